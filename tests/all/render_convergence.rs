//! How errors fall with samples, and whether walls hold.

use glam::{DAffine3, DVec3};
use respire_bench::airway::{self, case::Case};
use respire_bench::base::random::{CounterRng, Stage};
use respire_bench::base::{Camera, Image, mesh};
use respire_bench::render::{Light, Material, RenderSettings, Scene, Shading, Subsurface, render};

use crate::own_tracer::Wall;
use crate::render::{RHO, small_tube};

/// Slope of the least-squares line through (log x, log y).
fn log_slope(points: &[(f64, f64)]) -> f64 {
    let logs: Vec<(f64, f64)> = points.iter().map(|(x, y)| (x.ln(), y.ln())).collect();
    let n = logs.len() as f64;
    let (mx, my) = (logs.iter().map(|p| p.0).sum::<f64>() / n, logs.iter().map(|p| p.1).sum::<f64>() / n);
    logs.iter().map(|(x, y)| (x - mx) * (y - my)).sum::<f64>() / logs.iter().map(|(x, _)| (x - mx).powi(2)).sum::<f64>()
}

#[test]
fn error_falls_as_the_inverse_of_the_samples() {
    let camera = Camera::pinhole(32, 32, 1.7);
    for (name, material) in [
        ("Lambert", Material::lambert(RHO)),
        ("mucosa", Material { subsurface: Some(Subsurface::Off), ..Material::default() }),
        ("mucosa, light in the wall", Material::default()),
    ] {
        let scene = Scene::new(&small_tube(), &[], material, 7).unwrap();
        let picture = |samples_per_pixel: u32, seed: u64| -> Image<f32> {
            let settings =
                RenderSettings { samples_per_pixel, seed, shading: Shading::Smooth, ..RenderSettings::default() };
            render(&scene, &camera, &DAffine3::IDENTITY, &Light::at_camera([100.0; 3]), &settings).unwrap().radiance
        };
        // Two pictures of other seeds differ by twice the variance of one.
        let error = |samples: u32| -> f64 {
            let pairs = [(1, 2), (3, 4), (5, 6)].map(|(a, b)| (picture(samples, a), picture(samples, b)));
            pairs.iter().flat_map(|(a, b)| a.data.iter().zip(&b.data)).map(|(a, b)| f64::from(a - b).powi(2)).sum()
        };
        let points: Vec<(f64, f64)> = [4u32, 8, 16, 32, 64].iter().map(|&n| (n as f64, error(n))).collect();
        let slope = log_slope(&points);
        println!("{name}: slope {slope:.3}");
        assert!((-1.2..=-0.9).contains(&slope), "{name}: {slope} over {points:?}");
    }
}

/// Places from which rays start, per case and phase.
const ORIGINS: usize = 64;

#[test]
fn no_ray_leaves_an_airway_at_any_phase() {
    // The full count, 1e7 rays, is for a patient hand: RESPIRE_BENCH_LEAK_RAYS=10000000, RESPIRE_BENCH_LEAK_CASES=all.
    let rays: usize = std::env::var("RESPIRE_BENCH_LEAK_RAYS").ok().and_then(|v| v.parse().ok()).unwrap_or(200_000);
    let all = std::env::var("RESPIRE_BENCH_LEAK_CASES").is_ok_and(|v| v == "all");
    let cases = if all { (1..=9).collect() } else { vec![1, 5] };
    for number in cases {
        let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("bench-cases/case{number}.toml"));
        let anatomy = airway::build(&Case::load(&path).unwrap()).unwrap();
        let rest = &anatomy.inspiration;
        let mut scene = Scene::new(rest, &anatomy.vertex_generation, Material::lambert(RHO), 1).unwrap();
        for (k, phase) in [0.0, 0.35, 0.7, 1.0].into_iter().enumerate() {
            scene.deform(&mesh::interpolate(&rest.vertices, &anatomy.expiration.vertices, phase)).unwrap();
            let mut rng = CounterRng::new(number, Stage::Test, &[k as u64]);
            let points = &anatomy.centerline.points;
            let wall = Wall::between(&rest.vertices, &anatomy.expiration.vertices, phase, &rest.faces);
            // Only origins around which the wall winds once are inside: the centreline's last points may lie in the tissue.
            let tried: Vec<DVec3> = (0..ORIGINS)
                .map(|_| rng.index(points.len()))
                .map(|at| points[at].position_mm.lerp(anatomy.centerline_expiration[at], phase))
                .collect();
            let inside: Vec<DVec3> = tried.into_iter().filter(|&p| (wall.winding(p) - 1.0).abs() < 1e-6).collect();
            println!("case{number} at phase {phase}: {} of {ORIGINS} origins are inside", inside.len());
            assert!(inside.len() > ORIGINS / 2);
            let mut misses = 0;
            for _ in 0..(rays / 4).div_ceil(50_000) {
                let (origins, directions): (Vec<DVec3>, Vec<DVec3>) = (0..50_000.min(rays / 4))
                    .map(|_| {
                        let place = inside[rng.index(inside.len())];
                        (place, DVec3::new(rng.normal(), rng.normal(), rng.normal()).normalize())
                    })
                    .unzip();
                let distances = scene.distances(&origins, &directions).unwrap();
                misses += distances.iter().filter(|d| !d.is_finite()).count();
            }
            assert_eq!(misses, 0, "case{number} at phase {phase}: of {} rays", rays / 4);
        }
    }
}
