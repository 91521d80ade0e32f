//! An imported airway held against the true one: walls, branches, centreline.
//!
//! A branch is found when the imported centreline runs along it. The wall within 1.5 radii of the trachea's inlet is left
//! out: the scan shows a trachea that goes on.

use glam::DVec3;
use rayon::prelude::*;

use super::result::{AirwayWay, GENERATIONS, GenerationLoss, WayResult};
use crate::airway::Anatomy;
use crate::airway::centerline::{Centerline, CenterlineSettings};
use crate::airway::centerline_distance::SurfaceDistance;
use crate::airway::centerline_extract::extract;
use crate::airway::nearest_points::NearestPoints;
use crate::base::{Error, Result, TriangleMesh};
use crate::ct::lumen::DistanceSpread;

/// Radii of the inlet that are left out.
const INLET_RADII: f64 = 1.5;
/// A branch is found when this part of it, its start left out, has an imported centreline within a radius and at least
/// this many mm.
const FOUND_SHARE: f64 = 0.6;
const FOUND_MM: f64 = 1.2;
/// Part of a branch that counts as its start: it lies in its parent's lumen.
const START_SHARE: f64 = 0.3;
/// An imported branch is extra when half of it is farther than this many radii and mm from the true centreline.
const EXTRA: (f64, f64) = (1.5, 1.0);

/// An airway that others are held against: its surface by branches, without the inlet.
pub struct ReferenceAirway {
    line: Centerline,
    /// Vertices that are compared, and the branch and generation of each.
    vertices: Vec<usize>,
    branch_of: Vec<u32>,
    generation_of: Vec<u32>,
}

impl ReferenceAirway {
    /// Of a surface and its centreline, below `highest_mm` and outside of the inlet.
    ///
    /// Errors: a centreline without points.
    pub fn new(surface: &TriangleMesh, line: Centerline, highest_mm: f64) -> Result<ReferenceAirway> {
        let points = NearestPoints::new(&line.points.iter().map(|p| p.position_mm).collect::<Vec<_>>())?;
        let inlet = line.points.first().ok_or_else(|| Error::input("the centreline has no points"))?;
        let widest = line.points.iter().take(20).map(|p| p.radius_mm).fold(0.0, f64::max);
        let rim = INLET_RADII * widest;
        let is_compared = |v: &DVec3| v.distance(inlet.position_mm) > rim && v.z < highest_mm;
        let compared = surface.vertices.iter().enumerate().filter(|(_, v)| is_compared(v));
        let vertices: Vec<usize> = compared.map(|(k, _)| k).collect();
        let nearest = |&v: &usize| points.nearest(surface.vertices[v]).0;
        let feet: Vec<usize> = vertices.par_iter().map(nearest).collect();
        let branch_of = feet.iter().map(|&p| line.points[p].branch).collect();
        let generation_of = feet.iter().map(|&p| line.points[p].generation.min(GENERATIONS - 1)).collect();
        Ok(ReferenceAirway { line, vertices, branch_of, generation_of })
    }

    /// Those of its surface's vertices that are compared.
    pub fn at(&self, vertices: &[DVec3]) -> Vec<DVec3> {
        self.vertices.iter().map(|&v| vertices[v]).collect()
    }

    /// Distances along found branches, in generations that are `wanted`.
    pub fn of_found(&self, distances: &[f64], is_found: &[bool], wanted: impl Fn(u32) -> bool) -> Vec<f64> {
        (0..distances.len())
            .filter(|&k| is_found[self.branch_of[k] as usize] && wanted(self.generation_of[k]))
            .map(|k| distances[k])
            .collect()
    }

    /// How many branches a generation has, and how many of them were found.
    pub fn count(&self, generation: u32, is_found: &[bool]) -> (usize, usize) {
        let is_member = |points: &[usize]| {
            points.first().is_some_and(|&k| self.line.points[k].generation.min(GENERATIONS - 1) == generation)
        };
        let all = branches(&self.line);
        let members = all.iter().zip(is_found).filter(|(points, _)| is_member(points));
        members.fold((0, 0), |(all, found), (_, is_found)| (all + 1, found + usize::from(*is_found)))
    }

