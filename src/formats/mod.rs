//! One external file format per file, pure functions both ways. Damaged input gives an error that names file and
//! element, never a panic.

pub mod colmap;
mod damage;
pub mod depth_png;
#[cfg(feature = "program")]
pub mod dicom;
#[cfg(feature = "program")]
mod dicom_elements;
pub mod exr;
pub mod gaussians_ply;
pub mod glb;
#[cfg(feature = "program")]
pub mod http;
#[cfg(feature = "trace")]
pub mod jpeg;
#[cfg(feature = "trace")]
mod jpeg_decode;
pub mod landmarks;
pub mod mesh;
mod mesh_obj;
mod mesh_ply;
#[cfg(feature = "program")]
pub mod metaimage;
#[cfg(feature = "program")]
pub mod nifti;
#[cfg(feature = "methods")]
pub mod npy;
pub mod number_table;
pub mod png;
pub mod points_ply;
pub mod tiff_grey;
pub mod transforms;
pub mod tum;
#[cfg(feature = "program")]
pub mod volume;
#[cfg(feature = "program")]
mod volume_samples;
