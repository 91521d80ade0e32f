//! The shape of one grown branch, and whether it keeps clear of the others.

use glam::DVec3;

use super::tree::{Branch, Tree};

/// Distance between centreline points in mm.
const STEP_MM: f64 = 1.0;
/// Least gap in mm between walls of branches that are not joined; the share of the radius keeps the blend of
/// `surface` from closing it.
const CLEARANCE_MM: f64 = 1.6;
const CLEARANCE_RADIUS: f64 = 0.3;
/// Radius at the end of a branch over that at its start.
const TAPER: f64 = 0.93;

/// A branch before it has points.
pub(super) struct Shoot {
    /// End of the parent in mm.
    pub from: DVec3,
    /// Direction of the parent there.
    pub parent_direction: DVec3,
    /// Own direction, a unit vector.
    pub direction: DVec3,
    /// Length of the chord in mm.
    pub length_mm: f64,
    /// Inscribed radius at the start in mm.
    pub radius_mm: f64,
}

impl Shoot {
    /// Where it ends.
    pub fn end(&self) -> DVec3 {
        self.from + self.direction * self.length_mm
    }
}

/// Centreline as `[x, y, z, radius]`, rounded to 0.01 mm: a quadratic Bezier arc that leaves the parent half in the
/// parent's direction and swings into its own.
pub(super) fn shoot_points(shoot: &Shoot) -> Vec<[f64; 4]> {
    let leave = (shoot.direction + 0.5 * shoot.parent_direction).normalize_or(shoot.direction);
    let control = shoot.from + leave * (0.4 * shoot.length_mm);
    let pieces = (shoot.length_mm / STEP_MM).round().max(3.0) as usize;
    let point = |k: usize| {
        let t = k as f64 / pieces as f64;
        let p = shoot.from.lerp(control, t).lerp(control.lerp(shoot.end(), t), t);
        let radius = shoot.radius_mm * (1.0 + (TAPER - 1.0) * t);
        [p.x, p.y, p.z, radius].map(|c| (c * 100.0).round() / 100.0)
    };
    (0..=pieces).map(point).collect()
}

/// Distance in mm along the tree from the inlet to the start of every branch.
fn depths(tree: &Tree) -> Vec<f64> {
    let mut depths: Vec<f64> = Vec::with_capacity(tree.branches.len());
    for branch in &tree.branches {
        let parent = branch.parent.map(|p| p as usize);
        depths.push(parent.map_or(0.0, |p| depths[p] + tree.branches[p].length_mm()));
    }
    depths
}

fn with_ancestors(tree: &Tree, branch: usize) -> Vec<usize> {
    std::iter::successors(Some(branch), |&b| tree.branches[b].parent.map(|p| p as usize)).collect()
}

/// Whether a child of `parent` with the given points stays apart from every branch of `tree`. Near a shared joint
/// branches touch, as they must: pairs are compared only where the distance along the tree between them is so long that
/// they should have separated.
pub(super) fn keeps_clear(tree: &Tree, parent: usize, points_mm: &[[f64; 4]]) -> bool {
    let child = Branch { parent: Some(parent as u32), generation: 0, points_mm: points_mm.to_vec() };
    let depths = depths(tree);
    let own_line = with_ancestors(tree, parent);
    let joint_depth = depths[parent] + tree.branches[parent].length_mm();
    tree.branches.iter().enumerate().all(|(index, other)| {
        let ancestor = own_line.contains(&index);
        let meeting = with_ancestors(tree, index).into_iter().find(|b| own_line.contains(b)).unwrap_or(0);
        let meeting_depth = depths[meeting] + tree.branches[meeting].length_mm();
        let mut own_way = 0.0;
        (0..child.points_mm.len()).all(|k| {
            if k > 0 {
                own_way += child.position(k).distance(child.position(k - 1));
            }
            let mut other_depth = depths[index];
            (0..other.points_mm.len()).all(|m| {
                if m > 0 {
                    other_depth += other.position(m).distance(other.position(m - 1));
                }
                let shared = if ancestor { other_depth } else { meeting_depth };
                let way = own_way + joint_depth + other_depth - 2.0 * shared;
                let radii = child.radius(k) + other.radius(m);
                let gap = CLEARANCE_MM + CLEARANCE_RADIUS * child.radius(k).max(other.radius(m));
                way < 2.2 * (radii + gap) || child.position(k).distance(other.position(m)) > radii + gap
            })
        })
    })
}
