//! Bridges of the splat core and of what trains it; films are made without it, so that a change here leaves
//! cached films valid.
//!
//! | bridge | C++ (`cpp/splat/`) | kernels, compiled once per instruction set |
//! |---|---|---|
//! | [`rasterize`] | `rasterize.cpp` | `project.cpp`, `kernel.cpp`, `disc.cpp`, `chain.cpp` |
//! | [`bin`] | `bin.cpp` | |
//! | [`image`] | `image.cpp` | |
//! | [`loss`] | `loss.cpp` | `loss_kernel.cpp` |
//! | [`adam`] | none: Rust, compiled for AVX2 as well | |

pub mod adam;
pub mod bin;
pub mod image;
#[cfg(feature = "methods")]
pub mod loss;
pub mod rasterize;
