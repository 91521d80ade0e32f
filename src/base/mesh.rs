//! Triangle meshes: vertices in mm, faces wound so that the normal points *into the lumen* (towards the camera).

use std::collections::HashMap;
use std::iter::Sum;
use std::ops::{Add, Div, Mul};

use glam::DVec3;

use super::error::{Error, Result};

/// An indexed triangle mesh.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TriangleMesh {
    /// Positions in mm.
    pub vertices: Vec<DVec3>,
    /// Three vertex indices per face; right-handed winding.
    pub faces: Vec<[u32; 3]>,
}

/// Vertices that share an edge, by vertex.
#[derive(Clone, Debug)]
pub struct Neighbours {
    /// Where each vertex' part of `list` begins, and where the last one ends.
    offsets: Vec<u32>,
    list: Vec<u32>,
}

impl Neighbours {
    /// The neighbours of `vertex`, sorted.
    pub fn of(&self, vertex: usize) -> &[u32] {
        &self.list[self.offsets[vertex] as usize..self.offsets[vertex + 1] as usize]
    }

    /// Half of each vertex' value and half of its neighbours' mean, `rounds` times.
    pub fn smoothed<T>(&self, mut values: Vec<T>, rounds: usize) -> Vec<T>
    where
        T: Copy + Sum + Add<Output = T> + Mul<f64, Output = T> + Div<f64, Output = T>,
    {
        for _ in 0..rounds {
            let value = |v: usize| {
                let around = self.of(v);
                let sum: T = around.iter().map(|&n| values[n as usize]).sum();
                if around.is_empty() { values[v] } else { (values[v] + sum / around.len() as f64) * 0.5 }
            };
            values = (0..values.len()).map(value).collect();
        }
        values
    }
}

impl TriangleMesh {
    /// The three corners of face `face`.
    pub fn corners(&self, face: usize) -> [DVec3; 3] {
        self.faces[face].map(|v| self.vertices[v as usize])
    }

    /// Twice the area of `face` times its unit normal.
    pub fn area_normal(&self, face: usize) -> DVec3 {
        let [a, b, c] = self.corners(face);
        (b - a).cross(c - a)
    }

    /// Area-weighted unit vertex normals; zero where a vertex has no face.
    pub fn vertex_normals(&self) -> Vec<DVec3> {
        let mut normals = vec![DVec3::ZERO; self.vertices.len()];
        for (f, face) in self.faces.iter().enumerate() {
            let n = self.area_normal(f);
            for &v in face {
                normals[v as usize] += n;
            }
        }
        normals.iter().map(|n| n.normalize_or_zero()).collect()
    }

    /// Signed volume in mm^3: positive when the normals point out of the enclosed space.
    pub fn signed_volume(&self) -> f64 {
        (0..self.faces.len()).map(|f| self.corners(f)).map(|[a, b, c]| a.dot(b.cross(c)) / 6.0).sum()
    }

    /// Reverses the winding of every face.
    pub fn flip(&mut self) {
        for face in &mut self.faces {
            face.swap(1, 2);
        }
    }

