//! Where the planned targets are in the airway as a method has it: each moves with the wall around it.
//!
//! Half of the targets lie in the tissue, a centimetre beside the wall, where the motion is not that of the nearest
//! vertices. So the motion around a target is taken as affine: its value and slope at the target are fitted to the
//! motions of the vertices within reach, by least squares with weights that fall with the distance (moving least
//! squares: Lancaster and Salkauskas, Math Comp 37:141, 1981), and with a ridge on the slope, which a wall that is thin
//! as seen from the target does not tell. What comes out is linear in the motions: a weight for each vertex.
//!
//! A surface that a method has bent on its own, point by point, has no such motion: there the nearest vertices are
//! averaged.

use glam::{DMat3, DVec3};

use super::neighbours::nearest;
use crate::reconstruct::contract::Observation;

// Chosen on the tuning cases by the two true surfaces alone: .26 mm mean error at expiration, where the eight nearest
// vertices have .57; with the given surfaces of the clinical track 1.33 and 1.46.
/// How far beyond its nearest vertex a target looks, mm, and more by this much per mm to that vertex.
const REACH_MM: f64 = 10.0;
const REACH_PER_DISTANCE: f64 = 1.5;
/// Ridge on the slope, mm^2: a spread of the vertices below its root tells nothing.
const RIDGE_MM2: f64 = 2.0;
/// Vertices that are averaged, by inverse distance.
const NEAREST: usize = 8;
/// Added to distances in mm, so that a target on a vertex has a finite weight.
const SOFTENING_MM: f64 = 0.1;

/// Targets, tied to the vertices of the inspiration mesh.
#[derive(Clone, Debug, Default)]
pub struct CarriedTargets {
    rest: Vec<DVec3>,
    /// Vertices and weights of each target; weights sum to 1.
    weights: Vec<Vec<(u32, f64)>>,
}

/// Weights of the vertices within reach of `target`.
fn weights_of(target: DVec3, vertices: &[DVec3]) -> Vec<(u32, f64)> {
    let nearest_mm = vertices.iter().map(|v| v.distance_squared(target)).fold(f64::INFINITY, f64::min).sqrt();
    let reach_mm = REACH_MM + REACH_PER_DISTANCE * nearest_mm;
    let mut near: Vec<(u32, DVec3, f64)> = Vec::new();
    for (i, vertex) in (0u32..).zip(vertices) {
        let part = (vertex.distance(target) - nearest_mm) / reach_mm;
        if part < 1.0 {
            near.push((i, *vertex - target, (1.0 - part * part).powi(2)));
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
    near.into_iter().map(|(i, r, w)| (i, w / total * (1.0 - (r - mean).dot(slope)))).collect()
}

impl CarriedTargets {
    /// `targets` as planned, beside a wall with `vertices` at inspiration, moving as the wall around them.
    pub fn new(targets: &[DVec3], vertices: &[DVec3]) -> Self {
        let weights = targets.iter().map(|target| weights_of(*target, vertices)).collect();
        CarriedTargets { rest: targets.to_vec(), weights }
    }

    /// The same, moving with the nearest vertices.
    pub fn with_nearest(targets: &[DVec3], vertices: &[DVec3]) -> Self {
        let weigh = |list: Vec<(u32, f64)>| {
            let raw: Vec<(u32, f64)> = list.into_iter().map(|(v, d)| (v, 1.0 / (d + SOFTENING_MM))).collect();
            let total: f64 = raw.iter().map(|(_, w)| w).sum();
            raw.into_iter().map(|(v, w)| (v, w / total)).collect()
        };
        let weights = nearest(vertices, targets, NEAREST).into_iter().map(weigh).collect();
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
        let moved = |(rest, weights): (&DVec3, &Vec<(u32, f64)>)| {
            *rest + weights.iter().map(|&(v, w)| displacement_mm(v) * w).sum::<DVec3>()
        };
        self.rest.iter().zip(&self.weights).map(moved).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A bent tube's wall, and the affine motion of all space.
    fn wall() -> Vec<DVec3> {
        let point = |i: u32, k: u32| {
            let (along, around) = (f64::from(i), f64::from(k) * 0.7);
            DVec3::new(3.0 * around.cos(), 3.0 * around.sin() + 0.01 * along * along, along)
        };
        (0..40).flat_map(|i| (0..9).map(move |k| point(i, k))).collect()
    }

    #[test]
    fn the_same_motion_of_all_the_wall_is_the_targets_motion() {
        let (wall, shift) = (wall(), DVec3::new(1.0, 2.0, 3.0));
        let targets = [DVec3::new(0.0, 13.0, 0.0), DVec3::new(0.0, 0.0, 20.0), DVec3::new(50.0, 0.0, 90.0)];
        for (target, moved) in targets.iter().zip(CarriedTargets::new(&targets, &wall).moved(|_| shift)) {
            assert!(moved.distance(*target + shift) < 1e-9, "{moved}");
        }
        // A single vertex tells no slope.
        let one = CarriedTargets::new(&targets, &wall[..1]).moved(|_| shift);
        assert!(one[0].distance(targets[0] + shift) < 1e-12);
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

    /// A centimetre beside the wall the motion of the nearest vertices is wrong by what it changes over a centimetre.
    #[test]
    fn a_target_in_the_tissue_moves_as_an_affine_motion_says() {
        let wall = wall();
        let motion = |p: DVec3| DVec3::new(0.02 * p.y, 0.05 * p.y - 0.03 * p.z, 0.1 * p.z - 0.04 * p.x);
        let target = DVec3::new(2.0, 15.0, 12.0);
        let carried = CarriedTargets::new(&[target], &wall);
        let missed = carried.moved(|v| motion(wall[v as usize]))[0].distance(target + motion(target));
        let nearest = wall.iter().min_by(|a, b| a.distance(target).total_cmp(&b.distance(target))).unwrap();
        let by_nearest = motion(*nearest).distance(motion(target));
        // The ridge holds back what the thin wall hardly tells.
        assert!(missed < 0.4 * by_nearest, "{missed} against {by_nearest} mm");
    }
}
