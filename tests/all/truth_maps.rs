//! Ground-truth images against the mesh, the breathing field's own formula and another finite difference.

use glam::{DVec2, DVec3};
use respire_bench::airway;
use respire_bench::airway::case::{Case, Effect};
use respire_bench::base::color::srgb_from_linear;
use respire_bench::base::{Image, NoProgress, mesh};
use respire_bench::formats::exr;
use respire_bench::render::{Light, RenderSettings, Scene, Shading, Transport, render};
use respire_bench::simulate::sequence::{self, Sequence};
use respire_bench::simulate::truth::TruthMap;
use respire_bench::simulate::{MeshOutput, RadianceOutput, SimulationSettings, material, simulate};

use crate::simulate::{case, small};

fn settings(maps: &[TruthMap]) -> SimulationSettings {
    SimulationSettings {
        frames: 3,
        frames_per_second: 4.0,
        meshes: MeshOutput::EndStates,
        radiance: RadianceOutput::None,
        truth: maps.iter().copied().collect(),
        ..small()
    }
}

fn image(sequence: &Sequence, name: String) -> Image<f32> {
    exr::read(&sequence.root.join(name)).unwrap()
}

fn vector(image: &Image<f32>, x: usize, y: usize) -> DVec3 {
    let v = image.pixel(x, y);
    DVec3::new(v[0] as f64, v[1] as f64, v[2] as f64)
}

/// World position of a pixel's wall point, by depth alone.
fn wall_point(sequence: &Sequence, frame: usize, x: usize, y: usize) -> DVec3 {
    let depth = sequence.depth_mm(frame).unwrap();
    let ray = sequence.camera.direction(DVec2::new(x as f64 + 0.5, y as f64 + 0.5));
    sequence.frames[frame].world_from_camera.transform_point3(ray * (depth.pixel(x, y)[0] as f64 / ray.z))
}

#[test]
fn motion_is_that_of_the_breathing_field() {
    let folder = tempfile::tempdir().unwrap();
    // Without the change of calibre the motion is a formula: x + phase * u(x).
    let mut case: Case = case();
    let breathing = case.breathing.as_mut().unwrap();
    breathing.calibre.diameter_ratio = vec![1.0];
    breathing.calibre.tracheal_invagination = 0.0;
    let field = breathing.field.clone();
    let sequence = simulate(&case, &settings(&[TruthMap::Motion]), &folder.path().join("film"), &NoProgress).unwrap();
    assert!(!sequence.root.join(sequence::backward_motion_name(0)).exists());
    assert!(!sequence.root.join(sequence::forward_motion_name(2)).exists());
    let (forward, backward) =
        (image(&sequence, sequence::forward_motion_name(1)), image(&sequence, sequence::backward_motion_name(1)));
    let phase = sequence.frames.iter().map(|f| f.phase).collect::<Vec<_>>();
    let mut largest = 0.0f64;
    for y in (0..32).step_by(3) {
        for x in (0..32).step_by(3) {
            let now = wall_point(&sequence, 1, x, y);
            let mut rest = now;
            for _ in 0..200 {
                rest = now - phase[1] * field.displacement(rest);
            }
            let motion = field.displacement(rest);
            for (seen, to) in [(vector(&forward, x, y), phase[2]), (vector(&backward, x, y), phase[0])] {
                let miss = seen.distance(motion * (to - phase[1]));
                // Between the vertices the mesh is flat and its motion linear.
                assert!(miss < 0.01, "pixel {x} {y}: {seen} is {miss} mm from the field's motion");
                largest = largest.max(seen.length());
            }
        }
    }
    assert!(largest > 1.0, "the airway hardly moves: {largest} mm");
}

