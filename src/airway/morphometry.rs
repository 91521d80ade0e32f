//! Measures of a bronchial tree by generation, beside the literature's.
//!
//! The diameter is that of the inscribed sphere (median over the part of the branch outside of its parent); the length
//! runs from one bifurcation to the next; the branching angle lies between the direction of the branch there and that
//! of the parent's last part. The literature measures casts: real lumens are not round, so inscribed diameters are
//! smaller than diameters of equal area.

use crate::base::statistics::mean_median;
use glam::DVec3;
use serde::Serialize;

use super::tree::{Branch, Tree};

/// A generation in the two classic trees.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Literature {
    /// Diameter in mm, Weibel's model A (1963; 75 % of total lung capacity, 4800 ml).
    pub weibel_diameter_mm: f64,
    /// Length in mm, same.
    pub weibel_length_mm: f64,
    /// Diameter in mm of the Horsfield-based symmetric tree (3300 ml), generations 0 to 6.
    pub horsfield_diameter_mm: Option<f64>,
    /// Length in mm, same.
    pub horsfield_length_mm: Option<f64>,
    /// Branching angle in degrees, same; none for the trachea.
    pub horsfield_angle_deg: Option<f64>,
}

/// What a tree has in one generation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct GenerationRow {
    /// The generation, 0 for the trachea.
    pub generation: u32,
    /// Number of branches.
    pub branches: usize,
    /// Median inscribed diameter in mm.
    pub diameter_mm: f64,
    /// Median length in mm of the branches that divide again; of all where none does (ends are where the measuring
    /// or the growth stopped, not anatomy).
    pub length_mm: f64,
    /// Median branching angle in degrees; none for the trachea.
    pub angle_deg: Option<f64>,
    /// The same generation in the literature; none beyond generation 16.
    pub literature: Option<Literature>,
}

// By generation, in mm and degrees; [`Literature`] names the sources.
const WEIBEL_DIAMETER: [f64; 17] =
    [18.0, 12.2, 8.3, 5.6, 4.5, 3.5, 2.8, 2.3, 1.86, 1.54, 1.30, 1.09, 0.95, 0.82, 0.74, 0.66, 0.60];
const WEIBEL_LENGTH: [f64; 17] =
    [120.0, 47.6, 19.0, 7.6, 12.7, 10.7, 9.0, 7.6, 6.4, 5.4, 4.6, 3.9, 3.3, 2.7, 2.3, 2.0, 1.65];
const HORSFIELD_DIAMETER: [f64; 7] = [16.5, 12.0, 8.5, 6.1, 4.4, 3.6, 2.9];
const HORSFIELD_LENGTH: [f64; 7] = [91.0, 38.0, 15.0, 8.3, 9.0, 8.1, 6.6];
const HORSFIELD_ANGLE: [f64; 6] = [36.0, 35.0, 28.0, 35.0, 39.0, 34.0];

/// The literature's figures for one generation.
pub fn literature(generation: u32) -> Option<Literature> {
    let g = generation as usize;
    Some(Literature {
        weibel_diameter_mm: *WEIBEL_DIAMETER.get(g)?,
        weibel_length_mm: WEIBEL_LENGTH[g],
        horsfield_diameter_mm: HORSFIELD_DIAMETER.get(g).copied(),
        horsfield_length_mm: HORSFIELD_LENGTH.get(g).copied(),
        horsfield_angle_deg: g.checked_sub(1).and_then(|k| HORSFIELD_ANGLE.get(k)).copied(),
    })
}

/// Length in mm along the branch up to each point.
fn along(branch: &Branch) -> Vec<f64> {
    let mut sum = 0.0;
    (0..branch.points_mm.len())
        .map(|k| {
            sum += if k > 0 { branch.position(k).distance(branch.position(k - 1)) } else { 0.0 };
            sum
        })
        .collect()
}

/// The point at `way` mm along the branch.
fn point_at(branch: &Branch, along: &[f64], way: f64) -> DVec3 {
    let k = along.partition_point(|&a| a < way).clamp(1, along.len() - 1);
    let t = ((way - along[k - 1]) / (along[k] - along[k - 1]).max(1e-9)).clamp(0.0, 1.0);
    branch.position(k - 1).lerp(branch.position(k), t)
}

/// Index of the parent's point to which a branch is attached.
fn joint(parent: &Branch, branch: &Branch) -> usize {
    let gap = |k: usize| parent.position(k).distance_squared(branch.position(0));
    (0..parent.points_mm.len()).min_by(|&a, &b| gap(a).total_cmp(&gap(b))).unwrap_or(0)
}

/// Length in mm at the start of the branch that still lies in the parent's lumen, at most half of the branch.
fn inside_parent(tree: &Tree, branch: &Branch) -> f64 {
    let parent = branch.parent.map(|p| &tree.branches[p as usize]);
    parent.map_or(0.0, |p| p.radius(joint(p, branch)).min(0.5 * branch.length_mm()))
}

/// Inscribed diameter of a branch in mm.
fn diameter(tree: &Tree, branch: &Branch) -> f64 {
    let own_part = inside_parent(tree, branch);
    let along = along(branch);
    let radii = (0..along.len()).filter(|&k| along[k] >= own_part).map(|k| branch.radius(k));
    2.0 * mean_median(radii).unwrap_or_else(|| branch.median_radius_mm())
}

