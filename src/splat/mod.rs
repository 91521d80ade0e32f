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
mod bin;
mod chain;
mod composite;
mod disc_chain;
mod disc_mode;
mod disc_tangent;
mod disc_tile;
mod dual;
mod extra_channels;
mod fault;
pub mod gradient_check;
mod kernel;
mod lens;
mod native;
mod parameters;
mod pool;
mod project;
mod rasterizer;
mod real;
mod reuse;
mod sh;
mod sight;
mod skips;
mod stages;
mod surface_depth;
mod tangent;
mod tile;
pub mod tube;
mod types;

pub use crate::ffi::isa::Isa;
pub use anchors::{Anchors, Carrier, Frame};
pub use dual::Dual;
pub use fault::Fault;
pub use rasterizer::Rasterizer;
pub use real::Real;
pub use reuse::Reuse;
pub use skips::Skips;
pub use stages::{Stage, StageTimes};
pub use tangent::{Direction, Motion};
pub use types::{
    DepthOutput, Filter, Footprint, Gaussians, Gradients, ImageGradient, Rendered, Settings, Shape, View, Wanted,
};
