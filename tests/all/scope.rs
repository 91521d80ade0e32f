//! The scope's imperfections against closed forms and against published formulas.

use std::f64::consts::PI;

use std::fs;
use std::path::Path;

use glam::{DAffine3, DVec2, DVec3};
use respire_bench::airway;
use respire_bench::airway::case::{Case, Effect, ScopeSettings};
use respire_bench::airway::waveform::Waveform;
use respire_bench::base::{Camera, NoProgress, TriangleMesh, mesh};
use respire_bench::formats::exr;
use respire_bench::render::probe::probe;
use respire_bench::render::{Light, Material, RenderSettings, Scene, Shading, Transport, render};
use respire_bench::simulate::film::Film;
use respire_bench::simulate::sequence::{FRAMES, Sequence};
use respire_bench::simulate::{MeshOutput, RadianceOutput, SimulationSettings, material, simulate};

use crate::simulate::{case, contents, small};

/// A square wall at z = 10 mm that faces the camera at the origin.
fn wall() -> TriangleMesh {
    let corner = |x: f64, y: f64| DVec3::new(x * 100.0, y * 100.0, 10.0);
    TriangleMesh {
        vertices: vec![corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)],
        faces: vec![[0, 2, 1], [0, 3, 2]],
    }
}

#[test]
fn a_fibre_bundle_lights_a_wall_as_the_cosine_law_says() {
    let scene = Scene::new(&wall(), &[], Material::lambert([0.5; 3]), 1).unwrap();
    let camera = Camera::pinhole(33, 33, 100f64.to_radians());
    let half_angle_deg = 35.0;
    let exponent = Light::exponent_of_half_angle(half_angle_deg);
    assert!((half_angle_deg.to_radians().cos().powf(exponent) - 0.5).abs() < 1e-12);
    let light = Light { emission_exponent: exponent, ..Light::at_camera([100.0; 3]) };
    let settings = RenderSettings { max_scatterings: 1, samples_per_pixel: 256, ..RenderSettings::default() };
    let frame = render(&scene, &camera, &DAffine3::IDENTITY, &light, &settings).unwrap();
    for (x, y) in [(16, 16), (16, 2), (30, 16), (5, 27)] {
        // The mean over the pixel, by a grid of points.
        let at = |i: usize| {
            let offset = DVec2::new((i % 20) as f64 + 0.5, (i / 20) as f64 + 0.5) / 20.0;
            let direction = camera.direction(DVec2::new(x as f64, y as f64) + offset);
            let cosine = 1.0 / direction.length();
            let distance = 10.0 / cosine;
            0.5 / PI * 100.0 * cosine.powf(exponent) * cosine / (distance * distance)
        };
        let expected = (0..400).map(at).sum::<f64>() / 400.0;
        let got = frame.radiance.pixel(x, y)[0] as f64;
        assert!((got / expected - 1.0).abs() < 2e-3, "pixel {x} {y}: {got} for {expected}");
    }
}

#[test]
fn probed_points_lie_where_the_rays_meet_the_wall() {
    let mesh = wall();
    let scene = Scene::new(&mesh, &[], Material::lambert([0.5, 0.4, 0.3]), 1).unwrap();
    let camera = Camera::pinhole(9, 7, 1.5);
    let points = probe(&scene, &camera, &DAffine3::IDENTITY).unwrap();
    for (pixel, point) in points.iter().enumerate() {
        let point = point.expect("the wall fills the view");
        let centre = DVec2::new((pixel % 9) as f64 + 0.5, (pixel / 9) as f64 + 0.5);
        let expected = camera.direction(centre) * 10.0;
        assert!(point.on(&mesh.vertices, &mesh.faces).distance(expected) < 1e-3);
        assert_eq!(point.albedo, [0.5, 0.4, 0.3]);
    }
    let away = DAffine3::from_rotation_y(PI);
    assert!(probe(&scene, &camera, &away).unwrap().iter().all(Option::is_none));
}

/// A case with every effect at work.
fn everything() -> Case {
    let mut case = case();
    case.camera.fisheye = Some([-0.03, 0.002, 0.0, 0.0]);
    case.scope = ScopeSettings { shutter_s: 0.06, mask_radius: 0.95, ..case.scope };
    case
}

fn tiny() -> SimulationSettings {
    SimulationSettings {
        width_px: 16,
        height_px: 16,
        frames: 3,
        samples_per_pixel: 1,
        meshes: MeshOutput::EndStates,
        radiance: RadianceOutput::None,
        ..small()
    }
}

/// `frames.csv` as one map from column to values.
fn columns(sequence: &Sequence) -> std::collections::BTreeMap<String, Vec<f64>> {
    let text = fs::read_to_string(sequence.root.join(FRAMES)).unwrap();
    let mut lines = text.lines();
    let names: Vec<String> = lines.next().unwrap().split(',').map(str::to_string).collect();
    let rows: Vec<Vec<f64>> = lines.map(|l| l.split(',').map(|v| v.parse().unwrap()).collect()).collect();
    assert!(rows.iter().all(|r| r.len() == names.len()));
    names.into_iter().enumerate().map(|(i, n)| (n, rows.iter().map(|r| r[i]).collect())).collect()
}

