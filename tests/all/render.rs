//! The path tracer against closed forms, and against three renderers that we did not write (`shared/reference`).

use std::f64::consts::PI;

use glam::{DAffine3, DVec3};
use rayon::ThreadPoolBuilder;
use respire_bench::base::camera::world_from_camera_looking;
use respire_bench::base::random::{CounterRng, Stage};
use respire_bench::base::{Camera, Image, TriangleMesh};
use respire_bench::ffi::trace::tracer::{coat_albedo, sobol_pair};
use respire_bench::render::{Denoise, Light, Material, RenderSettings, Scene, Shading, Subsurface, render};

use crate::reference::{Reference, block_errors, relative_mse};

pub const RHO: [f64; 3] = [0.75, 0.40, 0.35];

/// Icosphere of radius 1 with normals to the inside.
pub fn sphere(subdivisions: u32) -> TriangleMesh {
    let t = (1.0 + 5f64.sqrt()) / 2.0;
    let mut mesh = TriangleMesh::default();
    for (a, b) in [(-1.0, t), (1.0, t), (-1.0, -t), (1.0, -t)] {
        mesh.vertices.extend([DVec3::new(a, b, 0.0), DVec3::new(0.0, a, b), DVec3::new(b, 0.0, a)]);
    }
    // Faces of the hull: triples at edge length from each other.
    for a in 0..12u32 {
        for b in a + 1..12 {
            for c in b + 1..12 {
                let p = [a, b, c].map(|v| mesh.vertices[v as usize]);
                if [(0, 1), (1, 2), (2, 0)]
                    .iter()
                    .all(|&(i, j)| (p[i as usize].distance(p[j as usize]) - 2.0).abs() < 1e-9)
                {
                    let inward = (p[1] - p[0]).cross(p[2] - p[0]).dot(p[0]) < 0.0;
                    mesh.faces.push(if inward { [a, b, c] } else { [a, c, b] });
                }
            }
        }
    }
    assert_eq!(mesh.faces.len(), 20);
    for _ in 0..subdivisions {
        let mut middles = std::collections::BTreeMap::new();
        let mut faces = Vec::new();
        for &[a, b, c] in &mesh.faces {
            let [ab, bc, ca] = [(a, b), (b, c), (c, a)].map(|(i, j)| {
                *middles.entry((i.min(j), i.max(j))).or_insert_with(|| {
                    mesh.vertices.push((mesh.vertices[i as usize] + mesh.vertices[j as usize]) * 0.5);
                    mesh.vertices.len() as u32 - 1
                })
            });
            faces.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
        }
        mesh.faces = faces;
    }
    mesh.vertices.iter_mut().for_each(|v| *v = v.normalize());
    mesh
}

pub fn scaled(mut mesh: TriangleMesh, radius: f64) -> TriangleMesh {
    mesh.vertices.iter_mut().for_each(|v| *v *= radius);
    mesh
}

pub fn mean(image: &Image<f32>) -> [f64; 3] {
    let mut sum = [0.0; 3];
    for pixel in image.data.chunks_exact(3) {
        (0..3).for_each(|c| sum[c] += pixel[c] as f64);
    }
    sum.map(|v| v / (image.width * image.height) as f64)
}

fn assert_ratio(what: &str, found: [f64; 3], expected: [f64; 3], tolerance: f64) {
    for c in 0..3 {
        let ratio = found[c] / expected[c];
        assert!((ratio - 1.0).abs() < tolerance, "{what}, channel {c}: {} for {}: {ratio}", found[c], expected[c]);
    }
}

#[test]
fn closed_sphere_with_a_lamp_at_its_centre() {
    let (radius, intensity) = (5.0, 100.0);
    let scene = Scene::new(&scaled(sphere(5), radius), &[], Material::lambert(RHO), 1).unwrap();
    let camera = Camera::pinhole(32, 32, 1.2);
    let pose = DAffine3::from_translation(DVec3::ZERO);
    for n in [1, 2, 6, 0] {
        let settings = RenderSettings { max_scatterings: n, samples_per_pixel: 64, ..RenderSettings::default() };
        let frame = render(&scene, &camera, &pose, &Light::at_camera([intensity; 3]), &settings).unwrap();
        let series = |rho: f64| match n {
            0 => rho / (1.0 - rho),
            n => (1..=n).map(|k| rho.powi(k as i32)).sum::<f64>(),
        };
        let expected = RHO.map(|rho| intensity / (PI * radius * radius) * series(rho));
        assert_ratio(&format!("{n} scatterings"), mean(&frame.radiance), expected, if n == 1 { 5e-4 } else { 4e-3 });
        assert_eq!(frame.statistics.rejected_samples, 0);
    }
}

