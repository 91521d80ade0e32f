//! `respire-bench stress`: the numerical-stability table. A fixed matrix of scenes that go wrong in single precision
//! (`stress_scenes`), each rendered and differentiated in f32 (fastest kernels) and in f64 (plain twin); what must be
//! refused (`stress_inputs`); the metrics on frames, maps and contours at the edge of their definition, against closed
//! forms (`stress_metrics`); gradients against central differences, and the faults that this must catch
//! (`stress_derivatives`).

use std::path::PathBuf;

use clap::Args;
use serde::Serialize;

use super::Terminal;
use super::stress_scenes::{self as scenes, Demand, Item};
use super::{stress_derivatives as derivatives, stress_inputs as inputs, stress_metrics as metrics};
use crate::base::random::{CounterRng, Stage};
use crate::base::{Error, ErrorKind, Result, files};
use crate::splat::{Footprint, Gradients, ImageGradient, Rasterizer, SplatKernels, Wanted};

/// Largest relative error (L2) of an image that passes.
const IMAGE_LIMIT: f64 = 1e-3;
/// The same for the worst group of gradients.
const GRADIENT_LIMIT: f64 = 2e-2;

/// Arguments of `stress`.
#[derive(Args)]
#[command(
    after_help = "Writes stress.csv into DIR when given. Fails when a number is not finite or an error is larger than\n\
    1e-3 (image) or 2e-2 (worst group of gradients) relative to double precision; of values of 3e38, which single\n\
    precision cannot square, only finite results are asked. Metrics are held against closed forms, gradients against\n\
    central differences (1e-6 for every value), and every fault seeded into the backward pass must be caught by them.\n\
    Example: respire-bench stress --out /tmp/stress"
)]
pub struct Arguments {
    /// Folder for the table
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Leave out the items with a million Gaussians and 4096x4096 pixels
    #[arg(long)]
    small: bool,
    /// The table as JSON
    #[arg(long)]
    json: bool,
}

/// One line of the table.
#[derive(Clone, Serialize)]
pub(super) struct Row {
    pub item: String,
    pub image_error: f64,
    pub gradient_error: f64,
    pub worst_group: &'static str,
    pub not_finite: usize,
    pub passed: bool,
    /// Whether its errors were asked to be small (not for values that overflow in single precision).
    #[serde(skip)]
    pub accurate: bool,
}

impl Row {
    /// A row of one number with its true value.
    pub fn of_value(item: impl Into<String>, found: f64, truth: f64, limit: f64) -> Row {
        let image_error = if found == truth { 0.0 } else { (found - truth).abs() / truth.abs().max(1.0) };
        let not_finite = usize::from(!found.is_finite());
        let passed = not_finite == 0 && image_error <= limit;
        let item = item.into();
        Row { item, image_error, gradient_error: 0.0, worst_group: "-", not_finite, passed, accurate: true }
    }

    /// A row of something that must hold.
    pub fn of_claim(item: impl Into<String>, holds: bool) -> Row {
        Row { passed: holds, ..Row::of_value(item, 0.0, 0.0, 0.0) }
    }
}

/// All values of all groups, by name.
fn groups<T: SplatKernels>(g: &Gradients<T>) -> [Group; 9] {
    let wide = |v: &[T]| v.iter().map(|v| v.to_f64()).collect::<Vec<f64>>();
    [
        ("positions", wide(g.positions.as_flattened())),
        ("axes", wide(g.axes.as_flattened().as_flattened())),
        ("opacities", wide(&g.opacities)),
        ("sh", wide(&g.sh)),
        ("rotations", wide(g.rotations.as_flattened())),
        ("scales", wide(g.scales.as_flattened())),
        ("pose", g.pose.to_vec()),
        ("gain", g.gain.to_vec()),
        ("lens", g.lens.to_vec()),
    ]
}

/// `|a - b| / |b|`, L2; 0 where both vanish.
fn relative(a: &[f64], b: &[f64]) -> f64 {
    let norm = b.iter().map(|v| v * v).sum::<f64>().sqrt();
    let difference = a.iter().zip(b).map(|(x, y)| (x - y).powi(2)).sum::<f64>().sqrt();
    if difference == 0.0 { 0.0 } else { difference / norm }
}

