//! Ground-truth images against the written meshes, the breathing field's formula and closed forms, by a tracer of our
//! tests alone.

use glam::{DVec2, DVec3};
use respire_bench::airway::case::{Case, Effect};
use respire_bench::base::{Image, NoProgress, TriangleMesh};
use respire_bench::formats::exr;
use respire_bench::simulate::sequence::{self, Sequence};
use respire_bench::simulate::truth::TruthMap;
use respire_bench::simulate::{MeshOutput, RadianceOutput, SimulationSettings, simulate};

use crate::own_tracer::{DARK, Met, Wall, differs, direction};
use crate::scope::{dark_case, exponent};
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
    case.waveform.start_hold_s = 0.0;
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

/// The central ray of a pixel against the wall at a frame's phase, by a tracer of our tests alone.
fn met<'a>(
    sequence: &Sequence,
    rest: &'a TriangleMesh,
    other: &TriangleMesh,
    frame: usize,
    x: usize,
    y: usize,
) -> (Wall<'a>, Met) {
    let state = &sequence.frames[frame];
    let wall = Wall::between(&rest.vertices, &other.vertices, state.phase, &rest.faces);
    let ray = state.world_from_camera.matrix3 * direction(&sequence.camera, x as f64 + 0.5, y as f64 + 0.5);
    let met = wall.meet(state.world_from_camera.translation, ray).expect("the airway is closed");
    (wall, met)
}

#[test]
fn normals_and_motion_are_those_of_the_written_meshes() {
    let folder = tempfile::tempdir().unwrap();
    let wanted =
        SimulationSettings { meshes: MeshOutput::EveryFrame, ..settings(&[TruthMap::Normals, TruthMap::Motion]) };
    let mut case: Case = case();
    case.waveform.start_hold_s = 0.0;
    case.camera.fisheye = Some([-0.03, 0.002, 0.0, 0.0]);
    let sequence = simulate(&case, &wanted, &folder.path().join("film"), &NoProgress).unwrap();
    let (rest, other) = (sequence.inspiration().unwrap(), sequence.expiration().unwrap());
    let meshes: Vec<TriangleMesh> = (0..3)
        .map(|f| respire_bench::formats::mesh::read(&sequence.root.join(sequence::frame_mesh_name(f))).unwrap())
        .collect();
    let pose = sequence.frames[1].world_from_camera;
    let normals = image(&sequence, sequence::normal_name(1));
    let (forward, backward) =
        (image(&sequence, sequence::forward_motion_name(1)), image(&sequence, sequence::backward_motion_name(1)));
    let depth = sequence.depth_mm(1).unwrap();
    let (mut largest, mut other_face) = (0.0f64, 0);
    for (x, y) in (0..64).map(|k| (1 + 4 * (k % 8), 1 + 4 * (k / 8))) {
        let (wall, met) = met(&sequence, &rest, &other, 1, x, y);
        let z = met.distance_mm * direction(&sequence.camera, x as f64 + 0.5, y as f64 + 0.5).z;
        let told = f64::from(depth.pixel(x, y)[0]);
        assert!((told - z).abs() < 2e-4 * z + 1e-4, "pixel {x} {y}: depth {told} for {z}");
        let normal = pose.matrix3 * vector(&normals, x, y);
        // On an edge single precision may choose the other face.
        other_face += usize::from(normal.distance(wall.face_normal(met)) > 1e-4);
        let on = |mesh: &TriangleMesh| Wall::new(mesh.vertices.clone(), &rest.faces).point(met);
        for (image, neighbour) in [(&forward, 2), (&backward, 0)] {
            let difference = on(&meshes[neighbour]) - on(&meshes[1]);
            let miss = vector(image, x, y).distance(difference);
            assert!(miss < 2e-3, "pixel {x} {y}: {miss} mm from the motion between the frames' meshes");
            largest = largest.max(difference.length());
        }
    }
    assert!(other_face <= 2 && largest > 1.0, "{other_face} normals of other faces, motion up to {largest} mm");
}

#[test]
fn colours_are_the_table_of_the_case() {
    let folder = tempfile::tempdir().unwrap();
    let film = |text: &str, name: &str| {
        let mut case: Case = case();
        case.waveform.start_hold_s = 0.0;
        case.material = toml::from_str(text).unwrap();
        let sequence = simulate(&case, &settings(&[TruthMap::Albedo]), &folder.path().join(name), &NoProgress).unwrap();
        image(&sequence, sequence::albedo_name(1))
    };
    let flat = film("kind = \"coated\"\nalbedo = [0.61, 0.27, 0.2]", "flat");
    assert!(flat.data.chunks_exact(3).all(|p| p == [0.61f32, 0.27, 0.2]));
    // Without vessels, blotches, rings, folds and spurs blood follows the generation alone: 3 % more redness per generation, and 1 + .75 of
    // that times the depth of blood; green and blue lose three times as much as red.
    let text = "kind = \"mucosa\"\nalbedo = [0.6, 0.3, 0.2]\nvessels = 0.0\nblotches = 0.0\nrings = 0.0\nfolds = 0.0\nspurs = 0.0";
    let plain = film(text, "plain");
    for p in plain.data.chunks_exact(3) {
        let depth = (0.6 * 1.16 / f64::from(p[0]) - 1.0) / 0.16;
        let generation = (depth - 1.0) / (0.75 * 0.03);
        assert!((-0.01..8.01).contains(&generation), "generation {generation}");
        for (c, base, rate) in [(1, 0.3, 0.5), (2, 0.2, 0.46)] {
            let expected = base * (1.0 + rate) / (1.0 + rate * depth);
            assert!((f64::from(p[c]) / expected - 1.0).abs() < 1e-4, "{p:?}");
        }
    }
}

#[test]
fn phase_sensitivity_is_the_derivative_of_the_closed_form() {
    let folder = tempfile::tempdir().unwrap();
    let case = dark_case().without(&[Effect::Vignette]);
    let wanted = SimulationSettings {
        width_px: 24,
        height_px: 24,
        samples_per_pixel: 400,
        ..settings(&[TruthMap::PhaseSensitivity])
    };
    let sequence = simulate(&case, &wanted, &folder.path().join("film"), &NoProgress).unwrap();
    let (rest, other) = (sequence.inspiration().unwrap(), sequence.expiration().unwrap());
    let (state, step) = (&sequence.frames[1], 0.004);
    let encoded = |phase: f64| -> Vec<f64> {
        let wall = Wall::between(&rest.vertices, &other.vertices, phase, &rest.faces);
        let scale = DARK[0] * case.light_intensity[0] * state.gain / std::f64::consts::PI;
        let encode = |v: f64| {
            let v = (v * scale).clamp(0.0, 1.0);
            if v <= 0.0031308 { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 }
        };
        wall.picture(&sequence.camera, &state.world_from_camera, exponent(&case), 4).into_iter().map(encode).collect()
    };
    let (low, high) = (encoded(state.phase - step), encoded(state.phase + step));
    let expected: Vec<f64> = low.iter().zip(&high).map(|(l, h)| (h - l).abs() / (2.0 * step)).collect();
    let told = image(&sequence, sequence::sensitivity_name(1));
    let told: Vec<f64> = told.data.iter().step_by(3).map(|&v| f64::from(v)).collect();
    let (rms, ratio) = differs(&told, &expected);
    // What is left: 16 points of a pixel against 400 where an edge crosses it.
    assert!(rms < 0.2 && (ratio - 1.0).abs() < 0.05, "relative difference {rms}, mean {ratio}");
}
