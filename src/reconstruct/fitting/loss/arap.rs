//! As-rigid-as-possible energy of a mesh (Sorkine and Alexa 2007) as BridgeSplat uses it: uniform weights,
//! summed over all vertices and both directions of every edge,
//! `E = sum_i sum_{j in N(i)} |(p'_i - p'_j) - R_i (p_i - p_j)|^2`, with `R_i` the rotation that fits the
//! neighbourhood of `i` best, and the gradient with rotations held fixed (exact, since the energy is stationary
//! in them): `dE/dp'_i = sum_j 4 ((p'_i - p'_j) - (R_i + R_j)/2 (p_i - p_j))`.
//!
//! The best rotation is found by Horn's quaternion method (1987): the eigenvector of the largest eigenvalue of a 4x4
//! matrix, the eigenvalue by Newton's method on the characteristic polynomial (Theobald 2005), the vector from the
//! adjugate. It is the rotation of the SVD with the sign fix, at a fraction of its cost.

use glam::{DMat3, DQuat, DVec3};
use rayon::prelude::*;

use crate::base::{Neighbours, TriangleMesh};

/// Vertices per parallel piece.
const PIECE: usize = 512;

/// Rest shape and buffers.
pub struct Arap {
    rest: Vec<DVec3>,
    neighbours: Neighbours,
    rotations: Vec<DMat3>,
}

impl Arap {
    /// The energy relative to `rest`.
    pub fn new(rest: &TriangleMesh) -> Self {
        let rotations = vec![DMat3::IDENTITY; rest.vertices.len()];
        Arap { rest: rest.vertices.clone(), neighbours: rest.neighbours(), rotations }
    }

    /// Adds `weight` times the gradient of the energy of the deformed vertices to `gradient`.
    pub fn add_gradient(&mut self, deformed: &[DVec3], weight: f64, gradient: &mut [DVec3]) {
        self.rotate(deformed);
        let rotations = &self.rotations;
        let around = Neighbourhoods { rest: &self.rest, deformed, neighbours: &self.neighbours };
        // Rotations held fixed.
        gradient.par_chunks_mut(PIECE).enumerate().for_each(|(piece, gradient)| {
            for (k, out) in gradient.iter_mut().enumerate() {
                let i = piece * PIECE + k;
                let mut sum = DVec3::ZERO;
                around.each(i, |j, e, d| sum += d - (rotations[i] * e + rotations[j] * e) * 0.5);
                *out += sum * (4.0 * weight);
            }
        });
    }

    /// The local step: the rotation of each vertex that fits its neighbourhood best.
    fn rotate(&mut self, deformed: &[DVec3]) {
        let around = Neighbourhoods { rest: &self.rest, deformed, neighbours: &self.neighbours };
        self.rotations.par_chunks_mut(PIECE).enumerate().for_each(|(piece, rotations)| {
            for (k, rotation) in rotations.iter_mut().enumerate() {
                let mut covariance = DMat3::ZERO;
                let mut size = 0.0;
                around.each(piece * PIECE + k, |_, e, d| {
                    covariance += DMat3::from_cols(e * d.x, e * d.y, e * d.z);
                    size += e.length_squared() + d.length_squared();
                });
                *rotation = best_rotation(&covariance, 0.5 * size);
            }
        });
    }

    /// The energy of the deformed vertices: no method asks for it.
    #[cfg(test)]
    fn energy(&mut self, deformed: &[DVec3]) -> f64 {
        self.rotate(deformed);
        let around = Neighbourhoods { rest: &self.rest, deformed, neighbours: &self.neighbours };
        let mut sum = 0.0;
        for (i, rotation) in self.rotations.iter().enumerate() {
            around.each(i, |_, e, d| sum += (d - *rotation * e).length_squared());
        }
        sum
    }
}

/// The edges around each vertex, at rest and deformed.
struct Neighbourhoods<'a> {
    rest: &'a [DVec3],
    deformed: &'a [DVec3],
    neighbours: &'a Neighbours,
}

impl Neighbourhoods<'_> {
    /// Calls `visit` with each neighbour of `i`, and with the edge from it to `i` at rest and deformed.
    #[inline(always)]
    fn each(&self, i: usize, mut visit: impl FnMut(usize, DVec3, DVec3)) {
        let (rest, deformed) = (self.rest[i], self.deformed[i]);
        for &j in self.neighbours.of(i) {
            let j = j as usize;
            visit(j, rest - self.rest[j], deformed - self.deformed[j]);
        }
    }
}

