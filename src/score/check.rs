//! Reads everything that scoring would read, and lists what it finds; the first problem is the error. What can be read
//! but is most likely meant otherwise (another unit, another name) is a warning.

use std::path::{Path, PathBuf};

use rayon::prelude::*;
use serde::Serialize;

use super::correspondence;
use super::metric::{Metric, Needs};
use super::other_frame::{poses_warning, targets_warning};
use super::prediction::{Prediction, Question};
use super::registry::registry;
use super::truth::{Truth, final_mesh};
use crate::base::statistics::upper_median;
use crate::base::{Error, Image, Result, TriangleMesh, files};
use crate::formats::prediction::{
    ABOUT, ABOUT_KEYS, COLOR, CORRESPONDENCE, DEPTH, FINAL_MESH, NOVEL_DEPTH, PHASE, POSES, TARGET_COVARIANCE, TARGETS,
    TIMING, TIMING_KEYS, TIMING_NOTES, frame_file,
};

/// A phase beyond this is no estimate of one in 0 to 1, however bad.
const MOST_PHASE: f64 = 1.5;
/// Median z-depths in mm of a frame seen from within an airway lie between these by far: real ones by 3 and 100.
const DEPTH_MM: [f32; 2] = [0.3, 500.0];
/// No airway's bounding box has a shorter diagonal, in mm.
const LEAST_MESH_MM: f64 = 3.0;
/// Endings of files that hold predictions of other programs, in folders that scoring looks into.
const ENDINGS_OF_RESULTS: [&str; 5] = ["ply", "obj", "stl", "csv", "npy"];

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
    /// What is sound but most likely meant otherwise, a sentence each.
    pub warnings: Vec<String>,
}

/// Checks a prediction folder file by file. The error is one sentence that names the file and the element.
pub fn check_prediction(question: &Question, folder: &Path) -> Result<Contents> {
    let frames = question.frames;
    let prediction = Prediction::open(folder, question)?;
    let depth_of = |frame: usize| -> Result<Option<FrameDepth>> {
        prediction.color(frame)?;
        Ok(prediction.depth_mm(frame)?.map(|depth| FrameDepth::of(&depth)))
    };
    let depths: Vec<Option<FrameDepth>> = (0..frames).into_par_iter().map(depth_of).collect::<Result<_>>()?;
    for &frame in prediction.ahead_frames() {
        prediction.ahead(frame)?;
    }
    let novel: &[usize] = if prediction.has_novel_views() { &question.novel_frames } else { &[] };
    for &frame in novel {
        prediction.novel(frame)?;
    }
    let mut novel_depths = Vec::new();
    for &frame in &question.novel_frames {
        let Some(depth) = prediction.novel_depth_mm(frame)? else { break };
        novel_depths.push(FrameDepth::of(&depth));
    }
    if let (Some(places), Some(vertices)) = (prediction.correspondence()?, question.vertices()) {
        correspondence::check_length(&places, vertices).map_err(|e| e.at(folder.join(CORRESPONDENCE)))?;
    }
    let surface = prediction.final_mesh()?;
    let mut contents = Contents {
        frames,
        depth: frames > 0 && prediction.depth_mm(0)?.is_some(),
        phase: prediction.phase().is_some(),
        surface: surface.is_some(),
        time: prediction.time_total_s().is_some(),
        ahead: prediction.ahead_frames().len(),
        novel: novel.len(),
        novel_depth: !novel_depths.is_empty(),
        targets: prediction.targets().is_some(),
        not_applicable: Vec::new(),
        warnings: Vec::new(),
    };
    let lacks = |metric: &Metric| match metric.applies_to {
        Needs::Pictures => false,
        Needs::Depth => !contents.depth,
        Needs::Phase => !contents.phase,
        Needs::PhaseDeviation => prediction.phase_sd().is_none(),
        Needs::Poses => prediction.poses().is_none(),
        Needs::Novel => contents.novel == 0,
        Needs::NovelDepth => !contents.novel_depth,
        Needs::Ahead => contents.ahead == 0,
        Needs::Targets => !contents.targets,
        Needs::DisturbedTargets => !contents.targets || question.is_disturbed == Some(false),
        Needs::TargetCovariance => prediction.target_covariance_mm2().is_none(),
        Needs::Surface => !contents.surface,
        Needs::Time => !contents.time,
        Needs::CpuTime => prediction.time_cpu_s().is_none(),
    };
    contents.not_applicable = registry().iter().filter(|metric| lacks(metric)).map(|metric| metric.id).collect();
    contents.warnings.extend(prediction.phase().and_then(phase_warning));
    contents.warnings.extend(depth_warning(DEPTH, &depths.into_iter().flatten().collect::<Vec<_>>()));
    contents.warnings.extend(depth_warning(NOVEL_DEPTH, &novel_depths));
    contents.warnings.extend(surface.as_ref().and_then(surface_warning));
    let targets = prediction.targets().and_then(|found| targets_warning(found, &question.planned_targets_mm));
    contents.warnings.extend(targets);
    contents.warnings.extend(prediction.poses().and_then(|found| poses_warning(found, &question.given_poses)));
    contents.warnings.extend(beyond_warning(folder, frames));
    contents.warnings.extend(unread_warnings(&prediction, folder, frames)?);
    Ok(contents)
}

