//! Scores one prediction against one sequence: every metric of the registry, every frame.

use std::path::Path;

use glam::{DAffine3, DQuat, DVec3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::contour::{ContourOverlay, Correspondence, Enclosure, TargetErrors, target_errors};
use super::correspondence;
use super::depth::{DepthErrors, depth_errors};
use super::image_quality::{Psnr, Ssim, psnr_ceiling, psnr_within, ssim_within};
use super::navigation::{self, NavigationFrame, navigation_errors};
use super::prediction::{Prediction, Question};
use super::registry::registry;
use super::statistics::{MeanInterval, bootstrap_series, mean, pearson, quantile};
use super::truth::{Truth, final_mesh};
use crate::base::{Error, Image, Mask, Result};

/// What kind of value it is, or why there is none.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Status {
    /// A value like any other.
    Ok,
    /// Prediction and truth are equal to the bit: better than any value.
    Identical,
    /// The prediction does not claim what the metric measures.
    NotApplicable,
    /// The metric has no value for such input (a phase without variance, an image smaller than a window).
    Degenerate,
    /// The final camera's plane cuts no contour around the camera (truth) or none at all (prediction).
    NoContour,
    /// The predicted surface has other faces than the sequence's, and no table says which point is which.
    NoCorrespondence,
    /// There is a value, but the camera lies outside the predicted contour.
    CameraOutside,
    /// The pictures are the input: more than one in a hundred equals its frame, noise and all.
    Copied,
    /// The cell failed: there is no prediction.
    Failed,
}

impl Status {
    /// All of them.
    pub const ALL: [Status; 9] = [
        Status::Ok,
        Status::Identical,
        Status::NotApplicable,
        Status::Degenerate,
        Status::NoContour,
        Status::NoCorrespondence,
        Status::CameraOutside,
        Status::Copied,
        Status::Failed,
    ];

    /// Whether a row without a value counts with the worst value that any row has in its case: a surface was handed in,
    /// and it cannot be measured.
    pub fn counts_as_worst(self) -> bool {
        matches!(self, Status::NoContour | Status::NoCorrespondence)
    }

    /// The status that `results.csv` calls `word`.
    pub fn of_word(word: &str) -> Option<Status> {
        Status::ALL.into_iter().find(|status| status.word() == word)
    }

    /// As in `results.csv`.
    pub fn word(self) -> &'static str {
        match self {
            Status::Ok => "ok",
            Status::Identical => "identical",
            Status::NotApplicable => "not_applicable",
            Status::Degenerate => "degenerate",
            Status::NoContour => "no_contour",
            Status::NoCorrespondence => "no_correspondence",
            Status::CameraOutside => "camera_outside",
            Status::Copied => "copied",
            Status::Failed => "failed",
        }
    }
}

/// One metric of one cell.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MetricScore {
    /// Id in the registry.
    pub metric: String,
    /// The value; never NaN, never infinite.
    pub value: Option<f64>,
    /// What kind of value it is, or why there is none.
    pub status: Status,
    /// Standard deviation over frames, where the value is a mean over frames.
    pub deviation: Option<f64>,
    /// Number of frames or points behind the value.
    pub count: usize,
    /// 95 % interval of the mean over frames (block bootstrap).
    pub interval: Option<[f64; 2]>,
    /// One sentence where the status needs one; empty otherwise.
    pub detail: String,
}

/// One metric of one frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FrameValue {
    /// Id in the registry.
    pub metric: String,
    /// The value.
    pub value: Option<f64>,
    /// What kind of value it is, or why there is none.
    pub status: Status,
}

/// All metrics of one frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FrameScore {
    /// Index.
    pub frame: usize,
    /// Seconds since the first frame.
    pub time_s: f64,
    /// True phase.
    pub phase: f64,
    /// Predicted phase.
    pub phase_predicted: Option<f64>,
    /// Values, in the registry's order; frame-wise metrics only.
    pub values: Vec<FrameValue>,
}

