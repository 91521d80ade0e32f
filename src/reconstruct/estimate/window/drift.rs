//! How given poses are wrong: by a correction `xi = (omega, tau)` in camera axes (rad, mm), `camera_from_world = exp(xi) given`,
//! that drifts. Its change per second is as steady as that of a tracker: it forgets itself within some seconds
//! (Ornstein-Uhlenbeck). [`Drift`] is the model, [`Walk`] the Kalman filter of one pose after the other.

use glam::{DAffine3, DMat3, DQuat, DVec3};
use nalgebra::{DMatrix, DVector};

/// Unknowns of a pose.
pub const POSE: usize = 6;
/// Standard deviation of what the first frame's depth tells: rad, mm.
const START_DEVIATION: [f64; 2] = [0.002, 0.03];
/// How unsteady a drift is from frame to frame, as a share of itself.
const UNSTEADY: f64 = 0.05;

/// `exp(xi)`, rotation first.
pub fn motion(xi: [f64; POSE]) -> DAffine3 {
    let turn = DQuat::from_scaled_axis(DVec3::new(xi[0], xi[1], xi[2]));
    DAffine3::from_mat3_translation(DMat3::from_quat(turn), DVec3::new(xi[3], xi[4], xi[5]))
}

/// How `exp(xi) x` changes with the angles of `xi`: `turns[k] x (exp(xi) x - tau)`, the columns of the left Jacobian of rotations.
pub fn turns(xi: [f64; POSE]) -> [DVec3; 3] {
    let omega = DVec3::new(xi[0], xi[1], xi[2]);
    let angle2 = omega.length_squared();
    // (1 - cos) / angle^2 and (angle - sin) / angle^3.
    let (a, b) = if angle2 < 1e-8 {
        (0.5 - angle2 / 24.0, 1.0 / 6.0 - angle2 / 120.0)
    } else {
        let angle = angle2.sqrt();
        ((1.0 - angle.cos()) / angle2, (angle - angle.sin()) / (angle2 * angle))
    };
    DVec3::AXES.map(|axis| {
        let once = omega.cross(axis);
        axis + a * once + b * omega.cross(once)
    })
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

/// Angles as `turn`, places as `shift`.
fn both(turn: f64, shift: f64) -> [f64; POSE] {
    [turn, turn, turn, shift, shift, shift]
}

/// How a correction drifts.
#[derive(Clone, Copy, Debug)]
pub struct Drift {
    /// Standard deviations of the rates, per second.
    rates: [f64; POSE],
    /// Seconds within which a rate changes.
    steady_s: f64,
    /// The square root of what the information of an image is divided by: what a model of it gets wrong looks like a motion,
    /// and stays the same for many frames.
    pub caution: f64,
}

impl Drift {
    /// From how large the changes per second are (`[rad, mm]`), how long they last, and how much more an image errs than it
    /// says.
    pub fn new(rate: [f64; 2], steady_s: f64, caution: f64) -> Drift {
        Drift { rates: both(rate[0], rate[1]), steady_s, caution }
    }

    /// Variances of the correction and of its rates at the first frame, whose depth has told the correction.
    pub fn start_variances(&self) -> [f64; 2 * POSE] {
        let start = both(START_DEVIATION[0], START_DEVIATION[1]);
        std::array::from_fn(|k| if k < POSE { start[k] } else { self.rates[k - POSE] }.powi(2))
    }

    /// What `seconds` do to the correction and its rates.
    pub fn transition(&self, seconds: f64) -> DMatrix<f64> {
        let mut step = DMatrix::identity(2 * POSE, 2 * POSE);
        for k in 0..POSE {
            step[(k, POSE + k)] = seconds;
            step[(POSE + k, POSE + k)] = (-seconds / self.steady_s).exp();
        }
        step
    }

    /// The variances that they add.
    pub fn noise(&self, seconds: f64) -> [f64; 2 * POSE] {
        let kept = (-seconds / self.steady_s).exp();
        std::array::from_fn(|k| {
            let rate = self.rates[k % POSE];
            if k < POSE { (UNSTEADY * rate * seconds).powi(2) } else { rate * rate * (1.0 - kept * kept) }
        })
    }
}

/// What is known of the correction: itself and its change per second, both with their covariance.
pub struct Walk {
    /// `xi`, and its rate.
    mean: DVector<f64>,
    covariance: DMatrix<f64>,
    drift: Drift,
}

impl Walk {
    /// Nothing is known yet but the drift.
    pub fn new(drift: Drift) -> Walk {
        Walk { mean: DVector::zeros(2 * POSE), covariance: DMatrix::zeros(2 * POSE, 2 * POSE), drift }
    }

    /// Begins with the correction of the first frame, which depth has told.
    pub fn begin(&mut self, xi: [f64; POSE]) {
        self.mean.rows_mut(0, POSE).copy_from_slice(&xi);
        self.covariance = DMatrix::from_diagonal(&DVector::from_column_slice(&self.drift.start_variances()));
    }

    /// Lets `seconds` pass.
    pub fn wait(&mut self, seconds: f64) {
        let step = self.drift.transition(seconds);
        self.mean = &step * &self.mean;
        self.covariance = &step * &self.covariance * step.transpose();
        self.covariance += DMatrix::from_diagonal(&DVector::from_column_slice(&self.drift.noise(seconds)));
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_change_leads_from_one_correction_to_another() {
        let (a, b) = ([0.03, -0.02, 0.05, 1.0, -2.0, 0.5], [-0.01, 0.04, 0.02, 0.3, 0.7, -1.5]);
        let there = after(apart(b, a), a);
        assert!(there.iter().zip(b).all(|(x, y)| (x - y).abs() < 1e-12), "{there:?}");
    }

    #[test]
    fn turns_are_the_derivatives_of_a_motion() {
        for xi in [[0.2, -0.5, 0.3, 1.0, 2.0, -1.0], [1e-5, 2e-5, -1e-5, 0.0, 0.0, 0.0]] {
            let point = DVec3::new(3.0, -2.0, 8.0);
            let (there, shift) = (motion(xi).transform_point3(point), DVec3::from_slice(&xi[3..]));
            for (k, turn) in turns(xi).into_iter().enumerate() {
                let side = |h: f64| {
                    let mut moved = xi;
                    moved[k] += h;
                    motion(moved).transform_point3(point)
                };
                let numeric = (side(1e-5) - side(-1e-5)) / 2e-5;
                assert!((turn.cross(there - shift) - numeric).length() < 1e-7, "{k}: {numeric}");
            }
        }
    }

    /// A drift of constant rate under measurements that are much coarser than the drift between two frames.
    #[test]
    fn a_steady_drift_is_followed_through_noise_and_without_measurements() {
        use crate::base::random::{CounterRng, Stage};
        let mut rng = CounterRng::new(3, Stage::Test, &[]);
        let truth = |s: f64| [0.01, -0.02, 0.0, 0.3, 0.0, -0.2].map(|rate: f64| rate * s);
        let noise = both(0.005, 0.15);
        let mut walk = Walk::new(Drift::new([0.02, 0.3], 20.0, 1.0));
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
