//! Cost against error of many settings.

pub(crate) mod phase;
pub(crate) mod render;
pub(crate) mod skipping;
pub(crate) mod splat;