/// Everything known of one cell: case x method x seed. `score.json` in the cell's folder.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CellScore {
    /// Case.
    pub case_id: String,
    /// Content hash of the sequence: of its case and settings.
    pub case_hash: String,
    /// Hash of what the film held when it was scored; empty where it is not known (an older report).
    #[serde(default)]
    pub film_content: String,
    /// Method.
    pub method: String,
    /// Seed of the method.
    pub seed: u64,
    /// Frames of the sequence.
    pub frames: usize,
    /// Every metric of the registry, in its order.
    pub metrics: Vec<MetricScore>,
    /// One row per frame.
    pub frame_scores: Vec<FrameScore>,
    /// The final frame's contours, where there are two.
    pub overlay: Option<ContourOverlay>,
}

impl CellScore {
    /// The score of the metric `id`.
    pub fn metric(&self, id: &str) -> Option<&MetricScore> {
        self.metrics.iter().find(|m| m.metric == id)
    }

    /// The value of the metric `id`, if it has one.
    pub fn value(&self, id: &str) -> Option<f64> {
        self.metric(id).and_then(|m| m.value)
    }

    /// The value of the metric `id` at each frame that has one.
    pub fn series(&self, id: &str) -> Vec<(f64, f64)> {
        let value = |f: &FrameScore| f.values.iter().find(|v| v.metric == id).and_then(|v| v.value);
        self.frame_scores.iter().filter_map(|f| value(f).map(|v| (f.time_s, v))).collect()
    }
}

/// Settings of the scoring, beside the two folders.
#[derive(Clone, Debug)]
pub struct ScoreSettings {
    /// Method id for the tables; `None` takes the prediction's own name, or `prediction`.
    pub method: Option<String>,
    /// Seed of the method's randomness, for the tables.
    pub seed: u64,
    /// Chooses the target vertex; one value for a whole run, so that all methods are scored on the same target.
    pub target_seed: u64,
}

impl Default for ScoreSettings {
    fn default() -> Self {
        ScoreSettings { method: None, seed: 0, target_seed: 1 }
    }
}

