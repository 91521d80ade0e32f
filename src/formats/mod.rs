//! One external file format per file, pure functions both ways. Damaged input gives an error that names file and
//! element, never a panic.

#[cfg(feature = "methods")]
pub mod colmap;
mod damage;
#[cfg(feature = "methods")]
pub mod depth_png;
#[cfg(feature = "program")]
pub mod dicom;
#[cfg(feature = "program")]
mod dicom_elements;
pub mod exr;
#[cfg(feature = "methods")]
pub mod gaussians_ply;
#[cfg(feature = "methods")]
pub mod glb;
#[cfg(feature = "program")]
pub mod http;
#[cfg(feature = "trace")]
pub mod jpeg;
#[cfg(feature = "trace")]
mod jpeg_decode;
#[cfg(feature = "methods")]
pub mod landmarks;
pub mod mesh;
mod mesh_obj;
mod mesh_ply;
mod mesh_polygons;
#[cfg(feature = "program")]
pub mod metaimage;
#[cfg(feature = "program")]
pub mod nifti;
#[cfg(feature = "methods")]
pub mod npy;
pub mod number_table;
pub mod png;
#[cfg(feature = "methods")]
pub mod points_ply;
pub mod prediction;
#[cfg(feature = "methods")]
pub mod tiff_grey;
pub mod transforms;
#[cfg(feature = "methods")]
pub mod tum;
#[cfg(feature = "program")]
pub mod volume;
#[cfg(feature = "program")]
mod volume_samples;
