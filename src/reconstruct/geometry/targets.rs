//! Where the planned targets are in the airway as a method has it: each moves with the wall next to it.

use glam::DVec3;

use super::neighbours::nearest;
use crate::reconstruct::contract::Observation;

/// Vertices of the wall whose motions a target averages, by inverse distance.
const VERTICES: usize = 8;
/// Added to distances in mm, so that a target on a vertex has a finite weight.
const SOFTENING_MM: f64 = 0.1;

/// Targets, tied to the vertices of the inspiration mesh.
#[derive(Clone, Debug, Default)]
pub struct CarriedTargets {
    rest: Vec<DVec3>,
    /// Vertices and weights of each target; weights sum to 1.
    weights: Vec<Vec<(u32, f64)>>,
}

impl CarriedTargets {
    /// `targets` as planned, on a wall with `vertices` at inspiration.
    pub fn new(targets: &[DVec3], vertices: &[DVec3]) -> Self {
        let weigh = |list: Vec<(u32, f64)>| {
            let raw: Vec<(u32, f64)> = list.into_iter().map(|(v, d)| (v, 1.0 / (d + SOFTENING_MM))).collect();
            let total: f64 = raw.iter().map(|(_, w)| w).sum();
            raw.into_iter().map(|(v, w)| (v, w / total)).collect()
        };
        let weights = nearest(vertices, targets, VERTICES).into_iter().map(weigh).collect();
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

    #[test]
    fn a_target_moves_with_the_wall_next_to_it() {
        let wall: Vec<DVec3> = (0..40).map(|i| DVec3::new(i as f64, 0.0, 0.0)).collect();
        let carried = CarriedTargets::new(&[DVec3::new(0.0, 10.0, 0.0), DVec3::new(39.0, 0.0, 0.0)], &wall);
        let shift = DVec3::new(1.0, 2.0, 3.0);
        let even = carried.moved(|_| shift);
        assert!(even[0].distance(DVec3::new(1.0, 12.0, 3.0)) < 1e-12);
        let growing = carried.moved(|v| DVec3::Z * f64::from(v));
        assert!(growing[0].z < 7.0 && growing[1].z > 36.0, "{growing:?}");
    }
}
