//! Isotropic remeshing of a closed surface towards a length field: split, collapse, flip, relax, project.
//!
//! After Botsch and Kobbelt, "A Remeshing Approach to Multiresolution Modeling", SGP 2004 (their 4/3 and 4/5 bounds,
//! valence 6), with a target length that varies over the surface. Every operation keeps the surface a closed
//! 2-manifold: collapses obey the link condition, flips never make a double edge, and neither turns a face around.
//! In index order: the same input gives the same bytes. Only target lengths are looked up in parallel.

use glam::DVec3;
use rayon::prelude::*;

use crate::base::TriangleMesh;

/// Vertices per task, at least.
const PIECE: usize = 256;
/// A face that was removed.
const DEAD: [u32; 3] = [u32::MAX; 3];

/// The surface being remeshed: positions, target lengths, faces, faces around each vertex.
struct WorkingMesh {
    position: Vec<DVec3>,
    target_mm: Vec<f64>,
    faces: Vec<[u32; 3]>,
    around: Vec<Vec<u32>>,
}

/// `rounds` of remeshing. `target_mm` gives the wanted edge length at a point, `project` brings a point back to the
/// surface.
pub fn remesh(
    mesh: &TriangleMesh,
    rounds: usize,
    target_mm: impl Fn(DVec3) -> f64 + Sync,
    project: impl Fn(DVec3) -> DVec3,
) -> TriangleMesh {
    let mut work = WorkingMesh::new(mesh, &target_mm);
    for _ in 0..rounds {
        work.split_long(&target_mm, &project);
        work.collapse_short();
        work.flip_for_valence();
        work.relax(&target_mm, &project);
    }
    work.finish()
}

impl WorkingMesh {
    fn new(mesh: &TriangleMesh, target_mm: &(impl Fn(DVec3) -> f64 + Sync)) -> Self {
        let mut around = vec![Vec::with_capacity(8); mesh.vertices.len()];
        for (f, face) in mesh.faces.iter().enumerate() {
            for &v in face {
                around[v as usize].push(f as u32);
            }
        }
        WorkingMesh {
            position: mesh.vertices.clone(),
            target_mm: mesh.vertices.par_iter().with_min_len(PIECE).map(|&v| target_mm(v)).collect(),
            faces: mesh.faces.clone(),
            around,
        }
    }

    fn finish(self) -> TriangleMesh {
        let mut new_index = vec![u32::MAX; self.position.len()];
        let mut mesh = TriangleMesh::default();
        for face in self.faces.iter().filter(|f| **f != DEAD) {
            mesh.faces.push(face.map(|v| {
                let slot = &mut new_index[v as usize];
                if *slot == u32::MAX {
                    *slot = mesh.vertices.len() as u32;
                    mesh.vertices.push(self.position[v as usize]);
                }
                *slot
            }));
        }
        mesh
    }

    fn length(&self, a: u32, b: u32) -> f64 {
        self.position[a as usize].distance(self.position[b as usize])
    }

    fn target(&self, a: u32, b: u32) -> f64 {
        0.5 * (self.target_mm[a as usize] + self.target_mm[b as usize])
    }

    /// Live edges (a < b), in the order of the faces that name them first.
    fn edges(&self) -> Vec<(u32, u32)> {
        let mut edges = Vec::with_capacity(self.faces.len() * 3 / 2);
        for &[a, b, c] in self.faces.iter().filter(|f| **f != DEAD) {
            // In a closed surface every edge is run along once in each direction.
            edges.extend([(a, b), (b, c), (c, a)].into_iter().filter(|(u, v)| u < v));
        }
        edges
    }

    /// The two faces along an edge: the one that runs a to b, and the other.
    fn faces_along(&self, a: u32, b: u32) -> Option<(u32, u32)> {
        let (mut forward, mut backward) = (None, None);
        for &f in &self.around[a as usize] {
            let face = self.faces[f as usize];
            let k = face.iter().position(|v| *v == a)?;
            if face[(k + 1) % 3] == b {
                forward = Some(f);
            } else if face[(k + 2) % 3] == b {
                backward = Some(f);
            }
        }
        Some((forward?, backward?))
    }

