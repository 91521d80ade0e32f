//! The tiles of a pass: composites them, develops their sums into images, and carries image gradients back to the
//! moments of every entry. A tile is one task.

use rayon::prelude::*;

use crate::ffi::splat::image::{ImageBand, Light};
use crate::ffi::splat::rasterize::Aligned;
use crate::ffi::system::grow;

use crate::splat::number::real::Real;
use crate::splat::pass::bins::cut;
use crate::splat::pass::pool::{PIECE, TILES};
use crate::splat::pass::rasterizer::Rasterizer;
use crate::splat::plain::disc_tile::{DiscTile, Sums};
use crate::splat::plain::fault::{Fault, Faults};
use crate::splat::plain::tile::{
    self as kernel, Adjoint, BackwardTile, ForwardTile, MOVING, PIXELS, PLANES, Parts, index_of,
};
use crate::splat::types::scene::{DepthOutput, Footprint, ImageGradient, Settings, View};
use crate::splat::types::skips::Skips;
use crate::splat::types::tiling::{TILE_SIDE, Tiling};

impl<T: Real> Rasterizer<T> {
    /// Composites all tiles; with velocities (`directions` of them, one row per splat, direction by direction) the
    /// motion of every pixel too. `false` when there is no kernel for velocities.
    pub(in crate::splat) fn composite(&mut self, depth: DepthOutput, velocities: &[[T; 8]], directions: usize) -> bool {
        let bins = &mut self.bins;
        let tiling = bins.tiling;
        if !self.skips.any(Skips::BLOCKS) {
            // All blocks of the tile, as if the kernel had found them.
            bins.masks.fill(kernel::ALL_BLOCKS);
            bins.masks_known = true;
        }
        let tiles = tiling.count();
        grow(&mut self.state, tiles * PLANES * PIXELS);
        grow(&mut self.moving, tiles * directions * MOVING * PIXELS);
        let sizes = bins.offsets.windows(2).map(|w| (w[1] - w[0]) as usize);
        let masks = cut(&mut bins.masks, sizes);
        let moving = cut(&mut self.moving, (0..tiles).map(|_| directions * MOVING * PIXELS));
        let (offsets, entries) = (&bins.offsets, &bins.entries);
        let (rows, isa) = (&self.rows, self.isa);
        let depth = depth == DepthOutput::Expected;
        let endless = !self.skips.any(Skips::STOP);
        let parts = Parts { geometry: false, color: true, depth, known: bins.masks_known, endless };
        bins.masks_known = true;
        let tiles = masks
            .into_par_iter()
            .zip(self.state.par_chunks_mut(PLANES * PIXELS))
            .zip(moving)
            .enumerate()
            .with_max_len(TILES);
        tiles
            .map(|(t, ((masks, state), moving))| {
                let mut tile = ForwardTile {
                    rows,
                    entries: &entries[offsets[t] as usize..offsets[t + 1] as usize],
                    masks,
                    corner: tiling.corner(t),
                    state,
                    parts,
                };
                if directions > 0 {
                    return T::forward_moving(isa, &mut tile, velocities, moving);
                }
                if !T::forward_tile(isa, &mut tile) {
                    kernel::scalar_forward(&mut tile);
                }
                true
            })
            .reduce(|| true, |a, b| a && b)
    }

