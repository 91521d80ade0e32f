//! The zero surface of a grid of values, and its decimation.
//!
//! Surface nets (Gibson, "Constrained elastic surface nets", MICCAI 1998) by the crate `fast-surface-nets`: one vertex in
//! each cube of eight nodes that the surface crosses. Decimation by quadric errors by `meshopt`. Why these:
//! `docs/decisions/0015-from-scans-to-case.md`.

use fast_surface_nets::ndshape::RuntimeShape;
use fast_surface_nets::{SurfaceNetsBuffer, surface_nets};
use glam::{DVec3, Vec3};
use meshopt::SimplifyOptions;

use crate::base::TriangleMesh;

/// Bytes a node that surface nets need beside the values: a vertex number.
pub const NODE_BYTES: f64 = 4.0;

/// How often decimation is asked again.
const LOCKING_ROUNDS: usize = 8;

/// The zero surface of `values` (x fastest, at `origin + spacing_mm * (i, j, k)`), normals towards negative values. A
/// closed manifold where the rim is not negative and the negative nodes are a well-composed set ([`super::topology`]).
pub fn isosurface(values: &[f32], size: [usize; 3], origin: DVec3, spacing_mm: f64) -> TriangleMesh {
    let size = size.map(|n| n as u32);
    let shape = RuntimeShape::<u32, 3>::new(size);
    let mut net = SurfaceNetsBuffer::default();
    surface_nets(values, &shape, [0; 3], size.map(|n| n - 1), &mut net);
    let vertices = net.positions.iter().map(|p| origin + Vec3::from(*p).as_dvec3() * spacing_mm).collect();
    // The crate's faces look to positive values.
    let faces = net.indices.chunks_exact(3).map(|face| [face[0], face[2], face[1]]).collect();
    TriangleMesh { vertices, faces }
}

/// The surface with fewer faces: `count` of them, or as many as keep within `error_mm` of it.
///
/// meshopt does not ask whether a collapse joins two sheets. Where one did, the vertices are locked, and it is asked
/// again; a surface that is still not a manifold after some rounds stays as it was.
pub fn decimated(mesh: &TriangleMesh, count: usize, error_mm: f64) -> TriangleMesh {
    // From the first vertex on, so that single precision loses nothing.
    let origin = mesh.vertices.first().copied().unwrap_or_default();
    let positions: Vec<[f32; 3]> = mesh.vertices.iter().map(|v| (v - origin).as_vec3().to_array()).collect();
    let options = SimplifyOptions::ErrorAbsolute | SimplifyOptions::Regularize;
    let mut is_locked = vec![false; positions.len()];
    for _ in 0..LOCKING_ROUNDS {
        let indices = meshopt::simplify_with_locks_decoder(
            mesh.faces.as_flattened(),
            &positions,
            &is_locked,
            3 * count,
            error_mm as f32,
            options,
            None,
        );
        let faces: Vec<[u32; 3]> = indices.chunks_exact(3).map(|face| [face[0], face[1], face[2]]).collect();
        let joined = joined_vertices(&faces, positions.len());
        if joined.is_empty() {
            return with_vertices_of(mesh, faces);
        }
        // With their neighbours, of which one was drawn away.
        for face in faces.iter().chain(&mesh.faces).filter(|face| face.iter().any(|v| joined.contains(v))) {
            face.iter().for_each(|&vertex| is_locked[vertex as usize] = true);
        }
    }
    mesh.clone()
}

/// The vertices of faces at which the surface is no disc: the faces around them are not one closed fan.
fn joined_vertices(faces: &[[u32; 3]], vertices: usize) -> Vec<u32> {
    let mut fans: Vec<Vec<(u32, u32)>> = vec![Vec::new(); vertices];
    for &[a, b, c] in faces {
        for [vertex, from, to] in [[a, b, c], [b, c, a], [c, a, b]] {
            fans[vertex as usize].push((from, to));
        }
    }
    let is_disc = |fan: &[(u32, u32)]| {
        let Some(&(first, mut at)) = fan.first() else { return true };
        let mut steps = 1;
        while at != first && steps < fan.len() {
            let mut onward = fan.iter().filter(|(from, _)| *from == at);
            let (Some(&(_, next)), None) = (onward.next(), onward.next()) else { return false };
            at = next;
            steps += 1;
        }
        at == first && steps == fan.len()
    };
    (0..vertices as u32).filter(|&vertex| !is_disc(&fans[vertex as usize])).collect()
}

