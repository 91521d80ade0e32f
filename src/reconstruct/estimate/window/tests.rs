use glam::{DAffine3, DVec2, DVec3, Vec3};

use nalgebra::{DMatrix, DVector};

use super::bounded::{BoundedStep, bounded};
use super::correction::Correction;
use super::drift::PoseDrift;
use super::keyframe_window::CONTRAST_RADIUS;
use super::keyframe_window::IncomingFrame;
use super::pair::{Assumed, OtherUnknowns, PairPoses, TargetFrame, carried, keyframe, point_residual};
use super::*;
use crate::base::{Camera, Image};
use crate::reconstruct::fitting::contrast::contrast_image;
use crate::reconstruct::geometry::breathing::BreathingMesh;
use crate::reconstruct::geometry::mesh_depth::{PixelRays, nearest_faces};
use crate::reconstruct::geometry::pyramid::PyramidLevel;
use crate::reconstruct::geometry::rigid::motion;
use crate::reconstruct::settings::{KeyframeSettings, NumberSource, Sourced};
use crate::splat::View;

const SIZE: usize = 64;
const AROUND: u32 = 48;
const RINGS: u32 = 61;
const RADIUS_MM: f64 = 6.0;

/// A tube along z that breathing narrows, shifts and draws towards the camera.
struct Tube {
    rest: Vec<[f32; 3]>,
    displacement: Vec<[f32; 3]>,
    faces: Vec<[u32; 3]>,
}

impl Tube {
    fn new() -> Tube {
        let place = |i: u32| {
            let (turn, z) = ((i % AROUND) as f64 / AROUND as f64 * std::f64::consts::TAU, (i / AROUND) as f64);
            DVec3::new(RADIUS_MM * turn.cos(), RADIUS_MM * turn.sin(), z)
        };
        let all = (0..AROUND * RINGS).map(place);
        let displaced = |p: DVec3| DVec3::new(3.0 - 0.2 * p.x, 2.0 - 0.2 * p.y, -3.0 - 0.05 * p.z);
        let faces = (0..AROUND * (RINGS - 1)).flat_map(|i| {
            let next = i / AROUND * AROUND + (i + 1) % AROUND;
            [[i, next, i + AROUND], [next, next + AROUND, i + AROUND]]
        });
        Tube {
            rest: all.clone().map(|p| p.as_vec3().to_array()).collect(),
            displacement: all.map(|p| displaced(p).as_vec3().to_array()).collect(),
            faces: faces.collect(),
        }
    }

    fn mesh(&self) -> BreathingMesh<'_> {
        BreathingMesh { rest: &self.rest, displacement: &self.displacement, faces: &self.faces }
    }

    /// The image of a camera at `z` mm at `phase`: a pattern fixed to the rest shape, under a light that is not.
    fn film(&self, z: f64, phase: f64) -> (View, Image<f32>) {
        let camera = Camera::pinhole(SIZE as u32, SIZE as u32, 1.7);
        let view = View::new(camera, DAffine3::from_translation(DVec3::new(0.8, -0.5, z)));
        let all: Vec<u32> = (0..self.faces.len() as u32).collect();
        let mesh = self.mesh();
        let nearest = nearest_faces(&view, &PixelRays::new(&camera), &mesh.at(phase), &self.faces, &all);
        let mut image = Image::filled(SIZE, SIZE, 3, 0.02f32);
        for (i, &(depth, face)) in nearest.iter().enumerate().filter(|(_, (depth, _))| *depth > 0.0) {
            let pixel = DVec2::new((i % SIZE) as f64 + 0.5, (i / SIZE) as f64 + 0.5);
            let direction = camera.direction(pixel);
            let eye = view.camera_from_world.inverse().translation;
            let p = carried([eye, direction / direction.z], self.faces[face as usize], phase, 0.0, mesh).unwrap().place;
            let turn = p.y.atan2(p.x);
            let pattern = (5.0 * turn).sin() * (1.7 * p.z).cos() + (3.0 * turn + 0.8 * p.z).sin();
            let light = 8.0 / (4.0 + depth as f64);
            (0..3).for_each(|c| image.data[3 * i + c] = (light * (0.5 + 0.1 * pattern)) as f32);
        }
        (view, image)
    }
}