/// Scores the prediction folder against `truth`.
///
/// Errors name the file and the element: a missing or damaged file, a wrong size, a mesh with a bad vertex. What the
/// prediction does not claim (no depth, no phase, no mesh, no time) is no error but status `not_applicable`.
pub fn score(truth: &dyn Truth, prediction: &Path, settings: &ScoreSettings) -> Result<CellScore> {
    let frames = truth.frames().len();
    if frames == 0 {
        return Err(Error::input(format!("the sequence of case {} has no frames", truth.case_id())));
    }
    let prediction = Prediction::open(prediction, &Question::of(truth))?;
    let mask = truth.mask()?;
    let measured: Vec<FrameMeasurement> = (0..frames)
        .into_par_iter()
        .map(|frame| measure(truth, &prediction, mask.as_ref(), frame))
        .collect::<Result<_>>()?;
    let novel: Vec<NovelMeasurement> = (truth.novel_views().par_iter())
        .map(|view| measure_novel(truth, &prediction, mask.as_ref(), view.frame))
        .collect::<Result<_>>()?;
    let distances = target_distances(truth, &prediction);
    let navigation = navigation_errors(truth, &prediction)?;
    let target = target(truth, &prediction, settings)?;
    let pixels = mask.map_or(truth.camera().width as usize * truth.camera().height as usize, |mask| mask.count());
    let ceiling = psnr_ceiling(pixels * 3);
    let seed = settings.target_seed;
    let metrics = registry()
        .iter()
        .map(|m| match m.id {
            "psnr_db" | "ssim" | "ssim_padded" if are_copies(measured.iter().map(|f| f.psnr)) => {
                entry(m.id, None, Status::Copied, frames, COPIED)
            }
            "psnr_db" => psnr_mean(m.id, measured.iter().map(|f| f.psnr).collect(), ceiling, seed),
            "psnr_ahead_db" if are_copies(measured.iter().filter_map(|f| f.psnr_ahead)) => {
                let count = measured.iter().filter(|f| f.psnr_ahead.is_some()).count();
                entry(m.id, None, Status::Copied, count, COPIED)
            }
            "psnr_ahead_db" => psnr_mean(m.id, measured.iter().filter_map(|f| f.psnr_ahead).collect(), ceiling, seed),
            "novel_psnr_db" | "novel_ssim" if are_nearly_copies(&novel) => {
                entry(m.id, None, Status::Copied, novel.len(), "the pictures are nearly the truth's, noise and all")
            }
            "novel_psnr_db" => psnr_mean(m.id, novel.iter().filter_map(|f| f.psnr).collect(), ceiling, seed),
            "novel_ssim" => ssim_mean(m.id, novel.iter().filter_map(|f| f.ssim), seed),
            "novel_depth_rmse_mm" => depth_mean(m.id, novel.iter().map(|f| &f.depth), |d| d.rmse_mm, seed),
            "novel_depth_delta_1_25" => depth_mean(m.id, novel.iter().map(|f| &f.depth), |d| d.delta_1_25, seed),
            "target_mean_mm" => series_mean(m.id, distances.iter().filter_map(|d| mean(d)).collect(), seed),
            "target_p95_mm" => plain(m.id, quantile(&distances.concat(), 0.95), frames),
            "ssim" => ssim_mean(m.id, measured.iter().map(|f| f.ssim), seed),
            "ssim_padded" => series_mean(m.id, measured.iter().map(|f| f.ssim.padded).collect(), seed),
            "depth_rmse_mm" => depth_mean(m.id, measured.iter().map(|f| &f.depth), |d| d.rmse_mm, seed),
            "depth_delta_1_25" => depth_mean(m.id, measured.iter().map(|f| &f.depth), |d| d.delta_1_25, seed),
            "depth_coverage" => depth_mean(m.id, measured.iter().map(|f| &f.depth), |d| d.coverage, seed),
            "phase_mae" => series_mean(m.id, measured.iter().filter_map(|f| f.phase_error).collect(), seed),
            "phase_coverage_1sd_pct" => series_mean(m.id, error_bars(&measured, within), seed),
            "phase_coverage_2sd_pct" => series_mean(m.id, error_bars(&measured, |e, sd| within(e, 2.0 * sd)), seed),
            "phase_sd_mean" => series_mean(m.id, error_bars(&measured, |_, sd| sd), seed),
            "phase_pearson_r" => correlation(m.id, truth, &prediction),
            "pose_error_mm" => {
                series_mean(m.id, measured.iter().filter_map(|f| f.pose_error).map(|e| e[0]).collect(), seed)
            }
            "pose_error_deg" => {
                series_mean(m.id, measured.iter().filter_map(|f| f.pose_error).map(|e| e[1]).collect(), seed)
            }
            "contour_rmse_mm" => contour_score(m.id, &target),
            "target_error_mm" => target_score(m.id, &target, |t| t.target_mm),
            "target_error_mean_mm" => target_score(m.id, &target, |t| t.mean_mm),
            "target_error_p95_mm" => target_score(m.id, &target, |t| t.p95_mm),
            "navigation_error_p95_mm" => plain(m.id, navigation_p95(&navigation), frames),
            id if navigation::is_frame_wise(id) => {
                series_mean(m.id, navigation.iter().filter_map(|frame| frame.value(id)).collect(), seed)
            }
            "time_cpu_s" => plain(m.id, prediction.time_cpu_s(), 1),
            "time_total_s" => plain(m.id, prediction.time_total_s(), 1),
            "time_per_frame_s" => plain(m.id, prediction.time_total_s().map(|t| t / frames as f64), frames),
            other => unreachable!("metric {other} of the registry is not computed"),
        })
        .collect();
    let method = settings.method.clone().or_else(|| prediction.method().map(str::to_owned));
    Ok(CellScore {
        case_id: truth.case_id().to_owned(),
        case_hash: truth.hash().to_owned(),
        film_content: truth.content().to_owned(),
        method: method.unwrap_or_else(|| "prediction".to_owned()),
        seed: settings.seed,
        frames,
        metrics,
        frame_scores: frame_scores(truth, &prediction, (&measured, &novel), &distances, &navigation),
        overlay: match target {
            TargetOutcome::Measured(t) if !t.overlay.predicted.is_empty() => Some(t.overlay),
            _ => None,
        },
    })
}

