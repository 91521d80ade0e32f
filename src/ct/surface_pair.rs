//! Two surfaces of one airway, made apart: the first is moved onto the second.
//!
//! Rigid first (iterated closest points; Besl and McKay, IEEE PAMI 14:239, 1992), since two scans may lie anyhow; that
//! part is the patient's place on the table and no breathing, so it is taken out. Then the breathing field of
//! [`crate::airway::field_fit`] is fitted to the closest points, again and again with less smoothing. Its residual tells
//! how well that went. Points slide along the wall: what moves along an airway without changing its shape is not seen.

use std::num::NonZeroUsize;

use glam::{DAffine3, DMat3, DVec3};
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use nalgebra::Matrix3;
use rayon::prelude::*;

use super::lumen::DistanceSpread;
use crate::airway::centerline_distance::SurfaceDistance;
use crate::airway::field::BreathingField;
use crate::airway::field_fit::{FitSettings, choose_centers, fit};
use crate::base::{Error, Progress, Result, TriangleMesh};
use crate::formats::landmarks::LandmarkPair;

/// Points of the first surface that are matched.
const POINTS: usize = 2500;
/// Rounds of rigid alignment, and the share of the closest matches that counts.
const RIGID_ROUNDS: usize = 60;
const TRUSTED_SHARE: f64 = 0.7;
/// Farthest match in mm and least smoothing of each round of the fit.
const ROUNDS: [(f64, f64); 7] =
    [(15.0, 3.0), (12.0, 1.0), (10.0, 0.3), (8.0, 0.1), (6.0, 0.03), (5.0, 0.01), (4.0, 0.003)];
/// Least cosine between the normals of matched points.
const ALIKE: f64 = 0.6;
/// Nearest candidates among which a match with a like normal is looked for.
const CANDIDATES: usize = 12;
/// Centres of the field, their spacing and reach in mm, and its softening.
const CENTERS: usize = 90;
const CENTER_SPACING_MM: f64 = 12.0;
const CENTER_REACH_MM: f64 = 15.0;
const SOFTENING_MM: f64 = 12.0;

/// In which frames two surfaces lie.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PairFrames {
    /// The patient lay anew for the second: a rigid part of the difference is not motion.
    Own,
    /// One frame: all of the difference is motion.
    Shared,
}

/// The first surface, moved onto the second.
pub struct RegisteredPair {
    /// The first surface's vertices where the second one is, in the first one's frame.
    pub moved: Vec<DVec3>,
    /// Angle of the rigid part that was taken out: how differently the patient lay.
    pub turn_deg: f64,
    /// Its shift at the middle of the airway, mm.
    pub shift_mm: f64,
    /// Distance of the first surface from the second after the rigid part.
    pub before: DistanceSpread,
    /// The same after all.
    pub after: DistanceSpread,
    /// The last of these for each vertex, mm.
    pub residual_mm: Vec<f64>,
    /// Mean motion of the vertices, mm.
    pub motion_mm: f64,
}

/// The other surface, ready to be asked for its nearest point.
struct Matcher {
    tree: ImmutableKdTree<f64, 3>,
    points: Vec<DVec3>,
    normals: Vec<DVec3>,
}

impl Matcher {
    fn new(mesh: &TriangleMesh) -> Result<Matcher> {
        let keys: Vec<[f64; 3]> = mesh.vertices.iter().map(|v| v.to_array()).collect();
        let tree = ImmutableKdTree::new_from_slice(&keys)
            .map_err(|e| Error::input(format!("its vertices cannot be searched: {e:?}")))?;
        Ok(Matcher { tree, points: mesh.vertices.clone(), normals: mesh.vertex_normals() })
    }

    /// The nearest point whose normal is like `normal`, on the plane through it: point and distance.
    fn nearest(&self, at: DVec3, normal: DVec3) -> Option<(DVec3, f64)> {
        let count = NonZeroUsize::new(CANDIDATES.min(self.points.len()))?;
        let found = self.tree.query(&at.to_array()).nearest_n::<SquaredEuclidean<f64>>(count).execute();
        let like = |&k: &usize| self.normals[k].dot(normal) > ALIKE;
        let nearest = found
            .iter()
            .map(|n| n.item as usize)
            .filter(like)
            .min_by(|&a, &b| self.points[a].distance_squared(at).total_cmp(&self.points[b].distance_squared(at)))?;
        let (point, wall) = (self.points[nearest], self.normals[nearest]);
        // The nearest vertex lies aside of the nearest point: only what is across the wall counts.
        let foot = at + wall * wall.dot(point - at);
        Some((foot, point.distance(at)))
    }
}

