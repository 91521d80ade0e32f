//! Dual numbers `value + derivative * e`, `e^2 = 0`: forward-mode differentiation of the rendering code itself.
//! Comparisons use the value alone, so that a dual render takes the same decisions as a plain one.

use std::cmp::Ordering;
use std::ops::{Add, AddAssign, Div, Mul, MulAssign, Neg, Sub, SubAssign};

use super::real::Real;

/// A number and its derivative with respect to one parameter.
#[derive(Clone, Copy, Debug, Default)]
pub struct Dual<T> {
    /// The number.
    pub value: T,
    /// Its derivative.
    pub derivative: T,
}

impl<T: Real> Dual<T> {
    /// A number that moves with speed `derivative`.
    pub fn new(value: T, derivative: T) -> Self {
        Dual { value, derivative }
    }

    /// A number that does not move.
    pub fn constant(value: T) -> Self {
        Dual { value, derivative: T::zero() }
    }
}

impl<T: Real> PartialEq for Dual<T> {
    fn eq(&self, other: &Self) -> bool {
        self.value == other.value
    }
}

impl<T: Real> PartialOrd for Dual<T> {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        self.value.partial_cmp(&other.value)
    }
}

impl<T: Real> Add for Dual<T> {
    type Output = Self;
    fn add(self, o: Self) -> Self {
        Dual::new(self.value + o.value, self.derivative + o.derivative)
    }
}

impl<T: Real> Sub for Dual<T> {
    type Output = Self;
    fn sub(self, o: Self) -> Self {
        Dual::new(self.value - o.value, self.derivative - o.derivative)
    }
}

impl<T: Real> Mul for Dual<T> {
    type Output = Self;
    fn mul(self, o: Self) -> Self {
        Dual::new(self.value * o.value, self.derivative * o.value + self.value * o.derivative)
    }
}

impl<T: Real> Div for Dual<T> {
    type Output = Self;
    fn div(self, o: Self) -> Self {
        let quotient = self.value / o.value;
        Dual::new(quotient, (self.derivative - quotient * o.derivative) / o.value)
    }
}

impl<T: Real> Neg for Dual<T> {
    type Output = Self;
    fn neg(self) -> Self {
        Dual::new(-self.value, -self.derivative)
    }
}

impl<T: Real> AddAssign for Dual<T> {
    fn add_assign(&mut self, o: Self) {
        *self = *self + o;
    }
}

impl<T: Real> SubAssign for Dual<T> {
    fn sub_assign(&mut self, o: Self) {
        *self = *self - o;
    }
}

impl<T: Real> MulAssign for Dual<T> {
    fn mul_assign(&mut self, o: Self) {
        *self = *self * o;
    }
}

impl<T: Real> Real for Dual<T> {
    fn of(value: f64) -> Self {
        Dual::constant(T::of(value))
    }

    fn to_f64(self) -> f64 {
        self.value.to_f64()
    }

    fn sqrt(self) -> Self {
        let root = self.value.sqrt();
        // At zero the slope is infinite; lengths that vanish have no direction, so none is reported.
        let slope = if root > T::zero() { T::of(0.5) / root } else { T::zero() };
        Dual::new(root, self.derivative * slope)
    }

    fn exp2(self) -> Self {
        let power = self.value.exp2();
        Dual::new(power, self.derivative * power * T::of(std::f64::consts::LN_2))
    }

    fn exp(self) -> Self {
        let power = self.value.exp();
        Dual::new(power, self.derivative * power)
    }

    fn log2(self) -> Self {
        Dual::new(self.value.log2(), self.derivative / (self.value * T::of(std::f64::consts::LN_2)))
    }

    fn atan2(self, x: Self) -> Self {
        let square = self.value * self.value + x.value * x.value;
        Dual::new(self.value.atan2(x.value), (self.derivative * x.value - self.value * x.derivative) / square)
    }

    fn is_finite(self) -> bool {
        self.value.is_finite() && self.derivative.is_finite()
    }
}
