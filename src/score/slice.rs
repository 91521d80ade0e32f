//! Cuts a triangle mesh with a plane and joins the cuts to polylines.
//!
//! A vertex is on the plane's positive side when its signed distance is >= 0, so a vertex exactly on the plane
//! belongs to one side and every face is crossed at two of its edges or none. A cut is known by the mesh edge it lies
//! on and the fraction along it: the same *material* point on any mesh of the same faces.

use glam::{DAffine3, DVec3};

use crate::base::TriangleMesh;

/// A plane with axes.
#[derive(Clone, Copy, Debug)]
pub struct Plane {
    /// A point of it; (0, 0) in plane coordinates.
    pub origin: DVec3,
    /// First axis, unit.
    pub x: DVec3,
    /// Second axis, unit.
    pub y: DVec3,
    /// Unit normal.
    pub normal: DVec3,
}

impl Plane {
    /// Through the camera's centre, normal to its optical axis; axes are the image's (x right, y down).
    pub fn of_camera(world_from_camera: &DAffine3) -> Self {
        let axis = |v: DVec3| world_from_camera.transform_vector3(v).normalize_or_zero();
        Plane { origin: world_from_camera.translation, x: axis(DVec3::X), y: axis(DVec3::Y), normal: axis(DVec3::Z) }
    }

    /// Coordinates of `point`, projected onto the plane, mm.
    pub fn coordinates(&self, point: DVec3) -> [f64; 2] {
        let offset = point - self.origin;
        [offset.dot(self.x), offset.dot(self.y)]
    }
}

/// Point on a mesh edge: `vertices[edge[0]] * (1 - fraction) + vertices[edge[1]] * fraction`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EdgePoint {
    /// The edge's vertices, lower index first.
    pub edge: [u32; 2],
    /// Where along it, 0 to 1.
    pub fraction: f64,
}

impl EdgePoint {
    /// Where this material point is when the mesh has `vertices`.
    pub fn position(&self, vertices: &[DVec3]) -> DVec3 {
        let [a, b] = self.edge.map(|v| vertices[v as usize]);
        a + (b - a) * self.fraction
    }
}

/// One connected cut.
#[derive(Clone, Debug)]
pub struct Polyline {
    /// Its vertices in order.
    pub cuts: Vec<EdgePoint>,
    /// The same in plane coordinates, mm.
    pub points: Vec<[f64; 2]>,
    /// True when the last vertex joins the first.
    pub closed: bool,
}

/// All cuts of `mesh` (valid: finite, indices in range) with `plane`, in an order that depends on the mesh alone.
pub fn slice(mesh: &TriangleMesh, plane: &Plane) -> Vec<Polyline> {
    let height: Vec<f64> = mesh.vertices.iter().map(|&v| (v - plane.origin).dot(plane.normal)).collect();
    let graph = CutGraph::new(mesh, &height);
    let used = vec![false; graph.segments.len()];
    let mut walker = Walker { graph: &graph, used, tried: vec![0; graph.nodes.len()] };
    // Open ends first, so that a chain is not begun in its middle.
    let ends = (0..graph.nodes.len()).filter(|&n| graph.segments_at(n).len() % 2 == 1);
    let starts: Vec<usize> = ends.chain(0..graph.nodes.len()).collect();
    let mut polylines = Vec::new();
    for start in starts {
        while let Some((nodes, closed)) = walker.walk(start) {
            // A face that occurs twice gives a loop of two nodes, which encloses nothing.
            if nodes.len() > 2 || !closed {
                polylines.push(polyline(mesh, plane, &height, &graph, &nodes, closed));
            }
        }
    }
    polylines
}

fn polyline(
    mesh: &TriangleMesh,
    plane: &Plane,
    height: &[f64],
    graph: &CutGraph,
    nodes: &[usize],
    closed: bool,
) -> Polyline {
    let cuts: Vec<EdgePoint> = nodes
        .iter()
        .map(|&n| {
            let [a, b] = graph.nodes[n];
            let (from, to) = (height[a as usize], height[b as usize]);
            // The signs differ, so the divisor is not 0.
            EdgePoint { edge: [a, b], fraction: (from / (from - to)).clamp(0.0, 1.0) }
        })
        .collect();
    let points = cuts.iter().map(|c| plane.coordinates(c.position(&mesh.vertices))).collect();
    Polyline { cuts, points, closed }
}

/// Crossed edges as nodes, crossed faces as segments between two of them.
struct CutGraph {
    nodes: Vec<[u32; 2]>,
    segments: Vec<[usize; 2]>,
    /// Segments of node `n`: `incident[offsets[n]..offsets[n + 1]]`.
    offsets: Vec<usize>,
    incident: Vec<usize>,
}

