//! The breathing phase as an unbounded-looking parameter: cosine plus linear leak (the paper's Eq. 3).
//!
//! `alpha = (1 - eps) (1 - cos theta) / 2 + eps theta / pi`, theta in [0, pi], eps = 0.05: monotonic, exact at both
//! ends, and its slope never falls below `eps / pi`.

use std::f64::consts::PI;

/// The activation with its leak `eps`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PhaseActivation {
    /// Share of the linear term; the paper's value is 0.05.
    pub leak: f64,
}

impl PhaseActivation {
    /// Phase of `theta`; theta is clamped to [0, pi].
    pub fn phase(self, theta: f64) -> f64 {
        let theta = theta.clamp(0.0, PI);
        (1.0 - self.leak) * 0.5 * (1.0 - theta.cos()) + self.leak * theta / PI
    }

    /// `d phase / d theta`.
    pub fn slope(self, theta: f64) -> f64 {
        let theta = theta.clamp(0.0, PI);
        (1.0 - self.leak) * 0.5 * theta.sin() + self.leak / PI
    }

    /// The theta whose phase is `phase` (clamped to [0, 1]): bisection to the last bits, since the function is
    /// monotonic.
    pub fn theta(self, phase: f64) -> f64 {
        let phase = phase.clamp(0.0, 1.0);
        let (mut low, mut high) = (0.0, PI);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if self.phase(middle) < phase {
                low = middle;
            } else {
                high = middle;
            }
        }
        0.5 * (low + high)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ACTIVATION: PhaseActivation = PhaseActivation { leak: 0.05 };

    #[test]
    fn ends_are_exact_and_the_slope_never_dies() {
        assert_eq!(ACTIVATION.phase(0.0), 0.0);
        assert!((ACTIVATION.phase(PI) - 1.0).abs() < 1e-15);
        assert!((ACTIVATION.phase(PI / 2.0) - 0.5).abs() < 1e-15);
        for i in 0..=1000 {
            let theta = PI * i as f64 / 1000.0;
            assert!(ACTIVATION.slope(theta) >= 0.05 / PI - 1e-12);
            if i > 0 && i < 1000 {
                let difference = (ACTIVATION.phase(theta + 1e-6) - ACTIVATION.phase(theta - 1e-6)) / 2e-6;
                assert!((difference - ACTIVATION.slope(theta)).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn inverse_inverts() {
        for i in 0..=200 {
            let phase = i as f64 / 200.0;
            assert!((ACTIVATION.phase(ACTIVATION.theta(phase)) - phase).abs() < 1e-12);
        }
    }
}
