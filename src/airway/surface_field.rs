//! The lumen as a field: signed distance to a smooth union of round cones, sampled on a grid.
//!
//! Each branch is a chain of round cones (spheres of the inscribed radii and what lies between them; exact distance
//! after Quilez, "Round cone"); branches are joined by the polynomial smooth minimum, so that a bifurcation gets the
//! rounded carina of real airways. Negative inside. Far from every branch the field only says "far".

use glam::{DVec3, IVec3};
use rayon::prelude::*;

use super::tree::{Branch, Tree};
use crate::base::{Error, Result};

/// Value far from every branch, in mm: beyond every band of interest.
const FAR: f32 = 1e3;
/// Most nodes of the grid: 1.2 GB.
const MOST_NODES: f64 = 3e8;
/// Most nodes that all branches and their cones together may touch: about a minute.
const MOST_TOUCHED_NODES: f64 = 6e9;

/// Samples of the field at `origin + spacing * (i, j, k)`.
pub struct LumenField {
    origin: DVec3,
    spacing_mm: f64,
    size: [usize; 3],
    values: Vec<f32>,
}

impl LumenField {
    /// Samples the field of `tree`; `blend` is the width of the smooth union over the radius of the joining branch.
    ///
    /// Errors: a tree so large, or a spacing so small, that the grid would have more than 300 million nodes, or that
    /// its branches would touch 6 billion.
    pub fn of_tree(tree: &Tree, spacing_mm: f64, blend: f64) -> Result<Self> {
        let touched: f64 = tree.branches.iter().map(|branch| touched_nodes(branch, spacing_mm, blend)).sum();
        if touched > MOST_TOUCHED_NODES {
            let sentence =
                format!("{spacing_mm} mm is too fine for this tree: its branches span {touched:.1e} grid nodes");
            return Err(Error::input(sentence).element("anatomy.surface.spacing_mm"));
        }
        let mut field = Self::empty(tree, spacing_mm)?;
        for branch in &tree.branches {
            field.join(branch, blend);
        }
        Ok(field)
    }

    fn empty(tree: &Tree, spacing_mm: f64) -> Result<Self> {
        let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for branch in &tree.branches {
            for k in 0..branch.points_mm.len() {
                low = low.min(branch.position(k) - branch.radius(k));
                high = high.max(branch.position(k) + branch.radius(k));
            }
        }
        let margin = DVec3::splat(4.0 * spacing_mm);
        let extent = (high - low + 2.0 * margin) / spacing_mm;
        let nodes = (extent + 2.0).element_product();
        if nodes.is_nan() || nodes > MOST_NODES {
            let sentence = format!(
                "{spacing_mm} mm is too fine for this tree: {nodes:.1e} grid nodes, {MOST_NODES:.0e} is the most"
            );
            return Err(Error::input(sentence).element("anatomy.surface.spacing_mm"));
        }
        let size = [extent.x, extent.y, extent.z].map(|e| e.ceil() as usize + 1);
        Ok(LumenField { origin: low - margin, spacing_mm, size, values: vec![FAR; size.iter().product()] })
    }

    /// A field of known values, in mm, x fastest: `values.len()` is the product of `size`.
    pub fn from_values(origin: DVec3, spacing_mm: f64, size: [usize; 3], values: Vec<f32>) -> Self {
        debug_assert_eq!(values.len(), size.iter().product::<usize>());
        LumenField { origin, spacing_mm, size, values }
    }

    /// Nodes along x, y and z.
    pub fn size(&self) -> [usize; 3] {
        self.size
    }

    /// Position of a node in mm.
    pub fn position(&self, node: [usize; 3]) -> DVec3 {
        self.origin + DVec3::new(node[0] as f64, node[1] as f64, node[2] as f64) * self.spacing_mm
    }

    /// Index of a node in x-fastest order.
    pub fn index(&self, [x, y, z]: [usize; 3]) -> usize {
        (z * self.size[1] + y) * self.size[0] + x
    }

    /// Value at a node in mm.
    pub fn value(&self, node: [usize; 3]) -> f32 {
        self.values[self.index(node)]
    }

    fn node_range(&self, low: DVec3, high: DVec3) -> [std::ops::Range<usize>; 3] {
        let a = ((low - self.origin) / self.spacing_mm).floor();
        let b = ((high - self.origin) / self.spacing_mm).ceil();
        std::array::from_fn(|axis| (a[axis].max(0.0) as usize)..((b[axis].max(0.0) as usize + 1).min(self.size[axis])))
    }

