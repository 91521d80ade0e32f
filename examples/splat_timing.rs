//! Times the rasteriser, stage by stage, on a bumpy tube like the one of `../shared/reference/splat`:
//! `cargo run --release --example splat_timing -- [DISCS] [SIDE] [THREADS] [ISA] [REPETITIONS]`.
//!
//! On a busy machine believe the CPU times (of the whole process, median), not the wall clock.

use glam::DVec3;
use respire_bench::base::Camera;
use respire_bench::base::camera::world_from_camera_looking;
use respire_bench::base::random::{CounterRng, Stage as Randomness};
use respire_bench::ffi::loss::{self, LossImage};
use respire_bench::splat::{
    DepthOutput, Direction, Gaussians, ImageGradient, Isa, Motion, Rasterizer, Settings, Shape, Stage, View, Wanted,
};

/// Thin ellipsoids as in the reference scene, in the order of a hexagonal lattice on the wall.
fn tube(n: usize) -> Gaussians<f32> {
    let mut r = CounterRng::new(1, Randomness::Test, &[n as u64]);
    let (around, length) = (std::f64::consts::TAU * 8.0, 100.0);
    let spacing = (around * length / n as f64).sqrt();
    let columns = (around / spacing).round().max(1.0);
    let rows = (n as f64 / columns).ceil();
    let mut scene = Gaussians::<f32>::discs(n, 1, 0.95);
    let (mut rotations, mut scales) = (Vec::new(), Vec::new());
    for (i, position) in scene.positions.iter_mut().enumerate() {
        let (row, column) = ((i as f64 / columns).floor(), i as f64 % columns);
        let angle = ((column + 0.5 * (row % 2.0)) * around / columns + 0.15 * spacing * r.normal()) / 8.0;
        let z = (row + 0.5) * length / rows + 0.15 * spacing * r.normal();
        let radius = 8.0 + 0.3 * (std::f64::consts::TAU * z / 12.0).sin() * (0.6 + 0.4 * (3.0 * angle).cos());
        *position = [radius * angle.cos(), radius * angle.sin(), z].map(|v| v as f32);
        // The third axis looks inwards.
        let inwards = DVec3::new(-angle.cos(), -angle.sin(), 0.05 * r.normal()).normalize();
        let turn = glam::DQuat::from_rotation_arc(DVec3::Z, inwards);
        rotations.push([turn.w, turn.x, turn.y, turn.z].map(|v| v as f32));
        let size = || 0.7 * spacing;
        scales.push([size() * r.range(0.85, 1.15), size() * r.range(0.85, 1.15), 0.05 * size()].map(|v| v as f32));
    }
    scene.shape = Shape::Ellipsoids { rotations, scales };
    scene.sh.iter_mut().for_each(|v| *v = (0.3 * r.normal()) as f32);
    scene
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2] * 1e3
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let number = |k: usize, default: usize| arguments.get(k).and_then(|v| v.parse().ok()).unwrap_or(default);
    let (n, side, threads) = (number(0, 20_000), number(1, 256), number(2, 2));
    let repetitions = number(4, 100);
    let isa = match arguments.get(3).map(String::as_str) {
        Some("scalar") => Isa::Scalar,
        Some("sse2") => Isa::Baseline,
        Some("avx2") => Isa::Avx2,
        _ => Isa::widest(),
    };
    rayon::ThreadPoolBuilder::new().num_threads(threads).build_global().expect("the pool is made once");
    let scene = tube(n);
    let forward = DVec3::new(12f64.to_radians().sin(), 6f64.to_radians().sin(), 1.0);
    let world = world_from_camera_looking(DVec3::new(1.0, -0.5, 10.0), forward, DVec3::NEG_Y);
    let view = View::new(Camera::pinhole(side as u32, side as u32, 90f64.to_radians()), world);
    let settings = Settings { depth: DepthOutput::Skip, ..Settings::default() };
    let mut rasterizer = Rasterizer::<f32>::with_isa(isa).expect("the processor has it");
    rasterizer.measure_cpu();
    let image = rasterizer.render(&scene, &view, &settings, None).expect("a good scene");
    let counts = (image.visible_count, image.intersections);
    println!("{n} discs, {side}x{side}, {threads} threads, {isa}: {} visible, {} intersections", counts.0, counts.1);
    let color: Vec<f32> = (0..side * side * 3).map(|k| ((k * 7919) % 1009) as f32 / 504.0 - 1.0).collect();
    let gradient = ImageGradient { color: &color, ..ImageGradient::default() };
    let velocities: Vec<[f32; 3]> = scene.positions.iter().map(|p| [0.1 * p[0], 0.1 * p[1], 1.0]).collect();
    let motion = Direction::Motion(Motion { positions: &velocities, ..Motion::default() });
    let (mut walls, mut cpus) = (vec![Vec::new(); 6], vec![Vec::new(); 6]);
    let (mut forwards, mut boths, mut tangents) = ([Vec::new(), Vec::new()], [Vec::new(), Vec::new()], Vec::new());
    for _ in 0..repetitions {
        rasterizer.render(&scene, &view, &settings, None).expect("a good scene");
        rasterizer.backward(&scene, &gradient, Wanted::ALL).expect("a good gradient");
        let times = rasterizer.stage_times();
        for k in 0..6 {
            walls[k].push(times.wall_s[k]);
            cpus[k].push(times.cpu_s[k]);
        }
        for (k, t) in [times.wall_s, times.cpu_s].iter().enumerate() {
            forwards[k].push(t[..4].iter().sum::<f64>());
            boths[k].push(t.iter().sum::<f64>());
        }
        let before = respire_bench::ffi::system::cpu_time_s();
        rasterizer.render_tangent(&scene, &view, &settings, None, &[motion]).expect("a good motion");
        tangents.push(respire_bench::ffi::system::cpu_time_s() - before);
    }
    println!("{:<20} {:>9} {:>9}", "ms (median)", "wall", "CPU");
    for (k, stage) in Stage::ALL.into_iter().enumerate() {
        println!("{:<20} {:>9.3} {:>9.3}", stage.name(), median(walls[k].clone()), median(cpus[k].clone()));
    }
    let least = |v: &[f64]| v.iter().copied().fold(f64::MAX, f64::min) * 1e3;
    for (name, [wall, cpu]) in [("forward", forwards), ("forward + backward", boths)] {
        println!(
            "{name:<20} {:>9.3} {:>9.3}   fastest {:.3} wall, {:.3} CPU",
            median(wall.clone()),
            median(cpu.clone()),
            least(&wall),
            least(&cpu)
        );
    }
    println!(
        "{:<20} {:>9} {:>9.3}   fastest {:.3} CPU",
        "tangent, one motion",
        "",
        median(tangents.clone()),
        least(&tangents)
    );
    let plane = vec![0.4f32; 3 * side * side];
    let window = [0.001, 0.0076, 0.036, 0.1094, 0.213, 0.266];
    let image = LossImage {
        width: side,
        height: side,
        target: &color,
        mean: &plane,
        square: &plane,
        mask: &[],
        window: &window,
        ssim_weight: 0.2,
    };
    let mut gradient = vec![0.0f32; 3 * side * side];
    let mut times = Vec::new();
    for _ in 0..repetitions {
        let before = respire_bench::ffi::system::cpu_time_s();
        std::hint::black_box(loss::band(isa, &image, &plane, 0, &mut gradient));
        times.push(respire_bench::ffi::system::cpu_time_s() - before);
    }
    println!(
        "{:<20} {:>9} {:>9.3}   fastest {:.3} CPU",
        "L1 + SSIM, gradient",
        "",
        median(times.clone()),
        least(&times)
    );
}