    /// Lowest and highest corner of the bounding box.
    pub fn bounds(&self) -> (DVec3, DVec3) {
        self.vertices.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), &v| (low.min(v), high.max(v)))
    }

    /// Whether some face uses a vertex, by vertex. The faces name vertices that are there.
    pub fn used_vertices(&self) -> Vec<bool> {
        let mut used = vec![false; self.vertices.len()];
        self.faces.iter().flatten().for_each(|&v| used[v as usize] = true);
        used
    }

    /// Puts vertices that no face uses where the first face begins: a stray one far away must not set the scale of the
    /// others. The faces name vertices that are there.
    pub fn park_unused_vertices(&mut self) {
        let Some(place) = self.faces.first().map(|face| self.vertices[face[0] as usize]) else { return };
        let used = self.used_vertices();
        self.vertices.iter_mut().zip(used).filter(|(_, used)| !used).for_each(|(vertex, _)| *vertex = place);
    }

    /// Sorted unique undirected edges.
    pub fn edges(&self) -> Vec<[u32; 2]> {
        let mut edges: Vec<[u32; 2]> = self
            .faces
            .iter()
            .flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]])
            .map(|[a, b]| [a.min(b), a.max(b)])
            .collect();
        edges.sort_unstable();
        edges.dedup();
        edges
    }

    /// Which vertices share an edge.
    pub fn neighbours(&self) -> Neighbours {
        let edges = self.edges();
        let mut offsets = vec![0u32; self.vertices.len() + 1];
        for &[a, b] in &edges {
            offsets[a as usize + 1] += 1;
            offsets[b as usize + 1] += 1;
        }
        for v in 0..self.vertices.len() {
            offsets[v + 1] += offsets[v];
        }
        let mut fill = offsets.clone();
        let mut list = vec![0u32; edges.len() * 2];
        for &[a, b] in &edges {
            for (from, to) in [(a, b), (b, a)] {
                list[fill[from as usize] as usize] = to;
                fill[from as usize] += 1;
            }
        }
        for v in 0..self.vertices.len() {
            list[offsets[v] as usize..offsets[v + 1] as usize].sort_unstable();
        }
        Neighbours { offsets, list }
    }

    /// Finite vertices, indices in range, no face that names a vertex twice. The error names the element.
    pub fn validate(&self) -> Result<()> {
        if self.faces.is_empty() {
            return Err(Error::input("the mesh has no faces"));
        }
        if let Some(v) = self.vertices.iter().position(|v| !v.is_finite()) {
            return Err(Error::input("coordinate is not finite").element(format!("vertex {v}")));
        }
        for (f, &[a, b, c]) in self.faces.iter().enumerate() {
            if a.max(b).max(c) as usize >= self.vertices.len() {
                return Err(Error::input(format!("names vertex {} of {}", a.max(b).max(c), self.vertices.len()))
                    .element(format!("face {f}")));
            }
            if a == b || b == c || c == a {
                return Err(Error::input("names one vertex twice").element(format!("face {f}")));
            }
        }
        Ok(())
    }

    /// An edge of two faces that run along it in the same direction: one is wound the other way round than its neighbour.
    /// The first one in the order of its vertices; copies of a face and edges of three or more tell nothing.
    pub fn two_ways_wound(&self) -> Option<[u32; 2]> {
        let mut edges: Vec<([u32; 2], bool, u32)> = Vec::with_capacity(3 * self.faces.len());
        for (face, &[a, b, c]) in (0u32..).zip(&self.faces) {
            edges.extend([[a, b], [b, c], [c, a]].map(|[p, q]| ([p.min(q), p.max(q)], p < q, face)));
        }
        edges.sort_unstable();
        let corners = |face: u32| {
            let mut corners = self.faces[face as usize];
            corners.sort_unstable();
            corners
        };
        edges.chunk_by(|a, b| a.0 == b.0).find_map(|of_edge| match *of_edge {
            [(edge, way, one), (_, other_way, other)] if way == other_way && corners(one) != corners(other) => {
                Some(edge)
            }
            _ => None,
        })
    }

    /// [`TriangleMesh::validate`], and every edge is shared by exactly two faces that run along it in opposite
    /// directions: the surface is closed, manifold in its edges and consistently wound.
    pub fn validate_closed(&self) -> Result<()> {
        self.validate()?;
        let mut directed: HashMap<(u32, u32), u32> = HashMap::with_capacity(self.faces.len() * 3);
        for (f, &[a, b, c]) in self.faces.iter().enumerate() {
            for edge in [(a, b), (b, c), (c, a)] {
                if let Some(other) = directed.insert(edge, f as u32) {
                    return Err(Error::input(format!(
                        "is run along in the same direction by faces {other} and {f}: not manifold"
                    ))
                    .element(format!("edge {}-{}", edge.0, edge.1)));
                }
            }
        }
        let open = directed.iter().filter(|((a, b), _)| !directed.contains_key(&(*b, *a))).min_by_key(|(e, _)| **e);
        match open {
            Some(((a, b), f)) => {
                Err(Error::input(format!("of face {f} has no second face: the surface is not closed"))
                    .element(format!("edge {a}-{b}")))
            }
            None => Ok(()),
        }
    }
}

