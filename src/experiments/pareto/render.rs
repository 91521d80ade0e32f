//! `respire-bench pareto render`: time against error of the path tracer's modes.
//!
//! The error is relMSE, the mean of `(x - r)^2 / (r^2 + 1e-4 m^2)`, to a reference r with unlimited bounces, m its mean; the
//! reference's own noise, estimated from its two halves, is taken off. The cost is CPU time, which other work on the
//! machine disturbs least.

use std::path::PathBuf;
use std::time::Instant;

use clap::Args;

use crate::airway::case::Case;
use crate::base::{Camera, Error, Image, Progress, Result, mesh};
use crate::bench::Catalogue;
use crate::cli::Terminal;
use crate::ffi::system::cpu_time_s;
use crate::render::{Denoise, Light, RenderSettings, Scene, Shading, Transport, render};
use crate::report::pareto_chart::{Chart, Point, Standing, write};
use crate::simulate::material;
use crate::simulate::trajectory::Route;

/// Arguments of `pareto render`.
#[derive(Args)]
pub(crate) struct Arguments {
    /// Folder for table and plots
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Cases by id, or paths of case files
    #[arg(long, value_delimiter = ',', value_name = "CASE,..", default_value = "case1,case5,case9")]
    cases: Vec<String>,
    /// Image width and height in pixels
    #[arg(long, default_value_t = 256, value_name = "PX")]
    width: u32,
    /// Samples per pixel of the reference
    #[arg(long, default_value_t = 1024, value_name = "N")]
    reference_spp: u32,
    /// Most samples per pixel of a measured setting
    #[arg(long, default_value_t = 64, value_name = "N")]
    most_spp: u32,
    /// Breathing phase of the frame, 0 inspiration (the shape at which the tissue's map is made) to 1 expiration
    #[arg(long, default_value_t = 0.5, value_name = "PHASE")]
    phase: f64,
    /// Folder with cases and profiles
    #[arg(long, value_name = "DIR")]
    bench_cases: Option<PathBuf>,
}

/// One frame of a case, ready to be rendered in any mode.
struct View {
    name: String,
    scene: Scene,
    camera: Camera,
    pose: glam::DAffine3,
    light: Light,
    seed: u64,
}

impl View {
    /// In the middle of the way.
    fn of(case: &Case, width: u32, phase: f64) -> Result<View> {
        let anatomy = crate::airway::build(case)?;
        let route = Route::plan(&anatomy, &case.trajectory)?;
        let mut scene = Scene::new(&anatomy.inspiration, &anatomy.vertex_generation, material(case)?, case.seed)?;
        scene.set_other_end(&anatomy.expiration.vertices)?;
        scene.deform(&mesh::interpolate(&anatomy.inspiration.vertices, &anatomy.expiration.vertices, phase))?;
        Ok(View {
            name: case.id.clone(),
            scene,
            camera: case.camera.camera(width, width),
            pose: route.pose(0.5 * route.length_mm(), phase),
            light: Light::at_camera(case.light_intensity),
            seed: case.seed,
        })
    }

    fn image(&self, settings: &RenderSettings) -> Result<Image<f32>> {
        Ok(render(&self.scene, &self.camera, &self.pose, &self.light, settings)?.radiance)
    }
}

/// A converged image and how noisy it still is.
struct Reference {
    image: Image<f32>,
    noise: f64,
}

impl Reference {
    fn render(view: &View, samples: u32) -> Result<Reference> {
        let half = |seed: u64| view.image(&raw(samples.div_ceil(2), seed));
        let (a, b) = (half(view.seed + 1000)?, half(view.seed + 2000)?);
        let mut image = a.clone();
        image.data.iter_mut().zip(&b.data).for_each(|(x, y)| *x = 0.5 * (*x + y));
        // The halves differ by twice the standard deviation of their mean.
        let noise = relative_error(&a, &b, &image) / 4.0;
        Ok(Reference { image, noise })
    }

    /// relMSE of `image`, free of the reference's noise, and the ratio of the means minus 1.
    fn compare(&self, image: &Image<f32>) -> (f64, f64) {
        let error = relative_error(image, &self.image, &self.image) - self.noise;
        let mean = |i: &Image<f32>| i.data.iter().map(|&v| f64::from(v)).sum::<f64>();
        (error, mean(image) / mean(&self.image) - 1.0)
    }
}

