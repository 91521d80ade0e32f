//! What is held against a scan before any work: units, spacing, field of view, and which way it lies.

use std::path::Path;

use glam::{DMat3, DVec3};

use super::dicom_conversion::read_scan;
use crate::base::{Error, Progress, Result, Volume, VoxelGrid};
use crate::formats::volume::frame_note;

/// Least share of voxels that are air or lung, and that are soft tissue, of a CT of a chest.
const LEAST_SHARE: f64 = 0.01;
/// HU below which is air or lung; and HU of soft tissue.
const AIR_HU: i16 = -500;
const TISSUE_HU: [i16; 2] = [-200, 300];
/// Thickest slices in mm in which a lobar bronchus can be followed.
const THICKEST_MM: f64 = 5.0;
/// Least extent in mm along each axis: half a chest.
const LEAST_EXTENT_MM: f64 = 100.0;
/// Values outside of the scanner's circle are padding: air.
const PADDING_HU: i16 = -1024;
const HIGHEST_HU: i16 = 3071;

/// Reads a scan, checks it, and turns it so that i, j and k run as nearly as they can to the left, back and head.
///
/// Errors: one sentence that names the file, and the cure; the user stopped the work.
pub fn read_checked(path: &Path, progress: &dyn Progress) -> Result<Volume<i16>> {
    let mut scan = read_scan(path, progress)?;
    progress.proceed()?;
    frame_note(path).iter().for_each(|note| progress.note(note));
    check_units(&scan.data).and_then(|()| check_grid(&scan.grid)).map_err(|e| e.at(path))?;
    scan.data.iter_mut().for_each(|v| *v = (*v).clamp(PADDING_HU, HIGHEST_HU));
    Ok(turned(scan))
}

/// Refuses values that are no Hounsfield units of a chest.
fn check_units(values: &[i16]) -> Result<()> {
    let (low, high) = values.iter().fold((i16::MAX, i16::MIN), |(low, high), &v| (low.min(v), high.max(v)));
    let share = |from: i16, to: i16| {
        values.iter().filter(|v| (from..=to).contains(*v)).count() as f64 / values.len().max(1) as f64
    };
    let are_hounsfield = share(i16::MIN, AIR_HU) >= LEAST_SHARE && share(TISSUE_HU[0], TISSUE_HU[1]) >= LEAST_SHARE;
    if are_hounsfield {
        return Ok(());
    }
    let what =
        format!("holds values from {low} to {high}, which are no Hounsfield units of a chest (air -1000, water 0)");
    let cure = if low >= 0 && high <= 255 {
        "it is a picture or a mask: export the CT itself"
    } else if low >= 0 {
        "its rescale intercept was lost: subtract 1024, or convert the DICOM folder again with `dcm2niix -z y`"
    } else {
        "export the CT of the chest with its rescale slope and intercept applied"
    };
    Err(Error::input(format!("{what}: {cure}")))
}

fn check_grid(grid: &VoxelGrid) -> Result<()> {
    let spacing = grid.spacing_mm();
    if spacing.max_element() > THICKEST_MM {
        return Err(Error::input(format!(
            "has voxels of {:.1} x {:.1} x {:.1} mm, in which no bronchus can be followed: {THICKEST_MM} mm is the most, \
             and the reconstruction with thin slices is wanted",
            spacing.x, spacing.y, spacing.z
        )));
    }
    let extent = spacing * DVec3::new(grid.size[0] as f64, grid.size[1] as f64, grid.size[2] as f64);
    if extent.min_element() < LEAST_EXTENT_MM {
        return Err(Error::input(format!(
            "shows {:.0} x {:.0} x {:.0} mm, and a chest has {LEAST_EXTENT_MM} mm or more along each axis: export the \
             whole field of view",
            extent.x, extent.y, extent.z
        )));
    }
    Ok(())
}

/// The volume with its voxels in such an order that i, j and k run as nearly as they can along x, y and z of LPS. No
/// value changes, and no voxel moves.
pub fn turned<T: Copy>(volume: Volume<T>) -> Volume<T> {
    let axes = [volume.grid.axes_mm.x_axis, volume.grid.axes_mm.y_axis, volume.grid.axes_mm.z_axis];
    let permutations = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];
    let fit = |p: &[usize; 3]| (0..3).map(|a| (axes[p[a]].normalize()[a]).abs()).sum::<f64>();
    let order = permutations.into_iter().fold(permutations[0], |best, p| if fit(&p) > fit(&best) { p } else { best });
    let is_flipped = [0, 1, 2].map(|a| axes[order[a]][a] < 0.0);
    if order == [0, 1, 2] && is_flipped == [false; 3] {
        return volume;
    }
    let old = volume.grid;
    let size = order.map(|axis| old.size[axis]);
    let mut first = [0usize; 3];
    (0..3).filter(|&a| is_flipped[a]).for_each(|a| first[order[a]] = old.size[order[a]] - 1);
    let signed = |a: usize| axes[order[a]] * if is_flipped[a] { -1.0 } else { 1.0 };
    let grid = VoxelGrid {
        size,
        origin_mm: old.position(DVec3::new(first[0] as f64, first[1] as f64, first[2] as f64)),
        axes_mm: DMat3::from_cols(signed(0), signed(1), signed(2)),
    };
    let mut data = Vec::with_capacity(volume.data.len());
    for k in 0..size[2] {
        for j in 0..size[1] {
            for i in 0..size[0] {
                let mut cell = [0usize; 3];
                for (a, n) in [i, j, k].into_iter().enumerate() {
                    cell[order[a]] = if is_flipped[a] { size[a] - 1 - n } else { n };
                }
                data.push(volume.value(cell));
            }
        }
    }
    Volume { grid, data }
}