fn ours<T>(value: T) -> Sourced<T> {
    Sourced { value, source: NumberSource::Ours, why: String::new() }
}

fn window_with(options: WindowOptions) -> KeyframeWindow {
    let memory = if options.drift.is_some() { 1.0 } else { 0.7 };
    let settings = KeyframeSettings { keyframes: ours(8), memory: ours(memory), prior_deviation: ours(0.05) };
    KeyframeWindow::new(&settings, options).expect("there are keyframes")
}

fn window_of(drift: Option<PoseDrift>) -> KeyframeWindow {
    window_with(WindowOptions { drift, ..WindowOptions::default() })
}

/// Errors of the window over a film in which every expected phase is `off` from the true one.
fn errors(off: f64) -> Vec<f64> {
    let tube = Tube::new();
    let all: Vec<u32> = (0..tube.faces.len() as u32).collect();
    let mut window = window_of(None);
    (0..40)
        .map(|frame| {
            let truth = 0.5 + 0.3 * (frame as f64 * 0.15).sin();
            let (view, image) = tube.film(2.0 + 0.3 * frame as f64, truth);
            let frame = PyramidLevel { view, image, weights: Vec::new() };
            window.place(&frame, tube.mesh(), &all, truth + off, |_| None).phase - truth
        })
        .collect()
}

#[test]
fn phases_that_are_expected_in_the_wrong_place_are_mended_by_parallax() {
    for off in [0.06, -0.06] {
        let errors = errors(off);
        assert!((errors[0] - off).abs() < 1e-3, "one frame alone has no parallax: {}", errors[0]);
        let late = errors[30..].iter().map(|e| e.abs()).fold(0.0, f64::max);
        assert!(late < 0.012, "{errors:.4?}");
    }
}

/// A last keyframe with a wrong phase misleads the search: the answer must be the one that all keyframes agree with,
/// not the one next to the result of the search.
#[test]
fn of_two_answers_all_keyframes_choose() {
    let tube = Tube::new();
    let all: Vec<u32> = (0..tube.faces.len() as u32).collect();
    let mut window = window_of(None);
    let truth = |frame: usize| 0.5 + 0.3 * (frame as f64 * 0.15).sin();
    let film = |frame: usize| tube.film(2.0 + 0.3 * frame as f64, truth(frame));
    for frame in 0..12 {
        let (view, image) = film(frame);
        let level = PyramidLevel { view, image, weights: Vec::new() };
        window.place(&level, tube.mesh(), &all, truth(frame), |_| None);
    }
    let last = window.unknowns.len() - 1;
    window.unknowns[last] += 0.06;
    let (view, image) = film(12);
    let contrast = contrast_image(&image, &[], CONTRAST_RADIUS);
    let expected = truth(12);
    let rays = PixelRays::new(&view.camera);
    let nearest = nearest_faces(&view, &rays, &tube.mesh().at(expected), &tube.faces, &all);
    let incoming = IncomingFrame { given: &view, contrast: &contrast, nearest: &nearest };
    let astray = window.nearest_fit(&incoming, &window.unknowns.clone().push(expected), tube.mesh());
    let level = PyramidLevel { view, image, weights: Vec::new() };
    let placed = window.place(&level, tube.mesh(), &all, expected, |_| None);
    assert!((astray - expected).abs() > 0.03, "the search is not sent astray: {astray}");
    assert!((placed.phase - expected).abs() < 0.012, "{} instead of {expected}", placed.phase);
}

