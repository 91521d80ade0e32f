//! Every stage of a pass as plain functions over slices, for every number type: the twin that the vectorised kernels
//! are checked against (f64), and the code that dual numbers run through. Each mistake of [`fault`] can be seeded
//! into the backward pass.
//!
//! From below: `fault`, `lens`, `exact_camera`, `projector`; `bins`, `project`, `tile`, `image`, `chain` for
//! `Footprint::Ewa`; `disc`, `disc_tile`, `disc_chain` for `Footprint::Disc`; `gradient_chunk` for both; `moving`,
//! `normals`, `surface_depth` for further outputs.

pub mod bins;
pub mod chain;
pub mod disc;
pub mod disc_chain;
pub mod disc_tile;
pub mod exact_camera;
pub mod fault;
pub mod gradient_chunk;
pub mod image;
pub mod lens;
pub mod moving;
pub mod normals;
pub mod project;
pub mod projector;
pub mod surface_depth;
pub mod tile;