/// Phases outside of 0 to 1, by the largest of them.
fn phase_warning(phases: &[f64]) -> Option<String> {
    let furthest = phases.iter().copied().fold(0.5, |a: f64, b| if (b - 0.5).abs() > (a - 0.5).abs() { b } else { a });
    if (furthest - 0.5).abs() <= MOST_PHASE - 0.5 {
        return None;
    }
    let unit = match furthest.abs() {
        f if f <= 7.0 => "radians",
        f if f <= 101.0 => "percent",
        _ => "degrees",
    };
    Some(format!("{PHASE}: a phase is {furthest}, as if in {unit}; 0 is full inspiration, 1 full expiration"))
}

/// What a depth image holds.
#[derive(Clone, Copy)]
struct FrameDepth {
    /// Median of what is a depth: above 0.
    median_mm: Option<f32>,
    /// Pixels with a depth.
    known: usize,
    /// Pixels with a number below 0.
    negative: usize,
}

impl FrameDepth {
    fn of(depth: &Image<f32>) -> Self {
        let is_depth = |d: &f32| *d > 0.0 && d.is_finite();
        let known = depth.data.iter().filter(|d| is_depth(d)).count();
        let negative = depth.data.iter().filter(|d| **d < 0.0).count();
        let median_mm = upper_median(depth.data.iter().copied().filter(|d| is_depth(d)));
        FrameDepth { median_mm, known, negative }
    }
}

/// Depths that are none of an airway: of frames that have any, by their sign and by the median over the frames.
fn depth_warning(place: &str, depths: &[FrameDepth]) -> Option<String> {
    let sum = |of: fn(&FrameDepth) -> usize| depths.iter().map(of).sum::<usize>();
    let (known, negative) = (sum(|depth| depth.known), sum(|depth| depth.negative));
    if negative > known {
        return Some(format!("{place}: most values are below 0 and count as unknown; depth along the view is above 0"));
    }
    if known == 0 && !depths.is_empty() {
        return Some(format!("{place}: no pixel of any frame has a depth above 0 mm"));
    }
    let depth_mm = upper_median(depths.iter().filter_map(|depth| depth.median_mm))?;
    let advice = match depth_mm {
        d if d < DEPTH_MM[0] => "as if in metres; depths are in mm",
        d if d > DEPTH_MM[1] => {
            "too far for an airway; depths are in mm, and `depth_unit_mm` says what a code of PNG is"
        }
        _ => return None,
    };
    Some(format!("{place}: the median is {depth_mm} mm, {advice}"))
}

fn surface_warning(surface: &TriangleMesh) -> Option<String> {
    let (low, high) = surface.bounds();
    let diagonal_mm = low.distance(high);
    let sentence = format!("{FINAL_MESH}: spans {diagonal_mm:.3} mm, as if in metres; coordinates are in mm");
    if diagonal_mm < LEAST_MESH_MM { Some(sentence) } else { None }
}

