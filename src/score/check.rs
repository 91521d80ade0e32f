//! Reads everything that scoring would read, and lists what it finds; the first problem is the error.

use std::path::Path;

use rayon::prelude::*;
use serde::Serialize;

use super::prediction::{Prediction, Question};
use super::registry::registry;
use super::truth::{Truth, final_mesh};
use crate::base::{Error, Result};

/// Contents of a valid folder.
#[derive(Clone, Debug, Serialize)]
pub struct Contents {
    /// Frames.
    pub frames: usize,
    /// Depth images.
    pub depth: bool,
    /// Phases.
    pub phase: bool,
    /// A surface at the last frame.
    pub surface: bool,
    /// A run time.
    pub time: bool,
    /// Frames rendered before the method read their image.
    pub ahead: usize,
    /// Views of second cameras.
    pub novel: usize,
    /// Depth images of second cameras.
    pub novel_depth: bool,
    /// Places of the targets.
    pub targets: bool,
    /// Metrics that will have a status instead of a value.
    pub not_applicable: Vec<&'static str>,
}

/// Checks a prediction folder file by file. The error is one sentence that names the file and the element.
pub fn check_prediction(question: &Question, folder: &Path) -> Result<Contents> {
    let frames = question.frames;
    let prediction = Prediction::open(folder, question)?;
    (0..frames).into_par_iter().try_for_each(|frame| {
        prediction.color(frame)?;
        prediction.depth_mm(frame).map(|_| ())
    })?;
    for &frame in prediction.ahead_frames() {
        prediction.ahead(frame)?;
    }
    let novel: &[usize] = if prediction.has_novel_views() { &question.novel_frames } else { &[] };
    for &frame in novel {
        prediction.novel(frame)?;
    }
    let first_novel = question.novel_frames.first().map_or(Ok(None), |&frame| prediction.novel_depth_mm(frame))?;
    for &frame in question.novel_frames.iter().filter(|_| first_novel.is_some()) {
        prediction.novel_depth_mm(frame)?;
    }
    prediction.correspondence()?;
    let mut contents = Contents {
        frames,
        depth: frames > 0 && prediction.depth_mm(0)?.is_some(),
        phase: prediction.phase().is_some(),
        surface: prediction.final_mesh()?.is_some(),
        time: prediction.time_total_s().is_some(),
        ahead: prediction.ahead_frames().len(),
        novel: novel.len(),
        novel_depth: first_novel.is_some(),
        targets: prediction.targets().is_some(),
        not_applicable: Vec::new(),
    };
    let lacks = |id: &str| match id {
        "time_cpu_s" => prediction.time_cpu_s().is_none(),
        id if id.starts_with("phase_coverage") || id.starts_with("phase_sd") => prediction.phase_sd().is_none(),
        id if id.starts_with("novel_depth") => !contents.novel_depth,
        id if id.starts_with("novel") => contents.novel == 0,
        "target_mean_mm" | "target_p95_mm" => !contents.targets,
        id if id.starts_with("depth") => !contents.depth,
        id if id.starts_with("phase") => !contents.phase,
        id if id.starts_with("contour") || id.starts_with("target") => !contents.surface,
        id if id.starts_with("time") => !contents.time,
        "psnr_ahead_db" => contents.ahead == 0,
        _ => false,
    };
    contents.not_applicable = registry().iter().map(|m| m.id).filter(|id| lacks(id)).collect();
    Ok(contents)
}

/// Checks a sequence folder file by file: images, depths, both surfaces, one topology. Gives the number of frames.
pub fn check_truth(truth: &dyn Truth) -> Result<usize> {
    let frames = truth.frames().len();
    (0..frames).into_par_iter().try_for_each(|frame| {
        truth.image(frame)?;
        truth.depth_mm(frame).map(|_| ())
    })?;
    truth.novel_views().into_par_iter().try_for_each(|view| {
        truth.novel_image(view.frame)?;
        truth.novel_depth_mm(view.frame).map(|_| ())
    })?;
    final_mesh(truth)?.validate()?;
    if truth.inspiration()?.faces != truth.expiration()?.faces {
        return Err(Error::input("the two surfaces have different faces"));
    }
    Ok(frames)
}
