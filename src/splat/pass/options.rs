//! The arguments of a render, and the options that hold for many passes.

use crate::ffi::isa::Isa;
use crate::splat::types::{GaussianSlices, Settings, Skips, View};

/// Which kernels run, and which work they skip.
#[derive(Clone, Copy, Debug)]
pub struct PassOptions {
    pub isa: Isa,
    pub skips: Skips,
}

/// The arguments of a render.
#[derive(Clone, Copy)]
pub struct RenderRequest<'a, T> {
    pub gaussians: GaussianSlices<'a, T>,
    pub view: &'a View,
    pub settings: &'a Settings,
    /// Indices of the Gaussians that take part; `None` for all.
    pub active: Option<&'a [u32]>,
}
