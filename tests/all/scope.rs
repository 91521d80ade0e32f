//! The scope's imperfections against closed forms and against published formulas.

use std::f64::consts::PI;

use std::fs;
use std::path::Path;

use glam::{DAffine3, DVec2, DVec3};
use respire_bench::airway::case::{Case, Effect, ScopeSettings};
use respire_bench::base::statistics::upper_median;
use respire_bench::base::{Camera, NoProgress, TriangleMesh};
use respire_bench::formats::{exr, png};
use respire_bench::render::probe::probe;
use respire_bench::render::{Light, Material, RenderSettings, Scene, render};
use respire_bench::score::{ScoreSettings, score};
use respire_bench::simulate::sequence::{FRAMES, MASK, Sequence, radiance_name};
use respire_bench::simulate::{MeshOutput, RadianceOutput, SimulationSettings, simulate};

use crate::own_tracer::{DARK, Wall, dark_wall, differs, direction, image_point};
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

/// A case with every effect at work, on a wall whose light takes no walks under it.
fn everything() -> Case {
    let mut case = case();
    case.material = toml::from_str("kind = \"lambert\"\nalbedo = [0.6, 0.3, 0.25]").unwrap();
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
            Effect::Steering => zero("off_route_mm"),
            Effect::Mask => zero("mask_radius_px") && !without.root.join("mask.png").exists(),
        };
        assert!(told, "frames.csv does not tell that {} is off", effect.name());
    }
}

/// A case whose light is a closed form: a dark Lambert wall, seen through a fisheye, noise off.
pub fn dark_case() -> Case {
    let mut case = case().without(&[Effect::ShotNoise, Effect::ReadNoise, Effect::WhiteBalance, Effect::GainDrift]);
    case.material = dark_wall();
    case.camera.fisheye = Some([-0.03, 0.002, 0.0, 0.0]);
    case
}

/// The power of the cosine by which the light falls off, from where it is half as bright.
pub fn exponent(case: &Case) -> f64 {
    0.5f64.ln() / case.scope.emission_half_angle_deg.to_radians().cos().ln()
}

fn dark_film(frames: usize, frames_per_second: f64) -> SimulationSettings {
    SimulationSettings {
        width_px: 24,
        height_px: 24,
        frames,
        frames_per_second,
        samples_per_pixel: 210,
        meshes: MeshOutput::EndStates,
        radiance: RadianceOutput::Exr,
        ..small()
    }
}

/// Red radiance over (albedo x intensity / pi).
fn relative_radiance(sequence: &Sequence, frame: usize, intensity: f64) -> Vec<f64> {
    let image = exr::read(&sequence.root.join(radiance_name(frame))).unwrap();
    image.data.iter().step_by(3).map(|&v| f64::from(v) * PI / (DARK[0] * intensity)).collect()
}

#[test]
fn the_film_is_that_of_a_renderer_that_shares_nothing_with_ours() {
    let folder = tempfile::tempdir().unwrap();
    let case = dark_case();
    let sequence = simulate(&case, &dark_film(3, 2.0), &folder.path().join("film"), &NoProgress).unwrap();
    let (rest, other) = (sequence.inspiration().unwrap(), sequence.expiration().unwrap());
    for (index, frame) in sequence.frames.iter().enumerate() {
        let wall = Wall::between(&rest.vertices, &other.vertices, frame.phase, &rest.faces);
        let expected = wall.picture(&sequence.camera, &frame.world_from_camera, exponent(&case), 4);
        let found = relative_radiance(&sequence, index, case.light_intensity[0]);
        let (rms, ratio) = differs(&found, &expected);
        // The other walls' light adds less than half a percent; 16 points and 210 samples of a pixel differ a little.
        assert!(rms < 0.03 && (0.995..1.01).contains(&ratio), "frame {index}: {rms}, mean {ratio}");
        // Vignette (1 - strength (1 - cos^4)), gain and sRGB (IEC 61966-2-1) make the 8-bit picture from the radiance.
        let radiance = exr::read(&sequence.root.join(radiance_name(index))).unwrap();
        let picture = sequence.image(index).unwrap();
        for (pixel, values) in picture.data.chunks_exact(3).enumerate() {
            let (x, y) = ((pixel % 24) as f64 + 0.5, (pixel / 24) as f64 + 0.5);
            let lens = 1.0 - case.scope.vignette * (1.0 - direction(&sequence.camera, x, y).z.powi(4));
            for c in 0..3 {
                let v = (f64::from(radiance.data[3 * pixel + c]) * frame.gain * lens).clamp(0.0, 1.0);
                let encoded = if v <= 0.0031308 { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 };
                let off = (f64::from(values[c]) - 255.0 * encoded).abs();
                assert!(off <= 0.51, "frame {index}, pixel {pixel}: {off} levels off");
            }
        }
    }
}

