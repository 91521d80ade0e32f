//! Keeps the faces of real surfaces from turning over between the breath holds.
//!
//! A fold-free motion may still turn single faces: real surfaces hold slivers much thinner than the scale of the motion,
//! and a raw mask's steps stand across the direction in which the lumen narrows. Two remedies, both local: the
//! narrowing yields around such faces, and the motion is averaged over neighbours. What either moved is told by
//! [`Mending`].

use glam::DVec3;

use super::field_check::flipped_faces;
use crate::base::TriangleMesh;

/// Most rounds of averaging around slivers; and in cases that were not mended at import no averaging when more than one
/// face in this many is turned over.
const SETTLING_ROUNDS: usize = 60;
const SETTLED_PART: usize = 1000;
/// Rounds in which the narrowing yields; what is left of it at a face's corners after each; rounds of spreading.
const YIELDING_ROUNDS: usize = 40;
const KEPT_SHARE: f64 = 0.6;
const SPREADING_ROUNDS: usize = 3;

/// By how much vertices stand elsewhere than the motion alone would have them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Mending {
    /// Faces that would turn over.
    pub faces: usize,
    /// Vertices that were moved by more than a micrometre.
    pub vertices: usize,
    /// Mean over those, mm.
    pub mean_mm: f64,
    /// Largest, mm.
    pub most_mm: f64,
}

impl Mending {
    /// What changed `wanted` into `mended`.
    pub fn between(rest: &TriangleMesh, wanted: &[DVec3], mended: &[DVec3]) -> Mending {
        let faces = flipped_faces(rest, wanted).len();
        let moved: Vec<f64> = wanted.iter().zip(mended).map(|(a, b)| a.distance(*b)).filter(|d| *d > 1e-3).collect();
        let count = moved.len().max(1) as f64;
        Mending {
            faces,
            vertices: moved.len(),
            // The sum of nothing is -0.
            mean_mm: moved.iter().sum::<f64>().abs() / count,
            most_mm: moved.iter().copied().fold(0.0, f64::max),
        }
    }
}

/// The motion averaged around the few faces that it turns over; as it was when they are many, or when that does not
/// help: who asks checks again.
pub fn settled(rest: &TriangleMesh, expiration: Vec<DVec3>) -> Vec<DVec3> {
    let flipped = flipped_faces(rest, &expiration);
    if flipped.is_empty() || flipped.len() * SETTLED_PART > rest.faces.len() {
        return expiration;
    }
    averaged(rest, expiration, flipped)
}

/// The motion averaged around every face that it turns over, however many. Faces may be left.
pub fn mended(rest: &TriangleMesh, expiration: Vec<DVec3>) -> Vec<DVec3> {
    match flipped_faces(rest, &expiration) {
        flipped if flipped.is_empty() => expiration,
        flipped => averaged(rest, expiration, flipped),
    }
}

fn averaged(rest: &TriangleMesh, mut expiration: Vec<DVec3>, mut flipped: Vec<u32>) -> Vec<DVec3> {
    let neighbours = rest.neighbours();
    let around = |v: usize| neighbours.of(v).iter().map(|&n| n as usize);
    let mut touched: Vec<usize> = Vec::new();
    for _ in 0..SETTLING_ROUNDS {
        let corners = flipped.iter().flat_map(|&f| rest.faces[f as usize]).map(|v| v as usize);
        touched.extend(corners.flat_map(|v| around(v).chain([v])));
        touched.sort_unstable();
        touched.dedup();
        let averaged: Vec<DVec3> = touched
            .iter()
            .map(|&v| {
                let count = neighbours.of(v).len().max(1) as f64;
                around(v).map(|n| expiration[n] - rest.vertices[n]).sum::<DVec3>() / count
            })
            .collect();
        for (&v, motion) in touched.iter().zip(averaged) {
            expiration[v] = rest.vertices[v] + motion;
        }
        flipped = flipped_faces(rest, &expiration);
        if flipped.is_empty() {
            break;
        }
    }
    expiration
}

