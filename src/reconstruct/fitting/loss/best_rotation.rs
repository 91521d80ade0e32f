//! The rotations that carry sets of vectors `e` onto vectors `d` best, [`LANES`] sets side by side, so that the compiler
//! makes vector instructions of them: nearly all of their time is divisions and chains of dependent operations.
//!
//! Horn's quaternion method (1987): the eigenvector of the largest eigenvalue of a 4x4 matrix, the eigenvalue by Newton's
//! method on the characteristic polynomial (Theobald 2005), the vector from the adjugate. It is the rotation of the SVD
//! with the sign fix, at a fraction of its cost. Lanes do not know of each other, and no operation is fused or reordered:
//! a set gives the same bytes in any lane beside any others, on any processor.

use std::ops::{Add, Mul, Neg, Sub};

use glam::{DMat3, DVec3};

/// Sets side by side.
pub const LANES: usize = 4;

/// One number of each set.
#[derive(Clone, Copy, Debug)]
struct Lanes([f64; LANES]);

impl Lanes {
    #[inline(always)]
    fn of(value: f64) -> Self {
        Lanes([value; LANES])
    }

    #[inline(always)]
    fn zip(self, other: Self, f: impl Fn(f64, f64) -> f64) -> Self {
        let mut out = [0.0; LANES];
        for lane in 0..LANES {
            out[lane] = f(self.0[lane], other.0[lane]);
        }
        Lanes(out)
    }

    /// This number where `chosen`, which is 1 or 0, is not 0; the other one elsewhere.
    #[inline(always)]
    fn where_chosen(self, chosen: Self, other: Self) -> Self {
        let mut out = other.0;
        for lane in 0..LANES {
            out[lane] = if chosen.0[lane] != 0.0 { self.0[lane] } else { other.0[lane] };
        }
        Lanes(out)
    }

    /// 1 where this is less than the other, 0 elsewhere and where either is not a number.
    #[inline(always)]
    fn below(self, other: Self) -> Self {
        self.zip(other, |a, b| if a < b { 1.0 } else { 0.0 })
    }

    #[inline(always)]
    fn absolute(self) -> Self {
        self.zip(self, |a, _| a.abs())
    }

    #[inline(always)]
    fn inverse_root(self) -> Self {
        self.zip(self, |a, _| a.sqrt().recip())
    }

    #[inline(always)]
    fn over(self, other: Self) -> Self {
        self.zip(other, |a, b| a / b)
    }
}

impl Add for Lanes {
    type Output = Lanes;
    #[inline(always)]
    fn add(self, other: Lanes) -> Lanes {
        self.zip(other, |a, b| a + b)
    }
}

impl Sub for Lanes {
    type Output = Lanes;
    #[inline(always)]
    fn sub(self, other: Lanes) -> Lanes {
        self.zip(other, |a, b| a - b)
    }
}

impl Mul for Lanes {
    type Output = Lanes;
    #[inline(always)]
    fn mul(self, other: Lanes) -> Lanes {
        self.zip(other, |a, b| a * b)
    }
}

impl Neg for Lanes {
    type Output = Lanes;
    #[inline(always)]
    fn neg(self) -> Lanes {
        self.zip(self, |a, _| -a)
    }
}

/// What the rotations of [`LANES`] sets follow from.
#[derive(Clone, Copy, Debug)]
pub struct Fits {
    /// `sum e_row d_column`, column by column.
    covariance: [Lanes; 9],
    /// Half the sum of all squared lengths: an upper bound of the largest eigenvalue.
    bound: Lanes,
}

impl Default for Fits {
    /// Sets without a vector, whose rotation is the identity.
    fn default() -> Self {
        Fits { covariance: [Lanes::of(0.0); 9], bound: Lanes::of(0.0) }
    }
}

impl Fits {
    /// Puts a set into a lane: `covariance[row a, column b] = sum e_a d_b`, and half the sum of all squared lengths.
    #[inline(always)]
    pub fn set(&mut self, lane: usize, covariance: &DMat3, half_squares: f64) {
        for (to, value) in self.covariance.iter_mut().zip(covariance.to_cols_array()) {
            to.0[lane] = value;
        }
        self.bound.0[lane] = half_squares;
    }
}

