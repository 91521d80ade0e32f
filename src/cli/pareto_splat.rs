//! `respire-bench pareto splat`: time against error of the rasteriser's kernels and precisions on the tube scenes, and
//! what it saves to leave out what nobody asks for.
//!
//! The error is that of the gradients (worst group, relative L2) to the plain twin in f64 of the same footprint (EWA or
//! exact discs); the image's stands beside it, and how far the image is from that of exact discs in f64.
//! The cost is CPU time of forward and backward, the median over repetitions.

use std::path::PathBuf;

use clap::Args;
use glam::{DQuat, DVec3};

use super::Terminal;
use crate::base::camera::world_from_camera_looking;
use crate::base::random::{CounterRng, Stage};
use crate::base::{Camera, Result, files};
use crate::ffi::system::cpu_time_s;
use crate::report::pareto::{Chart, Point, Standing, write};
use crate::splat::{
    DepthOutput, Direction, Filter, Footprint, Gaussians, Gradients, ImageGradient, Isa, Rasterizer, Real, Settings,
    Shape, View, Wanted,
};

/// Arguments of `pareto splat`.
#[derive(Args)]
pub(super) struct Arguments {
    /// Folder for tables and plots
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Scenes as DISCSxPIXELS
    #[arg(long, value_delimiter = ',', value_name = "NxPX,..", default_value = "5000x128,20000x256,100000x400")]
    scenes: Vec<String>,
    /// Passes per setting
    #[arg(long, default_value_t = 15, value_name = "N")]
    repeat: usize,
}

/// Thin ellipsoids on the wall of a bumpy tube of 8 mm radius.
fn tube(n: usize) -> Gaussians<f64> {
    let mut r = CounterRng::new(1, Stage::Test, &[n as u64]);
    let (around, length) = (std::f64::consts::TAU * 8.0, 100.0);
    let spacing = (around * length / n as f64).sqrt();
    let columns = (around / spacing).round().max(1.0);
    let rows = (n as f64 / columns).ceil();
    let mut scene = Gaussians::<f64>::discs(n, 1, 0.95);
    let (mut rotations, mut scales) = (Vec::new(), Vec::new());
    for (i, position) in scene.positions.iter_mut().enumerate() {
        let (row, column) = ((i as f64 / columns).floor(), i as f64 % columns);
        let angle = ((column + 0.5 * (row % 2.0)) * around / columns + 0.15 * spacing * r.normal()) / 8.0;
        let z = (row + 0.5) * length / rows + 0.15 * spacing * r.normal();
        let radius = 8.0 + 0.3 * (std::f64::consts::TAU * z / 12.0).sin() * (0.6 + 0.4 * (3.0 * angle).cos());
        *position = [radius * angle.cos(), radius * angle.sin(), z];
        let inwards = DVec3::new(-angle.cos(), -angle.sin(), 0.05 * r.normal()).normalize();
        let turn = DQuat::from_rotation_arc(DVec3::Z, inwards);
        rotations.push([turn.w, turn.x, turn.y, turn.z]);
        let size = 0.7 * spacing;
        scales.push([size * r.range(0.85, 1.15), size * r.range(0.85, 1.15), 0.05 * size]);
    }
    scene.shape = Shape::Ellipsoids { rotations, scales };
    scene.sh.iter_mut().for_each(|v| *v = 0.3 * r.normal());
    // Every precision gets the very numbers that the lowest one can hold.
    scene.cast::<f32>().cast()
}

fn view(side: u32) -> View {
    let forward = DVec3::new(12f64.to_radians().sin(), 6f64.to_radians().sin(), 1.0);
    let world = world_from_camera_looking(DVec3::new(1.0, -0.5, 10.0), forward, DVec3::NEG_Y);
    View::new(Camera::pinhole(side, side, 90f64.to_radians()), world)
}

