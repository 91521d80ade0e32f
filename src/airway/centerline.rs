//! The centreline of a lumen: a tree of points with inscribed radii, ordered from the trachea's inlet outwards.

use glam::DVec3;

/// Longest sum of all branches in mm: a kilometre, some fifty times what CT shows.
pub(super) const MOST_LENGTH_MM: f64 = 1e6;

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
    /// Index of the next point towards the inlet; `None` only for the inlet. Always smaller than the point's own index.
    pub parent: Option<u32>,
}

/// A tree of points; point 0 is the inlet of the trachea.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Centerline {
    /// Points, parents first.
    pub points: Vec<CenterlinePoint>,
}

/// How [`super::centerline_extract::extract`] works.
#[derive(Clone, Debug, PartialEq)]
pub struct CenterlineSettings {
    /// Point in mm near the inlet; by default the upper (largest z) end of the widest airway.
    pub inlet_mm: Option<DVec3>,
    /// End branches with a smaller mean radius in mm are cut back to their longest beginning that has it, or left out
    /// where that is too short to be a branch.
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