    /// Whether each branch runs along `other`, and the distances of the found ones' points from it, mm.
    pub fn found_in(&self, other: &Centerline) -> (Vec<bool>, Vec<f64>) {
        found_branches(&self.line, other)
    }
}

/// The true airway, ready to be compared with.
pub struct TrueAirway {
    anatomy: Anatomy,
    reference: ReferenceAirway,
}

impl TrueAirway {
    /// Of a case, as far as a scan shows it that ends at `highest_mm`.
    pub fn new(anatomy: Anatomy, highest_mm: f64) -> Result<TrueAirway> {
        let reference = ReferenceAirway::new(&anatomy.inspiration, anatomy.centerline.clone(), highest_mm)?;
        Ok(TrueAirway { anatomy, reference })
    }

    /// Its vertices that are compared, at inspiration and at expiration.
    pub fn walls(&self) -> [Vec<DVec3>; 2] {
        [&self.anatomy.inspiration, &self.anatomy.expiration].map(|mesh| self.reference.at(&mesh.vertices))
    }
}

/// Distances to the polyline of a centreline.
struct LineDistance<'a> {
    line: &'a Centerline,
}

impl LineDistance<'_> {
    /// The least distance in mm of a place, and the radius there.
    fn nearest(&self, place: DVec3) -> (f64, f64) {
        let points = &self.line.points;
        let mut best = (f64::INFINITY, 0.0);
        for point in points {
            let Some(parent) = point.parent.map(|p| &points[p as usize]) else { continue };
            let (a, b) = (parent.position_mm, point.position_mm);
            let length2 = (b - a).length_squared();
            let t = if length2 > 0.0 { ((place - a).dot(b - a) / length2).clamp(0.0, 1.0) } else { 0.0 };
            let distance = place.distance(a.lerp(b, t));
            if distance < best.0 {
                best = (distance, parent.radius_mm + (point.radius_mm - parent.radius_mm) * t);
            }
        }
        best
    }
}

/// The points of each branch, in order.
fn branches(line: &Centerline) -> Vec<Vec<usize>> {
    let count = line.points.iter().map(|p| p.branch).max().map_or(0, |b| b as usize + 1);
    let mut of_branch = vec![Vec::new(); count];
    line.points.iter().enumerate().for_each(|(k, p)| of_branch[p.branch as usize].push(k));
    of_branch
}

/// Whether each true branch was found, and the distances of the found ones' points from the imported centreline.
fn found_branches(truth: &Centerline, imported: &Centerline) -> (Vec<bool>, Vec<f64>) {
    let to_imported = LineDistance { line: imported };
    let (mut is_found, mut distances) = (Vec::new(), Vec::new());
    for branch in branches(truth) {
        let body = &branch[(branch.len() as f64 * START_SHARE) as usize..];
        let off: Vec<f64> = body.par_iter().map(|&k| to_imported.nearest(truth.points[k].position_mm).0).collect();
        let near = |&(&k, &off): &(&usize, &f64)| off < truth.points[k].radius_mm.max(FOUND_MM);
        let count = body.iter().zip(&off).filter(near).count();
        let found = !body.is_empty() && count as f64 >= FOUND_SHARE * body.len() as f64;
        is_found.push(found);
        if found {
            distances.extend(body.iter().zip(&off).filter(near).map(|(_, off)| *off));
        }
    }
    (is_found, distances)
}

/// Imported branches that run where no true airway is, below `highest_mm`.
fn extra_branches(truth: &Centerline, imported: &Centerline, highest_mm: f64) -> usize {
    let to_truth = LineDistance { line: truth };
    let is_off = |&k: &usize| {
        let (distance, radius) = to_truth.nearest(imported.points[k].position_mm);
        distance > (EXTRA.0 * radius).max(EXTRA.1)
    };
    let is_extra = |branch: &Vec<usize>| {
        let low: Vec<usize> =
            branch.iter().copied().filter(|&k| imported.points[k].position_mm.z < highest_mm).collect();
        !low.is_empty() && 2 * low.par_iter().filter(|k| is_off(k)).count() > low.len()
    };
    branches(imported).iter().filter(|branch| is_extra(branch)).count()
}