#[test]
fn normals_are_the_meshes_and_colours_are_albedos() {
    let folder = tempfile::tempdir().unwrap();
    let maps = [TruthMap::Normals, TruthMap::Albedo];
    let sequence = simulate(&case(), &settings(&maps), &folder.path().join("film"), &NoProgress).unwrap();
    let (rest, other) = (sequence.inspiration().unwrap(), sequence.expiration().unwrap());
    for frame in [0, 2] {
        let now = mesh::interpolate(&rest.vertices, &other.vertices, sequence.frames[frame].phase);
        let pose = sequence.frames[frame].world_from_camera;
        let normals = image(&sequence, sequence::normal_name(frame));
        let mut compared = 0;
        for y in (1..32).step_by(4) {
            for x in (1..32).step_by(4) {
                let point = wall_point(&sequence, frame, x, y);
                let normal = pose.transform_vector3(vector(&normals, x, y));
                assert!((normal.length() - 1.0).abs() < 1e-5);
                assert!(normal.dot(point - pose.translation) < 0.0, "the normal points away from the camera");
                // Faces whose plane and inside hold the point; on an edge there are two.
                let fits = rest.faces.iter().filter(|face| {
                    let [a, b, c] = face.map(|v| now[v as usize]);
                    let n = (b - a).cross(c - a).normalize();
                    let inside = |p: DVec3, q: DVec3| (q - p).cross(point - p).dot(n) >= -1e-3 * (q - p).length();
                    (point - a).dot(n).abs() < 2e-3 && inside(a, b) && inside(b, c) && inside(c, a)
                });
                let best = fits
                    .map(|face| {
                        let [a, b, c] = face.map(|v| now[v as usize]);
                        (b - a).cross(c - a).normalize().dot(normal)
                    })
                    .fold(-1.0, f64::max);
                assert!(best > 1.0 - 1e-6, "frame {frame}, pixel {x} {y}: no face there has this normal ({best})");
                compared += 1;
            }
        }
        assert_eq!(compared, 64);
        let albedo = image(&sequence, sequence::albedo_name(frame));
        assert!(albedo.data.iter().all(|&v| (0.02..=0.95).contains(&v)));
        let mean = |c: usize| albedo.data.iter().skip(c).step_by(3).sum::<f32>() / 1024.0;
        assert!(mean(0) > 1.3 * mean(1), "tissue is red: {} {}", mean(0), mean(1));
    }
}

#[test]
fn phase_sensitivity_is_the_derivative_by_another_step() {
    let folder = tempfile::tempdir().unwrap();
    let spp = 64;
    let wanted = SimulationSettings { samples_per_pixel: spp, ..settings(&[TruthMap::PhaseSensitivity]) };
    // One gain and no noise: the image is a function of the radiance alone.
    let case = case().without(&[Effect::Vignette, Effect::WhiteBalance]);
    let sequence = simulate(&case, &wanted, &folder.path().join("film"), &NoProgress).unwrap();
    let told = image(&sequence, sequence::sensitivity_name(1));
    let anatomy = airway::build(&case).unwrap();
    let mut scene =
        Scene::new(&anatomy.inspiration, &anatomy.vertex_generation, material(&case).unwrap(), case.seed).unwrap();
    let record = sequence.frames[1];
    let light = Light { emission_exponent: 1.0, ..Light::at_camera(case.light_intensity) };
    let mut encoded = |phase: f64| {
        scene.deform(&mesh::interpolate(&anatomy.inspiration.vertices, &anatomy.expiration.vertices, phase)).unwrap();
        let settings = RenderSettings {
            samples_per_pixel: 400,
            transport: Transport::VERTICES,
            shading: Shading::Smooth,
            seed: case.seed,
            frame: 99,
            ..RenderSettings::default()
        };
        let radiance = render(&scene, &sequence.camera, &record.world_from_camera, &light, &settings).unwrap().radiance;
        radiance.map(|v| srgb_from_linear(v * record.gain as f32))
    };
    let step = 0.008;
    let (low, high) = (encoded(record.phase - step), encoded(record.phase + step));
    let other: Vec<f64> = low.data.iter().zip(&high.data).map(|(l, h)| ((h - l).abs() as f64) / (2.0 * step)).collect();
    let mut square = (0.0, 0.0);
    for (a, b) in told.data.iter().zip(&other) {
        square.0 += (*a as f64 - b).powi(2);
        square.1 += b * b;
    }
    let difference = (square.0 / square.1).sqrt();
    let mean = |values: &mut dyn Iterator<Item = f64>| values.sum::<f64>() / (32.0 * 32.0 * 3.0);
    let (a, b) = (mean(&mut told.data.iter().map(|&v| v as f64)), mean(&mut other.iter().copied()));
    // What is left is the noise of both: it is there at the same step, too.
    assert!(difference < 0.3 && (a / b - 1.0).abs() < 0.05, "mean {a} and {b}, relative difference {difference}");
}