#[test]
fn automatic_exposure_follows_the_brightness_of_the_linear_picture() {
    let folder = tempfile::tempdir().unwrap();
    let mut case = dark_case();
    case.exposure.lag_s = 0.0;
    // A whole way: near walls and deep lumens.
    let sequence = simulate(&case, &dark_film(8, 0.5), &folder.path().join("film"), &NoProgress).unwrap();
    let mut wanted = Vec::new();
    for (index, _) in sequence.frames.iter().enumerate() {
        let radiance = exr::read(&sequence.root.join(radiance_name(index))).unwrap();
        let brightness = |log_gain: f64| {
            let encoded = |(i, &v): (usize, &f32)| {
                let (x, y) = ((i / 3 % 24) as f64 + 0.5, (i / 72) as f64 + 0.5);
                let lens = 1.0 - case.scope.vignette * (1.0 - direction(&sequence.camera, x, y).z.powi(4));
                let v = (f64::from(v) * log_gain.exp() * lens).clamp(0.0, 1.0);
                if v <= 0.0031308 { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 }
            };
            radiance.data.iter().enumerate().map(encoded).sum::<f64>() / radiance.data.len() as f64
        };
        let (mut low, mut high) = (-20.0, 40.0);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if brightness(middle) < case.exposure.target { low = middle } else { high = middle }
        }
        wanted.push(low);
    }
    // The gain stays within a factor of 8 of the film's middle one: a wall beside the lens would want less.
    let limit = 8f64.ln();
    let middle = upper_median(wanted.iter().copied()).unwrap();
    let limited = wanted.iter().map(|log_gain| log_gain.clamp(middle - limit, middle + limit));
    let ratios: Vec<f64> = sequence.frames.iter().zip(limited).map(|(f, log_gain)| f.gain / log_gain.exp()).collect();
    let middle = upper_median(ratios.iter().copied()).unwrap();
    println!("gain over that of the finished picture: {ratios:?}");
    // The proxy knows neither smooth normals nor the light of other walls, and has four rays a pixel here.
    assert!((0.95..1.05).contains(&middle), "{ratios:?}");
    assert!(ratios.iter().all(|r| (r / middle).ln().abs() < 0.06), "{ratios:?}");
    let gains: Vec<f64> = sequence.frames.iter().map(|f| f.gain.ln()).collect();
    let spread = gains.iter().copied().fold(f64::MIN, f64::max) - gains.iter().copied().fold(f64::MAX, f64::min);
    assert!(spread > 0.7, "the scene's brightness hardly changes: {spread}");
}

