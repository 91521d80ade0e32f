//! From a method to its PREDICTION folder: frames are written as they come, while the method's clock is stopped.

use std::path::Path;

use rayon::prelude::*;

use crate::base::image::codes_from_unit;
use crate::base::{Progress, Result};

use super::contract::{FramePrediction, Observation, Reconstruct};
use super::prediction_folder::{PredictionFolder, PredictionTiming};

/// Number of frames that are written together, on all threads, while the method's clock is stopped.
const BATCH: usize = 16;

/// Resolution of the system's count of CPU time, seconds.
const LEAST_CPU_S: f64 = 1e-6;

/// Runs `method` on `observation` and writes its prediction to `folder`.
pub fn write_prediction(
    method: &dyn Reconstruct,
    observation: &Observation,
    folder: &Path,
    progress: &dyn Progress,
) -> Result<()> {
    let mut out = PredictionFolder::new(folder);
    let mut waiting: Vec<FramePrediction> = Vec::with_capacity(BATCH);
    let mut emit = |prediction: FramePrediction| -> Result<()> {
        let frame = prediction.frame;
        prediction.world_from_camera.into_iter().for_each(|pose| out.add_pose(frame, pose));
        prediction.phase.into_iter().for_each(|phase| out.add_phase(frame, phase, prediction.phase_deviation));
        out.add_targets(frame, prediction.targets_mm.as_deref().unwrap_or_default());
        out.add_target_covariances(frame, prediction.target_covariance_mm2.as_deref().unwrap_or_default());
        waiting.push(prediction);
        if waiting.len() == BATCH {
            write_frames(&out, &waiting)?;
            waiting.clear();
        }
        Ok(())
    };
    let done = method.run(observation, &mut emit, progress)?;
    write_frames(&out, &waiting)?;
    let frames = observation.images.len();
    let spent = done.spent;
    let timing = PredictionTiming {
        time_total_s: spent.wall_s,
        // The system counts in ticks: what took less than one took some all the same.
        time_cpu_s: Some(spent.cpu_s.max(LEAST_CPU_S)),
        time_per_frame_s: spent.wall_s / frames as f64,
        frames,
    };
    out.finish(done.final_mesh.as_ref(), Some(&timing))
}

fn write_frames(out: &PredictionFolder, predictions: &[FramePrediction]) -> Result<()> {
    predictions.par_iter().try_for_each(|prediction| write_frame(out, prediction))
}

fn write_frame(out: &PredictionFolder, prediction: &FramePrediction) -> Result<()> {
    let frame = prediction.frame;
    out.color(frame, &codes_from_unit(&prediction.color))?;
    out.depth_mm(frame, &prediction.depth_mm)?;
    if let Some(ahead) = &prediction.ahead {
        out.ahead(frame, &codes_from_unit(ahead))?;
    }
    if let Some(novel) = &prediction.novel {
        out.novel(frame, &codes_from_unit(&novel.color))?;
        out.novel_depth_mm(frame, &novel.depth_mm)?;
    }
    Ok(())
}
