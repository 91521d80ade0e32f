//! Vectors of three numbers, and rotations as quaternions.

use super::real::Real;

/// Short arrays, value by value: as `map`, which the compiler does not always inline, and takes long over each time.
pub trait Each: Copy {
    /// One value.
    type Value;
    /// As many of other values.
    type Of<B>;
    /// What `f` makes of each value.
    fn each<B>(self, f: impl FnMut(Self::Value) -> B) -> Self::Of<B>;
}

macro_rules! each {
    ($n:literal: $($k:literal)*) => {
        impl<A: Copy> Each for [A; $n] {
            type Value = A;
            type Of<B> = [B; $n];
            #[inline(always)]
            fn each<B>(self, mut f: impl FnMut(A) -> B) -> [B; $n] {
                [$(f(self[$k])),*]
            }
        }
    };
}

each!(2: 0 1);
each!(3: 0 1 2);
each!(4: 0 1 2 3);

/// `a . b`.
#[inline(always)]
pub fn dot<T: Real>(a: [T; 3], b: [T; 3]) -> T {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// `a x b`.
#[inline(always)]
pub fn cross<T: Real>(a: [T; 3], b: [T; 3]) -> [T; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// `a + b`.
#[inline(always)]
pub fn add<T: Real>(a: [T; 3], b: [T; 3]) -> [T; 3] {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

/// Columns of the rotation of a unit quaternion `w x y z`.
#[inline(always)]
pub fn rotation_columns<T: Real>([w, x, y, z]: [T; 4]) -> [[T; 3]; 3] {
    let (one, two) = (T::one(), T::of(2.0));
    [
        [one - two * (y * y + z * z), two * (x * y + w * z), two * (x * z - w * y)],
        [two * (x * y - w * z), one - two * (x * x + z * z), two * (y * z + w * x)],
        [two * (x * z + w * y), two * (y * z - w * x), one - two * (x * x + y * y)],
    ]
}

/// A quaternion of any length but 0 divided by its length, and 1 / length.
#[inline(always)]
pub fn normalized<T: Real>(q: [T; 4]) -> ([T; 4], T) {
    let squares = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3];
    if !(1e-30..1e30).contains(&squares.to_f64()) {
        return normalized_by_steps(q, squares);
    }
    let inverse = T::one() / squares.sqrt();
    (q.each(|v| v * inverse), inverse)
}

/// [`normalized`] where the `squares` are beyond the precision: of multiples by a power of two, which is exact.
#[cold]
fn normalized_by_steps<T: Real>(q: [T; 4], squares: T) -> ([T; 4], T) {
    if q.iter().all(|v| v.to_f64() == 0.0) || q.iter().any(|v| !v.is_finite()) {
        return ([T::of(f64::NAN); 4], T::of(f64::NAN));
    }
    // So short a step that it never leads from one side of the range to the other.
    const STEP: f64 = (1_u64 << 32) as f64;
    let step = T::of(if squares.to_f64() < 1.0 { STEP } else { 1.0 / STEP });
    let (unit, inverse) = normalized(q.each(|v| v * step));
    (unit, inverse * step)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::splat::number::Dual;

    fn demand_unit<T: Real>(scale: f64, tolerance: f64) {
        let (unit, inverse) = normalized([0.1, -0.7, 0.5, 0.5].map(|v| T::of(scale * v)));
        for (found, wanted) in unit.into_iter().zip([0.1, -0.7, 0.5, 0.5]) {
            assert!((found.to_f64() - wanted).abs() < tolerance, "{scale:e}: {unit:?}");
        }
        assert!((inverse.to_f64() * scale - 1.0).abs() < tolerance, "{scale:e}: {inverse:?}");
    }

    #[test]
    fn quaternions_of_any_length_are_normalized() {
        for exponent in -37..=37 {
            demand_unit::<f32>(10f64.powi(exponent), 1e-6);
            demand_unit::<Dual<f32>>(10f64.powi(exponent), 1e-6);
        }
        for exponent in -307..=307 {
            demand_unit::<f64>(10f64.powi(exponent), 1e-14);
        }
        for nowhere in [[0.0f32; 4], [f32::INFINITY, 0.0, 0.0, 0.0], [1.0, f32::NAN, 0.0, 0.0]] {
            assert!(!normalized(nowhere).0[0].is_finite());
        }
    }
}
