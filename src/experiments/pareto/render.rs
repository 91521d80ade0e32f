//! Time against error of the path tracer's modes.
//!
//! The error is relMSE, the mean of `(x - r)^2 / (r^2 + 1e-4 m^2)`, to a reference r with unlimited bounces, m its
//! mean; the reference's own noise, estimated from its two halves, is subtracted. The cost is CPU time, which other
//! work on the machine disturbs least.

use crate::airway::{self, case::Case};
use crate::base::{Estimate, Image, Result};
use crate::experiments::ExperimentWatcher;
use crate::experiments::case_scene::{CaseScene, Viewpoint};
use crate::experiments::difference::relative_mse;
use crate::experiments::timing;
use crate::render::{Denoise, RenderSettings, Shading, Transport};
use crate::report::pareto_chart::{ParetoChart, ParetoPoint, SettingRole};
use crate::simulate::trajectory::Route;

/// Samples per pixel of the simulator's profiles, which render light at vertices.
const DEFAULT_SAMPLES: u32 = 4;
/// relMSE's floor, as a share of the squared mean of the reference: keeps dark pixels from deciding.
const FLOOR_SHARE: f64 = 1e-4;

/// Which frame is rendered, and with how many samples.
#[derive(Clone, Copy, Debug)]
pub struct RenderSweep {
    /// Image width and height in pixels.
    pub width_px: u32,
    /// Samples per pixel of the reference.
    pub reference_samples: u32,
    /// Most samples per pixel of a measured setting.
    pub most_samples: u32,
    /// Breathing phase of the frame, 0 inspiration to 1 expiration.
    pub phase: f64,
}

/// The model behind [`RenderSweep::estimate`]: core seconds of a path and of a case whatever its samples, and bytes of
/// a pixel in the images that are held at a time.
const SAMPLE_S: f64 = 3e-6;
const CASE_S: f64 = 30.0;
const PIXEL_BYTES: f64 = 500.0;

impl RenderSweep {
    /// What the points of one case would cost.
    pub fn estimate(&self) -> Estimate {
        let pixels = f64::from(self.width_px).powi(2);
        // The reference; two families of paths with 1, 2, 4 .. samples, and three of light at vertices with up to 16.
        let samples = f64::from(self.reference_samples) + 4.0 * f64::from(self.most_samples) + 96.0;
        Estimate {
            memory_bytes: pixels * PIXEL_BYTES,
            seconds: (CASE_S + pixels * samples * SAMPLE_S) / rayon::current_num_threads() as f64,
            resumable: false,
        }
    }
}

/// The chart of these points.
pub fn chart(points: Vec<ParetoPoint>) -> ParetoChart {
    ParetoChart { cost: "CPU seconds per frame", error: "relMSE to unlimited bounces", points }
}

/// Every mode with its powers of two of samples, on the frame in the middle of a case's route.
pub fn points(case: &Case, sweep: &RenderSweep, watcher: &dyn ExperimentWatcher) -> Result<Vec<ParetoPoint>> {
    watcher.stage_starts(&format!("{}: reference", case.id));
    let subject = Subject::new(case, sweep)?;
    let reference = Reference::render(&subject, sweep.reference_samples)?;
    watcher.stage_starts(&format!("{}: modes", case.id));
    let mut points = Vec::new();
    for mode in modes(case.seed, sweep.most_samples) {
        let mut samples_per_pixel = 1;
        while samples_per_pixel <= mode.most_samples {
            watcher.proceed()?;
            points.push(point(&subject, &reference, &mode, samples_per_pixel)?);
            samples_per_pixel *= 2;
        }
    }
    Ok(points)
}

/// One frame of a case, ready to be rendered in any mode.
struct Subject {
    case_id: String,
    seed: u64,
    scene: CaseScene,
    viewpoint: Viewpoint,
}

impl Subject {
    fn new(case: &Case, sweep: &RenderSweep) -> Result<Subject> {
        let anatomy = airway::build(case).map_err(|e| case.blamed(e))?;
        let route = Route::plan(&anatomy, &case.trajectory).map_err(|e| case.blamed(e))?;
        let mut scene = CaseScene::new(case, &anatomy)?;
        scene.set_phase(sweep.phase)?;
        let viewpoint = Viewpoint::on_route(case, &route, 0.5 * route.length_mm(), sweep.phase, sweep.width_px);
        Ok(Subject { case_id: case.id.clone(), seed: case.seed, scene, viewpoint })
    }