/// Moves `first` onto `second`. Both closed, LPS, mm, normals into the lumen; frames may differ by some degrees and any
/// shift.
///
/// Errors: surfaces so unlike that too few points match.
pub fn register_surfaces(
    first: &TriangleMesh,
    second: &TriangleMesh,
    frames: PairFrames,
    progress: &dyn Progress,
) -> Result<RegisteredPair> {
    let matcher = Matcher::new(second)?;
    let normals = first.vertex_normals();
    let step = (first.vertices.len() / POINTS).max(1);
    let points: Vec<usize> = (0..first.vertices.len()).step_by(step).collect();
    let second_from_first = match frames {
        PairFrames::Own => rigid(first, second, &points, &normals, &matcher),
        PairFrames::Shared => DAffine3::IDENTITY,
    };
    // Everything in the frame of the first: the second's answers are carried back.
    let first_from_second = second_from_first.inverse();
    let turn = second_from_first.matrix3;
    let ask = |place: DVec3, normal: DVec3| {
        let (foot, distance) = matcher.nearest(second_from_first.transform_point3(place), turn * normal)?;
        Some((first_from_second.transform_point3(foot), distance))
    };
    let near: Vec<DVec3> = points.iter().map(|&v| first.vertices[v]).collect();
    let settings = FitSettings {
        source: String::new(),
        centers_mm: choose_centers(&near, CENTER_SPACING_MM, CENTER_REACH_MM, CENTERS),
        softening_mm: SOFTENING_MM,
        anchors: vec![],
    };
    let mut field: Option<BreathingField> = None;
    for (round, (farthest_mm, least_lambda)) in ROUNDS.into_iter().enumerate() {
        progress.proceed()?;
        progress.advance(round, ROUNDS.len());
        let at =
            |v: usize| first.vertices[v] + field.as_ref().map_or(DVec3::ZERO, |f| f.displacement(first.vertices[v]));
        let pairs: Vec<LandmarkPair> = points
            .par_iter()
            .filter_map(|&v| {
                let (foot, distance) = ask(at(v), normals[v])?;
                let pair = LandmarkPair { inspiration_mm: first.vertices[v], expiration_mm: foot };
                (distance <= farthest_mm).then_some(pair)
            })
            .collect();
        if pairs.len() * 3 < points.len() {
            return Err(Error::input(format!(
                "the two surfaces are too unlike: {} of {} points find a wall of the same direction within {farthest_mm} mm",
                pairs.len(),
                points.len()
            )));
        }
        field = Some(fit(&pairs, &settings, least_lambda)?.0);
    }
    let field = field.ok_or_else(|| Error::input("no round of registration was run"))?;
    let moved: Vec<DVec3> = first.vertices.par_iter().map(|v| v + field.displacement(*v)).collect();
    let surface = SurfaceDistance::new(second);
    let off = |places: &[DVec3]| -> Vec<f64> {
        places.par_iter().map(|p| surface.distance(second_from_first.transform_point3(*p))).collect()
    };
    let residual_mm = off(&moved);
    let motion: f64 = moved.iter().zip(&first.vertices).map(|(a, b)| a.distance(*b)).sum();
    let turned_deg = glam::DQuat::from_mat3(&turn).to_axis_angle().1.to_degrees();
    Ok(RegisteredPair {
        turn_deg: turned_deg.min(360.0 - turned_deg),
        shift_mm: {
            let middle = near.iter().sum::<DVec3>() / near.len() as f64;
            second_from_first.transform_point3(middle).distance(middle)
        },
        before: DistanceSpread::of(off(&first.vertices)),
        after: DistanceSpread::of(residual_mm.clone()),
        residual_mm,
        motion_mm: motion / moved.len() as f64,
        moved,
    })
}