/// Everything measured on one frame.
struct FrameMeasurement {
    psnr: Psnr,
    psnr_ahead: Option<Psnr>,
    ssim: Ssim,
    /// `None`: no depth predicted. `Some(None)`: the frame has no true depth.
    depth: Option<Option<DepthErrors>>,
    phase_error: Option<f64>,
    /// Standard deviation that the prediction states of its phase.
    phase_sd: Option<f64>,
    /// mm, degrees.
    pose_error: Option<[f64; 2]>,
}

/// 100 where an error is within a width, else 0: a mean of them is a percentage.
fn within(error: f64, width: f64) -> f64 {
    if error <= width { 100.0 } else { 0.0 }
}

/// `part` of error and stated standard deviation, of each frame that states one.
fn error_bars(measured: &[FrameMeasurement], part: impl Fn(f64, f64) -> f64) -> Vec<f64> {
    measured.iter().filter_map(|f| Some(part(f.phase_error?, f.phase_sd?))).collect()
}

fn measure(truth: &dyn Truth, prediction: &Prediction, mask: Option<&Mask>, frame: usize) -> Result<FrameMeasurement> {
    let image = truth.image(frame)?;
    let color = prediction.color(frame)?;
    if !color.same_shape(&image) {
        return Err(Error::input(format!(
            "image of frame {frame} of case {} is not of the camera's size",
            truth.case_id()
        )));
    }
    let psnr_ahead = match prediction.ahead_frames().binary_search(&frame) {
        Ok(_) => Some(psnr_within(&prediction.ahead(frame)?, &image, mask)),
        Err(_) => None,
    };
    let depth = match prediction.depth_mm(frame)? {
        Some(depth) => Some(depth_within(&depth, truth.depth_mm(frame)?, mask)),
        None => None,
    };
    let phase_error = prediction.phase().map(|p| (p[frame] - truth.frames()[frame].phase).abs());
    let phase_sd = prediction.phase_sd().map(|sd| sd[frame]);
    let pose_error = prediction.poses().map(|p| pose_error(&p[frame], &truth.frames()[frame].world_from_camera));
    let (psnr, ssim) = (psnr_within(&color, &image, mask), ssim_within(&color, &image, mask)?);
    Ok(FrameMeasurement { psnr, psnr_ahead, ssim, depth, phase_error, phase_sd, pose_error })
}

/// What is measured on the view of a second camera.
struct NovelMeasurement {
    psnr: Option<Psnr>,
    ssim: Option<Ssim>,
    /// As in [`FrameMeasurement`].
    depth: Option<Option<DepthErrors>>,
}

fn measure_novel(
    truth: &dyn Truth,
    prediction: &Prediction,
    mask: Option<&Mask>,
    frame: usize,
) -> Result<NovelMeasurement> {
    let (mut psnr, mut ssim) = (None, None);
    if prediction.has_novel_views() {
        let (image, color) = (truth.novel_image(frame)?, prediction.novel(frame)?);
        (psnr, ssim) = (Some(psnr_within(&color, &image, mask)), Some(ssim_within(&color, &image, mask)?));
    }
    let depth = prediction.novel_depth_mm(frame)?;
    let depth = depth.map(|depth| Ok(depth_within(&depth, truth.novel_depth_mm(frame)?, mask))).transpose()?;
    Ok(NovelMeasurement { psnr, ssim, depth })
}

/// Depth errors where the mask shows something: pixels without true depth do not count.
fn depth_within(depth: &Image<f32>, mut true_depth: Image<f32>, mask: Option<&Mask>) -> Option<DepthErrors> {
    if let Some(mask) = mask {
        mask.hide(&mut true_depth, 0.0);
    }
    depth_errors(depth, &true_depth)
}

/// Distance in mm of each predicted target to the true one, per frame; empty without a prediction.
fn target_distances(truth: &dyn Truth, prediction: &Prediction) -> Vec<Vec<f64>> {
    let count = truth.targets().len();
    let of_frame = |(frame, places): (usize, &Vec<DVec3>)| {
        let off = |(index, place): (usize, &DVec3)| place.distance(truth.target_mm(index, frame));
        places.iter().take(count).enumerate().map(off).collect()
    };
    prediction
        .targets()
        .map_or_else(Vec::new, |all| all.iter().take(truth.frames().len()).enumerate().map(of_frame).collect())
}

