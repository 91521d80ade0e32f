//! `respire-bench pareto render`: time against error of the path tracer's modes.
//!
//! The error is relMSE, the mean of `(x - r)^2 / (r^2 + 1e-4 m^2)`, to a reference r with unlimited bounces, m its mean; the
//! reference's own noise, estimated from its two halves, is taken off. The cost is CPU time, which other work on the
//! machine disturbs least.

use std::path::PathBuf;
use std::time::Instant;

use clap::Args;

use super::Terminal;
use crate::airway::case::Case;
use crate::base::{Camera, Image, Result, mesh};
use crate::bench::Catalogue;
use crate::ffi::system::cpu_time_s;
use crate::render::{Denoise, Light, RenderSettings, Scene, Shading, render};
use crate::report::pareto::{Chart, Point, Standing, write};
use crate::simulate::material;
use crate::simulate::trajectory::Route;

/// Arguments of `pareto render`.
#[derive(Args)]
pub(super) struct Arguments {
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
    /// In the middle of the way, half breathed out.
    fn of(case: &Case, width: u32) -> Result<View> {
        let anatomy = crate::airway::build(case)?;
        let route = Route::plan(&anatomy, &case.trajectory)?;
        let phase = 0.5;
        let mut scene = Scene::new(&anatomy.inspiration, &anatomy.vertex_generation, material(case)?, case.seed)?;
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

/// Samples per pixel that the simulator's profiles use.
const DEFAULT_SAMPLES: u32 = 8;

/// Every mode with its powers of two of samples.
fn measure(view: &View, reference: &Reference, most_samples: u32) -> Result<Vec<Point>> {
    let mut points = Vec::new();
    for (mode, denoise) in [("plain", Denoise::Off), ("filtered", Denoise::On)] {
        let mut samples = 1;
        while samples <= most_samples {
            let settings = RenderSettings { denoise, ..raw(samples, view.seed) };
            let (wall, cpu) = (Instant::now(), cpu_time_s());
            let image = view.image(&settings)?;
            let (wall, cost) = (wall.elapsed().as_secs_f64(), cpu_time_s() - cpu);
            let (error, bias) = reference.compare(&image);
            let standing = match (denoise, samples) {
                (Denoise::On, DEFAULT_SAMPLES) => Standing::Default,
                _ => Standing::Alternative,
            };
            points.push(Point {
                subject: view.name.clone(),
                mode: mode.into(),
                setting: format!("{samples} spp"),
                cost,
                error,
                standing,
                extra: vec![("wall_s", wall), ("mean_ratio_minus_1", bias), ("reference_relmse", reference.noise)],
            });
            samples *= 2;
        }
    }
    Ok(points)
}

/// Runs the command.
pub(super) fn run(arguments: Arguments, terminal: &Terminal) -> Result<()> {
    let catalogue = Catalogue::find(arguments.bench_cases.as_deref())?;
    let mut points = Vec::new();
    for name in &arguments.cases {
        let case = Case::load(&catalogue.case_file(name)?)?;
        terminal.stage(format!("{}: reference", case.id));
        let view = View::of(&case, arguments.width)?;
        let reference = Reference::render(&view, arguments.reference_spp)?;
        terminal.stage(format!("{}: modes", case.id));
        points.extend(measure(&view, &reference, arguments.most_spp)?);
    }
    let chart = Chart { cost: "CPU seconds per frame", error: "relMSE to unlimited bounces", points };
    let table = write(&chart, &arguments.out, "pareto-render")?;
    terminal.line(table.display());
    Ok(())
}
