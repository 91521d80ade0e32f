//! Model of the error of given poses: a drifting correction `xi = (omega, tau)` in camera axes (rad, mm),
//! `camera_from_world = exp(xi) given`. Its change per second is an Ornstein-Uhlenbeck process with a time constant
//! of some seconds, like the drift of a tracker.

use nalgebra::DMatrix;

use crate::reconstruct::geometry::rigid::POSE;

/// Standard deviations of the correction after registering the first frame by depth: rad, mm.
const START_DEVIATION: [f64; 2] = [0.002, 0.03];
/// Standard deviation of the correction's change between frames that its rate does not explain, as a share of the
/// rate's standard deviation times the time.
const UNSTEADY: f64 = 0.05;

/// `turn` for the three angles, `shift` for the three translations.
fn per_unknown([turn, shift]: [f64; 2]) -> [f64; POSE] {
    [turn, turn, turn, shift, shift, shift]
}

/// How the correction of the poses drifts.
#[derive(Clone, Copy, Debug)]
pub struct PoseDrift {
    /// Standard deviations of the rates, per second.
    rates: [f64; POSE],
    /// Time constant of the rates, s.
    steady_s: f64,
    /// The information of an image is divided by the square of this: model errors resemble a motion and persist
    /// over many frames.
    pub caution: f64,
}

impl PoseDrift {
    /// From the standard deviations of the changes per second (`[rad, mm]`), their time constant in seconds, and
    /// [`PoseDrift::caution`].
    pub fn new(rate: [f64; 2], steady_s: f64, caution: f64) -> PoseDrift {
        PoseDrift { rates: per_unknown(rate), steady_s, caution }
    }

    /// Variances of the correction and of its rates at the first frame, after its registration by depth.
    pub fn start_variances(&self) -> [f64; 2 * POSE] {
        let start = per_unknown(START_DEVIATION);
        std::array::from_fn(|k| if k < POSE { start[k] } else { self.rates[k - POSE] }.powi(2))
    }

    /// Transition of the correction and its rates over `seconds`: `xi += s xi'`, `xi' *= exp(-s / steady)`.
    pub fn transition(&self, seconds: f64) -> DMatrix<f64> {
        let mut step = DMatrix::identity(2 * POSE, 2 * POSE);
        for k in 0..POSE {
            step[(k, POSE + k)] = seconds;
            step[(POSE + k, POSE + k)] = (-seconds / self.steady_s).exp();
        }
        step
    }

    /// Variances that `seconds` add: `(UNSTEADY rate s)^2` to the correction, `rate^2 (1 - exp(-2 s / steady))` to a
    /// rate.
    pub fn noise(&self, seconds: f64) -> [f64; 2 * POSE] {
        let kept = (-seconds / self.steady_s).exp();
        std::array::from_fn(|k| {
            let rate = self.rates[k % POSE];
            if k < POSE { (UNSTEADY * rate * seconds).powi(2) } else { rate * rate * (1.0 - kept * kept) }
        })
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::DVector;

    use super::*;

    /// Rates that are forgotten keep their variance, and two steps add the same noise to them as one of both.
    #[test]
    fn rates_are_stationary_and_steps_can_be_parted() {
        let drift = PoseDrift::new([0.01, 0.2], 4.0, 1.0);
        let rates = |state: &DMatrix<f64>| -> Vec<f64> { (POSE..2 * POSE).map(|k| state[(k, k)]).collect() };
        let after = |state: &DMatrix<f64>, seconds: f64| {
            let step = drift.transition(seconds);
            &step * state * step.transpose()
                + DMatrix::from_diagonal(&DVector::from_column_slice(&drift.noise(seconds)))
        };
        let start = DMatrix::from_diagonal(&DVector::from_column_slice(&drift.start_variances()));
        let known = DMatrix::zeros(2 * POSE, 2 * POSE);
        for (a, b) in rates(&after(&start, 0.7)).into_iter().zip(rates(&start)) {
            assert!((a / b - 1.0).abs() < 1e-12, "{a} {b}");
        }
        for (a, b) in rates(&after(&after(&known, 0.5), 1.5)).into_iter().zip(rates(&after(&known, 2.0))) {
            assert!((a / b - 1.0).abs() < 1e-12, "{a} {b}");
        }
    }
}
