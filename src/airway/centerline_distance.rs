//! Exact distance from a point to a triangle mesh.
//!
//! A bounding volume hierarchy over the triangles (median split of the centroids along the widest axis, at most four
//! triangles in a leaf), walked nearest box first; the point-triangle distance follows Ericson, Real-Time Collision
//! Detection (2005), section 5.1.5. Unsigned: which side the point lies on is answered by the voxels.

use glam::DVec3;

use crate::base::TriangleMesh;

/// Most triangles in a leaf.
const LEAF: usize = 4;

struct BoxNode {
    low: DVec3,
    high: DVec3,
    /// First triangle of a leaf, or the right child of an inner node (the left one follows its parent).
    first: u32,
    /// Number of triangles; 0 marks an inner node.
    count: u32,
}

/// The triangles of one mesh, ready for distance queries.
pub struct SurfaceDistance {
    nodes: Vec<BoxNode>,
    triangles: Vec<[DVec3; 3]>,
    /// The mesh's face that each triangle is.
    faces: Vec<u32>,
}

impl SurfaceDistance {
    /// Sorts the faces of `mesh` into the hierarchy. The mesh must have at least one face.
    pub fn new(mesh: &TriangleMesh) -> Self {
        let corners: Vec<[DVec3; 3]> = (0..mesh.faces.len()).map(|f| mesh.corners(f)).collect();
        let centroids: Vec<DVec3> = corners.iter().map(|[a, b, c]| (*a + *b + *c) / 3.0).collect();
        let mut order: Vec<u32> = (0..corners.len() as u32).collect();
        let mut nodes = Vec::with_capacity(corners.len());
        build(&corners, &centroids, &mut order, 0, &mut nodes);
        let triangles = order.iter().map(|&f| corners[f as usize]).collect();
        Self { nodes, triangles, faces: order }
    }

    /// Distance in mm from `point` to the surface.
    pub fn distance(&self, point: DVec3) -> f64 {
        self.distance_below(point, f64::INFINITY)
    }

    /// Distance in mm from `point` to the surface where it is less than `limit_mm`, else `limit_mm`. A tight limit
    /// saves most of the walk.
    pub fn distance_below(&self, point: DVec3, limit_mm: f64) -> f64 {
        self.nearest(point, 0.0, limit_mm).0
    }

    /// Distance in mm from `point` to the surface, at most `limit_mm`; `None` where it is `floor_mm` or less, which is
    /// known as soon as anything that near is found.
    pub fn distance_between(&self, point: DVec3, floor_mm: f64, limit_mm: f64) -> Option<f64> {
        let (distance, _) = self.nearest(point, floor_mm, limit_mm);
        (distance > floor_mm).then_some(distance)
    }

    /// Whether the surface is `distance_mm` or more from `point`.
    pub fn is_farther(&self, point: DVec3, distance_mm: f64) -> bool {
        self.distance_between(point, distance_mm.next_down(), distance_mm).is_some()
    }

    /// The face nearest to `point` and the weights of its corners at the nearest place on it. The mesh must be finite.
    pub fn nearest_place(&self, point: DVec3) -> (u32, [f64; 3]) {
        let triangle = self.nearest(point, 0.0, f64::INFINITY).1.unwrap_or(0);
        let [a, b, c] = self.triangles[triangle];
        let place = closest_on_triangle(point, &[a, b, c]) - a;
        let (ab, ac) = (b - a, c - a);
        let (bb, bc, cc) = (ab.length_squared(), ab.dot(ac), ac.length_squared());
        let determinant = (bb * cc - bc * bc).max(1e-300);
        let v = ((cc * place.dot(ab) - bc * place.dot(ac)) / determinant).clamp(0.0, 1.0);
        let w = ((bb * place.dot(ac) - bc * place.dot(ab)) / determinant).clamp(0.0, 1.0 - v);
        (self.faces[triangle], [1.0 - v - w, v, w])
    }