/// The state `moved(share)`, where each vertex has such a share of the narrowing, the given one at first, that no face
/// turns over; faces that turn over without any narrowing are left to the averaging of [`mended`].
pub fn yielding(rest: &TriangleMesh, mut share: Vec<f64>, moved: impl Fn(&[f64]) -> Vec<DVec3>) -> Vec<DVec3> {
    let neighbours = rest.neighbours();
    let around = |v: usize| neighbours.of(v).iter().map(|&n| n as usize);
    let mut expiration = moved(&share);
    for _ in 0..YIELDING_ROUNDS {
        let flipped = flipped_faces(rest, &expiration);
        if flipped.is_empty() {
            return expiration;
        }
        let mut touched: Vec<usize> =
            flipped.iter().flat_map(|&f| rest.faces[f as usize]).map(|v| v as usize).collect();
        touched.sort_unstable();
        touched.dedup();
        touched.iter().for_each(|&v| share[v] *= KEPT_SHARE);
        // The step from yielding to unyielding vertices must not fold in its turn.
        for _ in 0..SPREADING_ROUNDS {
            let wider: Vec<usize> = touched.iter().flat_map(|&v| around(v).chain([v])).collect();
            touched = wider;
            touched.sort_unstable();
            touched.dedup();
            let mean = |v: usize| around(v).map(|n| share[n]).sum::<f64>() / around(v).count().max(1) as f64;
            let spread: Vec<f64> = touched.iter().map(|&v| share[v].min(0.5 * (share[v] + mean(v)))).collect();
            touched.iter().zip(spread).for_each(|(&v, value)| share[v] = value);
        }
        expiration = moved(&share);
    }
    mended(rest, expiration)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A flat sheet of 2 n^2 triangles with a step in its middle that stands upright.
    fn stepped(n: usize) -> TriangleMesh {
        let place = |i: usize, j: usize| {
            let x = i as f64;
            DVec3::new(if i > n / 2 { x - 0.98 } else { x }, j as f64, if i > n / 2 { 1.0 } else { 0.0 })
        };
        let vertices = (0..=n).flat_map(|j| (0..=n).map(move |i| place(i, j))).collect();
        let at = |i: usize, j: usize| (j * (n + 1) + i) as u32;
        let faces = (0..n)
            .flat_map(|j| (0..n).map(move |i| (i, j)))
            .flat_map(|(i, j)| [[at(i, j), at(i + 1, j), at(i, j + 1)], [at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)]])
            .collect();
        TriangleMesh { vertices, faces }
    }

    #[test]
    fn narrowing_yields_where_steps_would_turn_over_and_nowhere_else() {
        let mesh = stepped(30);
        // The sheet's upper part sinks below the lower one: the step between them turns over.
        let push = |v: &DVec3| DVec3::new(-0.35 * v.z, 0.0, -1.1 * v.z);
        let moved = |share: &[f64]| mesh.vertices.iter().zip(share).map(|(v, s)| v + push(v) * *s).collect::<Vec<_>>();
        let wanted = moved(&vec![1.0; mesh.vertices.len()]);
        assert!(!flipped_faces(&mesh, &wanted).is_empty());
        assert_eq!(settled(&mesh, wanted.clone()), wanted, "too many to be slivers");
        let found = yielding(&mesh, vec![1.0; mesh.vertices.len()], moved);
        assert!(flipped_faces(&mesh, &found).is_empty());
        let mending = Mending::between(&mesh, &wanted, &found);
        assert!(mending.faces >= 60 && mending.most_mm < 1.0, "{mending:?}");
        assert!(mending.vertices < mesh.vertices.len() * 3 / 4, "{mending:?}");
        let far = mesh.vertices.len() - 1;
        assert_eq!(found[far], wanted[far]);
    }

    #[test]
    fn a_motion_that_folds_is_averaged_until_it_does_not() {
        let mesh = stepped(12);
        let mut wanted: Vec<DVec3> = mesh.vertices.iter().map(|v| v + DVec3::X).collect();
        wanted[40] += DVec3::new(2.5, 0.0, 0.0);
        let found = mended(&mesh, wanted.clone());
        assert!(flipped_faces(&mesh, &found).is_empty());
        assert!(Mending::between(&mesh, &wanted, &found).most_mm > 0.5);
    }
}
