//! One robust Gauss-Newton step of the phase, from an image `I`, a rendering `R` and its forward-mode derivative
//! `T = dR / dphase`: the change `d` of the phase that minimises `sum_i w_i (I_i - g_c (R_i + T_i d))^2`.
//!
//! Per channel the exposure gain `g` is eliminated in closed form (variable projection): with weights `w`,
//! `g = sum w I R / sum w R^2`, residual `r = I - g R`, derivative `J = g (T - R sum w T R / sum w R^2)`.
//! A clipped value says that the wall is at least so bright (censored regression: Tobin, Econometrica 26:24, 1958): it
//! counts where the rendering is darker, and never for the gain.
//! Weights are Huber's (1964), with the median absolute deviation as the scale of the residuals. Errors of
//! neighbouring pixels are correlated, so the information is that of the sandwich estimator with square blocks as
//! clusters (Liang and Zeger 1986): `information = H S^-1 H`, `H = sum w J^2`, `S` the sum over blocks of the
//! squares of their scores `sum w J r`.

use crate::base::statistics::robust_deviation;

/// Smallest scale of the residuals (encoded, 0..1): half a code of an 8-bit image.
const SMALLEST_SCALE: f32 = 0.5 / 255.0;
/// Ridge on `S`, as a share of it.
const SCATTER_RIDGE: f64 = 1e-6;

/// Gains beyond these are no exposure: after minutes in the dark their squares would be 0 in single precision, and stay so.
const GAINS: [f64; 2] = [1e-6, 1e6];

/// An image and its rendering with gain 1.
pub struct ImageComparison<'a> {
    /// Width in pixels.
    pub width: usize,
    /// `height * width * 3`, encoded, 0..1.
    pub image: &'a [f32],
    /// Like `image`.
    pub rendered: &'a [f32],
    /// How much each pixel counts; empty where all count alike.
    pub weights: &'a [f32],
    /// Values of `image` from which on they are clipped, like `image`; empty where none is.
    pub clipped_from: &'a [f32],
    /// d(rendered)/d(phase), like `image`.
    pub tangent: &'a [f32],
}

/// Parameters of the robust step.
#[derive(Clone, Copy, Debug)]
pub struct Robust {
    /// Residuals beyond this many robust standard deviations count linearly.
    pub huber: f64,
    /// Edge in pixels of the blocks within which errors are correlated.
    pub block_px: usize,
    /// Gains stay within `1 - limit` and `1 / (1 - limit)` of those of the last frame.
    pub gain_limit: f64,
    /// Gains of the last frame.
    pub last_gain: [f64; 3],
}

/// The likelihood of the phase from one image.
#[derive(Clone, Debug)]
pub struct Evidence {
    /// Most likely change of the phase by the image alone.
    pub step: f64,
    /// Inverse variance of that change.
    pub information: f64,
    /// Mean Huber loss per value, in encoded units squared.
    pub cost: f64,
    /// The gains.
    pub gain: [f64; 3],
}

/// Prior of the change of the phase.
#[derive(Clone, Copy, Debug)]
pub struct Prior {
    /// The change that leads to the expected phase.
    pub step: f64,
    /// Its inverse variance.
    pub precision: f64,
}

/// Gains of the channels in the least-squares sense under `weight`: `g = sum w I R / sum w R^2`.
fn gains(image: &[f32], rendered: &[f32], robust: &Robust, weight: impl Fn(usize) -> f32) -> [f64; 3] {
    std::array::from_fn(|c| {
        let (mut cross, mut square) = (0.0f64, 1e-9f64);
        for i in (c..image.len()).step_by(3) {
            let weighted = (weight(i) * rendered[i]) as f64;
            cross += weighted * image[i] as f64;
            square += weighted * rendered[i] as f64;
        }
        let room = 1.0 - robust.gain_limit;
        (cross / square).clamp(robust.last_gain[c] * room, robust.last_gain[c] / room).clamp(GAINS[0], GAINS[1])
    })
}

/// The standard deviation that the residuals would have if they were normal, by the median of their sizes.
fn robust_scale(residuals: &[f32]) -> f32 {
    robust_deviation(residuals.iter().map(|r| r.abs())).map_or(SMALLEST_SCALE, |scale| scale.max(SMALLEST_SCALE))
}

