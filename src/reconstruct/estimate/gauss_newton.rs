//! One robust Gauss-Newton step of few unknowns from an image, a rendering and its forward-mode derivatives.
//!
//! Per channel the exposure gain `g` is eliminated in closed form (variable projection): with weights `w`,
//! `g = sum w I R / sum w R^2`, residual `r = I - g R`, and each column of the Jacobian loses its part along `R`. Weights
//! are Huber's (1964), the scale of the residuals their median absolute deviation. Neighbouring pixels err together, so
//! the information is that of the sandwich estimator with square blocks as clusters (Liang and Zeger 1986):
//! `information = H S^-1 H`, `H = sum w J J^T`, `S` the sum over blocks of the outer products of their scores.

use nalgebra::{DMatrix, DVector};

/// Residuals whose median is below this (encoded, 0..1) are taken as this: half a code of an 8-bit image.
const SMALLEST_SCALE: f32 = 0.5 / 255.0;
/// Share of the mean diagonal of `S` that is added to it, so that few blocks cannot make it singular.
const SCATTER_RIDGE: f64 = 1e-6;

/// An image, and what was rendered of it with gain 1.
pub struct Comparison<'a> {
    /// Width in pixels.
    pub width: usize,
    /// `height * width * 3`, encoded, 0..1.
    pub image: &'a [f32],
    /// Like `image`.
    pub rendered: &'a [f32],
    /// How much each pixel counts; empty where all count alike.
    pub weights: &'a [f32],
    /// d(rendered)/d(unknown), one image per unknown.
    pub tangents: &'a [Vec<f32>],
}

/// How residuals count.
#[derive(Clone, Copy, Debug)]
pub struct Robust {
    /// Residuals beyond so many robust standard deviations count linearly.
    pub huber: f64,
    /// Edge of the blocks in pixels whose residuals err together.
    pub block_px: usize,
    /// Gains stay within `1 - limit` and `1 / (1 - limit)` of those of the last frame.
    pub gain_limit: f64,
    /// Those of the last frame.
    pub last_gain: [f64; 3],
    /// What else of the brightness is nobody's fault.
    pub unevenness: Unevenness,
}

/// Brightness of an image against its rendering, beyond one gain per channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unevenness {
    /// None.
    Even,
    /// A gain that is linear across the image, and one that grows with the square of the distance from its middle: walls
    /// light each other as no model here says.
    Smooth,
}

/// Smooth functions of the place in an image that a gain may follow.
const TERMS: usize = 4;

/// What a gain per channel explains: factors on the [`TERMS`] functions.
type Shares = [[f32; TERMS]; 3];

/// The functions at each pixel; empty where only the constant counts.
fn terms(seen: &Comparison<'_>, unevenness: Unevenness) -> Vec<[f32; TERMS]> {
    if unevenness == Unevenness::Even {
        return Vec::new();
    }
    let (width, pixels) = (seen.width as f32, seen.image.len() / 3);
    let height = pixels as f32 / width;
    let term = |i: usize| {
        let (x, y) = ((i % seen.width) as f32 + 0.5, (i / seen.width) as f32 + 0.5);
        let (u, v) = (2.0 * x / width - 1.0, 2.0 * y / height - 1.0);
        [1.0, u, v, u * u + v * v]
    };
    (0..pixels).map(term).collect()
}

/// What an image says about the unknowns.
#[derive(Clone, Debug)]
pub struct Evidence {
    /// Most likely change of the unknowns by the image alone.
    pub step: DVector<f64>,
    /// Inverse covariance of that change.
    pub information: DMatrix<f64>,
    /// Mean Huber loss per value, in encoded units squared.
    pub cost: f64,
    /// The gains.
    pub gain: [f64; 3],
}

/// What is known before the image of the change of the unknowns.
#[derive(Clone, Debug)]
pub struct Prior {
    /// The change that would bring them to what is expected.
    pub step: DVector<f64>,
    /// Its inverse covariance.
    pub precision: DMatrix<f64>,
}

/// Gains of the channels in the least-squares sense under `weight`.
fn gains(image: &[f32], rendered: &[f32], robust: &Robust, weight: impl Fn(usize) -> f32) -> [f64; 3] {
    std::array::from_fn(|c| {
        let (mut cross, mut square) = (0.0f64, 1e-9f64);
        for i in (c..image.len()).step_by(3) {
            let weighted = (weight(i) * rendered[i]) as f64;
            cross += weighted * image[i] as f64;
            square += weighted * rendered[i] as f64;
        }
        let room = 1.0 - robust.gain_limit;
        (cross / square).clamp(robust.last_gain[c] * room, robust.last_gain[c] / room)
    })
}

