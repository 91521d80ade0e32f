//! The scene of the timings (benchmarks, `pareto splat`, examples): a bumpy tube of thin ellipsoids, rendered from
//! inside, made like the one of `../shared/reference/splat`.

use crate::base::Camera;
use crate::base::camera::world_from_camera_looking;
use crate::base::random::{CounterRng, Stage};
use crate::splat::types::{DepthOutput, Gaussians, Settings, Shape, View};
use glam::DVec3;

/// Thin ellipsoids as in the reference scene, in the order of a hexagonal lattice on the wall.
pub fn tube(n: usize) -> Gaussians<f32> {
    let mut r = CounterRng::new(1, Stage::Test, &[n as u64]);
    let (around, length) = (std::f64::consts::TAU * 8.0, 100.0);
    let spacing = (around * length / n as f64).sqrt();
    let columns = (around / spacing).round().max(1.0);
    let rows = (n as f64 / columns).ceil();
    let mut scene = Gaussians::<f32>::discs(n, 1, 0.95);
    let (mut rotations, mut scales) = (Vec::new(), Vec::new());
    for (i, position) in scene.positions.iter_mut().enumerate() {
        let (row, column) = ((i as f64 / columns).floor(), i as f64 % columns);
        let angle = ((column + 0.5 * (row % 2.0)) * around / columns + 0.15 * spacing * r.normal()) / 8.0;
        let z = (row + 0.5) * length / rows + 0.15 * spacing * r.normal();
        let radius = 8.0 + 0.3 * (std::f64::consts::TAU * z / 12.0).sin() * (0.6 + 0.4 * (3.0 * angle).cos());
        *position = [radius * angle.cos(), radius * angle.sin(), z].map(|v| v as f32);
        // The third axis points inwards.
        let inwards = DVec3::new(-angle.cos(), -angle.sin(), 0.05 * r.normal()).normalize();
        let turn = glam::DQuat::from_rotation_arc(DVec3::Z, inwards);
        rotations.push([turn.w, turn.x, turn.y, turn.z].map(|v| v as f32));
        let size = || 0.7 * spacing;
        scales.push([size() * r.range(0.85, 1.15), size() * r.range(0.85, 1.15), 0.05 * size()].map(|v| v as f32));
    }
    scene.shape = Shape::Ellipsoids { rotations, scales };
    scene.sh.iter_mut().for_each(|v| *v = (0.3 * r.normal()) as f32);
    scene
}

/// The camera inside, 12 and 6 degrees off the axis, field of view 90 degrees.
pub fn view(side: usize) -> View {
    let forward = DVec3::new(12f64.to_radians().sin(), 6f64.to_radians().sin(), 1.0);
    let world = world_from_camera_looking(DVec3::new(1.0, -0.5, 10.0), forward, DVec3::NEG_Y);
    View::new(Camera::pinhole(side as u32, side as u32, 90f64.to_radians()), world)
}

/// Colour alone, as the other renderers are timed.
pub fn settings() -> Settings {
    Settings { depth: DepthOutput::Skip, ..Settings::default() }
}

/// Any gradient of an image of `values` values.
pub fn image_gradient(values: usize) -> Vec<f32> {
    (0..values).map(|k| ((k * 7919) % 1009) as f32 / 504.0 - 1.0).collect()
}

/// `scene` and `copies` of it out of sight: behind the camera and to its left and right in turn.
pub fn with_hidden(scene: &Gaussians<f32>, copies: usize) -> Gaussians<f32> {
    let mut all = scene.clone();
    let Shape::Ellipsoids { rotations, scales } = &scene.shape else { return all };
    for copy in 0..copies {
        let shift = [[0.0, 0.0, -130.0], [-260.0, 0.0, 0.0], [260.0, 0.0, 0.0]][copy % 3];
        all.positions.extend(scene.positions.iter().map(|p| [0, 1, 2].map(|k| p[k] + shift[k])));
        all.opacities.extend_from_slice(&scene.opacities);
        all.sh.extend_from_slice(&scene.sh);
        if let Shape::Ellipsoids { rotations: r, scales: s } = &mut all.shape {
            r.extend_from_slice(rotations);
            s.extend_from_slice(scales);
        }
    }
    all
}
