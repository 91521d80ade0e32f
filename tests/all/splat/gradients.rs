//! Analytic gradients against central differences (f64), f32 kernels against f64, forward mode against backward.

use glam::{DAffine3, DQuat, DVec3};
use respire_bench::splat::{
    Filter, Footprint, Gaussians, Gradients, ImageGradient, Rasterizer, Settings, Shape, SplatKernels, View, Wanted,
};

use super::forward::available;
use super::numpy_normal::Numpy;
use super::scenes::{Kind, Lens, Weights, flat, random, relative, tube, view, wide};
use crate::skip::shared;

const STEP: f64 = 1e-6;

fn loss(scene: &Gaussians<f64>, view: &View, settings: &Settings, weights: &Weights<f64>) -> f64 {
    let mut rasterizer = Rasterizer::<f64>::new();
    weights.loss(rasterizer.render(scene, view, settings, None).unwrap())
}

/// Central differences over every value that `entry` reaches.
fn differences(n: usize, mut at: impl FnMut(usize, f64) -> f64) -> Vec<f64> {
    (0..n).map(|k| (at(k, STEP) - at(k, -STEP)) / (2.0 * STEP)).collect()
}

/// Every group of gradients by name, in double.
fn groups<T: SplatKernels>(g: &Gradients<T>) -> Vec<(&'static str, Vec<f64>)> {
    let axes: Vec<f64> = g.axes.iter().flatten().flatten().map(|v| v.to_f64()).collect();
    [
        ("positions", flat(&g.positions)),
        ("rotations", flat(&g.rotations)),
        ("scales", flat(&g.scales)),
        ("axes", axes),
        ("opacities", wide(&g.opacities)),
        ("sh", wide(&g.sh)),
        ("pose", g.pose.to_vec()),
        ("gain", g.gain.to_vec()),
        ("lens", if g.lens == [0.0; 4] { Vec::new() } else { g.lens.to_vec() }),
    ]
    .into_iter()
    .filter(|(_, values)| !values.is_empty())
    .collect()
}

/// The value number `k` of a group.
fn entry<'a>(scene: &'a mut Gaussians<f64>, group: &str, k: usize) -> &'a mut f64 {
    match (group, &mut scene.shape) {
        ("positions", _) => &mut scene.positions[k / 3][k % 3],
        ("opacities", _) => &mut scene.opacities[k],
        ("sh", _) => &mut scene.sh[k],
        ("rotations", Shape::Ellipsoids { rotations, .. }) => &mut rotations[k / 4][k % 4],
        ("scales", Shape::Ellipsoids { scales, .. }) => &mut scales[k / 3][k % 3],
        ("axes", Shape::Discs { axes }) => &mut axes[k / 6][k / 3 % 2][k % 3],
        _ => unreachable!("no such group"),
    }
}

/// `exp(xi) camera_from_world` for a step along one of the six directions.
pub fn moved(view: &View, k: usize, step: f64) -> View {
    let axis = [DVec3::X, DVec3::Y, DVec3::Z][k % 3] * step;
    let motion =
        if k < 3 { DAffine3::from_quat(DQuat::from_scaled_axis(axis)) } else { DAffine3::from_translation(axis) };
    View { camera: view.camera, camera_from_world: motion * view.camera_from_world }
}

fn settings() -> Settings {
    Settings { background: [0.2, 0.5, 0.1], gain: [0.8, 1.2, 1.1], ..Settings::default() }
}

#[test]
fn every_group_equals_central_differences() {
    for (seed, kind, lens, degree) in [
        (11, Kind::Ellipsoids, Lens::Pinhole, 3),
        (12, Kind::Discs, Lens::Pinhole, 1),
        (13, Kind::Discs, Lens::Fisheye, 2),
        (14, Kind::Ellipsoids, Lens::Fisheye, 0),
    ] {
        let scene = random(25, kind, degree, seed);
        let (view, settings, weights) = (view(lens), settings(), Weights::new(43 * 29, seed));
        let mut rasterizer = Rasterizer::<f64>::new();
        rasterizer.render(&scene, &view, &settings, None).unwrap();
        let gradients = rasterizer.backward(&scene, &weights.gradient(), Wanted::ALL).unwrap();
        for (name, analytic) in groups(gradients) {
            let numeric = differences(analytic.len(), |k, step| match name {
                "pose" => loss(&scene, &moved(&view, k, step), &settings, &weights),
                "gain" => {
                    let mut settings = settings;
                    settings.gain[k] += step;
                    loss(&scene, &view, &settings, &weights)
                }
                _ => {
                    let mut scene = scene.clone();
                    *entry(&mut scene, name, k) += step;
                    loss(&scene, &view, &settings, &weights)
                }
            });
            let error = relative(&analytic, &numeric);
            assert!(error <= 1e-6, "scene {seed}: {name} off by {error:e}");
        }
    }
}

