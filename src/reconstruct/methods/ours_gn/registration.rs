//! Registration of the first frame when its given pose is wrong by a few mm and degrees. The correction is
//! `camera_from_world = exp(xi) given`, `xi = (omega, tau)` in camera axes (rad, mm). Pose and phase are found by
//! the depth given for that frame: Gauss-Newton with central differences on the robust relative error of depth,
//! from several initial phases, with an ever stricter norm. In later frames the keyframe window estimates `xi`.

use nalgebra::{DMatrix, DVector};

use crate::base::Image;
use crate::reconstruct::geometry::rigid::POSE;

/// Initial phases.
const STARTS: [f64; 4] = [0.05, 0.35, 0.65, 0.95];
/// Largest number of steps in each of the four stages (see [`HUBER`]).
const STEPS: [usize; 4] = [8, 12, 20, 40];
/// Number of candidates that continue after each stage.
const BEST: usize = 3;
/// Half widths of the central differences: phase, rad, mm.
const WIDTHS: [f64; 1 + POSE] = [0.01, 2e-3, 2e-3, 2e-3, 0.03, 0.03, 0.03];
/// Relative error of depth beyond which a pixel counts linearly, in each of the four stages.
const HUBER: [f64; 4] = [0.1, 0.03, 0.01, 0.003];
/// Relative error of depth beyond which a pixel counts no more.
const LARGEST: f64 = 0.3;
/// Largest change of the relative error within a half width: more is a jump of depth at an edge of the wall, whose slope
/// is meaningless.
const LARGEST_CHANGE: f64 = 0.05;
/// A stage ends if a step lowers the cost by less than this share, or if the damping exceeds this factor.
const SETTLED: f64 = 1e-4;
const LARGEST_DAMPING: f64 = 1e6;
/// The damping of a stage's first step, and what multiplies it after a step that lowered the cost, and after another.
const FIRST_DAMPING: f64 = 1e-3;
const AFTER_GOOD: f64 = 0.1;
const AFTER_BAD: f64 = 4.0;
/// Number of pixels that count as one independent observation: errors of neighbouring pixels are correlated.
const TOGETHER: f64 = 100.0;

/// The prior: standard deviations of phase, angles and translations.
pub struct Before {
    /// Of the phase, around one half.
    pub phase: f64,
    /// Per axis, rad.
    pub turn: f64,
    /// Per axis, mm.
    pub shift_mm: f64,
}

/// Relative error of rendered depth per pixel; NaN where either depth is missing.
fn errors(rendered: &Image<f32>, given: &Image<f32>) -> Vec<f64> {
    let error = |(&d, &t): (&f32, &f32)| if d > 0.0 && t > 0.0 { f64::from(d / t - 1.0) } else { f64::NAN };
    rendered.data.iter().zip(&given.data).map(error).collect()
}

fn weight(error: f64, huber: f64) -> f64 {
    if error.abs() < LARGEST { (huber / error.abs().max(huber)) / (huber * huber) } else { 0.0 }
}

