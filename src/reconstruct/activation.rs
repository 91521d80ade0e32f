//! The breathing phase as a function of an optimised parameter theta in [0, pi].
//!
//! The paper's choice (Eq. 3) is the cosine plus a linear leak,
//! `alpha = (1 - eps) (1 - cos theta) / 2 + eps theta / pi` with eps = 0.05: monotonic, exact at both ends, and
//! its slope never falls below `eps / pi`. The two others are what the paper argues against, for ablations;
//! both keep theta's range, so that one rate serves all three.

use std::f64::consts::PI;

use serde::{Deserialize, Serialize};

/// Which function.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Activation {
    /// Cosine plus linear leak (Eq. 3).
    CosineLeak,
    /// `1 / (1 + exp(pi - 2 theta))`: as steep as the cosine in the middle, saturates near full inspiration and
    /// expiration (.04 and .96 at the ends of theta's range, which it may leave by 2).
    Sigmoid,
    /// `theta / pi`, cut off: no slope beyond the ends.
    Clamp,
}

/// How far the sigmoid's theta may leave [0, pi]: phases of .001 and .999.
const SIGMOID_ROOM: f64 = 2.0;

/// The activation with its leak `eps`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PhaseActivation {
    /// Which function.
    pub kind: Activation,
    /// Share of the linear term of [`Activation::CosineLeak`]; the paper's value is 0.05.
    pub leak: f64,
}

impl PhaseActivation {
    /// Least and greatest theta.
    pub fn range(self) -> [f64; 2] {
        match self.kind {
            Activation::Sigmoid => [-SIGMOID_ROOM, PI + SIGMOID_ROOM],
            Activation::CosineLeak | Activation::Clamp => [0.0, PI],
        }
    }

    fn clamped(self, theta: f64) -> f64 {
        let [low, high] = self.range();
        theta.clamp(low, high)
    }

    /// Phase of `theta`; theta is clamped to its range.
    pub fn phase(self, theta: f64) -> f64 {
        let theta = self.clamped(theta);
        match self.kind {
            Activation::CosineLeak => (1.0 - self.leak) * 0.5 * (1.0 - theta.cos()) + self.leak * theta / PI,
            Activation::Sigmoid => 1.0 / (1.0 + (PI - 2.0 * theta).exp()),
            Activation::Clamp => theta / PI,
        }
    }

    /// `d phase / d theta`.
    pub fn slope(self, theta: f64) -> f64 {
        let theta = self.clamped(theta);
        match self.kind {
            Activation::CosineLeak => (1.0 - self.leak) * 0.5 * theta.sin() + self.leak / PI,
            Activation::Sigmoid => {
                let phase = self.phase(theta);
                2.0 * phase * (1.0 - phase)
            }
            Activation::Clamp => 1.0 / PI,
        }
    }

    /// The theta whose phase is `phase` (clamped to what the range of theta reaches): bisection to the last
    /// bits, since the function is monotonic.
    pub fn theta(self, phase: f64) -> f64 {
        let [mut low, mut high] = self.range();
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

    const ACTIVATION: PhaseActivation = PhaseActivation { kind: Activation::CosineLeak, leak: 0.05 };

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

    #[test]
    fn the_alternatives_do_what_the_paper_says_of_them() {
        let of = |kind| PhaseActivation { kind, leak: 0.05 };
        let (sigmoid, clamp) = (of(Activation::Sigmoid), of(Activation::Clamp));
        for activation in [sigmoid, clamp] {
            for i in 1..100 {
                let (phase, h) = (i as f64 / 100.0, 1e-6);
                let theta = activation.theta(phase);
                assert!((activation.phase(theta) - phase).abs() < 1e-12);
                let difference = (activation.phase(theta + h) - activation.phase(theta - h)) / (2.0 * h);
                assert!((difference - activation.slope(theta)).abs() < 1e-8, "{activation:?} {phase}");
            }
        }
        // Saturation near the clinically important ends: a quarter of the cosine's slope at phase .01, and both
        // ends out of reach.
        let at = |a: PhaseActivation, phase: f64| a.slope(a.theta(phase));
        assert!(at(sigmoid, 0.01) < 0.25 * at(ACTIVATION, 0.01));
        assert!(sigmoid.phase(-10.0) > 0.0 && sigmoid.phase(10.0) < 1.0);
        assert_eq!((clamp.phase(-1.0), clamp.phase(4.0)), (0.0, 1.0));
    }
}