/// Angle in degrees between a branch and the part of its parent before the joint.
fn angle(tree: &Tree, branch: &Branch) -> Option<f64> {
    let parent = &tree.branches[branch.parent? as usize];
    let parent_along = along(parent);
    let end = joint(parent, branch);
    let back = (parent_along[end] - 2.0 * parent.radius(end)).max(0.4 * parent_along[end]);
    let incoming = parent.position(end) - point_at(parent, &parent_along, back);
    let own_along = along(branch);
    let start = inside_parent(tree, branch);
    let far = (start + 4.0 * branch.median_radius_mm()).min(own_along[own_along.len() - 1]);
    let outgoing = point_at(branch, &own_along, far) - point_at(branch, &own_along, 0.5 * start);
    let defined = incoming.length_squared() > 0.0 && outgoing.length_squared() > 0.0;
    defined.then(|| incoming.angle_between(outgoing).to_degrees())
}

/// One row for each generation that the (valid) tree has, in order.
pub fn rows(tree: &Tree) -> Vec<GenerationRow> {
    let deepest = tree.branches.iter().map(|b| b.generation).max().unwrap_or(0);
    let divides: Vec<bool> =
        (0..tree.branches.len() as u32).map(|b| tree.branches.iter().any(|c| c.parent == Some(b))).collect();
    (0..=deepest)
        .filter_map(|generation| {
            let here: Vec<usize> =
                (0..tree.branches.len()).filter(|&b| tree.branches[b].generation == generation).collect();
            let inner: Vec<usize> = here.iter().copied().filter(|&b| divides[b]).collect();
            let whole = if inner.is_empty() { &here } else { &inner };
            Some(GenerationRow {
                generation,
                branches: here.len(),
                diameter_mm: mean_median(here.iter().map(|&b| diameter(tree, &tree.branches[b])))?,
                length_mm: mean_median(whole.iter().map(|&b| tree.branches[b].length_mm()))?,
                angle_deg: mean_median(here.iter().filter_map(|&b| angle(tree, &tree.branches[b]))),
                literature: literature(generation),
            })
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::airway::grow::{GrowthSettings, grow};

    fn line(from: DVec3, to: DVec3, radius: f64) -> Vec<[f64; 4]> {
        (0..=20).map(|k| from.lerp(to, k as f64 / 20.0)).map(|p| [p.x, p.y, p.z, radius]).collect()
    }

    /// A trachea and two branches at 30 and 50 degrees.
    fn fork() -> Tree {
        let end = DVec3::new(0.0, 0.0, -80.0);
        let child = |degrees: f64, radius: f64, length: f64| {
            let (sin, cos) = degrees.to_radians().sin_cos();
            let points_mm = line(end, end + DVec3::new(sin, 0.0, -cos) * length, radius);
            Branch { parent: Some(0), generation: 1, points_mm }
        };
        let trachea = Branch { parent: None, generation: 0, points_mm: line(DVec3::ZERO, end, 8.0) };
        Tree { source: "test".into(), branches: vec![trachea, child(30.0, 6.0, 30.0), child(-50.0, 4.0, 50.0)] }
    }

    #[test]
    fn a_known_fork_is_measured_to_the_bit_that_rounding_leaves() {
        let rows = rows(&fork());
        assert_eq!((rows[0].branches, rows[1].branches), (1, 2));
        assert_eq!((rows[0].diameter_mm, rows[1].diameter_mm), (16.0, 10.0));
        assert!((rows[0].length_mm - 80.0).abs() < 1e-9 && (rows[1].length_mm - 40.0).abs() < 1e-9);
        assert_eq!(rows[0].angle_deg, None);
        assert!((rows[1].angle_deg.unwrap() - 40.0).abs() < 1e-6);
        assert_eq!(rows[1].literature.unwrap().horsfield_angle_deg, Some(36.0));
        assert_eq!(literature(17), None);
    }

    #[test]
    fn grown_trees_agree_with_horsfield() {
        let mut sum = [[0.0; 3]; 6];
        let seeds = 10;
        for seed in 0..seeds {
            for row in rows(&grow(seed, &GrowthSettings::default()).unwrap()).into_iter().take(6) {
                let slot = &mut sum[row.generation as usize];
                slot[0] += row.diameter_mm / seeds as f64;
                slot[1] += row.length_mm / seeds as f64;
                slot[2] += row.angle_deg.unwrap_or(0.0) / seeds as f64;
            }
        }
        for (g, [diameter, length, angle]) in sum.into_iter().enumerate() {
            println!("generation {g}: {diameter:.1} mm, {length:.1} mm, {angle:.0} degrees");
            assert!((diameter / HORSFIELD_DIAMETER[g] - 1.0).abs() < 0.2, "generation {g}: diameter {diameter}");
            assert!((length / HORSFIELD_LENGTH[g] - 1.0).abs() < 0.45, "generation {g}: length {length}");
            assert!(g == 0 || (20.0..55.0).contains(&angle), "generation {g}: angle {angle}");
        }
    }

    #[test]
    fn measured_tables_have_the_diameters_measured_elsewhere() {
        // Medians of generations 0 to 3 in mm, from another program over the same surfaces.
        let known = [("atm_384", [13.0, 8.9, 6.3, 4.6]), ("atm_224", [14.3, 9.4, 7.0, 5.0])];
        for (name, diameters) in known {
            let path = format!("{}/bench-cases/trees/{name}.toml", env!("CARGO_MANIFEST_DIR"));
            let tree: Tree = crate::base::files::read_toml(path.as_ref()).unwrap();
            for (row, known) in rows(&tree).iter().zip(diameters) {
                let ours = row.diameter_mm;
                println!("{name} generation {}: {ours:.1} mm, elsewhere {known} mm", row.generation);
                assert!((ours / known - 1.0).abs() < 0.12, "{name} generation {}: {ours} mm", row.generation);
            }
        }
    }
}