/// Phase and pose `x = (phase, xi)` whose rendered depth `d(x)` best matches the `given` depth `t`: minimises
/// `sum_i rho(d_i(x) / t_i - 1) + 1/2 (x - mean)^T P (x - mean)` by damped Gauss-Newton. `render` returns the
/// depth image in mm for a phase and `xi`.
pub fn register(
    given: &Image<f32>,
    before: &Before,
    render: impl FnMut(f64, [f64; POSE]) -> Image<f32>,
) -> (f64, [f64; POSE]) {
    let (r, t) = (before.turn, before.shift_mm);
    let precision = DVector::from_vec([before.phase, r, r, r, t, t, t].map(|d| 1.0 / (d * d)).to_vec());
    let mean = DVector::from_vec(vec![0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    let mut registration = Registration { given, render, mean, precision };
    // Start from several phases; continue the best ones under ever stricter norms.
    let mut found: Vec<(f64, DVector<f64>)> = Vec::new();
    for phase in STARTS {
        let mut start = registration.mean.clone();
        start[0] = phase;
        found.push(registration.descend(start, 0));
    }
    for stage in [1, 2, 3] {
        found.sort_by(|a, b| a.0.total_cmp(&b.0));
        found.truncate(BEST);
        found = found.into_iter().map(|(_, x)| registration.descend(x, stage)).collect();
    }
    found.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (_, x) = found.swap_remove(0);
    (x[0].clamp(0.0, 1.0), unpacked(&x))
}

/// The objective, of `x = (phase, xi)`.
struct Registration<'a, R> {
    given: &'a Image<f32>,
    render: R,
    mean: DVector<f64>,
    /// Diagonal of the prior's precision.
    precision: DVector<f64>,
}

impl<R: FnMut(f64, [f64; POSE]) -> Image<f32>> Registration<'_, R> {
    fn errors_at(&mut self, x: &DVector<f64>) -> Vec<f64> {
        errors(&(self.render)(x[0].clamp(0.0, 1.0), unpacked(x)), self.given)
    }

    fn cost(&self, errors: &[f64], huber: f64, x: &DVector<f64>) -> f64 {
        let most = huber * (LARGEST - 0.5 * huber);
        let one = |e: &f64| {
            let size = e.abs();
            // A pixel where either depth is missing costs as much as the worst.
            let loss = if size <= huber { 0.5 * size * size } else { huber * (size - 0.5 * huber) };
            if loss.is_nan() { most } else { loss.min(most) }
        };
        let prior: f64 = (x - &self.mean).iter().zip(self.precision.iter()).map(|(d, p)| 0.5 * p * d * d).sum();
        errors.iter().map(one).sum::<f64>() / (huber * huber) / TOGETHER + prior
    }

    /// The lowest cost of a stage that begins at `x`, and where it is.
    fn descend(&mut self, mut x: DVector<f64>, stage: usize) -> (f64, DVector<f64>) {
        let (steps, huber) = (STEPS[stage], HUBER[stage]);
        let mut here = self.errors_at(&x);
        let mut lowest = self.cost(&here, huber, &x);
        let mut damping = FIRST_DAMPING;
        for _ in 0..steps {
            let (hessian, gradient) = self.normal_equations(&x, &here, huber);
            let Some(step) = damped_step(&hessian, &gradient, damping, x[0]) else { break };
            let mut next = &x + step;
            next[0] = next[0].clamp(0.0, 1.0);
            let there = self.errors_at(&next);
            let found = self.cost(&there, huber, &next);
            if found < lowest {
                let settled = lowest - found < SETTLED * lowest;
                (x, here, lowest, damping) = (next, there, found, damping * AFTER_GOOD);
                if settled {
                    break;
                }
            } else {
                damping *= AFTER_BAD;
                if damping > LARGEST_DAMPING {
                    break;
                }
            }
        }
        (lowest, x)
    }

    /// Hessian of Gauss-Newton and the negative gradient at `x`, where the errors are `here`; with the prior.
    fn normal_equations(&mut self, x: &DVector<f64>, here: &[f64], huber: f64) -> (DMatrix<f64>, DVector<f64>) {
        let columns: Vec<Vec<f64>> = (0..=POSE)
            .map(|k| {
                let mut side = |sign: f64| {
                    let mut moved = x.clone();
                    moved[k] += sign * WIDTHS[k];
                    self.errors_at(&moved)
                };
                // At an end of the breath the phase's slope is halved; docs/log has what a difference to one side gave.
                let (plus, minus) = (side(1.0), side(-1.0));
                let slope = |(p, m): (&f64, &f64)| (p - m) / (2.0 * WIDTHS[k]);
                plus.iter().zip(&minus).map(slope).collect()
            })
            .collect();
        let mut hessian = DMatrix::from_diagonal(&self.precision);
        let mut gradient = self.precision.component_mul(&(&self.mean - x));
        for (i, e) in here.iter().enumerate() {
            let row: [f64; 1 + POSE] = std::array::from_fn(|k| columns[k][i]);
            let jumps = |(v, w): (&f64, f64)| !(v * w).is_finite() || (v * w).abs() > LARGEST_CHANGE;
            if e.is_nan() || row.iter().zip(WIDTHS).any(jumps) {
                continue;
            }
            let w = weight(*e, huber) / TOGETHER;
            for a in 0..=POSE {
                gradient[a] -= w * row[a] * e;
                (0..=POSE).for_each(|b| hessian[(a, b)] += w * row[a] * row[b]);
            }
        }
        (hessian, gradient)
    }
}

/// The step that keeps `phase` within 0 to 1; `None` where the equations have no solution.
fn damped_step(hessian: &DMatrix<f64>, gradient: &DVector<f64>, damping: f64, phase: f64) -> Option<DVector<f64>> {
    let damped = hessian + DMatrix::from_diagonal(&hessian.diagonal()) * damping;
    let mut step = damped.clone().cholesky()?.solve(gradient);
    if !(0.0..=1.0).contains(&(phase + step[0])) {
        // Hold the phase at the end and solve for the others given that.
        let rest = damped.remove_row(0).remove_column(0);
        let edge = (phase + step[0]).clamp(0.0, 1.0) - phase;
        let against = DVector::from_fn(POSE, |k, _| gradient[k + 1] - hessian[(k + 1, 0)] * edge);
        let others = rest.cholesky()?.solve(&against);
        step[0] = edge;
        step.rows_mut(1, POSE).copy_from(&others);
    }
    Some(step)
}

fn unpacked(x: &DVector<f64>) -> [f64; POSE] {
    std::array::from_fn(|k| x[1 + k])
}
