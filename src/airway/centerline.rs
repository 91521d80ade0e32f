//! The centreline of a lumen: a tree of points with inscribed radii, ordered from the trachea's inlet outwards.

use glam::DVec3;

use super::centerline_distance::SurfaceDistance;
use super::centerline_trace::trace;
use super::centerline_tree::{assemble, centre};
use super::centerline_voxels::Voxels;
use crate::base::{Error, Result, TriangleMesh};

/// One point of the medial axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CenterlinePoint {
    /// Position in mm.
    pub position_mm: DVec3,
    /// Radius in mm of the largest sphere around the point that stays in the lumen.
    pub radius_mm: f64,
    /// Index of the branch (0 trachea).
    pub branch: u32,
    /// Generation of the branch (0 trachea).
    pub generation: u32,
    /// Index of the next point towards the inlet; `None` only for the inlet. Always smaller than the own index.
    pub parent: Option<u32>,
}

/// A tree of points; point 0 is the inlet of the trachea.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Centerline {
    /// Points, parents first.
    pub points: Vec<CenterlinePoint>,
}

/// How [`extract`] works.
#[derive(Clone, Debug, PartialEq)]
pub struct CenterlineSettings {
    /// Point in mm near the inlet; by default the upper (largest z) end of the widest airway.
    pub inlet_mm: Option<DVec3>,
    /// End branches with a smaller mean radius in mm are left out.
    pub minimal_radius_mm: f64,
    /// Distance in mm between neighbouring points.
    pub point_spacing_mm: f64,
    /// Edge length in mm of the voxels; by default 0.6 of the minimal radius. It grows where the bounding box would
    /// take more than 60 million voxels.
    pub voxel_mm: Option<f64>,
}

impl Default for CenterlineSettings {
    fn default() -> Self {
        Self { inlet_mm: None, minimal_radius_mm: 1.0, point_spacing_mm: 1.0, voxel_mm: None }
    }
}

/// Extracts the centreline of the closed surface `mesh` (normals either way).
///
/// Every point lies inside, its radius is its exact distance to the triangles. A branch runs from junction to
/// junction; the generation rises by one at each. The same mesh gives the same bytes on any number of threads.
///
/// # Errors
/// A mesh that is damaged, not closed or encloses no voxel; settings that are not positive.
pub fn extract(mesh: &TriangleMesh, settings: &CenterlineSettings) -> Result<Centerline> {
    mesh.validate()?;
    let voxel_mm = settings.voxel_mm.unwrap_or(0.6 * settings.minimal_radius_mm);
    if !(settings.minimal_radius_mm > 0.0 && settings.point_spacing_mm > 0.0 && voxel_mm > 0.0) {
        return Err(Error::usage("minimal radius, point spacing and voxel size of a centreline must be positive"));
    }
    let surface = SurfaceDistance::new(mesh);
    let voxels = Voxels::new(mesh, &surface, voxel_mm)?;
    let inlet = settings.inlet_mm.map_or_else(|| upper_end(&voxels), |point| voxels.nearest(point));
    let mut traces = trace(&voxels, inlet, settings.minimal_radius_mm);
    centre(&mut traces, &voxels, &surface);
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