/// The values of a group of gradients, and its name.
type Group = (&'static str, Vec<f64>);

/// Image and gradients of one precision.
fn pass<T: SplatKernels>(item: &Item, rasterizer: &mut Rasterizer<T>) -> Result<(Vec<f64>, Vec<Group>)> {
    let scene = item.scene.cast::<T>();
    let image = rasterizer.render(&scene, &item.view, &item.settings, None)?;
    let all: Vec<f64> = image.color.iter().chain(&image.alpha).map(|v| v.to_f64()).collect();
    let depths: Vec<f64> = image.depth.iter().map(|v| v.to_f64()).collect();
    // Independent of each other: what repeats cancels over large discs, and leaves nothing to be right about.
    let r = &mut CounterRng::new(31, Stage::Test, &[]);
    let weights: Vec<T> = image.color.iter().map(|_| T::of(f64::from(r.range(-1.0, 1.0) as f32))).collect();
    let gradient = ImageGradient { color: &weights, ..ImageGradient::default() };
    // The vectorised chain leaves the intrinsics to the plain twin: both are looked at.
    let exact_fisheye = item.settings.footprint == Footprint::Disc && item.view.camera.fisheye.is_some();
    let lens = if exact_fisheye { [0.0; 4] } else { rasterizer.backward(&scene, &gradient, Wanted::LENS)?.lens };
    let mut gradients = rasterizer.backward(&scene, &gradient, Wanted::ALL)?.clone();
    gradients.lens = lens;
    let gradients = &gradients;
    let mut groups: Vec<_> = groups(gradients).into();
    // Depth is checked for finite numbers with the rest; it is a quotient, and has no error of its own to bound.
    groups.push(("depth", depths));
    Ok((all, groups))
}

fn measure(item: &Item) -> Result<Row> {
    let (image, found) = pass::<f32>(item, &mut Rasterizer::new())?;
    let (true_image, truth) = pass::<f64>(item, &mut Rasterizer::new())?;
    let lists = found.iter().map(|g| &g.1).chain([&image]);
    let not_finite = lists.flatten().filter(|v| !v.is_finite()).count();
    let image_error = relative(&image, &true_image);
    let errors = found.iter().zip(&truth).filter(|(f, _)| f.0 != "depth").map(|(f, t)| (relative(&f.1, &t.1), f.0));
    let (gradient_error, worst_group) = errors.fold((0.0, "-"), |worst, e| if e.0 > worst.0 { e } else { worst });
    let near = image_error <= IMAGE_LIMIT && gradient_error <= GRADIENT_LIMIT;
    let accurate = item.demand == Demand::Accuracy;
    let passed = not_finite == 0 && (near || !accurate);
    Ok(Row { item: item.name.clone(), image_error, gradient_error, worst_group, not_finite, passed, accurate })
}

fn table(rows: &[Row]) -> String {
    let mut text = "item,image_error,gradient_error,worst_group,not_finite,passed\n".to_string();
    for r in rows {
        let (image, gradient) = (r.image_error, r.gradient_error);
        text += &format!("{},{image:e},{gradient:e},{},{},{}\n", r.item, r.worst_group, r.not_finite, r.passed);
    }
    text
}

/// The table in a sentence: worst errors where accuracy is asked for, numbers that are not finite, faults caught.
fn summary(rows: &[Row]) -> String {
    let faults: Vec<&Row> = rows.iter().filter(|r| r.item.starts_with(derivatives::FAULT)).collect();
    let sound = || rows.iter().filter(|r| r.passed && r.accurate && !r.item.starts_with(derivatives::FAULT));
    let worst = |error: fn(&Row) -> f64| sound().max_by(|a, b| error(a).total_cmp(&error(b)));
    let named = |row: Option<&Row>, error: fn(&Row) -> f64| {
        row.map_or_else(|| "none".into(), |r| format!("{:.1e} ({})", error(r), r.item))
    };
    format!(
        "{} items; worst image {}; worst gradients {}; {} numbers not finite; {} of {} seeded faults caught",
        rows.len() - faults.len(),
        named(worst(|r| r.image_error), |r| r.image_error),
        named(worst(|r| r.gradient_error), |r| r.gradient_error),
        rows.iter().map(|r| r.not_finite).sum::<usize>(),
        faults.iter().filter(|r| r.passed).count(),
        faults.len()
    )
}

/// Runs the command.
pub fn run(arguments: Arguments, terminal: &Terminal) -> Result<()> {
    let mut rows = Vec::new();
    let scenes = scenes::geometry().into_iter().chain(scenes::sizes(arguments.small)).chain(scenes::anchored());
    for item in scenes.chain(scenes::poisons()).chain(scenes::modes()) {
        terminal.stage(&item.name);
        rows.push(measure(&item)?);
    }
    rows.extend(inputs::refusals()?);
    rows.extend(metrics::rows()?);
    terminal.stage("central differences");
    rows.extend(derivatives::rows()?);
    if let Some(folder) = &arguments.out {
        files::write_bytes(&folder.join("stress.csv"), table(&rows).replace(", ", " ").as_bytes())?;
    }
    if arguments.json {
        terminal.json(&rows)?;
    } else {
        terminal.line(format!("{:<34} {:>9} {:>9} {:<10} not finite", "item", "image", "gradient", "worst"));
        for r in &rows {
            let mark = if r.passed { "" } else { "  FAILED" };
            let (image, gradient) = (r.image_error, r.gradient_error);
            terminal.line(format!(
                "{:<34} {image:>9.1e} {gradient:>9.1e} {:<10} {}{mark}",
                r.item, r.worst_group, r.not_finite
            ));
        }
    }
    if !arguments.json {
        terminal.line(summary(&rows));
    }
    let failed = rows.iter().filter(|r| !r.passed).count();
    if failed > 0 {
        return Err(Error::new(ErrorKind::CellFailed, format!("{failed} of {} items failed", rows.len())));
    }
    Ok(())
}
