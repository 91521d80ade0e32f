//! Between the sums of tiles and images in rows: the plain twin of `cpp/splat/image.cpp`.
//!
//! `colour = gain (sum + T background)`, `depth = sum / alpha`, `alpha = 1 - T`, with `T` the transmittance; and
//! the backward pass.

use crate::ffi::splat::image::{ImageBand, ImageFormation};
use crate::splat::number::{Each, Real};
use crate::splat::types::table::PLANES;
use crate::splat::types::{ImageGradient, PIXELS, TILE_SIDE, Tiling, index_of};

use super::fault::{Fault, Faults};

/// Sums of a row of tiles to the lines of images of `width` pixels; no depth is written if its slice is empty.
pub fn develop<T: Real>(tiles: &[T], width: usize, formation: &ImageFormation, band: ImageBand<'_, T>) {
    let (gain, background) = (formation.gain.each(T::of), formation.background.each(T::of));
    let pixels = band.color.as_chunks_mut::<3>().0.iter_mut().zip(band.alpha);
    for (at, (color, alpha)) in pixels.enumerate() {
        let (line, column) = (at / width, at % width);
        let tile = &tiles[column / TILE_SIDE * PLANES * PIXELS..][..PLANES * PIXELS];
        let p = index_of(column % TILE_SIDE, line);
        let left = tile[4 * PIXELS + p];
        *color = [0, 1, 2].each(|k| gain[k] * (tile[k * PIXELS + p] + left * background[k]));
        *alpha = T::one() - left;
        if let Some(depth) = band.depth.get_mut(at) {
            let shown = formation.with_depth && *alpha > T::zero();
            *depth = if shown { tile[3 * PIXELS + p] / *alpha } else { T::zero() };
        }
    }
}

/// Gradients of the tile's sums, and the loss that lies behind each pixel's first splat; returns the tile's part of the
/// gradient of the gain.
pub fn adjoint<T: Real>(
    state: &[T],
    (tiling, t): (Tiling, usize),
    size: [usize; 2],
    formation: &ImageFormation,
    image: &ImageGradient<'_, T>,
    adjoint: &mut [T],
    faults: impl Faults,
) -> [f64; 3] {
    let (gain, background) = (formation.gain.each(T::of), formation.background.each(T::of));
    let mut by_gain = [0.0; 3];
    for p in 0..PIXELS {
        let Some([x, y]) = tiling.pixel(t, p, size) else { continue };
        let o = y * size[0] + x;
        let left = state[4 * PIXELS + p];
        let mut behind = T::zero();
        // The remaining transmittance falls on the background.
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
        if formation.with_depth && covered > T::zero() {
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
