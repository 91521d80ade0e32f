//! A smaller airway for the page: vertices are taken away, none is moved, so that what is kept of one breath holds of
//! the other, and of errors at vertices.
//!
//! Quadric error metric of Garland and Heckbert, "Surface simplification using quadric error metrics", SIGGRAPH 1997:
//! Q(v) = sum over the faces around v of (n . v + d)^2, weighted by area; the half-edge (a into b) with the least
//! Q_a(b) + Q_b(b) goes first. Boundaries get planes across them. A collapse that would turn a face around in either
//! breath, or join what is not one edge (link condition), is left out. Serial and in order: the same input gives the
//! same bytes.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap};

use glam::DVec3;

use crate::base::TriangleMesh;

/// Weight of the planes across a boundary, beside those of its faces.
const BOUNDARY_WEIGHT: f64 = 10.0;
/// Least cosine between a face's normals before and after a collapse.
const LEAST_COSINE: f64 = 0.2;

/// What is left of a mesh.
pub struct Simplified {
    /// Indices of the kept vertices, ascending.
    pub kept: Vec<u32>,
    /// Faces between them, as places in `kept`.
    pub faces: Vec<[u32; 3]>,
}

/// Symmetric 4x4 matrix of a quadric, upper triangle by rows.
type Quadric = [f64; 10];

fn of_plane(normal: DVec3, offset: f64, weight: f64) -> Quadric {
    let [a, b, c, d] = [normal.x, normal.y, normal.z, offset];
    [a * a, a * b, a * c, a * d, b * b, b * c, b * d, c * c, c * d, d * d].map(|v| v * weight)
}

fn value(q: &Quadric, v: DVec3) -> f64 {
    q[0] * v.x * v.x
        + q[4] * v.y * v.y
        + q[7] * v.z * v.z
        + 2.0 * (q[1] * v.x * v.y + q[2] * v.x * v.z + q[5] * v.y * v.z + q[3] * v.x + q[6] * v.y + q[8] * v.z)
        + q[9]
}

struct CollapsingMesh<'a> {
    positions: [&'a [DVec3]; 2],
    faces: Vec<[u32; 3]>,
    is_alive: Vec<bool>,
    around: Vec<Vec<u32>>,
    quadrics: Vec<Quadric>,
    /// Goes up when something around the vertex changes: older entries of the heap are void.
    age: Vec<u32>,
}

impl<'a> CollapsingMesh<'a> {
    fn new(mesh: &'a TriangleMesh, other: &'a [DVec3]) -> Self {
        let count = mesh.vertices.len();
        let mut around = vec![Vec::new(); count];
        let mut quadrics = vec![[0.0; 10]; count];
        let mut borders: BTreeMap<(u32, u32), (u32, usize)> = BTreeMap::new();
        for (f, face) in mesh.faces.iter().enumerate() {
            let (double_area, normal) = (mesh.area_normal(f).length(), mesh.area_normal(f).normalize_or_zero());
            let plane = of_plane(normal, -normal.dot(mesh.vertices[face[0] as usize]), double_area);
            for corner in 0..3 {
                let v = face[corner] as usize;
                around[v].push(f as u32);
                add(&mut quadrics[v], &plane);
                let (a, b) = (face[corner], face[(corner + 1) % 3]);
                borders.entry((a.min(b), a.max(b))).or_insert((0, f)).0 += 1;
            }
        }
        for ((a, b), (_, f)) in borders.into_iter().filter(|(_, (faces, _))| *faces == 1) {
            let (from, to) = (mesh.vertices[a as usize], mesh.vertices[b as usize]);
            let normal = (to - from).cross(mesh.area_normal(f)).normalize_or_zero();
            let plane = of_plane(normal, -normal.dot(from), BOUNDARY_WEIGHT * from.distance_squared(to));
            add(&mut quadrics[a as usize], &plane);
            add(&mut quadrics[b as usize], &plane);
        }
        CollapsingMesh {
            positions: [&mesh.vertices, other],
            is_alive: vec![true; mesh.faces.len()],
            faces: mesh.faces.clone(),
            around,
            quadrics,
            age: vec![0; count],
        }
    }

