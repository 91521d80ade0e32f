//! Compositing of one tile of exact discs, forward and backward: the plain twin of `cpp/splat/disc.cpp`; symbols as
//! in `disc.rs`, transmittance and `behind` as in `tile.rs`.
//!
//! With `v = alpha d loss / d alpha`, an intersected disc has the gradients `-v s / w` by `p = P.d`, `-v u / w` by
//! `q = Q.d` and `v (s^2 + u^2) / w` by `w = N.d`. Their sums over the pixels, multiplied by the ray (for `p` and `q`:
//! by its offset from the centre's ray, and separately by the rest), are all that the chain needs.

use std::f64::consts::LOG2_E;

use crate::ffi::splat::rasterize::Aligned;
use crate::splat::number::{Each, Real, dot};
use crate::splat::types::table::{
    ALPHA_MAX, ALPHA_MIN, DiscSums, PLANES, SPARED_LOG2_ALPHA, STOP, SplatRow, at, disc_sum,
};
use crate::splat::types::{PIXELS, Tiling, pixel_of};

use super::disc::{Disc, DiscOptics};
use super::fault::{Fault, Faults};
use super::tile::Parts;

/// The discs of one tile, front to back.
pub struct DiscTile<'a, T> {
    pub rows: &'a [Aligned<T>],
    pub discs: &'a [Aligned<T>],
    pub entries: &'a [u32],
    /// The tiling, and the number of the tile.
    pub tile: (Tiling, usize),
    pub optics: DiscOptics<'a, T>,
}

/// The intersection of a ray and a disc's plane, in standard deviations, with `1 / N.d`.
struct PlanePoint<T> {
    s: T,
    u: T,
    over: T,
}

/// The sample of a disc at a pixel.
pub struct DiscSample<T> {
    /// Offset of the pixel from the centre on screen.
    offset: [T; 2],
    /// Offset of the ray from that of the centre.
    tilt: [T; 3],
    /// `None` where the screen filter is larger.
    hit: Option<PlanePoint<T>>,
    raw: T,
    pub alpha: T,
    pub depth: T,
}

/// Samples the disc of `row` at the pixel `(x, y)` with ray `d`; `None` if alpha is below 1/255.
#[inline(always)]
pub fn evaluate_alpha<T: Real>(
    row: &SplatRow<T>,
    disc: &Disc<T>,
    optics: &DiscOptics<'_, T>,
    [x, y]: [usize; 2],
    d: [T; 3],
) -> Option<DiscSample<T>> {
    let offset = [T::of(x as f64 + 0.5) - row[at::X], T::of(y as f64 + 0.5) - row[at::Y]];
    let tilt = match optics.per_pixel {
        Some([fx, fy]) => [offset[0] * fx, offset[1] * fy, T::zero()],
        None => [d[0] - disc.slope[0] * d[2], d[1] - disc.slope[1] * d[2], T::zero()],
    };
    let over = T::one() / dot(disc.n, d);
    let (s, u) = (dot(disc.p, tilt) * over, dot(disc.q, tilt) * over);
    let (square, depth) = (s * s + u * u, disc.height * d[2] * over);
    let met = depth >= optics.near && square.is_finite();
    let filter = optics.filter.map(|inverse| (offset[0] * offset[0] + offset[1] * offset[1]) * inverse);
    let on_plane = met && filter.is_none_or(|f| square <= f);
    let distance = if on_plane { square } else { filter? };
    let exponent = row[at::LOG2_OPACITY] - T::of(0.5 * LOG2_E) * distance;
    if exponent < T::of(SPARED_LOG2_ALPHA) {
        return None;
    }
    let raw = exponent.exp2();
    let alpha = raw.minimum(T::of(ALPHA_MAX));
    (alpha >= T::of(ALPHA_MIN)).then(|| DiscSample {
        offset,
        tilt,
        hit: on_plane.then_some(PlanePoint { s, u, over }),
        raw,
        alpha,
        depth: if on_plane { depth } else { row[at::DEPTH] },
    })
}