#[test]
fn lamp_away_from_the_camera_lights_the_same_sphere() {
    let scene = Scene::new(&scaled(sphere(4), 5.0), &[], Material::lambert(RHO), 1).unwrap();
    let camera = Camera::pinhole(24, 24, 1.2);
    let pose = DAffine3::from_translation(DVec3::new(2.0, -1.0, 0.5));
    let light = Light { intensity: [100.0; 3], position_mm: Some(DVec3::ZERO), emission_exponent: 0.0 };
    let settings = RenderSettings { max_scatterings: 1, samples_per_pixel: 8, ..RenderSettings::default() };
    let frame = render(&scene, &camera, &pose, &light, &settings).unwrap();
    assert_ratio("direct", mean(&frame.radiance), RHO.map(|rho| 100.0 * rho / (PI * 25.0)), 2e-3);
}

/// A square of side 200 mm at z = `distance`.
pub fn plane(distance: f64) -> TriangleMesh {
    let corner = |x: f64, y: f64| DVec3::new(x * 100.0, y * 100.0, distance);
    TriangleMesh {
        vertices: vec![corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)],
        faces: vec![[0, 2, 1], [0, 3, 2]],
    }
}

#[test]
fn lit_plane_follows_the_inverse_square_law() {
    for distance in [5.0, 10.0, 20.0, 40.0] {
        let scene = Scene::new(&plane(distance), &[], Material::lambert(RHO), 1).unwrap();
        // One pixel row of a narrow camera that looks at a slant: closed form per pixel centre, tiny pixels.
        let camera = Camera { cx: -300.0, ..Camera::pinhole(8, 8, 0.02) };
        let settings = RenderSettings { max_scatterings: 1, samples_per_pixel: 4, ..RenderSettings::default() };
        let frame = render(&scene, &camera, &DAffine3::IDENTITY, &Light::at_camera([400.0; 3]), &settings).unwrap();
        for y in 0..8 {
            for x in 0..8 {
                let direction = camera.direction(glam::DVec2::new(x as f64 + 0.5, y as f64 + 0.5));
                let r2 = (direction * distance).length_squared();
                let expected = RHO.map(|rho| rho / PI * 400.0 * (distance / r2.sqrt()) / r2);
                let found: Vec<f64> = frame.radiance.pixel(x, y).iter().map(|&v| v as f64).collect();
                assert_ratio("plane", [found[0], found[1], found[2]], expected, 1e-3);
                let depth = frame.depth_mm.pixel(x, y)[0] as f64;
                assert!((depth - distance).abs() < 1e-4 * distance, "{depth} for {distance}");
            }
        }
    }
}

/// Seen from far away, a point's place is rounded by more than shadow rays start above the wall.
#[test]
fn a_wall_is_as_bright_from_metres_away() {
    let light = Light { intensity: [400.0; 3], position_mm: Some(DVec3::new(0.0, 0.0, -50.0)), emission_exponent: 0.0 };
    let settings = RenderSettings { max_scatterings: 1, samples_per_pixel: 16, ..RenderSettings::default() };
    let scene = Scene::new(&plane(0.0), &[], Material::lambert(RHO), 1).unwrap();
    for distance in [100.0f64, 1_000.0, 5_000.0, 9_000.0] {
        // A pixel of .25 mm.
        let camera = Camera::pinhole(4, 4, 2.0 * (0.5 / distance).atan());
        let pose = DAffine3::from_translation(DVec3::new(0.0, 0.0, -distance));
        let frame = render(&scene, &camera, &pose, &light, &settings).unwrap();
        let expected = RHO.map(|rho| rho / PI * 400.0 / 2500.0);
        assert_ratio(&format!("from {distance} mm"), mean(&frame.radiance), expected, 1e-3);
    }
}

