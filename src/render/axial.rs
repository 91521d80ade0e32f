//! Distance along the airway of every vertex, for the cartilage rings.
//!
//! Shortest paths over the edges (Dijkstra) from a ring of vertices at the upper end of the trachea, then smoothed over
//! neighbours. In a straight tube the level lines run around the lumen; around a bend they lag on the outer side by
//! (angle x diameter), which is left so: no centreline is known in this room.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use glam::DVec3;

use crate::base::{Neighbours, TriangleMesh};

/// Rounds of neighbour averaging that take the edge-path zigzag out of the level lines.
const SMOOTHING_ROUNDS: usize = 24;
/// Length of the end piece of the trachea whose vertices all have distance 0, in mm.
const END_PIECE_MM: f64 = 6.0;

/// Distance along the surface in mm, one per vertex, growing away from the trachea's end: that which lies farthest from
/// generation 1 and deeper (or at the low end of the longest axis where no generations are known).
pub fn axial_distance_mm(mesh: &TriangleMesh, neighbours: &Neighbours, generation: &[f32]) -> Vec<f32> {
    let deep: Vec<usize> = (0..mesh.vertices.len()).filter(|&v| generation[v] >= 1.0).collect();
    let height: Vec<f64> = if deep.is_empty() {
        let axis = longest_axis(mesh);
        mesh.vertices.iter().map(|v| -v.dot(axis)).collect()
    } else {
        shortest_paths(mesh, neighbours, &deep)
    };
    let top = height.iter().copied().filter(|h| h.is_finite()).fold(f64::NEG_INFINITY, f64::max);
    let start: Vec<usize> = (0..height.len()).filter(|&v| height[v] >= top - END_PIECE_MM).collect();
    let mut distance = shortest_paths(mesh, neighbours, &start);
    // Pieces that are not connected with the trachea have no rings of their own.
    distance.iter_mut().filter(|d| !d.is_finite()).for_each(|d| *d = 0.0);
    neighbours.smoothed(distance, SMOOTHING_ROUNDS).iter().map(|&d| d as f32).collect()
}

fn longest_axis(mesh: &TriangleMesh) -> DVec3 {
    let (low, high) = mesh.bounds();
    let size = high - low;
    if size.x >= size.y && size.x >= size.z {
        DVec3::X
    } else if size.y >= size.z {
        DVec3::Y
    } else {
        DVec3::Z
    }
}

fn shortest_paths(mesh: &TriangleMesh, neighbours: &Neighbours, start: &[usize]) -> Vec<f64> {
    let mut distance = vec![f64::INFINITY; mesh.vertices.len()];
    // Non-negative floats compare like their bits.
    let mut queue: BinaryHeap<Reverse<(u64, usize)>> = start.iter().map(|&v| Reverse((0, v))).collect();
    start.iter().for_each(|&v| distance[v] = 0.0);
    while let Some(Reverse((bits, v))) = queue.pop() {
        let so_far = f64::from_bits(bits);
        if so_far > distance[v] {
            continue;
        }
        for &n in neighbours.of(v) {
            let n = n as usize;
            let through = so_far + mesh.vertices[v].distance(mesh.vertices[n]);
            if through < distance[n] {
                distance[n] = through;
                queue.push(Reverse((through.to_bits(), n)));
            }
        }
    }
    distance
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A cylinder along z, radius 5 mm, length 60 mm.
    fn cylinder() -> TriangleMesh {
        let (around, along) = (48u32, 90u32);
        let mut mesh = TriangleMesh::default();
        for k in 0..=along {
            for a in 0..around {
                // Every second ring is turned by half a step, so that triangles are about equilateral.
                let angle = (a as f64 + 0.5 * (k % 2) as f64) / around as f64 * std::f64::consts::TAU;
                mesh.vertices.push(DVec3::new(5.0 * angle.cos(), 5.0 * angle.sin(), k as f64 * 60.0 / along as f64));
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
    fn level_lines_run_around_a_tube() {
        let mesh = cylinder();
        let generation: Vec<f32> = mesh.vertices.iter().map(|v| if v.z > 45.0 { 1.0 } else { 0.0 }).collect();
        let axial = axial_distance_mm(&mesh, &mesh.neighbours(), &generation);
        let mut last = f64::NEG_INFINITY;
        for k in [40usize, 50, 60, 70, 80] {
            let ring: Vec<f64> = (0..48).map(|a| axial[k * 48 + a] as f64).collect();
            let mean = ring.iter().sum::<f64>() / 48.0;
            let spread = ring.iter().map(|v| (v - mean).abs()).fold(0.0, f64::max);
            assert!(spread < 1.5, "ring {k}: {spread} mm");
            if last.is_finite() {
                assert!((mean - last - 60.0 / 9.0).abs() < 1.0, "{mean} after {last}");
            }
            last = mean;
        }
    }
}
