//! What a film's frame costs, and how much it flickers.
//!
//! ```text
//! cargo run --release --example frame_cost [CASE [PIXELS]]
//! ```
//! Three measurements in CPU seconds, which a busy machine disturbs least: deforming and rendering one frame of the
//! case's airway alone and with three more airways of its size that the camera cannot see, in turns; one refit of
//! 100,000 triangles; and the mean temporal difference of two neighbouring frames beyond the converged one, of the
//! default mode and of 64 paths per pixel.

use std::path::Path;

use glam::DVec3;
use respire_bench::airway::{self, Anatomy, case::Case};
use respire_bench::base::{Image, Result, TriangleMesh};
use respire_bench::experiments::case_scene::{CaseScene, Viewpoint};
use respire_bench::experiments::timing::{Spread, in_turns};
use respire_bench::render::{Light, RenderSettings, Shading, Transport};
use respire_bench::simulate::trajectory::Route;

/// Turns per comparison.
const TURNS: usize = 9;

fn main() -> Result<()> {
    let mut arguments = std::env::args().skip(1);
    let name = arguments.next().unwrap_or_else(|| "case1".into());
    let pixels: u32 = arguments.next().and_then(|v| v.parse().ok()).unwrap_or(128);
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let case = Case::load(&root.join(format!("bench-cases/{name}.toml")))?;
    let anatomy = airway::build(&case)?;
    cost(&case, &anatomy, pixels)?;
    refit(&case, &anatomy)?;
    flicker(&case, &anatomy)
}

/// A mesh, and `more` others of its size out of sight.
fn with_others(mesh: &TriangleMesh, more: u32) -> TriangleMesh {
    let mut all = mesh.clone();
    for copy in 1..=more {
        let first = all.vertices.len() as u32;
        all.vertices.extend(mesh.vertices.iter().map(|&v| v + DVec3::X * 400.0 * f64::from(copy)));
        all.faces.extend(mesh.faces.iter().map(|f| f.map(|v| v + first)));
    }
    all
}

/// The airway and `more` others of its size out of sight.
fn scene(case: &Case, anatomy: &Anatomy, more: u32) -> Result<CaseScene> {
    let [inspiration, expiration] = [&anatomy.inspiration, &anatomy.expiration].map(|m| with_others(m, more));
    let vertex_generation = anatomy.vertex_generation.repeat(more as usize + 1);
    CaseScene::new(case, &Anatomy { inspiration, expiration, vertex_generation, ..anatomy.clone() })
}

/// The camera `later_s` seconds after the middle of the route, and the phase then.
fn frame(case: &Case, anatomy: &Anatomy, pixels: u32, later_s: f64) -> Result<(Viewpoint, f64)> {
    let route = Route::plan(anatomy, &case.trajectory)?;
    let (phase, way_mm) = (0.5 + 0.4 * later_s, 0.5 * route.length_mm() + case.trajectory.speed_mm_per_s * later_s);
    let mut viewpoint = Viewpoint::on_route(case, &route, way_mm, phase, pixels);
    viewpoint.light = Light { emission_exponent: 1.0, ..viewpoint.light };
    Ok((viewpoint, phase))
}

fn image(scene: &mut CaseScene, frame: &(Viewpoint, f64), settings: &RenderSettings) -> Result<Image<f32>> {
    scene.set_phase(frame.1)?;
    frame.0.radiance(&scene.scene, settings)
}

fn settings(seed: u64, frame: u64, transport: Transport, samples_per_pixel: u32) -> RenderSettings {
    RenderSettings { samples_per_pixel, transport, shading: Shading::Smooth, seed, frame, ..RenderSettings::default() }
}

fn cost(case: &Case, anatomy: &Anatomy, pixels: u32) -> Result<()> {
    let seen = frame(case, anatomy, pixels, 0.0)?;
    let mut scenes = [scene(case, anatomy, 0)?, scene(case, anatomy, 3)?];
    let mut turn = 0;
    // The first turn, which is not counted, builds what a film keeps between frames.
    let [alone, among] = in_turns(TURNS, |k, samples| {
        let settings = settings(case.seed, turn / 2, Transport::VERTICES, 4);
        turn += 1;
        samples.time(|| image(&mut scenes[k], &seen, &settings)).map(drop)
    })?
    .map(|samples| samples.cpu().least_s);
    let triangles = scenes[0].scene.triangles();
    println!(
        "one frame of {pixels} x {pixels}, 4 samples: {alone:.4} CPU-s with {triangles} triangles, {among:.4} with {} ({:+.1} %)",
        4 * triangles,
        100.0 * (among / alone - 1.0)
    );
    Ok(())
}

fn refit(case: &Case, anatomy: &Anatomy) -> Result<()> {
    let more = (100_000 / anatomy.inspiration.faces.len()) as u32;
    let mut scene = scene(case, anatomy, more)?.scene;
    let seconds: Vec<f64> = (0..TURNS).map(|_| scene.refit_seconds()).collect::<Result<_>>()?;
    let spread = Spread::of(&seconds);
    println!(
        "refit of {} triangles: {:.2} ms at best, median {:.2}",
        scene.triangles(),
        1e3 * spread.least_s,
        1e3 * spread.median_s
    );
    Ok(())
}

fn flicker(case: &Case, anatomy: &Anatomy) -> Result<()> {
    let mut scene = scene(case, anatomy, 0)?;
    let frames = [frame(case, anatomy, 64, 0.0)?, frame(case, anatomy, 64, 0.04)?];
    let mut change = |transport, samples, seed| -> Result<Vec<f32>> {
        let mut image = |k: usize| image(&mut scene, &frames[k], &settings(seed, k as u64, transport, samples));
        let (first, second) = (image(0)?, image(1)?);
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
