//! The rasteriser against references that it did not make: brute force, finite differences, `../shared/reference`.

mod anchoring;
mod command;
mod forward;
mod gradients;
mod reuse;
mod robustness;
mod scenes;
mod tangent;