/// 95th percentile in mm over all frames and targets.
fn navigation_p95(frames: &[NavigationFrame]) -> Option<f64> {
    quantile(&frames.iter().flat_map(NavigationFrame::distances_mm).collect::<Vec<_>>(), 0.95)
}

/// Distance in mm between two poses, and the angle in degrees between them.
fn pose_error(predicted: &DAffine3, truth: &DAffine3) -> [f64; 2] {
    let turn = DQuat::from_mat3(&(truth.matrix3.transpose() * predicted.matrix3));
    let angle = 2.0 * turn.xyz().length().atan2(turn.w.abs());
    [predicted.translation.distance(truth.translation), angle.to_degrees()]
}

/// The outcome of the target metrics.
enum TargetOutcome {
    /// The prediction has no surface.
    NoSurface,
    /// The truth has no contour around the camera.
    NoTrueContour,
    Measured(Box<TargetErrors>),
}

fn target(truth: &dyn Truth, prediction: &Prediction, settings: &ScoreSettings) -> Result<TargetOutcome> {
    let Some(surface) = prediction.final_mesh()? else { return Ok(TargetOutcome::NoSurface) };
    let last = &truth.frames()[truth.frames().len() - 1];
    let mut stated = prediction.correspondence()?;
    if stated.is_none()
        && let Some((told, table)) = truth.told_correspondence()?
        && told.faces == surface.faces
        && told.vertices.len() == surface.vertices.len()
    {
        stated = Some(correspondence::parse(&table, &surface)?);
    }
    let (truth, seed) = (final_mesh(truth)?, settings.target_seed);
    let errors = target_errors(&truth, &surface, stated.as_deref(), &last.world_from_camera, seed)?;
    Ok(errors.map_or(TargetOutcome::NoTrueContour, |e| TargetOutcome::Measured(Box::new(e))))
}

fn entry(id: &str, value: Option<f64>, status: Status, count: usize, detail: &str) -> MetricScore {
    // Scores hold no NaN and no infinity, whatever the prediction was.
    let (value, status) = match value {
        Some(v) if !v.is_finite() => (None, Status::Degenerate),
        value => (value, status),
    };
    MetricScore { metric: id.into(), value, status, deviation: None, count, interval: None, detail: detail.into() }
}

fn plain(id: &str, value: Option<f64>, count: usize) -> MetricScore {
    match value {
        Some(_) => entry(id, value, Status::Ok, count, ""),
        None => entry(id, None, Status::NotApplicable, 0, ""),
    }
}

fn with_interval(id: &str, mean: MeanInterval) -> MetricScore {
    MetricScore {
        deviation: mean.deviation,
        interval: mean.interval,
        ..entry(id, Some(mean.mean), Status::Ok, mean.count, "")
    }
}

fn series_mean(id: &str, values: Vec<f64>, seed: u64) -> MetricScore {
    bootstrap_series(&values, seed).map_or_else(|| plain(id, None, 0), |mean| with_interval(id, mean))
}

/// No rendering equals the sensor's noise. By that noise (.24 codes, the films' in `quick`) and the rounding of both, a
/// perfect rendering would be 57 dB from its frame (computed, not measured). What is far nearer is the input itself.
const COPIED_DB: f64 = 65.0;
/// Share of copied frames from which the pictures count as copied.
const COPIED_SHARE: f64 = 0.01;

/// What is said of them.
const COPIED: &str = "the pictures are the input, which no estimate equals";

fn are_copies(pictures: impl Iterator<Item = Psnr> + Clone) -> bool {
    let copied = |psnr: &Psnr| match psnr {
        Psnr::Identical => true,
        Psnr::Decibel(decibel) => *decibel > COPIED_DB,
    };
    pictures.clone().filter(copied).count() as f64 > COPIED_SHARE * pictures.count() as f64
}

