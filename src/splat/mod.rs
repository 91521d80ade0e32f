//! The differentiable Gaussian rasteriser on CPU: tiled forward, analytic backward, deterministic for any number of
//! threads. Knows nothing of methods, losses or optimisers.
//!
//! ```text
//! Anchors --place--> Gaussians --project--> rows --bin--> tiles --kernel--> images
//!    ^                   ^                                           |
//!    +----pullback-------+-------------chain<------moments<----------+  image gradients
//! ```

mod anchors;
mod bin;
mod chain;
mod composite;
mod dual;
mod fault;
pub mod gradient_check;
mod jvp;
mod kernel;
mod native;
mod parameters;
mod project;
mod rasterizer;
mod real;
mod reuse;
mod sh;
mod stages;
mod surface_depth;
mod tangent;
mod types;

pub use crate::ffi::splat::Isa;
pub use anchors::{Anchors, Carrier, Frame};
pub use dual::Dual;
pub use fault::Fault;
pub use jvp::PhaseTangent;
pub use rasterizer::Rasterizer;
pub use real::Real;
pub use reuse::Reuse;
pub use stages::{Stage, StageTimes};
pub use tangent::{Direction, Motion};
pub use types::{DepthOutput, Filter, Gaussians, Gradients, ImageGradient, Rendered, Settings, Shape, View, Wanted};
