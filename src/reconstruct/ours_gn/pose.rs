//! Where the scope is, when its given pose is wrong by a few mm and degrees. The correction is
//! `camera_from_world = exp(xi) given`, `xi = (omega, tau)` in camera axes (rad, mm). The first frame is registered to the
//! mesh by the depth that is given there, together with the phase: Gauss-Newton with central differences on the robust
//! relative error of depth, from several phases, with a norm that gets stricter. Later frames estimate `xi` from the image
//! (`track.rs`) around what is expected of it: a Kalman filter on `xi` and its change per second ([`Walk`]).

use glam::{DAffine3, DMat3, DQuat, DVec3};
use nalgebra::{DMatrix, DVector};

use crate::base::Image;

/// Unknowns of a pose.
pub const POSE: usize = 6;
/// Phases from which the first frame is registered.
const STARTS: [f64; 4] = [0.05, 0.35, 0.65, 0.95];
/// Steps with each.
const STEPS: [usize; 4] = [8, 12, 20, 40];
/// Standard deviation of what the first frame's depth tells: rad, mm.
const START_DEVIATION: [f64; 2] = [0.002, 0.03];
/// How many of them go on.
const BEST: usize = 3;
/// Half widths of the central differences: phase, rad, mm.
const WIDTHS: [f64; 1 + POSE] = [0.01, 2e-3, 2e-3, 2e-3, 0.03, 0.03, 0.03];
/// Relative error of depth beyond which a pixel counts linearly: from each start, from the best ones, and in the end.
const HUBER: [f64; 4] = [0.1, 0.03, 0.01, 0.003];
/// Beyond this a pixel does not count.
const LARGEST: f64 = 0.3;
/// A stage ends when a step gains less than this share of the cost, or when damped beyond this.
const SETTLED: f64 = 1e-4;
const LARGEST_DAMPING: f64 = 1e6;
/// Neighbouring pixels err together: so many count as one.
const TOGETHER: f64 = 100.0;

/// `exp(xi)`, rotation first.
pub fn motion(xi: [f64; POSE]) -> DAffine3 {
    let turn = DQuat::from_scaled_axis(DVec3::new(xi[0], xi[1], xi[2]));
    DAffine3::from_mat3_translation(DMat3::from_quat(turn), DVec3::new(xi[3], xi[4], xi[5]))
}

/// The correction `xi` after a further motion `change` in camera axes: `exp(change) exp(xi)`, shifts after the turn.
pub fn after(change: [f64; POSE], xi: [f64; POSE]) -> [f64; POSE] {
    unknowns(&(motion(change) * motion(xi)))
}

/// The `change` with which [`after`] makes `expected` of `xi`.
pub fn apart(expected: [f64; POSE], xi: [f64; POSE]) -> [f64; POSE] {
    unknowns(&(motion(expected) * motion(xi).inverse()))
}

/// The inverse of [`motion`].
fn unknowns(motion: &DAffine3) -> [f64; POSE] {
    let turn = DQuat::from_mat3(&motion.matrix3).to_scaled_axis();
    let [a, b, c] = turn.to_array();
    let [x, y, z] = motion.translation.to_array();
    [a, b, c, x, y, z]
}

/// What is known of the correction while it drifts: itself and its change per second, both with their covariance. The
/// drift is as steady as that of a tracker: its rate forgets itself within some seconds (Ornstein-Uhlenbeck).
pub struct Walk {
    /// `xi`, and its rate.
    mean: DVector<f64>,
    covariance: DMatrix<f64>,
    /// Standard deviations of the rates, per second.
    rates: [f64; POSE],
    /// Seconds within which a rate changes.
    steady_s: f64,
}

/// Angles as `turn`, places as `shift`.
fn both(turn: f64, shift: f64) -> [f64; POSE] {
    [turn, turn, turn, shift, shift, shift]
}