/// A phase that something else measures draws a frame that becomes a keyframe to it, by the way that the wall has moved
/// over the image; other frames are not measured.
#[test]
fn a_measured_phase_draws_a_keyframe_by_the_way_over_the_image() {
    let tube = Tube::new();
    let all: Vec<u32> = (0..tube.faces.len() as u32).collect();
    let truth = |frame: f64| 0.5 + 0.3 * (frame * 0.15).sin();
    // The frames 0 to 15, then `last`, and how many of them were measured.
    let placed = |last: f64, pull: Option<f64>| {
        let mut window = window_of(None);
        let mut count = 0;
        let mut place = |frame: f64, measured: Option<PhaseMeasurement>| {
            let (view, image) = tube.film(2.0 + 0.3 * frame, truth(frame));
            let level = PyramidLevel { view, image, weights: Vec::new() };
            window.place(&level, tube.mesh(), &all, truth(frame), |phase| {
                assert!((phase - truth(frame)).abs() < 0.02, "{phase} by the keyframes");
                count += 1;
                measured
            })
        };
        (0..16).for_each(|frame| {
            place(f64::from(frame), None);
        });
        let placement = place(last, pull.map(|pull| PhaseMeasurement { phase: truth(last) + 0.02, pull }));
        (placement, count)
    };
    let share = |last: f64, pull: f64| {
        let ((alone, asked), (drawn, _)) = (placed(last, None), placed(last, Some(pull)));
        assert!((5..10).contains(&asked), "{asked} of 17 frames are measured");
        assert!(drawn.deviation <= alone.deviation);
        (drawn.phase - alone.phase) / (truth(last) + 0.02 - alone.phase)
    };
    // So far from the frame before, it shows enough new wall.
    let [gentle, firm, whole] = [1.0, 10.0, 1e4].map(|pull| share(19.0, pull));
    assert!(gentle > 0.0 && firm > 3.0 * gentle && firm < 0.9, "{gentle} {firm}");
    assert!((whole - 1.0).abs() < 0.01, "{whole}");
    let nearer = share(18.0, 10.0);
    assert!(nearer > 0.0 && nearer < 0.9 * firm, "{nearer} {firm}");
}

/// The search before the first step finds the nearest of the tried phases from either side, and returns a correct
/// expected phase unchanged to the last bit.
#[test]
fn a_phase_that_is_expected_in_the_wrong_place_is_searched_for() {
    let tube = Tube::new();
    let all: Vec<u32> = (0..tube.faces.len() as u32).collect();
    let mut window = window_of(None);
    let (view, image) = tube.film(2.0, 0.5);
    window.place(&PyramidLevel { view, image, weights: Vec::new() }, tube.mesh(), &all, 0.5, |_| None);
    const TRUTH: f64 = 0.62;
    let (view, image) = tube.film(2.6, TRUTH);
    let contrast = contrast_image(&image, &[], CONTRAST_RADIUS);
    let search_from = |expected: f64| {
        let nearest = nearest_faces(&view, &PixelRays::new(&view.camera), &tube.mesh().at(expected), &tube.faces, &all);
        let incoming = IncomingFrame { given: &view, contrast: &contrast, nearest: &nearest };
        window.nearest_fit(&incoming, &window.unknowns.clone().push(expected), tube.mesh())
    };
    for off in [-0.055, -0.03, 0.03, 0.055] {
        let found = search_from(TRUTH + off);
        assert!((found - TRUTH).abs() < 0.011, "{off}: {found}");
    }
    assert_eq!(search_from(TRUTH), TRUTH);
    // Beyond the range of the search, the best phase within it is taken.
    assert!((search_from(TRUTH + 0.12) - TRUTH - 0.06).abs() < 0.011);
}

