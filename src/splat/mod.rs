//! The differentiable Gaussian rasteriser on CPU: tiled forward, analytic backward, deterministic for any number of
//! threads. Knows nothing of methods, losses or optimisers.
//!
//! ```text
//! Anchors --place--> Gaussians --project--> rows --bin--> tiles --composite--> sums --develop--> images
//!    ^                   ^                                                                          |
//!    +----pullback-------+------chain------ moments <------composite backward------ adjoint <-------+  image gradients
//! ```
//!
//! A pixel's colour is decided in `plain/tile.rs`, function `forward`, and for exact discs in `plain/disc_tile.rs`; for
//! `f32` in their vectorised twins `cpp/splat/kernel.cpp` and `cpp/splat/disc.cpp`.
//!
//! The folders are floors: each imports only from those before it, and imports within a floor have no cycles.
//!
//! | floor | has |
//! |---|---|
//! | `number` | real and dual numbers, vectors, spherical harmonics |
//! | `types` | Gaussians, view, settings, images, gradients, directions; tiles and the columns of the tables |
//! | `plain` | every stage as plain functions over slices, for every number type: the twin of the C++ |
//! | `kernels` | one trait: which code runs a stage, C++ (`f32`) or `plain` (`f64`, dual numbers) |
//! | `pass` | threads and tables: bins, tiles, images, moments, gradients; channels; derivatives along directions |
//! | `anchors` | discs on the triangles of a mesh, and the backward pass of their gradients |
//! | `check` | gradients against central differences, seeded faults, the scene of the timings; with the feature `methods` |
//!
//! `Footprint::Disc` takes its own path from the projection on (`disc`, `disc_tile`, `disc_chain` in `plain`).
//! Outputs beyond colour, depth and alpha: `pass/channels.rs` (features, normals), `pass/pixel_walk.rs` (depth
//! of the surface, median depth, contributors).

mod anchors;
#[cfg(feature = "methods")]
mod check;
mod kernels;
mod number;
mod pass;
mod plain;
mod types;

pub use crate::ffi::isa::Isa;
pub use anchors::{Anchors, Carrier, DiscFrame};
#[cfg(feature = "methods")]
pub use check::{gradient_check, tube};
pub use kernels::SplatKernels;
pub use number::{Dual, Real};
pub use pass::{PassStage, Rasterizer, Reuse, StageTimes};
pub use plain::fault::Fault;
pub use types::{
    DepthOutput, Direction, Filter, Footprint, GROUP, GaussianSlices, Gaussians, Gradients, ImageGradient, Motion,
    Rendered, Settings, Shape, ShapeSlices, Skips, View, Wanted, is_unheard,
};
