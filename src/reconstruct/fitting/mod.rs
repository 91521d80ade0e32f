//! Building blocks of fitting: what is optimised, against which loss, by which steps.

pub mod anchored;
pub mod contrast;
pub mod control_points;
pub mod free;
pub mod grid_search;
pub mod loss;
pub mod memory;
pub mod optimiser;
pub mod schedule;
pub mod scope_light;
pub mod unseen;
pub mod wall_picture;