    fn join(&mut self, branch: &Branch, blend: f64) {
        let reach = |k: usize| reach_mm(branch, k, self.spacing_mm, blend);
        let points = branch.points_mm.len();
        let widest = (0..points).map(reach).fold(0.0, f64::max);
        let (low, high) = (0..points).fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), k| {
            (low.min(branch.position(k) - widest), high.max(branch.position(k) + widest))
        });
        let whole = self.node_range(low, high);
        let cones: Vec<(RoundCone, [std::ops::Range<usize>; 3])> = (1..points)
            .map(|k| {
                let (a, b) = (branch.position(k - 1), branch.position(k));
                let margin = DVec3::splat(reach(k - 1).max(reach(k)));
                let part = self.node_range(a.min(b) - margin, a.max(b) + margin);
                (RoundCone::new(a, branch.radius(k - 1), b, branch.radius(k)), part)
            })
            .collect();
        let [columns, lines, layers] = whole;
        let (mut values, [width, height, _]) = (std::mem::take(&mut self.values), self.size);
        let around = values.par_chunks_mut(width * height).enumerate().skip(layers.start).take(layers.len());
        around.for_each(|(z, layer)| {
            // Distance from this branch, and the width of its blend, on the nodes of the layer around it.
            let mut own = vec![(FAR, 0f32); lines.len() * columns.len()];
            for (cone, part) in cones.iter().filter(|(_, part)| part[2].contains(&z)) {
                for y in part[1].clone() {
                    let row = (y - lines.start) * columns.len();
                    for x in part[0].clone() {
                        let (distance, radius) = cone.distance(self.position([x, y, z]));
                        let slot = &mut own[row + x - columns.start];
                        if (distance as f32) < slot.0 {
                            *slot = (distance as f32, (radius * blend) as f32);
                        }
                    }
                }
            }
            for (y, own) in lines.clone().zip(own.chunks_exact(columns.len())) {
                let values = &mut layer[y * width..][columns.clone()];
                for (value, (distance, blend)) in values.iter_mut().zip(own) {
                    *value = smooth_minimum(*value, *distance, *blend);
                }
            }
        });
        self.values = values;
    }

    /// Trilinear value and its gradient at `point` (mm, dimensionless); `None` outside the grid.
    pub fn sample(&self, point: DVec3) -> Option<(f64, DVec3)> {
        let local = (point - self.origin) / self.spacing_mm;
        let cell = local.floor();
        let base = IVec3::new(cell.x as i32, cell.y as i32, cell.z as i32);
        if base.min_element() < 0 || (0..3).any(|a| base[a] as usize + 1 >= self.size[a]) {
            return None;
        }
        let t = local - cell;
        let corner = |dx: usize, dy: usize, dz: usize| {
            self.value([base.x as usize + dx, base.y as usize + dy, base.z as usize + dz]) as f64
        };
        let along_x = |dy, dz| {
            let (a, b) = (corner(0, dy, dz), corner(1, dy, dz));
            (a + (b - a) * t.x, b - a)
        };
        let along_y = |dz| {
            let ((a, ax), (b, bx)) = (along_x(0, dz), along_x(1, dz));
            (a + (b - a) * t.y, ax + (bx - ax) * t.y, b - a)
        };
        let ((a, ax, ay), (b, bx, by)) = (along_y(0), along_y(1));
        let gradient = DVec3::new(ax + (bx - ax) * t.z, ay + (by - ay) * t.z, b - a) / self.spacing_mm;
        Some((a + (b - a) * t.z, gradient))
    }

    /// The point moved onto the zero surface by Newton steps along the gradient.
    pub fn project(&self, mut point: DVec3) -> DVec3 {
        for _ in 0..3 {
            let Some((value, gradient)) = self.sample(point) else { break };
            let square = gradient.length_squared();
            if square < 0.04 {
                break;
            }
            let step = -gradient * (value / square);
            point += step.clamp_length_max(self.spacing_mm);
        }
        point
    }
}

/// How far from its centre in mm point `k` of a branch changes the field.
fn reach_mm(branch: &Branch, k: usize, spacing_mm: f64, blend: f64) -> f64 {
    branch.radius(k) * (1.0 + blend) + 4.0 * spacing_mm
}