/// The rotation `R` of each set that minimises `sum |d - R e|^2`. Identity where none is better than another.
#[inline(always)]
pub fn best_rotations(fits: &Fits) -> [DMat3; LANES] {
    let of = Lanes::of;
    let [xx, yx, zx, xy, yy, zy, xz, yz, zz] = fits.covariance;
    let bound = fits.bound;
    // Horn's symmetric matrix, upper triangle.
    let n = [
        [xx + yy + zz, yz - zy, zx - xz, xy - yx],
        [yz - zy, xx - yy - zz, xy + yx, zx + xz],
        [zx - xz, xy + yx, yy - xx - zz, yz + zy],
        [xy - yx, zx + xz, yz + zy, zz - xx - yy],
    ];
    // Characteristic polynomial l^4 + c2 l^2 + c1 l + c0, and its largest root from above by Newton.
    let squares = xx * xx + xy * xy + xz * xz + yx * yx + yy * yy + yz * yz + zx * zx + zy * zy + zz * zz;
    let c2 = of(-2.0) * squares;
    let determinant = xz * (yx * zy - yy * zx) + yz * (zx * xy - zy * xx) + zz * (xx * yy - xy * yx);
    let c1 = of(-8.0) * determinant;
    let c0 = minor_determinants(&n).1;
    let tolerance = of(1e-13) * bound;
    let (mut lambda, mut goes_on) = (bound, of(1.0));
    for _ in 0..50 {
        let square = lambda * lambda;
        let value = (square + c2) * square + c1 * lambda + c0;
        let slope = (of(4.0) * square + of(2.0) * c2) * lambda + c1;
        let step = value.over(slope);
        goes_on = of(0.0).where_chosen(slope.absolute().below(of(1e-300)), goes_on);
        lambda = (lambda - step).where_chosen(goes_on, lambda);
        goes_on = of(0.0).where_chosen(step.absolute().below(tolerance), goes_on);
        if goes_on.0 == [0.0; LANES] {
            break;
        }
    }
    // Eigenvector: the largest row of the adjugate of N - l.
    let mut shifted = n;
    for (i, row) in shifted.iter_mut().enumerate() {
        row[i] = row[i] - lambda;
    }
    let adjugate = minor_determinants(&shifted).0;
    let mut best = adjugate[0];
    let mut largest = squared(&best);
    for row in &adjugate[1..] {
        let size = squared(row);
        let is_larger = largest.below(size);
        for (best, value) in best.iter_mut().zip(row) {
            *best = value.where_chosen(is_larger, *best);
        }
        largest = size.where_chosen(is_larger, largest);
    }
    let cube = bound * bound * bound;
    let is_vague = largest.below(of(1e-20) * (cube * cube));
    let is_nothing = bound.below(of(1e-300));
    let [w, x, y, z] = best;
    let inverse = (x * x + y * y + z * z + w * w).inverse_root();
    let identity = [of(1.0), of(0.0), of(0.0), of(0.0)];
    let [w, x, y, z] = [0, 1, 2, 3].map(|k| {
        let unit = [w, x, y, z][k] * inverse;
        identity[k].where_chosen(is_nothing, identity[k].where_chosen(is_vague, unit))
    });
    turns(w, x, y, z)
}

/// The matrices of unit quaternions.
#[inline(always)]
fn turns(w: Lanes, x: Lanes, y: Lanes, z: Lanes) -> [DMat3; LANES] {
    let one = Lanes::of(1.0);
    let (x2, y2, z2) = (x + x, y + y, z + z);
    let (xx, xy, xz, yy, yz, zz) = (x * x2, x * y2, x * z2, y * y2, y * z2, z * z2);
    let (wx, wy, wz) = (w * x2, w * y2, w * z2);
    let columns =
        [[one - (yy + zz), xy + wz, xz - wy], [xy - wz, one - (xx + zz), yz + wx], [xz + wy, yz - wx, one - (xx + yy)]];
    let mut out = [DMat3::IDENTITY; LANES];
    for (lane, out) in out.iter_mut().enumerate() {
        let [a, b, c] = [0, 1, 2].map(|k| columns[k].map(|value| value.0[lane]));
        *out = DMat3::from_cols(DVec3::from(a), DVec3::from(b), DVec3::from(c));
    }
    out
}

#[inline(always)]
fn squared(row: &[Lanes; 4]) -> Lanes {
    row[0] * row[0] + row[1] * row[1] + row[2] * row[2] + row[3] * row[3]
}