    fn opposite(&self, face: u32, a: u32, b: u32) -> u32 {
        let corners = self.faces[face as usize];
        corners.into_iter().find(|v| *v != a && *v != b).expect("a face has a corner off each of its edges")
    }

    fn normal(&self, face: [u32; 3]) -> DVec3 {
        let [a, b, c] = face.map(|v| self.position[v as usize]);
        (b - a).cross(c - a)
    }

    fn valence(&self, v: u32) -> i32 {
        self.around[v as usize].len() as i32
    }

    fn neighbours(&self, v: u32, list: &mut Vec<u32>) {
        list.clear();
        for &f in &self.around[v as usize] {
            let face = self.faces[f as usize];
            let k = face.iter().position(|u| *u == v).expect("faces around a vertex name it");
            // In a closed fan every neighbour follows the vertex in exactly one face.
            list.push(face[(k + 1) % 3]);
        }
    }

    fn split_long(&mut self, target_mm: &impl Fn(DVec3) -> f64, project: &impl Fn(DVec3) -> DVec3) {
        for (a, b) in self.edges() {
            if self.length(a, b) <= 4.0 / 3.0 * self.target(a, b) {
                continue;
            }
            let Some((forward, backward)) = self.faces_along(a, b) else { continue };
            let (c, d) = (self.opposite(forward, a, b), self.opposite(backward, a, b));
            let middle = project(self.position[a as usize].midpoint(self.position[b as usize]));
            let m = self.position.len() as u32;
            self.position.push(middle);
            self.target_mm.push(target_mm(middle));
            let (f2, g2) = (self.faces.len() as u32, self.faces.len() as u32 + 1);
            self.faces[forward as usize] = [a, m, c];
            self.faces[backward as usize] = [a, d, m];
            self.faces.push([m, b, c]);
            self.faces.push([m, d, b]);
            self.around.push(vec![forward, backward, f2, g2]);
            for (face, new) in [(forward, f2), (backward, g2)] {
                let slot = self.around[b as usize].iter_mut().find(|f| **f == face);
                *slot.expect("b was in both faces") = new;
            }
            self.around[c as usize].push(f2);
            self.around[d as usize].push(g2);
        }
    }

    fn collapse_short(&mut self) {
        let (mut of_a, mut of_b) = (Vec::new(), Vec::new());
        for (a, b) in self.edges() {
            if self.around[a as usize].is_empty() || self.around[b as usize].is_empty() {
                continue;
            }
            if self.length(a, b) >= 0.8 * self.target(a, b) {
                continue;
            }
            let Some((forward, backward)) = self.faces_along(a, b) else { continue };
            self.neighbours(a, &mut of_a);
            self.neighbours(b, &mut of_b);
            // Link condition: the ends share exactly the two vertices opposite the edge.
            if of_a.iter().filter(|v| of_b.contains(v)).count() != 2 || of_a.len() + of_b.len() < 8 {
                continue;
            }
            let (c, d) = (self.opposite(forward, a, b), self.opposite(backward, a, b));
            if self.valence(c) <= 3 || self.valence(d) <= 3 {
                continue;
            }
            let middle = self.position[a as usize].midpoint(self.position[b as usize]);
            let stretched = of_a
                .iter()
                .chain(&of_b)
                .filter(|v| **v != a && **v != b)
                .any(|&v| self.position[v as usize].distance(middle) > 4.0 / 3.0 * self.target(a, v));
            if stretched || self.turns_a_face(a, b, middle) || self.turns_a_face(b, a, middle) {
                continue;
            }
            self.collapse(a, b, [forward, backward], [c, d], middle);
        }
    }

