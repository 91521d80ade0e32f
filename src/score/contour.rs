//! Target localisation at the final frame: contour RMSE and target error (the paper, "Target localization accuracy").
//!
//! True and predicted surface are cut by the final camera's plane; of each cut, the contour around the camera is kept.
//! Contour RMSE is symmetric: both contours are resampled densely and every sample is measured against the other
//! polyline. Where the plane meets a bifurcation, a shift of a hair's breadth joins the contours of two branches to one
//! or parts them; so of a prediction with the truth's faces, cuts of the other surface that come nearer than its contour
//! around the camera join that contour, on both sides, and so do their counterparts. The target error is the
//! displacement of one material point of the true contour (same mesh edge, same fraction along it), so it also measures
//! motion *along* the wall and along the airway, which the contour RMSE cannot.

use glam::{DAffine3, DVec3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::correspondence;
use super::slice::{Plane, Polyline, slice};
use super::statistics;
use crate::base::random::{CounterRng, Stage};
use crate::base::statistics::quantile;
use crate::base::{Result, TriangleMesh};
use crate::ffi::vision::PlaneContour;

/// Distance between samples of a contour, mm.
const SAMPLE_STEP_MM: f64 = 0.05;
/// Samples of one contour at most: a damaged mesh may have contours of any length.
const MAX_SAMPLES: usize = 5000;

/// Cuts of a prediction for each of the truth that may join.
const MOST_PARTS: usize = 2;
/// Share of the true contour of which the predicted one around the camera is the nearest cut, at least, where others join.
const LEAST_SHARE: f64 = 0.1;

/// Whether a surface's contour runs around the camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Enclosure {
    /// A contour does.
    Inside,
    /// None does; the nearest contour was taken.
    Outside,
}

/// How points of the truth were found on the predicted surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Correspondence {
    /// Same faces: the same material point.
    Material,
    /// Other faces, and a table that says where the true vertices are on them.
    Stated,
    /// Other faces and no table. Whatever is nearest would reward surfaces that fill the room.
    Missing,
}

/// What a plot of the final frame needs; plane coordinates in mm, the camera at (0, 0), x right, y down.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ContourOverlay {
    /// The true contour, closed.
    pub truth: Vec<[f64; 2]>,
    /// The predicted contour.
    pub predicted: Vec<[f64; 2]>,
    /// Whether the predicted contour's last vertex joins its first.
    pub predicted_closed: bool,
    /// The target on the true contour.
    pub target_truth: [f64; 2],
    /// The same point on the predicted surface, projected into the plane.
    pub target_predicted: [f64; 2],
}

/// Errors at the final frame, mm.
#[derive(Clone, Debug)]
pub struct TargetErrors {
    /// Symmetric contour RMSE; `None` when the plane does not meet the predicted surface.
    pub contour_rmse_mm: Option<f64>,
    /// Whether the predicted contour runs around the camera.
    pub enclosure: Enclosure,
    /// Cuts that were compared, of the truth and of the prediction; unequal where they branch differently in the plane.
    pub cuts: [usize; 2],
    /// Displacement of the chosen vertex; `None` without a correspondence.
    pub target_mm: Option<f64>,
    /// Mean displacement over all contour vertices.
    pub mean_mm: Option<f64>,
    /// 95th percentile of the same.
    pub p95_mm: Option<f64>,
    /// How points were matched.
    pub correspondence: Correspondence,
    /// For plots.
    pub overlay: ContourOverlay,
}

