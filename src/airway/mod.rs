//! Anatomy that breathes: case files, bronchial trees, surface, breathing field and waveform, centreline, import.
//! Knows nothing of rendering.

pub mod breathing_text;
pub mod case;
pub mod case_build;
pub mod case_centerline;
pub mod case_clinical;
mod case_scope;
mod case_steering;
pub mod centerline;
mod centerline_centre;
pub mod centerline_distance;
pub mod centerline_extract;
mod centerline_trace;
mod centerline_tree;
pub mod centerline_voxels;
pub mod field;
pub mod field_calibre;
pub mod field_check;
pub mod field_fit;
pub mod fold_mending;
pub mod grow;
mod grow_region;
mod grow_shape;
pub mod import_axes;
pub mod import_breathing;
pub mod import_carried;
pub mod import_check;
pub mod import_mesh;
pub mod import_tree;
pub mod morphometry;
pub mod nearest_points;
pub mod remesh;
pub mod surface;
pub mod surface_field;
pub mod surface_polygon;
pub mod target;
pub mod targets;
pub mod tree;
pub mod waveform;

pub use case_build::build;
use glam::DVec3;

use crate::base::TriangleMesh;
use centerline::Centerline;

/// One airway in its two end states, with one topology: what a case file builds and a simulator films.
#[derive(Clone, Debug)]
pub struct Anatomy {
    /// Surface at full inspiration (phase 0, the rest shape); normals point into the lumen.
    pub inspiration: TriangleMesh,
    /// The same faces at full expiration (phase 1).
    pub expiration: TriangleMesh,
    /// Airway generation of each vertex (0 trachea), fractional at bifurcations; drives the mucosa's look.
    pub vertex_generation: Vec<f32>,
    /// Centreline at inspiration.
    pub centerline: Centerline,
    /// Position in mm of each centreline point at expiration.
    pub centerline_expiration: Vec<DVec3>,
    /// Inscribed radius in mm of each centreline point at expiration.
    pub radius_expiration_mm: Vec<f64>,
}