impl CutGraph {
    fn new(mesh: &TriangleMesh, height: &[f64]) -> Self {
        let side = |v: u32| height[v as usize] >= 0.0;
        let mut crossings: Vec<[[u32; 2]; 2]> = Vec::new();
        for &[a, b, c] in &mesh.faces {
            let mut crossed = [[a, b], [b, c], [c, a]].into_iter().filter(|&[a, b]| side(a) != side(b));
            if let (Some(first), Some(second)) = (crossed.next(), crossed.next()) {
                crossings.push([first, second].map(|[a, b]| [a.min(b), a.max(b)]));
            }
        }
        let mut nodes: Vec<[u32; 2]> = crossings.iter().flatten().copied().collect();
        nodes.sort_unstable();
        nodes.dedup();
        let node_of = |edge: &[u32; 2]| nodes.binary_search(edge).unwrap_or_else(|place| place);
        let segments: Vec<[usize; 2]> = crossings.iter().map(|[a, b]| [node_of(a), node_of(b)]).collect();
        let mut ends: Vec<(usize, usize)> = segments.iter().enumerate().flat_map(|(s, n)| n.map(|n| (n, s))).collect();
        ends.sort_unstable();
        let offsets = (0..=nodes.len()).map(|n| ends.partition_point(|e| e.0 < n)).collect();
        CutGraph { nodes, segments, offsets, incident: ends.into_iter().map(|e| e.1).collect() }
    }

    fn segments_at(&self, node: usize) -> &[usize] {
        &self.incident[self.offsets[node]..self.offsets[node + 1]]
    }
}

struct Walker<'a> {
    graph: &'a CutGraph,
    used: Vec<bool>,
    /// Per node how many of its first segments are known to be used: a million faces may share one edge.
    tried: Vec<usize>,
}

impl Walker<'_> {
    /// Nodes of the polyline from `start` along segments that no walk has used; `None` when there is none.
    fn walk(&mut self, start: usize) -> Option<(Vec<usize>, bool)> {
        let mut nodes = vec![start];
        let mut here = start;
        while let Some(segment) = self.unused_at(here) {
            self.used[segment] = true;
            let [a, b] = self.graph.segments[segment];
            here = if a == here { b } else { a };
            if here == start {
                return Some((nodes, true));
            }
            nodes.push(here);
        }
        (nodes.len() > 1).then_some((nodes, false))
    }

    fn unused_at(&mut self, node: usize) -> Option<usize> {
        let segments = self.graph.segments_at(node);
        while segments.get(self.tried[node]).is_some_and(|&segment| self.used[segment]) {
            self.tried[node] += 1;
        }
        segments.get(self.tried[node]).copied()
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// Open tube of `radius` around the z axis from z = 0 to `length`; normals point inwards.
    pub fn tube(radius: f64, length: f64, around: u32, along: u32) -> TriangleMesh {
        let mut mesh = TriangleMesh::default();
        for ring in 0..=along {
            for step in 0..around {
                let angle = std::f64::consts::TAU * f64::from(step) / f64::from(around);
                let z = length * f64::from(ring) / f64::from(along);
                mesh.vertices.push(DVec3::new(radius * angle.cos(), radius * angle.sin(), z));
            }
        }
        for ring in 0..along {
            for step in 0..around {
                let (a, b) = (ring * around + step, ring * around + (step + 1) % around);
                mesh.faces.push([a, a + around, b]);
                mesh.faces.push([b, a + around, b + around]);
            }
        }
        mesh
    }

    pub fn looking_along_z(z: f64) -> Plane {
        Plane::of_camera(&DAffine3::from_translation(DVec3::new(0.0, 0.0, z)))
    }

    #[test]
    fn a_tube_is_cut_to_one_closed_ring() {
        let mesh = tube(5.0, 20.0, 24, 10);
        // Between rings, and exactly through the vertices of one.
        for z in [7.3, 8.0] {
            let cuts = slice(&mesh, &looking_along_z(z));
            assert_eq!(cuts.len(), 1);
            assert!(cuts[0].closed && cuts[0].points.len() >= 24);
            for (cut, point) in cuts[0].cuts.iter().zip(&cuts[0].points) {
                assert!((cut.position(&mesh.vertices).z - z).abs() < 1e-12);
                let radius = point[0].hypot(point[1]);
                assert!(radius <= 5.0 + 1e-12 && radius > 5.0 * (std::f64::consts::PI / 24.0).cos() - 1e-12);
            }
        }
        assert!(slice(&mesh, &looking_along_z(25.0)).is_empty());
    }

    #[test]
    fn a_plane_along_an_open_tube_gives_two_open_chains() {
        let mesh = tube(5.0, 20.0, 24, 10);
        let plane = Plane { origin: DVec3::new(0.1, 0.0, 0.0), x: DVec3::Y, y: DVec3::Z, normal: DVec3::X };
        let cuts = slice(&mesh, &plane);
        assert_eq!(cuts.len(), 2);
        assert!(cuts.iter().all(|c| !c.closed));
    }

    #[test]
    fn a_million_faces_on_one_edge_are_cut_in_a_moment() {
        let mut mesh = TriangleMesh { vertices: vec![DVec3::NEG_Z, DVec3::Z], faces: Vec::new() };
        for sliver in 0..1_000_000u32 {
            mesh.vertices.push(DVec3::new(1.0, f64::from(sliver) * 1e-6, 1.0));
            mesh.faces.push([0, 1, sliver + 2]);
        }
        let started = std::time::Instant::now();
        assert!(slice(&mesh, &looking_along_z(0.0)).len() > 400_000);
        assert!(started.elapsed().as_secs() < 60, "{:?}", started.elapsed());
    }

    #[test]
    fn faces_that_share_an_edge_more_than_twice_do_not_loop_for_ever() {
        let mut mesh = tube(5.0, 20.0, 8, 2);
        mesh.faces.extend_from_within(..);
        let cuts = slice(&mesh, &looking_along_z(3.0));
        assert!(!cuts.is_empty());
    }
}