#[test]
fn white_furnace_gives_back_what_comes_in() {
    let ball = {
        let mut outward = sphere(4);
        outward.flip();
        outward
    };
    let pose = world_from_camera_looking(DVec3::new(0.0, 0.0, -4.0), DVec3::Z, DVec3::NEG_Y);
    let camera = Camera::pinhole(32, 32, 0.55);
    for material in
        [Material::lambert([1.0; 3]), Material::coated([1.0; 3], 0.15, 1.4), Material::coated([1.0; 3], 0.5, 1.4)]
    {
        let settings = RenderSettings { samples_per_pixel: 256, background: [1.0; 3], ..RenderSettings::default() };
        let scene = Scene::new(&ball, &[], material, 1).unwrap();
        let frame = render(&scene, &camera, &pose, &Light::at_camera([0.0; 3]), &settings).unwrap();
        assert_ratio(&format!("furnace {:?}", material.kind), mean(&frame.radiance), [1.0; 3], 3e-3);
        let worst = frame.radiance.data.iter().map(|v| (v - 1.0).abs()).fold(0.0, f32::max);
        assert!(worst < 0.25, "{worst}");
    }
}

#[test]
fn depth_of_a_cylinder_seen_along_its_axis_is_the_closed_form() {
    let (radius, around) = (6.0, 4096u32);
    let mut tube = TriangleMesh::default();
    for a in 0..around {
        let angle = a as f64 / around as f64 * 2.0 * PI;
        for z in [-10.0, 200.0] {
            tube.vertices.push(DVec3::new(radius * angle.cos(), radius * angle.sin(), z));
        }
        let (p, q) = (2 * a, 2 * ((a + 1) % around));
        tube.faces.extend([[p, p + 1, q], [q, p + 1, q + 1]]);
    }
    let scene = Scene::new(&tube, &[], Material::lambert(RHO), 1).unwrap();
    let pinhole = Camera::pinhole(40, 40, 1.9);
    let fisheye = Camera { fisheye: Some([0.01, -0.002, 0.0, 0.0]), ..pinhole };
    for camera in [pinhole, fisheye] {
        let settings = RenderSettings { max_scatterings: 1, samples_per_pixel: 1, ..RenderSettings::default() };
        let frame = render(&scene, &camera, &DAffine3::IDENTITY, &Light::at_camera([1.0; 3]), &settings).unwrap();
        for y in 0..40 {
            for x in 0..40 {
                let d = camera.direction(glam::DVec2::new(x as f64 + 0.5, y as f64 + 0.5));
                let expected = radius * d.z / d.x.hypot(d.y);
                let depth = frame.depth_mm.pixel(x, y)[0] as f64;
                if expected <= 0.0 {
                    assert_eq!(depth, 0.0, "beside the lens at {x} {y}");
                } else if expected < 199.0 {
                    assert!((depth / expected - 1.0).abs() < 2e-5, "{depth} for {expected} at {x} {y}");
                }
            }
        }
    }
}

/// Image means and medians of 16x16 blocks against another renderer's image of the reference tube.
fn compare_with_reference(material: Material, max_scatterings: u32, samples: u32, file: &str, block_median: f64) {
    let Some(reference) = Reference::open("reference/pathtrace") else { return };
    let (Some(mesh), Some(expected)) = (reference.mesh("tube.ply"), reference.npy_rgb(&format!("refs/{file}"))) else {
        return;
    };
    let scene = Scene::new(&mesh, &[], material, 1).unwrap();
    let (camera, pose) = tube_camera();
    let settings = RenderSettings { max_scatterings, samples_per_pixel: samples, ..RenderSettings::default() };
    let frame = render(&scene, &camera, &pose, &Light::at_camera([400.0; 3]), &settings).unwrap();
    assert_eq!(frame.statistics.rejected_samples, 0);
    assert!(frame.radiance.data.iter().all(|v| v.is_finite() && *v >= 0.0));
    assert_ratio(file, mean(&frame.radiance), mean(&expected), 5e-3);
    let mut errors = block_errors(&frame.radiance, &expected, 16);
    errors.sort_by(f64::total_cmp);
    let median = errors[errors.len() / 2];
    assert!(median < block_median, "{file}: median block error {median}");
}

pub fn tube_camera() -> (Camera, DAffine3) {
    let origin = DVec3::new(0.4, -0.3, 0.0);
    let pose = world_from_camera_looking(origin, DVec3::new(3.0, 0.6, 40.0) - origin, DVec3::Y);
    (Camera::pinhole(256, 256, PI / 2.0), pose)
}

#[test]
fn lambert_tube_agrees_with_other_renderers() {
    compare_with_reference(Material::lambert(RHO), 6, 16, "best_M1_n6.npy", 0.008);
}

#[test]
fn lambert_tube_without_limit_agrees_with_mitsuba() {
    compare_with_reference(Material::lambert(RHO), 0, 12, "mitsuba_M1_unl.npy", 0.012);
}

