//! Compositing of one tile, forward and backward: the plain twin of `cpp/splat/kernel.cpp`, for every number type.
//!
//! Front to back at a pixel with offset `d` from the centre of a splat: `alpha = min(0.99, 2^(l - A dx^2 - B dx dy -
//! C dy^2))`, left out below 1/255; the pixel stops at the splat that would leave `T (1 - alpha) <= 1e-4`, which is not
//! blended. Colour, depth: sums of `weight = alpha T`.
//!
//! Backward, front to back too (after FastGS and Brush): let `value` be a splat's colour and depth times the gradient
//! of the pixel's sums, and `behind` the total that splats further back (and the background) contribute to it. Then
//! `d loss / d alpha = T value - behind / (1 - alpha)`. With `v = alpha d loss / d alpha`, the moments
//! `sum v, v dx, v dy, v dx^2, v dx dy, v dy^2` are all that the chain to the parameters needs (`chain.rs`).
//!
//! A tile is 16 blocks of 4x4 pixels, numbered down the columns (`types/tiling.rs`); per-pixel tables go block by
//! block.

use crate::ffi::splat::rasterize::Aligned;
use crate::splat::number::{Each, Real};
use crate::splat::types::table::{ALPHA_MAX, ALPHA_MIN, PLANES, SPARED_LOG2_ALPHA, STOP, SplatRow, at, moment};
use crate::splat::types::{PIXELS, pixel_of};

use super::fault::{Fault, Faults};

/// What a kernel computes beyond colour, as the bits that C++ uses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Parts {
    pub geometry: bool,
    pub color: bool,
    pub depth: bool,
    /// The masks are those of an earlier forward pass with the same splats.
    pub known: bool,
    /// Pixels do not stop (`Skips::STOP` switched off).
    pub endless: bool,
}

impl Parts {
    /// A pixel stops at the splat that would bring its transmittance to this or below.
    fn stop<T: Real>(self) -> T {
        T::of(if self.endless { -1.0 } else { STOP })
    }

    pub fn bits(self) -> u32 {
        self.geometry as u32
            + 2 * self.color as u32
            + 4 * self.depth as u32
            + 8 * self.known as u32
            + 16 * self.endless as u32
    }
}

/// The adjoint of a tile, aligned for vector loads.
#[repr(C, align(64))]
pub struct Adjoint<T>(pub [T; PLANES * PIXELS]);

/// One tile to composite.
pub struct ForwardTile<'a, T> {
    pub rows: &'a [Aligned<T>],
    pub entries: &'a [u32],
    /// Out: blocks that an entry may touch, 0 for entries that no pixel reached.
    pub masks: &'a mut [u16],
    /// Upper left corner in pixels.
    pub corner: [usize; 2],
    /// Out: `PLANES` planes of `PIXELS`.
    pub state: &'a mut [T],
    pub parts: Parts,
}

/// One tile whose image gradient is to be carried to its splats.
pub struct BackwardTile<'a, T> {
    pub rows: &'a [Aligned<T>],
    pub entries: &'a [u32],
    pub masks: &'a [u16],
    /// Slot of each entry.
    pub targets: &'a [u32],
    pub corner: [usize; 2],
    /// `PLANES` planes: dL/d red, green, blue, depth sums, and `behind`.
    pub adjoint: &'a [T],
    pub parts: Parts,
}

/// Blocks whose pixel centres the ellipse `alpha >= 1/255` can reach: its x-extent over each band of 4 pixel rows.
fn block_mask<T: Real>(q: &SplatRow<T>, corner: [T; 2]) -> u16 {
    let (half, three) = (T::of(0.5), T::of(3.0));
    let slack = T::of(1e-3) + T::of(1e-5) * (q[at::HALF_WIDTH] + q[at::HALF_HEIGHT]);
    let limit = q[at::HALF_HEIGHT] + slack;
    // Widest to the right at y = -B half_width / (2 C), to the left at the opposite point.
    let widest = q[at::WIDEST];
    // 4 A (LOG2_OPACITY + log2(255))
    let reach = -q[at::DISCRIMINANT] * q[at::HALF_HEIGHT] * q[at::HALF_HEIGHT];
    let extent = |y: T, sign: T| {
        let root = (q[at::DISCRIMINANT] * y * y + reach).maximum(T::zero()).sqrt();
        (sign * root - q[at::B] * y) * half / q[at::A]
    };
    let offset = q[at::X] - corner[0] - half;
    let mut mask = 0;
    for band in 0..4 {
        let top = corner[1] + T::of(4.0 * band as f64 + 0.5) - q[at::Y];
        let (low, high) = (top.maximum(-limit), (top + three).minimum(limit));
        if low > high {
            continue;
        }
        let right = extent(widest.maximum(low).minimum(high), T::one()) + offset + slack;
        let left = extent((-widest).maximum(low).minimum(high), -T::one()) + offset - slack;
        for column in 0..4 {
            let x = T::of(4.0 * column as f64);
            if left <= x + three && right >= x {
                mask |= 1 << (4 * column + band);
            }
        }
    }
    mask
}

