//! Bronchial trees as tables: branches with centreline points and inscribed radii, as case files hold them.
//!
//! Frame: LPS, millimetres (x to the patient's left, y posterior, z superior).

use std::collections::BTreeMap;

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::centerline::{Centerline, CenterlinePoint, MOST_LENGTH_MM};
use crate::base::range::{COORDINATE_MM, GENERATION, RADIUS_MM};
use crate::base::statistics::upper_median;
use crate::base::{Error, Result};

/// One branch between two bifurcations. Its first point lies on the parent's centreline (or is the inlet).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Branch {
    /// Index of the parent branch, smaller than the branch's own; absent for the trachea.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub parent: Option<u32>,
    /// Airway generation, 0 for the trachea.
    pub generation: u32,
    /// One `[x, y, z, inscribed radius]` in mm per centreline point, from the parent outwards.
    pub points_mm: Vec<[f64; 4]>,
}

impl Branch {
    /// Position of point `index` in mm.
    pub fn position(&self, index: usize) -> DVec3 {
        let [x, y, z, _] = self.points_mm[index];
        DVec3::new(x, y, z)
    }

    /// Inscribed radius at point `index` in mm.
    pub fn radius(&self, index: usize) -> f64 {
        self.points_mm[index][3]
    }

    /// Length of the centreline in mm.
    pub fn length_mm(&self) -> f64 {
        (1..self.points_mm.len()).map(|k| self.position(k).distance(self.position(k - 1))).sum()
    }

    /// Median inscribed radius in mm.
    pub fn median_radius_mm(&self) -> f64 {
        upper_median(self.points_mm.iter().map(|p| p[3])).expect("a branch has points")
    }
}

/// A bronchial tree; branch 0 is the trachea, parents come before children.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tree {
    /// Where the numbers come from: data set, method, licence, citation.
    pub source: String,
    /// The branches.
    pub branches: Vec<Branch>,
}

impl Tree {
    /// Rejects tables that are no tree; the error names the branch and the point.
    pub fn validate(&self) -> Result<()> {
        let Some(trachea) = self.branches.first() else {
            return Err(Error::input("the tree has no branches"));
        };
        if trachea.parent.is_some() {
            return Err(Error::input("is the trachea and cannot have a parent").element("branches[0]"));
        }
        for (index, branch) in self.branches.iter().enumerate() {
            let wrong = |what: String| Err(Error::input(what).element(format!("branches[{index}]")));
            if index > 0 && branch.parent.is_none_or(|p| p as usize >= index) {
                return wrong("needs a parent that stands before it".into());
            }
            if branch.points_mm.len() < 2 {
                return wrong(format!("has {} points; a branch needs two", branch.points_mm.len()));
            }
            let named = |e: Error, what: &str| e.element(format!("branches[{index}]{what}"));
            GENERATION.check(branch.generation.into()).map_err(|e| named(e, ".generation"))?;
            for (point, &[x, y, z, radius_mm]) in branch.points_mm.iter().enumerate() {
                let place = |e: Error| named(e, &format!(".points_mm[{point}]"));
                [x, y, z].into_iter().try_for_each(|v| COORDINATE_MM.check(v)).map_err(place)?;
                RADIUS_MM.check(radius_mm).map_err(place)?;
            }
        }
        let length_mm: f64 = self.branches.iter().map(Branch::length_mm).sum();
        if length_mm > MOST_LENGTH_MM {
            let sentence =
                format!("the branches are {length_mm:.0} mm long in all, and {MOST_LENGTH_MM:.0} is the most");
            return Err(Error::input(sentence));
        }
        Ok(())
    }

    /// Only the branches that a scope of `minimal_radius_mm` could enter, down to generation `deepest`; a branch that
    /// narrows below half of that is cut off there. Branches that lose their parent are dropped, too.
    pub fn reachable(&self, minimal_radius_mm: f64, deepest: u32) -> Tree {
        let mut kept = Vec::new();
        let mut new_index = vec![None; self.branches.len()];
        for (index, branch) in self.branches.iter().enumerate() {
            let parent = branch.parent.map(|p| new_index[p as usize]);
            let wide = index == 0 || (branch.generation <= deepest && branch.median_radius_mm() >= minimal_radius_mm);
            if !wide || parent == Some(None) {
                continue;
            }
            let end = branch.points_mm.iter().position(|p| p[3] < 0.5 * minimal_radius_mm);
            let points_mm = branch.points_mm[..end.unwrap_or(branch.points_mm.len())].to_vec();
            if points_mm.len() < 2 {
                continue;
            }
            new_index[index] = Some(kept.len() as u32);
            kept.push(Branch { parent: parent.flatten(), generation: branch.generation, points_mm });
        }
        Tree { source: self.source.clone(), branches: kept }
    }

    /// The same branches with points about `step_mm` apart (both ends stay), rounded to 0.01 mm.
    pub fn resampled(&self, step_mm: f64) -> Tree {
        let branches = self.branches.iter().map(|b| Branch { points_mm: resample(&b.points_mm, step_mm), ..b.clone() });
        Tree { source: self.source.clone(), branches: branches.collect() }
    }

    /// The centreline whose points are those of the tables; the first point of a branch is attached to the nearest
    /// point of its parent.
    pub fn to_centerline(&self) -> Centerline {
        let mut points: Vec<CenterlinePoint> = Vec::new();
        let mut range_of_branch: Vec<std::ops::Range<usize>> = Vec::new();
        for (index, branch) in self.branches.iter().enumerate() {
            let start = points.len();
            for k in 0..branch.points_mm.len() {
                let parent = if k > 0 {
                    Some(points.len() as u32 - 1)
                } else {
                    branch.parent.map(|p| nearest(&points, range_of_branch[p as usize].clone(), branch.position(0)))
                };
                points.push(CenterlinePoint {
                    position_mm: branch.position(k),
                    radius_mm: branch.radius(k),
                    branch: index as u32,
                    generation: branch.generation,
                    parent,
                });
            }
            range_of_branch.push(start..points.len());
        }
        Centerline { points }
    }

