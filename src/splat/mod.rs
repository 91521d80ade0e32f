//! The differentiable Gaussian rasteriser on CPU: tiled forward, analytic backward, deterministic for any number of
//! threads. Knows nothing of methods, losses or optimisers.
//!
//! ```text
//! Anchors --place--> Gaussians --project--> rows --bin--> tiles --kernel--> images
//!    ^                   ^                                           |
//!    +----pullback-------+-------------chain<------moments<----------+  image gradients
//! ```
//!
//! The way of `Footprint::Disc` parts from it at the projection (`disc_mode`, `disc_tile`, `disc_chain`). What is asked
//! for beyond colour, depth and alpha: `extra_channels` (features, normals), `sight` (median depth, contributors).

mod anchors;
mod check;
mod kernels;
mod number;
mod pass;
mod plain;
mod types;

pub use crate::ffi::isa::Isa;
pub use anchors::{Anchors, Carrier, Frame};
pub use check::{gradient_check, tube};
pub use number::dual::Dual;
pub use number::real::Real;
pub use pass::rasterizer::Rasterizer;
pub use pass::reuse::Reuse;
pub use pass::stages::{Stage, StageTimes};
pub use pass::tangent::{Direction, Motion};
pub use plain::fault::Fault;
pub use types::scene::{
    DepthOutput, Filter, Footprint, Gaussians, Gradients, ImageGradient, Rendered, Settings, Shape, View, Wanted,
};
pub use types::skips::Skips;
