//! Numbers that the rasteriser computes with: `f32` for work, `f64` to be checked against, [`super::Dual`] of either
//! for forward-mode derivatives. One generic source serves all of them.

use std::fmt::Debug;
use std::ops::{Add, AddAssign, Div, Mul, MulAssign, Neg, Sub, SubAssign};

/// A real number.
pub trait Real:
    Copy
    + Debug
    + Default
    + PartialEq
    + PartialOrd
    + Send
    + Sync
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + AddAssign
    + SubAssign
    + MulAssign
    + 'static
{
    /// Whether the number has no derivative, so that values may be computed in double and rounded.
    const PLAIN: bool = false;
    /// The nearest number to `value`.
    fn of(value: f64) -> Self;
    /// The value (without any derivative) as `f64`.
    fn to_f64(self) -> f64;
    /// Square root.
    fn sqrt(self) -> Self;
    /// `2^self`.
    fn exp2(self) -> Self;
    /// `e^self`.
    fn exp(self) -> Self;
    /// Logarithm to base 2.
    fn log2(self) -> Self;
    /// Angle of the vector `(x, self)`.
    fn atan2(self, x: Self) -> Self;
    /// Neither infinite nor NaN.
    fn is_finite(self) -> bool;

    /// Zero.
    #[inline(always)]
    fn zero() -> Self {
        Self::of(0.0)
    }

    /// One.
    #[inline(always)]
    fn one() -> Self {
        Self::of(1.0)
    }

    /// The smaller of two numbers, `other` where `self` is NaN.
    #[inline(always)]
    fn minimum(self, other: Self) -> Self {
        if self < other { self } else { other }
    }

    /// The larger of two numbers, `other` where `self` is NaN.
    #[inline(always)]
    fn maximum(self, other: Self) -> Self {
        if self > other { self } else { other }
    }

    /// The number itself, or 0 where it is infinite or NaN.
    #[inline(always)]
    fn finite_or_zero(self) -> Self {
        if self.is_finite() { self } else { Self::zero() }
    }
}

macro_rules! real_functions {
    ($t:ty) => {
        #[inline(always)]
        fn of(value: f64) -> Self {
            value as $t
        }
        #[inline(always)]
        fn to_f64(self) -> f64 {
            self as f64
        }
        #[inline(always)]
        fn sqrt(self) -> Self {
            <$t>::sqrt(self)
        }
        #[inline(always)]
        fn exp2(self) -> Self {
            <$t>::exp2(self)
        }
        #[inline(always)]
        fn exp(self) -> Self {
            <$t>::exp(self)
        }
        #[inline(always)]
        fn log2(self) -> Self {
            <$t>::log2(self)
        }
        #[inline(always)]
        fn atan2(self, x: Self) -> Self {
            <$t>::atan2(self, x)
        }
        #[inline(always)]
        fn is_finite(self) -> bool {
            <$t>::is_finite(self)
        }
    };
}

impl Real for f64 {
    const PLAIN: bool = true;
    real_functions!(f64);
}

impl Real for f32 {
    const PLAIN: bool = true;
    real_functions!(f32);
}