/// Pictures that equal the truth are marked as such; those that nearly do are no better.
fn are_nearly_copies(novel: &[NovelMeasurement]) -> bool {
    let pictures = novel.iter().filter_map(|view| view.psnr);
    !pictures.clone().all(|psnr| psnr == Psnr::Identical) && are_copies(pictures)
}

fn psnr_mean(id: &str, frames: Vec<Psnr>, ceiling: f64, seed: u64) -> MetricScore {
    let identical = frames.iter().filter(|p| **p == Psnr::Identical).count();
    if identical == frames.len() && identical > 0 {
        return entry(id, None, Status::Identical, identical, "every frame equals the truth");
    }
    let decibels = frames.iter().map(|p| if let Psnr::Decibel(d) = p { *d } else { ceiling }).collect();
    let mut score = series_mean(id, decibels, seed);
    if identical > 0 {
        score.detail = format!("{identical} frames equal the truth and count as {ceiling:.2} dB");
    }
    score
}

fn ssim_mean(id: &str, measured: impl Iterator<Item = Ssim> + Clone, seed: u64) -> MetricScore {
    let values: Vec<f64> = measured.clone().filter_map(|ssim| ssim.valid).collect();
    if values.is_empty() && measured.count() > 0 {
        return entry(id, None, Status::Degenerate, 0, "no 11x11 window lies within image and mask");
    }
    series_mean(id, values, seed)
}

fn depth_mean<'a>(
    id: &str,
    measured: impl Iterator<Item = &'a Option<Option<DepthErrors>>>,
    part: impl Fn(&DepthErrors) -> f64,
    seed: u64,
) -> MetricScore {
    let claimed: Vec<&Option<DepthErrors>> = measured.filter_map(Option::as_ref).collect();
    let values: Vec<f64> = claimed.iter().filter_map(|d| d.as_ref().map(&part)).collect();
    match (claimed.is_empty(), values.is_empty()) {
        (false, true) => entry(id, None, Status::Degenerate, 0, "no frame has true depth"),
        _ => series_mean(id, values, seed),
    }
}

fn correlation(id: &str, truth: &dyn Truth, prediction: &Prediction) -> MetricScore {
    let Some(predicted) = prediction.phase() else { return plain(id, None, 0) };
    let phases: Vec<f64> = truth.frames().iter().map(|f| f.phase).collect();
    match pearson(predicted, &phases) {
        Some(r) => entry(id, Some(r), Status::Ok, phases.len(), ""),
        None => entry(id, None, Status::Degenerate, phases.len(), "a phase trajectory without variance"),
    }
}

fn contour_score(id: &str, target: &TargetOutcome) -> MetricScore {
    match target {
        TargetOutcome::Measured(t) => match (t.contour_rmse_mm, t.enclosure) {
            (Some(_), Enclosure::Inside) => {
                let detail = match t.cuts {
                    [own, other] if own == other => String::new(),
                    [own, other] => {
                        format!("branches otherwise in the plane: {own} cuts of the truth, {other} predicted")
                    }
                };
                entry(id, t.contour_rmse_mm, Status::Ok, t.overlay.truth.len(), &detail)
            }
            (Some(_), Enclosure::Outside) => {
                let detail = "no predicted contour encloses the camera; the nearest one was taken";
                entry(id, t.contour_rmse_mm, Status::CameraOutside, t.overlay.truth.len(), detail)
            }
            (None, _) => entry(id, None, Status::NoContour, 0, "the plane does not meet the predicted surface"),
        },
        _ => target_score(id, target, |_| None),
    }
}

fn target_score(id: &str, target: &TargetOutcome, part: impl Fn(&TargetErrors) -> Option<f64>) -> MetricScore {
    match target {
        TargetOutcome::NoSurface => plain(id, None, 0),
        TargetOutcome::NoTrueContour => {
            entry(id, None, Status::NoContour, 0, "no contour of the true surface encloses the final camera")
        }
        TargetOutcome::Measured(t) => match part(t) {
            None => {
                let detail = "the surface has other faces than the sequence's, and there is no correspondence.csv";
                entry(id, None, Status::NoCorrespondence, 0, detail)
            }
            value => {
                let detail = match t.correspondence {
                    Correspondence::Stated => "other faces: by correspondence.csv",
                    Correspondence::Material | Correspondence::Missing => "",
                };
                entry(id, value, Status::Ok, t.overlay.truth.len(), detail)
            }
        },
    }
}

