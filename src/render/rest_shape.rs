//! What the look of the wall needs to know of the shape at rest, per vertex: the airway's generation, the distance along
//! it, the place in its cross-section, and how sharp a ridge the wall is there. No centreline is known in this room: all
//! of it comes from the surface.

use glam::DVec3;

use super::axial::axial_distance_mm;
use crate::base::{Neighbours, TriangleMesh};
use crate::ffi::trace::tracer::RestVertex;

/// Length along the airway in mm of the pieces whose middles stand for the centreline.
const PIECE_MM: f64 = 2.0;
/// Rounds of neighbour averaging that take the pieces' steps out of the places in the cross-section.
const SECTION_ROUNDS: usize = 8;
/// Rounds of neighbour averaging of the axis.
const AXIS_ROUNDS: usize = 12;
/// Rounds of neighbour averaging of the curvature: a ridge is wider than a vertex.
const RIDGE_ROUNDS: usize = 2;

/// One record per vertex. `generation` per vertex (0 trachea; may be fractional); all else 0 unless `shaped`.
pub(super) fn rest_vertices(mesh: &TriangleMesh, generation: &[f32], shaped: bool) -> Vec<RestVertex> {
    let plain = |&generation: &f32| RestVertex { generation, ..RestVertex::default() };
    if !shaped {
        return generation.iter().map(plain).collect();
    }
    let neighbours = mesh.neighbours();
    let axial = axial_distance_mm(mesh, &neighbours, generation);
    let section = section_mm(mesh, &axial, &neighbours);
    let ridge = ridge_per_mm(mesh, &neighbours);
    (0..mesh.vertices.len())
        .map(|v| RestVertex {
            generation: generation[v],
            axial_mm: axial[v],
            section_mm: section[v].to_array().map(|value| value as f32),
            ridge_per_mm: ridge[v].x as f32,
        })
        .collect()
}

/// From the middle of the airway to each vertex, across the airway.
///
/// The airway is cut into pieces along its length; connected vertices of one piece share one middle. Where it branches,
/// the middle jumps from the common one to those of the branches, which the averaging spreads over some millimetres.
fn section_mm(mesh: &TriangleMesh, axial: &[f32], neighbours: &Neighbours) -> Vec<DVec3> {
    let count = mesh.vertices.len();
    let piece = |v: usize| (f64::from(axial[v]) / PIECE_MM).floor() as i64;
    let mut middle = vec![None; count];
    for first in 0..count {
        if middle[first].is_some() {
            continue;
        }
        let (mut members, mut next) = (vec![first], 0);
        middle[first] = Some(DVec3::ZERO);
        while next < members.len() {
            for &n in neighbours.of(members[next]) {
                let n = n as usize;
                if middle[n].is_none() && piece(n) == piece(first) {
                    middle[n] = Some(DVec3::ZERO);
                    members.push(n);
                }
            }
            next += 1;
        }
        let mean = members.iter().map(|&v| mesh.vertices[v]).sum::<DVec3>() / members.len() as f64;
        members.iter().for_each(|&v| middle[v] = Some(mean));
    }
    let axis = neighbours.smoothed(axial_gradient(mesh, axial), AXIS_ROUNDS);
    let across = (0..count)
        .map(|v| {
            let offset = mesh.vertices[v] - middle[v].unwrap_or(mesh.vertices[v]);
            let axis = axis[v].normalize_or_zero();
            offset - axis * axis.dot(offset)
        })
        .collect();
    neighbours.smoothed(across, SECTION_ROUNDS)
}

/// Gradient of the distance along the airway on the surface, area-weighted per vertex; its length has no meaning.
fn axial_gradient(mesh: &TriangleMesh, axial: &[f32]) -> Vec<DVec3> {
    let mut gradient = vec![DVec3::ZERO; mesh.vertices.len()];
    for (face, corners) in mesh.faces.iter().enumerate() {
        let [a, b, c] = mesh.corners(face);
        let normal = (b - a).cross(c - a);
        let [va, vb, vc] = corners.map(|v| f64::from(axial[v as usize]));
        let twice_area = normal.length();
        if twice_area <= 1e-12 {
            continue;
        }
        // (dv1 (e2 x n) + dv2 (n x e1)) / |n|^2, times the area.
        let slope = (c - a).cross(normal) * (vb - va) + normal.cross(b - a) * (vc - va);
        corners.iter().for_each(|&v| gradient[v as usize] += slope / twice_area);
    }
    gradient
}

