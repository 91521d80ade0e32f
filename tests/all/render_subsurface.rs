//! Light in the wall against closed forms, and against renderers that we did not write (`shared/reference`).

use std::f64::consts::PI;

use glam::{DAffine3, DVec3};
use respire_bench::base::camera::world_from_camera_looking;
use respire_bench::base::{Camera, Image};
use respire_bench::ffi::trace::tracer::medium_albedo;
use respire_bench::render::{Boundary, Light, Material, RenderSettings, Scene, WalkedVertices, render};

use crate::reference::Reference;
use crate::render::{RHO, mean, plane, scaled, sphere, tube_camera};

const MEAN_FREE_PATH_MM: [f64; 3] = [1.0, 0.4, 0.25];
/// Of the reference scenes (an older fit of the inversion than ours).
const REFERENCE_SCATTERING: [f64; 3] = [0.9855396, 0.8529496, 0.8111069];

/// Mean radiance of a ball of the material (light walks inside it) in a white surrounding.
fn furnace(material: Material, radius: f64, samples_per_pixel: u32) -> [f64; 3] {
    let mut ball = scaled(sphere(5), radius);
    ball.flip();
    let scene = Scene::new(&ball, &[], material, 1).unwrap();
    let pose = world_from_camera_looking(DVec3::new(0.0, 0.0, -4.0 * radius), DVec3::Z, DVec3::NEG_Y);
    // Narrow: every pixel sees the ball.
    let camera = Camera::pinhole(32, 32, 0.3);
    let settings = RenderSettings { samples_per_pixel, background: [1.0; 3], ..RenderSettings::default() };
    let frame = render(&scene, &camera, &pose, &Light::at_camera([0.0; 3]), &settings).unwrap();
    assert_eq!(frame.statistics.rejected_samples, 0);
    mean(&frame.radiance)
}

#[test]
fn white_medium_gives_back_what_comes_in() {
    for (boundary, walk) in [
        (Boundary::Matched, WalkedVertices::Every),
        (Boundary::Diffuse, WalkedVertices::Every),
        (Boundary::Diffuse, WalkedVertices::First),
    ] {
        let material = Material::subsurface([1.0; 3], [1.0, 0.5, 0.25], boundary, walk);
        let found = furnace(material, 1.5, 64);
        // Nothing is lost, and the channels' weights do not drift.
        assert!(found.iter().all(|v| (v - 1.0).abs() < 0.01), "{boundary:?} {walk:?}: {found:?}");
    }
}

#[test]
fn thick_medium_has_the_diffuse_albedo_that_was_asked_for() {
    for albedo in [RHO, [0.95, 0.2, 0.05]] {
        let material = Material::subsurface(albedo, [0.05; 3], Boundary::Diffuse, WalkedVertices::First);
        let found = furnace(material, 50.0, 192);
        for c in 0..3 {
            // van de Hulst's fit is within 1 %, and within .002 where the albedo is small.
            let tolerance = 0.01 * albedo[c] + 0.0015;
            assert!((found[c] - albedo[c]).abs() < tolerance, "channel {c}: {} for {}", found[c], albedo[c]);
        }
    }
    // The fit itself at its ends.
    assert!(medium_albedo(0.0).abs() < 1e-3 && (medium_albedo(1.0) - 1.0).abs() < 1e-6);
}

#[test]
fn no_medium_gives_back_more_than_comes_in() {
    for boundary in [Boundary::Diffuse, Boundary::Mixed, Boundary::Matched] {
        let found = furnace(Material::subsurface([0.5; 3], [2.0, 1.0, 0.2], boundary, WalkedVertices::Every), 1.0, 64);
        assert!(found.iter().all(|&v| v > 0.3 && v < 0.99), "{boundary:?}: {found:?}");
    }
}

#[test]
fn single_scattering_of_a_half_space_is_the_closed_form() {
    // Lamp and eye at one point at distance d before an index-matched half-space: scattering at depth t below the foot
    // point sends a s / (4 pi) exp(-2 s t) I / (d + t)^2 back.
    let (distance, intensity) = (8.0, 300.0);
    let material = Material {
        single_scattering_albedo: Some([0.9, 0.7, 0.5]),
        ..Material::subsurface(RHO, MEAN_FREE_PATH_MM, Boundary::Matched, WalkedVertices::Every)
    };
    let scene = Scene::new(&plane(distance), &[], material, 1).unwrap();
    let camera = Camera::pinhole(16, 16, 0.02);
    let settings = RenderSettings { max_scatterings: 1, samples_per_pixel: 1024, ..RenderSettings::default() };
    let frame = render(&scene, &camera, &DAffine3::IDENTITY, &Light::at_camera([intensity; 3]), &settings).unwrap();
    let found = mean(&frame.radiance);
    for c in 0..3 {
        let extinction = 1.0 / MEAN_FREE_PATH_MM[c];
        let step = 1e-4;
        let integral: f64 = (0..400_000)
            .map(|k| (k as f64 + 0.5) * step)
            .map(|t| (-2.0 * extinction * t).exp() / (distance + t).powi(2) * step)
            .sum();
        let expected = [0.9, 0.7, 0.5][c] * extinction / (4.0 * PI) * intensity * integral;
        assert!((found[c] / expected - 1.0).abs() < 6e-3, "channel {c}: {} for {expected}", found[c]);
    }
}