fn frame_scores(
    truth: &dyn Truth,
    prediction: &Prediction,
    (measured, novel): (&[FrameMeasurement], &[NovelMeasurement]),
    distances: &[Vec<f64>],
    navigation: &[NavigationFrame],
) -> Vec<FrameScore> {
    let frame_score = |(frame, m): (usize, &FrameMeasurement)| {
        let record = &truth.frames()[frame];
        let view = truth.novel_views().iter().position(|view| view.frame == frame);
        let mut values = frame_values(m, view.map(|view| &novel[view]));
        if let Some(distance) = distances.get(frame).and_then(|of_frame| mean(of_frame)) {
            let metric = "target_mean_mm".to_owned();
            values.push(FrameValue { metric, value: Some(distance), status: Status::Ok });
        }
        for (metric, value) in navigation.get(frame).into_iter().flat_map(navigation::frame_values) {
            values.push(FrameValue { metric: metric.to_owned(), value: Some(value), status: Status::Ok });
        }
        FrameScore {
            frame,
            time_s: record.time_s,
            phase: record.phase,
            phase_predicted: prediction.phase().map(|p| p[frame]),
            values,
        }
    };
    measured.iter().enumerate().map(frame_score).collect()
}

fn frame_values(m: &FrameMeasurement, novel: Option<&NovelMeasurement>) -> Vec<FrameValue> {
    let value = |metric: &str, value: Option<f64>, without: Status| FrameValue {
        metric: metric.into(),
        value: value.filter(|v| v.is_finite()),
        status: if value.is_some() { Status::Ok } else { without },
    };
    let decibel = |p: Psnr| if let Psnr::Decibel(d) = p { Some(d) } else { None };
    let mut values =
        vec![value("psnr_db", decibel(m.psnr), Status::Identical), value("ssim", m.ssim.valid, Status::Degenerate)];
    if let Some(depth) = &m.depth {
        let part = |part: fn(&DepthErrors) -> f64| depth.as_ref().map(part);
        values.push(value("depth_rmse_mm", part(|d| d.rmse_mm), Status::Degenerate));
        values.push(value("depth_delta_1_25", part(|d| d.delta_1_25), Status::Degenerate));
    }
    if let Some(error) = m.phase_error {
        values.push(value("phase_mae", Some(error), Status::Degenerate));
    }
    if let Some((error, sd)) = m.phase_error.zip(m.phase_sd) {
        values.push(value("phase_coverage_1sd_pct", Some(within(error, sd)), Status::Degenerate));
        values.push(value("phase_coverage_2sd_pct", Some(within(error, 2.0 * sd)), Status::Degenerate));
        values.push(value("phase_sd_mean", Some(sd), Status::Degenerate));
    }
    if let Some([mm, degrees]) = m.pose_error {
        values.push(value("pose_error_mm", Some(mm), Status::Degenerate));
        values.push(value("pose_error_deg", Some(degrees), Status::Degenerate));
    }
    if let Some(p) = novel.and_then(|view| view.psnr) {
        values.push(value("novel_psnr_db", decibel(p), Status::Identical));
    }
    if let Some(ssim) = novel.and_then(|view| view.ssim) {
        values.push(value("novel_ssim", ssim.valid, Status::Degenerate));
    }
    if let Some(depth) = novel.and_then(|view| view.depth.as_ref()) {
        let part = |part: fn(&DepthErrors) -> f64| depth.as_ref().map(part);
        values.push(value("novel_depth_rmse_mm", part(|d| d.rmse_mm), Status::Degenerate));
        values.push(value("novel_depth_delta_1_25", part(|d| d.delta_1_25), Status::Degenerate));
    }
    if let Some(p) = m.psnr_ahead {
        values.push(value("psnr_ahead_db", decibel(p), Status::Identical));
    }
    values
}