impl<T: Real> DiscTile<'_, T> {
    /// Pixel `p` of the tile with its ray; `None` outside the image.
    fn pixel(&self, p: usize) -> Option<([usize; 2], [T; 3])> {
        let (tiling, t) = self.tile;
        let [x, y] = tiling.pixel(t, p, self.optics.size)?;
        Some(([x, y], self.optics.rays[y * self.optics.size[0] + x]))
    }

    /// Entries whose box meets the 4x4 pixels of a block.
    fn near(&self, block: usize, near: &mut Vec<usize>) {
        let (column, line) = pixel_of(16 * block);
        let (tiling, t) = self.tile;
        let corner = tiling.corner(t);
        let middle = [corner[0] + column, corner[1] + line].each(|v| T::of(v as f64 + 2.0));
        let half = T::of(1.5);
        let meets = |k: &usize| Disc::unpack(&self.discs[self.entries[*k] as usize]).bounds.holds(middle, half);
        near.clear();
        near.extend((0..self.entries.len()).filter(meets));
    }

    /// Calls `visit` with each disc of `near` that pixel `p` blends, front to back: number of the entry, row, sample,
    /// transmittance before and after. Stops when the pixel is full.
    fn blend(&self, p: usize, near: &[usize], mut visit: impl FnMut(usize, &SplatRow<T>, &DiscSample<T>, T, T)) {
        let Some((pixel, ray)) = self.pixel(p) else { return };
        let mut left = T::one();
        for &k in near {
            let entry = self.entries[k];
            let row = &self.rows[entry as usize].0;
            let Some(sample) =
                evaluate_alpha(row, &Disc::unpack(&self.discs[entry as usize]), &self.optics, pixel, ray)
            else {
                continue;
            };
            let next = left - sample.alpha * left;
            if next <= T::of(STOP) {
                break;
            }
            visit(k, row, &sample, left, next);
            left = next;
        }
    }

    /// Fills the state of the tile: sums of red, green, blue, depth, and the transmittance.
    pub fn forward(&self, state: &mut [T], with_depth: bool) {
        let mut near = Vec::with_capacity(self.entries.len());
        for p in 0..PIXELS {
            if p % 16 == 0 {
                self.near(p / 16, &mut near);
            }
            let mut sums = [T::zero(), T::zero(), T::zero(), T::zero(), T::one()];
            self.blend(p, &near, |_, row, sample, left, next| {
                let weight = sample.alpha * left;
                for k in 0..3 {
                    sums[k] += weight * row[at::RED + k];
                }
                if with_depth {
                    sums[3] += weight * sample.depth;
                }
                sums[4] = next;
            });
            (0..PLANES).for_each(|k| state[k * PIXELS + p] = sums[k]);
        }
    }

    /// Carries the gradient of the tile (`adjoint` as in `tile::BackwardTile`) to the sums of its entries.
    pub fn backward(&self, adjoint: &[T], parts: Parts, faults: impl Faults) -> Vec<DiscSums<T>> {
        let mut out = vec![[T::zero(); disc_sum::COUNT]; self.entries.len()];
        let mut near = Vec::with_capacity(self.entries.len());
        for p in 0..PIXELS {
            if p % 16 == 0 {
                self.near(p / 16, &mut near);
            }
            let Some((_, d)) = self.pixel(p) else { continue };
            let by = |k: usize| adjoint[k * PIXELS + p];
            let mut behind = by(4);
            self.blend(p, &near, |entry, row, sample, left, _| {
                let out = &mut out[entry];
                let weight = sample.alpha * left;
                if parts.color {
                    (0..3).for_each(|k| out[disc_sum::RED + k] += weight * by(k));
                }
                let by_depth = if parts.depth { weight * by(3) } else { T::zero() };
                if parts.depth {
                    sample.depth_pullback(by_depth, d, out);
                }
                if !parts.geometry {
                    return;
                }
                let mut value = row[at::RED] * by(0) + row[at::RED + 1] * by(1) + row[at::RED + 2] * by(2);
                if parts.depth {
                    value += sample.depth * by(3);
                }
                behind -= weight * value;
                if sample.raw <= T::of(ALPHA_MAX) {
                    let v = sample.alpha * (left * value - behind / (T::one() - sample.alpha));
                    sample.alpha_pullback(v, d, out, faults);
                }
            });
        }
        out
    }
}

impl<T: Real> DiscSample<T> {
    /// Gradient of the depth of the point.
    #[inline(always)]
    fn depth_pullback(&self, by_depth: T, d: [T; 3], out: &mut DiscSums<T>) {
        let Some(hit) = &self.hit else {
            out[disc_sum::DEPTH] += by_depth;
            return;
        };
        out[disc_sum::HEIGHT] += by_depth * d[2] * hit.over;
        let by_w = -(by_depth * self.depth * hit.over);
        (0..3).for_each(|k| out[disc_sum::N + k] += by_w * d[k]);
    }

    /// Gradient of the logarithm of alpha.
    #[inline(always)]
    fn alpha_pullback(&self, v: T, d: [T; 3], out: &mut DiscSums<T>, faults: impl Faults) {
        out[disc_sum::S] += v;
        let Some(hit) = &self.hit else {
            out[disc_sum::FILTER] += v * self.offset[0];
            out[disc_sum::FILTER + 1] += v * self.offset[1];
            return;
        };
        let scaled = v * hit.over;
        let (by_p, by_q) = (-(scaled * hit.s), -(scaled * hit.u));
        let by_w =
            if faults.has(Fault::PlaneTiltIgnored) { T::zero() } else { scaled * (hit.s * hit.s + hit.u * hit.u) };
        for k in 0..3 {
            out[disc_sum::P + k] += by_p * self.tilt[k];
            out[disc_sum::Q + k] += by_q * self.tilt[k];
            out[disc_sum::N + k] += by_w * d[k];
        }
        out[disc_sum::P_ALONG] += by_p * d[2];
        out[disc_sum::Q_ALONG] += by_q * d[2];
    }
}
