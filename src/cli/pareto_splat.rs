//! `respire-bench pareto splat`: time against error of everything that the rasteriser lets one choose, on tubes of several
//! sizes: kernels, threads, precision, blocks, dilated or compensated, EWA or exact discs; and what it saves
//! to leave out what nobody sees or asks for (`pareto_skipping`).
//!
//! Two charts: the errors of the gradients (worst group) and of the image, relative L2 to the plain twin in f64 of the same
//! footprint and filter. The cost is CPU time of forward and backward, the median over repetitions; the least wall clock
//! stands beside it, and how far the image is from that of exact discs in f64, which is what EWA approximates.

use std::path::PathBuf;
use std::time::Instant;

use clap::Args;

use super::{Terminal, pareto_skipping};
use crate::base::{Error, Result, files};
use crate::ffi::system::cpu_time_s;
use crate::report::pareto::{Chart, Point, Standing, write};
use crate::splat::{
    Filter, Footprint, Gaussians, Gradients, ImageGradient, Isa, Rasterizer, Settings, Skips, SplatKernels, Wanted,
    tube,
};

/// Arguments of `pareto splat`.
#[derive(Args)]
pub(super) struct Arguments {
    /// Folder for tables and plots
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Scenes as DISCSxPIXELS
    #[arg(
        long,
        value_delimiter = ',',
        value_name = "NxPX,..",
        default_value = "5000x128,20000x128,20000x256,20000x512,100000x400,1000000x1024"
    )]
    scenes: Vec<String>,
    /// Passes per setting; a tenth of it, at least one, where a pass takes tenths of a second
    #[arg(long, default_value_t = 15, value_name = "N")]
    repeat: usize,
}

/// One thing to choose of everything.
#[derive(Clone, Copy)]
struct Choice {
    mode: &'static str,
    isa: Isa,
    threads: usize,
    footprint: Footprint,
    filter: Filter,
    skips: Skips,
}

impl Choice {
    /// What the program uses.
    fn default() -> Self {
        Choice {
            mode: "EWA, f32",
            isa: Isa::widest(),
            threads: 1,
            footprint: Footprint::Ewa,
            filter: Filter::Dilate,
            skips: Skips::ALL,
        }
    }

    fn settings(&self) -> Settings {
        Settings { footprint: self.footprint, filter: self.filter, ..tube::settings() }
    }

    fn label(&self) -> String {
        let kernel = self.isa.to_string();
        if self.threads == 1 { kernel } else { format!("{kernel}, {} threads", self.threads) }
    }
}

/// What one choice computes and costs.
struct Measured {
    image: Vec<f64>,
    groups: Vec<Vec<f64>>,
    forward_s: f64,
    both_s: f64,
    wall_s: f64,
}

fn groups<T: SplatKernels>(g: &Gradients<T>) -> Vec<Vec<f64>> {
    let wide = |v: &[T]| v.iter().map(|v| v.to_f64()).collect::<Vec<f64>>();
    let (rotations, scales) = (wide(g.rotations.as_flattened()), wide(g.scales.as_flattened()));
    vec![wide(g.positions.as_flattened()), rotations, scales, wide(&g.opacities), wide(&g.sh), g.pose.to_vec()]
}

/// CPU seconds of `work`, the median, and the least of its wall clock; after one to warm up.
fn seconds(repeat: usize, mut work: impl FnMut() -> Result<()>) -> Result<[f64; 2]> {
    work()?;
    let (mut times, mut least) = (Vec::new(), f64::INFINITY);
    for _ in 0..repeat.max(1) {
        let (cpu, wall) = (cpu_time_s(), Instant::now());
        work()?;
        least = least.min(wall.elapsed().as_secs_f64());
        times.push(cpu_time_s() - cpu);
    }
    times.sort_by(f64::total_cmp);
    Ok([times[times.len() / 2], least])
}

/// Runs `work` with so many threads.
pub(super) fn with_threads<R: Send>(threads: usize, work: impl FnOnce() -> Result<R> + Send) -> Result<R> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    pool.map_err(|e| Error::input(format!("{threads} threads cannot be had: {e}")))?.install(work)
}

fn measure<T: SplatKernels>(scene: &Gaussians<f32>, side: usize, choice: Choice, repeat: usize) -> Result<Measured> {
    let (scene, view, settings) = (scene.cast::<T>(), tube::view(side), choice.settings());
    let weights: Vec<T> = tube::image_gradient(3 * side * side).iter().map(|&w| T::of(f64::from(w))).collect();
    let gradient = ImageGradient { color: &weights, ..ImageGradient::default() };
    with_threads(choice.threads, || {
        let mut rasterizer = Rasterizer::<T>::with_isa(choice.isa)?;
        rasterizer.skips(choice.skips);
        let [forward_s, _] = seconds(repeat, || rasterizer.render(&scene, &view, &settings, None).map(drop))?;
        let [both_s, wall_s] = seconds(repeat, || {
            rasterizer.render(&scene, &view, &settings, None)?;
            rasterizer.backward(&scene, &gradient, Wanted::ALL).map(drop)
        })?;
        let image = rasterizer.rendered().color.iter().map(|v| v.to_f64()).collect();
        Ok(Measured { image, groups: groups(rasterizer.gradients()), forward_s, both_s, wall_s })
    })
}