/// Worst group of the f32 gradients of every kernel against the f64 analytic ones.
fn f32_errors(scene: &Gaussians<f32>, view: &View, seed: u64, settings: Settings) -> Vec<(String, f64)> {
    let pixels = (view.camera.width * view.camera.height) as usize;
    let mut exact = Rasterizer::<f64>::new();
    let scene64 = scene.cast::<f64>();
    exact.render(&scene64, view, &settings, None).unwrap();
    let weights = Weights::<f64>::new(pixels, seed);
    let exact_fisheye = settings.footprint == Footprint::Disc && view.camera.fisheye.is_some();
    let lens = if exact_fisheye { Wanted::NONE } else { Wanted::LENS };
    let truth = groups(exact.backward(&scene64, &weights.gradient(), Wanted::ALL | lens).unwrap());
    let weights = Weights::<f32>::new(pixels, seed);
    let mut errors = Vec::new();
    for isa in available() {
        let mut rasterizer = Rasterizer::<f32>::with_isa(isa).unwrap();
        rasterizer.render(scene, view, &settings, None).unwrap();
        let mut found = groups(rasterizer.backward(scene, &weights.gradient(), Wanted::ALL).unwrap());
        if !exact_fisheye {
            let lens = rasterizer.backward(scene, &weights.gradient(), Wanted::LENS).unwrap().lens;
            found.push(("lens", lens.to_vec()));
        }
        assert_eq!(found.len(), truth.len());
        for ((name, found), (_, truth)) in found.iter().zip(&truth) {
            errors.push((format!("{isa} {name}"), relative(found, truth)));
        }
    }
    errors
}

#[test]
fn single_precision_equals_double() {
    for (seed, kind, lens, degree) in [
        (21, Kind::Ellipsoids, Lens::Pinhole, 2),
        (22, Kind::Discs, Lens::Fisheye, 2),
        (23, Kind::Discs, Lens::Pinhole, 1),
        (24, Kind::Discs, Lens::Pinhole, 0),
        (25, Kind::Ellipsoids, Lens::Pinhole, 3),
        (26, Kind::Discs, Lens::Pinhole, 3),
        (27, Kind::Ellipsoids, Lens::Pinhole, 0),
        (28, Kind::Ellipsoids, Lens::Pinhole, 1),
        (29, Kind::Ellipsoids, Lens::Fisheye, 3),
        (30, Kind::Discs, Lens::Fisheye, 0),
        (31, Kind::Ellipsoids, Lens::Fisheye, 1),
    ] {
        let scene = random(60, kind, degree, seed).cast::<f32>();
        for (name, error) in f32_errors(&scene, &view(lens), seed, settings()) {
            assert!(error <= 1e-4, "scene {seed}: {name} off by {error:e}");
        }
    }
}

/// Beyond EWA with its fixed filter; intrinsics too.
#[test]
fn single_precision_equals_double_in_every_mode() {
    let compensated = Settings { filter: Filter::Compensate, ..settings() };
    let discs = Settings { footprint: Footprint::Disc, ..settings() };
    for (seed, kind, lens, settings) in [
        (41, Kind::Ellipsoids, Lens::Pinhole, compensated),
        (42, Kind::Discs, Lens::Fisheye, compensated),
        (43, Kind::Discs, Lens::Pinhole, discs),
        (44, Kind::Ellipsoids, Lens::Pinhole, discs),
        (45, Kind::Discs, Lens::Fisheye, discs),
    ] {
        let scene = random(60, kind, 1, seed).cast::<f32>();
        for (name, error) in f32_errors(&scene, &view(lens), seed, settings) {
            println!("scene {seed}: {name} {error:.1e}");
            assert!(error <= 5e-4, "scene {seed}: {name} off by {error:e}");
        }
    }
}

#[test]
fn every_mode_on_the_reference_scene() {
    let Some((tube, view)) = tube("tube_20k.npz", 256) else { return };
    let compensated = Settings { filter: Filter::Compensate, ..settings() };
    let discs = Settings { footprint: Footprint::Disc, ..settings() };
    for (mode, settings) in [("compensated", compensated), ("discs", discs)] {
        for (name, error) in f32_errors(&tube, &view, 9, settings) {
            println!("{mode}: {name} {error:.1e}");
            assert!(error <= 1e-3, "{mode}: {name} off by {error:e}");
        }
    }
}

