//! A scan as a registration sees it: how far each voxel stands out of its surroundings, whatever their density.
//!
//! A lung that empties becomes denser, the more so the lower it lies, and a correlation over the whole lung takes that for
//! structure. So every voxel is given as
//!
//!   c(x) = (h(x) - m(x)) / (s(x) + 30 HU),
//!
//! with h the HU within -1000 to 200, and m and s their mean and standard deviation under a Gaussian of 8 mm: the
//! correlation of c over a region is close to the mean of local correlations (Cachier and Pennec, MMBIA 2000). Mean and
//! deviation are those of lungs and airways wherever there are any nearby: the chest wall, along which a lung slides, has
//! a thousandth of their weight.

use rayon::prelude::*;

use super::parts::grown;
use crate::base::Volume;

/// HU that are told apart: air to soft tissue. Bone and contrast medium count as the latter.
const RANGE_HU: [i16; 2] = [-1000, 200];
/// Standard deviation in mm of the surroundings: a few vessels wide, and small beside a lobe.
const SURROUNDINGS_MM: f64 = 8.0;
/// The rim in mm that counts as lung or airway, so that the pleura and the wall of the trachea are seen as edges.
const RIM_MM: f64 = 3.0;
/// Weight of what is neither.
const OUTSIDE: f32 = 1e-3;
/// Deviation in HU that is added: noise of an even place is not blown up.
const FLOOR_HU: f32 = 30.0;
/// Bounds of the contrast, and its unit in the result: vessels stand out by five deviations and more.
const BOUNDS: [f32; 2] = [-3.0, 5.0];
const UNIT: f32 = 300.0;
/// Standard deviations after which a Gaussian is cut off.
const CUT_OFF: f64 = 3.0;

/// Weights of a Gaussian at 0, 1, 2, .. voxels from its middle; normalised by the caller.
fn half_kernel(deviation_voxels: f64) -> Vec<f32> {
    let reach = (CUT_OFF * deviation_voxels).ceil() as usize;
    (0..=reach).map(|k| (-0.5 * (k as f64 / deviation_voxels).powi(2)).exp() as f32).collect()
}

/// Sums of `values` under a Gaussian along each axis; what is outside of the volume counts as 0.
fn spread_out(mut values: Vec<f32>, size: [usize; 3], deviation_voxels: [f64; 3]) -> Vec<f32> {
    let mut stride = 1;
    for axis in 0..3 {
        let kernel = half_kernel(deviation_voxels[axis]);
        let sum = |at: usize| {
            let here = at / stride % size[axis];
            let mut sum = kernel[0] * values[at];
            for (k, weight) in kernel.iter().enumerate().skip(1) {
                if here >= k {
                    sum += weight * values[at - k * stride];
                }
                if here + k < size[axis] {
                    sum += weight * values[at + k * stride];
                }
            }
            sum
        };
        values = (0..values.len()).into_par_iter().map(sum).collect();
        stride *= size[axis];
    }
    values
}

/// The contrast of `scan` (HU), 300 a standard deviation, -900 to 1500. `air`, lungs and airways, has the scan's grid.
pub fn local_contrast(scan: &Volume<i16>, air: &Volume<u8>) -> Volume<i16> {
    let size = scan.grid.size;
    let deviation = (SURROUNDINGS_MM / scan.grid.spacing_mm()).to_array();
    let weight: Vec<f32> = grown(air, RIM_MM).data.iter().map(|v| if *v > 0 { 1.0 } else { OUTSIDE }).collect();
    let hu: Vec<f32> = scan.data.iter().map(|v| f32::from((*v).clamp(RANGE_HU[0], RANGE_HU[1]))).collect();
    let moment =
        |of: fn(f32) -> f32| spread_out(weight.iter().zip(&hu).map(|(w, h)| w * of(*h)).collect(), size, deviation);
    let (total, first, second) = (moment(|_| 1.0), moment(|h| h), moment(|h| h * h));
    let contrast = |at: usize| {
        let mean = first[at] / total[at];
        let variance = (second[at] / total[at] - mean * mean).max(0.0);
        let contrast = (hu[at] - mean) / (variance.sqrt() + FLOOR_HU);
        (UNIT * contrast.clamp(BOUNDS[0], BOUNDS[1])).round() as i16
    };
    Volume { grid: scan.grid, data: (0..scan.data.len()).into_par_iter().map(contrast).collect() }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::base::VoxelGrid;

    /// Vessels in a lung that is twice as dense in one scan, and denser at the back, look the same; the chest wall next
    /// to a lung does not tell.
    #[test]
    fn density_does_not_tell_and_vessels_do() {
        let grid = VoxelGrid::upright([50, 40, 30], DVec3::new(-50.0, -40.0, -30.0), DVec3::splat(2.0));
        let is_lung = |p: DVec3| p.x < 20.0;
        let is_vessel = |p: DVec3| (p.truncate() % 16.0).abs().min_element() < 2.0;
        let scan = |density: f64, wall: i16| {
            let value = |at: usize| {
                let p = grid.centre(at);
                match (is_lung(p), is_vessel(p)) {
                    (false, _) => wall,
                    // What stands out of the parenchyma shrinks as that becomes denser: partial volumes of vessels.
                    (true, vessel) => {
                        let tissue = density * (1.0 + p.y / 160.0);
                        (1000.0 * (tissue * if vessel { 2.0 } else { 1.0 } - 1.0)) as i16
                    }
                }
            };
            Volume { grid, data: (0..grid.count()).map(value).collect() }
        };
        let lungs = Volume { grid, data: (0..grid.count()).map(|at| u8::from(is_lung(grid.centre(at)))).collect() };
        let (full, empty) = (local_contrast(&scan(0.12, 40), &lungs), local_contrast(&scan(0.24, 40), &lungs));
        let other_wall = local_contrast(&scan(0.12, -100), &lungs);
        let inner = |at: &usize| grid.centre(*at).x < 12.0;
        let mean_difference = |a: &Volume<i16>, b: &Volume<i16>| {
            let all: Vec<f64> =
                (0..grid.count()).filter(inner).map(|at| f64::from(a.data[at] - b.data[at]).abs()).collect();
            all.iter().sum::<f64>() / all.len() as f64
        };
        let size: f64 = mean_difference(&full, &Volume::filled(grid, 0i16));
        // A third of the surroundings' deviation, in the mean over vessels and what lies between them.
        assert!(size > f64::from(UNIT) / 3.0, "vessels stand out: {size}");
        assert!(mean_difference(&full, &empty) < 0.35 * size, "{}", mean_difference(&full, &empty));
        assert!(mean_difference(&full, &other_wall) < 0.05 * size, "{}", mean_difference(&full, &other_wall));
    }
}