/// Compares `predicted` with `truth` at the final frame. `stated` are the places of the truth's vertices on a predicted
/// surface with other faces, where they are known; `seed` chooses the target vertex.
///
/// `Ok(None)` when no contour of the truth encloses the camera: there is nothing to measure. Errors: `stated` is of
/// another number of vertices.
pub fn target_errors(
    truth: &TriangleMesh,
    predicted: &TriangleMesh,
    stated: Option<&[DVec3]>,
    world_from_camera: &DAffine3,
    seed: u64,
) -> Result<Option<TargetErrors>> {
    if let Some(places) = stated {
        correspondence::check_length(places, truth.vertices.len())?;
    }
    let plane = Plane::of_camera(world_from_camera);
    let (true_cuts, predicted_cuts) = (slice(truth, &plane), slice(predicted, &plane));
    let Some((own, Enclosure::Inside)) = around_camera(&true_cuts)? else { return Ok(None) };
    let other = around_camera(&predicted_cuts)?;
    // Where each vertex of the truth lies on the predicted surface.
    let same_topology = predicted.vertices.len() == truth.vertices.len() && predicted.faces == truth.faces;
    let (correspondence, places) = match stated {
        _ if same_topology => (Correspondence::Material, Some(predicted.vertices.as_slice())),
        Some(places) => (Correspondence::Stated, Some(places)),
        None => (Correspondence::Missing, None),
    };
    let true_contour = &true_cuts[own];
    let target = CounterRng::new(seed, Stage::Score, &[0]).index(true_contour.cuts.len());
    let to: Vec<DVec3> =
        places.map_or_else(Vec::new, |places| true_contour.cuts.iter().map(|c| c.position(places)).collect());
    let from = true_contour.cuts.iter().map(|c| c.position(&truth.vertices));
    let displacements: Vec<f64> = from.zip(&to).map(|(a, b)| a.distance(*b)).collect();
    let (mut contour_rmse_mm, mut cuts) = (None, [1, 0]);
    if let Some((contour, _)) = other {
        let mut own = ChosenCuts { cuts: &true_cuts, places: vec![own] };
        let mut other = ChosenCuts { cuts: &predicted_cuts, places: vec![contour] };
        // A surface of its own faces could be folded into every gap: of it the one contour counts.
        if same_topology {
            let (alone, alone_predicted) = (own.clone(), other.clone());
            join_counterparts(&mut own, &mut other);
            // So could one with the truth's faces, whose vertices are its own. Where branches part, each part is some of the
            // wall; and the part around the camera is the nearest of it somewhere.
            let is_folded =
                other.places.len() > MOST_PARTS * own.places.len() || other.nearest_share(true_contour) < LEAST_SHARE;
            if is_folded {
                (own, other) = (alone, alone_predicted);
            }
        }
        let [of_truth, predicted] = [&own, &other].map(|cuts| cuts.chosen().cloned().collect::<Vec<_>>());
        contour_rmse_mm = Some(symmetric_rmse(&of_truth, &predicted));
        cuts = [own.places.len(), other.places.len()];
    }
    let predicted_contour = other.map(|(contour, _)| &predicted_cuts[contour]);
    Ok(Some(TargetErrors {
        contour_rmse_mm,
        enclosure: other.map_or(Enclosure::Outside, |(_, enclosure)| enclosure),
        cuts,
        target_mm: displacements.get(target).copied(),
        mean_mm: statistics::mean(&displacements),
        p95_mm: quantile(&displacements, 0.95),
        correspondence,
        overlay: ContourOverlay {
            target_truth: true_contour.points[target],
            target_predicted: to.get(target).map_or(true_contour.points[target], |&p| plane.coordinates(p)),
            truth: true_contour.points.clone(),
            predicted_closed: predicted_contour.is_some_and(|c| c.closed),
            predicted: predicted_contour.map_or_else(Vec::new, |c| c.points.clone()),
        },
    }))
}

/// The cuts of a surface that are compared.
#[derive(Clone)]
struct ChosenCuts<'a> {
    /// All cuts of the surface.
    cuts: &'a [Polyline],
    /// Places of the chosen ones among them; the first is that around the camera.
    places: Vec<usize>,
}

impl ChosenCuts<'_> {
    fn chosen(&self) -> impl Iterator<Item = &Polyline> {
        self.places.iter().map(|&k| &self.cuts[k])
    }

    /// Adds every cut that is nearer to some sample of the chosen ones of `other` than the cuts that are in it.
    fn join_nearer_to(&mut self, other: &ChosenCuts<'_>) {
        let samples: Vec<[f64; 2]> = other.chosen().flat_map(resample).collect();
        let nearest = |&point: &[f64; 2]| {
            let distance = |k: usize| nearest_on(&self.cuts[k], point).1;
            let best = (0..self.cuts.len()).map(|k| (distance(k), k)).min_by(|a, b| a.0.total_cmp(&b.0))?;
            let is_nearer = self.places.iter().all(|&k| best.0 < distance(k));
            is_nearer.then_some(best.1)
        };
        let mut found: Vec<usize> = samples.par_iter().filter_map(nearest).collect();
        found.sort_unstable();
        found.dedup();
        self.places.extend(found);
    }

    /// Share of `contour` to which the first of the chosen ones is the nearest.
    fn nearest_share(&self, contour: &Polyline) -> f64 {
        let samples = resample(contour);
        let is_first = |&point: &[f64; 2]| {
            let distance = |k: usize| nearest_on(&self.cuts[k], point).1;
            self.places[1..].iter().all(|&k| distance(self.places[0]) <= distance(k))
        };
        samples.par_iter().filter(|&point| is_first(point)).count() as f64 / samples.len() as f64
    }
}

