//! What a pass leaves out, as switches: everything, unless somebody wants to know what it saves.

use crate::splat::number::real::Real;
use crate::splat::pass::rasterizer::Rasterizer;

/// A set of things left out because they cannot be seen. `respire-bench pareto splat` switches them off one at a time; the
/// kernels have no branch for them in their loops over pixels. Exact discs have none of these switches.
///
/// What else costs nothing when nobody asks has settings of its own: groups of gradients ([`crate::splat::Wanted`]), inactive
/// Gaussians (`active`), lists that are kept ([`crate::splat::Reuse`]), depth ([`crate::splat::DepthOutput`]).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Skips(u8);

impl Skips {
    /// Extents end where a splat's alpha falls below 1/255; without, where that of an opaque one would (3.33 standard
    /// deviations). The image is the same.
    pub const EXTENTS: Skips = Skips(1);
    /// Of each splat in a tile, only the 4x4 blocks that its ellipse can touch are looked at; without, all of the tile. The
    /// image is the same.
    pub const BLOCKS: Skips = Skips(2);
    /// Groups of Gaussians beside the image are left before their covariance is known (vectorised projection). The image is
    /// the same.
    pub const BESIDE: Skips = Skips(4);
    /// A pixel stops when no more than 1e-4 of the light is left; without, it meets all its splats. The image changes by
    /// as much.
    pub const STOP: Skips = Skips(8);
    /// All of them: the default.
    pub const ALL: Skips = Skips(15);

    /// These without `others`.
    pub fn without(self, others: Skips) -> Skips {
        Skips(self.0 & !others.0)
    }

    /// True when any of `others` is among these.
    pub fn any(self, others: Skips) -> bool {
        self.0 & others.0 != 0
    }
}

impl Default for Skips {
    fn default() -> Self {
        Skips::ALL
    }
}

impl<T: Real> Rasterizer<T> {
    /// What later passes leave out; [`Skips::ALL`] unless told.
    pub fn skips(&mut self, skips: Skips) {
        self.skips = skips;
        self.kept = None;
        self.last = None;
    }
}