/// Pictures of frames that the film has not: whoever counts from 1 has one too many.
fn beyond_warning(folder: &Path, frames: usize) -> Option<String> {
    let beyond = [COLOR, DEPTH]
        .iter()
        .flat_map(|place| ["png", "exr", "npy"].iter().map(move |ending| frame_file(place, frames, ending)));
    let name = beyond.into_iter().find(|name| folder.join(name).exists())?;
    Some(format!("{name}: is not read; the frames are 000000 to {:06}", frames.saturating_sub(1)))
}

/// Keys of the two JSON files of a prediction.
const KEYS: [(&str, &[&str]); 2] = [(TIMING, &TIMING_KEYS), (ABOUT, &ABOUT_KEYS)];

/// Results that nobody reads, because they have another name.
fn unread_warnings(prediction: &Prediction, folder: &Path, frames: usize) -> Result<Vec<String>> {
    let read: Vec<PathBuf> = prediction.file_paths(frames).collect();
    let is_result = |path: &PathBuf| path.extension().is_some_and(|e| ENDINGS_OF_RESULTS.iter().any(|r| e == *r));
    let mut unread = Vec::new();
    for place in [folder.to_path_buf(), folder.join("mesh"), folder.join("meshes")] {
        if place.is_dir() {
            unread.extend(files::all_directly_in(&place)?.into_iter().filter(is_result).filter(|p| !read.contains(p)));
        }
    }
    let sentence = |path: &PathBuf| {
        let name = path.strip_prefix(folder).unwrap_or(path).display();
        let is_surface = ["ply", "obj", "stl"].iter().any(|ending| path.extension().is_some_and(|e| e == *ending));
        let wanted = if is_surface {
            format!("the surface at the last frame is {FINAL_MESH}")
        } else {
            format!("tables are {PHASE}, {POSES}, {TARGETS}, {TARGET_COVARIANCE} and {CORRESPONDENCE}")
        };
        format!("{name}: is not read; {wanted}")
    };
    let mut warnings: Vec<String> = unread.iter().map(sentence).collect();
    for (name, known) in KEYS {
        let path = folder.join(name);
        if !path.is_file() {
            continue;
        }
        let keys: serde_json::Map<String, serde_json::Value> = files::read_json(&path)?;
        let is_noted = |key: &str| name == TIMING && TIMING_NOTES.contains(&key);
        let unknown = keys.keys().filter(|key| !known.contains(&key.as_str()) && !is_noted(key));
        warnings.extend(unknown.map(|key| format!("{name}: `{key}` is not read; keys are {}", known.join(", "))));
    }
    Ok(warnings)
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
    truth.mask()?;
    final_mesh(truth)?.validate()?;
    if truth.inspiration()?.faces != truth.expiration()?.faces {
        return Err(Error::input("the two surfaces have different faces"));
    }
    Ok(frames)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn other_units_are_told_and_bad_estimates_are_not() {
        assert_eq!(phase_warning(&[0.0, -0.3, 1.4]), None);
        for (phases, unit) in [([0.0, 87.5], "percent"), ([6.2, 0.1], "radians"), ([-180.0, 20.0], "degrees")] {
            assert!(phase_warning(&phases).unwrap().contains(unit), "{phases:?}");
        }
        let said = |frames: &[[f32; 4]]| {
            let frame = |data: &[f32; 4]| Image { width: 4, height: 1, channels: 1, data: data.to_vec() };
            depth_warning(DEPTH, &frames.iter().map(|data| FrameDepth::of(&frame(data))).collect::<Vec<_>>())
        };
        assert_eq!(said(&[]), None);
        assert_eq!(said(&[[3.0; 4], [40.0; 4], [0.01; 4]]), None, "one frame is no unit");
        assert_eq!(said(&[[0.0, 5.0, f32::NAN, f32::NAN]]), None, "what is unknown may be most");
        assert!(said(&[[0.02; 4], [0.0, 0.03, 0.03, f32::NAN]]).unwrap().contains("metres"));
        assert!(said(&[[2000.0; 4]]).unwrap().contains("depth_unit_mm"));
        assert!(said(&[[-5.0, -4.0, 0.0, 2.0]]).unwrap().contains("below 0"));
        assert!(said(&[[f32::NAN; 4], [0.0, 0.0, f32::INFINITY, 0.0]]).unwrap().contains("no pixel of any frame"));
    }
}