/// `right / square`, computed through the square root like a 1x1 Cholesky solve: recorded results depend on this
/// rounding.
fn solve(square: f64, right: f64) -> f64 {
    let root = square.sqrt();
    right / root / root
}

/// Evidence of one image; `None` if it says nothing about the phase (black rendering, zero derivative).
pub fn evidence(comparison: &ImageComparison<'_>, robust: Robust) -> Option<Evidence> {
    let ImageComparison { width, image, rendered, weights: pixel_weights, clipped_from, tangent } = *comparison;
    let n = image.len();
    let is_clipped = |i: usize| clipped_from.get(i).is_some_and(|from| image[i] >= *from);
    let pixel_weight = |i: usize| pixel_weights.get(i / 3).copied().unwrap_or(1.0);
    let residual = |gain: [f64; 3], i: usize| image[i] - gain[i % 3] as f32 * rendered[i];

    // Huber weights w = min(1, limit / |r|), with residuals r = I - g R under the plain least-squares gains.
    let first_gain = gains(image, rendered, &robust, |i| if is_clipped(i) { 0.0 } else { pixel_weight(i) });
    let rough: Vec<f32> = (0..n).map(|i| residual(first_gain, i)).collect();
    let pixel_weight = |i: usize| if is_clipped(i) && rough[i] < 0.0 { 0.0 } else { pixel_weight(i) };
    let counting: Vec<f32> = (0..n).filter(|&i| pixel_weight(i) > 0.0).map(|i| rough[i]).collect();
    if counting.is_empty() {
        return None;
    }
    let limit = robust.huber as f32 * robust_scale(&counting);
    let weights: Vec<f32> =
        rough.iter().enumerate().map(|(i, r)| pixel_weight(i) * (limit / r.abs().max(limit)).min(1.0)).collect();

    // Gains g under these weights, and per channel the part sum w T R / sum w R^2 of the derivative that a change of
    // gain also explains.
    let gain_weight = |i: usize| if is_clipped(i) { 0.0 } else { weights[i] };
    let gain = gains(image, rendered, &robust, gain_weight);
    let explained: [f32; 3] = std::array::from_fn(|c| {
        let (mut cross, mut square) = (0.0f64, 1e-9f64);
        for i in (c..n).step_by(3) {
            let weighted = gain_weight(i) * rendered[i];
            cross += (weighted * tangent[i]) as f64;
            square += (weighted * rendered[i]) as f64;
        }
        solve(square, cross) as f32
    });

    // Curvature H = sum w J^2 and, block by block, the scores sum w J r.
    let row = 3 * width;
    let blocks_x = width.div_ceil(robust.block_px);
    let block_of = |i: usize| (i / row / robust.block_px) * blocks_x + (i % row / 3) / robust.block_px;
    let mut scores = vec![0.0f64; block_of(n.max(1) - 1) + 1];
    let (mut curvature, mut cost) = (0.0f64, 0.0f64);
    for i in 0..n {
        let (r, w) = (residual(gain, i), weights[i]);
        let size = r.abs();
        cost += (pixel_weight(i) * if size <= limit { 0.5 * size * size } else { limit * (size - 0.5 * limit) }) as f64;
        let jacobian = gain[i % 3] * (tangent[i] - explained[i % 3] * rendered[i]) as f64;
        scores[block_of(i)] += (w * r) as f64 * jacobian;
        curvature += w as f64 * jacobian * jacobian;
    }

    // Step H^-1 sum w J r, and the sandwich H S^-1 H.
    let gradient: f64 = scores.iter().sum();
    let scatter: f64 = scores.iter().map(|s| s * s).sum();
    let scatter = scatter + SCATTER_RIDGE * scatter;
    let (step, information) = (solve(curvature, gradient), curvature * solve(scatter, curvature));
    let sound = curvature > 0.0 && scatter > 0.0 && step.is_finite() && information.is_finite();
    sound.then_some(Evidence { step, information, cost: cost / counting.len() as f64, gain })
}

