//! The rasteriser against references that it did not make: brute force, finite differences, `../shared/reference`.

mod anchoring;
mod command;
mod disc;
pub mod forward;
mod gradients;
mod numpy_normal;
mod portable;
mod reuse;
mod robustness;
mod scenes;
mod skips;
mod tangent;