/// Curvature (1 / mm, in x) of the wall where it stands out into the lumen, as carinas do; 0 elsewhere. Mean over the
/// neighbours of 2 (q - p) n / |q - p|^2, the curvature of the circle through p and q that touches the wall in p.
fn ridge_per_mm(mesh: &TriangleMesh, neighbours: &Neighbours) -> Vec<DVec3> {
    let normals = mesh.vertex_normals();
    let curvature = (0..mesh.vertices.len())
        .map(|v| {
            let around = neighbours.of(v);
            let sum: f64 = around
                .iter()
                .map(|&n| {
                    let way = mesh.vertices[n as usize] - mesh.vertices[v];
                    2.0 * way.dot(normals[v]) / way.length_squared().max(1e-12)
                })
                .sum();
            DVec3::new((-sum / around.len().max(1) as f64).clamp(-2.0, 2.0), 0.0, 0.0)
        })
        .collect();
    let mut ridge = neighbours.smoothed(curvature, RIDGE_ROUNDS);
    ridge.iter_mut().for_each(|r| r.x = r.x.max(0.0));
    ridge
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A bent tube of radius 5 mm around a quarter of a circle of radius 60 mm; normals into the lumen.
    fn bend() -> TriangleMesh {
        let (around, along) = (48u32, 140u32);
        let mut mesh = TriangleMesh::default();
        for k in 0..=along {
            let turn = f64::from(k) / f64::from(along) * std::f64::consts::FRAC_PI_2;
            let outwards = DVec3::new(turn.cos(), 0.0, turn.sin());
            for a in 0..around {
                let angle = (f64::from(a) + 0.5 * f64::from(k % 2)) / f64::from(around) * std::f64::consts::TAU;
                mesh.vertices.push(outwards * (60.0 + 5.0 * angle.cos()) + DVec3::Y * (5.0 * angle.sin()));
            }
        }
        for k in 0..along {
            for a in 0..around {
                let (p, q) = (k * around + a, k * around + (a + 1) % around);
                mesh.faces.push([p, q, p + around]);
                mesh.faces.push([q, q + around, p + around]);
            }
        }
        mesh
    }

    #[test]
    fn the_place_in_a_bent_tube_is_that_from_its_middle_line() {
        let mesh = bend();
        let generation = vec![0.0; mesh.vertices.len()];
        let shape = rest_vertices(&mesh, &generation, true);
        let mut worst = 0.0f64;
        for k in 30..110usize {
            let turn = k as f64 / 140.0 * std::f64::consts::FRAC_PI_2;
            let middle = DVec3::new(turn.cos(), 0.0, turn.sin()) * 60.0;
            for a in 0..48 {
                let v = k * 48 + a;
                let place = DVec3::from(shape[v].section_mm.map(f64::from));
                worst = worst.max(place.distance(mesh.vertices[v] - middle));
            }
        }
        assert!(worst < 0.8, "{worst} mm of 5");
    }

    #[test]
    fn a_tube_has_no_ridges_and_a_bar_across_it_has() {
        let mut tube = bend();
        let inside = tube.signed_volume();
        let generation = vec![0.0; tube.vertices.len()];
        if tube.area_normal(0).dot(tube.vertices[0] - DVec3::new(60.0, 0.0, 0.0)) > 0.0 {
            tube.flip();
        }
        assert!(inside.is_finite());
        let flat = rest_vertices(&tube, &generation, true);
        assert!(flat[48 * 20..48 * 120].iter().all(|v| v.ridge_per_mm == 0.0));
        // Seen from outside, a tube of radius 5 mm is a ridge: mean curvature 1 / 5 around it and none along it.
        tube.flip();
        let ridge = rest_vertices(&tube, &generation, true);
        let middle = &ridge[48 * 60..48 * 61];
        let mean = middle.iter().map(|v| v.ridge_per_mm).sum::<f32>() / 48.0;
        assert!((0.07..0.15).contains(&mean), "{mean}");
        // What is not asked for is not computed.
        assert!(rest_vertices(&tube, &generation, false).iter().all(|v| v.axial_mm == 0.0));
    }
}
