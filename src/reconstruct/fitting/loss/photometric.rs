//! Photometric loss between a rendering and an image: `(1 - w_s) L1 + w_s (1 - SSIM)` (first part of the paper's
//! Eq. 4), with its gradient by the rendering.
//!
//! SSIM after Wang et al. 2004 as all the Gaussian-splatting code bases compute it: 11x11 Gaussian window, sigma 1.5,
//! each channel on its own, zero padding, K1 = .01, K2 = .03, range [0, 1], mean over pixels and channels. With blurs
//! `mx, my, xx, yy, xy` of x, y, x^2, y^2, xy:
//! `S = (2 mx my + C1)(2 sxy + C2) / ((mx^2 + my^2 + C1)(sx + sy + C2))`, `sx = xx - mx^2`, `sxy = xy - mx my`.
//! The blur is its own adjoint, so `dS/dx = blur(dS/dmx) + 2 x blur(dS/dxx) + y blur(dS/dxy)`.
//!
//! The blurs of the image alone are made once per frame. An optional weight per pixel masks both parts.

use rayon::prelude::*;

use crate::ffi::isa::Isa;
use crate::ffi::splat::loss::{self as native, LossImage};

const RADIUS: usize = 5;
const C1: f32 = 0.01 * 0.01;
const C2: f32 = 0.03 * 0.03;

/// `f32` for work, `f64` for the gradient test.
pub trait Scalar:
    Copy
    + Default
    + Send
    + Sync
    + PartialOrd
    + From<f32>
    + Into<f64>
    + std::ops::Add<Output = Self>
    + std::ops::Sub<Output = Self>
    + std::ops::Mul<Output = Self>
    + std::ops::Div<Output = Self>
    + std::ops::AddAssign
{
    /// Loss and gradient with vectorised code; `None` if this type has none.
    fn evaluate(_prepared: &Photometric<Self>, _rendered: &[Self], _gradient: &mut [Self]) -> Option<f64> {
        None
    }
}

impl Scalar for f64 {}

impl Scalar for f32 {
    fn evaluate(prepared: &Photometric<f32>, rendered: &[f32], gradient: &mut [f32]) -> Option<f64> {
        Some(prepared.evaluate_with(Isa::widest(), rendered, gradient))
    }
}

/// Lines per task of the vectorised code: an even number of tasks of the same size, for two threads, but none
/// so small that the ten lines beyond either end cost much.
fn band_of(height: usize) -> usize {
    if height <= 128 { height.max(1) } else { height.div_ceil(2 * height.div_ceil(256)) }
}

/// The image of one frame, prepared for many evaluations.
pub struct Photometric<T> {
    width: usize,
    height: usize,
    ssim_weight: T,
    /// Whether the image's blurs have been computed.
    has_blurs: bool,
    /// Weights per pixel divided by their sum; `None` is uniform.
    mask: Option<Vec<T>>,
    channels: [Channel<T>; 3],
    /// Image, its blur and the blur of its square, in the layout of the image.
    images: [Vec<T>; 3],
}

struct Channel<T> {
    target: Vec<T>,
    mean: Vec<T>,
    square: Vec<T>,
    source: Vec<T>,
    maps: [Vec<T>; 3],
    scratch: Vec<T>,
    gradient: Vec<T>,
}

/// Gaussian window, one side and centre: `kernel[0]` is the outermost tap.
fn kernel<T: Scalar>() -> [T; RADIUS + 1] {
    let taps: Vec<f64> = (0..=2 * RADIUS).map(|i| (-(i as f64 - RADIUS as f64).powi(2) / 4.5).exp()).collect();
    let sum: f64 = taps.iter().sum();
    std::array::from_fn(|i| T::from((taps[i] / sum) as f32))
}

/// Separable 11x11 blur with zero padding, in place. `scratch` holds `(height + 10) * width` values.
fn blur<T: Scalar>(map: &mut [T], scratch: &mut [T], width: usize, height: usize) {
    let k = kernel::<T>();
    let zero = T::default();
    let mut padded = vec![zero; width + 2 * RADIUS];
    let margin = RADIUS * width;
    scratch[..margin].fill(zero);
    scratch[margin + height * width..].fill(zero);
    for y in 0..height {
        padded[RADIUS..RADIUS + width].copy_from_slice(&map[y * width..(y + 1) * width]);
        let out = &mut scratch[margin + y * width..][..width];
        symmetric_sum(out, &k, |i| &padded[i..i + width]);
    }
    for y in 0..height {
        let rows = &scratch[y * width..];
        symmetric_sum(&mut map[y * width..(y + 1) * width], &k, |i| &rows[i * width..(i + 1) * width]);
    }
}

