//! A sparse deformation field (BridgeSplat's `MeshSparseDeformation`): every point follows its `k` nearest control
//! points, `delta_i = sum_c w_ic d_c / max(sum_c w_ic, 0.01)`, `w_ic = exp(-decay |x_i - c|)`, lengths in units.

use glam::DVec3;
use rayon::prelude::*;

use crate::reconstruct::geometry::neighbours;

/// Smallest sum of weights to divide by (released code): points below it follow only in part.
const WEIGHT_FLOOR: f64 = 1e-2;
/// Points per task.
const PIECE: usize = 512;

/// Weights from control points to points, both ways.
pub struct ControlField {
    per_point: usize,
    /// `per_point` (control, weight) for each point.
    weights: Vec<(u32, f32)>,
    /// Points of each control point, ascending: `reverse[offsets[c]..offsets[c + 1]]`.
    offsets: Vec<u32>,
    reverse: Vec<(u32, f32)>,
}

impl ControlField {
    /// The field of `controls` on `points`.
    pub fn new(controls: &[DVec3], points: &[DVec3], neighbours: usize, decay: f64) -> Self {
        let per_point = neighbours.min(controls.len());
        let near = neighbours::nearest(controls, points, per_point);
        let weights = near
            .iter()
            .flat_map(|list| {
                let sum: f64 = list.iter().map(|(_, d)| (-decay * d).exp()).sum();
                list.iter().map(move |&(c, d)| (c, ((-decay * d).exp() / sum.max(WEIGHT_FLOOR)) as f32))
            })
            .collect();
        Self::from_weights(weights, per_point, controls.len())
    }

    /// The same field on some of its points.
    pub fn subset(&self, points: &[u32]) -> Self {
        let k = self.per_point;
        let weights = points.iter().flat_map(|&p| self.weights[p as usize * k..][..k].iter().copied()).collect();
        Self::from_weights(weights, k, self.offsets.len() - 1)
    }

    fn from_weights(weights: Vec<(u32, f32)>, per_point: usize, controls: usize) -> Self {
        let mut offsets = vec![0u32; controls + 1];
        for (c, _) in &weights {
            offsets[*c as usize + 1] += 1;
        }
        for c in 0..controls {
            offsets[c + 1] += offsets[c];
        }
        let mut fill = offsets.clone();
        let mut reverse = vec![(0, 0.0); weights.len()];
        for (i, &(c, w)) in weights.iter().enumerate() {
            reverse[fill[c as usize] as usize] = ((i / per_point) as u32, w);
            fill[c as usize] += 1;
        }
        ControlField { per_point, weights, offsets, reverse }
    }

    /// Interpolates the `values` of the control points at each point.
    pub fn apply<const N: usize>(&self, values: &[[f32; N]], out: &mut Vec<[f32; N]>) {
        let k = self.per_point.max(1);
        out.resize(self.weights.len() / k, [0.0; N]);
        out.par_chunks_mut(PIECE).zip(self.weights.par_chunks(PIECE * k)).for_each(|(out, weights)| {
            for (out, list) in out.iter_mut().zip(weights.chunks_exact(k)) {
                let mut sum = [0.0; N];
                for &(c, w) in list {
                    for n in 0..N {
                        sum[n] += w * values[c as usize][n];
                    }
                }
                *out = sum;
            }
        });
    }

    /// Gradient by the control points from the gradient by the points: the transpose of [`ControlField::apply`].
    pub fn pull_back<const N: usize>(&self, by_points: &[[f32; N]], out: &mut Vec<[f32; N]>) {
        out.resize(self.offsets.len() - 1, [0.0; N]);
        out.par_iter_mut().with_min_len(16).enumerate().for_each(|(c, out)| {
            let mut sum = [0.0; N];
            for &(p, w) in &self.reverse[self.offsets[c] as usize..self.offsets[c + 1] as usize] {
                for n in 0..N {
                    sum[n] += w * by_points[p as usize][n];
                }
            }
            *out = sum;
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::{CounterRng, Stage};

    #[test]
    fn weights_are_the_released_ones_and_the_pullback_is_the_transpose() {
        let mut rng = CounterRng::new(2, Stage::Test, &[3]);
        let mut cloud = |n: usize, spread: f64| -> Vec<DVec3> {
            (0..n).map(|_| DVec3::new(rng.normal(), rng.normal(), rng.normal()) * spread).collect()
        };
        let (controls, points) = (cloud(20, 0.1), cloud(50, 0.1));
        let field = ControlField::new(&controls, &points, 5, 4.5);
        let mut out = Vec::new();
        field.apply(&vec![[1.0f32, 2.0, 3.0]; 20], &mut out);
        assert!(out.iter().all(|o| (o[0] - 1.0).abs() < 1e-5 && (o[2] - 3.0).abs() < 1e-5), "a common shift is kept");
        // Far away the weights are below their floor, and their sum over it is left of a common shift.
        let (place, mut far) = (DVec3::X * 1.8, Vec::new());
        ControlField::new(&controls, &[place], 5, 4.5).apply(&[[1.0f32]; 20], &mut far);
        let mut weights: Vec<f64> = controls.iter().map(|c| (-4.5 * c.distance(place)).exp()).collect();
        weights.sort_by(|a, b| b.total_cmp(a));
        let (sum, moved) = (weights[..5].iter().sum::<f64>(), f64::from(far[0][0]));
        assert!(sum < 0.01 && (moved - sum / 0.01).abs() < 1e-5, "{moved} of {sum}");
        let d: Vec<[f32; 3]> = cloud(20, 1.0).iter().map(|v| v.as_vec3().to_array()).collect();
        let g: Vec<[f32; 3]> = cloud(50, 1.0).iter().map(|v| v.as_vec3().to_array()).collect();
        field.apply(&d, &mut out);
        let mut back = Vec::new();
        field.pull_back(&g, &mut back);
        let dot = |a: &[[f32; 3]], b: &[[f32; 3]]| -> f64 {
            a.as_flattened().iter().zip(b.as_flattened()).map(|(x, y)| (x * y) as f64).sum()
        };
        assert!((dot(&out, &g) - dot(&d, &back)).abs() < 1e-4);
        let all: Vec<u32> = (0..50).collect();
        assert_eq!(field.subset(&all).weights, field.weights);
    }
}
