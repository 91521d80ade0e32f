//! What checks and times the core: gradients against central differences, and the scene of the timings.

pub mod gradient_check;
pub mod tube;
