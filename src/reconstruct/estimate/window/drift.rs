//! How given poses are wrong: by a correction `xi = (omega, tau)` in camera axes (rad, mm),
//! `camera_from_world = exp(xi) given`, that drifts. Its change per second is as steady as that of a tracker:
//! it forgets itself within some seconds (Ornstein-Uhlenbeck).

use nalgebra::DMatrix;

use crate::reconstruct::geometry::rigid::POSE;

/// Standard deviation of what the first frame's depth tells: rad, mm.
const START_DEVIATION: [f64; 2] = [0.002, 0.03];
/// How unsteady a drift is from frame to frame, as a share of itself.
const UNSTEADY: f64 = 0.05;

/// Angles as `turn`, places as `shift`.
fn per_unknown([turn, shift]: [f64; 2]) -> [f64; POSE] {
    [turn, turn, turn, shift, shift, shift]
}

/// How the correction of the poses drifts.
#[derive(Clone, Copy, Debug)]
pub struct PoseDrift {
    /// Standard deviations of the rates, per second.
    rates: [f64; POSE],
    /// Seconds within which a rate changes.
    steady_s: f64,
    /// The square root of what the information of an image is divided by: what a model of it gets wrong looks
    /// like a motion, and stays the same for many frames.
    pub caution: f64,
}

impl PoseDrift {
    /// From how large the changes per second are (`[rad, mm]`), how long they last, and how much more an image
    /// errs than it says.
    pub fn new(rate: [f64; 2], steady_s: f64, caution: f64) -> PoseDrift {
        PoseDrift { rates: per_unknown(rate), steady_s, caution }
    }

    /// Variances of the correction and of its rates at the first frame, whose depth has told the correction.
    pub fn start_variances(&self) -> [f64; 2 * POSE] {
        let start = per_unknown(START_DEVIATION);
        std::array::from_fn(|k| if k < POSE { start[k] } else { self.rates[k - POSE] }.powi(2))
    }

    /// What `seconds` do to the correction and its rates: `xi += s xi'`, `xi' *= exp(-s / steady)`.
    pub fn transition(&self, seconds: f64) -> DMatrix<f64> {
        let mut step = DMatrix::identity(2 * POSE, 2 * POSE);
        for k in 0..POSE {
            step[(k, POSE + k)] = seconds;
            step[(POSE + k, POSE + k)] = (-seconds / self.steady_s).exp();
        }
        step
    }

    /// The variances that they add: `rate^2 (1 - exp(-2 s / steady))` to a rate.
    pub fn noise(&self, seconds: f64) -> [f64; 2 * POSE] {
        let kept = (-seconds / self.steady_s).exp();
        std::array::from_fn(|k| {
            let rate = self.rates[k % POSE];
            if k < POSE { (UNSTEADY * rate * seconds).powi(2) } else { rate * rate * (1.0 - kept * kept) }
        })
    }
}