impl Walk {
    /// Nothing is known yet but how large the changes per second are (`[rad, mm]`) and how long they last.
    pub fn new(rate: [f64; 2], steady_s: f64) -> Walk {
        Walk {
            mean: DVector::zeros(2 * POSE),
            covariance: DMatrix::zeros(2 * POSE, 2 * POSE),
            rates: both(rate[0], rate[1]),
            steady_s,
        }
    }

    /// Begins with the correction of the first frame, which depth has told.
    pub fn begin(&mut self, xi: [f64; POSE]) {
        self.mean.rows_mut(0, POSE).copy_from_slice(&xi);
        let deviations = both(START_DEVIATION[0], START_DEVIATION[1]).into_iter().chain(self.rates);
        self.covariance = DMatrix::from_diagonal(&DVector::from_iterator(2 * POSE, deviations.map(|d| d * d)));
    }

    /// Lets `seconds` pass.
    pub fn wait(&mut self, seconds: f64) {
        let kept = (-seconds / self.steady_s).exp();
        let mut step = DMatrix::identity(2 * POSE, 2 * POSE);
        for k in 0..POSE {
            step[(k, POSE + k)] = seconds;
            step[(POSE + k, POSE + k)] = kept;
        }
        self.mean = &step * &self.mean;
        self.covariance = &step * &self.covariance * step.transpose();
        for (k, rate) in self.rates.iter().enumerate() {
            self.covariance[(POSE + k, POSE + k)] += rate * rate * (1.0 - kept * kept);
        }
    }

    /// The correction that is expected.
    pub fn expected(&self) -> [f64; POSE] {
        std::array::from_fn(|k| self.mean[k])
    }

    /// Its covariance.
    pub fn covariance(&self) -> DMatrix<f64> {
        self.covariance.view((0, 0), (POSE, POSE)).into()
    }

    /// Takes over what an image and [`Walk::expected`] together say of the correction.
    pub fn learn(&mut self, xi: [f64; POSE], covariance: &DMatrix<f64>) {
        let before = self.covariance();
        let Some(inverse) = before.clone().try_inverse() else { return };
        let all: DMatrix<f64> = self.covariance.columns(0, POSE).into();
        let gain = all * inverse;
        let news = DVector::from_fn(POSE, |k, _| xi[k] - self.mean[k]);
        self.mean += &gain * news;
        self.covariance += &gain * (covariance - before) * gain.transpose();
    }
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

fn weight(error: f64, huber: f64) -> f64 {
    if error.abs() < LARGEST { (huber / error.abs().max(huber)) / (huber * huber) } else { 0.0 }
}

fn cost(errors: &[f64], huber: f64, x: &DVector<f64>, mean: &DVector<f64>, precision: &DVector<f64>) -> f64 {
    let most = huber * (LARGEST - 0.5 * huber);
    let one = |e: &f64| {
        let size = e.abs();
        // A pixel without a counterpart is as wrong as the worst.
        let loss = if size <= huber { 0.5 * size * size } else { huber * (size - 0.5 * huber) };
        if loss.is_nan() { most } else { loss.min(most) }
    };
    let prior: f64 = (x - mean).iter().zip(precision.iter()).map(|(d, p)| 0.5 * p * d * d).sum();
    errors.iter().map(one).sum::<f64>() / (huber * huber) / TOGETHER + prior
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
    let mut descend = |mut x: DVector<f64>, stage: usize| {
        let (steps, huber) = (STEPS[stage], HUBER[stage]);
        let mut here = errors_at(&x);
        let mut lowest = cost(&here, huber, &x, &mean, &precision);
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
                let w = weight(*e, huber) / TOGETHER;
                for a in 0..=POSE {
                    pull[a] -= w * row[a] * e;
                    (0..=POSE).for_each(|b| hessian[(a, b)] += w * row[a] * row[b]);
                }
            }
            let damped = &hessian + DMatrix::from_diagonal(&hessian.diagonal()) * damping;
            let Some(mut step) = damped.clone().cholesky().map(|c| c.solve(&pull)) else { break };
            if !(0.0..=1.0).contains(&(x[0] + step[0])) {
                // At the end of the breath the others must not count on more of it.
                let rest = damped.remove_row(0).remove_column(0);
                let edge = (x[0] + step[0]).clamp(0.0, 1.0) - x[0];
                let against = DVector::from_fn(POSE, |k, _| pull[k + 1] - hessian[(k + 1, 0)] * edge);
                let Some(others) = rest.cholesky().map(|c| c.solve(&against)) else { break };
                step[0] = edge;
                step.rows_mut(1, POSE).copy_from(&others);
            }
            let mut next = &x + step;
            next[0] = next[0].clamp(0.0, 1.0);
            let there = errors_at(&next);
            let found = cost(&there, huber, &next, &mean, &precision);
            if found < lowest {
                let settled = lowest - found < SETTLED * lowest;
                (x, here, lowest, damping) = (next, there, found, damping * 0.1);
                if settled {
                    break;
                }
            } else {
                damping *= 4.0;
                if damping > LARGEST_DAMPING {
                    break;
                }
            }
        }
        (lowest, x)
    };
    let from = |&phase: &f64| {
        let mut start = mean.clone();
        start[0] = phase;
        start
    };
    let mut found: Vec<(f64, DVector<f64>)> = STARTS.iter().map(from).map(|x| descend(x, 0)).collect();
    for stage in [1, 2, 3] {
        found.sort_by(|a, b| a.0.total_cmp(&b.0));
        found.truncate(BEST);
        found = found.into_iter().map(|(_, x)| descend(x, stage)).collect();
    }
    found.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (_, x) = found.swap_remove(0);
    (x[0].clamp(0.0, 1.0), unpacked(&x))
}

