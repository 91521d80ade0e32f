//! Which faces and vertices lie around a vertex.

use crate::base::{Error, Result, TriangleMesh};
use crate::ffi::trace::tracer::FacesAround;

/// Most entries of all second rings together; a surface whose vertices have six neighbours has 49 a vertex.
const MOST_RING_ENTRIES: f64 = 1e9;

/// Faces of a mesh and what is around its vertices.
pub(super) struct Topology {
    /// Corners of the faces.
    pub faces: Vec<[u32; 3]>,
    offsets: Vec<u32>,
    list: Vec<u32>,
}

impl Topology {
    /// The topology of a valid mesh.
    pub(super) fn new(mesh: &TriangleMesh) -> Self {
        let mut offsets = vec![0u32; mesh.vertices.len() + 1];
        mesh.faces.iter().flatten().for_each(|&v| offsets[v as usize + 1] += 1);
        for v in 0..mesh.vertices.len() {
            offsets[v + 1] += offsets[v];
        }
        let mut next = offsets.clone();
        let mut list = vec![0; mesh.faces.len() * 3];
        for (face, corners) in mesh.faces.iter().enumerate() {
            for &v in corners {
                list[next[v as usize] as usize] = face as u32;
                next[v as usize] += 1;
            }
        }
        Topology { faces: mesh.faces.clone(), offsets, list }
    }

    /// Number of vertices.
    pub(super) fn vertex_count(&self) -> usize {
        self.offsets.len() - 1
    }

    /// Faces around all vertices.
    pub(super) fn around(&self) -> FacesAround<'_> {
        FacesAround { offsets: &self.offsets, faces: &self.list }
    }

    /// Faces around a vertex.
    pub(super) fn faces_around(&self, vertex: u32) -> &[u32] {
        &self.list[self.offsets[vertex as usize] as usize..self.offsets[vertex as usize + 1] as usize]
    }

    /// Vertices that share a face with one, itself included (in the order of the faces, some twice).
    pub(super) fn neighbours(&self, vertex: u32) -> impl Iterator<Item = u32> {
        self.faces_around(vertex).iter().flat_map(|&f| self.faces[f as usize])
    }

    /// Vertices that share a face with one, itself included, ascending, each once.
    fn first_ring(&self, vertex: u32) -> Vec<u32> {
        let mut ring: Vec<u32> = self.neighbours(vertex).collect();
        ring.sort_unstable();
        ring.dedup();
        ring
    }

    /// Vertices at most two edges away, itself included, ascending.
    pub(super) fn second_ring(&self, vertex: u32) -> Vec<u32> {
        let mut ring = Vec::new();
        for near in self.first_ring(vertex) {
            // Without repetitions: faces that coincide name their corners as often as there are faces.
            ring.extend(self.first_ring(near));
        }
        ring.sort_unstable();
        ring.dedup();
        ring
    }

    /// Refuses a mesh whose second rings would not fit into memory: a vertex that a large part of the mesh surrounds.
    pub(super) fn check_rings(&self) -> Result<()> {
        let corners = |vertex: u32| 3.0 * self.faces_around(vertex).len() as f64;
        let vertices = 0..self.vertex_count() as u32;
        // Each corner counts as a vertex of its own: an upper bound that costs nothing.
        if vertices.clone().map(|v| corners(v).powi(2)).sum::<f64>() <= MOST_RING_ENTRIES {
            return Ok(());
        }
        let entries: f64 = vertices.clone().map(|v| (self.first_ring(v).len() as f64).powi(2)).sum();
        if entries <= MOST_RING_ENTRIES {
            return Ok(());
        }
        let busiest = vertices.max_by_key(|&v| self.faces_around(v).len()).unwrap_or_default();
        let sentence =
            format!("has {} faces around it, too many for light at vertices", self.faces_around(busiest).len());
        Err(Error::input(sentence).element(format!("vertex {busiest}")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    #[test]
    fn what_lies_around_a_vertex() {
        // A strip of four triangles: 0 2 4 / 1 3 5.
        let mesh =
            TriangleMesh { vertices: vec![DVec3::ZERO; 6], faces: vec![[0, 1, 2], [2, 1, 3], [2, 3, 4], [4, 3, 5]] };
        let topology = Topology::new(&mesh);
        assert_eq!(topology.faces_around(2), [0, 1, 2]);
        assert_eq!(topology.second_ring(0), [0, 1, 2, 3, 4]);
        assert_eq!((topology.vertex_count(), topology.around().offsets.len()), (6, 7));
    }

    #[test]
    fn faces_that_coincide_have_small_rings_and_a_hub_of_all_faces_is_refused() {
        let coincident = TriangleMesh { vertices: vec![DVec3::ZERO; 3], faces: vec![[0, 1, 2]; 200_000] };
        let topology = Topology::new(&coincident);
        topology.check_rings().unwrap();
        assert_eq!(topology.second_ring(1), [0, 1, 2]);
        let rim = |v: u32| 1 + v % 50_000;
        let fan = TriangleMesh {
            vertices: vec![DVec3::ZERO; 50_001],
            faces: (0..50_000).map(|v| [0, rim(v), rim(v + 1)]).collect(),
        };
        let refused = Topology::new(&fan).check_rings().unwrap_err().to_string();
        assert_eq!(refused, "vertex 0: has 50000 faces around it, too many for light at vertices");
    }
}