/// Means of blocks of voxels, as many along each axis as make about `wanted_mm`: for what needs no finer voxels.
pub fn coarser(scan: &Volume<i16>, wanted_mm: f64) -> Volume<i16> {
    let spacing = scan.grid.spacing_mm();
    let block = [0, 1, 2].map(|a| ((wanted_mm / spacing[a]).round() as usize).clamp(1, scan.grid.size[a]));
    if block == [1, 1, 1] {
        return scan.clone();
    }
    let size = [0, 1, 2].map(|a| scan.grid.size[a] / block[a]);
    let factor = DVec3::new(block[0] as f64, block[1] as f64, block[2] as f64);
    let grid = VoxelGrid {
        size,
        origin_mm: scan.grid.position((factor - 1.0) * 0.5),
        axes_mm: scan.grid.axes_mm * DMat3::from_diagonal(factor),
    };
    let count = block.iter().product::<usize>() as i32;
    let mut data = Vec::with_capacity(grid.count());
    let mut row = vec![0i32; size[0]];
    for k in 0..size[2] {
        for j in 0..size[1] {
            row.fill(0);
            for z in 0..block[2] {
                for y in 0..block[1] {
                    let start = scan.grid.at([0, j * block[1] + y, k * block[2] + z]);
                    let line = &scan.data[start..start + size[0] * block[0]];
                    for (sum, part) in row.iter_mut().zip(line.chunks_exact(block[0])) {
                        *sum += part.iter().map(|&v| i32::from(v)).sum::<i32>();
                    }
                }
            }
            data.extend(row.iter().map(|&sum| (sum as f64 / f64::from(count)).round() as i16));
        }
    }
    Volume { grid, data }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_are_told_from_pictures_and_lost_intercepts() {
        let chest: Vec<i16> = (0..1000).map(|v| if v % 3 == 0 { -850 } else { 40 + v % 20 }).collect();
        check_units(&chest).unwrap();
        let said = |map: &dyn Fn(i16) -> i16| {
            check_units(&chest.iter().map(|v| map(*v)).collect::<Vec<_>>()).unwrap_err().to_string()
        };
        assert!(said(&|v| (v + 1024) / 10).contains("it is a picture"));
        assert!(said(&|v| v + 1024).contains("subtract 1024"));
        assert!(said(&|v| v / 2 - 700).contains("slope and intercept"));
    }

    #[test]
    fn grids_that_no_airway_can_be_followed_in_are_refused() {
        let grid = VoxelGrid::upright([256, 256, 128], DVec3::ZERO, DVec3::new(1.95, 1.95, 2.5));
        check_grid(&grid).unwrap();
        let thick = VoxelGrid { axes_mm: DMat3::from_diagonal(DVec3::new(0.7, 0.7, 8.0)), ..grid };
        assert!(check_grid(&thick).unwrap_err().to_string().contains("thin slices"));
        let small = VoxelGrid { size: [256, 256, 20], ..grid };
        assert!(check_grid(&small).unwrap_err().to_string().contains("field of view"));
    }

    #[test]
    fn turning_and_coarsening_move_nothing() {
        // i to the head, j to the right, k to the front.
        let axes_mm = DMat3::from_cols(DVec3::Z * 2.0, DVec3::NEG_X, DVec3::new(0.1, -1.5, 0.0));
        let grid = VoxelGrid { size: [4, 6, 8], origin_mm: DVec3::new(5.0, 6.0, 7.0), axes_mm };
        let height = |p: DVec3| (10.0 * p.x - 20.0 * p.y + 50.0 * p.z).round() as i16;
        let volume = Volume { grid, data: (0..grid.count()).map(|at| height(grid.centre(at))).collect() };
        let lying = turned(volume.clone());
        assert_eq!(lying.grid.size, [6, 8, 4]);
        assert!(lying.grid.axes_mm.x_axis.x > 0.0 && lying.grid.axes_mm.z_axis.z > 0.0);
        for at in 0..lying.grid.count() {
            assert_eq!(lying.data[at], height(lying.grid.centre(at)));
        }
        let coarse = coarser(&lying, 2.0);
        assert_eq!(coarse.grid.size, [3, 8, 4]);
        for at in 0..coarse.grid.count() {
            assert!((coarse.data[at] - height(coarse.grid.centre(at))).abs() <= 1);
        }
    }
}