/// Joins the cuts of two surfaces until neither has one that comes nearer to what is chosen of the other: a cut that
/// joins may have a counterpart of its own.
fn join_counterparts(own: &mut ChosenCuts<'_>, other: &mut ChosenCuts<'_>) {
    loop {
        let before = own.places.len() + other.places.len();
        other.join_nearer_to(own);
        own.join_nearer_to(other);
        if own.places.len() + other.places.len() == before {
            return;
        }
    }
}

/// The place of the cut around the camera (0, 0), by OpenCV's contour analysis: the closed cut of least area that encloses it, or,
/// if none does, the cut that comes nearest to it.
fn around_camera(cuts: &[Polyline]) -> Result<Option<(usize, Enclosure)>> {
    let mut best: Option<(usize, f64)> = None;
    for (index, cut) in cuts.iter().enumerate().filter(|(_, cut)| cut.closed) {
        let contour = PlaneContour::new(&cut.points);
        if contour.encloses([0.0, 0.0])? {
            let area = contour.area()?;
            if best.is_none_or(|(_, least)| area < least) {
                best = Some((index, area));
            }
        }
    }
    if let Some((index, _)) = best {
        return Ok(Some((index, Enclosure::Inside)));
    }
    let distances = cuts.iter().map(|cut| nearest_on(cut, [0.0, 0.0]).1).enumerate();
    Ok(distances.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(index, _)| (index, Enclosure::Outside)))
}

/// `sqrt((mean d^2 from a to b + mean d^2 from b to a) / 2)`.
fn symmetric_rmse(a: &[Polyline], b: &[Polyline]) -> f64 {
    let one_way = |from: &[Polyline], to: &[Polyline]| {
        let samples: Vec<[f64; 2]> = from.iter().flat_map(resample).collect();
        let square = |&p: &[f64; 2]| to.iter().map(|line| nearest_on(line, p).1).fold(f64::INFINITY, f64::min).powi(2);
        let squares: Vec<f64> = samples.par_iter().map(square).collect();
        statistics::mean(&squares).unwrap_or(0.0)
    };
    (0.5 * (one_way(a, b) + one_way(b, a))).sqrt()
}

/// Segments of a polyline, the closing one included.
fn segments(line: &Polyline) -> impl Iterator<Item = ([f64; 2], [f64; 2])> + '_ {
    let points = &line.points;
    let closing = if line.closed { points.last().copied().zip(points.first().copied()) } else { None };
    points.windows(2).map(|w| (w[0], w[1])).chain(closing)
}

/// Points along a polyline at equal distances of at most [`SAMPLE_STEP_MM`] (more on very long ones).
fn resample(line: &Polyline) -> Vec<[f64; 2]> {
    let length: f64 = segments(line).map(|(a, b)| distance(a, b)).sum();
    let count = ((length / SAMPLE_STEP_MM).ceil() as usize).clamp(line.points.len().min(MAX_SAMPLES), MAX_SAMPLES);
    let step = length / count as f64;
    let mut samples = Vec::with_capacity(count);
    let mut walked = 0.0;
    for (a, b) in segments(line) {
        let here = distance(a, b);
        while samples.len() < count && samples.len() as f64 * step <= walked + here {
            let share = if here > 0.0 { (samples.len() as f64 * step - walked) / here } else { 0.0 };
            samples.push([a[0] + (b[0] - a[0]) * share, a[1] + (b[1] - a[1]) * share]);
        }
        walked += here;
    }
    samples
}

fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// Nearest point of a polyline to `point`, and its distance.
fn nearest_on(line: &Polyline, point: [f64; 2]) -> ([f64; 2], f64) {
    let mut best = (line.points[0], distance(line.points[0], point));
    for (a, b) in segments(line) {
        let along = [b[0] - a[0], b[1] - a[1]];
        let square = along[0] * along[0] + along[1] * along[1];
        let dot = (point[0] - a[0]) * along[0] + (point[1] - a[1]) * along[1];
        let share = if square > 0.0 { (dot / square).clamp(0.0, 1.0) } else { 0.0 };
        let foot = [a[0] + along[0] * share, a[1] + along[1] * share];
        let reach = distance(foot, point);
        if reach < best.1 {
            best = (foot, reach);
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::super::slice::tests::tube;
    use super::*;

    fn camera_at(x: f64, z: f64) -> DAffine3 {
        DAffine3::from_translation(DVec3::new(x, 0.0, z))
    }

    fn moved(mesh: &TriangleMesh, by: impl Fn(DVec3) -> DVec3) -> TriangleMesh {
        TriangleMesh { vertices: mesh.vertices.iter().map(|&v| by(v)).collect(), faces: mesh.faces.clone() }
    }

    #[test]
    fn truth_is_perfect() {
        let mesh = tube(5.0, 20.0, 64, 20);
        let found = target_errors(&mesh, &mesh, None, &camera_at(1.0, 7.3), 3).unwrap().unwrap();
        assert_eq!(found.contour_rmse_mm.map(|v| v < 1e-12), Some(true));
        assert_eq!((found.target_mm, found.p95_mm), (Some(0.0), Some(0.0)));
        assert_eq!((found.enclosure, found.correspondence), (Enclosure::Inside, Correspondence::Material));
    }

    #[test]
    fn a_wider_tube_is_off_by_the_difference_of_radii() {
        let mesh = tube(5.0, 20.0, 512, 20);
        let wide = tube(5.8, 20.0, 512, 20);
        let found = target_errors(&mesh, &wide, None, &camera_at(0.0, 7.3), 3).unwrap().unwrap();
        assert!((found.contour_rmse_mm.unwrap() - 0.8).abs() < 1e-3, "{:?}", found.contour_rmse_mm);
        assert!((found.target_mm.unwrap() - 0.8).abs() < 1e-3);
    }

    /// Motion along the airway leaves the contour where it is, but not the target.
    #[test]
    fn the_target_sees_motion_along_the_airway() {
        let mesh = tube(5.0, 20.0, 64, 20);
        let slid = moved(&mesh, |v| v + DVec3::new(0.0, 0.0, 2.5));
        let found = target_errors(&mesh, &slid, None, &camera_at(0.0, 10.2), 3).unwrap().unwrap();
        assert!(found.contour_rmse_mm.unwrap() < 1e-9);
        assert!((found.target_mm.unwrap() - 2.5).abs() < 1e-12 && (found.mean_mm.unwrap() - 2.5).abs() < 1e-12);
        assert!((found.p95_mm.unwrap() - 2.5).abs() < 1e-12);
    }

    /// Vertices that slide along the tube by (1 + cos) / 2 mm of their angle: half a millimetre in the mean, and one in
    /// twenty slides by more than at a fortieth of a turn.
    #[test]
    fn all_vertices_of_the_contour_count_and_the_target_is_drawn_among_them() {
        let mesh = tube(5.0, 20.0, 256, 8);
        let slid = moved(&mesh, |v| v + DVec3::Z * (0.5 + 0.1 * v.x));
        let found = |seed: u64| target_errors(&mesh, &slid, None, &camera_at(0.0, 7.3), seed).unwrap().unwrap();
        let p95 = 0.5 + 0.5 * (std::f64::consts::TAU / 40.0).cos();
        assert!((found(0).mean_mm.unwrap() - 0.5).abs() < 1e-3, "{:?}", found(0).mean_mm);
        assert!((found(0).p95_mm.unwrap() - p95).abs() < 2e-3, "{:?} {p95}", found(0).p95_mm);
        let drawn: Vec<f64> = (0..40).map(|seed| found(seed).target_mm.unwrap()).collect();
        // A deviation of 0.35 mm: 0.06 mm for the mean of forty.
        assert!((statistics::mean(&drawn).unwrap() - 0.5).abs() < 0.2, "{drawn:?}");
    }

    /// RMSE of a shifted circle against brute force over dense samples of both circles' own formulas.
    #[test]
    fn a_shifted_tube_equals_brute_force() {
        let mesh = tube(5.0, 20.0, 720, 8);
        let shift = 1.3;
        let shifted = moved(&mesh, |v| v + DVec3::new(shift, 0.0, 0.0));
        let found = target_errors(&mesh, &shifted, None, &camera_at(0.0, 7.3), 3).unwrap().unwrap();
        let squares: f64 = (0..10_000)
            .map(|i| f64::from(i) * std::f64::consts::TAU / 10_000.0)
            .map(|t| ((5.0 * t.cos() - shift).hypot(5.0 * t.sin()) - 5.0).powi(2))
            .sum();
        let expected = (squares / 10_000.0).sqrt();
        assert!((found.contour_rmse_mm.unwrap() - expected).abs() < 1e-3, "{:?} {expected}", found.contour_rmse_mm);
        assert!((found.target_mm.unwrap() - shift).abs() < 1e-12);
    }

    #[test]
    fn another_topology_has_a_target_only_where_it_says_which_point_is_which() {
        let mesh = tube(5.0, 20.0, 512, 20);
        let other = tube(6.0, 20.0, 300, 11);
        let found = target_errors(&mesh, &other, None, &camera_at(0.0, 7.3), 3).unwrap().unwrap();
        assert_eq!((found.correspondence, found.target_mm), (Correspondence::Missing, None));
        assert!((found.contour_rmse_mm.unwrap() - 1.0).abs() < 2e-3);
        let places: Vec<DVec3> = mesh.vertices.iter().map(|&v| v * DVec3::new(1.2, 1.2, 1.0)).collect();
        let found = target_errors(&mesh, &other, Some(&places), &camera_at(0.0, 7.3), 3).unwrap().unwrap();
        assert_eq!(found.correspondence, Correspondence::Stated);
        assert!((found.target_mm.unwrap() - 1.0).abs() < 2e-3);
        let refused = target_errors(&mesh, &other, Some(&places[1..]), &camera_at(0.0, 7.3), 3).unwrap_err();
        assert!(refused.to_string().contains("vertices, the sequence's meshes have"), "{refused}");
    }

    /// The order of the faces is part of them: permuted, they are other faces.
    #[test]
    fn permuted_faces_are_other_faces() {
        let mesh = tube(5.0, 20.0, 64, 20);
        let mut permuted = mesh.clone();
        permuted.faces.reverse();
        let found = target_errors(&mesh, &permuted, None, &camera_at(0.0, 7.3), 3).unwrap().unwrap();
        assert_eq!((found.correspondence, found.target_mm), (Correspondence::Missing, None));
    }

    /// Half a torus: a plane just above the inner wall of the bend cuts two legs, one just below it cuts both in one.
    #[test]
    fn contours_that_a_hairs_breadth_joins_do_not_jump() {
        let bend = moved(&tube(3.0, 1.0, 192, 192), |v| {
            let (along, ring) = (std::f64::consts::PI * (1.0 + v.z), 5.0 + v.x);
            DVec3::new(ring * along.cos(), v.y, ring * along.sin())
        });
        let camera = camera_at(5.0, -2.0);
        let by = |dz: f64| moved(&bend, |v| v + DVec3::new(0.0, 0.0, dz));
        let error = |truth: f64, predicted: f64| {
            let found = target_errors(&by(truth), &by(predicted), None, &camera, 3).unwrap().unwrap();
            assert_eq!(found.enclosure, Enclosure::Inside);
            (found.contour_rmse_mm.unwrap(), found.cuts)
        };
        // Parted and parted, joined and joined, and across: all are moved by a fifth of a millimetre.
        let (parted, joined) = (error(-0.1, -0.3), error(0.3, 0.1));
        assert_eq!((parted.1, joined.1), ([1, 1], [1, 1]));
        for (across, cuts) in [(error(0.1, -0.1), [1, 2]), (error(-0.1, 0.1), [2, 1])] {
            assert_eq!(across.1, cuts);
            assert!(across.0 < 3.0 * parted.0.max(joined.0), "{} of {} and {}", across.0, parted.0, joined.0);
            assert!(across.0 < 0.5, "{}", across.0);
        }
    }

    /// Copies of a tube of radius 3 mm beside each other, along x at `places`, in one mesh.
    fn tubes(places: impl IntoIterator<Item = f64>) -> TriangleMesh {
        let mut all = TriangleMesh { vertices: Vec::new(), faces: Vec::new() };
        for x in places {
            let one = moved(&tube(3.0, 20.0, 64, 20), |v| v + DVec3::X * x);
            let offset = all.vertices.len() as u32;
            all.vertices.extend(one.vertices);
            all.faces.extend(one.faces.iter().map(|f| f.map(|v| v + offset)));
        }
        all
    }

    /// A branch that joins because the prediction comes near it is compared with its own counterpart.
    #[test]
    fn a_cut_that_joins_brings_its_counterpart() {
        let (truth, predicted) = (tubes([0.0, 7.0]), tubes([1.2, 8.2]));
        let found = target_errors(&truth, &predicted, None, &camera_at(0.0, 7.3), 3).unwrap().unwrap();
        assert_eq!(found.cuts, [2, 2]);
        assert!(found.contour_rmse_mm.unwrap() < 1.2, "{:?}", found.contour_rmse_mm);
    }

    /// Vertices are a prediction's own even where its faces are the truth's: rings at every place where the wall might be
    /// are no answer.
    #[test]
    fn a_surface_that_is_cut_many_times_counts_by_its_contour_alone() {
        let truth = tubes((0..8).map(|k| 40.0 * f64::from(k)));
        // One ring around the camera, too small, and one for each guess.
        let guesses = (1..8).map(|k| 0.3 * f64::from(k - 3) + 0.1);
        let mut predicted = tubes(std::iter::once(0.0).chain(guesses));
        let first = truth.vertices.len() / 8;
        predicted.vertices[..first].iter_mut().for_each(|v| *v *= DVec3::new(0.2, 0.2, 1.0));
        let found = target_errors(&truth, &predicted, None, &camera_at(0.0, 7.3), 3).unwrap().unwrap();
        assert_eq!(found.cuts, [1, 1]);
        assert!(found.contour_rmse_mm.unwrap() > 2.3, "{:?}", found.contour_rmse_mm);
    }

    #[test]
    fn a_camera_outside_the_prediction_gets_the_nearest_contour() {
        let mesh = tube(5.0, 20.0, 64, 20);
        let far = moved(&mesh, |v| v + DVec3::new(14.0, 0.0, 0.0));
        let found = target_errors(&mesh, &far, None, &camera_at(0.0, 7.3), 3).unwrap().unwrap();
        assert_eq!(found.enclosure, Enclosure::Outside);
        assert!(found.contour_rmse_mm.unwrap() > 5.0);
        assert!((found.target_mm.unwrap() - 14.0).abs() < 1e-9);
    }

    #[test]
    fn without_a_contour_there_is_a_status_and_no_number() {
        let mesh = tube(5.0, 20.0, 64, 20);
        assert!(target_errors(&mesh, &mesh, None, &camera_at(9.0, 7.3), 3).unwrap().is_none());
        assert!(target_errors(&mesh, &mesh, None, &camera_at(0.0, 30.0), 3).unwrap().is_none());
        let gone = moved(&tube(5.0, 20.0, 32, 20), |v| v + DVec3::new(0.0, 0.0, 100.0));
        let found = target_errors(&mesh, &gone, None, &camera_at(0.0, 7.3), 3).unwrap().unwrap();
        assert_eq!((found.contour_rmse_mm, found.target_mm, found.mean_mm), (None, None, None));
    }

    #[test]
    fn of_nested_contours_the_inner_one_is_the_lumen() {
        let mut mesh = tube(9.0, 20.0, 64, 20);
        let inner = tube(5.0, 20.0, 64, 20);
        let offset = mesh.vertices.len() as u32;
        mesh.vertices.extend(&inner.vertices);
        mesh.faces.extend(inner.faces.iter().map(|f| f.map(|v| v + offset)));
        let found = target_errors(&mesh, &inner, None, &camera_at(0.0, 7.3), 3).unwrap().unwrap();
        assert!(found.contour_rmse_mm.unwrap() < 1e-9);
    }
}