#[test]
fn the_derivatives_of_a_carried_point_are_those_of_its_place() {
    let tube = Tube::new();
    let mesh = tube.mesh();
    let (view, _) = tube.film(3.0, 0.4);
    let all: Vec<u32> = (0..tube.faces.len() as u32).collect();
    let nearest = nearest_faces(&view, &PixelRays::new(&view.camera), &mesh.at(0.4), &tube.faces, &all);
    let eye = view.camera_from_world.inverse().translation;
    for i in (7..SIZE * SIZE).step_by(131).filter(|&i| nearest[i].0 > 0.0) {
        let pixel = DVec2::new((i % SIZE) as f64 + 0.5, (i / SIZE) as f64 + 0.5);
        let face = tube.faces[nearest[i].1 as usize];
        let ray = [eye, view.camera.direction(pixel)];
        let at = |first: f64, second: f64| carried(ray, face, first, second, mesh).unwrap();
        let found = at(0.4, 0.7);
        let ([by_first, by_second], by_offset) = (found.by_phase(), found.by_offset(0.4, 0.7));
        let h = 1e-5;
        let numeric_first = (at(0.4 + h, 0.7).place - at(0.4 - h, 0.7).place) / (2.0 * h);
        let numeric_second = (at(0.4, 0.7 + h).place - at(0.4, 0.7 - h).place) / (2.0 * h);
        assert!((by_first - numeric_first).length() < 1e-5 * (1.0 + by_first.length()), "{by_first} {numeric_first}");
        assert!((by_second - numeric_second).length() < 1e-5 * (1.0 + by_second.length()));
        assert!((found.shares.iter().sum::<f64>() - 1.0).abs() < 1e-12);
        for axis in 0..3 {
            let h = 0.01;
            let offset = |h: f32| {
                let mut displacement = tube.displacement.clone();
                displacement.iter_mut().for_each(|d| d[axis] += h);
                carried(ray, face, 0.4, 0.7, BreathingMesh { displacement: &displacement, ..mesh }).unwrap().place
            };
            let numeric = (offset(h) - offset(-h)) / (2.0 * h as f64);
            assert!((by_offset.col(axis) - numeric).length() < 2e-3, "{} {numeric}", by_offset.col(axis));
        }
    }
}

/// A registration with a bell-shaped error of 1 mm to one side, while the scope advances and the tube breathes:
/// root mean square of the remaining error around the scope at the end, mm, and mean error of the last phases;
/// without a correction and with one.
#[test]
fn an_error_of_the_registration_is_seen_by_parallax() {
    let tube = Tube::new();
    let all: Vec<u32> = (0..tube.faces.len() as u32).collect();
    let middle = DVec3::new(0.0, 0.0, 22.0);
    let bell = |p: &[f32; 3]| (-0.5 * Vec3::from(*p).as_dvec3().distance_squared(middle) / 400.0).exp() as f32;
    let mut given = tube.displacement.clone();
    given.iter_mut().zip(&tube.rest).for_each(|(d, p)| d[0] += bell(p));
    let breath = |frame: usize| 0.55 + 0.3 * (frame as f64 * 0.15).sin();
    let films: Vec<_> = (0..40).map(|frame| tube.film(2.0 + 0.3 * frame as f64, breath(frame))).collect();
    let poses: Vec<DAffine3> = films.iter().map(|(view, _)| view.camera_from_world.inverse()).collect();
    let run = |rank: usize| {
        let correction = Correction::new(&tube.rest, &poses, rank, 20.0, 0.6);
        let mut window = window_with(WindowOptions { correction, ..WindowOptions::default() });
        let mut wrong = Vec::new();
        for (frame, (view, image)) in films.iter().enumerate() {
            let level = PyramidLevel { view: *view, image: image.clone(), weights: Vec::new() };
            let mesh = BreathingMesh { displacement: &given, ..tube.mesh() };
            let placed = window.place(&level, mesh, &all, breath(frame), |_| None);
            wrong.push((placed.phase - breath(frame)).abs());
        }
        let found = window.corrected(&given).unwrap_or_else(|| given.clone());
        let near =
            tube.rest.iter().zip(found.iter().zip(&tube.displacement)).filter(|(p, _)| (17.0..35.0).contains(&p[2]));
        let squares: Vec<f64> =
            near.map(|(_, (a, b))| Vec3::from(*a).distance_squared(Vec3::from(*b)) as f64).collect();
        let rms = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
        (rms, wrong[20..].iter().sum::<f64>() / 20.0)
    };
    let (without, with) = (run(0), run(2));
    println!("without {without:.3?}, with {with:.3?}");
    assert!(without.0 > 0.7);
    assert!(with.0 < 0.5 * without.0 && with.1 < without.1);
}

