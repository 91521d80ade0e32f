//! Which faces and vertices lie around a vertex.

use crate::base::TriangleMesh;
use crate::ffi::trace::tracer::FacesAround;

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
        assert_eq!(topology.neighbours(1).collect::<Vec<_>>(), [0, 1, 2, 2, 1, 3]);
        assert_eq!((topology.vertex_count(), topology.around().offsets.len()), (6, 7));
    }
}
