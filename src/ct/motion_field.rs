//! A displacement field between the breath holds, and what is measured of it: does it fold, does the way back undo it.
//!
//! u(x) in mm, LPS: the tissue that is at x at full inspiration is at x + u(x) at full expiration.

use glam::{DMat3, DVec3};
use rayon::prelude::*;

use super::lumen::DistanceSpread;
use crate::airway::import_check::STILL_MM;
use crate::base::{Error, Result, Volume, VoxelGrid};

/// Farthest in mm that tissue moves between two breath holds, the patient's own motion included.
const FARTHEST_MM: f64 = 120.0;
/// Bounds of the histogram of volume change.
const HISTOGRAM: [f64; 2] = [0.0, 2.0];
const BINS: usize = 40;

/// How a field changes volumes: determinants of I + grad u over a region.
#[derive(Clone, Debug, PartialEq)]
pub struct VolumeChange {
    /// Voxels looked at.
    pub voxels: usize,
    /// Those that fold (0 or less).
    pub folded: usize,
    /// Least determinant.
    pub least: f64,
    /// Median.
    pub median: f64,
    /// Greatest.
    pub greatest: f64,
    /// Shares of voxels in bins of equal width from 0 to 2; what lies outside counts in the first or last.
    pub histogram: Vec<f64>,
}

/// Refuses a field that no breathing is: too far, or nowhere.
pub fn check_motion(field: &Volume<[f32; 3]>) -> Result<()> {
    let farthest = field.data.iter().map(|v| v.iter().map(|c| c * c).sum::<f32>()).fold(0.0, f32::max).sqrt();
    if f64::from(farthest) > FARTHEST_MM {
        return Err(Error::input(format!(
            "moves tissue by {farthest:.0} mm, and breathing moves it by {FARTHEST_MM} mm at most: a displacement field \
             in mm is wanted"
        )));
    }
    if f64::from(farthest) < STILL_MM {
        return Err(still(farthest.into()));
    }
    Ok(())
}

fn still(most_mm: f64) -> Error {
    Error::input(format!(
        "does not move the airway (by {most_mm:.3} mm at most): is it in metres? A displacement field in mm is wanted"
    ))
}

/// Refuses a field that does not cover `places`, the airway, and one that does not move them.
pub fn check_field(field: &Volume<[f32; 3]>, places: &[DVec3]) -> Result<()> {
    let to_index = field.grid.index_from_place();
    let moves: Vec<f64> =
        places.iter().filter_map(|p| field.sample_vector(to_index(*p))).map(|motion| motion.length()).collect();
    if (moves.len() as f64) < 0.98 * places.len() as f64 {
        return Err(Error::input(format!(
            "covers {:.0} % of the airway: it was made for another scan, or its frame is not that of the inspiration scan",
            100.0 * moves.len() as f64 / places.len().max(1) as f64
        )));
    }
    let most = moves.into_iter().fold(0.0, f64::max);
    if most < STILL_MM { Err(still(most)) } else { Ok(()) }
}

/// Displacement at a place; at the rim's where the field has ended.
pub fn displacement(field: &Volume<[f32; 3]>, to_index: impl Fn(DVec3) -> DVec3, place: DVec3) -> DVec3 {
    let last = DVec3::new(field.grid.size[0] as f64, field.grid.size[1] as f64, field.grid.size[2] as f64) - 1.0;
    field.sample_vector(to_index(place).clamp(DVec3::ZERO, last)).unwrap_or_default()
}

/// Where `places` are at expiration.
pub fn carried(field: &Volume<[f32; 3]>, places: &[DVec3]) -> Vec<DVec3> {
    let to_index = field.grid.index_from_place();
    places.par_iter().map(|&p| p + displacement(field, to_index, p)).collect()
}

/// Determinant of I + grad u at a voxel, by central differences; one-sided at the rim.
fn determinant(field: &Volume<[f32; 3]>, index_from_step: DMat3, at: usize) -> f64 {
    let grid = field.grid;
    let cell = grid.cell(at);
    let vector = |cell: [usize; 3]| {
        let [x, y, z] = field.value(cell).map(f64::from);
        DVec3::new(x, y, z)
    };
    let along = |axis: usize| {
        let (mut low, mut high) = (cell, cell);
        low[axis] = cell[axis].saturating_sub(1);
        high[axis] = (cell[axis] + 1).min(grid.size[axis] - 1);
        (vector(high) - vector(low)) / (high[axis] - low[axis]).max(1) as f64
    };
    let by_index = DMat3::from_cols(along(0), along(1), along(2));
    (DMat3::IDENTITY + by_index * index_from_step).determinant()
}

