//! Numbers alone: real numbers, dual numbers, vectors, spherical harmonics. Knows nothing of Gaussians or images.

mod dual;
mod real;
pub mod sh;
mod vector;

pub use dual::Dual;
pub use real::Real;
pub use vector::{Each, add, cross, dot, normalized, rotation_columns};
