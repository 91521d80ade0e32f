//! The tiles of a pass: composites them, develops their sums into images, and carries image gradients back to the
//! moments of every entry. A tile is one task.

use rayon::prelude::*;

use crate::ffi::splat::Aligned;

use super::bin::{TILE, cut};
use super::kernel::{self, BackwardTile, ForwardTile, MOVING, PIXELS, PLANES, Parts, index_of};
use super::rasterizer::Rasterizer;
use super::real::Real;
use super::types::{DepthOutput, ImageGradient, Settings, View, Wanted};

/// Pixels of line `line` of a tile in the per-pixel tables: four pieces of four.
fn line_of(line: usize) -> [usize; 4] {
    [0, 4, 8, 12].map(|column| index_of(column, line))
}

impl<T: Real> Rasterizer<T> {
    /// Composites all tiles; with velocities (`directions` of them, one row per splat, direction by direction) the
    /// motion of every pixel too. `false` when there is no kernel for velocities.
    pub(super) fn composite(&mut self, depth: DepthOutput, velocities: &[[T; 8]], directions: usize) -> bool {
        let bins = &mut self.bins;
        let tiles = bins.tiles_x * bins.tiles_y;
        self.state.resize(tiles * PLANES * PIXELS, T::zero());
        self.moving.resize(tiles * directions * MOVING * PIXELS, T::zero());
        let sizes = bins.offsets.windows(2).map(|w| (w[1] - w[0]) as usize);
        let masks = cut(&mut bins.masks, sizes);
        let moving = cut(&mut self.moving, (0..tiles).map(|_| directions * MOVING * PIXELS));
        let (offsets, entries, tiles_x) = (&bins.offsets, &bins.entries, bins.tiles_x);
        let (rows, isa) = (&self.rows, self.isa);
        let parts = Parts { geometry: false, color: true, depth: depth == DepthOutput::Expected };
        let tiles = masks.into_par_iter().zip(self.state.par_chunks_mut(PLANES * PIXELS)).zip(moving).enumerate();
        tiles
            .map(|(t, ((masks, state), moving))| {
                let mut tile = ForwardTile {
                    rows,
                    entries: &entries[offsets[t] as usize..offsets[t + 1] as usize],
                    masks,
                    corner: [t % tiles_x * TILE, t / tiles_x * TILE],
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
    pub(super) fn develop(&mut self, view: &View, settings: &Settings) {
        let (width, height) = (view.camera.width as usize, view.camera.height as usize);
        let out = &mut self.rendered;
        (out.width, out.height) = (width, height);
        out.color.resize(width * height * 3, T::zero());
        out.depth.resize(width * height, T::zero());
        out.alpha.resize(width * height, T::zero());
        let (state, tiles_x) = (&self.state, self.bins.tiles_x);
        let gain = settings.gain.map(T::of);
        let background = settings.background.map(T::of);
        let with_depth = settings.depth == DepthOutput::Expected;
        let band = TILE * width;
        let bands = out.color.par_chunks_mut(3 * band).zip(out.depth.par_chunks_mut(band));
        bands.zip(out.alpha.par_chunks_mut(band)).enumerate().for_each(|(tile_y, ((color, depth), alpha))| {
            let row = &state[tile_y * tiles_x * PLANES * PIXELS..][..tiles_x * PLANES * PIXELS];
            let lines = color.chunks_mut(3 * width).zip(depth.chunks_mut(width)).zip(alpha.chunks_mut(width));
            for (line, ((color, depth), alpha)) in lines.enumerate() {
                let pieces = color.chunks_mut(12).zip(depth.chunks_mut(4)).zip(alpha.chunks_mut(4)).enumerate();
                for (piece, ((color, depth), alpha)) in pieces {
                    let tile = &row[piece / 4 * PLANES * PIXELS..][..PLANES * PIXELS];
                    let p = line_of(line)[piece % 4];
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
        });
    }

    /// Gradients of the tiles' sums, and the loss that lies behind each pixel's first splat; the gain on the way.
    pub(super) fn adjoint_of_tiles(&mut self, image: &ImageGradient<'_, T>, settings: &Settings, wanted: Wanted) {
        let (width, height) = (self.rendered.width, self.rendered.height);
        self.adjoint.resize(self.state.len(), T::zero());
        let gain = settings.gain.map(T::of);
        let background = settings.background.map(T::of);
        let tiles_x = self.bins.tiles_x;
        let with_gain = wanted.any(Wanted::GAIN);
        let tiles = self.adjoint.par_chunks_mut(PLANES * PIXELS).zip(self.state.par_chunks(PLANES * PIXELS));
        let gains: Vec<[f64; 3]> = tiles
            .enumerate()
            .map(|(t, (adjoint, state))| {
                let mut by_gain = [0.0; 3];
                for line in 0..TILE {
                    let y = t / tiles_x * TILE + line;
                    for (piece, p) in line_of(line).into_iter().enumerate() {
                        let x = t % tiles_x * TILE + 4 * piece;
                        let count = if y < height { width.saturating_sub(x).min(4) } else { 0 };
                        let o = y * width + x;
                        let part = |plane: &'_ [T], each: usize| {
                            let mut out = [T::zero(); 12];
                            if let Some(found) = plane.get(each * o..each * (o + count)) {
                                out[..each * count].copy_from_slice(found);
                            }
                            out
                        };
                        let color = part(image.color, 3);
                        let (depth, alpha) = (part(image.depth, 1), part(image.alpha, 1));
                        for i in 0..4 {
                            let left = state[4 * PIXELS + p + i];
                            let mut behind = T::zero();
                            // The background is what the light that is left falls on.
                            let mut by_left = -alpha[i];
                            for k in 0..3 {
                                let v = color[3 * i + k] * gain[k];
                                let plain = state[k * PIXELS + p + i];
                                if with_gain {
                                    by_gain[k] += (color[3 * i + k] * (plain + left * background[k])).to_f64();
                                }
                                adjoint[k * PIXELS + p + i] = v;
                                behind += v * plain;
                                by_left += v * background[k];
                            }
                            let covered = T::one() - left;
                            let mut by_depth = T::zero();
                            if !image.depth.is_empty() && covered > T::zero() {
                                by_depth = depth[i] / covered;
                                behind += by_depth * state[3 * PIXELS + p + i];
                                by_left += by_depth * state[3 * PIXELS + p + i] / covered;
                            }
                            adjoint[3 * PIXELS + p + i] = by_depth;
                            adjoint[4 * PIXELS + p + i] = behind + left * by_left;
                        }
                    }
                }
                by_gain
            })
            .collect();
        self.gradients.gain = [0.0; 3];
        for tile in gains {
            for k in 0..3 {
                self.gradients.gain[k] += tile[k];
            }
        }
    }

    /// Moments of every entry.
    pub(super) fn composite_backward(&mut self, parts: Parts) {
        let bins = &self.bins;
        if self.slots.len() < bins.entries.len() {
            self.slots.resize(bins.entries.len(), Aligned::default());
        }
        let sizes = bins.offsets.windows(2).map(|w| (w[1] - w[0]) as usize);
        let slots = cut(&mut self.slots, sizes);
        let (rows, isa) = (&self.rows, self.isa);
        slots.into_par_iter().zip(self.adjoint.par_chunks(PLANES * PIXELS)).enumerate().for_each(
            |(t, (slots, adjoint))| {
                let range = bins.offsets[t] as usize..bins.offsets[t + 1] as usize;
                let mut tile = BackwardTile {
                    rows,
                    entries: &bins.entries[range.clone()],
                    masks: &bins.masks[range],
                    corner: [t % bins.tiles_x * TILE, t / bins.tiles_x * TILE],
                    adjoint,
                    slots,
                    parts,
                };
                if !T::backward_tile(isa, &mut tile) {
                    kernel::scalar_backward(&mut tile);
                }
            },
        );
    }
}