    /// From the tiles' sums to images in rows: background, gain, depth by alpha.
    pub(in crate::splat) fn develop(&mut self, view: &View, settings: &Settings) {
        let (width, height) = (view.camera.width as usize, view.camera.height as usize);
        let out = &mut self.rendered;
        (out.width, out.height) = (width, height);
        out.color.resize(width * height * 3, T::zero());
        // What nobody asks for stays as it is once it is 0.
        let depth_stays =
            settings.depth == DepthOutput::Skip && self.depth_is_zero && out.depth.len() == width * height;
        out.depth.resize(width * height, T::zero());
        out.alpha.resize(width * height, T::zero());
        let (state, tiling) = (&self.state, self.bins.tiling);
        let (tiles_x, side) = (tiling.columns, TILE_SIDE);
        let gain = settings.gain.map(T::of);
        let background = settings.background.map(T::of);
        let with_depth = has_depth(settings);
        let light = Light { gain: settings.gain, background: settings.background, with_depth };
        let band = side * width;
        let depth = if depth_stays { &mut [][..] } else { &mut out.depth[..] };
        let depths = cut(depth, out.alpha.chunks(band).map(|alpha| if depth_stays { 0 } else { alpha.len() }));
        let bands = out.color.par_chunks_mut(3 * band).zip(depths);
        bands.zip(out.alpha.par_chunks_mut(band)).enumerate().with_max_len(PIECE).for_each(
            |(tile_y, ((color, depth), alpha))| {
                let row = &state[tile_y * tiles_x * PLANES * PIXELS..][..tiles_x * PLANES * PIXELS];
                if T::develop_band(
                    row,
                    [width, side],
                    &light,
                    ImageBand { color: &mut *color, depth: &mut *depth, alpha: &mut *alpha },
                ) {
                    return;
                }
                let mut none = vec![T::zero(); if depth_stays { alpha.len() } else { 0 }];
                let depth = if depth_stays { &mut none[..] } else { depth };
                let lines = color.chunks_mut(3 * width).zip(depth.chunks_mut(width)).zip(alpha.chunks_mut(width));
                for (line, ((color, depth), alpha)) in lines.enumerate() {
                    let pieces = color.chunks_mut(12).zip(depth.chunks_mut(4)).zip(alpha.chunks_mut(4)).enumerate();
                    for (piece, ((color, depth), alpha)) in pieces {
                        let tile = &row[4 * piece / side * PLANES * PIXELS..][..PLANES * PIXELS];
                        let p = index_of(4 * piece % side, line);
                        let plane = |k: usize| &tile[k * PIXELS + p..][..4];
                        let (sums, left) = ([plane(0), plane(1), plane(2)], plane(4));
                        for (i, pixel) in color.as_chunks_mut::<3>().0.iter_mut().enumerate() {
                            *pixel = [0, 1, 2].map(|k| gain[k] * (sums[k][i] + left[i] * background[k]));
                        }
                        for (i, covered) in alpha.iter_mut().enumerate() {
                            *covered = T::one() - left[i];
                        }
                        for (i, depth) in depth.iter_mut().enumerate() {
                            let shown = with_depth && alpha[i] > T::zero();
                            *depth = if shown { plane(3)[i] / alpha[i] } else { T::zero() };
                        }
                    }
                }
            },
        );
        self.depth_is_zero = !with_depth;
    }

    /// Composites all tiles of exact discs.
    pub(in crate::splat) fn composite_discs(&mut self, view: &View, settings: &Settings) {
        let tiles = self.bins.tiling.count();
        let mut state = std::mem::take(&mut self.state);
        grow(&mut state, tiles * PLANES * PIXELS);
        let optics = self.optics(view, settings);
        let bins = &self.bins;
        state.par_chunks_mut(PLANES * PIXELS).take(tiles).enumerate().with_max_len(TILES).for_each(|(t, state)| {
            let range = bins.offsets[t] as usize..bins.offsets[t + 1] as usize;
            let tile = DiscTile {
                rows: &self.rows,
                discs: &self.discs,
                entries: &bins.entries[range],
                tile: (bins.tiling, t),
                optics,
            };
            if !T::disc_forward(self.isa, &tile, has_depth(settings), state) {
                tile.forward(state, has_depth(settings));
            }
        });
        self.state = state;
    }