/// The volume change in the voxels of `region`, which has the field's grid.
pub fn volume_change(field: &Volume<[f32; 3]>, region: &Volume<u8>) -> VolumeChange {
    let inverse = field.grid.axes_mm.inverse();
    let mut all: Vec<f64> = (0..field.data.len())
        .into_par_iter()
        .filter(|&at| region.data[at] > 0)
        .map(|at| determinant(field, inverse, at))
        .collect();
    all.sort_by(f64::total_cmp);
    let mut histogram = vec![0.0; BINS];
    let width = (HISTOGRAM[1] - HISTOGRAM[0]) / BINS as f64;
    for value in &all {
        let bin = ((value - HISTOGRAM[0]) / width).clamp(0.0, BINS as f64 - 1.0);
        histogram[bin as usize] += 1.0 / all.len() as f64;
    }
    let at = |share: f64| all.get((share * all.len().saturating_sub(1) as f64) as usize).copied().unwrap_or(1.0);
    VolumeChange {
        voxels: all.len(),
        folded: all.iter().filter(|d| **d <= 0.0).count(),
        least: at(0.0),
        median: at(0.5),
        greatest: at(1.0),
        histogram,
    }
}

/// |u(x) + v(x + u(x))| in mm at `places`, where `back` is v, the field the other way. Places that it does not cover are
/// left out.
pub fn inverse_consistency(field: &Volume<[f32; 3]>, back: &Volume<[f32; 3]>, places: &[DVec3]) -> DistanceSpread {
    let (to_index, to_index_back) = (field.grid.index_from_place(), back.grid.index_from_place());
    let miss = |place: &DVec3| {
        let motion = displacement(field, to_index, *place);
        Some((motion + back.sample_vector(to_index_back(*place + motion))?).length())
    };
    DistanceSpread::of(places.par_iter().filter_map(miss).collect())
}

/// A field of a known motion on a grid: for tests, and for whoever has the motion as a function.
pub fn sampled_field(grid: VoxelGrid, motion: impl Fn(DVec3) -> DVec3 + Sync) -> Volume<[f32; 3]> {
    let data = (0..grid.count()).into_par_iter().map(|at| motion(grid.centre(at)).as_vec3().to_array()).collect();
    Volume { grid, data }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid() -> VoxelGrid {
        let turn = DMat3::from_rotation_z(0.3);
        let axes_mm = turn * DMat3::from_diagonal(DVec3::new(2.0, 2.5, 3.0));
        VoxelGrid { size: [20, 18, 16], origin_mm: DVec3::new(-20.0, 10.0, 5.0), axes_mm }
    }

    #[test]
    fn an_affine_field_changes_volumes_by_its_determinant_and_its_inverse_undoes_it() {
        let matrix = DMat3::from_diagonal(DVec3::new(-0.1, 0.05, -0.2));
        let forward = sampled_field(grid(), |p| matrix * p);
        let wide = VoxelGrid { size: [60; 3], origin_mm: grid().position(DVec3::splat(-20.0)), ..grid() };
        let inverse = (DMat3::IDENTITY + matrix).inverse() - DMat3::IDENTITY;
        let back = sampled_field(wide, |p| inverse * p);
        let whole = Volume::filled(grid(), 1u8);
        let change = volume_change(&forward, &whole);
        let truth = 0.9 * 1.05 * 0.8;
        assert!((change.least - truth).abs() < 1e-4 && (change.greatest - truth).abs() < 1e-4, "{change:?}");
        assert_eq!((change.folded, change.voxels), (0, grid().count()));
        assert!((change.histogram.iter().sum::<f64>() - 1.0).abs() < 1e-9);
        let all: Vec<DVec3> = (0..grid().count()).map(|at| grid().centre(at)).collect();
        assert!(inverse_consistency(&forward, &back, &all).most_mm < 1e-4);
        let place = grid().position(DVec3::new(3.3, 4.4, 5.5));
        assert!((carried(&forward, &[place])[0] - (place + matrix * place)).length() < 1e-4);
        check_motion(&forward).and_then(|()| check_field(&forward, &[place])).unwrap();
    }

    #[test]
    fn folds_are_counted_and_fields_of_other_frames_refused() {
        let folding = sampled_field(grid(), |p| DVec3::new(-1.5 * p.x, 0.0, 0.0));
        assert_eq!(volume_change(&folding, &Volume::filled(grid(), 1u8)).folded, grid().count());
        let far = grid().position(DVec3::splat(-9.0));
        assert!(check_field(&folding, &[far]).unwrap_err().to_string().contains("covers 0 %"));
        let wide = sampled_field(grid(), |_| DVec3::X * 900.0);
        assert!(check_motion(&wide).unwrap_err().to_string().contains("900 mm"));
        let metres = sampled_field(grid(), |_| DVec3::X * 0.02);
        assert!(check_motion(&metres).unwrap_err().to_string().contains("0.020 mm at most): is it in metres?"));
        // It moves, but not where the airway is.
        let middle = grid().position(DVec3::splat(8.0));
        let aside = sampled_field(grid(), |p| if p.distance(middle) > 15.0 { DVec3::X * 5.0 } else { DVec3::ZERO });
        check_motion(&aside).unwrap();
        assert!(check_field(&aside, &[middle]).unwrap_err().to_string().contains("does not move the airway"));
    }
}