/// Nodes in the boxes around a branch and around its cones.
fn touched_nodes(branch: &Branch, spacing_mm: f64, blend: f64) -> f64 {
    let reach = |k: usize| reach_mm(branch, k, spacing_mm, blend);
    let points = branch.points_mm.len();
    let nodes = |first: usize, last: usize, reach_mm: f64| {
        let (low, high) = (first..=last).fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), k| {
            (low.min(branch.position(k)), high.max(branch.position(k)))
        });
        ((high - low + 2.0 * reach_mm) / spacing_mm + 2.0).element_product()
    };
    let cones: f64 = (1..points).map(|k| nodes(k - 1, k, reach(k - 1).max(reach(k)))).sum();
    cones + nodes(0, points - 1, (0..points).map(reach).fold(0.0, f64::max))
}

/// Polynomial smooth minimum (Quilez): exact where |a - b| > k, at most k / 4 below the minimum.
fn smooth_minimum(a: f32, b: f32, k: f32) -> f32 {
    let overlap = (k - (a - b).abs()).max(0.0);
    if overlap <= 0.0 { a.min(b) } else { a.min(b) - overlap * overlap / (4.0 * k) }
}

/// The hull of two spheres.
struct RoundCone {
    a: DVec3,
    b: DVec3,
    radius_a: f64,
    radius_b: f64,
    axis: DVec3,
    length2: f64,
}

impl RoundCone {
    fn new(a: DVec3, radius_a: f64, b: DVec3, radius_b: f64) -> Self {
        RoundCone { a, b, radius_a, radius_b, axis: b - a, length2: (b - a).length_squared() }
    }

    /// Signed distance, and the radius at the foot point.
    fn distance(&self, p: DVec3) -> (f64, f64) {
        let shrink = self.radius_a - self.radius_b;
        let slant2 = self.length2 - shrink * shrink;
        let from_a = p - self.a;
        // One sphere holds the other: the hull is the larger one.
        if slant2 <= 1e-12 {
            let (centre, radius) = if shrink >= 0.0 { (self.a, self.radius_a) } else { (self.b, self.radius_b) };
            return (p.distance(centre) - radius, radius);
        }
        // Coordinates along (y from a, z from b) and off (x) the axis, in powers of its length; then cap or flank.
        let y = from_a.dot(self.axis);
        let z = y - self.length2;
        let x2 = (from_a * self.length2 - self.axis * y).length_squared();
        let (y2, z2) = (y * y * self.length2, z * z * self.length2);
        let k = shrink.signum() * shrink * shrink * x2;
        let t = (y / self.length2).clamp(0.0, 1.0);
        let radius = self.radius_a + (self.radius_b - self.radius_a) * t;
        let distance = if z.signum() * slant2 * z2 > k {
            (x2 + z2).sqrt() / self.length2 - self.radius_b
        } else if y.signum() * slant2 * y2 < k {
            (x2 + y2).sqrt() / self.length2 - self.radius_a
        } else {
            ((x2 * slant2 / self.length2).sqrt() + y * shrink) / self.length2 - self.radius_a
        };
        (distance, radius)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_round_cone_is_the_hull_of_its_spheres() {
        let cone = RoundCone::new(DVec3::ZERO, 3.0, DVec3::X * 10.0, 1.0);
        for (p, expected) in [(DVec3::NEG_X * 5.0, 2.0), (DVec3::X * 13.0, 2.0), (DVec3::ZERO, -3.0)] {
            assert!((cone.distance(p).0 - expected).abs() < 1e-9, "{p}: {} {expected}", cone.distance(p).0);
        }
        // Brute force: the distance to the densest chain of spheres.
        for p in [DVec3::new(4.0, 5.0, 0.0), DVec3::new(8.0, 0.5, 0.7), DVec3::new(1.0, 0.0, 6.0)] {
            let chain =
                (0..=100_000).map(|k| k as f64 / 1e5).map(|t| p.distance(DVec3::X * 10.0 * t) - (3.0 - 2.0 * t));
            let brute = chain.fold(f64::INFINITY, f64::min);
            assert!((cone.distance(p).0 - brute).abs() < 1e-4, "{p}: {} {brute}", cone.distance(p).0);
        }
    }
}
