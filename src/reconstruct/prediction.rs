//! The PREDICTION folder: `color/NNNNNN.png`, `depth/NNNNNN.exr`, `ahead/NNNNNN.png`,
//! `novel/NNNNNN.png`, `novel_depth/NNNNNN.exr`, `targets.csv`, `phase.csv` (with
//! `phase_sd` if the method estimates it), `mesh/final.ply`, `timing.json`. Frames are written as they come, the rest
//! at the end.

use std::path::{Path, PathBuf};

use glam::DAffine3;
use rayon::prelude::*;
use serde::Serialize;

use crate::base::image::codes_from_unit;
use crate::base::{Error, Progress, Result, files};
use crate::formats::{exr, mesh, png};

use super::contract::{FramePrediction, Observation, Reconstruct};

/// Number of frames that are written together, on all threads, while the method's clock is stopped.
const BATCH: usize = 16;

/// Resolution of the system's count of CPU time, seconds.
const LEAST_CPU_S: f64 = 1e-6;

#[derive(Serialize)]
struct PredictionTiming {
    time_total_s: f64,
    time_cpu_s: f64,
    time_per_frame_s: f64,
    frames: usize,
}

/// Runs `method` on `observation` and writes its prediction to `folder`.
pub fn write_prediction(
    method: &dyn Reconstruct,
    observation: &Observation,
    folder: &Path,
    progress: &dyn Progress,
) -> Result<()> {
    let mut phases: Vec<(usize, f64, Option<f64>)> = Vec::new();
    let mut poses: Vec<(usize, DAffine3)> = Vec::new();
    let mut targets = String::from("frame,target,x_mm,y_mm,z_mm\n");
    let mut waiting: Vec<FramePrediction> = Vec::with_capacity(BATCH);
    let mut emit = |prediction: FramePrediction| -> Result<()> {
        poses.extend(prediction.world_from_camera.map(|pose| (prediction.frame, pose)));
        phases.extend(prediction.phase.map(|phase| (prediction.frame, phase, prediction.phase_deviation)));
        for (target, place) in prediction.targets_mm.iter().flatten().enumerate() {
            targets += &format!("{},{target},{:.9},{:.9},{:.9}\n", prediction.frame, place.x, place.y, place.z);
        }
        waiting.push(prediction);
        if waiting.len() == BATCH {
            write_frames(folder, &waiting)?;
            waiting.clear();
        }
        Ok(())
    };
    let done = method.run(observation, &mut emit, progress)?;
    write_frames(folder, &waiting)?;
    if !phases.is_empty() {
        let mut writer = csv::Writer::from_writer(Vec::new());
        let failed = |e: csv::Error| Error::input(format!("cannot be written: {e}")).at(folder.join("phase.csv"));
        let with_deviation = phases.iter().all(|(_, _, deviation)| deviation.is_some());
        let columns = if with_deviation { 3 } else { 2 };
        writer.write_record(&["frame", "phase", "phase_sd"][..columns]).map_err(failed)?;
        for (frame, phase, deviation) in &phases {
            let deviation = deviation.map_or(String::new(), |sd| format!("{sd:.9}"));
            let row = [frame.to_string(), format!("{phase:.9}"), deviation];
            writer.write_record(&row[..columns]).map_err(failed)?;
        }
        let bytes = writer.into_inner().map_err(|e| Error::input(e.to_string()))?;
        files::write_bytes(&folder.join("phase.csv"), &bytes)?;
    }
    if !poses.is_empty() {
        files::write_bytes(&folder.join("poses.csv"), pose_table(&poses).as_bytes())?;
    }
    if targets.lines().count() > 1 {
        files::write_bytes(&folder.join("targets.csv"), targets.as_bytes())?;
    }
    if let Some(final_mesh) = &done.final_mesh {
        mesh::write_ply(&folder.join("mesh/final.ply"), final_mesh, &["airway surface at the last frame, mm"])?;
    }
    let frames = observation.images.len();
    let spent = done.spent;
    let timing = PredictionTiming {
        time_total_s: spent.wall_s,
        // The system counts in ticks: what took less than one took some all the same.
        time_cpu_s: spent.cpu_s.max(LEAST_CPU_S),
        time_per_frame_s: spent.wall_s / frames as f64,
        frames,
    };
    files::write_json(&folder.join("timing.json"), &timing)
}

/// Columns `frame` and `m00` to `m23`: the upper rows of world_from_camera, mm.
fn pose_table(poses: &[(usize, DAffine3)]) -> String {
    let mut table = String::from("frame,m00,m01,m02,m03,m10,m11,m12,m13,m20,m21,m22,m23\n");
    for (frame, pose) in poses {
        table += &frame.to_string();
        for row in 0..3 {
            for column in [pose.matrix3.x_axis, pose.matrix3.y_axis, pose.matrix3.z_axis, pose.translation] {
                table += &format!(",{:.9}", column[row]);
            }
        }
        table.push('\n');
    }
    table
}

fn frame_file(folder: &Path, kind: &str, frame: usize, extension: &str) -> PathBuf {
    folder.join(kind).join(format!("{frame:06}.{extension}"))
}

fn write_frames(folder: &Path, predictions: &[FramePrediction]) -> Result<()> {
    predictions.par_iter().try_for_each(|prediction| write_frame(folder, prediction))
}

fn write_frame(folder: &Path, prediction: &FramePrediction) -> Result<()> {
    let frame = prediction.frame;
    png::write_rgb(&frame_file(folder, "color", frame, "png"), &codes_from_unit(&prediction.color))?;
    exr::write_depth(&frame_file(folder, "depth", frame, "exr"), &prediction.depth_mm)?;
    if let Some(ahead) = &prediction.ahead {
        png::write_rgb(&frame_file(folder, "ahead", frame, "png"), &codes_from_unit(ahead))?;
    }
    if let Some(novel) = &prediction.novel {
        png::write_rgb(&frame_file(folder, "novel", frame, "png"), &codes_from_unit(&novel.color))?;
        exr::write_depth(&frame_file(folder, "novel_depth", frame, "exr"), &novel.depth_mm)?;
    }
    Ok(())
}