/// `|a - b| / |b|`, L2.
pub(super) fn relative(a: &[f64], b: &[f64]) -> f64 {
    let norm = b.iter().map(|v| v * v).sum::<f64>().sqrt();
    a.iter().zip(b).map(|(x, y)| (x - y).powi(2)).sum::<f64>().sqrt() / norm
}

/// The points of a scene, for the chart of gradients and for that of the image.
fn points(subject: &str, scene: &Gaussians<f32>, side: usize, repeat: usize) -> Result<[Vec<Point>; 2]> {
    let few = if scene.len() >= 500_000 { repeat.div_ceil(10) } else { repeat };
    let slow = repeat.div_ceil(10);
    let default = Choice::default();
    let compensated = Choice { filter: Filter::Compensate, ..default };
    let discs = Choice { footprint: Footprint::Disc, ..default };
    let twin = |choice: Choice| measure::<f64>(scene, side, Choice { isa: Isa::Scalar, ..choice }, slow);
    let (truth, truth_compensated, truth_discs) = (twin(default)?, twin(compensated)?, twin(discs)?);

    let mut charts = [Vec::new(), Vec::new()];
    let mut add = |choice: Choice, m: &Measured, truth: &Measured, standing: Standing| {
        let gradients = m.groups.iter().zip(&truth.groups).map(|(f, t)| relative(f, t)).fold(0.0, f64::max);
        let image = relative(&m.image, &truth.image);
        for (chart, error) in charts.iter_mut().zip([gradients, image]) {
            chart.push(Point {
                subject: subject.into(),
                mode: choice.mode.into(),
                setting: choice.label(),
                cost: m.both_s,
                error,
                standing,
                extra: vec![
                    ("threads", choice.threads as f64),
                    ("forward_s", m.forward_s),
                    ("least_wall_s", m.wall_s),
                    ("gradient_error", gradients),
                    ("image_error", image),
                    ("image_to_exact_discs", relative(&m.image, &truth_discs.image)),
                ],
            });
        }
    };
    for isa in [Isa::Scalar, Isa::Baseline, Isa::Avx2, Isa::Avx512] {
        if isa.available().is_ok() {
            let choice = Choice { isa, ..default };
            let measured = measure::<f32>(scene, side, choice, if isa == Isa::Scalar { slow } else { few })?;
            let standing = if isa == Isa::widest() { Standing::Default } else { Standing::Alternative };
            add(choice, &measured, &truth, standing);
        }
    }
    for (choice, truth, repeat) in [
        (Choice { threads: 2, ..default }, &truth, few),
        (Choice { mode: "EWA, f32, whole tiles", skips: Skips::ALL.without(Skips::BLOCKS), ..default }, &truth, few),
        (Choice { mode: "EWA compensated, f32", ..compensated }, &truth_compensated, few),
        (Choice { mode: "exact discs, f32", ..discs }, &truth_discs, slow),
    ] {
        add(choice, &measure::<f32>(scene, side, choice, repeat)?, truth, Standing::Alternative);
    }
    let plain = |mode, choice| Choice { mode, isa: Isa::Scalar, ..choice };
    add(plain("EWA, f64", default), &truth, &truth, Standing::Alternative);
    add(plain("EWA compensated, f64", compensated), &truth_compensated, &truth_compensated, Standing::Alternative);
    add(plain("exact discs, f64", discs), &truth_discs, &truth_discs, Standing::Alternative);
    Ok(charts)
}

/// Runs the command.
pub(super) fn run(arguments: Arguments, terminal: &Terminal) -> Result<()> {
    let mut charts = [Vec::new(), Vec::new()];
    let mut saved = pareto_skipping::HEADER.to_string();
    for name in &arguments.scenes {
        let parsed = name.split_once('x').and_then(|(n, side)| Some((n.parse().ok()?, side.parse().ok()?)));
        let Some((n, side @ 1..=4096)) = parsed else {
            return Err(Error::usage(format!("`{name}` is no scene; 20000x256 would be one")));
        };
        let subject = format!("{n} discs, {side} px");
        terminal.stage(&subject);
        let scene = tube::tube(n);
        let found = points(&subject, &scene, side, arguments.repeat)?;
        charts.iter_mut().zip(found).for_each(|(chart, points)| chart.extend(points));
        if n < 500_000 {
            let rows = with_threads(1, || pareto_skipping::rows(&scene, side, arguments.repeat))?;
            rows.iter().for_each(|row| saved += &row.line(&subject.replace(", ", " at ")));
        }
    }
    let [gradients, image] = charts;
    let cost = "CPU seconds, forward and backward";
    let chart = Chart { cost, error: "gradients to f64, worst group, relative L2", points: gradients };
    let table = write(&chart, &arguments.out, "pareto-splat")?;
    let chart = Chart { cost, error: "image to f64, relative L2", points: image };
    write(&chart, &arguments.out, "pareto-splat-image")?;
    files::write_bytes(&arguments.out.join("skipping.csv"), saved.as_bytes())?;
    terminal.line(table.display());
    Ok(())
}