/// Distances in mm of places from a surface.
pub fn distances(surface: &TriangleMesh, places: &[DVec3]) -> Vec<f64> {
    let surface = SurfaceDistance::new(surface);
    places.par_iter().map(|p| surface.distance(*p)).collect()
}

/// Holds an imported airway against the truth. `moved` are its vertices at expiration.
pub fn compared(way: AirwayWay, truth: &TrueAirway, rest: &TriangleMesh, moved: Vec<DVec3>) -> Result<WayResult> {
    let line = extract(rest, &CenterlineSettings::default())?;
    let (reference, true_line) = (&truth.reference, &truth.anatomy.centerline);
    let (is_found, off_line) = reference.found_in(&line);
    let other = TriangleMesh { vertices: moved, faces: rest.faces.clone() };
    let [at_rest, at_expiration] = truth.walls();
    let (wall, wall_expiration) = (distances(rest, &at_rest), distances(&other, &at_expiration));
    let spread = |distances: &[f64], wanted: &dyn Fn(u32) -> bool| {
        DistanceSpread::of(reference.of_found(distances, &is_found, wanted))
    };
    let of_generation = |generation: u32| {
        let (branches, found) = reference.count(generation, &is_found);
        GenerationLoss { generation, branches, found, wall: spread(&wall, &|g| g == generation) }
    };
    let inlet = true_line.points[0];
    let highest = inlet.position_mm.z - INLET_RADII * inlet.radius_mm;
    let below: Vec<DVec3> = rest.vertices.iter().copied().filter(|v| v.z < highest).collect();
    Ok(WayResult {
        way,
        failure: None,
        generations: (0..GENERATIONS).map(of_generation).filter(|row| row.branches > 0).collect(),
        wall: spread(&wall, &|_| true),
        wall_to_3: spread(&wall, &|g| g <= 3),
        imported_wall: DistanceSpread::of(distances(&truth.anatomy.inspiration, &below)),
        extra_branches: extra_branches(true_line, &line, highest),
        centerline: DistanceSpread::of(off_line),
        wall_expiration: spread(&wall_expiration, &|_| true),
    })
}

/// A row that says why there is none.
pub fn failed(way: AirwayWay, error: &Error) -> WayResult {
    let none = DistanceSpread::of(Vec::new());
    WayResult {
        way,
        failure: Some(error.to_string()),
        generations: Vec::new(),
        wall: none,
        wall_to_3: none,
        imported_wall: none,
        extra_branches: 0,
        centerline: none,
        wall_expiration: none,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::airway::centerline::CenterlinePoint;

    /// A trachea down to a fork with two branches of 30 mm, of which the second may be missing.
    fn fork(branches: u32) -> Centerline {
        let mut points = Vec::new();
        for branch in 0..=branches {
            let way = [-DVec3::Z, DVec3::new(0.7, 0.0, -0.7), DVec3::new(-0.7, 0.0, -0.7)][branch as usize];
            for k in 0..=30 {
                points.push(CenterlinePoint {
                    position_mm: if branch == 0 { DVec3::ZERO } else { -30.0 * DVec3::Z } + way * f64::from(k),
                    radius_mm: 5.0,
                    branch,
                    generation: branch.min(1),
                    parent: match (branch, k) {
                        (0, 0) => None,
                        (1.., 0) => Some(30),
                        _ => Some(points.len() as u32 - 1),
                    },
                });
            }
        }
        Centerline { points }
    }

    /// A tree without one of its ends has lost one branch, and has an extra one against the tree without it.
    #[test]
    fn a_branch_that_is_missing_is_counted() {
        let (whole, less) = (fork(2), fork(1));
        let (found, off) = found_branches(&whole, &whole);
        assert!(found.iter().all(|f| *f) && off.iter().all(|d| *d < 1e-9));
        let (found, _) = found_branches(&whole, &less);
        assert_eq!(found, [true, true, false]);
        assert_eq!(extra_branches(&less, &whole, 1e9), 1);
        assert_eq!(extra_branches(&whole, &less, 1e9), 0);
    }
}
