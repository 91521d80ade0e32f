//! A low-rank correction of the displacement field between the two CTs, whose registration has a smooth error of
//! about 1 mm: `D(x) = D_given(x) + sum_k exp(-|x - x_k|^2 / (2 reach^2)) c_k`, one vector `c_k` (mm) per centre
//! `x_k`. The centres lie along the path of the scope. The few in front of a frame are unknowns of the keyframe
//! window, together with the frame's phase.

use std::borrow::Cow;

use glam::{DAffine3, DVec3};

/// Distance between centres, in reaches.
const SPACING: f64 = 1.2;
/// Assumed distance of the viewed wall in front of the scope, mm.
const AHEAD_MM: f64 = 12.0;

/// The correction for a whole mesh; the default has no centres and corrects nothing.
#[derive(Default)]
pub struct Correction {
    centres: Vec<DVec3>,
    /// For each centre, the weight of every vertex of the mesh.
    weights: Vec<Vec<f32>>,
    /// Coefficients, mm, three per centre.
    coefficients: Vec<[f64; 3]>,
    /// Inverse prior variance of each coefficient, 1 / mm^2.
    precision: f64,
    /// How many centres a frame estimates.
    rank: usize,
}

impl Correction {
    /// Centres along the path of `poses` for the mesh `rest`; `rank` of them are estimated per frame (0: no
    /// correction), each with a prior of `deviation_mm` per axis.
    pub fn new(rest: &[[f32; 3]], poses: &[DAffine3], rank: usize, reach_mm: f64, deviation_mm: f64) -> Self {
        let mut centres: Vec<DVec3> = Vec::new();
        if rank > 0 {
            for place in poses.iter().map(looked_at) {
                if centres.iter().all(|c| c.distance(place) >= SPACING * reach_mm) {
                    centres.push(place);
                }
            }
        }
        let falloff = |c: &DVec3| {
            let weight = |v: &[f32; 3]| {
                let distance2 = v.iter().zip(c.to_array()).map(|(a, b)| (f64::from(*a) - b).powi(2)).sum::<f64>();
                (-0.5 * distance2 / (reach_mm * reach_mm)).exp() as f32
            };
            rest.iter().map(weight).collect()
        };
        Correction {
            weights: centres.iter().map(falloff).collect(),
            coefficients: vec![[0.0; 3]; centres.len()],
            precision: 1.0 / (deviation_mm * deviation_mm),
            rank: rank.min(centres.len()),
            centres,
        }
    }

    /// Whether there is anything to estimate.
    pub fn estimates(&self) -> bool {
        self.rank > 0
    }

    /// Weights of all vertices at `centre`.
    pub fn weights(&self, centre: usize) -> &[f32] {
        &self.weights[centre]
    }

    /// The centres in front of the scope at `pose`, nearest first.
    pub fn in_view(&self, pose: &DAffine3) -> Vec<usize> {
        let place = looked_at(pose);
        let mut order: Vec<usize> = (0..self.centres.len()).collect();
        order.sort_by(|&a, &b| self.centres[a].distance(place).total_cmp(&self.centres[b].distance(place)));
        order.truncate(self.rank);
        order
    }

    /// Precision of the prior of all coefficients, three per centre, 1 / mm^2.
    pub fn precision(&self) -> Vec<f64> {
        vec![self.precision; 3 * self.centres.len()]
    }

    /// Replaces all coefficients, three per centre.
    pub fn set(&mut self, coefficients: &[[f64; 3]]) {
        self.coefficients.copy_from_slice(coefficients);
    }

    /// `given` with the current correction.
    pub fn apply<'a>(&self, given: &'a [[f32; 3]]) -> Cow<'a, [[f32; 3]]> {
        self.apply_with(given, &self.coefficients)
    }

    /// `given` with the correction that `coefficients` describe.
    pub fn apply_with<'a>(&self, given: &'a [[f32; 3]], coefficients: &[[f64; 3]]) -> Cow<'a, [[f32; 3]]> {
        let mut out = Cow::Borrowed(given);
        for (weights, c) in self.weights.iter().zip(coefficients).filter(|(_, c)| **c != [0.0; 3]) {
            let c = c.map(|v| v as f32);
            for (d, w) in out.to_mut().iter_mut().zip(weights) {
                (0..3).for_each(|k| d[k] += w * c[k]);
            }
        }
        out
    }
}

fn looked_at(pose: &DAffine3) -> DVec3 {
    pose.transform_point3(DVec3::new(0.0, 0.0, AHEAD_MM))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn centres_stand_apart_along_the_path_and_correct_what_is_near() {
        let poses: Vec<DAffine3> = (0..50).map(|i| DAffine3::from_translation(DVec3::Z * i as f64)).collect();
        let rest = [[0.0, 0.0, 12.0], [0.0, 0.0, 36.0], [0.0, 0.0, 500.0]];
        let mut correction = Correction::new(&rest, &poses, 2, 20.0, 1.0);
        assert_eq!(correction.centres.len(), 3);
        assert_eq!(correction.in_view(&poses[49]), [2, 1]);
        correction.set(&[[1.0, 0.0, -2.0], [0.0; 3], [0.0; 3]]);
        let out = correction.apply(&[[1.0; 3]; 3]);
        let there = (-0.5f32 * 1.44).exp();
        assert_eq!(out[0], [2.0, 1.0, -1.0]);
        assert!((out[1][2] - (1.0 - 2.0 * there)).abs() < 1e-5 && out[2] == [1.0; 3], "{out:?}");
        assert!(Correction::new(&rest, &poses, 0, 20.0, 1.0).in_view(&poses[0]).is_empty());
        assert!(!Correction::default().estimates());
    }
}
