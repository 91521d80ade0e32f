//! The scenes of `stress`: geometry that is hard in single precision, and values that are not finite, denormal or huge
//! in every array.

use glam::DAffine3;

use crate::base::Camera;
use crate::base::random::{CounterRng, Stage};
use crate::splat::{Anchors, Carrier, DiscFrame, Filter, Footprint, Gaussians, Settings, Shape, View};

/// The requirement on an item.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Demand {
    /// The numbers of double precision.
    Accuracy,
    /// Finite numbers: its values overflow in single precision, where their Gaussians are left out, and not in double.
    Finite,
}

/// A scene of the matrix.
pub(super) struct StressItem {
    pub demand: Demand,
    pub name: String,
    pub scene: Gaussians<f32>,
    pub view: View,
    pub settings: Settings,
}

pub(super) fn view(width: u32, height: u32) -> View {
    View::new(Camera::pinhole(width, height, 90f64.to_radians()), DAffine3::IDENTITY)
}

/// `n` discs on a wall 4 to 9 mm before the camera, of about `size` mm.
pub(super) fn wall(n: usize, size: f64, seed: u64) -> Gaussians<f32> {
    let r = &mut CounterRng::new(seed, Stage::Test, &[n as u64]);
    let mut scene = Gaussians::<f32>::discs(n, 1, 0.8);
    let mut axes = Vec::with_capacity(n);
    for position in &mut scene.positions {
        let z = r.range(4.0, 9.0);
        *position = [z * r.range(-1.1, 1.1), z * r.range(-1.1, 1.1), z].map(|v| v as f32);
        let mut axis = || [0, 1, 2].map(|_| (size * r.normal()) as f32);
        axes.push([axis(), axis()]);
    }
    scene.shape = Shape::Discs { axes };
    scene.sh.iter_mut().for_each(|v| *v = (0.3 * r.normal()) as f32);
    scene
}

/// The same wall of ellipsoids.
fn ellipsoids(n: usize, seed: u64) -> Gaussians<f32> {
    let mut scene = wall(n, 0.5, seed);
    let r = &mut CounterRng::new(seed, Stage::Test, &[5]);
    scene.shape = Shape::Ellipsoids {
        rotations: (0..n).map(|_| [0; 4].map(|_| r.normal() as f32)).collect(),
        scales: (0..n).map(|_| [0.5, 0.4, 0.1].map(|size| (size * r.range(0.5, 1.5)) as f32)).collect(),
    };
    scene
}

fn axes_of(scene: &mut Gaussians<f32>) -> &mut [[[f32; 3]; 2]] {
    match &mut scene.shape {
        Shape::Discs { axes } => axes,
        Shape::Ellipsoids { .. } => &mut [],
    }
}

fn scaled(factor: f32) -> StressItem {
    let mut scene = wall(400, 0.5, 1);
    scene.positions.iter_mut().flatten().for_each(|v| *v *= factor);
    axes_of(&mut scene).iter_mut().flatten().flatten().for_each(|v| *v *= factor);
    let near_mm = 0.2 * f64::from(factor);
    StressItem {
        settings: Settings { near_mm, ..Settings::default() },
        ..item(&format!("scene scale {factor:e}"), scene)
    }
}

pub(super) fn item(name: &str, scene: Gaussians<f32>) -> StressItem {
    StressItem { demand: Demand::Accuracy, name: name.into(), scene, view: view(96, 80), settings: Settings::default() }
}

/// A scene of `wall` after a change.
fn changed(name: &str, seed: u64, change: impl Fn(&mut Gaussians<f32>, &mut CounterRng)) -> StressItem {
    let mut scene = wall(400, 0.5, seed);
    change(&mut scene, &mut CounterRng::new(seed, Stage::Test, &[99]));
    item(name, scene)
}