#[test]
fn the_derivatives_of_a_path_are_those_of_its_pixel() {
    let tube = Tube::new();
    let all: Vec<u32> = (0..tube.faces.len() as u32).collect();
    let bell: Vec<f32> = tube.rest.iter().map(|p| (-0.01 * (p[2] - 20.0).powi(2)).exp()).collect();
    let weights: [&[f32]; 1] = [&bell];
    let (key_view, key_image) = tube.film(3.0, 0.4);
    let (view, image) = tube.film(5.0, 0.7);
    let rays = PixelRays::new(&view.camera);
    let nearest = |view: &View, phase: f64| nearest_faces(view, &rays, &tube.mesh().at(phase), &tube.faces, &all);
    let (contrasts, depths) = (
        [&key_image, &image].map(|i| contrast_image(i, &[], CONTRAST_RADIUS)),
        [nearest(&key_view, 0.4), nearest(&view, 0.7)],
    );
    let key = keyframe(
        &TargetFrame { view: &key_view, contrast_image: &contrasts[0], nearest: &depths[0] },
        &key_view,
        1.0,
        &tube.faces,
    );
    let elapsed_s = 0.7;
    // Correction of the poses, its change per second, offset, and both phases.
    let start = [0.02, -0.01, 0.03, 0.5, -0.3, 0.4, 0.01, 0.0, -0.01, 0.1, 0.2, -0.1, 0.1, 0.2, 0.3, 0.4, 0.7];
    let correction = |at: &[f64], ago_s: f64| -> [f64; 6] { std::array::from_fn(|k| at[k] - ago_s * at[6 + k]) };
    let residual_at = |at: &[f64], point: usize| {
        let moved = |view: &View, ago_s: f64| motion(correction(at, ago_s)) * view.camera_from_world;
        let mut displacement = tube.displacement.clone();
        displacement.iter_mut().zip(&bell).for_each(|(d, w)| (0..3).for_each(|k| d[k] += w * at[12 + k] as f32));
        let mesh = BreathingMesh { displacement: &displacement, ..tube.mesh() };
        let now = View { camera_from_world: moved(&view, 0.0), ..view };
        let target = TargetFrame { view: &now, contrast_image: &contrasts[1], nearest: &depths[1] };
        let key_from_world = moved(&key_view, elapsed_s);
        let poses = Some(PairPoses { corrections: [correction(at, elapsed_s), correction(at, 0.0)], elapsed_s });
        let assumed = Assumed { first: at[15], key_from_world, second: at[16], mesh };
        point_residual(&key.points[point], &target, &assumed, &OtherUnknowns { poses, weights: &weights })
    };
    let mut compared = 0;
    for point in (0..key.points.len()).step_by(7) {
        let Some(here) = residual_at(&start, point) else { continue };
        let analytic: Vec<DVec2> = here.by_others.iter().chain(&here.by_phase).copied().collect();
        for (k, analytic) in analytic.iter().enumerate() {
            // Offsets are kept in single precision.
            let h = if (12..15).contains(&k) { 1e-2 } else { 1e-4 };
            let side = |sign: f64| {
                let mut at = start;
                at[k] += sign * h;
                residual_at(&at, point).map(|found| found.path)
            };
            let (Some(plus), Some(minus)) = (side(1.0), side(-1.0)) else { continue };
            let numeric = (plus - minus) / (2.0 * h);
            assert!((*analytic - numeric).length() < 5e-3 * numeric.length() + 5e-3, "{k}: {analytic} {numeric}");
            compared += 1;
        }
    }
    assert!(compared > 200, "{compared}");
}