/// `out[x] = sum_i k_i tap(i)[x]` over the 11 taps of a symmetric window.
#[inline(always)]
fn symmetric_sum<'a, T: Scalar + 'a>(out: &mut [T], k: &[T; RADIUS + 1], tap: impl Fn(usize) -> &'a [T]) {
    let n = out.len();
    let taps: [&[T]; 2 * RADIUS + 1] = std::array::from_fn(|i| &tap(i)[..n]);
    for x in 0..n {
        out[x] = k[0] * (taps[0][x] + taps[10][x])
            + k[1] * (taps[1][x] + taps[9][x])
            + k[2] * (taps[2][x] + taps[8][x])
            + k[3] * (taps[3][x] + taps[7][x])
            + k[4] * (taps[4][x] + taps[6][x])
            + k[5] * taps[5][x];
    }
}

impl Photometric<f32> {
    /// The kernels of `isa`, which the processor must have.
    fn evaluate_with(&self, isa: Isa, rendered: &[f32], gradient: &mut [f32]) -> f64 {
        let (width, height) = (self.width, self.height);
        let [target, mean, square] = &self.images;
        let image = LossImage {
            width,
            height,
            target,
            mean,
            square,
            mask: self.mask.as_deref().unwrap_or_default(),
            window: kernel(),
            ssim_weight: self.ssim_weight,
        };
        let lines = band_of(height);
        let bands = gradient.par_chunks_mut(3 * width * lines).enumerate();
        let losses: Vec<f64> =
            bands.map(|(b, gradient)| native::band(isa, &image, rendered, b * lines, gradient)).collect();
        losses.iter().sum()
    }
}

impl<T: Scalar> Photometric<T> {
    /// Prepares `target` (`height * width * 3` encoded values). `mask` has one weight per pixel, at least one of them
    /// positive.
    pub fn new(target: &[T], width: usize, height: usize, ssim_weight: f64, mask: Option<&[T]>) -> Self {
        let n = width * height;
        assert_eq!(target.len(), n * 3, "the image has another size");
        let channels = std::array::from_fn(|c| {
            let plane: Vec<T> = target.iter().skip(c).step_by(3).copied().collect();
            let mut scratch = vec![T::default(); n + 2 * RADIUS * width];
            let mut mean = plane.clone();
            let mut square: Vec<T> = plane.iter().map(|&v| v * v).collect();
            if ssim_weight > 0.0 {
                blur(&mut mean, &mut scratch, width, height);
                blur(&mut square, &mut scratch, width, height);
            }
            let empty = || vec![T::default(); n];
            Channel {
                target: plane,
                mean,
                square,
                source: empty(),
                maps: [empty(), empty(), empty()],
                scratch,
                gradient: empty(),
            }
        });
        let mask = mask.map(|m| {
            let sum: f64 = m.iter().map(|&v| v.into()).sum();
            m.iter().map(|&v| v / T::from(sum as f32)).collect()
        });
        let all = |of: fn(&Channel<T>) -> &Vec<T>| (0..3 * n).map(|i| of(&channels[i % 3])[i / 3]).collect();
        let images = [all(|c| &c.target), all(|c| &c.mean), all(|c| &c.square)];
        let (ssim_weight, has_blurs) = (T::from(ssim_weight as f32), ssim_weight > 0.0);
        Photometric { width, height, ssim_weight, has_blurs, mask, channels, images }
    }

    /// Changes the share of SSIM; it stays 0 if the image was prepared without SSIM.
    pub fn set_ssim_weight(&mut self, ssim_weight: f64) {
        assert!(self.has_blurs || ssim_weight == 0.0, "prepared without SSIM");
        self.ssim_weight = T::from(ssim_weight as f32);
    }

    /// Loss of `rendered` (`height * width * 3`); its gradient is written to `gradient`.
    pub fn evaluate(&mut self, rendered: &[T], gradient: &mut [T]) -> f64 {
        T::evaluate(self, rendered, gradient).unwrap_or_else(|| self.evaluate_plainly(rendered, gradient))
    }

    /// The plain twin of the vectorised code.
    fn evaluate_plainly(&mut self, rendered: &[T], gradient: &mut [T]) -> f64 {
        let (width, height) = (self.width, self.height);
        let (ssim_weight, mask) = (self.ssim_weight, self.mask.as_deref());
        let losses: Vec<f64> = self
            .channels
            .par_iter_mut()
            .enumerate()
            .map(|(c, channel)| {
                for (s, v) in channel.source.iter_mut().zip(rendered.iter().skip(c).step_by(3)) {
                    *s = *v;
                }
                channel.evaluate(width, height, ssim_weight, mask)
            })
            .collect();
        for (c, channel) in self.channels.iter().enumerate() {
            for (g, v) in gradient.iter_mut().skip(c).step_by(3).zip(&channel.gradient) {
                *g = *v;
            }
        }
        losses.iter().sum()
    }
}

