//! Where the planned targets are in the airway as a method has it: each moves with the wall around it.
//!
//! Half of the targets lie in the tissue, a centimetre beside the wall. What its vertices tell of the motion there has two
//! parts: the tissue moves smoothly, and on top of that the airway changes its calibre, which ends at the wall. So the
//! displacement of a vertex at `x` with the normal `n` is taken to be
//!
//!   u(x) = a + A x + f(x) + g(x) n + noise
//!
//! with `f` and `g` Gaussian processes: `f` of covariance `c r^3` in each coordinate, the kernel of the smoothest
//! interpolation in space (Duchon, Lect Notes Math 571:85, 1977; Wahba, Spline Models for Observational Data, 1990), and
//! `g`, the change of calibre, alike over some centimetres. A target moves by the best linear prediction of
//! `a + A x + f(x)` (universal kriging). What comes out is linear in the motions: a matrix for each vertex.
//!
//! Points on the axis, where nothing is to be told beyond the wall, follow an affine motion fitted to the vertices within
//! reach, by least squares with weights that fall with the distance (moving least squares: Lancaster and Salkauskas, Math
//! Comp 37:141, 1981) and a ridge on the slope. A surface that a method has bent on its own, point by point, has no such
//! motion: there the nearest vertices are averaged.

use glam::{DMat3, DVec3};
use nalgebra::DMatrix;
use rayon::prelude::*;

use super::neighbours::nearest;
use crate::base::TriangleMesh;
use crate::reconstruct::contract::Observation;

// Chosen on the tuning cases by the two true surfaces alone: .11 mm mean error at expiration (tissue: .15), where the
// affine motion has .26 (.41) and the eight nearest vertices .57; with the given surfaces of the clinical track 1.32,
// 1.34 and 1.46. Half and twice each number are alike.
/// `c`, mm^2 per mm^3.
const SMOOTH: f64 = 3e-6;
/// Standard deviation of the change of calibre, mm, and the length over which it is alike, mm.
const CALIBRE_MM: f64 = 2.0;
const CALIBRE_LENGTH_MM: f64 = 30.0;
/// Standard deviation of the noise, mm.
const NOISE_MM: f64 = 0.03;
/// Standard deviation of `A`, without unit. Beside a lone tube, it tells a narrower tube from narrower space.
const SLOPE: f64 = 0.1;
/// Vertices that are asked, at most; no farther than this beyond the nearest, mm; and no nearer to each other than this
/// many mm, and than this share of their distance from the target.
const ASKED: usize = 100;
const FARTHEST_MM: f64 = 60.0;
const APART_MM: f64 = 2.0;
const APART_SHARE: f64 = 0.2;
/// Points on the axis: how far beyond its nearest vertex one looks, mm, and more by this much per mm to that vertex.
const REACH_MM: f64 = 10.0;
const REACH_PER_DISTANCE: f64 = 1.5;
/// Ridge on the slope there, mm^2: a spread of the vertices below its root tells nothing.
const RIDGE_MM2: f64 = 2.0;
/// Vertices that are averaged, by inverse distance.
const NEAREST: usize = 8;
/// Added to distances in mm, so that a target on a vertex has a finite weight.
const SOFTENING_MM: f64 = 0.1;

/// Targets, tied to the vertices of the inspiration mesh.
#[derive(Clone, Debug, Default)]
pub struct CarriedTargets {
    rest: Vec<DVec3>,
    /// Vertices and weights of each target; weights sum to the identity.
    weights: Vec<Vec<(u32, DMat3)>>,
}

/// The vertices that are asked for the motion of `target`: the nearest, and farther away ever fewer.
fn asked(target: DVec3, vertices: &[DVec3]) -> Vec<u32> {
    let mut near: Vec<(f64, u32)> = (0u32..).zip(vertices).map(|(i, v)| (v.distance(target), i)).collect();
    let nearest_mm = near.iter().map(|(d, _)| *d).fold(f64::INFINITY, f64::min);
    near.retain(|(d, _)| *d <= nearest_mm + FARTHEST_MM);
    near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let mut kept: Vec<u32> = Vec::new();
    for (distance, i) in near {
        let apart = APART_MM.max(APART_SHARE * distance);
        let place = vertices[i as usize];
        if kept.iter().all(|&k| vertices[k as usize].distance_squared(place) >= apart * apart) {
            kept.push(i);
            if kept.len() == ASKED {
                break;
            }
        }
    }
    kept
}