const SETTINGS: Settings = Settings {
    footprint: Footprint::Ewa,
    near_mm: 0.2,
    dilation_px2: 0.3,
    filter: Filter::Dilate,
    gain: [1.0; 3],
    background: [0.0; 3],
    depth: DepthOutput::Skip,
};

/// CPU seconds of `work`, the median of `repeat` after one to warm up.
fn seconds(repeat: usize, mut work: impl FnMut() -> Result<()>) -> Result<f64> {
    let mut times = Vec::new();
    for _ in 0..=repeat.max(1) {
        let start = cpu_time_s();
        work()?;
        times.push(cpu_time_s() - start);
    }
    times.remove(0);
    times.sort_by(f64::total_cmp);
    Ok(times[times.len() / 2])
}

/// What one setting computes and costs.
struct Measured {
    image: Vec<f64>,
    groups: Vec<Vec<f64>>,
    forward_s: f64,
    both_s: f64,
}

fn groups<T: Real>(g: &Gradients<T>) -> Vec<Vec<f64>> {
    let wide = |v: &[T]| v.iter().map(|v| v.to_f64()).collect::<Vec<f64>>();
    let (rotations, scales) = (wide(g.rotations.as_flattened()), wide(g.scales.as_flattened()));
    vec![wide(g.positions.as_flattened()), rotations, scales, wide(&g.opacities), wide(&g.sh), g.pose.to_vec()]
}

fn weights<T: Real>(values: usize) -> Vec<T> {
    (0..values).map(|k| T::of(((k * 7919) % 1009) as f64 / 504.0 - 1.0)).collect()
}

fn measure<T: Real>(
    scene: &Gaussians<f64>,
    side: u32,
    isa: Isa,
    footprint: Footprint,
    repeat: usize,
) -> Result<Measured> {
    let settings = Settings { footprint, ..SETTINGS };
    let (scene, view) = (scene.cast::<T>(), view(side));
    let mut rasterizer = Rasterizer::<T>::with_isa(isa)?;
    let weights = weights::<T>(3 * (side * side) as usize);
    let gradient = ImageGradient { color: &weights, ..ImageGradient::default() };
    let forward_s = seconds(repeat, || rasterizer.render(&scene, &view, &settings, None).map(drop))?;
    let both_s = seconds(repeat, || {
        rasterizer.render(&scene, &view, &settings, None)?;
        rasterizer.backward(&scene, &gradient, Wanted::ALL).map(drop)
    })?;
    let image = rasterizer.rendered().color.iter().map(|v| v.to_f64()).collect();
    Ok(Measured { image, groups: groups(rasterizer.gradients()), forward_s, both_s })
}

fn relative(a: &[f64], b: &[f64]) -> f64 {
    let norm = b.iter().map(|v| v * v).sum::<f64>().sqrt();
    a.iter().zip(b).map(|(x, y)| (x - y).powi(2)).sum::<f64>().sqrt() / norm
}

fn points(subject: &str, scene: &Gaussians<f64>, side: u32, repeat: usize) -> Result<Vec<Point>> {
    let truth = measure::<f64>(scene, side, Isa::Scalar, Footprint::Ewa, 1)?;
    let discs = measure::<f64>(scene, side, Isa::Scalar, Footprint::Disc, 1)?;
    let mut points = Vec::new();
    let mut add = |mode: &str, setting: String, standing, m: &Measured, truth: &Measured| {
        let error = m.groups.iter().zip(&truth.groups).map(|(f, t)| relative(f, t)).fold(0.0, f64::max);
        points.push(Point {
            subject: subject.into(),
            mode: mode.into(),
            setting,
            cost: m.both_s,
            error,
            standing,
            extra: vec![
                ("forward_s", m.forward_s),
                ("image_error", relative(&m.image, &truth.image)),
                ("image_to_exact_discs", relative(&m.image, &discs.image)),
            ],
        });
    };
    for isa in [Isa::Scalar, Isa::Baseline, Isa::Avx2, Isa::Avx512] {
        if isa.available().is_err() {
            continue;
        }
        let repeat = if isa == Isa::Scalar { 1 } else { repeat };
        let standing = if isa == Isa::widest() { Standing::Default } else { Standing::Alternative };
        let measured = measure::<f32>(scene, side, isa, Footprint::Ewa, repeat)?;
        add("single precision", isa.to_string(), standing, &measured, &truth);
    }
    add("double precision", "scalar".into(), Standing::Alternative, &truth, &truth);
    let single = measure::<f32>(scene, side, Isa::widest(), Footprint::Disc, repeat.min(3))?;
    add("exact discs, single precision", "plain".into(), Standing::Alternative, &single, &discs);
    add("exact discs, double precision", "plain".into(), Standing::Alternative, &discs, &discs);
    Ok(points)
}