#[test]
fn coated_tube_agrees_with_other_renderers() {
    compare_with_reference(Material::coated(RHO, 0.15, 1.4), 6, 16, "best_M2_n6.npy", 0.008);
}

#[test]
fn coat_albedo_is_that_of_the_reference_table() {
    let Some(reference) = Reference::open("reference/pathtrace") else { return };
    for (file, alpha) in [("data/etab_a0.15.txt", 0.15), ("data/etab_a0.0225.txt", 0.0225)] {
        let Some(text) = reference.text(file) else { return };
        let values: Vec<f32> = text.split_whitespace().filter_map(|v| v.parse().ok()).collect();
        let table = &values[values.len() - 129..];
        for k in (4..129).step_by(4) {
            let found = coat_albedo(alpha, 1.4, k as f32 / 128.0);
            assert!((found - table[k]).abs() < 1e-3, "{file}, entry {k}: {found} for {}", table[k]);
        }
    }
}

#[test]
fn filtered_image_stays_close_to_the_reference() {
    let Some(reference) = Reference::open("reference/pathtrace") else { return };
    let (Some(mesh), Some(expected)) = (reference.mesh("tube.ply"), reference.npy_rgb("refs/best_M1_n6.npy")) else {
        return;
    };
    let scene = Scene::new(&mesh, &[], Material::lambert(RHO), 1).unwrap();
    let (camera, pose) = tube_camera();
    let error = |denoise| {
        let settings =
            RenderSettings { max_scatterings: 6, samples_per_pixel: 4, denoise, ..RenderSettings::default() };
        let frame = render(&scene, &camera, &pose, &Light::at_camera([400.0; 3]), &settings).unwrap();
        assert_ratio("filtered", mean(&frame.radiance), mean(&expected), 6e-3);
        relative_mse(&frame.radiance, &expected)
    };
    let (raw, filtered) = (error(Denoise::Off), error(Denoise::On));
    assert!(filtered < 0.007 && filtered < raw / 15.0, "raw {raw}, filtered {filtered}");
}

/// A bent, bumpy tube: closed enough for light to run around in.
pub fn small_tube() -> TriangleMesh {
    tube(48, 60)
}

/// The same in other resolutions: vertices around and rings along its 60 mm.
pub fn tube(around: u32, along: u32) -> TriangleMesh {
    let mut mesh = TriangleMesh::default();
    for k in 0..=along {
        for a in 0..around {
            let (z, angle) = (k as f64 * 60.0 / along as f64 - 5.0, a as f64 / around as f64 * 2.0 * PI);
            let radius = 5.0 + 0.3 * (z * 1.3).sin() + 0.2 * (3.0 * angle).cos();
            mesh.vertices.push(DVec3::new(radius * angle.cos() + 0.003 * z * z, radius * angle.sin(), z));
        }
    }
    for k in 0..along {
        for a in 0..around {
            let (p, q) = (k * around + a, k * around + (a + 1) % around);
            mesh.faces.extend([[p, p + around, q], [q, p + around, q + around]]);
        }
    }
    mesh
}

#[test]
fn image_does_not_depend_on_the_number_of_threads_and_does_on_the_frame() {
    let scene = Scene::new(&small_tube(), &[], Material::default(), 7).unwrap();
    let camera = Camera::pinhole(50, 38, 1.7);
    let picture = |threads: usize, frame: u64, denoise| {
        let settings = RenderSettings {
            samples_per_pixel: 5,
            frame,
            denoise,
            shading: Shading::Smooth,
            ..RenderSettings::default()
        };
        let pool = ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let light = Light::at_camera([100.0; 3]);
        pool.install(|| render(&scene, &camera, &DAffine3::IDENTITY, &light, &settings)).unwrap()
    };
    for denoise in [Denoise::Off, Denoise::On] {
        let one = picture(1, 0, denoise);
        for threads in [2, 3] {
            let other = picture(threads, 0, denoise);
            assert_eq!(one.radiance, other.radiance);
            assert_eq!(one.depth_mm, other.depth_mm);
        }
        assert_ne!(one.radiance, picture(2, 1, denoise).radiance);
        assert_eq!(one.statistics.rejected_samples, 0);
        assert!(one.radiance.data.iter().all(|v| v.is_finite() && *v >= 0.0));
    }
}

