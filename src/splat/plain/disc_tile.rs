//! Compositing of one tile of exact discs, forward and backward: the plain twin of `cpp/splat/disc.cpp`; symbols as in `disc_mode.rs`, transmittance and the
//! bookkeeping of what lies behind as in `kernel.rs`.
//!
//! Of `v = alpha d loss / d alpha` a disc that is met gets `-v s / w` for `p = P.d`, `-v u / w` for `q = Q.d` and
//! `v (s^2 + u^2) / w` for `w = N.d`; summed with the ray (for `p`, `q`: with its offset from the centre's ray, and the
//! rest apart), they are all that the chain needs.

use std::f64::consts::LOG2_E;

use crate::ffi::splat::rasterize::{self as native, Aligned, SplatDiscs};
use crate::splat::number::real::Real;
use crate::splat::plain::disc::{Disc, Optics};
use crate::splat::plain::fault::{Fault, Faults};
use crate::splat::plain::project::{Row, at, dot};
use crate::splat::plain::tile::{self as kernel, PIXELS, PLANES, Parts, pixel_of};
use crate::splat::types::tiling::Tiling;

/// Columns of the sums of one entry.
pub(in crate::splat) mod sum {
    pub const S: usize = 0;
    pub const RED: usize = 1;
    /// Of the screen filter: `v dx`, `v dy`.
    pub const FILTER: usize = 4;
    /// Depth of the centre.
    pub const DEPTH: usize = 6;
    /// `N.t`.
    pub const HEIGHT: usize = 7;
    /// Of `P.d`, `Q.d` with the offset of the ray, and with `d_z`.
    pub const P: usize = 8;
    pub const Q: usize = 11;
    pub const P_ALONG: usize = 14;
    pub const Q_ALONG: usize = 15;
    /// Of `N.d` with the ray.
    pub const N: usize = 16;
    pub const COUNT: usize = 19;
}

/// The sums of one entry.
pub type Sums<T> = [T; sum::COUNT];

/// The discs of one tile, front to back.
pub struct DiscTile<'a, T> {
    pub rows: &'a [Aligned<T>],
    pub discs: &'a [Aligned<T>],
    pub entries: &'a [u32],
    /// Which tile of which.
    pub tile: (Tiling, usize),
    pub optics: Optics<'a, T>,
}

/// A point of a disc's plane that a ray meets, in standard deviations, with `1 / N.d`.
struct Hit<T> {
    s: T,
    u: T,
    over: T,
}

/// What a disc shows at a pixel.
pub(in crate::splat) struct Seen<T> {
    /// Offset of the pixel from the centre on screen.
    offset: [T; 2],
    /// Of the ray from that of the centre.
    tilt: [T; 3],
    /// `None` where the screen filter counts.
    hit: Option<Hit<T>>,
    raw: T,
    pub alpha: T,
    pub depth: T,
}

/// What the disc of `row` shows at the pixel `(x, y)` with ray `d`; `None` below 1/255.
#[inline(always)]
pub(in crate::splat) fn sample<T: Real>(
    row: &Row<T>,
    disc: &Disc<T>,
    optics: &Optics<'_, T>,
    [x, y]: [usize; 2],
    d: [T; 3],
) -> Option<Seen<T>> {
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
    if exponent < T::of(-8.0) {
        return None;
    }
    let raw = exponent.exp2();
    let alpha = raw.minimum(T::of(0.99));
    let visible = alpha >= T::of(1.0 / 255.0);
    visible.then(|| Seen {
        offset,
        tilt,
        hit: on_plane.then_some(Hit { s, u, over }),
        raw,
        alpha,
        depth: if on_plane { depth } else { row[at::DEPTH] },
    })
}

