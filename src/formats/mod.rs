//! One external file format per file, pure functions both ways. Damaged input gives an error that names file and
//! element, never a panic.

mod damage;
pub mod depth_png;
#[cfg(feature = "program")]
pub mod dicom;
pub mod exr;
pub mod gaussians_ply;
pub mod landmarks;
pub mod mesh;
mod mesh_obj;
mod mesh_ply;
#[cfg(feature = "program")]
pub mod metaimage;
#[cfg(feature = "program")]
pub mod nifti;
pub mod npy;
pub mod png;
pub mod transforms;
#[cfg(feature = "program")]
pub mod volume;
#[cfg(feature = "program")]
mod volume_samples;