/// The shapes, places and opacities of the matrix.
pub(super) fn geometry() -> Vec<StressItem> {
    let mut items: Vec<StressItem> = [1e-3, 1e-2, 0.1, 1.0, 10.0, 100.0, 1e3].map(scaled).into();
    items
        .push(changed("needles, 1:10000", 2, |s, _| axes_of(s).iter_mut().for_each(|a| a[1] = a[1].map(|v| v * 1e-4))));
    items.push(changed("no area", 3, |s, _| axes_of(s).iter_mut().for_each(|a| a[1] = a[0])));
    items.push(changed("no extent", 4, |s, _| axes_of(s).fill([[0.0; 3]; 2])));
    items.push(changed("coincident", 5, |s, _| {
        let place = s.positions[0];
        s.positions.fill([0.3, 0.2, place[2]]);
    }));
    items.push(changed("depth ties", 6, |s, _| s.positions.iter_mut().for_each(|p| p[2] = 5.0)));
    items.push(changed("behind the camera", 7, |s, _| s.positions.iter_mut().for_each(|p| p[2] = -p[2])));
    items.push(changed("on and across the near plane", 8, |s, r| {
        s.positions.iter_mut().for_each(|p| p[2] = [0.2, 0.199, 0.201, 0.25, 3.0][r.index(5)]);
        axes_of(s).iter_mut().flatten().flatten().for_each(|v| *v *= 0.05);
    }));
    items.push(changed("camera touches the wall", 9, |s, _| {
        s.positions.iter_mut().for_each(|p| *p = [0.05 * p[0], 0.05 * p[1], 0.2 + 0.05 * p[2]]);
        axes_of(s).iter_mut().flatten().flatten().for_each(|v| *v *= 0.05);
    }));
    items.push(changed("edge-on", 10, |s, _| {
        let places = s.positions.clone();
        for (axes, p) in axes_of(s).iter_mut().zip(places) {
            // One axis along the ray: the disc is a line.
            axes[0] = p.map(|v| 0.1 * v);
        }
    }));
    items.push(changed("smaller than a pixel", 11, |s, _| {
        axes_of(s).iter_mut().flatten().flatten().for_each(|v| *v *= 1e-3);
    }));
    items.push(changed("fills the screen", 12, |s, _| {
        axes_of(s).iter_mut().flatten().flatten().for_each(|v| *v *= 40.0);
    }));
    for opacity in [0.0, 1.0 / 255.0, 0.999, 1.0] {
        items.push(changed(&format!("opacity {opacity:.4}"), 13, |s, _| s.opacities.fill(opacity)));
    }
    items
}

/// Sizes of scene and image.
pub(super) fn sizes(small: bool) -> Vec<StressItem> {
    let mut items = vec![item("one Gaussian", wall(1, 2.0, 20)), item("no Gaussian", wall(0, 1.0, 21))];
    items.push(StressItem { view: view(1, 1), ..item("1x1 pixel", wall(400, 0.5, 22)) });
    if !small {
        items.push(item("1000000 Gaussians", wall(1_000_000, 0.02, 23)));
        items.push(StressItem { view: view(4096, 4096), ..item("4096x4096 pixels", wall(400, 0.5, 24)) });
    }
    items
}

/// Puts a value into the rotations or scales of a Gaussian.
type Spoil = fn(&mut [[f32; 4]], &mut [[f32; 3]], usize, f32);

/// Every bad value in every array.
pub(super) fn poisons() -> Vec<StressItem> {
    let values = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e-40, 3e38];
    let mut items = Vec::new();
    for (k, value) in values.into_iter().enumerate() {
        let poisoned = |name: &str, place: fn(&mut Gaussians<f32>, usize, f32)| {
            let demand = if value == 3e38 { Demand::Finite } else { Demand::Accuracy };
            let scene = changed(&format!("{value:e} in {name}"), 30 + k as u64, |s, r| {
                (0..40).for_each(|_| place(s, r.index(400), value));
            });
            StressItem { demand, ..scene }
        };
        items.push(poisoned("positions", |s, i, v| s.positions[i][i % 3] = v));
        items.push(poisoned("axes", |s, i, v| axes_of(s)[i][i % 2][i % 3] = v));
        items.push(poisoned("opacities", |s, i, v| s.opacities[i] = v));
        items.push(poisoned("SH", |s, i, v| s.sh[12 * i + i % 12] = v));
        let ellipsoid = |name: &str, place: Spoil| {
            let demand = if value == 3e38 { Demand::Finite } else { Demand::Accuracy };
            let mut scene = ellipsoids(400, 50 + k as u64);
            let r = &mut CounterRng::new(50 + k as u64, Stage::Test, &[99]);
            if let Shape::Ellipsoids { rotations, scales } = &mut scene.shape {
                (0..40).for_each(|_| place(rotations, scales, r.index(400), value));
            }
            StressItem { demand, ..item(&format!("{value:e} in {name}"), scene) }
        };
        items.push(ellipsoid("rotations", |q, _, i, v| q[i][i % 4] = v));
        items.push(ellipsoid("scales", |_, s, i, v| s[i][i % 3] = v));
    }
    let mut still = ellipsoids(400, 60);
    if let Shape::Ellipsoids { rotations, .. } = &mut still.shape {
        rotations.iter_mut().step_by(7).for_each(|q| *q = [0.0; 4]);
    }
    items.push(item("rotations of length 0", still));
    items
}