    /// Whether moving `v` to `to` turns or crushes a face around it that does not hold `other`.
    fn turns_a_face(&self, v: u32, other: u32, to: DVec3) -> bool {
        self.around[v as usize].iter().map(|&f| self.faces[f as usize]).filter(|f| !f.contains(&other)).any(|face| {
            let before = self.normal(face);
            let [a, b, c] = face.map(|u| if u == v { to } else { self.position[u as usize] });
            let after = (b - a).cross(c - a);
            after.dot(before) <= 0.3 * after.length() * before.length() || after.length() < 1e-3 * before.length()
        })
    }

    fn collapse(&mut self, a: u32, b: u32, gone: [u32; 2], opposite: [u32; 2], middle: DVec3) {
        self.position[a as usize] = middle;
        for face in gone {
            self.faces[face as usize] = DEAD;
            for v in [a, opposite[0], opposite[1]] {
                self.around[v as usize].retain(|f| *f != face);
            }
        }
        let moved = std::mem::take(&mut self.around[b as usize]);
        for face in moved.into_iter().filter(|f| !gone.contains(f)) {
            for corner in &mut self.faces[face as usize] {
                if *corner == b {
                    *corner = a;
                }
            }
            self.around[a as usize].push(face);
        }
    }

    fn flip_for_valence(&mut self) {
        let mut of_c = Vec::new();
        for (a, b) in self.edges() {
            let Some((forward, backward)) = self.faces_along(a, b) else { continue };
            let (c, d) = (self.opposite(forward, a, b), self.opposite(backward, a, b));
            let off = |v: u32, change: i32| (self.valence(v) + change - 6).pow(2);
            let before = off(a, 0) + off(b, 0) + off(c, 0) + off(d, 0);
            let after = off(a, -1) + off(b, -1) + off(c, 1) + off(d, 1);
            if after >= before || self.valence(a) <= 3 || self.valence(b) <= 3 {
                continue;
            }
            self.neighbours(c, &mut of_c);
            if of_c.contains(&d) {
                continue;
            }
            let (new_forward, new_backward) = ([a, d, c], [d, b, c]);
            let old = self.normal(self.faces[forward as usize]).normalize_or_zero()
                + self.normal(self.faces[backward as usize]).normalize_or_zero();
            let flat = [new_forward, new_backward].into_iter().all(|face| {
                let n = self.normal(face);
                n.dot(old) > 0.8 * n.length() * old.length() && n.length() > 1e-9
            });
            if !flat {
                continue;
            }
            self.faces[forward as usize] = new_forward;
            self.faces[backward as usize] = new_backward;
            self.around[a as usize].retain(|f| *f != backward);
            self.around[b as usize].retain(|f| *f != forward);
            self.around[c as usize].push(backward);
            self.around[d as usize].push(forward);
        }
    }

    fn relax(&mut self, target_mm: &(impl Fn(DVec3) -> f64 + Sync), project: &impl Fn(DVec3) -> DVec3) {
        let (mut neighbours, mut has_moved) = (Vec::new(), vec![false; self.position.len()]);
        for v in 0..self.position.len() as u32 {
            if self.around[v as usize].is_empty() {
                continue;
            }
            let normal: DVec3 =
                self.around[v as usize].iter().map(|&f| self.normal(self.faces[f as usize])).sum::<DVec3>();
            let normal = normal.normalize_or_zero();
            self.neighbours(v, &mut neighbours);
            let here = self.position[v as usize];
            let centre = neighbours.iter().map(|&u| self.position[u as usize]).sum::<DVec3>() / neighbours.len() as f64;
            let pull = centre - here;
            let moved = project(here + pull - normal * normal.dot(pull));
            if moved.distance(here) > self.target_mm[v as usize] || self.turns_a_face(v, u32::MAX, moved) {
                continue;
            }
            self.position[v as usize] = moved;
            has_moved[v as usize] = true;
        }
        // Nothing above asks for the target of another vertex.
        let targets = self.target_mm.par_iter_mut().zip(&self.position).zip(has_moved).with_min_len(PIECE);
        targets.filter(|(_, has_moved)| *has_moved).for_each(|((target, at), _)| *target = target_mm(*at));
    }
}