/// Weights of the vertices by whose motion `target` moves, see the module's formula.
fn predicted(target: DVec3, vertices: &[DVec3], normals: &[DVec3]) -> Vec<(u32, DMat3)> {
    let asked = asked(target, vertices);
    let known = 3 * asked.len();
    // Unknowns: the weights, and the multipliers of `a` and `A`.
    let mut system = DMatrix::zeros(known + 12, known + 12);
    let mut wanted = DMatrix::zeros(known + 12, 3);
    let smooth = |r: f64| SMOOTH * r * r * r;
    for (i, &v) in asked.iter().enumerate() {
        let (place, normal) = (vertices[v as usize], normals[v as usize]);
        for (j, &w) in asked.iter().enumerate() {
            let (other, other_normal) = (vertices[w as usize], normals[w as usize]);
            let r = place.distance(other);
            let calibre = CALIBRE_MM * CALIBRE_MM * (-0.5 * (r / CALIBRE_LENGTH_MM).powi(2)).exp();
            for (k, l) in (0..3).flat_map(|k| (0..3).map(move |l| (k, l))) {
                system[(3 * i + k, 3 * j + l)] = calibre * normal[k] * other_normal[l];
            }
            let alike = smooth(r) + if i == j { NOISE_MM * NOISE_MM } else { 0.0 };
            (0..3).for_each(|k| system[(3 * i + k, 3 * j + k)] += alike);
        }
        let offset = place - target;
        for k in 0..3 {
            let row = 3 * i + k;
            let trend = [1.0, offset.x, offset.y, offset.z];
            let columns = [known + k, known + 3 + 3 * k, known + 4 + 3 * k, known + 5 + 3 * k];
            for (column, value) in columns.into_iter().zip(trend) {
                system[(row, column)] = value;
                system[(column, row)] = value;
            }
            wanted[(row, k)] = smooth(offset.length());
        }
    }
    (0..9).for_each(|k| system[(known + 3 + k, known + 3 + k)] = -1.0 / (SLOPE * SLOPE));
    (0..3).for_each(|k| wanted[(known + k, k)] = 1.0);
    if !system.lu().solve_mut(&mut wanted) {
        return averaged(nearest(vertices, &[target], NEAREST).swap_remove(0));
    }
    let weight = |i: usize| DMat3::from_cols_array_2d(&[0, 1, 2].map(|l| [0, 1, 2].map(|k| wanted[(3 * i + l, k)])));
    asked.into_iter().enumerate().map(|(i, v)| (v, weight(i))).collect()
}

/// Weights of the vertices within reach of `point`, for an affine motion.
fn affine(point: DVec3, vertices: &[DVec3]) -> Vec<(u32, DMat3)> {
    let nearest_mm = vertices.iter().map(|v| v.distance_squared(point)).fold(f64::INFINITY, f64::min).sqrt();
    let reach_mm = REACH_MM + REACH_PER_DISTANCE * nearest_mm;
    let mut near: Vec<(u32, DVec3, f64)> = Vec::new();
    for (i, vertex) in (0u32..).zip(vertices) {
        let part = (vertex.distance(point) - nearest_mm) / reach_mm;
        if part < 1.0 {
            near.push((i, *vertex - point, (1.0 - part * part).powi(2)));
        }
    }
    let total: f64 = near.iter().map(|(_, _, w)| w).sum();
    let mean: DVec3 = near.iter().map(|(_, r, w)| *r * (*w / total)).sum();
    let mut spread = DMat3::from_diagonal(DVec3::splat(RIDGE_MM2));
    for (_, r, w) in &near {
        let off = *r - mean;
        let row = off * (*w / total);
        spread += DMat3::from_cols(row * off.x, row * off.y, row * off.z);
    }
    let slope = spread.inverse() * mean;
    near.into_iter().map(|(i, r, w)| (i, even(w / total * (1.0 - (r - mean).dot(slope))))).collect()
}