/// The scenes of [`geometry`] with the compensated filter and with exact discs, and a fisheye.
pub(super) fn modes() -> Vec<StressItem> {
    let compensate = |item: StressItem| StressItem {
        name: format!("{}; compensated", item.name),
        settings: Settings { filter: Filter::Compensate, ..item.settings },
        ..item
    };
    let discs = |item: StressItem| StressItem {
        name: format!("{}; exact discs", item.name),
        settings: Settings { footprint: Footprint::Disc, ..item.settings },
        ..item
    };
    let fisheye = |mut item: StressItem| {
        item.view.camera.fisheye = Some([0.05, -0.02, 0.01, -0.003]);
        StressItem { name: format!("{}; fisheye", item.name), ..item }
    };
    let mut items: Vec<StressItem> = geometry().into_iter().map(compensate).collect();
    items.extend(geometry().into_iter().map(discs));
    items.extend(geometry().into_iter().map(fisheye));
    items
}

/// Discs anchored to a mesh of bad triangles, at a phase: the discs are placed in single precision, and the phase is
/// exactly 0 or 1 where a method could start or stop.
pub(super) fn anchored() -> Vec<StressItem> {
    let mut items = Vec::new();
    for (name, squeeze) in [("sound", 1.0f32), ("needle", 1e-4), ("zero-area", 0.0)] {
        for phase in [0.0f32, 1.0] {
            let scene = on_triangles(squeeze, phase);
            items.push(item(&format!("anchors on {name} triangles at phase {phase}"), scene));
        }
    }
    items
}

/// Sixty triangles whose height is multiplied by `squeeze`, five discs each, moved by `phase` of a breath.
fn on_triangles(squeeze: f32, phase: f32) -> Gaussians<f32> {
    let r = &mut CounterRng::new(70, Stage::Test, &[]);
    let mut vertices = Vec::new();
    for _ in 0..60 {
        let z = r.range(4.0, 9.0) as f32;
        let corner = [z * r.range(-1.0, 1.0) as f32, z * r.range(-1.0, 1.0) as f32, z];
        let (width, height) = (r.range(0.5, 1.5) as f32, squeeze * r.range(0.5, 1.5) as f32);
        vertices.push(corner);
        vertices.push([corner[0] + width, corner[1], corner[2]]);
        vertices.push([corner[0] + 0.3 * width, corner[1] + height, corner[2] + 0.2 * height]);
    }
    let faces: Vec<[u32; 3]> = (0..60).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect();
    let moved: Vec<[f32; 3]> =
        vertices.iter().map(|v| [v[0] + phase * 0.1 * v[1], v[1] + phase * 0.2, v[2] * (1.0 + 0.05 * phase)]).collect();
    let n = 300;
    let mut scene = wall(n, 0.5, 71);
    let faces_of = (0..n as u32).map(|i| i / 5).collect();
    let logits = (0..n).map(|_| [0; 3].map(|_| r.normal() as f32)).collect();
    let log_scales = (0..n).map(|_| [-1.5f32; 2]).collect();
    let rest = Carrier { vertices: &vertices, faces: &faces };
    let now = Carrier { vertices: &moved, faces: &faces };
    // A mesh that cannot be anchored to is an item that fails: its scene stays the wall.
    let anchors = Anchors::new(DiscFrame::InheritStretch, faces_of, logits, log_scales, rest);
    if anchors.and_then(|mut anchors| anchors.place(now, None, &mut scene)).is_err() {
        scene.positions.fill([f32::NAN; 3]);
    }
    scene
}