/// 1.4826 times the median absolute residual: the standard deviation if residuals were normal.
fn robust_scale(residuals: &[f32]) -> f32 {
    let mut sizes: Vec<f32> = residuals.iter().map(|r| r.abs()).collect();
    let middle = sizes.len() / 2;
    let (_, median, _) = sizes.select_nth_unstable_by(middle, f32::total_cmp);
    (1.4826 * *median).max(SMALLEST_SCALE)
}

/// Weighs `seen`; `None` when it says nothing about the unknowns (a black rendering, no derivative).
pub fn evidence(seen: &Comparison<'_>, robust: Robust) -> Option<Evidence> {
    let (n, unknowns) = (seen.image.len(), seen.tangents.len());
    let counts = |i: usize| seen.weights.get(i / 3).copied().unwrap_or(1.0);
    let first = gains(seen.image, seen.rendered, &robust, counts);
    let residual = |gain: [f64; 3], i: usize| seen.image[i] - gain[i % 3] as f32 * seen.rendered[i];
    let rough: Vec<f32> = (0..n).map(|i| residual(first, i)).collect();
    let counting: Vec<f32> = (0..n).filter(|&i| counts(i) > 0.0).map(|i| rough[i]).collect();
    if counting.is_empty() {
        return None;
    }
    let limit = robust.huber as f32 * robust_scale(&counting);
    let weights: Vec<f32> =
        rough.iter().enumerate().map(|(i, r)| counts(i) * (limit / r.abs().max(limit)).min(1.0)).collect();
    let gain = gains(seen.image, seen.rendered, &robust, |i| weights[i]);

    // Residuals and each column of the Jacobian without what a change of gain explains as well.
    let terms = terms(seen, robust.unevenness);
    let count = if terms.is_empty() { 1 } else { TERMS };
    let term = |i: usize, m: usize| terms.get(i / 3).map_or(1.0, |t| t[m]);
    let squares: Vec<DMatrix<f64>> = (0..3)
        .map(|c| {
            let mut square = DMatrix::identity(count, count) * 1e-9;
            for i in (c..n).step_by(3) {
                let weighted = (weights[i] * seen.rendered[i] * seen.rendered[i]) as f64;
                for (a, b) in (0..count).flat_map(|a| (0..=a).map(move |b| (a, b))) {
                    square[(a, b)] += weighted * (term(i, a) * term(i, b)) as f64;
                }
            }
            square.fill_upper_triangle_with_lower_triangle();
            square
        })
        .collect();
    let along = |column: &dyn Fn(usize) -> f32| -> Option<Shares> {
        let mut shares = [[0.0; TERMS]; 3];
        for (c, square) in squares.iter().enumerate() {
            let mut cross = DVector::<f64>::zeros(count);
            for i in (c..n).step_by(3) {
                let weighted = (weights[i] * seen.rendered[i] * column(i)) as f64;
                (0..count).for_each(|m| cross[m] += weighted * term(i, m) as f64);
            }
            let solved = square.clone().cholesky()?.solve(&cross);
            (0..count).for_each(|m| shares[c][m] = solved[m] as f32);
        }
        Some(shares)
    };
    let explained = |shares: &Shares, i: usize| {
        let share = &shares[i % 3];
        let factor = if terms.is_empty() { share[0] } else { (0..TERMS).map(|m| share[m] * terms[i / 3][m]).sum() };
        factor * seen.rendered[i]
    };
    let shares: Vec<Shares> = seen.tangents.iter().map(|t| along(&|i| t[i])).collect::<Option<_>>()?;
    let uneven = if terms.is_empty() { [[0.0; TERMS]; 3] } else { along(&|i| residual(gain, i))? };

    let row = 3 * seen.width;
    let blocks_x = seen.width.div_ceil(robust.block_px);
    let block_of = |i: usize| (i / row / robust.block_px) * blocks_x + (i % row / 3) / robust.block_px;
    let mut scores = vec![DVector::<f64>::zeros(unknowns); block_of(n.max(1) - 1) + 1];
    let mut hessian = DMatrix::<f64>::zeros(unknowns, unknowns);
    let mut jacobian = vec![0.0f64; unknowns];
    let mut cost = 0.0f64;
    for i in 0..n {
        let (r, w) = (residual(gain, i) - explained(&uneven, i), weights[i]);
        let size = r.abs();
        cost += (counts(i) * if size <= limit { 0.5 * size * size } else { limit * (size - 0.5 * limit) }) as f64;
        for (k, (t, share)) in seen.tangents.iter().zip(&shares).enumerate() {
            jacobian[k] = gain[i % 3] * (t[i] - explained(share, i)) as f64;
        }
        let score = &mut scores[block_of(i)];
        for a in 0..unknowns {
            score[a] += (w * r) as f64 * jacobian[a];
            for b in 0..=a {
                hessian[(a, b)] += w as f64 * jacobian[a] * jacobian[b];
            }
        }
    }
    hessian.fill_upper_triangle_with_lower_triangle();
    let gradient = scores.iter().fold(DVector::zeros(unknowns), |sum, s| sum + s);
    let mut scatter = scores.iter().fold(DMatrix::zeros(unknowns, unknowns), |sum, s| sum + s * s.transpose());
    let ridge = SCATTER_RIDGE * scatter.trace() / unknowns.max(1) as f64;
    (0..unknowns).for_each(|k| scatter[(k, k)] += ridge);
    let step = hessian.clone().cholesky()?.solve(&gradient);
    let information = &hessian * scatter.cholesky()?.solve(&hessian);
    let finite = step.iter().chain(information.iter()).all(|v| v.is_finite());
    finite.then_some(Evidence { step, information, cost: cost / counting.len() as f64, gain })
}