/// Some faces of a mesh with the vertices that they use.
fn with_vertices_of(mesh: &TriangleMesh, mut faces: Vec<[u32; 3]>) -> TriangleMesh {
    let mut number = vec![u32::MAX; mesh.vertices.len()];
    let mut vertices = Vec::new();
    for vertex in faces.iter_mut().flatten() {
        let slot = &mut number[*vertex as usize];
        if *slot == u32::MAX {
            *slot = vertices.len() as u32;
            vertices.push(mesh.vertices[*vertex as usize]);
        }
        *vertex = *slot;
    }
    TriangleMesh { vertices, faces }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ct::lumen::euler_characteristic;

    const SIZE: [usize; 3] = [40, 36, 34];
    const ORIGIN: DVec3 = DVec3::new(-12.0, -9.0, -8.5);
    const SPACING_MM: f64 = 0.5;

    fn surface(inside: impl Fn(DVec3) -> f64) -> TriangleMesh {
        let node = |n: usize| [n % SIZE[0], n / SIZE[0] % SIZE[1], n / SIZE[0] / SIZE[1]].map(|c| c as f64);
        let place = |n: usize| ORIGIN + DVec3::from_array(node(n)) * SPACING_MM;
        let values: Vec<f32> = (0..SIZE.iter().product()).map(|n| inside(place(n)) as f32).collect();
        isosurface(&values, SIZE, ORIGIN, SPACING_MM)
    }

    #[test]
    fn a_ball_is_drawn_where_it_is_and_looks_inwards() {
        let (centre, radius) = (DVec3::new(-2.3, 0.2, -0.4), 5.3);
        let ball = surface(|p| p.distance(centre) - radius);
        ball.validate_closed().unwrap();
        assert_eq!(euler_characteristic(&ball), 2);
        let volume = 4.0 / 3.0 * std::f64::consts::PI * radius.powi(3);
        assert!((ball.signed_volume() + volume).abs() < 0.02 * volume, "{}", ball.signed_volume());
        for vertex in &ball.vertices {
            assert!((vertex.distance(centre) - radius).abs() < 0.1 * SPACING_MM, "{vertex}");
        }
    }

    /// A tube so thin that its two walls are one collapse apart.
    #[test]
    fn decimation_keeps_to_its_error_and_joins_no_walls() {
        let tube = |p: DVec3, radius: f64| {
            let along = p.x.clamp(-8.0, 4.0);
            p.distance(DVec3::new(along, 0.25, 0.25)) - radius
        };
        for (radius, error_mm) in [(0.8, 1.0), (0.6, 0.6), (3.0, 0.1)] {
            let fine = surface(|p| tube(p, radius));
            let coarse = decimated(&fine, 40, error_mm);
            println!("radius {radius}: {} of {} faces", coarse.faces.len(), fine.faces.len());
            coarse.validate_closed().unwrap();
            assert_eq!(euler_characteristic(&coarse), 2);
            assert!(joined_vertices(&coarse.faces, coarse.vertices.len()).is_empty());
            assert!(coarse.faces.len() < fine.faces.len(), "{} of {}", coarse.faces.len(), fine.faces.len());
            let off = coarse.faces.iter().map(|face| {
                let middle = face.iter().map(|&v| coarse.vertices[v as usize]).sum::<DVec3>() / 3.0;
                tube(middle, radius).abs()
            });
            let most = off.fold(0.0, f64::max);
            assert!(most < 2.0 * error_mm + 0.1, "radius {radius}: {most} mm for {error_mm}");
        }
    }

    #[test]
    fn joined_sheets_are_found() {
        let ball = surface(|p| p.length() - 4.0);
        let count = ball.vertices.len();
        assert!(joined_vertices(&ball.faces, count).is_empty());
        // One vertex of two sheets, and an edge of four faces.
        let mut pinched = ball.faces.clone();
        pinched.iter_mut().flatten().filter(|v| **v == 0).for_each(|v| *v = (count - 1) as u32);
        assert_eq!(joined_vertices(&pinched, count), [(count - 1) as u32]);
        assert!(!joined_vertices(&ball.faces[1..], count).is_empty());
    }
}
