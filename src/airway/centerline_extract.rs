//! Extracts the centreline of a closed surface: voxels of the lumen, paths from the inlet to every end, centred and
//! joined.

use super::centerline::{Centerline, CenterlineSettings};
use super::centerline_centre::centre;
use super::centerline_distance::SurfaceDistance;
use super::centerline_trace::trace;
use super::centerline_tree::assemble;
use super::centerline_voxels::Voxels;
use crate::base::{Error, NoProgress, Progress, Result, TriangleMesh};

/// Extracts the centreline of the closed surface `mesh` (normals either way).
///
/// Every point lies inside, its radius is its exact distance to the triangles. A branch runs from junction to
/// junction; the generation rises by one at each. The same mesh gives the same bytes on any number of threads.
///
/// # Errors
/// A mesh that is damaged, not closed or encloses no voxel; settings that are not positive.
pub fn extract(mesh: &TriangleMesh, settings: &CenterlineSettings) -> Result<Centerline> {
    extract_watched(mesh, settings, &NoProgress)
}

/// [`extract`], which `progress` watches and may stop.
pub fn extract_watched(
    mesh: &TriangleMesh,
    settings: &CenterlineSettings,
    progress: &dyn Progress,
) -> Result<Centerline> {
    mesh.validate()?;
    let voxel_mm = settings.voxel_mm.unwrap_or(0.6 * settings.minimal_radius_mm);
    if !(settings.minimal_radius_mm > 0.0 && settings.point_spacing_mm > 0.0 && voxel_mm > 0.0) {
        return Err(Error::usage("minimal radius, point spacing and voxel size of a centreline must be positive"));
    }
    let surface = SurfaceDistance::new(mesh);
    let voxels = Voxels::new(mesh, &surface, voxel_mm)?;
    let inlet = settings.inlet_mm.map_or_else(|| upper_end(&voxels), |point| voxels.nearest(point));
    let mut traces = trace(&voxels, inlet, settings.minimal_radius_mm, progress)?;
    centre(&mut traces, &voxels, &surface, progress)?;
    Ok(assemble(&traces, settings, &voxels, &surface))
}

/// The middle of the upper end of the widest airway.
fn upper_end(voxels: &Voxels) -> u32 {
    let widest = voxels.distance_mm.iter().copied().fold(0.0, f64::max);
    let height = |v: u32| voxels.center(v).z;
    let wide: Vec<u32> = (0..voxels.len() as u32).filter(|v| voxels.distance_mm[*v as usize] > 0.5 * widest).collect();
    let top = wide.iter().map(|&v| height(v)).fold(f64::NEG_INFINITY, f64::max);
    wide.into_iter()
        .filter(|&v| height(v) > top - 0.5 * widest)
        .max_by(|&a, &b| voxels.distance_mm[a as usize].total_cmp(&voxels.distance_mm[b as usize]).then(b.cmp(&a)))
        .expect("the widest voxel is wide")
}

#[cfg(test)]
#[path = "centerline_tests.rs"]
mod tests;