/// The rigid map from the first surface's frame to the second's.
fn rigid(
    first: &TriangleMesh,
    second: &TriangleMesh,
    points: &[usize],
    normals: &[DVec3],
    matcher: &Matcher,
) -> DAffine3 {
    let middle = |mesh: &TriangleMesh| mesh.vertices.iter().sum::<DVec3>() / mesh.vertices.len() as f64;
    let mut map = DAffine3::from_translation(middle(second) - middle(first));
    for _ in 0..RIGID_ROUNDS {
        let mut matches: Vec<(DVec3, DVec3, f64)> = points
            .par_iter()
            .filter_map(|&v| {
                let at = map.transform_point3(first.vertices[v]);
                let (foot, distance) = matcher.nearest(at, map.matrix3 * normals[v])?;
                Some((at, foot, distance))
            })
            .collect();
        matches.sort_by(|a, b| a.2.total_cmp(&b.2));
        matches.truncate(((matches.len() as f64 * TRUSTED_SHARE) as usize).max(3));
        if matches.len() < 10 {
            break;
        }
        let step = kabsch(&matches);
        map = step * map;
        let moves = step.translation.length()
            + (step.matrix3 - DMat3::IDENTITY).to_cols_array().map(f64::abs).iter().sum::<f64>();
        if moves < 1e-5 {
            break;
        }
    }
    map
}

/// The rotation and shift that bring the first points of the matches nearest to the second ones (Kabsch).
fn kabsch(matches: &[(DVec3, DVec3, f64)]) -> DAffine3 {
    let count = matches.len() as f64;
    let from = matches.iter().map(|m| m.0).sum::<DVec3>() / count;
    let to = matches.iter().map(|m| m.1).sum::<DVec3>() / count;
    let mut covariance = Matrix3::<f64>::zeros();
    for (a, b, _) in matches {
        let (a, b) = (*a - from, *b - to);
        for row in 0..3 {
            for column in 0..3 {
                covariance[(row, column)] += b[row] * a[column];
            }
        }
    }
    let svd = covariance.svd(true, true);
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else { return DAffine3::from_translation(to - from) };
    let sign = (u * v_t).determinant().signum();
    let rotation = u * Matrix3::from_diagonal(&nalgebra::Vector3::new(1.0, 1.0, sign)) * v_t;
    let turn = DMat3::from_cols_array(&std::array::from_fn(|k| rotation[(k % 3, k / 3)]));
    DAffine3 { matrix3: turn, translation: to - turn * from }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::airway::grow::{GrowthSettings, grow};
    use crate::airway::surface::{SurfaceSettings, surface_from_tree};
    use crate::base::NoProgress;

    #[test]
    fn a_surface_that_lay_elsewhere_and_breathed_is_found_again() {
        let growth = GrowthSettings::default();
        let tree = grow(3, &growth).unwrap().reachable(1.5, 3);
        let surface = SurfaceSettings { unevenness: 0.0, rounds: 3, ..SurfaceSettings::default() };
        let (first, _) = surface_from_tree(&tree, &surface).unwrap();
        let other = SurfaceSettings { spacing_mm: 0.7, ..surface };
        let (mut second, _) = surface_from_tree(&tree, &other).unwrap();
        let (low, high) = first.bounds();
        let breath = |p: DVec3| {
            let depth = (high.z - p.z) / (high.z - low.z);
            p + DVec3::new(0.02 * (p.x - low.x), 0.0, 7.0 * depth * depth)
        };
        let lie = DAffine3::from_axis_angle(DVec3::new(1.0, 0.5, 0.2).normalize(), 0.06);
        // In one frame nothing is taken out. What slides along a smooth wall is not seen either way.
        let mut there = second.clone();
        there.vertices.iter_mut().for_each(|v| *v = breath(*v));
        let motion = first.vertices.iter().map(|&v| breath(v).distance(v)).sum::<f64>() / first.vertices.len() as f64;
        let found = register_surfaces(&first, &there, PairFrames::Shared, &NoProgress).unwrap();
        assert_eq!((found.turn_deg, found.shift_mm), (0.0, 0.0));
        let own = register_surfaces(&first, &there, PairFrames::Own, &NoProgress).unwrap();
        let share = found.motion_mm / motion;
        assert!((0.7..1.0).contains(&share) && own.motion_mm < 0.8 * found.motion_mm, "{share}, {} mm", own.motion_mm);
        second.vertices.iter_mut().for_each(|v| *v = lie.transform_point3(breath(*v)) + DVec3::new(30.0, -50.0, 12.0));
        let found = register_surfaces(&first, &second, PairFrames::Own, &NoProgress).unwrap();
        println!("turn {:.2} deg, before {}, after {}", found.turn_deg, found.before, found.after);
        assert!(found.after.median_mm < 0.3 && found.after.p95_mm < 1.0, "{}", found.after);
        assert!(found.before.median_mm > 2.0 * found.after.median_mm);
        assert!(found.turn_deg < 10.0);
    }
}