/// Offset of pixel `p` from the splat, `2^exponent`, and the alpha that is blended (0 below 1/255).
struct AlphaSample<T> {
    offset: [T; 2],
    raw: T,
    alpha: T,
}

fn evaluate_alpha<T: Real>(q: &SplatRow<T>, corner: [usize; 2], p: usize) -> Option<AlphaSample<T>> {
    let (column, line) = pixel_of(p);
    let dx = T::of((corner[0] + column) as f64 + 0.5) - q[at::X] - q[at::X_REST];
    let dy = T::of((corner[1] + line) as f64 + 0.5) - q[at::Y] - q[at::Y_REST];
    let exponent = q[at::LOG2_OPACITY] - q[at::C] * dy * dy - (q[at::A] * dx + q[at::B] * dy) * dx;
    if exponent < T::of(SPARED_LOG2_ALPHA) {
        return None;
    }
    let raw = exponent.exp2();
    let alpha = raw.minimum(T::of(ALPHA_MAX));
    (alpha >= T::of(ALPHA_MIN)).then_some(AlphaSample { offset: [dx, dy], raw, alpha })
}

/// Alpha of the splat of `row` at pixel `p` of the tile at `corner`; `None` below 1/255.
pub fn alpha_at<T: Real>(row: &SplatRow<T>, corner: [usize; 2], p: usize) -> Option<T> {
    evaluate_alpha(row, corner, p).map(|s| s.alpha)
}

/// Composites one tile, pixel by pixel.
pub fn forward<T: Real>(t: &mut ForwardTile<'_, T>) {
    let corner = t.corner.each(|v| T::of(v as f64));
    for (mask, &entry) in t.masks.iter_mut().zip(t.entries).filter(|_| !t.parts.known) {
        *mask = block_mask(&t.rows[entry as usize].0, corner);
    }
    t.state.fill(T::zero());
    let stop = t.parts.stop::<T>();
    for p in 0..PIXELS {
        let bit = 1u16 << (p / 16);
        let mut left = T::one();
        let mut sums = [T::zero(); 4];
        for (&mask, &entry) in t.masks.iter().zip(t.entries) {
            if mask & bit == 0 {
                continue;
            }
            let q = &t.rows[entry as usize].0;
            let Some(AlphaSample { alpha, .. }) = evaluate_alpha(q, t.corner, p) else { continue };
            let next = left - alpha * left;
            if next <= stop {
                break;
            }
            let weight = alpha * left;
            for (k, sum) in sums.iter_mut().enumerate() {
                *sum += weight * q[at::RED + k];
            }
            left = next;
        }
        for k in 0..3 {
            t.state[k * PIXELS + p] = sums[k];
        }
        if t.parts.depth {
            t.state[3 * PIXELS + p] = sums[3];
        }
        t.state[4 * PIXELS + p] = left;
    }
}

/// Carries the gradient of one tile to the moments of its entries, one row for each.
pub fn backward<T: Real>(t: &BackwardTile<'_, T>, faults: impl Faults) -> Vec<Aligned<T>> {
    let mut slots = vec![Aligned([T::zero(); 16]); t.entries.len()];
    let mut left = [T::one(); PIXELS];
    let mut behind = [T::zero(); PIXELS];
    behind.copy_from_slice(&t.adjoint[4 * PIXELS..]);
    let stop = t.parts.stop::<T>();
    for (i, &entry) in t.entries.iter().enumerate() {
        let q = &t.rows[entry as usize].0;
        let mut sums = [T::zero(); 16];
        for p in (0..PIXELS).filter(|p| t.masks[i] >> (p / 16) & 1 == 1) {
            let Some(AlphaSample { offset: [dx, dy], raw, alpha }) = evaluate_alpha(q, t.corner, p) else { continue };
            let now = left[p];
            let next = now - alpha * now;
            if next <= stop {
                left[p] = T::zero();
                continue;
            }
            left[p] = next;
            let weight = alpha * now;
            let adjoint = |k: usize| t.adjoint[k * PIXELS + p];
            if t.parts.geometry {
                let mut value = q[at::RED] * adjoint(0) + q[at::RED + 1] * adjoint(1) + q[at::RED + 2] * adjoint(2);
                if t.parts.depth {
                    value += q[at::DEPTH] * adjoint(3);
                }
                behind[p] -= weight * value;
                if raw <= T::of(ALPHA_MAX) || faults.has(Fault::AlphaCutIgnored) {
                    let mut hidden = behind[p] / (T::one() - alpha);
                    if faults.has(Fault::OcclusionForgotten) {
                        hidden = T::zero();
                    }
                    if faults.has(Fault::SurvivalFactorMissing) {
                        hidden = behind[p];
                    }
                    let v = alpha * (now * value - hidden);
                    for (k, moment) in [T::one(), dx, dy, dx * dx, dx * dy, dy * dy].into_iter().enumerate() {
                        sums[k] += v * moment;
                    }
                }
            }
            if t.parts.color {
                for k in 0..3 {
                    sums[moment::RED + k] += weight * adjoint(k);
                }
            }
            if t.parts.depth {
                sums[moment::DEPTH] += weight * adjoint(3);
            }
        }
        slots[i].0 = sums;
    }
    slots
}