#[test]
fn refitted_scene_is_the_rebuilt_scene() {
    let rest = small_tube();
    let mut moved = rest.clone();
    moved
        .vertices
        .iter_mut()
        .for_each(|v| *v += DVec3::new(0.4 * (v.z * 0.2).sin(), 0.3 * (v.z * 0.1).cos(), 0.02 * v.z));
    let mut refitted = Scene::new(&rest, &[], Material::lambert(RHO), 1).unwrap();
    refitted.deform(&moved.vertices).unwrap();
    let rebuilt = Scene::new(&moved, &[], Material::lambert(RHO), 1).unwrap();
    let (origins, directions) = rays_from_inside(20_000);
    let (a, b) =
        (refitted.distances(&origins, &directions).unwrap(), rebuilt.distances(&origins, &directions).unwrap());
    for (a, b) in a.iter().zip(&b) {
        assert!(a == b || (a / b - 1.0).abs() < 1e-5, "{a} and {b}");
    }
    assert!(refitted.deform(&moved.vertices[1..]).is_err());
    moved.vertices[3].y = f64::INFINITY;
    assert!(refitted.deform(&moved.vertices).unwrap_err().to_string().contains("vertex 3"));
}

#[test]
fn picture_does_not_depend_on_the_shapes_before() {
    // A resumed sequence deforms the scene straight to the frame where it goes on.
    let rest = small_tube();
    let shape = |k: f64| -> Vec<DVec3> {
        rest.vertices.iter().map(|&v| v + DVec3::new(0.5 * k * (v.z * 0.2).sin(), 0.3 * k, 0.05 * k * v.z)).collect()
    };
    let camera = Camera::pinhole(48, 40, 1.7);
    let settings = RenderSettings { samples_per_pixel: 4, shading: Shading::Smooth, ..RenderSettings::default() };
    let picture = |shapes: &[f64]| {
        let mut scene = Scene::new(&rest, &[], Material::default(), 7).unwrap();
        shapes.iter().for_each(|&k| scene.deform(&shape(k)).unwrap());
        render(&scene, &camera, &DAffine3::IDENTITY, &Light::at_camera([100.0; 3]), &settings).unwrap()
    };
    let history: Vec<f64> = (0..20).map(|k| (k as f64 * 0.7).sin()).chain([0.6]).collect();
    let (long, short) = (picture(&history), picture(&[0.6]));
    assert_eq!(long.radiance, short.radiance);
    assert_eq!(long.depth_mm, short.depth_mm);
}

fn rays_from_inside(count: usize) -> (Vec<DVec3>, Vec<DVec3>) {
    let mut rng = CounterRng::new(3, Stage::Test, &[]);
    (0..count)
        .map(|_| {
            let origin = DVec3::new(0.5 * rng.normal(), 0.5 * rng.normal(), rng.range(1.0, 8.0));
            (origin, DVec3::new(rng.normal(), rng.normal(), rng.normal()).normalize())
        })
        .unzip()
}

#[test]
fn no_ray_slips_through_a_closed_wall() {
    let Some(reference) = Reference::open("reference/pathtrace") else { return };
    let Some(mesh) = reference.mesh("tube.ply") else { return };
    let scene = Scene::new(&mesh, &[], Material::lambert(RHO), 1).unwrap();
    let (origins, directions) = rays_from_inside(1_000_000);
    let misses = scene.distances(&origins, &directions).unwrap().iter().filter(|d| !d.is_finite()).count();
    assert_eq!(misses, 0);
}

#[test]
fn look_moves_with_the_tissue() {
    // The same rigid motion of wall and camera gives the same picture, up to the last bits of the moved coordinates.
    let material = Material { subsurface: Some(Subsurface::Off), ..Material::default() };
    let rest = small_tube();
    let mut scene = Scene::new(&rest, &[], material, 7).unwrap();
    let camera = Camera::pinhole(48, 48, 1.7);
    let settings = RenderSettings { max_scatterings: 1, samples_per_pixel: 4, ..RenderSettings::default() };
    let light = Light::at_camera([100.0; 3]);
    let still = render(&scene, &camera, &DAffine3::IDENTITY, &light, &settings).unwrap();
    let motion = DAffine3::from_axis_angle(DVec3::new(1.0, 2.0, 0.5).normalize(), 0.7)
        * DAffine3::from_translation(DVec3::new(3.0, -2.0, 9.0));
    let moved: Vec<DVec3> = rest.vertices.iter().map(|&v| motion.transform_point3(v)).collect();
    scene.deform(&moved).unwrap();
    let carried = render(&scene, &camera, &motion, &light, &settings).unwrap();
    let mut differences: Vec<f32> =
        still.radiance.data.iter().zip(&carried.radiance.data).map(|(a, b)| (a - b).abs() / (a + 1e-3)).collect();
    differences.sort_by(f32::total_cmp);
    assert!(differences[differences.len() * 95 / 100] < 0.01, "{:?}", &differences[differences.len() - 10..]);
    // And the look is there: neighbouring pixels of the wall differ in colour, not only in brightness.
    let hues: Vec<f32> = still.radiance.data.chunks_exact(3).map(|p| p[1] / p[0]).filter(|h| h.is_finite()).collect();
    let average = hues.iter().sum::<f32>() / hues.len() as f32;
    let spread = (hues.iter().map(|h| (h - average).powi(2)).sum::<f32>() / hues.len() as f32).sqrt();
    assert!(spread > 0.03, "hue spread {spread}");
}

