//! `respire-bench pareto`: cost against error of many settings, with the front marked and the default on it.

use std::path::PathBuf;

use clap::{Args, Subcommand};

use super::Terminal;
use super::selection::{CacheFolder, CatalogueFolder, ProfileChoice};
use crate::airway::case::Case;
use crate::base::range::{IMAGE_SIDE_PX, REPETITIONS, SAMPLES_PER_PIXEL, SHARE};
use crate::base::{Estimate, Progress, Result};
use crate::experiments::pareto::phase::{self, PhaseSweep};
use crate::experiments::pareto::render::{self, RenderSweep};
use crate::experiments::pareto::skipping;
use crate::experiments::pareto::splat::{self, SceneSize};
use crate::report::pareto::write;
use crate::report::tables::write_csv;

/// Arguments of `pareto`.
#[derive(Args)]
#[command(after_help = "Each kind writes pareto-KIND.csv, .svg and .png into DIR; splat also writes\n\
    pareto-splat-image.csv, .svg and .png (the image's error; gradients are in the others) and skipping.csv.\n\
    Example: respire-bench pareto render --out /tmp/pareto")]
pub struct ParetoArguments {
    #[command(subcommand)]
    chart: ChartArguments,
}

#[derive(Subcommand)]
enum ChartArguments {
    /// Path tracer: time against relative error of its modes, on a frame of each of three cases
    Render(RenderChartArguments),
    /// Tracking: time against phase error of Adam and Gauss-Newton, on three cases
    Phase(PhaseChartArguments),
    /// Rasteriser: time against error of kernels, threads, precisions, footprints, filters and blocks; what skipping
    /// saves
    Splat(SplatChartArguments),
}

#[derive(Args)]
#[command(after_help = "Example: respire-bench pareto render --cases case1 --width 128 --out /tmp/pareto")]
struct RenderChartArguments {
    /// Folder for table and plots
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Cases by id, or paths of case files
    #[arg(long, value_delimiter = ',', value_name = "CASE,..", default_value = "case1,case5,case9")]
    cases: Vec<String>,
    /// Image width and height in pixels
    #[arg(long, default_value_t = 256, value_name = "PX", value_parser = IMAGE_SIDE_PX.parser::<u32>())]
    width: u32,
    /// Samples per pixel of the reference
    #[arg(long, default_value_t = 1024, value_name = "N", value_parser = SAMPLES_PER_PIXEL.parser::<u32>())]
    reference_spp: u32,
    /// Most samples per pixel of a measured setting
    #[arg(long, default_value_t = 64, value_name = "N", value_parser = SAMPLES_PER_PIXEL.parser::<u32>())]
    most_spp: u32,
    /// Breathing phase of the frame, 0 inspiration (the shape at which the tissue's map is made) to 1 expiration
    #[arg(long, default_value_t = 0.5, value_name = "PHASE", value_parser = SHARE.parser::<f64>())]
    phase: f64,
    #[command(flatten)]
    catalogue: CatalogueFolder,
}

#[derive(Args)]
#[command(after_help = "Example: respire-bench pareto phase --cases case1 --out /tmp/pareto")]
struct PhaseChartArguments {
    /// Folder for table and plots
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Cases by id, or paths of case files
    #[arg(long, value_delimiter = ',', value_name = "CASE,..", default_value = "case1,case5,case9")]
    cases: Vec<String>,
    #[command(flatten)]
    profile: ProfileChoice,
    #[command(flatten)]
    cache: CacheFolder,
    #[command(flatten)]
    catalogue: CatalogueFolder,
}

#[derive(Args)]
#[command(after_help = "Example: respire-bench pareto splat --out /tmp/pareto")]
struct SplatChartArguments {
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
    scenes: Vec<SceneSize>,
    /// Passes per setting; a tenth of it, at least one, where a pass takes tenths of a second
    #[arg(long, default_value_t = 15, value_name = "N", value_parser = REPETITIONS.parser::<usize>())]
    repeat: usize,
}

/// Measures, writes the chart and prints the path of its table.
pub fn run(arguments: ParetoArguments, terminal: &Terminal) -> Result<()> {
    let table = match arguments.chart {
        ChartArguments::Render(arguments) => run_render(arguments, terminal),
        ChartArguments::Phase(arguments) => run_phase(arguments, terminal),
        ChartArguments::Splat(arguments) => run_splat(arguments, terminal),
    }?;
    terminal.line(table.display());
    Ok(())
}

fn run_render(arguments: RenderChartArguments, terminal: &Terminal) -> Result<PathBuf> {
    let catalogue = arguments.catalogue.open()?;
    let sweep = RenderSweep {
        width_px: arguments.width,
        reference_samples: arguments.reference_spp,
        most_samples: arguments.most_spp,
        phase: arguments.phase,
    };
    let cases = arguments.cases.len() as f64;
    terminal.accepts(&Estimate { seconds: cases * sweep.estimate().seconds, ..sweep.estimate() })?;
    let mut points = Vec::new();
    for name in &arguments.cases {
        points.extend(render::points(&Case::load(&catalogue.case_file(name)?)?, &sweep, terminal)?);
    }
    write(&render::chart(points), &arguments.out, "pareto-render")
}

fn run_phase(arguments: PhaseChartArguments, terminal: &Terminal) -> Result<PathBuf> {
    let catalogue = arguments.catalogue.open()?;
    let PhaseChartArguments { cases, profile, cache, .. } = arguments;
    let sweep = PhaseSweep { catalogue: &catalogue, cases, profile: profile.name(), cache: cache.path() };
    let chart = phase::chart(&sweep, terminal)?;
    write(&chart, &arguments.out, "pareto-phase")
}

fn run_splat(arguments: SplatChartArguments, terminal: &Terminal) -> Result<PathBuf> {
    let sizes = arguments.scenes.iter().map(|size| size.estimate(arguments.repeat));
    terminal.accepts(&sizes.fold(Estimate::default(), Estimate::then))?;
    let (mut gradients, mut images, mut skips) = (Vec::new(), Vec::new(), Vec::new());
    for &size in &arguments.scenes {
        terminal.proceed()?;
        terminal.stage(size);
        let found = splat::measure(size, arguments.repeat)?;
        gradients.extend(found.gradients);
        images.extend(found.image);
        skips.extend(found.skips.iter().map(|skip| skip.row(&size.to_string().replace(", ", " at "))));
    }
    let [gradients, images] = splat::charts(gradients, images);
    let table = write(&gradients, &arguments.out, "pareto-splat")?;
    write(&images, &arguments.out, "pareto-splat-image")?;
    write_csv(&arguments.out.join("skipping.csv"), &skipping::COLUMNS.map(String::from), &skips)?;
    Ok(table)
}
