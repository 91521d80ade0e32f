//! What a film's frame costs, and how much it flickers.
//!
//! ```text
//! cargo run --release --example frame_cost [CASE [PIXELS]]
//! ```
//! Three measurements in CPU seconds, which a busy machine disturbs least: deforming and rendering one frame of the
//! case's airway alone and with three more airways of its size that the camera cannot see, in turns; one refit of 100,000
//! triangles; and the mean temporal difference of two neighbouring frames beyond the converged one, of the default mode
//! and of 64 paths per pixel.

use std::path::Path;

use glam::{DAffine3, DVec3};
use respire_bench::airway::{self, Anatomy, case::Case};
use respire_bench::base::{Camera, Image, Result, TriangleMesh, mesh};
use respire_bench::ffi::system::cpu_time_s;
use respire_bench::render::{Light, RenderSettings, Scene, Shading, Transport, render};
use respire_bench::simulate::{material, trajectory::Route};

/// Turns of the race.
const TURNS: usize = 9;

fn main() -> Result<()> {
    let mut arguments = std::env::args().skip(1);
    let name = arguments.next().unwrap_or_else(|| "case1".into());
    let pixels: u32 = arguments.next().and_then(|v| v.parse().ok()).unwrap_or(128);
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let case = Case::load(&root.join(format!("bench-cases/{name}.toml")))?;
    let anatomy = airway::build(&case)?;
    race(&case, &anatomy, pixels)?;
    refit(&case, &anatomy)?;
    flicker(&case, &anatomy)
}

/// An airway, and `more` others of its size out of sight.
fn with_others(mesh: &TriangleMesh, more: u32) -> TriangleMesh {
    let mut all = mesh.clone();
    for copy in 1..=more {
        let first = all.vertices.len() as u32;
        all.vertices.extend(mesh.vertices.iter().map(|&v| v + DVec3::X * 400.0 * f64::from(copy)));
        all.faces.extend(mesh.faces.iter().map(|f| f.map(|v| v + first)));
    }
    all
}

/// A scene and the two ends of its motion.
struct Stage {
    scene: Scene,
    ends: [Vec<DVec3>; 2],
}

impl Stage {
    fn new(case: &Case, anatomy: &Anatomy, more: u32) -> Result<Stage> {
        let [rest, other] = [&anatomy.inspiration, &anatomy.expiration].map(|m| with_others(m, more));
        let generation = anatomy.vertex_generation.repeat(more as usize + 1);
        let mut scene = Scene::new(&rest, &generation, material(case)?, case.seed)?;
        scene.set_other_end(&other.vertices)?;
        Ok(Stage { scene, ends: [rest.vertices, other.vertices] })
    }

    fn picture(&mut self, view: &View, settings: &RenderSettings) -> Result<Image<f32>> {
        self.scene.deform(&mesh::interpolate(&self.ends[0], &self.ends[1], view.phase))?;
        Ok(render(&self.scene, &view.camera, &view.pose, &view.light, settings)?.radiance)
    }
}

struct View {
    camera: Camera,
    pose: DAffine3,
    light: Light,
    phase: f64,
}

impl View {
    /// The middle of the way, some hundredths of a second later.
    fn new(case: &Case, anatomy: &Anatomy, pixels: u32, later: f64) -> Result<View> {
        let route = Route::plan(anatomy, &case.trajectory)?;
        let phase = 0.5 + 0.4 * later;
        Ok(View {
            camera: case.camera.camera(pixels, pixels),
            pose: route.pose(0.5 * route.length_mm() + case.trajectory.speed_mm_per_s * later, phase),
            light: Light { emission_exponent: 1.0, ..Light::at_camera(case.light_intensity) },
            phase,
        })
    }
}

fn settings(seed: u64, frame: u64, transport: Transport, samples_per_pixel: u32) -> RenderSettings {
    RenderSettings { samples_per_pixel, transport, shading: Shading::Smooth, seed, frame, ..RenderSettings::default() }
}

fn race(case: &Case, anatomy: &Anatomy, pixels: u32) -> Result<()> {
    let view = View::new(case, anatomy, pixels, 0.0)?;
    let mut stages = [Stage::new(case, anatomy, 0)?, Stage::new(case, anatomy, 3)?];
    let mut best = [f64::INFINITY; 2];
    // The first turn makes what a film keeps.
    for turn in 0..=TURNS {
        for (stage, best) in stages.iter_mut().zip(&mut best) {
            let start = cpu_time_s();
            stage.picture(&view, &settings(case.seed, turn as u64, Transport::VERTICES, 4))?;
            if turn > 0 {
                *best = best.min(cpu_time_s() - start);
            }
        }
    }
    let triangles = stages[0].scene.triangles();
    println!(
        "one frame of {pixels} x {pixels}, 4 samples: {:.4} CPU-s with {triangles} triangles, {:.4} with {} ({:+.1} %)",
        best[0],
        best[1],
        4 * triangles,
        100.0 * (best[1] / best[0] - 1.0)
    );
    Ok(())
}

fn refit(case: &Case, anatomy: &Anatomy) -> Result<()> {
    let more = (100_000 / anatomy.inspiration.faces.len()) as u32;
    let mut stage = Stage::new(case, anatomy, more)?;
    let triangles = stage.scene.triangles();
    let mut seconds: Vec<f64> = (0..TURNS).map(|_| stage.scene.refit_seconds()).collect::<Result<_>>()?;
    seconds.sort_by(f64::total_cmp);
    println!(
        "refit of {triangles} triangles: {:.2} ms at best, median {:.2}",
        1e3 * seconds[0],
        1e3 * seconds[TURNS / 2]
    );
    Ok(())
}

fn flicker(case: &Case, anatomy: &Anatomy) -> Result<()> {
    let mut stage = Stage::new(case, anatomy, 0)?;
    let views = [View::new(case, anatomy, 64, 0.0)?, View::new(case, anatomy, 64, 0.04)?];
    let mut change = |transport, samples, seed| -> Result<Vec<f32>> {
        let mut picture = |k: usize| stage.picture(&views[k], &settings(seed, k as u64, transport, samples));
        let (first, second) = (picture(0)?, picture(1)?);
        Ok(first.data.iter().zip(&second.data).map(|(a, b)| b - a).collect())
    };
    // The wall's pattern follows the scene's seed, not this one.
    let converged = change(Transport::Paths, 1024, 1001)?;
    let beyond = |change: Vec<f32>| {
        change.iter().zip(&converged).map(|(a, b)| f64::from((a - b).abs())).sum::<f64>() / converged.len() as f64
    };
    let ours = beyond(change(Transport::VERTICES, 4, case.seed)?);
    let paths = beyond(change(Transport::Paths, 64, 1002)?);
    println!(
        "temporal difference beyond the converged one: default {ours:.5}, 64 paths {paths:.5} ({:.2})",
        ours / paths
    );
    Ok(())
}