/// Against brute force: hold every subset of three phases at either end, and of the solutions within 0..1 take the
/// one with the least cost.
#[test]
fn a_step_within_the_breath_is_the_best_of_all_such() {
    use crate::base::random::{CounterRng, Stage};
    const FIRST: usize = 2;
    const COUNT: usize = 5;
    let mut held = 0;
    for seed in 0..200 {
        let mut rng = CounterRng::new(seed, Stage::Test, &[]);
        let root = DMatrix::from_fn(COUNT, COUNT, |_, _| rng.normal());
        let curvature: DMatrix<f64> = &root * root.transpose() + 0.05 * DMatrix::identity(COUNT, COUNT);
        let gradient = DVector::from_fn(COUNT, |_, _| 3.0 * rng.normal());
        let at = DVector::from_fn(COUNT, |_, _| rng.uniform());
        let cost = |step: &DVector<f64>| 0.5 * step.dot(&(&curvature * step)) - gradient.dot(step);
        let within = |step: &DVector<f64>| (FIRST..COUNT).all(|k| (-1e-9..=1.0 + 1e-9).contains(&(at[k] + step[k])));
        let mut least = f64::INFINITY;
        for choice in 0..3usize.pow(3) {
            let end = |k: usize| (k >= FIRST).then(|| choice / 3usize.pow((k - FIRST) as u32) % 3);
            let (mut matrix, mut right) = (curvature.clone(), gradient.clone());
            for k in 0..COUNT {
                if let Some(side @ 0..=1) = end(k) {
                    matrix.row_mut(k).fill(0.0);
                    matrix[(k, k)] = 1.0;
                    right[k] = side as f64 - at[k];
                }
            }
            let step = matrix.lu().solve(&right).unwrap();
            least = if within(&step) { least.min(cost(&step)) } else { least };
        }
        let BoundedStep { step, push } = bounded(&curvature, &gradient, &at, FIRST).unwrap();
        assert!(within(&step) && (cost(&step) - least).abs() < 1e-9 * (1.0 + least.abs()), "{seed}: {step}");
        held += push.iter().filter(|p| **p != 0.0).count();
    }
    assert!(held > 100, "{held} phases were held in all");
}

/// Poses of a tracker that drifts across the tube and turns, by 1.6 mm and 2.3 degrees over the film. The start is
/// known.
#[test]
fn a_drift_of_the_given_poses_is_followed() {
    let tube = Tube::new();
    let all: Vec<u32> = (0..tube.faces.len() as u32).collect();
    let drift = |time_s: f64| [0.01, -0.004, 0.0, 0.35, 0.2, 0.0].map(|rate| rate * time_s);
    let mut window = window_of(Some(PoseDrift::new([0.01, 0.4], 60.0, 1.0)));
    let mut wrong = Vec::new();
    for frame in 0..40 {
        let time_s = 0.1 * frame as f64;
        let phase = 0.5 + 0.3 * (1.5 * time_s).sin();
        let (view, image) = tube.film(2.0 + 3.0 * time_s, phase);
        let given = View { camera_from_world: motion(drift(time_s)).inverse() * view.camera_from_world, ..view };
        window.advance_to(time_s);
        let level = PyramidLevel { view: given, image, weights: Vec::new() };
        let placed = window.place(&level, tube.mesh(), &all, phase, |_| None);
        let off = |from: usize, to: usize| {
            (from..to).map(|k| (placed.pose[k] - drift(time_s)[k]).powi(2)).sum::<f64>().sqrt()
        };
        wrong.push([off(0, 3), off(3, 6), (placed.phase - phase).abs()]);
    }
    println!("{wrong:.3?}");
    let worst = wrong[20..].iter().fold([0.0f64; 3], |w, e| [0, 1, 2].map(|k| w[k].max(e[k])));
    assert!(worst[0] < 0.03 && worst[1] < 0.35 && worst[2] < 0.08, "{worst:.3?}");
}

#[test]
fn contrast_knows_no_gain_and_no_hidden_pixels() {
    let image = Image {
        width: 40,
        height: 30,
        channels: 3,
        data: (0..3600).map(|i| 0.5 + 0.3 * (i as f32 * 0.37).sin()).collect(),
    };
    let weights: Vec<f32> = (0..1200).map(|i| f32::from(u8::from(i % 40 < 30))).collect();
    let mut other = image.clone();
    (0..1200).filter(|i| i % 40 >= 30).for_each(|i| other.data[3 * i] = 9.0);
    let (a, b) = (contrast_image(&image, &weights, CONTRAST_RADIUS), contrast_image(&other, &weights, CONTRAST_RADIUS));
    assert_eq!(a.contrast.data, b.contrast.data);
    let flat = contrast_image(&Image::filled(40, 30, 3, 0.6), &[], CONTRAST_RADIUS);
    assert!(flat.contrast.data.iter().all(|v| v.abs() < 1e-5));
}
