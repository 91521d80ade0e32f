//! Where the scope is, when its given pose is wrong by a few mm and degrees. The correction is
//! `camera_from_world = exp(xi) given`, `xi = (omega, tau)` in camera axes (rad, mm). The first frame is registered to the
//! mesh by the depth that is given there, together with the phase: Gauss-Newton with central differences on the robust
//! relative error of depth, from several phases. Later frames estimate `xi` from the image (`track.rs`).

use glam::{DAffine3, DMat3, DQuat, DVec3};
use nalgebra::{DMatrix, DVector};

use crate::base::Image;

/// Unknowns of a pose.
pub const POSE: usize = 6;
/// Phases from which the first frame is registered.
const STARTS: [f64; 4] = [0.05, 0.35, 0.65, 0.95];
/// Steps from each start, and from the best of them.
const STEPS: [usize; 2] = [6, 12];
/// Half widths of the central differences: phase, rad, mm.
const WIDTHS: [f64; 1 + POSE] = [0.01, 2e-3, 2e-3, 2e-3, 0.03, 0.03, 0.03];
/// Relative error of depth beyond which a pixel counts linearly, and beyond which it does not count.
const HUBER: f64 = 0.01;
const LARGEST: f64 = 0.3;
/// Neighbouring pixels err together: so many count as one.
const TOGETHER: f64 = 100.0;

/// `exp(xi)`, rotation first.
pub fn motion(xi: [f64; POSE]) -> DAffine3 {
    let turn = DQuat::from_scaled_axis(DVec3::new(xi[0], xi[1], xi[2]));
    DAffine3::from_mat3_translation(DMat3::from_quat(turn), DVec3::new(xi[3], xi[4], xi[5]))
}

/// What is known before: standard deviations of phase, angles and places.
pub struct Before {
    /// Phases around one half.
    pub phase: f64,
    /// Per axis, rad.
    pub turn: f64,
    /// Per axis, mm.
    pub shift_mm: f64,
}

/// Relative errors of the depth rendered for an answer, pixel by pixel; NaN where there is none.
fn errors(rendered: &Image<f32>, given: &Image<f32>) -> Vec<f64> {
    let error = |(&d, &t): (&f32, &f32)| if d > 0.0 && t > 0.0 { f64::from(d / t - 1.0) } else { f64::NAN };
    rendered.data.iter().zip(&given.data).map(error).collect()
}

fn weight(error: f64) -> f64 {
    if error.abs() < LARGEST { (HUBER / error.abs().max(HUBER)) / (HUBER * HUBER) } else { 0.0 }
}

fn cost(errors: &[f64], x: &DVector<f64>, mean: &DVector<f64>, precision: &DVector<f64>) -> f64 {
    let most = HUBER * (LARGEST - 0.5 * HUBER);
    let one = |e: &f64| {
        let size = e.abs();
        // A pixel without a counterpart is as wrong as the worst.
        let loss = if size <= HUBER { 0.5 * size * size } else { HUBER * (size - 0.5 * HUBER) };
        if loss.is_nan() { most } else { loss.min(most) }
    };
    let prior: f64 = (x - mean).iter().zip(precision.iter()).map(|(d, p)| 0.5 * p * d * d).sum();
    errors.iter().map(one).sum::<f64>() / (HUBER * HUBER) / TOGETHER + prior
}

/// Phase and pose whose rendered depth is most like `given`. `render` answers phase and `xi` with a depth image in mm.
pub fn register(
    given: &Image<f32>,
    before: &Before,
    mut render: impl FnMut(f64, [f64; POSE]) -> Image<f32>,
) -> (f64, [f64; POSE]) {
    let mut errors_at = |x: &DVector<f64>| errors(&render(x[0].clamp(0.0, 1.0), unpacked(x)), given);
    let (r, t) = (before.turn, before.shift_mm);
    let precision = DVector::from_vec([before.phase, r, r, r, t, t, t].map(|d| 1.0 / (d * d)).to_vec());
    let mean = DVector::from_vec(vec![0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    let mut descend = |mut x: DVector<f64>, steps: usize| {
        let mut here = errors_at(&x);
        let mut lowest = cost(&here, &x, &mean, &precision);
        let mut damping = 1e-3;
        for _ in 0..steps {
            let columns: Vec<Vec<f64>> = (0..=POSE)
                .map(|k| {
                    let mut side = |sign: f64| {
                        let mut moved = x.clone();
                        moved[k] += sign * WIDTHS[k];
                        errors_at(&moved)
                    };
                    let (plus, minus) = (side(1.0), side(-1.0));
                    let slope = |(p, m): (&f64, &f64)| (p - m) / (2.0 * WIDTHS[k]);
                    plus.iter().zip(&minus).map(slope).collect()
                })
                .collect();
            let mut hessian = DMatrix::from_diagonal(&precision);
            let mut pull = precision.component_mul(&(&mean - &x));
            for (i, e) in here.iter().enumerate() {
                let row: [f64; 1 + POSE] = std::array::from_fn(|k| columns[k][i]);
                // Edges of the wall jump: their slopes say nothing.
                if e.is_nan() || row.iter().zip(WIDTHS).any(|(v, w)| !(v * w).is_finite() || (v * w).abs() > 0.05) {
                    continue;
                }
                let w = weight(*e) / TOGETHER;
                for a in 0..=POSE {
                    pull[a] -= w * row[a] * e;
                    (0..=POSE).for_each(|b| hessian[(a, b)] += w * row[a] * row[b]);
                }
            }
            let damped = &hessian + DMatrix::from_diagonal(&hessian.diagonal()) * damping;
            let Some(step) = damped.cholesky().map(|c| c.solve(&pull)) else { break };
            let mut next = &x + step;
            next[0] = next[0].clamp(0.0, 1.0);
            let there = errors_at(&next);
            let found = cost(&there, &next, &mean, &precision);
            if found < lowest {
                (x, here, lowest, damping) = (next, there, found, damping * 0.1);
            } else {
                damping *= 10.0;
            }
        }
        (lowest, x)
    };
    let mut best: Option<(f64, DVector<f64>)> = None;
    for phase in STARTS {
        let mut start = mean.clone();
        start[0] = phase;
        let found = descend(start, STEPS[0]);
        if best.as_ref().is_none_or(|b| found.0 < b.0) {
            best = Some(found);
        }
    }
    let (_, x) = best.map_or_else(|| (0.0, mean.clone()), |(_, x)| descend(x, STEPS[1]));
    (x[0].clamp(0.0, 1.0), unpacked(&x))
}

fn unpacked(x: &DVector<f64>) -> [f64; POSE] {
    std::array::from_fn(|k| x[1 + k])
}
