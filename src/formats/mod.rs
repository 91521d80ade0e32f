//! One external file format per file, pure functions both ways. Damaged input gives an error that names file and
//! element, never a panic.

pub mod colmap;
mod damage;
pub mod depth_png;
pub mod exr;
pub mod gaussians_ply;
pub mod glb;
pub mod landmarks;
pub mod mesh;
mod mesh_obj;
mod mesh_ply;
pub mod npy;
pub mod png;
pub mod points_ply;
pub mod tiff_grey;
pub mod transforms;
pub mod tum;