/// The change of the unknowns that image and prior agree on, and the covariance after it.
pub fn posterior(evidence: &Evidence, prior: &Prior) -> Option<(DVector<f64>, DMatrix<f64>)> {
    let factor = (&evidence.information + &prior.precision).cholesky()?;
    let pull = &prior.precision * &prior.step;
    Some((factor.solve(&(&evidence.information * &evidence.step + pull)), factor.inverse()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::{CounterRng, Stage};

    const SIZE: usize = 48;

    /// A smooth image that two unknowns shift, with its exact derivatives.
    fn wave(at: [f64; 2]) -> (Vec<f32>, Vec<Vec<f32>>) {
        let (mut image, mut tangents) = (Vec::new(), vec![Vec::new(), Vec::new()]);
        for i in 0..SIZE * SIZE * 3 {
            let (x, y, c) = ((i / 3 % SIZE) as f64, (i / 3 / SIZE) as f64, (i % 3) as f64);
            let (u, v) = (0.21 * x + at[0] + c, 0.17 * y + at[1]);
            image.push((0.5 + 0.2 * u.sin() + 0.2 * v.cos()) as f32);
            tangents[0].push((0.2 * u.cos()) as f32);
            tangents[1].push((-0.2 * v.sin()) as f32);
        }
        (image, tangents)
    }

    const ROBUST: Robust =
        Robust { huber: 2.0, block_px: 8, gain_limit: 0.5, last_gain: [1.0; 3], unevenness: Unevenness::Even };

    #[test]
    fn what_a_mask_hides_says_nothing() {
        let n = 3 * SIZE * SIZE;
        let at = |i: usize, phase: f32| 0.5 + 0.3 * (0.2 * i as f32 + phase).sin();
        let rendered: Vec<f32> = (0..n).map(|i| at(i, 0.0)).collect();
        let tangents = [(0..n).map(|i| 0.3 * (0.2 * i as f32).cos()).collect::<Vec<f32>>()];
        let weights: Vec<f32> = (0..SIZE * SIZE).map(|i| f32::from(i % SIZE < SIZE / 2)).collect();
        let image: Vec<f32> = (0..n).map(|i| at(i, 0.05)).collect();
        let spoilt: Vec<f32> = (0..n).map(|i| if weights[i / 3] > 0.0 { image[i] } else { 0.9 }).collect();
        let of = |image: &[f32]| {
            let seen = Comparison { width: SIZE, image, rendered: &rendered, weights: &weights, tangents: &tangents };
            evidence(&seen, ROBUST).unwrap()
        };
        let (clean, hidden) = (of(&image), of(&spoilt));
        assert_eq!((clean.step[0], clean.cost), (hidden.step[0], hidden.cost));
        assert!((clean.step[0] - 0.05).abs() < 0.01, "{}", clean.step[0]);
        let blind = vec![0.0; SIZE * SIZE];
        let seen = Comparison { width: SIZE, image: &image, rendered: &rendered, weights: &blind, tangents: &tangents };
        assert!(evidence(&seen, ROBUST).is_none());
    }

    #[test]
    fn a_shift_is_found_through_gain_and_outliers() {
        let truth = [0.05, -0.03];
        let mut image = wave(truth).0;
        for (i, v) in image.iter_mut().enumerate() {
            *v *= [1.2, 0.9, 1.05][i % 3];
            if (i / 3 % SIZE) < 6 && i / 3 / SIZE < 6 {
                *v = 1.0;
            }
        }
        let mut at = [0.0, 0.0];
        let mut last = None;
        for _ in 0..6 {
            let (rendered, tangents) = wave(at);
            let seen =
                Comparison { width: SIZE, image: &image, rendered: &rendered, weights: &[], tangents: &tangents };
            let found = evidence(&seen, ROBUST).unwrap();
            at = [at[0] + found.step[0], at[1] + found.step[1]];
            last = Some(found);
        }
        let last = last.unwrap();
        assert!((at[0] - truth[0]).abs() < 1e-3 && (at[1] - truth[1]).abs() < 1e-3, "{at:?}");
        assert!((last.gain[0] - 1.2).abs() < 5e-3 && (last.gain[1] - 0.9).abs() < 5e-3, "{:?}", last.gain);
    }

    /// A slope of brightness across the image is no shift, once it may be uneven.
    #[test]
    fn a_shift_is_found_under_an_uneven_light() {
        let mut image = wave([0.0, 0.0]).0;
        for (i, v) in image.iter_mut().enumerate() {
            let (x, y) = ((i / 3 % SIZE) as f32 / SIZE as f32, (i / 3 / SIZE) as f32 / SIZE as f32);
            *v *= 0.8 + 0.3 * x + 0.1 * y;
        }
        let (rendered, tangents) = wave([0.0, 0.0]);
        let seen = Comparison { width: SIZE, image: &image, rendered: &rendered, weights: &[], tangents: &tangents };
        let off = |unevenness| {
            let found = evidence(&seen, Robust { unevenness, ..ROBUST }).unwrap();
            found.step.norm()
        };
        let (even, smooth) = (off(Unevenness::Even), off(Unevenness::Smooth));
        assert!(even > 2e-3 && smooth < 0.2 * even, "{even} {smooth}");
    }

    /// Noise that is constant on blocks: a bound that took pixels as independent would be far too sure.
    #[test]
    fn the_deviation_covers_the_error_when_neighbours_err_together() {
        let (clean, tangents) = wave([0.0, 0.0]);
        let mut scores = Vec::new();
        for trial in 0..200u64 {
            let mut rng = CounterRng::new(7, Stage::Test, &[trial]);
            let blocks: Vec<f32> = (0..(SIZE / 8).pow(2)).map(|_| 0.02 * rng.normal() as f32).collect();
            let noisy = |(i, v): (usize, &f32)| v + blocks[(i / 3 / SIZE / 8) * (SIZE / 8) + (i / 3 % SIZE) / 8];
            let image: Vec<f32> = clean.iter().enumerate().map(noisy).collect();
            let seen = Comparison { width: SIZE, image: &image, rendered: &clean, weights: &[], tangents: &tangents };
            let found = evidence(&seen, ROBUST).unwrap();
            let covariance = found.information.clone().try_inverse().unwrap();
            scores.extend((0..2).map(|k| found.step[k] / covariance[(k, k)].sqrt()));
        }
        let variance = scores.iter().map(|z| z * z).sum::<f64>() / scores.len() as f64;
        assert!((0.7..1.4).contains(&variance), "{variance}");
    }

    #[test]
    fn a_prior_wins_where_the_image_is_silent_and_yields_where_it_speaks() {
        let prior = Prior { step: DVector::from_element(1, 0.3), precision: DMatrix::from_element(1, 1, 100.0) };
        let with = |information: f64| Evidence {
            step: DVector::from_element(1, 0.1),
            information: DMatrix::from_element(1, 1, information),
            cost: 0.0,
            gain: [1.0; 3],
        };
        let (quiet, covariance) = posterior(&with(1e-6), &prior).unwrap();
        assert!((quiet[0] - 0.3).abs() < 1e-6 && (covariance[(0, 0)] - 0.01).abs() < 1e-6);
        let (loud, covariance) = posterior(&with(1e8), &prior).unwrap();
        assert!((loud[0] - 0.1).abs() < 1e-5 && covariance[(0, 0)] < 1.1e-8);
    }

    #[test]
    fn nothing_is_said_by_a_black_or_rigid_rendering() {
        let image = vec![0.5; 3 * 64];
        let still = vec![vec![0.0; 3 * 64]];
        let seen = Comparison { width: 8, image: &image, rendered: &[0.0; 192], weights: &[], tangents: &still };
        assert!(evidence(&seen, ROBUST).is_none());
    }
}
