//! As-rigid-as-possible energy of a mesh (Sorkine and Alexa 2007) as BridgeSplat uses it: uniform weights,
//! summed over all vertices and both directions of every edge,
//! `E = sum_i sum_{j in N(i)} |(p'_i - p'_j) - R_i (p_i - p_j)|^2`, with `R_i` the rotation that fits the
//! neighbourhood of `i` best, and the gradient with rotations held fixed (exact, since the energy is stationary
//! in them): `dE/dp'_i = sum_j 4 ((p'_i - p'_j) - (R_i + R_j)/2 (p_i - p_j))`.
//!
//! The rotations are found four at a time ([`best_rotations`]).

use glam::{DMat3, DVec3};
use rayon::prelude::*;

use crate::base::{Neighbours, TriangleMesh};
use crate::ffi::isa::{VectorLoop, with_avx2};
use crate::reconstruct::fitting::loss::best_rotation::{Fits, LANES, best_rotations};

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
            with_avx2(Rotate { around: &around, first: piece * PIECE, rotations });
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

/// A piece of the local step.
struct Rotate<'a> {
    around: &'a Neighbourhoods<'a>,
    /// Vertex of the first rotation.
    first: usize,
    rotations: &'a mut [DMat3],
}

impl VectorLoop for Rotate<'_> {
    #[inline(always)]
    fn run(self) {
        for (group, rotations) in self.rotations.chunks_mut(LANES).enumerate() {
            let mut fits = Fits::default();
            for lane in 0..rotations.len() {
                let mut covariance = DMat3::ZERO;
                let mut size = 0.0;
                self.around.each(self.first + group * LANES + lane, |_, e, d| {
                    covariance += DMat3::from_cols(e * d.x, e * d.y, e * d.z);
                    size += e.length_squared() + d.length_squared();
                });
                fits.set(lane, &covariance, 0.5 * size);
            }
            rotations.copy_from_slice(&best_rotations(&fits)[..rotations.len()]);
        }
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

#[cfg(test)]
mod tests {
    use glam::DQuat;

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