    fn neighbours(&self, v: u32) -> Vec<u32> {
        let mut found: Vec<u32> =
            self.around[v as usize].iter().flat_map(|&f| self.faces[f as usize]).filter(|&w| w != v).collect();
        found.sort_unstable();
        found.dedup();
        found
    }

    /// Cost of moving `a` onto `b`.
    fn cost(&self, a: u32, b: u32) -> f64 {
        let at = self.positions[0][b as usize];
        let flat = value(&self.quadrics[a as usize], at) + value(&self.quadrics[b as usize], at);
        // On a plane everything costs nothing: short edges first there.
        flat.max(0.0) + 1e-9 * self.positions[0][a as usize].distance_squared(at)
    }

    /// Whether `a` may move onto `b`: one edge with at most two faces, and no face around `a` turns.
    fn is_allowed(&self, a: u32, b: u32) -> bool {
        let has = |f: u32, v: u32| self.faces[f as usize].contains(&v);
        let shared = self.around[a as usize].iter().filter(|&&f| has(f, b)).count();
        let (of_a, of_b) = (self.neighbours(a), self.neighbours(b));
        let common = of_a.iter().filter(|v| of_b.binary_search(v).is_ok()).count();
        if shared == 0 || common != shared || (of_a.len() <= 3 && of_b.len() <= 3) {
            return false;
        }
        self.around[a as usize].iter().filter(|&&f| !has(f, b)).all(|&f| {
            let face = self.faces[f as usize];
            self.positions.iter().all(|positions| {
                let normal = |corners: [u32; 3]| {
                    let [p, q, r] = corners.map(|v| positions[v as usize]);
                    (q - p).cross(r - p).normalize_or_zero()
                };
                normal(face).dot(normal(face.map(|v| if v == a { b } else { v }))) > LEAST_COSINE
            })
        })
    }

    /// Moves `a` onto `b` and returns the vertices around it.
    fn collapse(&mut self, a: u32, b: u32) -> Vec<u32> {
        let touched = self.neighbours(a);
        for f in std::mem::take(&mut self.around[a as usize]) {
            let face = self.faces[f as usize];
            if face.contains(&b) {
                self.is_alive[f as usize] = false;
                for v in face.into_iter().filter(|&v| v != a) {
                    self.around[v as usize].retain(|&other| other != f);
                }
            } else {
                self.faces[f as usize] = face.map(|v| if v == a { b } else { v });
                self.around[b as usize].push(f);
            }
        }
        let quadric = self.quadrics[a as usize];
        add(&mut self.quadrics[b as usize], &quadric);
        touched
    }
}

fn add(to: &mut Quadric, other: &Quadric) {
    to.iter_mut().zip(other).for_each(|(a, b)| *a += b);
}

