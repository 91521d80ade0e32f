//! Prints CPU and wall time of the rasteriser on a bumpy tube like the one of `../shared/reference/splat`:
//! `cargo run --release --example splat_timing -- [DISCS] [SIDE] [THREADS] [ISA]`.

use std::time::Instant;

use glam::DVec3;
use respire_bench::base::Camera;
use respire_bench::base::camera::world_from_camera_looking;
use respire_bench::base::random::{CounterRng, Stage};
use respire_bench::splat::{Gaussians, ImageGradient, Isa, Rasterizer, Settings, Shape, View, Wanted};

fn tube(n: usize) -> Gaussians<f32> {
    let mut r = CounterRng::new(1, Stage::Test, &[n as u64]);
    let spacing = (std::f64::consts::TAU * 8.0 * 100.0 / n as f64).sqrt();
    let mut scene = Gaussians::<f32>::discs(n, 1, 0.95);
    let mut axes = Vec::new();
    for position in &mut scene.positions {
        let (angle, z) = (r.range(0.0, std::f64::consts::TAU), r.range(0.0, 100.0));
        let radius = 8.0 + 0.3 * (std::f64::consts::TAU * z / 12.0).sin();
        *position = [radius * angle.cos(), radius * angle.sin(), z].map(|v| v as f32);
        let size = 0.7 * spacing * r.range(0.85, 1.15);
        axes.push([[-size * angle.sin(), size * angle.cos(), 0.0], [0.0, 0.0, size]].map(|a| a.map(|v| v as f32)));
    }
    scene.shape = Shape::Discs { axes };
    scene.sh.iter_mut().for_each(|v| *v = (0.3 * r.normal()) as f32);
    scene
}

/// CPU seconds of all threads of this process.
fn cpu_s() -> f64 {
    let text = std::fs::read_to_string("/proc/self/stat").expect("/proc is mounted");
    let fields: Vec<&str> = text.rsplit(") ").next().unwrap_or("").split(' ').collect();
    let ticks: f64 = fields[11..13].iter().filter_map(|v| v.parse::<f64>().ok()).sum();
    ticks / 100.0
}

fn timed(name: &str, mut work: impl FnMut()) {
    (0..20).for_each(|_| work());
    let mut walls = Vec::new();
    let cpu = cpu_s();
    for _ in 0..300 {
        let start = Instant::now();
        work();
        walls.push(start.elapsed().as_secs_f64() * 1e3);
    }
    let cpu = (cpu_s() - cpu) / 300.0 * 1e3;
    walls.sort_by(f64::total_cmp);
    println!("{name:<28} wall median {:.2} ms, fastest {:.2} ms; CPU {cpu:.2} ms", walls[150], walls[0]);
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let number = |k: usize, default: usize| arguments.get(k).and_then(|v| v.parse().ok()).unwrap_or(default);
    let (n, side, threads) = (number(0, 20_000), number(1, 128), number(2, 2));
    let isa = match arguments.get(3).map(String::as_str) {
        Some("scalar") => Isa::Scalar,
        Some("sse2") => Isa::Baseline,
        Some("avx2") => Isa::Avx2,
        _ => Isa::widest(),
    };
    rayon::ThreadPoolBuilder::new().num_threads(threads).build_global().expect("the pool is made once");
    let scene = tube(n);
    let world = world_from_camera_looking(DVec3::new(1.0, -0.5, 10.0), DVec3::new(0.2, 0.1, 1.0), DVec3::NEG_Y);
    let view = View::new(Camera::pinhole(side as u32, side as u32, 90f64.to_radians()), world);
    let settings = Settings { depth: respire_bench::splat::DepthOutput::Skip, ..Settings::default() };
    let mut rasterizer = Rasterizer::<f32>::with_isa(isa).expect("the processor has it");
    let image = rasterizer.render(&scene, &view, &settings, None).expect("a good scene");
    println!(
        "{n} discs, {side}x{side}, {threads} threads, {isa}: {} visible, {} intersections",
        image.visible_count, image.intersections
    );
    let color: Vec<f32> = (0..side * side * 3).map(|k| ((k * 7919) % 1009) as f32 / 504.0 - 1.0).collect();
    let gradient = ImageGradient { color: &color, ..ImageGradient::default() };
    let groups = [
        ("forward", None),
        ("forward + backward, geometry", Some(Wanted::POSITIONS | Wanted::SHAPES)),
        ("forward + backward, SH", Some(Wanted::SH)),
        ("forward + backward, all", Some(Wanted::ALL)),
    ];
    for (name, wanted) in groups {
        timed(name, || {
            rasterizer.render(&scene, &view, &settings, None).expect("a good scene");
            if let Some(wanted) = wanted {
                rasterizer.backward(&scene, &gradient, wanted).expect("a good gradient");
            }
        });
    }
}
