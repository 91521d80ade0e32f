//! Cost against error of many settings; each file gives the points of a chart.

pub mod phase;
pub mod render;
pub mod skipping;
pub mod splat;
