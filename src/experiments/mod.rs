//! Measurements of the program itself: what parts are worth, cost against error, numerical stability.

pub mod ablation;
pub mod pareto;
pub mod stress;