/// Means of 16 x 16 equal parts of the image, per channel.
fn parts(image: &Image<f32>) -> Vec<[f64; 3]> {
    let side = image.width / 16;
    let part = |k: usize| {
        let (x0, y0) = (k % 16 * side, k / 16 * side);
        let pixels = (0..side * side).map(|p| image.pixel(x0 + p % side, y0 + p / side));
        pixels.fold([0.0; 3], |sum: [f64; 3], p| std::array::from_fn(|c| sum[c] + p[c] as f64))
    };
    (0..256).map(|k| part(k).map(|v| v / (side * side) as f64)).collect()
}

/// Image means within 0.5 % and three standard deviations of the noise, which is estimated from 256 parts of the
/// difference between the images; median relative difference of the parts below `part_median`.
fn compare_with_reference(material: Material, max_scatterings: u32, samples: u32, file: &str, part_median: f64) {
    let Some(reference) = Reference::open("reference/pathtrace") else { return };
    let (Some(mesh), Some(expected)) = (reference.mesh("tube.ply"), reference.npy_rgb(&format!("refs/{file}"))) else {
        return;
    };
    let scene = Scene::new(&mesh, &[], material, 1).unwrap();
    let (camera, pose) = tube_camera();
    // Half the resolution sees the same: four times fewer paths for the same mean.
    let camera = camera.scaled(0.5);
    let settings = RenderSettings { max_scatterings, samples_per_pixel: samples, ..RenderSettings::default() };
    let frame = render(&scene, &camera, &pose, &Light::at_camera([400.0; 3]), &settings).unwrap();
    assert_eq!(frame.statistics.rejected_samples, 0);
    assert!(frame.radiance.data.iter().all(|v| v.is_finite() && *v >= 0.0));
    let (ours, theirs) = (parts(&frame.radiance), parts(&expected));
    let mut relative: Vec<f64> = ours
        .iter()
        .zip(&theirs)
        .flat_map(|(a, b)| (0..3).map(|c| (a[c] / b[c] - 1.0).abs()).collect::<Vec<_>>())
        .collect();
    relative.sort_by(f64::total_cmp);
    for c in 0..3 {
        let expected = theirs.iter().map(|v| v[c]).sum::<f64>() / 256.0;
        let difference: Vec<f64> = ours.iter().zip(&theirs).map(|(a, b)| a[c] - b[c]).collect();
        let bias = difference.iter().sum::<f64>() / 256.0;
        let variance = difference.iter().map(|d| (d - bias).powi(2)).sum::<f64>() / 255.0;
        let noise = (variance / 256.0).sqrt() / expected;
        println!(
            "{file}, channel {c}: {:+.4} with noise {noise:.4}, parts' median {:.4}",
            bias / expected,
            relative[384]
        );
        // A test that is mostly noise would show nothing.
        assert!(noise < 0.005, "{file}, channel {c}: noise {noise}");
        assert!((bias / expected).abs() < 0.005 + 3.0 * noise, "{file}, channel {c}: {}", bias / expected);
    }
    assert!(relative[384] < part_median, "{file}: median {}", relative[384]);
}

fn reference_medium(boundary: Boundary, walk: WalkedVertices) -> Material {
    Material {
        single_scattering_albedo: Some(REFERENCE_SCATTERING),
        ..Material::subsurface(RHO, MEAN_FREE_PATH_MM, boundary, walk)
    }
}

#[test]
fn walk_at_the_first_vertex_agrees_with_the_reference() {
    let material = reference_medium(Boundary::Mixed, WalkedVertices::First);
    compare_with_reference(material, 6, 48, "minipt_M3c_n6.npy", 0.03);
}

#[test]
fn matched_medium_without_limit_agrees_with_the_reference() {
    let material = reference_medium(Boundary::Matched, WalkedVertices::Every);
    compare_with_reference(material, 0, 20, "minipt_M3_unl.npy", 0.04);
}

#[test]
fn matched_medium_of_32_scatterings_agrees_with_mitsuba() {
    let material = reference_medium(Boundary::Matched, WalkedVertices::Every);
    compare_with_reference(material, 32, 24, "mitsuba_M3_n32.npy", 0.04);
}
