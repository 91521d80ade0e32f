//! Losses and their analytic gradients, one file each.

pub mod arap;
pub mod best_rotation;
pub mod pairs;
pub mod photometric;