impl DiscTile<'_, f32> {
    /// As the vectorised kernels take it.
    pub fn native(&self) -> SplatDiscs<'_> {
        let (tiling, t) = self.tile;
        let ([x, y], [width, height]) = (tiling.corner(t), self.optics.size);
        SplatDiscs {
            rows: native::columns(self.rows),
            discs: native::columns(self.discs),
            entries: self.entries,
            x: x as u32,
            y: y as u32,
            width: width as u32,
            height: height as u32,
            blocks: kernel::ALL_BLOCKS,
            rays: self.optics.rays.as_flattened(),
            pinhole: self.optics.per_pixel.is_some(),
            per_px: self.optics.per_pixel.unwrap_or_default(),
            near: self.optics.near,
            filter: self.optics.filter.unwrap_or_default(),
        }
    }
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
        let middle = [corner[0] + column, corner[1] + line].map(|v| T::of(v as f64 + 2.0));
        let half = T::of(1.5);
        let meets = |k: &usize| Disc::unpack(&self.discs[self.entries[*k] as usize]).bounds.holds(middle, half);
        near.clear();
        near.extend((0..self.entries.len()).filter(meets));
    }

    /// Calls `visit` with each disc of `near` that pixel `p` blends, front to back: number of the entry, what is seen,
    /// the light before and after. Stops where the pixel is full.
    fn walk(&self, p: usize, near: &[usize], mut visit: impl FnMut(usize, &Row<T>, &Seen<T>, T, T)) {
        let Some((pixel, ray)) = self.pixel(p) else { return };
        let mut left = T::one();
        for &k in near {
            let entry = self.entries[k];
            let row = &self.rows[entry as usize].0;
            let Some(seen) = sample(row, &Disc::unpack(&self.discs[entry as usize]), &self.optics, pixel, ray) else {
                continue;
            };
            let next = left - seen.alpha * left;
            if next <= T::of(1e-4) {
                break;
            }
            visit(k, row, &seen, left, next);
            left = next;
        }
    }

    /// Fills the state of the tile: sums of red, green, blue, depth, and the light that is left.
    pub fn forward(&self, state: &mut [T], with_depth: bool) {
        let mut near = Vec::with_capacity(self.entries.len());
        for p in 0..PIXELS {
            if p % 16 == 0 {
                self.near(p / 16, &mut near);
            }
            let mut sums = [T::zero(), T::zero(), T::zero(), T::zero(), T::one()];
            self.walk(p, &near, |_, row, seen, left, next| {
                let weight = seen.alpha * left;
                for k in 0..3 {
                    sums[k] += weight * row[at::RED + k];
                }
                if with_depth {
                    sums[3] += weight * seen.depth;
                }
                sums[4] = next;
            });
            (0..PLANES).for_each(|k| state[k * PIXELS + p] = sums[k]);
        }
    }

    /// Carries the gradient of the tile (`adjoint` as in `kernel::BackwardTile`) to the sums of its entries.
    pub(in crate::splat) fn backward(&self, adjoint: &[T], parts: Parts, faults: impl Faults) -> Vec<Sums<T>> {
        let mut out = vec![[T::zero(); sum::COUNT]; self.entries.len()];
        let mut near = Vec::with_capacity(self.entries.len());
        for p in 0..PIXELS {
            if p % 16 == 0 {
                self.near(p / 16, &mut near);
            }
            let Some((_, d)) = self.pixel(p) else { continue };
            let by = |k: usize| adjoint[k * PIXELS + p];
            let mut behind = by(4);
            self.walk(p, &near, |entry, row, seen, left, _| {
                let out = &mut out[entry];
                let weight = seen.alpha * left;
                if parts.color {
                    (0..3).for_each(|k| out[sum::RED + k] += weight * by(k));
                }
                let by_depth = if parts.depth { weight * by(3) } else { T::zero() };
                if parts.depth {
                    seen.depth_pullback(by_depth, d, out);
                }
                if !parts.geometry {
                    return;
                }
                let mut value = row[at::RED] * by(0) + row[at::RED + 1] * by(1) + row[at::RED + 2] * by(2);
                if parts.depth {
                    value += seen.depth * by(3);
                }
                behind -= weight * value;
                if seen.raw <= T::of(0.99) {
                    let v = seen.alpha * (left * value - behind / (T::one() - seen.alpha));
                    seen.alpha_pullback(v, d, out, faults);
                }
            });
        }
        out
    }
}

impl<T: Real> Seen<T> {
    /// Gradient of the depth of the point.
    #[inline(always)]
    fn depth_pullback(&self, by_depth: T, d: [T; 3], out: &mut Sums<T>) {
        let Some(hit) = &self.hit else {
            out[sum::DEPTH] += by_depth;
            return;
        };
        out[sum::HEIGHT] += by_depth * d[2] * hit.over;
        let by_w = -(by_depth * self.depth * hit.over);
        (0..3).for_each(|k| out[sum::N + k] += by_w * d[k]);
    }

    /// Gradient of the logarithm of alpha.
    #[inline(always)]
    fn alpha_pullback(&self, v: T, d: [T; 3], out: &mut Sums<T>, faults: impl Faults) {
        out[sum::S] += v;
        let Some(hit) = &self.hit else {
            out[sum::FILTER] += v * self.offset[0];
            out[sum::FILTER + 1] += v * self.offset[1];
            return;
        };
        let scaled = v * hit.over;
        let (by_p, by_q) = (-(scaled * hit.s), -(scaled * hit.u));
        let by_w =
            if faults.has(Fault::PlaneTiltIgnored) { T::zero() } else { scaled * (hit.s * hit.s + hit.u * hit.u) };
        for k in 0..3 {
            out[sum::P + k] += by_p * self.tilt[k];
            out[sum::Q + k] += by_q * self.tilt[k];
            out[sum::N + k] += by_w * d[k];
        }
        out[sum::P_ALONG] += by_p * d[2];
        out[sum::Q_ALONG] += by_q * d[2];
    }
}
