//! Bias of the light at vertices against path tracing, case by case.
//!
//! ```text
//! cargo run --release --example vertex_bias [CASE,.. [SAMPLES [PIXELS]]]
//! ```
//! Six frames per case: at one half and nine tenths of the route, at phases 0, .5 and 1, lit as in the films. Per
//! frame: the ratio of the mean image to that of the paths, per channel, with the standard error of the paths' mean
//! (from eight parts), relMSE free of the reference's noise (the product of the differences from two halves of the
//! parts, over the square of their mean and 1e-4 of the image's), and the CPU seconds of one frame. References are kept
//! in `target/vertex_bias`; delete them after a change of the materials.

use std::path::Path;

use respire_bench::airway::{self, case::Case};
use respire_bench::base::{Image, Result};
use respire_bench::experiments::case_scene::{CaseScene, Viewpoint};
use respire_bench::experiments::{difference::relative_mse, timing};
use respire_bench::formats::exr;
use respire_bench::render::{Light, RenderSettings, Shading, Transport};
use respire_bench::simulate::trajectory::Route;

/// Fractions of the route, and phases.
const PLACES: [(f64, f64); 6] = [(0.5, 0.0), (0.5, 0.5), (0.5, 1.0), (0.9, 0.0), (0.9, 0.5), (0.9, 1.0)];
/// Independent parts of a reference.
const PARTS: u64 = 8;

fn main() -> Result<()> {
    let mut arguments = std::env::args().skip(1);
    let all = (1..=9).map(|n| format!("case{n}")).collect::<Vec<_>>().join(",");
    let names = arguments.next().unwrap_or(all);
    let samples: u32 = arguments.next().and_then(|v| v.parse().ok()).unwrap_or(256);
    let pixels: u32 = arguments.next().and_then(|v| v.parse().ok()).unwrap_or(96);
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    for name in names.split(',') {
        let case = Case::load(&root.join(format!("bench-cases/{name}.toml")))?;
        let anatomy = airway::build(&case)?;
        let route = Route::plan(&anatomy, &case.trajectory)?;
        let mut scene = CaseScene::new(&case, &anatomy)?;
        for (part, phase) in PLACES {
            scene.set_phase(phase)?;
            let mut viewpoint = Viewpoint::on_route(&case, &route, part * route.length_mm(), phase, pixels);
            let emission_exponent = Light::exponent_of_half_angle(case.scope.emission_half_angle_deg);
            viewpoint.light = Light { emission_exponent, ..viewpoint.light };
            let picture = |settings: &RenderSettings| viewpoint.radiance(&scene.scene, settings);
            let folder = root.join(format!("target/vertex_bias/{name}-{part}-{phase}-{samples}x{pixels}"));
            let paths = reference(&folder, samples, &picture)?;
            let vertices = RenderSettings { transport: Transport::VERTICES, ..settings(4, case.seed) };
            picture(&vertices)?;
            let (found, cost) = timing::measure(|| picture(&vertices));
            report(name, [part, phase], &paths, &found?, cost.cpu_s);
        }
    }
    Ok(())
}

fn settings(samples_per_pixel: u32, seed: u64) -> RenderSettings {
    RenderSettings { samples_per_pixel, shading: Shading::Smooth, seed, ..RenderSettings::default() }
}

/// The independent parts of the reference.
fn reference(
    folder: &Path,
    samples: u32,
    picture: &dyn Fn(&RenderSettings) -> Result<Image<f32>>,
) -> Result<Vec<Image<f32>>> {
    let file = |part| folder.join(format!("{part}.exr"));
    (0..PARTS)
        .map(|part| {
            if !file(part).is_file() {
                let image = picture(&settings(samples / PARTS as u32, 7000 + part))?;
                exr::write_rgb(&file(part), &image)?;
            }
            exr::read(&file(part))
        })
        .collect()
}

fn mean(image: &Image<f32>) -> [f64; 3] {
    let sum = |c: usize| image.data.iter().skip(c).step_by(3).map(|&v| f64::from(v)).sum::<f64>();
    std::array::from_fn(|c| sum(c) / (image.data.len() / 3) as f64)
}

/// relMSE, free of the noise of the parts.
fn relative_error(found: &Image<f32>, parts: &[Image<f32>]) -> f64 {
    let half = |first: usize| -> Vec<f64> {
        let chosen: Vec<&Image<f32>> = parts.iter().skip(first).step_by(2).collect();
        let value = |k: usize| chosen.iter().map(|p| f64::from(p.data[k])).sum::<f64>() / chosen.len() as f64;
        (0..found.data.len()).map(value).collect()
    };
    let (a, b) = (half(0), half(1));
    let mean = a.iter().chain(&b).sum::<f64>() / (2.0 * a.len() as f64);
    relative_mse(&found.data, [&a, &b], 1e-4 * mean * mean)
}

fn report(name: &str, [part, phase]: [f64; 2], parts: &[Image<f32>], picture: &Image<f32>, cpu: f64) {
    let count = parts.len() as f64;
    let (paths, found): (Vec<[f64; 3]>, [f64; 3]) = (parts.iter().map(mean).collect(), mean(picture));
    let mut line = format!("{name} at {part}, phase {phase}:");
    for c in 0..3 {
        let truth = paths.iter().map(|p| p[c]).sum::<f64>() / count;
        let variance = paths.iter().map(|p| (p[c] - truth).powi(2)).sum::<f64>() / (count * (count - 1.0));
        line += &format!(" {:+.2} +- {:.2} %", 100.0 * (found[c] / truth - 1.0), 100.0 * variance.sqrt() / truth);
    }
    println!("{line}   relMSE {:.4}   {cpu:.3} CPU-s", relative_error(picture, parts));
}
