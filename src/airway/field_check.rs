//! Is the interpolation (1 - alpha) V_insp + alpha V_exp free of folds at every alpha in [0, 1]?
//!
//! Triangles: with edges e1 + alpha d1 and e2 + alpha d2 the area normal is quadratic in alpha, and so is its
//! projection onto the normal at rest; the minimum of that quadratic over [0, 1] is known in closed form, so the check
//! is exact. Field: the determinant of I + alpha grad u is cubic in alpha; its coefficients are the invariants of grad
//! u, and its minimum over [0, 1] lies at an end or at a root of the derivative: exact as well.

use glam::{DMat3, DVec3};
use rayon::prelude::*;

use super::field::BreathingField;
use crate::base::TriangleMesh;

/// Faces whose normal, at some alpha in [0, 1], is no longer on the side of its rest normal; in order.
pub fn flipped_faces(inspiration: &TriangleMesh, expiration: &[DVec3]) -> Vec<u32> {
    (0..inspiration.faces.len() as u32)
        .into_par_iter()
        .filter(|&f| {
            let [a, b, c] = inspiration.corners(f as usize);
            let [a1, b1, c1] = inspiration.faces[f as usize].map(|v| expiration[v as usize]);
            let (e1, e2) = (b - a, c - a);
            let (d1, d2) = ((b1 - a1) - e1, (c1 - a1) - e2);
            let rest = e1.cross(e2);
            let linear = rest.dot(d1.cross(e2) + e1.cross(d2));
            let square = rest.dot(d1.cross(d2));
            lowest_on_unit(&[rest.length_squared(), linear, square, 0.0]) <= 0.0
        })
        .collect()
}

/// Least det(I + alpha grad u) over alpha in [0, 1] and over `points`, with the index of the point.
pub fn least_determinant(field: &BreathingField, points: &[DVec3]) -> (f64, usize) {
    let all: Vec<f64> = points
        .par_iter()
        .map(|&x| {
            let g = field.gradient(x);
            lowest_on_unit(&determinant_polynomial(&g))
        })
        .collect();
    all.iter().enumerate().fold((f64::INFINITY, 0), |best, (i, &d)| if d < best.0 { (d, i) } else { best })
}

/// det(I + alpha G) = 1 + alpha tr G + alpha^2 (tr^2 G - tr G^2) / 2 + alpha^3 det G.
fn determinant_polynomial(g: &DMat3) -> [f64; 4] {
    let trace = |m: &DMat3| m.x_axis.x + m.y_axis.y + m.z_axis.z;
    let t = trace(g);
    [1.0, t, 0.5 * (t * t - trace(&(*g * *g))), g.determinant()]
}

/// Minimum over [0, 1] of c0 + c1 a + c2 a^2 + c3 a^3.
fn lowest_on_unit(c: &[f64; 4]) -> f64 {
    let value = |a: f64| c[0] + a * (c[1] + a * (c[2] + a * c[3]));
    let (qa, qb, qc) = (3.0 * c[3], 2.0 * c[2], c[1]);
    let mut stationary = [f64::NAN; 2];
    if qa.abs() > 1e-300 {
        let discriminant = qb * qb - 4.0 * qa * qc;
        if discriminant >= 0.0 {
            let q = -0.5 * (qb + discriminant.sqrt().copysign(qb));
            stationary = [q / qa, qc / q];
        }
    } else if qb != 0.0 {
        stationary[0] = -qc / qb;
    }
    let inside = stationary.iter().filter(|a| (0.0..=1.0).contains(*a)).map(|&a| value(a));
    inside.fold(value(0.0).min(value(1.0)), f64::min)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn triangle() -> TriangleMesh {
        TriangleMesh { vertices: vec![DVec3::ZERO, DVec3::X, DVec3::Y], faces: vec![[0, 1, 2]] }
    }

    #[test]
    fn a_flip_in_the_middle_is_found_though_both_ends_are_fine() {
        let mesh = triangle();
        // Half a turn in the plane: the same normal at both ends, but the triangle passes through a point.
        let turned = [DVec3::new(0.0, 0.0, 0.0), DVec3::NEG_X, DVec3::NEG_Y];
        assert_eq!(flipped_faces(&mesh, &turned), [0]);
        let wider = [DVec3::ZERO, DVec3::X * 2.0, DVec3::new(0.4, 0.7, 0.3)];
        assert!(flipped_faces(&mesh, &wider).is_empty());
        let mirrored = [DVec3::ZERO, DVec3::NEG_X, DVec3::Y];
        assert_eq!(flipped_faces(&mesh, &mirrored), [0]);
    }

    #[test]
    fn the_closed_form_agrees_with_dense_sampling() {
        for c in [[1.0, -3.0, 2.5, 0.1], [1.0, -0.5, 0.0, 0.0], [1.0, 0.3, -4.0, 3.0], [1.0, -1.8, 0.9, -1e-9]] {
            let dense = (0..=10_000)
                .map(|i| i as f64 / 1e4)
                .map(|a| c[0] + a * (c[1] + a * (c[2] + a * c[3])))
                .fold(f64::INFINITY, f64::min);
            assert!((lowest_on_unit(&c) - dense).abs() < 1e-6, "{c:?}");
        }
    }

    #[test]
    fn a_field_that_folds_is_seen() {
        let mut field = BreathingField {
            source: String::new(),
            scale: 1.0,
            softening_mm: 10.0,
            origin_mm: [0.0; 3],
            affine: [[0.0, -90.0, 0.0, 0.0], [0.0; 4], [0.0; 4]],
            centers: vec![],
        };
        assert!((least_determinant(&field, &[DVec3::ONE]).0 - 0.1).abs() < 1e-12);
        field.affine[0][1] = -150.0;
        assert!((least_determinant(&field, &[DVec3::ONE]).0 + 0.5).abs() < 1e-12);
    }
}