    /// The table of a centreline, rounded to 0.01 mm; every branch starts with the point of its parent to which it is
    /// attached.
    pub fn from_centerline(centerline: &Centerline, source: &str) -> Tree {
        let row = |p: &CenterlinePoint| {
            let v = p.position_mm;
            [v.x, v.y, v.z, p.radius_mm].map(|c| (c * 100.0).round() / 100.0)
        };
        let mut branches: Vec<Branch> = Vec::new();
        // By name and not by place: a table may number its branches as it likes.
        let mut table_of_branch: BTreeMap<u32, u32> = BTreeMap::new();
        for point in &centerline.points {
            let table = match table_of_branch.get(&point.branch) {
                Some(&table) => table,
                None => {
                    let joint = point.parent.map(|p| centerline.points[p as usize]);
                    let parent = joint.and_then(|p| table_of_branch.get(&p.branch).copied());
                    let points_mm = joint.iter().map(row).collect();
                    branches.push(Branch { parent, generation: point.generation, points_mm });
                    let table = branches.len() as u32 - 1;
                    table_of_branch.insert(point.branch, table);
                    table
                }
            };
            branches[table as usize].points_mm.push(row(point));
        }
        Tree { source: source.into(), branches }
    }
}

fn resample(points: &[[f64; 4]], step_mm: f64) -> Vec<[f64; 4]> {
    let gap = |a: &[f64; 4], b: &[f64; 4]| (0..3).map(|c| (a[c] - b[c]).powi(2)).sum::<f64>().sqrt();
    let mut along = vec![0.0];
    for pair in points.windows(2) {
        along.push(along[along.len() - 1] + gap(&pair[0], &pair[1]));
    }
    let length = along[along.len() - 1];
    let pieces = (length / step_mm).round().max(1.0) as usize;
    let mut segment = 1;
    (0..=pieces)
        .map(|k| {
            let at = length * k as f64 / pieces as f64;
            while segment + 1 < points.len() && along[segment] < at {
                segment += 1;
            }
            let span = (along[segment] - along[segment - 1]).max(1e-12);
            let t = ((at - along[segment - 1]) / span).clamp(0.0, 1.0);
            let (a, b) = (points[segment - 1], points[segment]);
            std::array::from_fn(|c| ((a[c] + (b[c] - a[c]) * t) * 100.0).round() / 100.0)
        })
        .collect()
}

fn nearest(points: &[CenterlinePoint], range: std::ops::Range<usize>, to: DVec3) -> u32 {
    range
        .min_by(|&a, &b| {
            points[a].position_mm.distance_squared(to).total_cmp(&points[b].position_mm.distance_squared(to))
        })
        .unwrap_or(0) as u32
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fork() -> Tree {
        let line = |from: DVec3, to: DVec3, r: f64| -> Vec<[f64; 4]> {
            (0..=10).map(|k| from.lerp(to, k as f64 / 10.0)).map(|p| [p.x, p.y, p.z, r]).collect()
        };
        Tree {
            source: "test".into(),
            branches: vec![
                Branch { parent: None, generation: 0, points_mm: line(DVec3::ZERO, DVec3::NEG_Z * 50.0, 8.0) },
                Branch {
                    parent: Some(0),
                    generation: 1,
                    points_mm: line(DVec3::NEG_Z * 50.0, DVec3::new(20.0, 0.0, -80.0), 5.0),
                },
                Branch {
                    parent: Some(0),
                    generation: 1,
                    points_mm: line(DVec3::NEG_Z * 50.0, DVec3::new(-20.0, 0.0, -80.0), 1.0),
                },
            ],
        }
    }

    #[test]
    fn table_and_centerline_agree() {
        let tree = fork();
        tree.validate().unwrap();
        let centerline = tree.to_centerline();
        assert_eq!(centerline.points.len(), 33);
        assert_eq!(centerline.points[11].parent, Some(10));
        let back = Tree::from_centerline(&centerline, "test");
        assert_eq!(back.branches.len(), 3);
        assert_eq!(back.branches[2].parent, Some(0));
        assert!((back.branches[1].length_mm() - tree.branches[1].length_mm()).abs() < 0.1);
    }

    /// A branch may leave its parent on the way, and ends where it gets too narrow.
    #[test]
    fn a_branch_joins_its_parent_where_it_begins() {
        let mut tree = fork();
        tree.branches[2].points_mm.iter_mut().for_each(|p| p[2] += 20.0);
        let centerline = tree.to_centerline();
        assert_eq!((centerline.points[11].parent, centerline.points[22].parent), (Some(10), Some(6)));
        tree.branches[1].points_mm[7..].iter_mut().for_each(|p| p[3] = 0.9);
        assert_eq!(tree.reachable(2.0, 9).branches[1].points_mm.len(), 7);
    }

    #[test]
    fn narrow_branches_are_not_reachable_and_damage_is_named() {
        assert_eq!(fork().reachable(2.0, 9).branches.len(), 2);
        let mut broken = fork();
        broken.branches[1].points_mm[3][3] = 0.0;
        assert!(broken.validate().unwrap_err().to_string().contains("branches[1].points_mm[3]: 0 must lie"));
    }
}