#[test]
fn a_blurred_frame_is_the_mean_over_the_open_shutter() {
    let folder = tempfile::tempdir().unwrap();
    let mut open = dark_case();
    open.scope.shutter_s = 0.25;
    let blurred = simulate(&open, &dark_film(3, 4.0), &folder.path().join("blurred"), &NoProgress).unwrap();
    // The seven moments of the second frame (at 7/28 s, from 1/8 to 3/8 s) are frames 4 to 10 of a film of 28 frames a second.
    let still = SimulationSettings { samples_per_pixel: 1, ..dark_film(15, 28.0) };
    let moments = simulate(&dark_case(), &still, &folder.path().join("still"), &NoProgress).unwrap();
    assert!(moments.frames[7].world_from_camera.abs_diff_eq(blurred.frames[1].world_from_camera, 1e-9));
    let (rest, other) = (moments.inspiration().unwrap(), moments.expiration().unwrap());
    let picture = |frame: usize, side: u32| {
        let state = &moments.frames[frame];
        let wall = Wall::between(&rest.vertices, &other.vertices, state.phase, &rest.faces);
        wall.picture(&moments.camera, &state.world_from_camera, exponent(&open), side)
    };
    let mut mean = vec![0.0; 24 * 24];
    for frame in 4..=10 {
        mean.iter_mut().zip(picture(frame, 2)).for_each(|(m, v)| *m += v / 7.0);
    }
    let found = relative_radiance(&blurred, 1, open.light_intensity[0]);
    let ((rms, ratio), (from_still, _)) = (differs(&found, &mean), differs(&picture(7, 4), &mean));
    assert!(rms < 0.03 && (0.99..1.01).contains(&ratio), "{rms} from the mean over the shutter, ratio {ratio}");
    assert!(rms < 0.6 * from_still, "{rms}; a still picture is {from_still} from it");

    // The truth says how far the picture moves between the shutter's opening and closing: tissue at the pixel centres at
    // the frame's time, followed by its triangle. 1/8 s and 3/8 s lie midway between frames 3 and 4, 10 and 11.
    let now = Wall::between(&rest.vertices, &other.vertices, moments.frames[7].phase, &rest.faces);
    let shapes: Vec<Wall> = [3, 4, 10, 11]
        .map(|f| Wall::between(&rest.vertices, &other.vertices, moments.frames[f as usize].phase, &rest.faces))
        .into();
    let mut ways: Vec<f64> = Vec::new();
    for pixel in 0..24 * 24 {
        let pose = moments.frames[7].world_from_camera;
        let ray = direction(&moments.camera, f64::from(pixel % 24) + 0.5, f64::from(pixel / 24) + 0.5);
        let met = now.meet(pose.translation, pose.matrix3 * ray).unwrap();
        let [a, b, c, d] = [0, 1, 2, 3].map(|k| {
            let pose = moments.frames[[3, 4, 10, 11][k]].world_from_camera;
            image_point(&moments.camera, pose.inverse().transform_point3(shapes[k].point(met)))
        });
        ways.push((0.5 * (c.0 + d.0 - a.0 - b.0)).hypot(0.5 * (c.1 + d.1 - a.1 - b.1)));
    }
    ways.sort_by(f64::total_cmp);
    let (told, seen) = (columns(&blurred)["blur_px"][1], ways[ways.len() / 2]);
    assert!(seen > 0.5 && (told / seen - 1.0).abs() < 0.1, "{told} px told, {seen} px seen");
}

#[test]
fn what_the_mask_hides_counts_in_no_metric() {
    let folder = tempfile::tempdir().unwrap();
    let settings = SimulationSettings { width_px: 48, height_px: 48, frames: 2, ..tiny() };
    let masked = simulate(&everything(), &settings, &folder.path().join("film"), &NoProgress).unwrap();
    let mask = masked.mask().unwrap().expect("the scope has a mask");
    let file = png::read_rgb(&masked.root.join(MASK)).unwrap();
    let hidden = file.data.iter().step_by(3).filter(|v| **v == 0).count();
    assert!(hidden > 300 && mask.count() < 48 * 48 - hidden, "one pixel at the rim does not count either");
    // A prediction that is a little off everywhere, and three that differ where nobody looks.
    let predict = |name: &str, outside: u8| {
        let root = folder.path().join(name);
        for frame in 0..2 {
            let mut image = masked.image(frame).unwrap();
            image.data.iter_mut().enumerate().for_each(|(i, v)| *v = v.saturating_add((i % 7) as u8));
            let mut depth = masked.depth_mm(frame).unwrap();
            depth.data.iter_mut().for_each(|d| *d *= 1.1);
            for p in (0..48 * 48).filter(|&p| !mask.shows(p)) {
                image.pixel_mut(p % 48, p / 48).fill(outside.wrapping_mul(p as u8));
                depth.pixel_mut(p % 48, p / 48)[0] = f32::from(outside);
            }
            png::write_rgb(&root.join(format!("color/{frame:06}.png")), &image).unwrap();
            exr::write_depth(&root.join(format!("depth/{frame:06}.exr")), &depth).unwrap();
        }
        score(&masked, &root, &ScoreSettings::default()).unwrap()
    };
    let first = predict("first", 0);
    for id in ["psnr_db", "ssim", "ssim_padded", "depth_rmse_mm"] {
        assert!(first.value(id).is_some(), "{id}");
    }
    for (name, outside) in [("second", 255), ("third", 91)] {
        assert_eq!(predict(name, outside).metrics, first.metrics, "{name}");
    }
    let whole = simulate(&everything().without(&[Effect::Mask]), &settings, &folder.path().join("whole"), &NoProgress);
    assert_eq!(whole.unwrap().mask().unwrap(), None);
}
