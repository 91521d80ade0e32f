//! How far the light at vertices is off the mean of its own paths, case by case.
//!
//! ```text
//! cargo run --release --example vertex_bias [CASE,.. [SAMPLES [PIXELS]]]
//! ```
//! Two frames per case: half way at phase .3 and nine tenths of the way at phase .8, lit as in the films. Per frame: the
//! ratio of the mean picture to that of the paths, per channel, with the standard error of the paths' mean (from eight
//! parts), and the CPU seconds of one frame. References are kept in `target/vertex_bias`; delete them after a change of the
//! look.

use std::path::{Path, PathBuf};

use respire_bench::airway::{self, case::Case};
use respire_bench::base::{Image, Result, mesh};
use respire_bench::ffi::system::cpu_time_s;
use respire_bench::formats::exr;
use respire_bench::render::{Light, Material, RenderSettings, Scene, Shading, Transport, render};
use respire_bench::simulate::{material, trajectory::Route};

/// Parts of the way and phases.
const PLACES: [(f64, f64); 2] = [(0.5, 0.3), (0.9, 0.8)];
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
        let mut anatomy = airway::build(&case)?;
        if std::env::var("FINE").is_ok() {
            fine(&mut anatomy);
        }
        let route = Route::plan(&anatomy, &case.trajectory)?;
        let look = look(&case)?;
        let mut scene = Scene::new(&anatomy.inspiration, &anatomy.vertex_generation, look, case.seed)?;
        scene.set_other_end(&anatomy.expiration.vertices)?;
        for (part, phase) in PLACES {
            let phase = std::env::var("PHASE").ok().map_or(phase, |p| p.parse().unwrap());
            scene.deform(&mesh::interpolate(&anatomy.inspiration.vertices, &anatomy.expiration.vertices, phase))?;
            let pose = route.pose(part * route.length_mm(), phase);
            let exponent = Light::exponent_of_half_angle(case.scope.emission_half_angle_deg);
            let light = Light { emission_exponent: exponent, ..Light::at_camera(case.light_intensity) };
            let picture = |settings: &RenderSettings| -> Result<Image<f32>> {
                Ok(render(&scene, &case.camera.camera(pixels, pixels), &pose, &light, settings)?.radiance)
            };
            let mut variant = std::env::var("LOOK").unwrap_or_default();
            variant += &std::env::var("FINE").unwrap_or_default();
            variant += &std::env::var("PHASE").unwrap_or_default();
            let folder = root.join(format!("target/vertex_bias/{name}{variant}-{part}-{samples}x{pixels}"));
            let paths = reference(&folder, samples, &picture)?;
            let rays_per_face = std::env::var("RAYS").ok().map_or(32, |p| p.parse().unwrap());
            let spp = std::env::var("SPP").ok().map_or(4, |p| p.parse().unwrap());
            let vertices =
                RenderSettings { transport: Transport::Vertices { rays_per_face }, ..settings(spp, case.seed) };
            picture(&vertices)?;
            let cpu = cpu_time_s();
            let found = mean(&picture(&vertices)?);
            let cpu = cpu_time_s() - cpu;
            report(name, part, &paths, found, cpu);
        }
    }
    Ok(())
}

fn fine(a: &mut airway::Anatomy) {
    let mut mids = std::collections::HashMap::new();
    let mut faces = Vec::new();
    let old = a.inspiration.faces.clone();
    for f in old {
        let m: [u32; 3] = std::array::from_fn(|k| {
            let (i, j) = (f[k].min(f[(k + 1) % 3]), f[k].max(f[(k + 1) % 3]));
            *mids.entry((i, j)).or_insert_with(|| {
                let (i, j) = (i as usize, j as usize);
                for v in [&mut a.inspiration.vertices, &mut a.expiration.vertices] {
                    let m = v[i].lerp(v[j], 0.5);
                    v.push(m);
                }
                let g = 0.5 * (a.vertex_generation[i] + a.vertex_generation[j]);
                a.vertex_generation.push(g);
                a.vertex_generation.len() as u32 - 1
            })
        });
        faces.extend([[f[0], m[0], m[2]], [m[0], f[1], m[1]], [m[2], m[1], f[2]], m]);
    }
    a.inspiration.faces = faces.clone();
    a.expiration.faces = faces;
}

fn look(case: &Case) -> Result<Material> {
    let mut look = material(case)?;
    let off: respire_bench::render::Subsurface = respire_bench::render::Subsurface::Off;
    match std::env::var("LOOK").as_deref() {
        Ok("lambert") => return Ok(Material::lambert(look.albedo)),
        Ok("nosss") => look.subsurface = Some(off),
        Ok("norings") => look.rings = 0.0,
        _ => {}
    }
    Ok(look)
}

fn settings(samples_per_pixel: u32, seed: u64) -> RenderSettings {
    RenderSettings { samples_per_pixel, shading: Shading::Smooth, seed, ..RenderSettings::default() }
}

/// Mean pictures of the parts.
fn reference(
    folder: &PathBuf,
    samples: u32,
    picture: &dyn Fn(&RenderSettings) -> Result<Image<f32>>,
) -> Result<Vec<[f64; 3]>> {
    let file = |part| folder.join(format!("{part}.exr"));
    (0..PARTS)
        .map(|part| {
            if !file(part).is_file() {
                let image = picture(&settings(samples / PARTS as u32, 7000 + part))?;
                exr::write_rgb(&file(part), &image)?;
            }
            Ok(mean(&exr::read(&file(part))?))
        })
        .collect()
}

fn mean(image: &Image<f32>) -> [f64; 3] {
    let sum = |c: usize| image.data.iter().skip(c).step_by(3).map(|&v| f64::from(v)).sum::<f64>();
    std::array::from_fn(|c| sum(c) / (image.data.len() / 3) as f64)
}

fn report(name: &str, part: f64, paths: &[[f64; 3]], found: [f64; 3], cpu: f64) {
    let count = paths.len() as f64;
    let mut line = format!("{name} at {part}:");
    for c in 0..3 {
        let truth = paths.iter().map(|p| p[c]).sum::<f64>() / count;
        let variance = paths.iter().map(|p| (p[c] - truth).powi(2)).sum::<f64>() / (count * (count - 1.0));
        line += &format!(" {:+.2} +- {:.2} %", 100.0 * (found[c] / truth - 1.0), 100.0 * variance.sqrt() / truth);
    }
    println!("{line}   {cpu:.3} CPU-s");
}
