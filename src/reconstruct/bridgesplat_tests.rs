//! Does BridgeSplat do what it was made for? A textured patch, seen by a still camera, deforms smoothly by 5 mm.

use glam::{DAffine3, DVec3};

use super::anchored::{SH_C0, SH_VALUES, Start, Surface, to_f32};
use super::settings::{BridgeMethod, PerFace};
use super::tests::bridge;
use super::*;
use crate::base::NoProgress;
use crate::base::image::codes_from_unit;
use crate::splat::{Frame, Rasterizer, Settings, View};

const FRAMES: usize = 20;
const SIDE: usize = 41;

/// A square of 40 mm, 50 mm in front of the camera and facing it.
fn patch() -> TriangleMesh {
    let mut mesh = TriangleMesh::default();
    for y in 0..SIDE {
        for x in 0..SIDE {
            mesh.vertices.push(DVec3::new(x as f64 - 20.0, y as f64 - 20.0, 50.0));
        }
    }
    for y in 0..SIDE - 1 {
        for x in 0..SIDE - 1 {
            let i = (y * SIDE + x) as u32;
            let below = i + SIDE as u32;
            mesh.faces.extend([[i, below, i + 1], [i + 1, below, below + 1]]);
        }
    }
    mesh
}

/// 5 mm at the centre, mostly sideways, fading towards the rim.
fn planted(at: DVec3, share: f64) -> DVec3 {
    let from_centre = DVec3::new(at.x, at.y, 0.0).length_squared();
    at + DVec3::new(3.5, 2.5, -2.549) * share * (-from_centre / (2.0 * 9.0 * 9.0)).exp()
}

fn texture(at: DVec3) -> [f64; 3] {
    let waves = (0.9 * at.x + 0.5 * at.y).sin() * (0.4 * at.x - 1.1 * at.y).cos() + 0.6 * (1.7 * at.y).sin();
    [0.65 + 0.15 * waves, 0.45 + 0.12 * waves, 0.4 + 0.1 * (1.3 * at.x).cos()]
}

/// What a still camera sees of it while the deformation grows, and the surface at the end.
fn film(deforms: bool) -> (Observation, Vec<DVec3>) {
    let rest = patch();
    let mut settings = bridge("bridgesplat").appearance;
    settings.gaussians_per_face.value = PerFace::Count(4);
    let mut surface = Surface::new(&rest, &settings, Frame::InheritStretch, Start::Even, 5);
    let camera = Camera::pinhole(96, 96, 1.0);
    let view = View::new(camera, DAffine3::IDENTITY);
    let faces: Vec<u32> = (0..rest.faces.len() as u32).collect();
    let mut discs = surface.patch(&faces).unwrap();
    discs.place(&to_f32(&rest.vertices)).unwrap();
    for (sh, at) in surface.sh.chunks_exact_mut(SH_VALUES).zip(&discs.gaussians.positions) {
        let color = texture(DVec3::from(at.map(f64::from)));
        (0..3).for_each(|c| sh[c] = (color[c] as f32 - 0.5) / SH_C0);
    }
    let mut discs = surface.patch(&faces).unwrap();
    let (mut images, mut vertices) = (Vec::new(), rest.vertices.clone());
    let mut rasterizer = Rasterizer::new();
    for t in 0..FRAMES {
        let share = if deforms { t as f64 / (FRAMES - 1) as f64 } else { 0.0 };
        vertices = rest.vertices.iter().map(|v| planted(*v, share)).collect();
        discs.place(&to_f32(&vertices)).unwrap();
        let rendered = rasterizer.render(&discs.gaussians, &view, &Settings::default(), None).unwrap();
        let (width, height) = (rendered.width, rendered.height);
        images.push(codes_from_unit(&Image { width, height, channels: 3, data: rendered.color.clone() }));
    }
    let observation = Observation {
        camera,
        world_from_camera: vec![DAffine3::IDENTITY; FRAMES],
        time_s: (0..FRAMES).map(|t| t as f64 * 0.04).collect(),
        images,
        inspiration: rest,
        expiration: None,
        first_depth_mm: None,
        true_phase: None,
        seed: 1,
    };
    (observation, vertices)
}

/// Root mean square distance of the recovered surface to the true one, over what moves by 1 mm or more, in mm.
fn error_mm(settings: BridgeMethod, observation: &Observation, truth: &[DVec3]) -> f64 {
    let done = Bridgesplat::new(settings, 1.0).run(observation, &mut |_| Ok(()), &NoProgress).unwrap();
    let found = done.final_mesh.unwrap().vertices;
    let rest = &observation.inspiration.vertices;
    let moved = (0..rest.len()).filter(|&i| planted(rest[i], 1.0).distance(rest[i]) >= 1.0);
    let squares: Vec<f64> = moved.map(|i| found[i].distance_squared(truth[i])).collect();
    (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
}

#[test]
fn a_planted_smooth_deformation_of_5_mm_is_recovered() {
    let (observation, truth) = film(true);
    let error = error_mm(bridge("bridgesplat"), &observation, &truth);
    let mut frozen = bridge("bridgesplat");
    frozen.displacement_rate.value = 0.0;
    let without = error_mm(frozen, &observation, &truth);
    println!("planted 5 mm: error {error:.3} mm, with a frozen mesh {without:.3} mm");
    assert!(error <= 0.5, "{error}");
    assert!(without > 2.0, "the test would pass without any deformation: {without}");
}

#[test]
fn what_does_not_move_is_left_in_place() {
    let (observation, truth) = film(false);
    let error = error_mm(bridge("bridgesplat"), &observation, &truth);
    assert!(error <= 0.5, "{error}");
}