    /// Moments of every entry, and the gradient of the gain. Where no `parts` are wanted, the gain alone.
    /// `false` where the gradient of a colour may not be finite.
    pub(in crate::splat) fn composite_backward(
        &mut self,
        image: &ImageGradient<'_, T>,
        view: &View,
        settings: &Settings,
        parts: Option<Parts>,
        with_gain: bool,
        faults: impl Faults,
    ) -> bool {
        let discs = settings.footprint == Footprint::Disc;
        let entries = if parts.is_some() { self.bins.entries.len() } else { 0 };
        if !discs && self.slots.len() < entries {
            grow(&mut self.slots, entries);
        }
        if discs && self.disc_slots.len() < entries {
            grow(&mut self.disc_slots, entries);
        }
        let mut slots = std::mem::take(&mut self.slots);
        let shared = if faults.is_sound() { T::shared(self.isa, &mut slots) } else { None };
        let optics = self.optics(view, settings);
        let (bins, rows, isa, states) = (&self.bins, &self.rows, self.isa, &self.state);
        let image_size = [self.rendered.width, self.rendered.height];
        let light = Light { gain: settings.gain, background: settings.background, with_depth: !image.depth.is_empty() };
        let tiles =
            states[..bins.tiling.count() * PLANES * PIXELS].par_chunks(PLANES * PIXELS).enumerate().with_max_len(TILES);
        let done: Vec<TileSums<T>> = tiles
            .map(|(t, state)| {
                let place = (bins.tiling, t);
                let corner = bins.tiling.corner(t);
                let Adjoint(adjoint) = &mut Adjoint([T::zero(); PLANES * PIXELS]);
                let by_gain = T::adjoint_tile(state, place, image_size, &light, image, adjoint)
                    .unwrap_or_else(|| adjoint_of_tile(state, place, image_size, &light, image, adjoint, faults));
                let none = (by_gain, Vec::new(), Vec::new());
                let Some(parts) = parts else { return none };
                let range = bins.offsets[t] as usize..bins.offsets[t + 1] as usize;
                if discs {
                    let entries = &bins.entries[range];
                    let tile = DiscTile { rows, discs: &self.discs, entries, tile: place, optics };
                    let sums = faults.is_sound().then(|| T::disc_backward(isa, &tile, adjoint, parts)).flatten();
                    return (by_gain, Vec::new(), sums.unwrap_or_else(|| tile.backward(adjoint, parts, faults)));
                }
                let tile = BackwardTile {
                    rows,
                    entries: &bins.entries[range.clone()],
                    masks: &bins.masks[range.clone()],
                    targets: &bins.targets[range],
                    corner,
                    adjoint,
                    parts,
                };
                match &shared {
                    Some(slots) => {
                        T::backward_tile(isa, &tile, slots);
                        none
                    }
                    None => (by_gain, kernel::scalar_backward(&tile, faults), Vec::new()),
                }
            })
            .collect();
        self.slots = slots;
        // The sums of what shows a pixel times its gradient are finite only if all gradients are.
        let finite = done.iter().all(|(by_gain, ..)| by_gain.iter().all(|v| v.is_finite()));
        self.gradients.gain = [0.0; 3];
        for (t, (by_gain, moments, sums)) in done.into_iter().enumerate() {
            for k in (0..3).filter(|_| with_gain) {
                self.gradients.gain[k] += by_gain[k];
            }
            let targets = &self.bins.targets[self.bins.offsets[t] as usize..];
            for (&target, moments) in targets.iter().zip(moments) {
                self.slots[target as usize] = moments;
            }
            for (&target, sums) in targets.iter().zip(sums) {
                self.disc_slots[target as usize] = sums;
            }
        }
        finite
    }
}

/// What the backward pass of one tile gives: gradient of the gain, and where no slots are shared the moments or the sums
/// of its entries.
type TileSums<T> = ([f64; 3], Vec<Aligned<T>>, Vec<Sums<T>>);

/// Whether the depth is composited with the colours.
pub(in crate::splat) fn has_depth(settings: &Settings) -> bool {
    match settings.footprint {
        Footprint::Ewa => settings.depth == DepthOutput::Expected,
        Footprint::Disc => matches!(settings.depth, DepthOutput::Expected | DepthOutput::Surface),
    }
}

/// Gradients of the tile's sums, and the loss that lies behind each pixel's first splat; returns the tile's part of the
/// gradient of the gain.
fn adjoint_of_tile<T: Real>(
    state: &[T],
    (tiling, t): (Tiling, usize),
    size: [usize; 2],
    light: &Light,
    image: &ImageGradient<'_, T>,
    adjoint: &mut [T],
    faults: impl Faults,
) -> [f64; 3] {
    let (gain, background) = (light.gain.map(T::of), light.background.map(T::of));
    let mut by_gain = [0.0; 3];
    for p in 0..PIXELS {
        let Some([x, y]) = tiling.pixel(t, p, size) else { continue };
        let o = y * size[0] + x;
        let left = state[4 * PIXELS + p];
        let mut behind = T::zero();
        // The background is what the light that is left falls on.
        let mut by_left = -image.alpha.get(o).copied().unwrap_or_default();
        for k in 0..3 {
            let v = image.color.get(3 * o + k).copied().unwrap_or_default();
            let plain = state[k * PIXELS + p];
            by_gain[k] += (v * (plain + left * background[k])).to_f64();
            adjoint[k * PIXELS + p] = v * gain[k];
            behind += v * gain[k] * plain;
            by_left += v * gain[k] * background[k];
        }
        let covered = T::one() - left;
        if light.with_depth && covered > T::zero() {
            let by_depth = image.depth[o] / covered;
            adjoint[3 * PIXELS + p] = by_depth;
            behind += by_depth * state[3 * PIXELS + p];
            if !faults.has(Fault::DepthQuotientForgotten) {
                by_left += by_depth * state[3 * PIXELS + p] / covered;
            }
        }
        adjoint[4 * PIXELS + p] = behind + left * by_left;
    }
    by_gain
}