fn relative_error(a: &Image<f32>, b: &Image<f32>, truth: &Image<f32>) -> f64 {
    let count = truth.data.len() as f64;
    let mean = truth.data.iter().map(|&v| f64::from(v)).sum::<f64>() / count;
    let floor = 1e-4 * mean * mean;
    let term = |((&a, &b), &t): ((&f32, &f32), &f32)| f64::from(a - b).powi(2) / (f64::from(t).powi(2) + floor);
    a.data.iter().zip(&b.data).zip(&truth.data).map(term).sum::<f64>() / count
}

fn raw(samples_per_pixel: u32, seed: u64) -> RenderSettings {
    RenderSettings { samples_per_pixel, seed, shading: Shading::Smooth, ..RenderSettings::default() }
}

/// Samples per pixel of the simulator's profiles, which render light at vertices.
const DEFAULT_SAMPLES: u32 = 4;

/// A family of settings and the numbers of samples per pixel that are tried.
struct Mode {
    name: String,
    settings: RenderSettings,
    most_samples: u32,
}

fn modes(view: &View, most_samples: u32) -> Vec<Mode> {
    let plain = raw(1, view.seed);
    let mode = |name: &str, settings, most_samples| Mode { name: name.into(), settings, most_samples };
    let mut modes = vec![
        mode("paths", plain, most_samples),
        mode("paths, filtered", RenderSettings { denoise: Denoise::On, ..plain }, most_samples),
    ];
    for rays_per_face in [8, 32, 128] {
        let settings = RenderSettings { transport: Transport::Vertices { rays_per_face }, ..plain };
        modes.push(mode(&format!("vertices, {rays_per_face} rays"), settings, most_samples.min(16)));
    }
    modes
}

/// Every mode with its powers of two of samples.
fn measure(view: &View, reference: &Reference, most_samples: u32, terminal: &Terminal) -> Result<Vec<Point>> {
    let mut points = Vec::new();
    for mode in modes(view, most_samples) {
        let mut samples_per_pixel = 1;
        while samples_per_pixel <= mode.most_samples {
            if terminal.cancelled() {
                return Err(Error::interrupted());
            }
            points.push(point(view, reference, &mode, samples_per_pixel)?);
            samples_per_pixel *= 2;
        }
    }
    Ok(points)
}

fn point(view: &View, reference: &Reference, mode: &Mode, samples_per_pixel: u32) -> Result<Point> {
    let settings = RenderSettings { samples_per_pixel, ..mode.settings };
    // What a film makes once for all frames (the tissue's map) is made before the clock starts.
    if matches!(settings.transport, Transport::Vertices { .. }) {
        view.image(&RenderSettings { samples_per_pixel: 1, ..settings })?;
    }
    let (wall, cpu) = (Instant::now(), cpu_time_s());
    let image = view.image(&settings)?;
    let (wall, cost) = (wall.elapsed().as_secs_f64(), cpu_time_s() - cpu);
    let (error, bias) = reference.compare(&image);
    let is_default = settings.transport == Transport::VERTICES && samples_per_pixel == DEFAULT_SAMPLES;
    Ok(Point {
        subject: view.name.clone(),
        mode: mode.name.clone(),
        setting: format!("{samples_per_pixel}"),
        cost,
        error,
        standing: if is_default { Standing::Default } else { Standing::Alternative },
        extra: vec![("wall_s", wall), ("mean_ratio_minus_1", bias), ("reference_relmse", reference.noise)],
    })
}

/// Runs the command.
pub(crate) fn run(arguments: Arguments, terminal: &Terminal) -> Result<()> {
    let catalogue = Catalogue::find(arguments.bench_cases.as_deref())?;
    if !(0.0..=1.0).contains(&arguments.phase) {
        return Err(Error::usage(format!("the phase is {}; it must lie in [0, 1]", arguments.phase)));
    }
    let mut points = Vec::new();
    for name in &arguments.cases {
        let case = Case::load(&catalogue.case_file(name)?)?;
        terminal.stage(format!("{}: reference", case.id));
        let view = View::of(&case, arguments.width, arguments.phase)?;
        let reference = Reference::render(&view, arguments.reference_spp)?;
        terminal.stage(format!("{}: modes", case.id));
        points.extend(measure(&view, &reference, arguments.most_spp, terminal)?);
    }
    let chart = Chart { cost: "CPU seconds per frame", error: "relMSE to unlimited bounces", points };
    let table = write(&chart, &arguments.out, "pareto-render")?;
    terminal.line(table.display());
    Ok(())
}
