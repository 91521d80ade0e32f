//! A pass over a scene on all threads: which stage runs on which chunk, and the tables between the stages. Each table
//! is changed in the file of its type; the recipe is in `rasterizer`, `tangent` adds derivatives along directions.
//!
//! From below: `pool`, `options`, `stages`, `reuse`, `rays`; `bins`, `splats`, `forward`, `images` (the forward pass
//! in its order); `backward`, `gradients` (the backward pass); `channels`, `pixel_walk`; `rasterizer`; `tangent`.

mod backward;
mod bins;
mod channels;
mod forward;
mod gradients;
mod images;
mod options;
mod pixel_walk;
mod pool;
mod rasterizer;
mod rays;
mod reuse;
mod splats;
mod stages;
mod tangent;

pub(in crate::splat) use pool::cut;
pub use rasterizer::Rasterizer;
pub use reuse::Reuse;
pub use stages::{PassStage, StageTimes};
