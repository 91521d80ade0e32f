//! The tiles of a backward pass: image gradients through the tiles to the moments of every entry. A tile is one task,
//! and sums are added in the order of the tiles.

use rayon::prelude::*;

use crate::base::Result;
use crate::base::estimate::demand_memory;
use crate::ffi::splat::rasterize::Aligned;
use crate::ffi::system::grow;
use crate::splat::kernels::SplatKernels;
use crate::splat::plain::disc_tile::DiscTile;
use crate::splat::plain::fault::Faults;
use crate::splat::plain::tile::{Adjoint, BackwardTile, Parts};
use crate::splat::types::table::{DiscSums, PLANES};
use crate::splat::types::{ImageGradient, PIXELS};

use super::bins::Bins;
use super::forward::{TilePass, image_formation};
use super::pool::TILES;
use super::splats::Splats;

/// The output of the tiles for the chain: a slot for every entry of the bins.
#[derive(Debug, Default)]
pub struct Moments<T> {
    /// With `Footprint::Ewa`.
    pub splats: Vec<Aligned<T>>,
    /// Of each of these, whether the last pass wrote it: most entries of a scene of many layers lie behind others, and
    /// to write zeros for them would cost more than all else that a pass does with them.
    pub live: Vec<bool>,
    /// With `Footprint::Disc`.
    pub discs: Vec<DiscSums<T>>,
}

impl<T: SplatKernels> Moments<T> {
    /// Refuses a backward pass over lists of `entries` for whose moments this machine has no memory left.
    pub fn demand(&self, entries: usize, exact_discs: bool) -> Result<()> {
        let (there, bytes) = match exact_discs {
            true => (self.discs.capacity(), size_of::<DiscSums<T>>()),
            false => (self.splats.capacity(), size_of::<Aligned<T>>()),
        };
        let new_bytes = entries.saturating_sub(there) as f64 * bytes as f64;
        demand_memory(format_args!("the gradients of {entries} tile entries"), new_bytes)
    }
}

/// The gradient to propagate.
pub struct TileGradient<'a, T> {
    pub image: &'a ImageGradient<'a, T>,
    /// Which moments are wanted; `None` computes the gradient of the gain only.
    pub parts: Option<Parts>,
}

/// Gradient of the gain and, if no slots are shared, the moments or the sums of the entries of a tile.
type TileResult<T> = ([f64; 3], Vec<Aligned<T>>, Vec<DiscSums<T>>);

impl<T: SplatKernels> TilePass<'_, T> {
    /// Fills the moments of every entry and returns the gradient of the gain, which is not finite if that of a colour
    /// is not.
    pub fn backward(
        &self,
        splats: &Splats<T>,
        bins: &Bins,
        state: &[T],
        gradient: &TileGradient<'_, T>,
        moments: &mut Moments<T>,
        faults: impl Faults,
    ) -> [f64; 3] {
        let isa = self.options.isa;
        let entries = if gradient.parts.is_some() { bins.entries.len() } else { 0 };
        if self.optics.is_none() && moments.splats.len() < entries {
            grow(&mut moments.splats, entries);
        }
        moments.live.clear();
        moments.live.resize(if self.optics.is_none() { entries } else { 0 }, false);
        if self.optics.is_some() && moments.discs.len() < entries {
            grow(&mut moments.discs, entries);
        }
        let shared =
            if faults.is_sound() { T::shared_slots(isa, &mut moments.splats, &mut moments.live) } else { None };
        let formation = image_formation(&self.settings, !gradient.image.depth.is_empty());
        let tile_result = |(t, state): (usize, &[T])| -> TileResult<T> {
            let place = (bins.tiling, t);
            // The adjoint of the sums of the tile.
            let Adjoint(adjoint) = &mut Adjoint([T::zero(); PLANES * PIXELS]);
            let by_gain = T::adjoint(state, place, self.size, &formation, gradient.image, adjoint, faults);
            let Some(parts) = gradient.parts else { return (by_gain, Vec::new(), Vec::new()) };
            // From the adjoint to the moments of its entries.
            let (span, rows) = (bins.span(t), &splats.rows);
            let entries = &bins.entries[span.clone()];
            if let Some(optics) = self.optics {
                let tile = DiscTile { rows, discs: &splats.discs, entries, tile: place, optics };
                return (by_gain, Vec::new(), T::disc_backward(isa, &tile, adjoint, parts, faults));
            }
            let (masks, targets) = (&bins.masks[span.clone()], &bins.targets[span]);
            let tile = BackwardTile { rows, entries, masks, targets, corner: bins.tiling.corner(t), adjoint, parts };
            (by_gain, T::backward_tile(isa, &tile, shared.as_ref(), faults), Vec::new())
        };
        let states = state[..bins.tiling.count() * PLANES * PIXELS].par_chunks(PLANES * PIXELS);
        let done: Vec<TileResult<T>> = states.enumerate().with_max_len(TILES).map(tile_result).collect();
        let mut total = [0.0; 3];
        for (t, (by_gain, of_splats, of_discs)) in done.into_iter().enumerate() {
            (0..3).for_each(|k| total[k] += by_gain[k]);
            let targets = &bins.targets[bins.offsets[t] as usize..];
            for (&target, moments_of_entry) in targets.iter().zip(of_splats) {
                moments.splats[target as usize] = moments_of_entry;
                moments.live[target as usize] = true;
            }
            for (&target, sums) in targets.iter().zip(of_discs) {
                moments.discs[target as usize] = sums;
            }
        }
        total
    }
}
