//! Signed distance in mm from voxel centres to the boundary of a mask, exact near it: the boundary is made of voxel
//! faces, so the distance to a set is that to the boxes of its voxels, which separates by axis,
//!
//!   d^2(i, j, k) = min over voxels of the set of  sum_axis (max(0, |difference| - 1/2) * spacing)^2.

use rayon::prelude::*;

use crate::base::Volume;

/// Distances of `mask` (above 0 inside): negative inside, at most `limit_mm` away from 0.
pub fn signed_distance(mask: &Volume<u8>, limit_mm: f64) -> Volume<f32> {
    let outside = distance_to(mask, true, limit_mm);
    let inside = distance_to(mask, false, limit_mm);
    let data = outside.par_iter().zip(&inside).map(|(out, inner)| out - inner).collect();
    Volume { grid: mask.grid, data }
}

/// Distance in mm of every voxel to the voxels in (or not in) the mask; 0 at those.
fn distance_to(mask: &Volume<u8>, is_inside: bool, limit_mm: f64) -> Vec<f32> {
    let [nx, ny, nz] = mask.grid.size;
    let spacing = mask.grid.spacing_mm();
    let most = (limit_mm * limit_mm) as f32;
    let start: Vec<f32> = mask.data.iter().map(|&v| if (v > 0) == is_inside { 0.0 } else { most }).collect();
    let steps = |axis: usize| -> Vec<f32> {
        let reach = (limit_mm / spacing[axis]).ceil() as usize + 1;
        (0..=reach).map(|d| ((d as f64 - 0.5).max(0.0) * spacing[axis]).powi(2) as f32).collect()
    };
    let along =
        |from: &[f32], stride: usize, length: usize, position: fn(usize, usize, usize) -> usize, costs: &[f32]| {
            let mut to = vec![0f32; from.len()];
            to.par_iter_mut().enumerate().for_each(|(at, best)| {
                let here = position(at, stride, length);
                *best = from[at];
                for (d, cost) in costs.iter().enumerate().skip(1) {
                    if *cost >= *best {
                        break;
                    }
                    if here >= d {
                        *best = best.min(from[at - d * stride] + cost);
                    }
                    if here + d < length {
                        *best = best.min(from[at + d * stride] + cost);
                    }
                }
            });
            to
        };
    let position = |at: usize, stride: usize, length: usize| at / stride % length;
    let x = along(&start, 1, nx, position, &steps(0));
    let y = along(&x, nx, ny, position, &steps(1));
    let z = along(&y, nx * ny, nz, position, &steps(2));
    z.into_par_iter().map(f32::sqrt).collect()
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::base::VoxelGrid;

    #[test]
    fn distances_to_a_block_are_those_to_its_faces_edges_and_corners() {
        let grid = VoxelGrid::upright([20, 20, 20], DVec3::ZERO, DVec3::new(0.5, 1.0, 2.0));
        let mut mask = Volume::filled(grid, 0u8);
        for at in 0..grid.count() {
            let cell = grid.cell(at);
            mask.data[at] = u8::from(cell.iter().all(|c| (6..14).contains(c)));
        }
        let distance = signed_distance(&mask, 6.0);
        let at = |i, j, k| f64::from(distance.value([i, j, k]));
        assert!((at(5, 10, 10) - 0.25).abs() < 1e-6);
        assert!((at(6, 10, 10) + 0.25).abs() < 1e-6);
        assert!((at(3, 10, 10) - 1.25).abs() < 1e-6);
        assert!((at(3, 4, 10) - 1.25f64.hypot(1.5)).abs() < 1e-6);
        assert!((at(4, 5, 5) - (0.75f64.powi(2) + 0.25 + 1.0).sqrt()).abs() < 1e-6);
        assert!((at(10, 10, 10) + 1.75).abs() < 1e-6, "{}", at(10, 10, 10));
        assert!((at(0, 0, 0) - 6.0).abs() < 1e-6);
    }
}