/// Weights of the nearest vertices, given with their distances.
fn averaged(list: Vec<(u32, f64)>) -> Vec<(u32, DMat3)> {
    let raw: Vec<(u32, f64)> = list.into_iter().map(|(v, d)| (v, 1.0 / (d + SOFTENING_MM))).collect();
    let total: f64 = raw.iter().map(|(_, w)| w).sum();
    raw.into_iter().map(|(v, w)| (v, even(w / total))).collect()
}

/// The same weight in all directions.
fn even(weight: f64) -> DMat3 {
    DMat3::from_diagonal(DVec3::splat(weight))
}

impl CarriedTargets {
    /// `targets` as planned, in the lumen or in the tissue beside the wall `mesh` at inspiration.
    pub fn new(targets: &[DVec3], mesh: &TriangleMesh) -> Self {
        let normals = mesh.vertex_normals();
        let weights = targets.par_iter().map(|target| predicted(*target, &mesh.vertices, &normals)).collect();
        CarriedTargets { rest: targets.to_vec(), weights }
    }

    /// Many `points` on the axis of a wall with `vertices` at inspiration.
    pub fn on_axis(points: &[DVec3], vertices: &[DVec3]) -> Self {
        let weights = points.iter().map(|point| affine(*point, vertices)).collect();
        CarriedTargets { rest: points.to_vec(), weights }
    }

    /// `targets` that move with the nearest `vertices`.
    pub fn with_nearest(targets: &[DVec3], vertices: &[DVec3]) -> Self {
        let weights = nearest(vertices, targets, NEAREST).into_iter().map(averaged).collect();
        CarriedTargets { rest: targets.to_vec(), weights }
    }

    /// Where they are at `phase` by the two CTs; at rest where only one is given.
    pub fn at_phase(&self, observation: &Observation, phase: f64) -> Vec<DVec3> {
        let Some(expiration) = &observation.expiration else { return self.rest.clone() };
        let rest = &observation.inspiration.vertices;
        self.moved(|v| (expiration.vertices[v as usize] - rest[v as usize]) * phase)
    }

