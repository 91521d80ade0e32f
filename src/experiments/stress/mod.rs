//! Numerical stability.

pub(crate) mod derivatives;
pub(crate) mod inputs;
pub(crate) mod metrics;
pub(crate) mod scenes;
