//! Where the scope is in a breathing airway, when nothing that is told is exact: pose, phase, the field's correction, lens
//! and lamp in one state ([`state`]), fed by the sensor's pose ([`sensor`]) and by pictures ([`look`]).
//!
//! A sliding window that is one frame long: what earlier frames say is kept as a Gaussian, in which everything before the
//! present is marginalised. Errors that last (the sensor's bias, what shading makes of a pose, the wall's offset) are
//! unknowns of the state, so that a hundred pictures that are wrong alike do not count as a hundred.

pub mod look;
pub mod sensor;
pub mod start;
pub mod state;
#[cfg(test)]
pub(super) mod tests;
pub mod wall_mask;

pub use state::NavigationState;
pub use wall_mask::wall_shares;
