//! The tiles of a forward pass: composites the lists of all tiles into sums per pixel. A tile is one task. What
//! happens at a pixel is in `plain/tile.rs` and `plain/disc_tile.rs`.

use rayon::prelude::*;

use crate::ffi::splat::image::ImageFormation;
use crate::ffi::system::grow;
use crate::splat::kernels::{SplatKernels, VelocityKernels};
use crate::splat::plain::disc::DiscOptics;
use crate::splat::plain::disc_tile::DiscTile;
use crate::splat::plain::tile::{ForwardTile, Parts};
use crate::splat::types::table::{ALL_BLOCKS, PLANES, VELOCITY_PLANES};
use crate::splat::types::{PIXELS, Settings, Skips};

use super::bins::Bins;
use super::options::PassOptions;
use super::pool::{TILES, cut};
use super::splats::Splats;

/// Inputs that all tiles of a pass share.
#[derive(Clone, Copy)]
pub struct TilePass<'a, T> {
    pub options: PassOptions,
    pub settings: Settings,
    /// Width and height of the image in pixels.
    pub size: [usize; 2],
    /// With `Footprint::Disc`, the rays.
    pub optics: Option<DiscOptics<'a, T>>,
}

/// Velocities of all splats along some directions, and the kernels for them.
pub struct MovingSplats<'a, T> {
    pub kernels: &'a VelocityKernels<T>,
    /// One row per splat, direction by direction.
    pub velocities: &'a [[T; 8]],
    pub directions: usize,
}

/// Gain and background of the pixels.
pub fn image_formation(settings: &Settings, with_depth: bool) -> ImageFormation {
    ImageFormation { gain: settings.gain, background: settings.background, with_depth }
}

impl<T: SplatKernels> TilePass<'_, T> {
    /// Composites all tiles into `state`, `PLANES` planes of `PIXELS` each.
    pub fn forward(&self, splats: &Splats<T>, bins: &mut Bins, with_depth: bool, state: &mut Vec<T>) {
        let (isa, tiles) = (self.options.isa, bins.tiling.count());
        grow(state, tiles * PLANES * PIXELS);
        let Some(optics) = self.optics else {
            let tiles = self.tiles(splats, bins, with_depth, state).with_max_len(TILES);
            return tiles.for_each(|mut tile| T::forward_tile(isa, &mut tile));
        };
        let bins = &*bins;
        state.par_chunks_mut(PLANES * PIXELS).take(tiles).enumerate().with_max_len(TILES).for_each(|(t, state)| {
            let entries = &bins.entries[bins.span(t)];
            let tile = DiscTile { rows: &splats.rows, discs: &splats.discs, entries, tile: (bins.tiling, t), optics };
            T::disc_forward(isa, &tile, with_depth, state);
        });
    }

    /// Composites all tiles without depth, and the velocities of their pixels into `moved`: `VELOCITY_PLANES` planes
    /// per tile and direction.
    pub fn forward_moving(
        &self,
        splats: &Splats<T>,
        bins: &mut Bins,
        moving: &MovingSplats<'_, T>,
        state: &mut Vec<T>,
        moved: &mut Vec<T>,
    ) {
        let (isa, tiles) = (self.options.isa, bins.tiling.count());
        let per_tile = moving.directions * VELOCITY_PLANES * PIXELS;
        grow(state, tiles * PLANES * PIXELS);
        grow(moved, tiles * per_tile);
        let tiles = self.tiles(splats, bins, false, state).zip(moved.par_chunks_mut(per_tile)).with_max_len(TILES);
        tiles.for_each(|(mut tile, moved)| (moving.kernels.forward)(isa, &mut tile, moving.velocities, moved));
    }

    /// The tiles of an affine projection; their masks are known from now on.
    fn tiles<'b>(
        &self,
        splats: &'b Splats<T>,
        bins: &'b mut Bins,
        depth: bool,
        state: &'b mut [T],
    ) -> impl IndexedParallelIterator<Item = ForwardTile<'b, T>> + use<'b, T> {
        if !self.options.skips.any(Skips::BLOCKS) {
            // All blocks of the tile, as if the kernel had found them.
            bins.masks.fill(ALL_BLOCKS);
            bins.masks_known = true;
        }
        let endless = !self.options.skips.any(Skips::STOP);
        let parts = Parts { geometry: false, color: true, depth, known: bins.masks_known, endless };
        bins.masks_known = true;
        let (tiling, offsets, entries) = (bins.tiling, &bins.offsets, &bins.entries);
        let masks = cut(&mut bins.masks, offsets.windows(2).map(|w| (w[1] - w[0]) as usize));
        masks.into_par_iter().zip(state.par_chunks_mut(PLANES * PIXELS)).enumerate().map(move |(t, (masks, state))| {
            ForwardTile {
                rows: &splats.rows,
                entries: &entries[offsets[t] as usize..offsets[t + 1] as usize],
                masks,
                corner: tiling.corner(t),
                state,
                parts,
            }
        })
    }
}
