//! What a difference `d` between a rendered and an observed value costs. Both robust norms are scaled to the slope of L1
//! far from 0, so that weights keep their meaning whichever is chosen:
//!
//! | norm | cost | slope | far from 0 |
//! |---|---|---|---|
//! | `L1` | `abs d` | `sign d` | itself |
//! | `Charbonnier(e)` (Charbonnier et al. 1994) | `sqrt(d^2 + e^2) - e` | `d / sqrt(d^2 + e^2)` | `abs d - e` |
//! | `Huber(e)` (Huber 1964, divided by `e`) | `d^2 / 2e` up to `e`, then `abs d - e / 2` | `d / e`, then `sign d` | `abs d - e / 2` |

use serde::{Deserialize, Serialize};

use crate::base::{Error, Result};

use super::photometric::Scalar;

/// The norm of the photometric loss; the numbers are encoded values in `[0, 1]`. In a method's file `"l1"`,
/// `{ charbonnier = 0.01 }` or `{ huber = 0.02 }`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Norm {
    /// As published.
    #[default]
    L1,
    /// Smooth everywhere: quadratic within about so much of 0.
    Charbonnier(f64),
    /// Quadratic within so much of 0.
    Huber(f64),
}

impl Norm {
    /// Errors when the number is not positive and finite.
    pub fn validate(self) -> Result<()> {
        match self {
            Norm::L1 => Ok(()),
            Norm::Charbonnier(e) | Norm::Huber(e) if e.is_finite() && e > 0.0 => Ok(()),
            Norm::Charbonnier(e) | Norm::Huber(e) => {
                Err(Error::input(format!("a norm needs a positive number, not {e}")).element("color_norm"))
            }
        }
    }

    /// As the kernel knows it: which, and its number.
    pub(super) fn code(self) -> (u8, f32) {
        match self {
            Norm::L1 => (0, 1.0),
            Norm::Charbonnier(e) => (1, e as f32),
            Norm::Huber(e) => (2, e as f32),
        }
    }

    /// Cost and slope at `d`.
    #[inline(always)]
    pub(super) fn at<T: Scalar>(self, d: T) -> (T, T) {
        let (zero, one) = (T::default(), T::from(1.0));
        let (size, sign) = match (d > zero, d < zero) {
            (true, _) => (d, one),
            (_, true) => (zero - d, zero - one),
            _ => (d, zero),
        };
        let e = T::from(self.code().1);
        match self {
            Norm::L1 => (size, sign),
            Norm::Charbonnier(_) => {
                let root = (d * d + e * e).root();
                // Not the difference of two large numbers.
                (d * d / (root + e), d / root)
            }
            Norm::Huber(_) if size < e => (d * d / (e + e), d / e),
            Norm::Huber(_) => (size - e / T::from(2.0), sign),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn robust_norms_are_quadratic_at_zero_and_have_the_slope_of_l1_far_away() {
        for norm in [Norm::Charbonnier(0.02), Norm::Huber(0.02)] {
            let (cost, slope) = norm.at(1e-4f64);
            assert!((cost / (1e-8 / 0.04) - 1.0).abs() < 1e-4 && (slope / (1e-4 / 0.02) - 1.0).abs() < 1e-4);
            let (cost, slope) = norm.at(-1.0f64);
            assert!((cost - 1.0).abs() < 0.02 && (slope + 1.0).abs() < 3e-4, "{cost} {slope}");
            assert_eq!(norm.at(0.0), (0.0, 0.0));
        }
        assert_eq!((Norm::L1.at(-0.5), Norm::L1.at(0.0)), ((0.5, -1.0), (0.0, 0.0)));
    }

    #[test]
    fn a_number_that_makes_no_norm_is_refused() {
        assert!(Norm::L1.validate().is_ok() && Norm::Huber(0.01).validate().is_ok());
        for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(Norm::Huber(bad).validate().is_err() && Norm::Charbonnier(bad).validate().is_err());
        }
    }
}