/// At most `most` vertices of `mesh`; `other` are its vertices in the other breath. Vertices without a face go. Stops
/// above `most` only where nothing more can be taken without turning a face.
pub fn simplify(mesh: &TriangleMesh, other: &[DVec3], most: usize) -> Simplified {
    let mut surface = CollapsingMesh::new(mesh, other);
    // Costs are finite and not negative: their bits are in the order of their values.
    let key = |surface: &CollapsingMesh<'_>, a: u32, b: u32| {
        Reverse((surface.cost(a, b).to_bits(), a, b, surface.age[a as usize], surface.age[b as usize]))
    };
    let mut alive = surface.around.iter().filter(|faces| !faces.is_empty()).count();
    let mut queue = BinaryHeap::new();
    if alive > most {
        for [a, b] in mesh.edges() {
            queue.push(key(&surface, a, b));
            queue.push(key(&surface, b, a));
        }
    }
    while let Some(Reverse((_, a, b, age_a, age_b))) = queue.pop() {
        if alive <= most {
            break;
        }
        let is_current = surface.age[a as usize] == age_a && surface.age[b as usize] == age_b;
        if !is_current || surface.around[a as usize].is_empty() || !surface.is_allowed(a, b) {
            continue;
        }
        let touched = surface.collapse(a, b);
        alive -= 1;
        surface.age[a as usize] += 1;
        surface.age[b as usize] += 1;
        for v in surface.neighbours(b) {
            queue.push(key(&surface, b, v));
            queue.push(key(&surface, v, b));
        }
        debug_assert!(touched.contains(&b));
    }
    let kept: Vec<u32> =
        (0..surface.around.len()).filter(|&v| !surface.around[v].is_empty()).map(|v| v as u32).collect();
    let place = |v: u32| kept.binary_search(&v).map_or(0, |at| at as u32);
    let alive = surface.faces.iter().zip(&surface.is_alive).filter(|(_, alive)| **alive);
    let faces = alive.map(|(face, _)| face.map(place)).collect();
    Simplified { kept, faces }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A closed tube with round ends is not needed: a torus has no boundary and curves both ways.
    fn torus(around: u32, along: u32, thin: f64) -> TriangleMesh {
        let mut mesh = TriangleMesh::default();
        for i in 0..along {
            for k in 0..around {
                let turn = |n: u32, of: u32| std::f64::consts::TAU * f64::from(n) / f64::from(of);
                let (u, v) = (turn(i, along), turn(k, around));
                let ring = 20.0 + thin * v.cos();
                mesh.vertices.push(DVec3::new(ring * u.cos(), ring * u.sin(), thin * v.sin()));
            }
        }
        for i in 0..along {
            for k in 0..around {
                let at = |i: u32, k: u32| (i % along) * around + k % around;
                mesh.faces.push([at(i, k), at(i + 1, k), at(i, k + 1)]);
                mesh.faces.push([at(i, k + 1), at(i + 1, k), at(i + 1, k + 1)]);
            }
        }
        mesh
    }

    #[test]
    fn what_is_left_is_the_same_closed_surface_with_few_vertices() {
        let (mesh, other) = (torus(24, 80, 5.0), torus(24, 80, 4.0));
        let small = simplify(&mesh, &other.vertices, 400);
        assert!(small.kept.len() <= 400 && small.kept.len() > 390);
        let of = |vertices: &[DVec3]| TriangleMesh {
            vertices: small.kept.iter().map(|&v| vertices[v as usize]).collect(),
            faces: small.faces.clone(),
        };
        for whole in [&mesh, &other] {
            let part = of(&whole.vertices);
            part.validate_closed().unwrap();
            let share = part.signed_volume() / whole.signed_volume();
            assert!((0.9..1.02).contains(&share), "volume {share}");
        }
    }

    #[test]
    fn a_small_mesh_stays_as_it_is_and_stray_vertices_go() {
        let mut mesh = torus(8, 12, 5.0);
        mesh.vertices.push(DVec3::ZERO);
        let small = simplify(&mesh, &mesh.vertices, 1000);
        assert_eq!((small.kept.len(), &small.faces), (96, &mesh.faces));
    }

    #[test]
    fn an_open_end_stays_where_it_is() {
        let mut mesh = torus(16, 60, 5.0);
        mesh.faces.retain(|face| face.iter().all(|&v| mesh.vertices[v as usize].x < 15.0));
        let small = simplify(&mesh, &mesh.vertices, 200);
        let far = |at: &[u32]| at.iter().map(|&v| mesh.vertices[v as usize].x).fold(f64::MIN, f64::max);
        let before: Vec<u32> = mesh.faces.iter().flatten().copied().collect();
        assert!(small.kept.len() <= 200 && (far(&small.kept) - far(&before)).abs() < 0.5);
    }
}