    /// Distance to the surface below the limit, and the triangle that is nearest. What is found at `floor_mm` or less ends
    /// the search, and may not be the nearest.
    fn nearest(&self, point: DVec3, floor_mm: f64, limit_mm: f64) -> (f64, Option<usize>) {
        let mut best = limit_mm * limit_mm;
        let mut found = None;
        let mut stack = [(0u32, 0.0f64); 64];
        stack[0] = (0, self.box_distance2(0, point));
        let mut depth = 1;
        while depth > 0 {
            depth -= 1;
            let (index, lower) = stack[depth];
            if lower >= best {
                continue;
            }
            let node = &self.nodes[index as usize];
            if node.count > 0 {
                for index in node.first as usize..(node.first + node.count) as usize {
                    let d2 = closest_on_triangle(point, &self.triangles[index]).distance_squared(point);
                    if d2 < best {
                        (best, found) = (d2, Some(index));
                        if d2.sqrt() <= floor_mm {
                            return (d2.sqrt(), found);
                        }
                    }
                }
                continue;
            }
            let children = [index + 1, node.first].map(|c| (c, self.box_distance2(c, point)));
            let [near, far] = if children[0].1 <= children[1].1 { children } else { [children[1], children[0]] };
            stack[depth] = far;
            stack[depth + 1] = near;
            depth += 2;
        }
        (best.sqrt(), found)
    }

    fn box_distance2(&self, node: u32, point: DVec3) -> f64 {
        let node = &self.nodes[node as usize];
        (point - point.clamp(node.low, node.high)).length_squared()
    }
}

/// Appends the subtree of the triangles `order`, which begin at `offset` of the whole list.
fn build(corners: &[[DVec3; 3]], centroids: &[DVec3], order: &mut [u32], offset: usize, nodes: &mut Vec<BoxNode>) {
    let empty = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    let (low, high) = order
        .iter()
        .flat_map(|&f| corners[f as usize])
        .fold(empty, |(low, high), corner| (low.min(corner), high.max(corner)));
    let index = nodes.len();
    nodes.push(BoxNode { low, high, first: offset as u32, count: order.len() as u32 });
    if order.len() <= LEAF {
        return;
    }
    let extent = high - low;
    let axis = if extent.x >= extent.y && extent.x >= extent.z {
        0
    } else if extent.y >= extent.z {
        1
    } else {
        2
    };
    let middle = order.len() / 2;
    order.select_nth_unstable_by(middle, |&a, &b| {
        centroids[a as usize][axis].total_cmp(&centroids[b as usize][axis]).then(a.cmp(&b))
    });
    let (left, right) = order.split_at_mut(middle);
    build(corners, centroids, left, offset, nodes);
    nodes[index].first = nodes.len() as u32;
    nodes[index].count = 0;
    build(corners, centroids, right, offset + middle, nodes);
}

/// The point of the triangle nearest to `p`.
fn closest_on_triangle(p: DVec3, &[a, b, c]: &[DVec3; 3]) -> DVec3 {
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let (d1, d2) = (ab.dot(ap), ac.dot(ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return a;
    }
    let bp = p - b;
    let (d3, d4) = (ab.dot(bp), ac.dot(bp));
    if d3 >= 0.0 && d4 <= d3 {
        return b;
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 && d1 > d3 {
        return a + ab * (d1 / (d1 - d3));
    }
    let cp = p - c;
    let (d5, d6) = (ab.dot(cp), ac.dot(cp));
    if d6 >= 0.0 && d5 <= d6 {
        return c;
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 && d2 > d6 {
        return a + ac * (d2 / (d2 - d6));
    }
    let va = d3 * d6 - d5 * d4;
    let (along_b, along_c) = (d4 - d3, d5 - d6);
    if va <= 0.0 && along_b >= 0.0 && along_c >= 0.0 && along_b + along_c > 0.0 {
        return b + (c - b) * (along_b / (along_b + along_c));
    }
    let sum = va + vb + vc;
    if sum > 0.0 { a + ab * (vb / sum) + ac * (vc / sum) } else { a }
}