/// The rotation `R` that minimises `sum |d - R e|^2`, given `covariance[row a, col b] = sum e_a d_b` and half the sum
/// of all squared lengths (an upper bound of the largest eigenvalue). Identity where none is better than another.
pub fn best_rotation(covariance: &DMat3, bound: f64) -> DMat3 {
    let [xx, yx, zx, xy, yy, zy, xz, yz, zz] = covariance.to_cols_array();
    if bound < 1e-300 {
        return DMat3::IDENTITY;
    }
    // Horn's symmetric matrix, upper triangle.
    let n = [
        [xx + yy + zz, yz - zy, zx - xz, xy - yx],
        [yz - zy, xx - yy - zz, xy + yx, zx + xz],
        [zx - xz, xy + yx, yy - xx - zz, yz + zy],
        [xy - yx, zx + xz, yz + zy, zz - xx - yy],
    ];
    // Characteristic polynomial l^4 + c2 l^2 + c1 l + c0, and its largest root from above by Newton.
    let c2 = -2.0 * (xx * xx + xy * xy + xz * xz + yx * yx + yy * yy + yz * yz + zx * zx + zy * zy + zz * zz);
    let c1 = -8.0 * covariance.determinant();
    let c0 = minor_determinants(&n).1;
    let mut lambda = bound;
    for _ in 0..50 {
        let square = lambda * lambda;
        let value = (square + c2) * square + c1 * lambda + c0;
        let slope = (4.0 * square + 2.0 * c2) * lambda + c1;
        if slope.abs() < 1e-300 {
            break;
        }
        let step = value / slope;
        lambda -= step;
        if step.abs() < 1e-13 * bound {
            break;
        }
    }
    // Eigenvector: the largest row of the adjugate of N - l.
    let mut shifted = n;
    for (i, row) in shifted.iter_mut().enumerate() {
        row[i] -= lambda;
    }
    let adjugate = minor_determinants(&shifted).0;
    let norm = |row: &[f64; 4]| row.iter().map(|v| v * v).sum::<f64>();
    let mut best = adjugate[0];
    for row in &adjugate[1..] {
        if norm(row) > norm(&best) {
            best = *row;
        }
    }
    if norm(&best) < 1e-20 * bound.powi(6) {
        return DMat3::IDENTITY;
    }
    let [w, x, y, z] = best;
    DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize())
}

/// Adjugate and determinant of a symmetric 4x4 matrix, by 2x2 minors. Inlined, so that a caller pays for what it uses.
#[inline(always)]
fn minor_determinants(m: &[[f64; 4]; 4]) -> ([[f64; 4]; 4], f64) {
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
    use super::*;
    use crate::base::random::{CounterRng, Stage};

    /// A bumpy patch of `n` by `n` vertices.
    fn patch(n: usize) -> TriangleMesh {
        let mut mesh = TriangleMesh::default();
        for y in 0..n {
            for x in 0..n {
                let (u, v) = (x as f64, y as f64);
                mesh.vertices.push(DVec3::new(u, v, 0.3 * (u * 1.3).sin() * (v * 0.9).cos()));
            }
        }
        for y in 0..n - 1 {
            for x in 0..n - 1 {
                let a = (y * n + x) as u32;
                let b = a + n as u32;
                mesh.faces.extend([[a, a + 1, b], [a + 1, b + 1, b]]);
            }
        }
        mesh
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
            let got = best_rotation(&s, 0.5 * size);
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

    #[test]
    fn gradient_equals_central_differences() {
        let mesh = patch(5);
        let mut arap = Arap::new(&mesh);
        let mut rng = CounterRng::new(2, Stage::Test, &[]);
        let mut p: Vec<DVec3> = mesh.vertices.iter().map(|v| *v + random_vector(&mut rng) * 0.2).collect();
        let mut gradient = vec![DVec3::ZERO; p.len()];
        arap.add_gradient(&p, 1.0, &mut gradient);
        for i in 0..p.len() {
            for axis in 0..3 {
                let (old, step) = (p[i][axis], 1e-5);
                p[i][axis] = old + step;
                let high = arap.energy(&p);
                p[i][axis] = old - step;
                let low = arap.energy(&p);
                p[i][axis] = old;
                let want = (high - low) / (2.0 * step);
                assert!((gradient[i][axis] - want).abs() < 1e-6 * want.abs().max(1.0), "{} {want}", gradient[i][axis]);
            }
        }
    }

    #[test]
    fn a_rigid_motion_costs_nothing_and_a_sheared_patch_is_pulled_back() {
        let mesh = patch(6);
        let mut arap = Arap::new(&mesh);
        let turn = DQuat::from_scaled_axis(DVec3::new(0.4, -1.1, 0.7));
        let moved: Vec<DVec3> = mesh.vertices.iter().map(|v| turn * *v + DVec3::new(3.0, -2.0, 9.0)).collect();
        let mut gradient = vec![DVec3::ZERO; moved.len()];
        assert!(arap.energy(&moved) < 1e-20);
        arap.add_gradient(&moved, 1.0, &mut gradient);
        assert!(gradient.iter().all(|g| g.length() < 1e-10));
        let mut p: Vec<DVec3> = mesh.vertices.iter().map(|v| *v + DVec3::X * (0.5 * v.y)).collect();
        let start = arap.energy(&p);
        for _ in 0..2000 {
            gradient.fill(DVec3::ZERO);
            arap.add_gradient(&p, 1.0, &mut gradient);
            for (p, g) in p.iter_mut().zip(&gradient) {
                *p -= *g * 0.02;
            }
        }
        let end = arap.energy(&p);
        assert!(end < 1e-3 * start, "{start} -> {end}");
    }

    #[test]
    fn one_thread_and_four_give_the_same_bytes() {
        let mesh = patch(40);
        let bent: Vec<DVec3> = mesh.vertices.iter().map(|v| *v + DVec3::Z * (0.05 * v.x * v.x)).collect();
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let mut gradient = vec![DVec3::ZERO; bent.len()];
            pool.install(|| Arap::new(&mesh).add_gradient(&bent, 1.0, &mut gradient));
            gradient
        };
        assert_eq!(run(1), run(4));
    }
}
