//! `respire-bench render`: path-traces one scene file.

use std::path::PathBuf;

use clap::Args;
use serde::Serialize;

use super::Terminal;
use crate::base::{Error, ErrorKind, Progress, Result, files};
use crate::experiments::timing::measure;
use crate::formats::{exr, prediction};
use crate::render::scene_file::SceneFile;
use crate::render::{ISA, render_watched};

/// Arguments of `render`.
#[derive(Args)]
#[command(after_help = "Writes image.exr (R, G, B: linear radiance, no clamp), depth.exr (Z: z-depth in mm, 0 where\n\
    nothing is hit and beyond 90 degrees off the axis) and timing.json into DIR.\n\
    Keys of a scene file: docs/scenes.md.\n\
    Example: respire-bench render scene.toml --out /tmp/view")]
pub struct RenderArguments {
    /// Scene file: mesh, camera, light, material, integrator
    #[arg(value_name = "SCENE.toml")]
    scene: PathBuf,
    /// Folder for the images and the timing
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

/// Refits that are timed; the fastest counts.
const REFITS: usize = 5;

/// Said of a picture without any wall.
const NOTHING_HIT: &str = "note: no pixel shows the mesh; does camera.world_from_camera stand inside of it (mm, z \
    forward, y down), and have its faces any area?";

#[derive(Serialize)]
struct RenderTiming {
    render_wall_s: f64,
    render_cpu_s: f64,
    bvh_build_s: f64,
    bvh_refit_s: f64,
    triangles: usize,
    paths: u64,
    rays: u64,
    spp: u32,
    rejected_samples: u64,
    #[serde(skip_serializing_if = "Option::is_none")]
    estimated_relmse: Option<f64>,
    threads: usize,
    isa: &'static str,
}

/// Runs the command.
pub fn run(arguments: RenderArguments, terminal: &Terminal) -> Result<()> {
    if arguments.out.exists() && !arguments.out.is_dir() {
        return Err(Error::input("is no folder").element("--out").at(&arguments.out));
    }
    prediction::refuse_timing_in(&arguments.out)?;
    let file = SceneFile::load(&arguments.scene)?;
    let (camera, pose) = (file.camera.intrinsics()?, file.camera.pose()?);
    let (scene, build) = measure(|| file.build());
    let mut scene = scene?;
    file.check_view(&scene).map_err(|e| e.at(&arguments.scene))?;
    // The first refit also touches its memory for the first time.
    let refits: Vec<f64> = (0..REFITS).map(|_| scene.refit_seconds()).collect::<Result<_>>()?;
    let bvh_refit_s = refits.iter().copied().fold(f64::INFINITY, f64::min);
    terminal.stage(arguments.scene.display());
    let (frame, cost) = measure(|| render_watched(&scene, &camera, &pose, &file.light, &file.settings(), terminal));
    let is_of_scene = |e: &Error| e.path().is_none() && e.kind() == ErrorKind::InputOutput;
    let frame = frame.map_err(|e| if is_of_scene(&e) { e.at(&arguments.scene) } else { e })?;
    if frame.depth_mm.data.iter().all(|&z| z == 0.0) {
        terminal.note(NOTHING_HIT);
    }
    if let Some(target) = file.integrator.target_relmse {
        let found = frame.statistics.estimated_relmse;
        if found.is_none_or(|found| found > target) {
            let found = found.map_or("unknown".to_owned(), |found| format!("{found:.1e}"));
            terminal.note(&format!("target_relmse {target:e} was not reached: its estimate is {found}"));
        }
    }
    let timing = RenderTiming {
        render_wall_s: cost.wall_s,
        render_cpu_s: cost.cpu_s,
        bvh_build_s: build.wall_s,
        bvh_refit_s,
        triangles: scene.triangles(),
        paths: frame.statistics.paths,
        rays: frame.statistics.rays,
        spp: frame.statistics.samples_per_pixel,
        rejected_samples: frame.statistics.rejected_samples,
        estimated_relmse: frame.statistics.estimated_relmse,
        threads: rayon::current_num_threads(),
        isa: ISA,
    };
    exr::write_rgb(&arguments.out.join("image.exr"), &frame.radiance)?;
    exr::write_channel(&arguments.out.join("depth.exr"), "Z", &frame.depth_mm)?;
    files::write_json(&arguments.out.join("timing.json"), &timing)?;
    terminal.line(format!(
        "{}: {} samples per pixel in {:.2} s",
        arguments.out.display(),
        timing.spp,
        timing.render_wall_s
    ));
    Ok(())
}
