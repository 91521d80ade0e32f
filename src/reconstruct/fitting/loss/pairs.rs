//! Regularisers between control points, as in the code BridgeSplat was built on (OET, after Dynamic 3D Gaussians),
//! `i` a control point, `j` one of its nearest neighbours at rest, `o_ij = p_j - p_i`, `w_ij = exp(-decay d_ij)`:
//! - rigidity `mean w_ij |o_ij^prev - o_ij^cur|`, `prev` the positions after the previous frame;
//! - isometry `mean w_ij | |o_ij| - d_ij |`, `d_ij` the distance at rest; a commented-out line of BridgeSplat's own code
//!   divides it by the mean of `d_ij`;
//! - rotation `mean sqrt(w_ij |dR_i - dR_j|^2 + 1e-20)`, `dR = R_prev R_cur^T` (Frobenius norm);
//! - visibility: the length of the displacement of what is not visible, over a count that is never zero.
//!
//! All take `weight` and add `weight * gradient`; all return the plain loss.

use glam::{DMat3, DVec3};

use crate::reconstruct::geometry::neighbours;

/// The neighbours of each point at rest.
pub struct Pairs {
    /// (i, j, w_ij, d_ij), sorted by i.
    list: Vec<(u32, u32, f64, f64)>,
}

impl Pairs {
    /// Each point with its `count` nearest others; weights decay by `decay` per unit of length.
    pub fn new(rest: &[DVec3], count: usize, decay: f64) -> Self {
        let near = neighbours::nearest(rest, rest, count + 1);
        let mut list = Vec::with_capacity(rest.len() * count);
        for (i, near) in near.iter().enumerate() {
            let others = near.iter().filter(|(j, _)| *j as usize != i).take(count);
            list.extend(others.map(|&(j, d)| (i as u32, j, (-decay * d).exp(), d)));
        }
        Pairs { list }
    }

    /// Mean distance of neighbours at rest; 1 where there are none.
    pub fn mean_distance(&self) -> f64 {
        let mean = self.mean_over(|(_, _, _, rest)| *rest);
        if mean > 0.0 { mean } else { 1.0 }
    }

    fn mean_over<'a>(&'a self, term: impl FnMut(&'a (u32, u32, f64, f64)) -> f64) -> f64 {
        self.list.iter().map(term).sum::<f64>() / self.list.len().max(1) as f64
    }

    /// Rigidity against the `previous` positions: the gradient by `o_ij` is `w_ij` times the direction of its change.
    pub fn rigidity(&self, previous: &[DVec3], current: &[DVec3], weight: f64, gradient: &mut [DVec3]) -> f64 {
        let share = weight / self.list.len().max(1) as f64;
        self.mean_over(|&(i, j, w, _)| {
            let (i, j) = (i as usize, j as usize);
            let change = (current[j] - current[i]) - (previous[j] - previous[i]);
            let length = change.length();
            let by_offset = change * (share * w / length.max(1e-12));
            gradient[j] += by_offset;
            gradient[i] -= by_offset;
            w * length
        })
    }

    /// Isometry against the lengths at rest: the gradient by `o_ij` is `w_ij sign(|o_ij| - d_ij)` times its
    /// direction.
    pub fn isometry(&self, current: &[DVec3], weight: f64, gradient: &mut [DVec3]) -> f64 {
        let share = weight / self.list.len().max(1) as f64;
        self.mean_over(|&(i, j, w, rest)| {
            let (i, j) = (i as usize, j as usize);
            let o = current[j] - current[i];
            let length = o.length();
            let stretch = length - rest;
            let sign = if stretch == 0.0 { 0.0 } else { stretch.signum() };
            let by_offset = o * (share * w * sign / length.max(1e-12));
            gradient[j] += by_offset;
            gradient[i] -= by_offset;
            w * stretch.abs()
        })
    }

    /// Rotation similarity of quaternions `w x y z` of any length; gradients go through the normalisation.
    pub fn rotation(&self, previous: &[[f64; 4]], current: &[[f64; 4]], weight: f64, gradient: &mut [[f64; 4]]) -> f64 {
        let before: Vec<DMat3> = previous.iter().map(|q| rotation_matrix(*q)).collect();
        let change: Vec<DMat3> =
            current.iter().zip(&before).map(|(q, b)| *b * rotation_matrix(*q).transpose()).collect();
        let mut by_change = vec![DMat3::ZERO; current.len()];
        let share = weight / self.list.len().max(1) as f64;
        let loss = self.mean_over(|&(i, j, w, _)| {
            let (i, j) = (i as usize, j as usize);
            let difference = change[i] - change[j];
            let square: f64 = difference.to_cols_array().iter().map(|v| v * v).sum();
            let root = (w * square + 1e-20).sqrt();
            let by_difference = difference * (share * w / root);
            by_change[i] += by_difference;
            by_change[j] -= by_difference;
            root
        });
        for ((out, q), (g, b)) in gradient.iter_mut().zip(current).zip(by_change.iter().zip(&before)) {
            // dR = B R^T, so dL/dR = (dL/ddR)^T B.
            let by_quaternion = rotation_matrix_pullback(*q, &(g.transpose() * *b));
            for k in 0..4 {
                out[k] += by_quaternion[k];
            }
        }
        loss
    }
}