    fn image(&self, settings: &RenderSettings) -> Result<Image<f32>> {
        self.viewpoint.radiance(&self.scene.scene, settings)
    }
}

/// A converged image and how noisy it still is.
struct Reference {
    values: Vec<f64>,
    sum: f64,
    floor: f64,
    noise: f64,
}

impl Reference {
    fn render(subject: &Subject, samples: u32) -> Result<Reference> {
        let half = |seed: u64| subject.image(&plain(samples.div_ceil(2), seed));
        let (a, b) = (half(subject.seed + 1000)?, half(subject.seed + 2000)?);
        let mean: Vec<f32> = a.data.iter().zip(&b.data).map(|(x, y)| 0.5 * (x + y)).collect();
        let [a, b, values] =
            [&a.data, &b.data, &mean].map(|data| data.iter().map(|&v| f64::from(v)).collect::<Vec<_>>());
        let sum = values.iter().sum::<f64>();
        let floor = FLOOR_SHARE * (sum / values.len() as f64).powi(2);
        // (m - a)(m - b) = -(a - b)^2 / 4 with m = (a + b) / 2: the variance of the mean of the halves, negative.
        let noise = -relative_mse(&mean, [&a, &b], floor);
        Ok(Reference { values, sum, floor, noise })
    }

    /// relMSE of `image`, free of the reference's noise, and the ratio of the means minus 1.
    fn compare(&self, image: &Image<f32>) -> (f64, f64) {
        let error = relative_mse(&image.data, [&self.values, &self.values], self.floor) - self.noise;
        let sum = image.data.iter().map(|&v| f64::from(v)).sum::<f64>();
        (error, sum / self.sum - 1.0)
    }
}

fn plain(samples_per_pixel: u32, seed: u64) -> RenderSettings {
    RenderSettings { samples_per_pixel, seed, shading: Shading::Smooth, ..RenderSettings::default() }
}

/// A family of settings and the numbers of samples per pixel that are tried.
struct RenderMode {
    name: String,
    settings: RenderSettings,
    most_samples: u32,
}

fn modes(seed: u64, most_samples: u32) -> Vec<RenderMode> {
    let paths = plain(1, seed);
    let mode = |name: &str, settings, most_samples| RenderMode { name: name.into(), settings, most_samples };
    let mut modes = vec![
        mode("paths", paths, most_samples),
        mode("paths, filtered", RenderSettings { denoise: Denoise::On, ..paths }, most_samples),
    ];
    for rays_per_face in [8, 32, 128] {
        let settings = RenderSettings { transport: Transport::Vertices { rays_per_face }, ..paths };
        modes.push(mode(&format!("vertices, {rays_per_face} rays"), settings, most_samples.min(16)));
    }
    modes
}

fn point(subject: &Subject, reference: &Reference, mode: &RenderMode, samples_per_pixel: u32) -> Result<ParetoPoint> {
    let settings = RenderSettings { samples_per_pixel, ..mode.settings };
    // What a film makes once for all frames (the tissue's map) is made before the clock starts.
    if matches!(settings.transport, Transport::Vertices { .. }) {
        subject.image(&RenderSettings { samples_per_pixel: 1, ..settings })?;
    }
    let (image, cost) = timing::measure(|| subject.image(&settings));
    let (error, bias) = reference.compare(&image?);
    let is_default = settings.transport == Transport::VERTICES && samples_per_pixel == DEFAULT_SAMPLES;
    Ok(ParetoPoint {
        subject: subject.case_id.clone(),
        mode: mode.name.clone(),
        setting: format!("{samples_per_pixel}"),
        cost: cost.cpu_s,
        error,
        role: if is_default { SettingRole::Default } else { SettingRole::Alternative },
        extra: vec![("wall_s", cost.wall_s), ("mean_ratio_minus_1", bias), ("reference_relmse", reference.noise)],
    })
}