#[test]
fn sampling_goes_on_until_the_target_is_met() {
    let scene = Scene::new(&small_tube(), &[], Material::lambert(RHO), 7).unwrap();
    let camera = Camera::pinhole(32, 32, 1.7);
    let picture = |target_relmse, samples_per_pixel| {
        let settings = RenderSettings { target_relmse, samples_per_pixel, ..RenderSettings::default() };
        render(&scene, &camera, &DAffine3::IDENTITY, &Light::at_camera([100.0; 3]), &settings).unwrap()
    };
    let truth = picture(None, 768);
    let coarse = picture(Some(0.02), 4);
    let fine = picture(Some(0.002), 4);
    assert!(coarse.statistics.samples_per_pixel < fine.statistics.samples_per_pixel);
    let error = relative_mse(&fine.radiance, &truth.radiance);
    assert!(error < 0.004 && error > 0.0002, "{error}");
    // Tiles that are good enough get no more: the same error costs less than with as many samples everywhere.
    let even = |spp| relative_mse(&picture(None, spp).radiance, &truth.radiance);
    let as_good = (2..10).map(|k| 1 << k).find(|&spp| even(spp) <= error).unwrap_or(1024);
    println!("adaptive {} samples per pixel, even {as_good}", fine.statistics.samples_per_pixel);
    assert!(fine.statistics.samples_per_pixel < as_good);
}

#[test]
fn sample_points_fill_every_elementary_interval_once() {
    for (key, dimension) in [(1u32, 0u32), (77, 3), (123_456, 10)] {
        for (columns, rows) in [(1, 64), (2, 32), (8, 8), (32, 2), (64, 1)] {
            let mut seen = vec![0; 64];
            for index in 0..64 {
                let [u, v] = sobol_pair(key, index, dimension);
                assert!((0.0..1.0).contains(&u) && (0.0..1.0).contains(&v));
                seen[(v * rows as f32) as usize * columns + (u * columns as f32) as usize] += 1;
            }
            assert!(seen.iter().all(|&n| n == 1), "{columns}x{rows}: {seen:?}");
        }
    }
}

#[test]
fn what_cannot_be_rendered_is_said() {
    let mesh = small_tube();
    let scene = Scene::new(&mesh, &[], Material::lambert(RHO), 1).unwrap();
    let camera = Camera::pinhole(4, 4, 1.0);
    let light = Light::at_camera([1.0; 3]);
    let good = RenderSettings::default();
    let attempt = |camera: &Camera, pose: DAffine3, light: &Light, settings: &RenderSettings| {
        render(&scene, camera, &pose, light, settings).map(|_| ())
    };
    attempt(&camera, DAffine3::IDENTITY, &light, &good).unwrap();
    assert!(attempt(&Camera { fl_x: f64::NAN, ..camera }, DAffine3::IDENTITY, &light, &good).is_err());
    let huge = Camera::pinhole(1_000_000, 1_000_000, 1.0);
    assert!(attempt(&huge, DAffine3::IDENTITY, &light, &good).unwrap_err().to_string().contains("too large"));
    assert!(attempt(&camera, DAffine3::from_scale(DVec3::splat(2.0)), &light, &good).is_err());
    assert!(attempt(&camera, DAffine3::IDENTITY, &Light::at_camera([-1.0; 3]), &good).is_err());
    assert!(attempt(&camera, DAffine3::IDENTITY, &light, &RenderSettings { samples_per_pixel: 0, ..good }).is_err());
    assert!(Scene::new(&mesh, &[0.0; 3], Material::default(), 1).is_err());
    let mut broken = mesh.clone();
    broken.vertices[9].x = f64::NAN;
    let message = Scene::new(&broken, &[], Material::default(), 1).err().expect("NaN is refused").to_string();
    assert!(message.contains("vertex 9"), "{message}");
}