/// `sum over invisible of |d| / denominator`; the released code divides by the count and is NaN when that is 0.
pub fn visibility(
    invisible: &[u32],
    displacement: &[DVec3],
    denominator: f64,
    weight: f64,
    gradient: &mut [DVec3],
) -> f64 {
    let share = weight / denominator.max(1.0);
    let mut sum = 0.0;
    for &i in invisible {
        gradient[i as usize] += visibility_gradient(displacement[i as usize], share);
        sum += displacement[i as usize].length();
    }
    sum / denominator.max(1.0)
}

/// Gradient of `share` times the length of the displacement of one invisible point.
#[inline]
pub fn visibility_gradient(displacement: DVec3, share: f64) -> DVec3 {
    displacement * (share / displacement.length().max(1e-12))
}

/// Rotation of a quaternion `w x y z` of any length.
pub fn rotation_matrix(q: [f64; 4]) -> DMat3 {
    let n = q.iter().map(|v| v * v).sum::<f64>().sqrt();
    let [w, x, y, z] = q.map(|v| v / n);
    DMat3::from_quat(glam::DQuat::from_xyzw(x, y, z, w))
}

/// Gradient by the quaternion of a loss with gradient `g` by the matrix (same index order).
fn rotation_matrix_pullback(q: [f64; 4], g: &DMat3) -> [f64; 4] {
    let n = q.iter().map(|v| v * v).sum::<f64>().sqrt();
    let u = q.map(|v| v / n);
    let [w, x, y, z] = u;
    // m(r, c): gradient by the entry in row r and column c.
    let m = |r: usize, c: usize| g.col(c)[r];
    let by_unit = [
        2.0 * (x * (m(2, 1) - m(1, 2)) + y * (m(0, 2) - m(2, 0)) + z * (m(1, 0) - m(0, 1))),
        2.0 * (y * (m(0, 1) + m(1, 0)) + z * (m(0, 2) + m(2, 0)) + w * (m(2, 1) - m(1, 2)))
            - 4.0 * x * (m(1, 1) + m(2, 2)),
        2.0 * (x * (m(0, 1) + m(1, 0)) + z * (m(1, 2) + m(2, 1)) + w * (m(0, 2) - m(2, 0)))
            - 4.0 * y * (m(0, 0) + m(2, 2)),
        2.0 * (x * (m(0, 2) + m(2, 0)) + y * (m(1, 2) + m(2, 1)) + w * (m(1, 0) - m(0, 1)))
            - 4.0 * z * (m(0, 0) + m(1, 1)),
    ];
    let along: f64 = by_unit.iter().zip(&u).map(|(a, b)| a * b).sum();
    std::array::from_fn(|k| (by_unit[k] - along * u[k]) / n)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::{CounterRng, Stage};

    fn cloud(n: usize, key: u64) -> Vec<DVec3> {
        let mut rng = CounterRng::new(8, Stage::Test, &[key]);
        (0..n).map(|_| DVec3::new(rng.normal(), rng.normal(), rng.normal())).collect()
    }

    /// Compares an analytic gradient with central differences in every coordinate.
    fn check(values: &[f64], analytic: &[f64], loss: impl Fn(&[f64]) -> f64) {
        let mut x = values.to_vec();
        for k in 0..x.len() {
            let (old, step) = (x[k], 1e-6);
            x[k] = old + step;
            let high = loss(&x);
            x[k] = old - step;
            let want = (high - loss(&x)) / (2.0 * step);
            x[k] = old;
            assert!((analytic[k] - want).abs() < 1e-8 + 1e-5 * want.abs(), "{k}: {} {want}", analytic[k]);
        }
    }

    fn flat(points: &[DVec3]) -> Vec<f64> {
        points.iter().flat_map(|p| p.to_array()).collect()
    }

    fn points(values: &[f64]) -> Vec<DVec3> {
        values.chunks_exact(3).map(DVec3::from_slice).collect()
    }

    #[test]
    fn each_point_is_paired_with_its_nearest_others_by_their_distance() {
        let rest = cloud(12, 1);
        let pairs = Pairs::new(&rest, 4, 0.7);
        for (i, of_point) in pairs.list.chunks_exact(4).enumerate() {
            let mut others: Vec<f64> = (0..12).filter(|j| *j != i).map(|j| rest[i].distance(rest[j])).collect();
            others.sort_by(f64::total_cmp);
            for (&(from, to, weight, distance), nearest) in of_point.iter().zip(others) {
                assert!(from as usize == i && to as usize != i && (distance - nearest).abs() < 1e-12);
                assert!((weight - (-0.7 * nearest).exp()).abs() < 1e-12);
            }
        }
        // Everything half as large again: each pair is stretched by half its distance.
        let grown: Vec<DVec3> = rest.iter().map(|p| *p * 1.5).collect();
        let terms: Vec<f64> = pairs.list.iter().map(|&(_, _, weight, distance)| weight * 0.5 * distance).collect();
        let isometry = pairs.isometry(&grown, 1.0, &mut [DVec3::ZERO; 12]);
        assert!((isometry - terms.iter().sum::<f64>() / 48.0).abs() < 1e-12, "{isometry}");
    }

    #[test]
    fn gradients_equal_central_differences() {
        let (rest, previous, current) = (cloud(12, 1), cloud(12, 2), cloud(12, 3));
        let pairs = Pairs::new(&rest, 4, 0.7);
        let run = |term: &dyn Fn(&[DVec3], &mut [DVec3]) -> f64| {
            let mut gradient = vec![DVec3::ZERO; 12];
            term(&current, &mut gradient);
            check(&flat(&current), &flat(&gradient), |x| term(&points(x), &mut vec![DVec3::ZERO; 12]));
        };
        run(&|p, g| pairs.rigidity(&previous, p, 1.0, g));
        run(&|p, g| pairs.isometry(p, 1.0, g));
        run(&|p, g| visibility(&[1, 5, 7], p, 4.0, 1.0, g));
    }

    #[test]
    fn rotation_gradient_equals_central_differences() {
        let mut rng = CounterRng::new(8, Stage::Test, &[9]);
        let mut quaternions = || -> Vec<[f64; 4]> { (0..9).map(|_| std::array::from_fn(|_| rng.normal())).collect() };
        let (previous, current) = (quaternions(), quaternions());
        let pairs = Pairs::new(&cloud(9, 4), 3, 0.5);
        let mut gradient = vec![[0.0; 4]; 9];
        pairs.rotation(&previous, &current, 1.0, &mut gradient);
        check(current.as_flattened(), gradient.as_flattened(), |x| {
            let q: Vec<[f64; 4]> = x.chunks_exact(4).map(|c| c.try_into().unwrap()).collect();
            pairs.rotation(&previous, &q, 1.0, &mut vec![[0.0; 4]; 9])
        });
        // A rotation common to all points costs nothing; that of a single point does.
        assert!(pairs.rotation(&previous, &previous, 1.0, &mut gradient) < 1e-7);
    }

    #[test]
    fn a_stretched_patch_is_restored_by_isometry_and_a_displaced_one_by_rigidity() {
        let rest: Vec<DVec3> = (0..25).map(|i| DVec3::new((i % 5) as f64, (i / 5) as f64, 0.0)).collect();
        let pairs = Pairs::new(&rest, 8, 0.3);
        let stretched: Vec<DVec3> = rest.iter().map(|p| *p * DVec3::new(1.4, 1.0, 1.0)).collect();
        let descend = |term: &dyn Fn(&[DVec3], &mut [DVec3]) -> f64| {
            let mut p = stretched.clone();
            let start = term(&p, &mut vec![DVec3::ZERO; 25]);
            for i in 0..4000 {
                let mut g = vec![DVec3::ZERO; 25];
                term(&p, &mut g);
                let step = 0.5 * (1.0 - i as f64 / 4000.0);
                for (p, g) in p.iter_mut().zip(&g) {
                    *p -= *g * step;
                }
            }
            term(&p, &mut vec![DVec3::ZERO; 25]) / start
        };
        assert!(descend(&|p, g| pairs.isometry(p, 1.0, g)) < 0.02);
        assert!(descend(&|p, g| pairs.rigidity(&rest, p, 1.0, g)) < 0.02);
    }

    #[test]
    fn nothing_invisible_is_no_nan() {
        assert_eq!(visibility(&[], &[DVec3::ONE], 0.0, 1.0, &mut [DVec3::ZERO]), 0.0);
    }
}
