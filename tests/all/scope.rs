//! The scope's imperfections against closed forms and against published formulas.

use std::f64::consts::PI;

use glam::{DAffine3, DVec2, DVec3};
use respire_bench::base::{Camera, TriangleMesh};
use respire_bench::render::probe::probe;
use respire_bench::render::{Light, Material, RenderSettings, Scene, render};

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