/// `(1 - phase) * inspiration + phase * expiration`, the breathing model of the paper (its equations 2 and 5).
/// Phase 0 and 1 give the end states to the bit.
pub fn interpolate(inspiration: &[DVec3], expiration: &[DVec3], phase: f64) -> Vec<DVec3> {
    if phase == 1.0 {
        return expiration.to_vec();
    }
    inspiration.iter().zip(expiration).map(|(&i, &e)| i + (e - i) * phase).collect()
}

/// How far each vertex moves from inspiration to expiration (mm), for hot loops.
pub fn displacement(inspiration: &TriangleMesh, expiration: &TriangleMesh) -> Vec<[f32; 3]> {
    let pairs = expiration.vertices.iter().zip(&inspiration.vertices);
    pairs.map(|(e, i)| (*e - *i).as_vec3().to_array()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tetrahedron() -> TriangleMesh {
        TriangleMesh {
            vertices: vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z],
            faces: vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
        }
    }

    #[test]
    fn faces_wound_both_ways_are_found() {
        let quad = |second: [u32; 3]| TriangleMesh {
            vertices: vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::ONE],
            faces: vec![[0, 1, 2], second],
        };
        assert_eq!(quad([2, 1, 3]).two_ways_wound(), None);
        assert_eq!(quad([1, 2, 3]).two_ways_wound(), Some([1, 2]));
        assert_eq!(quad([1, 2, 0]).two_ways_wound(), None, "a copy");
        let mut fin = quad([1, 2, 3]);
        fin.faces.push([2, 1, 0]);
        assert_eq!(fin.two_ways_wound(), None, "three faces at an edge");
    }

    #[test]
    fn closed_mesh_passes_and_damage_is_named() {
        let mut mesh = tetrahedron();
        mesh.validate_closed().unwrap();
        assert!((mesh.signed_volume() - 1.0 / 6.0).abs() < 1e-15);
        mesh.faces.pop();
        assert!(mesh.validate_closed().unwrap_err().to_string().contains("not closed"));
        mesh.vertices[2].y = f64::NAN;
        assert_eq!(mesh.validate().unwrap_err().to_string(), "vertex 2: coordinate is not finite");
    }

    #[test]
    fn neighbours_of_a_tetrahedron() {
        let neighbours = tetrahedron().neighbours();
        assert_eq!(neighbours.of(1), [0, 2, 3]);
        // Vertex 0 keeps half of its own value and takes half of the mean of the other three.
        assert_eq!(neighbours.smoothed(vec![6.0, 0.0, 3.0, 0.0], 1)[0], 3.5);
    }

    #[test]
    fn interpolation_ends_are_exact() {
        let a = [DVec3::new(0.1, 0.7, 1e9)];
        let b = [DVec3::new(0.3, -0.2, 1e-9)];
        assert_eq!(interpolate(&a, &b, 0.0), a);
        assert_eq!(interpolate(&a, &b, 1.0), b);
    }

    #[test]
    fn stray_vertices_are_parked_and_others_stay() {
        let mut mesh = tetrahedron();
        mesh.vertices.insert(1, DVec3::splat(1e12));
        mesh.faces.iter_mut().flatten().for_each(|v| *v += u32::from(*v > 0));
        assert_eq!(mesh.used_vertices(), [true, false, true, true, true]);
        mesh.park_unused_vertices();
        assert_eq!(mesh.vertices, [DVec3::ZERO, DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z]);
    }
}
