//! The centreline of a lumen: a tree of points with inscribed radii, ordered from the trachea's inlet outwards.

use glam::DVec3;

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