/// The most likely change of the phase by image and prior: their mean, weighted by their information.
pub fn posterior_step(evidence: &Evidence, prior: Prior) -> f64 {
    let weighted = evidence.information * evidence.step + prior.precision * prior.step;
    solve(evidence.information + prior.precision, weighted)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::{CounterRng, Stage};

    const SIZE: usize = 48;

    /// A smooth image that the phase shifts, with its exact derivative.
    fn wave(phase: f64) -> (Vec<f32>, Vec<f32>) {
        let (mut image, mut tangent) = (Vec::new(), Vec::new());
        for i in 0..SIZE * SIZE * 3 {
            let (x, y, c) = ((i / 3 % SIZE) as f64, (i / 3 / SIZE) as f64, (i % 3) as f64);
            let u = 0.21 * x + phase + c;
            image.push((0.5 + 0.2 * u.sin() + 0.2 * (0.17 * y).cos()) as f32);
            tangent.push((0.2 * u.cos()) as f32);
        }
        (image, tangent)
    }

    const ROBUST: Robust = Robust { huber: 2.0, block_px: 8, gain_limit: 0.5, last_gain: [1.0; 3] };

    #[test]
    fn what_a_mask_hides_says_nothing() {
        let n = 3 * SIZE * SIZE;
        let at = |i: usize, phase: f32| 0.5 + 0.3 * (0.2 * i as f32 + phase).sin();
        let rendered: Vec<f32> = (0..n).map(|i| at(i, 0.0)).collect();
        let tangent: Vec<f32> = (0..n).map(|i| 0.3 * (0.2 * i as f32).cos()).collect();
        let weights: Vec<f32> = (0..SIZE * SIZE).map(|i| f32::from(i % SIZE < SIZE / 2)).collect();
        let image: Vec<f32> = (0..n).map(|i| at(i, 0.05)).collect();
        let spoilt: Vec<f32> = (0..n).map(|i| if weights[i / 3] > 0.0 { image[i] } else { 0.9 }).collect();
        let of = |image: &[f32], weights: &[f32]| {
            let comparison = ImageComparison {
                width: SIZE,
                image,
                rendered: &rendered,
                weights,
                clipped_from: &[],
                tangent: &tangent,
            };
            evidence(&comparison, ROBUST)
        };
        let (clean, hidden) = (of(&image, &weights).unwrap(), of(&spoilt, &weights).unwrap());
        assert_eq!((clean.step, clean.cost), (hidden.step, hidden.cost));
        assert!((clean.step - 0.05).abs() < 0.01, "{}", clean.step);
        assert!(of(&image, &vec![0.0; SIZE * SIZE]).is_none());
    }

    #[test]
    fn what_is_clipped_pulls_neither_phase_nor_gain() {
        let truth = 0.05;
        let (rendered, tangent) = wave(0.0);
        let white = 0.7;
        let image: Vec<f32> = wave(truth).0.iter().map(|v| v.min(white)).collect();
        let clipped_from = vec![white; image.len()];
        let clipped = image.iter().filter(|v| **v >= white).count() as f64 / image.len() as f64;
        assert!((0.1..0.4).contains(&clipped), "{clipped}");
        let of = |clipped_from: &[f32]| {
            let comparison = ImageComparison {
                width: SIZE,
                image: &image,
                rendered: &rendered,
                weights: &[],
                clipped_from,
                tangent: &tangent,
            };
            evidence(&comparison, ROBUST).unwrap()
        };
        let (told, untold) = (of(&clipped_from), of(&[]));
        let gain_error = |found: &Evidence| found.gain.iter().map(|g| (g - 1.0).abs()).fold(0.0, f64::max);
        assert!((told.step - truth).abs() < 0.005 && gain_error(&told) < 0.005, "{told:?}");
        assert!(gain_error(&untold) > 2.0 * gain_error(&told), "{untold:?}");
        // Where the rendering is darker than white, a clipped value does count.
        let dark: Vec<f32> = rendered.iter().map(|v| 0.5 * v).collect();
        let all_white = vec![0.7f32; image.len()];
        let comparison = ImageComparison {
            width: SIZE,
            image: &all_white,
            rendered: &dark,
            weights: &[],
            clipped_from: &clipped_from,
            tangent: &tangent,
        };
        assert!(evidence(&comparison, ROBUST).is_some_and(|found| found.cost > 0.0));
    }

    #[test]
    fn a_shift_is_found_through_gain_and_outliers() {
        let truth = 0.05;
        let mut image = wave(truth).0;
        for (i, v) in image.iter_mut().enumerate() {
            *v *= [1.2, 0.9, 1.05][i % 3];
            if (i / 3 % SIZE) < 6 && i / 3 / SIZE < 6 {
                *v = 1.0;
            }
        }
        let mut at = 0.0;
        let mut last = None;
        for _ in 0..6 {
            let (rendered, tangent) = wave(at);
            let comparison = ImageComparison {
                width: SIZE,
                image: &image,
                rendered: &rendered,
                weights: &[],
                clipped_from: &[],
                tangent: &tangent,
            };
            let found = evidence(&comparison, ROBUST).unwrap();
            at += found.step;
            last = Some(found);
        }
        let last = last.unwrap();
        assert!((at - truth).abs() < 1e-3, "{at}");
        assert!((last.gain[0] - 1.2).abs() < 5e-3 && (last.gain[1] - 0.9).abs() < 5e-3, "{:?}", last.gain);
    }

    /// Minutes of black pictures leave a gain from which the first bright one begins to come back.
    #[test]
    fn a_long_dark_stretch_leaves_a_gain_that_comes_back() {
        let picture = wave(0.0).0;
        let black = vec![0.0; picture.len()];
        let mut last_gain = [1.0; 3];
        let mut see = |image: &[f32]| {
            last_gain = gains(image, &picture, &Robust { last_gain, ..ROBUST }, |_| 1.0);
            last_gain
        };
        for _ in 0..5000 {
            see(&black);
        }
        let dark = see(&black);
        assert!(dark.iter().all(|g| (*g as f32).powi(2) > 0.0), "{dark:?}");
        let mut again = dark;
        for _ in 0..30 {
            again = see(&picture);
        }
        assert!(again.iter().all(|g| (g - 1.0).abs() < 1e-6), "{again:?}");
    }

    /// Noise that is constant on blocks: a bound that assumed independent pixels would be far too small.
    #[test]
    fn the_information_covers_the_error_when_neighbours_err_together() {
        let (clean, tangent) = wave(0.0);
        let mut scores = Vec::new();
        for trial in 0..400u64 {
            let mut rng = CounterRng::new(7, Stage::Test, &[trial]);
            let blocks: Vec<f32> = (0..(SIZE / 8).pow(2)).map(|_| 0.02 * rng.normal() as f32).collect();
            let noisy = |(i, v): (usize, &f32)| v + blocks[(i / 3 / SIZE / 8) * (SIZE / 8) + (i / 3 % SIZE) / 8];
            let image: Vec<f32> = clean.iter().enumerate().map(noisy).collect();
            let comparison = ImageComparison {
                width: SIZE,
                image: &image,
                rendered: &clean,
                weights: &[],
                clipped_from: &[],
                tangent: &tangent,
            };
            let found = evidence(&comparison, ROBUST).unwrap();
            scores.push(found.step * found.information.sqrt());
        }
        let variance = scores.iter().map(|z| z * z).sum::<f64>() / scores.len() as f64;
        assert!((0.7..1.4).contains(&variance), "{variance}");
    }

    #[test]
    fn a_prior_wins_where_the_image_is_silent_and_yields_where_it_speaks() {
        let prior = Prior { step: 0.3, precision: 100.0 };
        let with = |information: f64| Evidence { step: 0.1, information, cost: 0.0, gain: [1.0; 3] };
        assert!((posterior_step(&with(1e-6), prior) - 0.3).abs() < 1e-6);
        assert!((posterior_step(&with(1e8), prior) - 0.1).abs() < 1e-5);
    }

    #[test]
    fn nothing_is_said_by_a_black_or_rigid_rendering() {
        let (image, still) = (vec![0.5; 3 * 64], vec![0.0; 3 * 64]);
        let comparison = ImageComparison {
            width: 8,
            image: &image,
            rendered: &[0.0; 192],
            weights: &[],
            clipped_from: &[],
            tangent: &still,
        };
        assert!(evidence(&comparison, ROBUST).is_none());
    }
}
