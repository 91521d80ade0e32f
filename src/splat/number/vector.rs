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

/// A quaternion divided by its length, and 1 / length.
#[inline(always)]
pub fn normalized<T: Real>(q: [T; 4]) -> ([T; 4], T) {
    let inverse = T::one() / (q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]).sqrt();
    (q.each(|v| v * inverse), inverse)
}