/// Norms of the gradients of the fixed loss against those of a double-precision program that is not ours.
#[test]
fn the_reference_scenes_give_the_reference_gradient_norms() {
    let Some(path) = shared("reference/splat/ref_expected.json") else { return };
    let expected: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
    for (file, key, side) in [
        ("tube_20k.npz", "tube_20k_256", 256),
        ("tube_20k.npz", "tube_20k_400", 400),
        ("tube_100k.npz", "tube_100k_256", 256),
        ("tube_100k.npz", "tube_100k_400", 400),
    ] {
        let Some((tube, view)) = tube(file, side) else { return };
        let mut numpy = Numpy::seeded_77();
        let color: Vec<f32> = (0..3 * side * side).map(|_| numpy.normal() as f32).collect();
        let settings = Settings::default();
        let mut rasterizer = Rasterizer::<f32>::new();
        rasterizer.render(&tube, &view, &settings, None).unwrap();
        let image = ImageGradient { color: &color, ..ImageGradient::default() };
        let single = groups(rasterizer.backward(&tube, &image, Wanted::ALL).unwrap());
        let mut found = vec![("f32", single)];
        if side == 256 {
            let (tube, color) = (tube.cast::<f64>(), wide(&color));
            let mut rasterizer = Rasterizer::<f64>::new();
            rasterizer.render(&tube, &view, &settings, None).unwrap();
            let image = ImageGradient { color: &color, ..ImageGradient::default() };
            found.push(("f64", groups(rasterizer.backward(&tube, &image, Wanted::ALL).unwrap())));
        }
        for (kind, groups) in found {
            for (group, values) in groups {
                let name = match group {
                    "positions" => "means",
                    "rotations" => "quats",
                    other => other,
                };
                let Some(truth) = expected[key][format!("grad_l2_{name}")].as_f64() else { continue };
                let norm = values.iter().map(|v| v * v).sum::<f64>().sqrt();
                println!("{key} {kind} {name}: {norm:.4}, {:.1e} from {truth:.4}", norm / truth - 1.0);
                assert!((norm / truth - 1.0).abs() < 2e-4, "{key} {kind} {name}: {norm} is not {truth}");
            }
        }
    }
}

/// With 1.3 million blended pairs some alphas cross 1/255 by rounding; bound: better than the best of the peers
/// (`../shared/reference/splat/PEERS.md`).
#[test]
fn single_precision_equals_double_on_the_reference_scene() {
    for (file, side, fisheye) in [
        ("tube_20k.npz", 256, None),
        ("tube_100k.npz", 400, None),
        ("tube_20k.npz", 256, Some([-0.03, 0.002, 0.0, 0.0])),
    ] {
        let Some((tube, mut view)) = tube(file, side) else { return };
        view.camera.fisheye = fisheye;
        for (name, error) in f32_errors(&tube, &view, 9, settings()) {
            println!("{file} {fisheye:?} {name}: {error:.1e}");
            assert!(error <= 5e-4, "{file} {fisheye:?} {name} off by {error:e}");
        }
    }
}

#[test]
fn a_wanted_group_does_not_depend_on_the_others() {
    let scene = random(40, Kind::Discs, 1, 31).cast::<f32>();
    let weights = Weights::<f32>::new(43 * 29, 31);
    let mut rasterizer = Rasterizer::<f32>::new();
    rasterizer.render(&scene, &view(Lens::Pinhole), &settings(), None).unwrap();
    let all = groups(rasterizer.backward(&scene, &weights.gradient(), Wanted::ALL).unwrap());
    let groups_and_names = [
        (Wanted::POSITIONS, "positions"),
        (Wanted::SHAPES, "axes"),
        (Wanted::OPACITIES, "opacities"),
        (Wanted::SH, "sh"),
        (Wanted::POSE, "pose"),
        (Wanted::GAIN, "gain"),
    ];
    for (wanted, name) in groups_and_names {
        let found = groups(rasterizer.backward(&scene, &weights.gradient(), wanted).unwrap());
        for (group, values) in &found {
            let expected = &all.iter().find(|(g, _)| g == group).unwrap().1;
            let is_sum = matches!(*group, "pose" | "gain");
            assert!(is_sum || *group == name, "{group} computed though only {name} was wanted");
            if *group == name {
                assert_eq!(values, expected, "{name}");
            }
        }
    }
}
