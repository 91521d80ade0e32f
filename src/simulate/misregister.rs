//! The error that an imperfect registration of the two CTs leaves in the expiration mesh: a sum of plane waves with
//! random directions, phases and amplitudes, smooth over several cm as the residuals of lung registration are, scaled
//! to a stated root mean square over the vertices.

use std::f64::consts::TAU;

use glam::DVec3;

use crate::base::TriangleMesh;
use crate::base::random::{CounterRng, Stage};

/// Waves in the sum.
const WAVES: usize = 12;
/// Shortest and longest wave, mm.
const LENGTHS_MM: [f64; 2] = [60.0, 160.0];

/// `mesh` with an error of `rms_mm` by `seed`.
pub fn misregister(mesh: &TriangleMesh, rms_mm: f64, seed: u64) -> TriangleMesh {
    let mut rng = CounterRng::new(seed, Stage::Registration, &[]);
    let mut vector = || DVec3::new(rng.normal(), rng.normal(), rng.normal());
    let directions: Vec<[DVec3; 2]> = (0..WAVES).map(|_| [vector().normalize_or(DVec3::X), vector()]).collect();
    let waves: Vec<(DVec3, f64, DVec3)> = directions
        .into_iter()
        .map(|[direction, amplitude]| {
            let number = TAU / rng.range(LENGTHS_MM[0], LENGTHS_MM[1]);
            (direction * number, rng.range(0.0, TAU), amplitude)
        })
        .collect();
    let error = |v: &DVec3| waves.iter().map(|(number, start, a)| *a * (number.dot(*v) + start).sin()).sum::<DVec3>();
    let errors: Vec<DVec3> = mesh.vertices.iter().map(error).collect();
    let square = errors.iter().map(|e| e.length_squared()).sum::<f64>() / errors.len().max(1) as f64;
    let scale = if square > 0.0 { rms_mm / square.sqrt() } else { 0.0 };
    let vertices = mesh.vertices.iter().zip(&errors).map(|(v, e)| *v + *e * scale).collect();
    TriangleMesh { vertices, faces: mesh.faces.clone() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_error_has_the_stated_size_and_is_smooth() {
        let vertices: Vec<DVec3> =
            (0..4000).map(|i| DVec3::new((i % 20) as f64, (i / 20 % 20) as f64, (i / 400) as f64 * 12.0)).collect();
        let mesh = TriangleMesh { vertices, faces: Vec::new() };
        let wrong = misregister(&mesh, 1.5, 3);
        let errors: Vec<DVec3> = wrong.vertices.iter().zip(&mesh.vertices).map(|(a, b)| *a - *b).collect();
        let rms = (errors.iter().map(|e| e.length_squared()).sum::<f64>() / 4000.0).sqrt();
        assert!((rms - 1.5).abs() < 1e-9, "{rms}");
        let step = errors.windows(2).enumerate().filter(|(i, _)| i % 20 != 19).map(|(_, w)| w[0].distance(w[1]));
        assert!(step.fold(0.0, f64::max) < 0.6, "neighbours one mm apart");
        assert_eq!(wrong.vertices, misregister(&mesh, 1.5, 3).vertices);
        assert_ne!(wrong.vertices, misregister(&mesh, 1.5, 4).vertices);
    }
}