/// Adjugate and determinant of a symmetric 4x4 matrix, by 2x2 minors. Inlined, so that a caller pays for what it uses.
#[inline(always)]
fn minor_determinants(m: &[[Lanes; 4]; 4]) -> ([[Lanes; 4]; 4], Lanes) {
    let minor = |r0: usize, r1: usize, a: usize, b: usize| m[r0][a] * m[r1][b] - m[r0][b] * m[r1][a];
    let s = [
        minor(0, 1, 0, 1),
        minor(0, 1, 0, 2),
        minor(0, 1, 0, 3),
        minor(0, 1, 1, 2),
        minor(0, 1, 1, 3),
        minor(0, 1, 2, 3),
    ];
    let c = [
        minor(2, 3, 0, 1),
        minor(2, 3, 0, 2),
        minor(2, 3, 0, 3),
        minor(2, 3, 1, 2),
        minor(2, 3, 1, 3),
        minor(2, 3, 2, 3),
    ];
    let determinant = s[0] * c[5] - s[1] * c[4] + s[2] * c[3] + s[3] * c[2] - s[4] * c[1] + s[5] * c[0];
    let adjugate = [
        [
            m[1][1] * c[5] - m[1][2] * c[4] + m[1][3] * c[3],
            -m[0][1] * c[5] + m[0][2] * c[4] - m[0][3] * c[3],
            m[3][1] * s[5] - m[3][2] * s[4] + m[3][3] * s[3],
            -m[2][1] * s[5] + m[2][2] * s[4] - m[2][3] * s[3],
        ],
        [
            -m[1][0] * c[5] + m[1][2] * c[2] - m[1][3] * c[1],
            m[0][0] * c[5] - m[0][2] * c[2] + m[0][3] * c[1],
            -m[3][0] * s[5] + m[3][2] * s[2] - m[3][3] * s[1],
            m[2][0] * s[5] - m[2][2] * s[2] + m[2][3] * s[1],
        ],
        [
            m[1][0] * c[4] - m[1][1] * c[2] + m[1][3] * c[0],
            -m[0][0] * c[4] + m[0][1] * c[2] - m[0][3] * c[0],
            m[3][0] * s[4] - m[3][1] * s[2] + m[3][3] * s[0],
            -m[2][0] * s[4] + m[2][1] * s[2] - m[2][3] * s[0],
        ],
        [
            -m[1][0] * c[3] + m[1][1] * c[1] - m[1][2] * c[0],
            m[0][0] * c[3] - m[0][1] * c[1] + m[0][2] * c[0],
            -m[3][0] * s[3] + m[3][1] * s[1] - m[3][2] * s[0],
            m[2][0] * s[3] - m[2][1] * s[1] + m[2][2] * s[0],
        ],
    ];
    (adjugate, determinant)
}

#[cfg(test)]
mod tests {
    use glam::DQuat;

    use super::*;
    use crate::base::random::{CounterRng, Stage};

    /// The rotation of one set, in whichever lane.
    fn alone(covariance: &DMat3, half_squares: f64) -> DMat3 {
        let of_lane = |lane: usize| {
            let mut fits = Fits::default();
            fits.set(lane, covariance, half_squares);
            let all = best_rotations(&fits);
            assert!(all.iter().enumerate().all(|(k, r)| k == lane || *r == DMat3::IDENTITY));
            all[lane]
        };
        let found = of_lane(0);
        assert_eq!(of_lane(3), found);
        found
    }

    fn random_vector(rng: &mut CounterRng) -> DVec3 {
        DVec3::new(rng.normal(), rng.normal(), rng.normal())
    }

    #[test]
    fn rotation_is_that_of_the_svd() {
        let mut rng = CounterRng::new(1, Stage::Test, &[]);
        for case in 0..2000 {
            let (mut s, mut size) = (DMat3::ZERO, 0.0);
            let turn = DQuat::from_scaled_axis(random_vector(&mut rng));
            let flat = if case % 3 == 0 { 1e-7 } else { 1.0 };
            let mirror = if case % 5 == 0 { -1.0 } else { 1.0 };
            for _ in 0..6 {
                let e = random_vector(&mut rng) * DVec3::new(1.0, 1.0, flat);
                let d = turn * (e * DVec3::new(1.0, 1.0, mirror)) + random_vector(&mut rng) * 0.1;
                s += DMat3::from_cols(e * d.x, e * d.y, e * d.z);
                size += e.length_squared() + d.length_squared();
            }
            let got = alone(&s, 0.5 * size);
            let matrix = nalgebra::Matrix3::from_column_slice(&s.to_cols_array());
            let svd = matrix.svd(true, true);
            let (u, mut v) = (svd.u.unwrap(), svd.v_t.unwrap().transpose());
            if (v * u.transpose()).determinant() < 0.0 {
                let last = svd.singular_values.imin();
                v.column_mut(last).neg_mut();
            }
            let want = DMat3::from_cols_slice((v * u.transpose()).as_slice());
            // Compare the fit, not the rotation: two rotations may tie when the two smallest singular values vanish.
            let gain = |r: DMat3| (r * s).to_cols_array()[0] + (r * s).y_axis.y + (r * s).z_axis.z;
            assert!((gain(got) - gain(want)).abs() < 1e-9 * size, "case {case}: {got} {want}");
            assert!((got.determinant() - 1.0).abs() < 1e-9);
        }
    }
}