fn unpacked(x: &DVector<f64>) -> [f64; POSE] {
    std::array::from_fn(|k| x[1 + k])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_change_leads_from_one_correction_to_another() {
        let (a, b) = ([0.03, -0.02, 0.05, 1.0, -2.0, 0.5], [-0.01, 0.04, 0.02, 0.3, 0.7, -1.5]);
        let there = after(apart(b, a), a);
        assert!(there.iter().zip(b).all(|(x, y)| (x - y).abs() < 1e-12), "{there:?}");
    }

    /// A drift of constant rate under measurements that are much coarser than the drift between two frames.
    #[test]
    fn a_steady_drift_is_followed_through_noise_and_without_measurements() {
        use crate::base::random::{CounterRng, Stage};
        let mut rng = CounterRng::new(3, Stage::Test, &[]);
        let truth = |s: f64| [0.01, -0.02, 0.0, 0.3, 0.0, -0.2].map(|rate: f64| rate * s);
        let noise = both(0.005, 0.15);
        let mut walk = Walk::new([0.02, 0.3], 20.0);
        walk.begin([0.0; POSE]);
        let mut free = Vec::new();
        for frame in 1..=80 {
            walk.wait(0.1);
            if frame > 60 {
                free.push(walk.expected()[3] - truth(0.1 * frame as f64)[3]);
                continue;
            }
            let here = truth(0.1 * frame as f64);
            let measured = DVector::from_fn(POSE, |k, _| here[k] + noise[k] * rng.normal());
            let precision = DMatrix::from_diagonal(&DVector::from_fn(POSE, |k, _| noise[k].powi(-2)));
            let before = walk.covariance().try_inverse().unwrap();
            let covariance = (&before + &precision).try_inverse().unwrap();
            let expected = DVector::from_column_slice(&walk.expected());
            let both = &covariance * (before * expected + precision * measured);
            walk.learn(std::array::from_fn(|k| both[k]), &covariance);
        }
        let (said, off) = (walk.covariance()[(3, 3)].sqrt(), free.last().unwrap().abs());
        assert!(free[0].abs() < 0.12 && off < 0.5 && off < 3.0 * said, "{} {off} {said}", free[0]);
    }
}
