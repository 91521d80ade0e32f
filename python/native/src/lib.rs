//! The native half of the Python package `respire_bench`: numpy arrays in, numpy arrays out. What a user sees, with its
//! documentation, is in `respire_bench/*.py`; the module that Python loads is `../src/lib.rs`.
//!
//! | file | holds |
//! |---|---|
//! | `film` | a film's folder or a participant's, read file by file |
//! | `predict` | a prediction's folder |
//! | `rasterize` | the splat core behind `rasterize` |
//! | `table` | gradients as Python holds them |
//! | `threads` | on which threads a call computes, and in a forked child |
//! | `failure` | errors of the library as Python exceptions |

pub mod failure;
pub mod film;
pub mod predict;
pub mod rasterize;
mod table;
mod threads;
