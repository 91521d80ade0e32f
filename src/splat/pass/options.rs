//! What is chosen once for many passes.

use crate::ffi::isa::Isa;
use crate::splat::types::Skips;

/// Which kernels run, and what they leave out.
#[derive(Clone, Copy, Debug)]
pub struct PassOptions {
    pub isa: Isa,
    pub skips: Skips,
}