#[test]
fn every_effect_has_its_switch_and_its_truth() {
    let folder = tempfile::tempdir().unwrap();
    let film = |case: &Case, name: &str| simulate(case, &tiny(), &folder.path().join(name), &NoProgress).unwrap();
    let whole = film(&everything(), "whole");
    let on = columns(&whole);
    assert!(whole.root.join("mask.png").is_file());
    let masks = fs::read_to_string(whole.root.join("transforms.json")).unwrap().matches("mask.png").count();
    assert_eq!(masks, 3);
    let pictures = |root: &Path| contents(&root.join("images"));
    for effect in Effect::ALL {
        let without = film(&everything().without(&[effect]), effect.name());
        assert_ne!(pictures(&without.root), pictures(&whole.root), "{} changes nothing", effect.name());
        let off = columns(&without);
        let zero = |column: &str| off[column].iter().all(|&v| v == 0.0) && on[column].iter().any(|&v| v != 0.0);
        let told = match effect {
            Effect::Emission => zero("emission_half_angle_deg"),
            Effect::AutoExposure => {
                // What is left is the drift: nothing of the wanted gain.
                let drift = columns(&film(&everything().without(&[effect, Effect::GainDrift]), "fixed"));
                drift["gain"].iter().all(|&g| g == drift["gain"][0])
            }
            Effect::Lag => {
                let at_once = columns(&film(&everything().without(&[effect, Effect::GainDrift]), "at once"));
                at_once["gain"].iter().zip(&at_once["wanted_gain"]).all(|(g, w)| (g / w - 1.0).abs() < 1e-9)
            }
            Effect::Overshoot | Effect::GainDrift => off["gain"] != on["gain"],
            Effect::WhiteBalance => {
                ["red", "green", "blue"].iter().all(|c| off[&format!("white_balance_{c}")].iter().all(|&v| v == 1.0))
            }
            Effect::ShotNoise => zero("shot_noise"),
            Effect::ReadNoise => zero("read_noise"),
            Effect::Vignette => zero("vignette"),
            Effect::Distortion => zero("k1") && zero("k2") && without.camera.fisheye.is_none(),
            Effect::MotionBlur => zero("shutter_s") && zero("blur_px"),
            Effect::Mask => zero("mask_radius_px") && !without.root.join("mask.png").exists(),
        };
        assert!(told, "frames.csv does not tell that {} is off", effect.name());
    }
}

#[test]
fn a_blurred_frame_is_the_mean_over_the_open_shutter() {
    let folder = tempfile::tempdir().unwrap();
    // A breath that is held: what moves is the scope.
    let mut held = case();
    held.waveform = Waveform { amplitude: 1e-9, offset: 0.5, ..held.waveform };
    held.scope.shutter_s = 0.25;
    let settings = SimulationSettings { frames: 3, samples_per_pixel: 70, truth: Default::default(), ..small() };
    let sequence = simulate(&held, &settings, &folder.path().join("film"), &NoProgress).unwrap();
    let anatomy = airway::build(&held).unwrap();
    let look = material(&held).unwrap();
    let plan = Film::plan(&held, &anatomy, &settings, &look).unwrap();
    let vertices = mesh::interpolate(&anatomy.inspiration.vertices, &anatomy.expiration.vertices, 0.5);
    let mut scene = Scene::new(&anatomy.inspiration, &anatomy.vertex_generation, look, held.seed).unwrap();
    scene.deform(&vertices).unwrap();
    let light = Light { emission_exponent: 1.0, ..Light::at_camera(held.light_intensity) };
    // The same seven moments, unfiltered, many other random numbers.
    let still = |time_s: f64, samples_per_pixel: u32| {
        let render_settings = RenderSettings {
            samples_per_pixel,
            // What noise lies on the tissue follows from the seed, the camera's samples from the frame's number.
            transport: Transport::VERTICES,
            shading: Shading::Smooth,
            seed: held.seed,
            frame: 77,
            ..RenderSettings::default()
        };
        render(&scene, &plan.camera, &plan.state_at(time_s).0, &light, &render_settings).unwrap().radiance.data
    };
    let time_s = plan.frames[1].time_s;
    let mut mean = vec![0.0f32; 32 * 32 * 3];
    for moment in 0..7 {
        let at = still(time_s + 0.25 * ((moment as f64 + 0.5) / 7.0 - 0.5), 200);
        mean.iter_mut().zip(&at).for_each(|(m, v)| *m += v / 7.0);
    }
    let blurred = exr::read(&sequence.root.join("radiance/000001.exr")).unwrap().data;
    let error = |a: &[f32], b: &[f32]| {
        let square: f64 = a.iter().zip(b).map(|(x, y)| (x - y).powi(2) as f64).sum();
        let norm: f64 = b.iter().map(|y| y.powi(2) as f64).sum();
        (square / norm).sqrt()
    };
    let (of_mean, of_still) = (error(&blurred, &mean), error(&still(time_s, 640), &mean));
    assert!(of_mean < 0.04 && of_mean < 0.6 * of_still, "{of_mean} from the mean, a still image is {of_still} from it");

    // The truth says how far the picture moved: points of the wall at the pixel centres, seen from the way's two ends.
    let depth = sequence.depth_mm(1).unwrap();
    let pose = sequence.frames[1].world_from_camera;
    let mut ways: Vec<f64> = Vec::new();
    for (pixel, &z) in depth.data.iter().enumerate() {
        let ray = plan.camera.direction(DVec2::new((pixel % 32) as f64 + 0.5, (pixel / 32) as f64 + 0.5));
        let point = pose.transform_point3(ray * (z as f64 / ray.z));
        let [a, b] = [-0.125, 0.125]
            .map(|offset| plan.camera.project(plan.state_at(time_s + offset).0.inverse().transform_point3(point)));
        ways.extend(a.zip(b).map(|(a, b)| a.distance(b)));
    }
    ways.sort_by(f64::total_cmp);
    let (told, seen) = (columns(&sequence)["blur_px"][1], ways[ways.len() / 2]);
    assert!(seen > 1.0 && (told / seen - 1.0).abs() < 0.1, "{told} px told, {seen} px seen");
}