impl<T: Scalar> Channel<T> {
    /// This channel's share of the loss; fills `gradient`.
    fn evaluate(&mut self, width: usize, height: usize, ssim_weight: T, mask: Option<&[T]>) -> f64 {
        let n = width * height;
        let (zero, one) = (T::default(), T::from(1.0));
        let uniform = one / T::from(3.0 * n as f32);
        let third = one / T::from(3.0);
        let weight = |i: usize| mask.map_or(uniform, |m| m[i] * third);
        let l1_weight = one - ssim_weight;
        let mut l1 = 0.0f64;
        for y in 0..height {
            let mut sum = zero;
            for i in y * width..(y + 1) * width {
                let difference = self.source[i] - self.target[i];
                let (cost, slope) = match (difference > zero, difference < zero) {
                    (true, _) => (difference, one),
                    (_, true) => (zero - difference, zero - one),
                    _ => (difference, zero),
                };
                let w = weight(i) * l1_weight;
                self.gradient[i] = w * slope;
                sum += w * cost;
            }
            l1 += sum.into();
        }
        if ssim_weight > zero { l1 + self.add_ssim(width, height, ssim_weight, weight) } else { l1 }
    }

    /// Adds `ssim_weight * (1 - SSIM)` to the gradient and returns it.
    fn add_ssim(&mut self, width: usize, height: usize, ssim_weight: T, weight: impl Fn(usize) -> T) -> f64 {
        let [mean, square, cross] = &mut self.maps;
        mean.copy_from_slice(&self.source);
        for (i, &s) in self.source.iter().enumerate() {
            square[i] = s * s;
            cross[i] = s * self.target[i];
        }
        // Blurs mx, xx, xy.
        for map in [&mut *mean, &mut *square, &mut *cross] {
            blur(map, &mut self.scratch, width, height);
        }
        // SSIM of each pixel, S = a b / (c d), and its derivatives by the three blurs, which overwrite these.
        let (two, c1, c2) = (T::from(2.0), T::from(C1), T::from(C2));
        let zero = T::default();
        let mut loss = 0.0f64;
        for y in 0..height {
            let mut sum = zero;
            for i in y * width..(y + 1) * width {
                let (mx, my) = (mean[i], self.mean[i]);
                let a = two * mx * my + c1;
                let b = two * (cross[i] - mx * my) + c2;
                let c = mx * mx + my * my + c1;
                let d = (square[i] - mx * mx) + (self.square[i] - my * my) + c2;
                let inverse = T::from(1.0) / (c * d);
                let s = a * b * inverse;
                let w = zero - weight(i) * ssim_weight;
                sum += w * s - w;
                mean[i] = w * two * (my * (b - a) * inverse + mx * s * (c - d) * inverse);
                square[i] = zero - w * s * c * inverse;
                cross[i] = w * two * a * inverse;
            }
            loss += sum.into();
        }
        // Back through the blurs: dS/dx = blur(dS/dmx) + 2 x blur(dS/dxx) + y blur(dS/dxy).
        for map in [&mut *mean, &mut *square, &mut *cross] {
            blur(map, &mut self.scratch, width, height);
        }
        for i in 0..width * height {
            self.gradient[i] += mean[i] + two * self.source[i] * square[i] + self.target[i] * cross[i];
        }
        loss
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::{CounterRng, Stage};

    fn noise(n: usize, key: u64) -> Vec<f64> {
        let mut rng = CounterRng::new(3, Stage::Test, &[key]);
        (0..n).map(|_| rng.uniform()).collect()
    }

    /// SSIM by its definition, without separable blurs.
    fn ssim_by_definition(x: &[f64], y: &[f64], w: usize, h: usize) -> f64 {
        let tap = |d: i64| (-(d * d) as f64 / 4.5).exp();
        let norm: f64 = (-5..=5).map(tap).sum::<f64>();
        let mut total = 0.0;
        for c in 0..3 {
            for py in 0..h as i64 {
                for px in 0..w as i64 {
                    let mut m = [0.0; 5];
                    for dy in -5..=5i64 {
                        for dx in -5..=5i64 {
                            let (qx, qy) = (px + dx, py + dy);
                            if qx < 0 || qy < 0 || qx >= w as i64 || qy >= h as i64 {
                                continue;
                            }
                            let i = (qy as usize * w + qx as usize) * 3 + c;
                            let k = tap(dx) * tap(dy) / (norm * norm);
                            for (m, v) in m.iter_mut().zip([x[i], y[i], x[i] * x[i], y[i] * y[i], x[i] * y[i]]) {
                                *m += k * v;
                            }
                        }
                    }
                    let [mx, my, xx, yy, xy] = m;
                    total += (2.0 * mx * my + 1e-4) * (2.0 * (xy - mx * my) + 9e-4)
                        / ((mx * mx + my * my + 1e-4) * (xx - mx * mx + yy - my * my + 9e-4));
                }
            }
        }
        total / (3 * w * h) as f64
    }

    #[test]
    fn equals_the_definition_and_vanishes_for_equal_images() {
        let (w, h) = (17, 13);
        let (x, y) = (noise(w * h * 3, 1), noise(w * h * 3, 2));
        let mut gradient = vec![0.0; x.len()];
        let loss = Photometric::new(&y, w, h, 0.3, None).evaluate(&x, &mut gradient);
        let l1 = x.iter().zip(&y).map(|(a, b)| (a - b).abs()).sum::<f64>() / x.len() as f64;
        let want = 0.7 * l1 + 0.3 * (1.0 - ssim_by_definition(&x, &y, w, h));
        assert!((loss - want).abs() < 1e-6, "{loss} {want}");
        let same = Photometric::new(&y, w, h, 0.3, None).evaluate(&y, &mut gradient);
        assert!(same.abs() < 1e-12, "{same}");
        // One pixel near the edge is wrong: the gradient pushes it back.
        let mut wrong = y.clone();
        wrong[3] += 0.3;
        Photometric::new(&y, w, h, 0.3, None).evaluate(&wrong, &mut gradient);
        assert!(gradient[3] > 0.0);
    }

    #[test]
    fn gradient_equals_central_differences_with_and_without_mask() {
        let (w, h) = (14, 12);
        let (mut x, y) = (noise(w * h * 3, 3), noise(w * h * 3, 4));
        let weights = noise(w * h, 5);
        let masks = [None, Some(&weights[..])];
        for mask in masks {
            let mut loss = Photometric::new(&y, w, h, 0.6, mask);
            let mut gradient = vec![0.0; x.len()];
            let mut unused = vec![0.0; x.len()];
            loss.evaluate(&x, &mut gradient);
            for i in (0..x.len()).step_by(7) {
                let (old, step) = (x[i], 1e-6);
                x[i] = old + step;
                let high = loss.evaluate(&x, &mut unused);
                x[i] = old - step;
                let low = loss.evaluate(&x, &mut unused);
                x[i] = old;
                let want = (high - low) / (2.0 * step);
                assert!((gradient[i] - want).abs() < 1e-8 + 1e-5 * want.abs(), "{i}: {} {want}", gradient[i]);
            }
        }
    }

    /// Every instruction set; several bands, a width that is no multiple of any vector, with and without SSIM
    /// and mask.
    #[test]
    fn vectorised_and_plain_agree() {
        for (w, h, ssim_weight) in [(37, 300, 0.4), (64, 20, 0.0), (5, 3, 0.7), (256, 129, 0.2)] {
            let single = |v: Vec<f64>| v.into_iter().map(|x| x as f32).collect::<Vec<f32>>();
            let (x, y) = (single(noise(w * h * 3, 6)), single(noise(w * h * 3, 7)));
            let weights = single(noise(w * h, 8));
            for mask in [None, Some(&weights[..])] {
                let mut loss = Photometric::new(&y, w, h, ssim_weight, mask);
                let (mut fast, mut plain) = (vec![0.0; x.len()], vec![0.0; x.len()]);
                let b = loss.evaluate_plainly(&x, &mut plain);
                let largest = plain.iter().fold(0.0f32, |m, v| m.max(v.abs()));
                // Loss and gradient of the instruction sets that must agree to the last bit.
                let mut fused: Option<(f64, Vec<f32>)> = None;
                for isa in [Isa::Baseline, Isa::Avx2, Isa::Avx512].into_iter().filter_map(|isa| isa.available().ok()) {
                    let a = loss.evaluate_with(isa, &x, &mut fast);
                    assert!((a - b).abs() < 1e-5 * b.abs(), "{isa}: {a} {b}");
                    let worst = fast.iter().zip(&plain).map(|(f, p)| (f - p).abs()).fold(0.0, f32::max);
                    assert!(worst < 1e-4 * largest, "{isa}, {w}x{h}: {worst} of {largest}");
                    if isa > Isa::Baseline {
                        let (loss, gradient) = fused.get_or_insert_with(|| (a, fast.clone()));
                        assert!(*loss == a && *gradient == fast, "{isa}, {w}x{h}: other bits than AVX2");
                    }
                }
            }
        }
    }

    #[test]
    fn flat_frames_stay_finite() {
        let (w, h) = (20, 20);
        let mut gradient = vec![0.0f32; w * h * 3];
        for (a, b) in [(0.0, 0.0), (0.0, 1.0), (1.0, 1.0), (1.0, 0.0)] {
            let mut loss = Photometric::new(&vec![a; w * h * 3], w, h, 0.5, None);
            assert!(loss.evaluate(&vec![b; w * h * 3], &mut gradient).is_finite());
            assert!(gradient.iter().all(|g| g.is_finite()));
        }
    }
}