/// CPU time of forward and backward for the groups wanted, over that of all, and of one tangent over a forward pass.
fn skipping(subject: &str, scene: &Gaussians<f64>, side: u32, repeat: usize) -> Result<String> {
    let (scene, view) = (scene.cast::<f32>(), view(side));
    let mut rasterizer = Rasterizer::<f32>::new();
    let weights = weights::<f32>(3 * (side * side) as usize);
    let gradient = ImageGradient { color: &weights, ..ImageGradient::default() };
    let forward = seconds(repeat, || rasterizer.render(&scene, &view, &SETTINGS, None).map(drop))?;
    let mut text = String::new();
    let wanted = [
        ("all groups", Wanted::ALL),
        ("positions and shapes", Wanted::POSITIONS | Wanted::SHAPES),
        ("opacities", Wanted::OPACITIES),
        ("SH", Wanted::SH),
        ("pose", Wanted::POSE),
        ("gain", Wanted::GAIN),
    ];
    for (name, groups) in wanted {
        let both = seconds(repeat, || {
            rasterizer.render(&scene, &view, &SETTINGS, None)?;
            rasterizer.backward(&scene, &gradient, groups).map(drop)
        })?;
        text += &format!("{subject},forward + backward for {name},{:.6},{:.3}\n", both, both / forward);
    }
    let directions = [Direction::Pose([0.1, 0.2, 0.3, 1.0, 2.0, 3.0])];
    let tangent = seconds(repeat, || rasterizer.render_tangent(&scene, &view, &SETTINGS, None, &directions).map(drop))?;
    text += &format!("{subject},forward with one direction (JVP),{tangent:.6},{:.3}\n", tangent / forward);
    let half: Vec<u32> = (0..scene.len() as u32 / 2).collect();
    let active = seconds(repeat, || rasterizer.render(&scene, &view, &SETTINGS, Some(&half)).map(drop))?;
    text += &format!("{subject},forward of the nearer half of the Gaussians,{active:.6},{:.3}\n", active / forward);
    Ok(text)
}

/// Runs the command.
pub(super) fn run(arguments: Arguments, terminal: &Terminal) -> Result<()> {
    let mut all = Vec::new();
    let mut saved = "subject,what,cpu_s,of_forward\n".to_string();
    for name in &arguments.scenes {
        let parsed = name.split_once('x').and_then(|(n, side)| Some((n.parse().ok()?, side.parse().ok()?)));
        let Some((n, side @ 1..=4096)) = parsed else {
            return Err(crate::base::Error::usage(format!("`{name}` is no scene; 20000x256 would be one")));
        };
        let subject = format!("{n} discs, {side} px");
        terminal.stage(&subject);
        let scene = tube(n);
        all.extend(points(&subject, &scene, side, arguments.repeat)?);
        saved += &skipping(&subject.replace(", ", " at "), &scene, side, arguments.repeat)?;
    }
    let chart = Chart {
        cost: "CPU seconds, forward and backward",
        error: "gradients to f64, worst group, relative L2",
        points: all,
    };
    let table = write(&chart, &arguments.out, "pareto-splat")?;
    files::write_bytes(&arguments.out.join("skipping.csv"), saved.as_bytes())?;
    terminal.line(table.display());
    Ok(())
}