    /// Where they are when vertex `v` has moved by `displacement_mm(v)`.
    pub fn moved(&self, displacement_mm: impl Fn(u32) -> DVec3) -> Vec<DVec3> {
        let moved = |(rest, weights): (&DVec3, &Vec<(u32, DMat3)>)| {
            *rest + weights.iter().map(|&(v, w)| w * displacement_mm(v)).sum::<DVec3>()
        };
        self.rest.iter().zip(&self.weights).map(moved).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const AROUND: u32 = 12;
    const RINGS: u32 = 30;

    /// Three tubes in three directions, and for each vertex the nearest point of its axis. One alone would not tell whether
    /// it got narrower with the space around it.
    fn fork() -> (TriangleMesh, Vec<DVec3>) {
        let ways = [DVec3::Z, DVec3::new(0.8, 0.0, -0.6), DVec3::new(-0.6, 0.7, -0.4).normalize()];
        let (mut mesh, mut axis) = (TriangleMesh { vertices: Vec::new(), faces: Vec::new() }, Vec::new());
        for (way, radius) in ways.into_iter().zip([3.0, 2.0, 2.5]) {
            let (across, other) = way.any_orthonormal_pair();
            let first = mesh.vertices.len() as u32;
            for (i, k) in (0..RINGS).flat_map(|i| (0..AROUND).map(move |k| (i, k))) {
                let (sine, cosine) = (std::f64::consts::TAU * f64::from(k) / f64::from(AROUND)).sin_cos();
                axis.push(way * f64::from(i));
                mesh.vertices.push(way * f64::from(i) + radius * (across * cosine + other * sine));
                let [here, next] = [first + i * AROUND + k, first + i * AROUND + (k + 1) % AROUND];
                if i + 1 < RINGS {
                    mesh.faces.extend([[here, next, next + AROUND], [here, next + AROUND, here + AROUND]]);
                }
            }
        }
        (mesh, axis)
    }

    #[test]
    fn the_same_motion_of_all_the_wall_is_the_targets_motion() {
        let ((wall, _), shift) = (fork(), DVec3::new(1.0, 2.0, 3.0));
        let targets = [DVec3::new(0.0, 13.0, 0.0), DVec3::new(0.0, 0.0, 20.0), DVec3::new(50.0, 0.0, 90.0)];
        // A single vertex tells no slope.
        let one = TriangleMesh { vertices: wall.vertices[..1].to_vec(), faces: Vec::new() };
        let carried = [CarriedTargets::new(&targets, &wall), CarriedTargets::new(&targets, &one)];
        let on_axis = [&wall, &one].map(|mesh| CarriedTargets::on_axis(&targets, &mesh.vertices));
        for carried in carried.into_iter().chain(on_axis) {
            for (target, moved) in targets.iter().zip(carried.moved(|_| shift)) {
                assert!(moved.distance(*target + shift) < 1e-7, "{moved}");
            }
        }
    }

    #[test]
    fn the_nearest_vertices_take_a_target_along() {
        let wall: Vec<DVec3> = (0..40).map(|i| DVec3::new(i as f64, 0.0, 0.0)).collect();
        let carried = CarriedTargets::with_nearest(&[DVec3::new(0.0, 10.0, 0.0), DVec3::new(39.0, 0.0, 0.0)], &wall);
        let even = carried.moved(|_| DVec3::ONE);
        assert!(even[0].distance(DVec3::new(1.0, 11.0, 1.0)) < 1e-12);
        let growing = carried.moved(|v| DVec3::Z * f64::from(v));
        assert!(growing[0].z < 7.0 && growing[1].z > 36.0, "{growing:?}");
    }

    /// A centimetre beside the wall, the nearest vertices are wrong by what the motion changes over a centimetre, and by
    /// the change of calibre. The affine motion takes that change for one of all space.
    #[test]
    fn tissue_moves_smoothly_whatever_the_calibre_does() {
        let (wall, axis) = fork();
        let motion = |p: DVec3| {
            let bend = DVec3::new(0.001 * p.z * p.z, 0.0005 * p.y * p.z, 0.0);
            DVec3::new(0.02 * p.y, 0.05 * p.y - 0.03 * p.z, 0.1 * p.z - 0.04 * p.x) + bend
        };
        let target = DVec3::new(2.0, 13.0, 22.0);
        let missed = |carried: CarriedTargets, narrower: f64| {
            let of = |v: usize| motion(wall.vertices[v]) - narrower * (wall.vertices[v] - axis[v]);
            carried.moved(|v| of(v as usize))[0].distance(target + motion(target))
        };
        let new = || CarriedTargets::new(&[target], &wall);
        let nearest = || CarriedTargets::with_nearest(&[target], &wall.vertices);
        let affine = || CarriedTargets::on_axis(&[target], &wall.vertices);
        for narrower in [0.0, 0.2] {
            assert!(missed(new(), narrower) < 0.25 * missed(nearest(), narrower));
            assert!(missed(new(), narrower) < 0.5 * missed(affine(), narrower));
        }
    }

    /// An affine motion of all space is known, up to what the priors let pass.
    #[test]
    fn an_affine_motion_is_told_without_error() {
        let (wall, _) = fork();
        let motion = |p: DVec3| DVec3::new(0.1 * p.y, 0.05 * p.y - 0.03 * p.z, 0.1 * p.z - 0.04 * p.x);
        let targets = [DVec3::new(2.0, 13.0, 22.0), DVec3::new(0.0, 1.0, 10.0)];
        let moved = CarriedTargets::new(&targets, &wall).moved(|v| motion(wall.vertices[v as usize]));
        for (target, moved) in targets.iter().zip(moved) {
            assert!(moved.distance(*target + motion(*target)) < 0.02, "{moved}");
        }
    }
}
