//! What every room may use: errors, geometry, images, randomness, hashing, files. Knows nothing above itself.

pub mod base64;
pub mod camera;
pub mod case_id;
pub mod color;
pub mod depth;
pub mod error;
pub mod estimate;
pub mod files;
pub mod hash;
pub mod image;
pub mod mask;
pub mod mesh;
pub mod method_name;
pub mod own_row;
pub mod pose;
pub mod progress;
pub mod random;
pub mod range;
pub mod revision;
pub mod shipped;
pub mod staging;
pub mod statistics;
pub mod target_limits;
pub mod volume;

pub use camera::Camera;
pub use error::{Error, ErrorKind, Result};
pub use estimate::Estimate;
pub use image::Image;
pub use mask::Mask;
pub use mesh::{Neighbours, TriangleMesh};
pub use progress::{NoProgress, Progress};
pub use staging::Staging;
pub use volume::{Volume, VoxelGrid};
