//! What the entries of the registry are computed by: functions of one frame, ways to take the mean over frames, and
//! functions of the whole film.

use super::contour::{Correspondence, Enclosure, TargetErrors};
use super::depth::DepthErrors;
use super::finding::{Finding, Status};
use super::image_quality::{Psnr, Ssim};
use super::measured::{Measured, MeasuredFrame, TargetOutcome};
use super::metric::FrameReading;
use super::navigation::NavigationFrame;
use super::statistics::{self, pearson};
use crate::base::statistics::quantile;
use crate::formats::prediction::CORRESPONDENCE;

/// No rendering equals the sensor's noise. By that noise (.24 codes, the films' in `quick`) and the rounding of both, a
/// perfect rendering would be 57 dB from its frame (computed, not measured). What is far nearer is the input itself.
const COPIED_DB: f64 = 65.0;
/// Share of copied frames from which the pictures count as copied.
const COPIED_SHARE: f64 = 0.01;

/// What is said of them.
const COPIED: &str = "the pictures are the input, which no estimate equals";
/// And of a second camera's.
const NEARLY_COPIED: &str = "the pictures are nearly the truth's, noise and all";
/// And of a second camera's that are what the first one saw.
const COPIED_BESIDE: &str = "the pictures are those of the frames' own cameras";

// One frame. `None`: the prediction does not claim it.

fn decibel(psnr: Psnr) -> FrameReading {
    match psnr {
        Psnr::Decibel(decibel) => Ok(decibel),
        Psnr::Identical => Err(Status::Identical),
    }
}

fn similarity(ssim: Ssim) -> FrameReading {
    ssim.valid.ok_or(Status::Degenerate)
}

/// `part` of the errors of a predicted depth image, which are none where the truth has no depth.
fn of_depth(depth: &Option<Option<DepthErrors>>, part: fn(&DepthErrors) -> f64) -> Option<FrameReading> {
    let errors = depth.as_ref()?.as_ref();
    Some(errors.map(part).ok_or(Status::Degenerate))
}

/// `part` of error and stated standard deviation of the phase, where one is stated.
fn of_phase_bar(frame: &MeasuredFrame<'_>, part: fn(f64, f64) -> f64) -> Option<FrameReading> {
    frame.picture.phase_error.zip(frame.picture.phase_sd).map(|(error, sd)| Ok(part(error, sd)))
}

fn of_navigation(frame: &MeasuredFrame<'_>, part: impl Fn(&NavigationFrame) -> Option<f64>) -> Option<FrameReading> {
    part(frame.navigation?).map(Ok)
}

/// 100 where an error is within a width, else 0: a mean of them is a percentage.
fn within(error: f64, width: f64) -> f64 {
    if error <= width { 100.0 } else { 0.0 }
}

/// PSNR of the picture, dB.
pub fn psnr(frame: &MeasuredFrame<'_>) -> Option<FrameReading> {
    Some(decibel(frame.picture.psnr))
}

/// SSIM of the picture.
pub fn ssim(frame: &MeasuredFrame<'_>) -> Option<FrameReading> {
    Some(similarity(frame.picture.ssim))
}

/// PSNR of the picture that was rendered before the frame's own was read, dB.
pub fn psnr_ahead(frame: &MeasuredFrame<'_>) -> Option<FrameReading> {
    frame.picture.psnr_ahead.map(decibel)
}

/// PSNR of the second camera's picture, dB.
pub fn novel_psnr(frame: &MeasuredFrame<'_>) -> Option<FrameReading> {
    frame.novel?.psnr.map(decibel)
}

/// SSIM of the second camera's picture.
pub fn novel_ssim(frame: &MeasuredFrame<'_>) -> Option<FrameReading> {
    frame.novel?.ssim.map(similarity)
}

/// RMSE of the depth, mm.
pub fn depth_rmse(frame: &MeasuredFrame<'_>) -> Option<FrameReading> {
    of_depth(&frame.picture.depth, |depth| depth.rmse_mm)
}

/// Share of the depths that are off by less than a quarter.
pub fn depth_delta(frame: &MeasuredFrame<'_>) -> Option<FrameReading> {
    of_depth(&frame.picture.depth, |depth| depth.delta_1_25)
}

/// RMSE of the second camera's depth, mm.
pub fn novel_depth_rmse(frame: &MeasuredFrame<'_>) -> Option<FrameReading> {
    of_depth(&frame.novel?.depth, |depth| depth.rmse_mm)
}

/// Share of the second camera's depths that are off by less than a quarter.
pub fn novel_depth_delta(frame: &MeasuredFrame<'_>) -> Option<FrameReading> {
    of_depth(&frame.novel?.depth, |depth| depth.delta_1_25)
}

/// Error of the phase.
pub fn phase_error(frame: &MeasuredFrame<'_>) -> Option<FrameReading> {
    frame.picture.phase_error.map(Ok)
}

/// Whether the phase is off by at most the stated standard deviation, in percent.
pub fn phase_within_1sd(frame: &MeasuredFrame<'_>) -> Option<FrameReading> {
    of_phase_bar(frame, within)
}

/// The same for two of them.
pub fn phase_within_2sd(frame: &MeasuredFrame<'_>) -> Option<FrameReading> {
    of_phase_bar(frame, |error, sd| within(error, 2.0 * sd))
}

/// The stated standard deviation of the phase.
pub fn phase_deviation(frame: &MeasuredFrame<'_>) -> Option<FrameReading> {
    of_phase_bar(frame, |_, sd| sd)
}

/// Distance of the camera from its true place, mm.
pub fn pose_distance(frame: &MeasuredFrame<'_>) -> Option<FrameReading> {
    frame.picture.pose_error.map(|[mm, _]| Ok(mm))
}

/// Angle of the camera to its true orientation, degrees.
pub fn pose_angle(frame: &MeasuredFrame<'_>) -> Option<FrameReading> {
    frame.picture.pose_error.map(|[_, degrees]| Ok(degrees))
}

/// Distance of the targets from their true places, mean over targets, mm.
pub fn targets_distance(frame: &MeasuredFrame<'_>) -> Option<FrameReading> {
    statistics::mean(frame.distances_mm).map(Ok)
}

/// The same in the camera's axes, mm.
pub fn navigation_error(frame: &MeasuredFrame<'_>) -> Option<FrameReading> {
    of_navigation(frame, NavigationFrame::error_mm)
}

/// Whether the targets are lost, in percent.
pub fn lost(frame: &MeasuredFrame<'_>) -> Option<FrameReading> {
    of_navigation(frame, NavigationFrame::lost_pct)
}

/// Whether they are lost while the error bar says otherwise, in percent.
pub fn lost_in_silence(frame: &MeasuredFrame<'_>) -> Option<FrameReading> {
    of_navigation(frame, NavigationFrame::silent_pct)
}

/// At the end of a disturbance: whether the targets are found again soon enough, in percent.
pub fn recovered(frame: &MeasuredFrame<'_>) -> Option<FrameReading> {
    of_navigation(frame, NavigationFrame::recovered_pct)
}

/// Share of the coordinates that are off by at most the stated standard deviation, in percent.
pub fn navigation_within_1sd(frame: &MeasuredFrame<'_>) -> Option<FrameReading> {
    of_navigation(frame, |navigation| navigation.coverage_pct(1.0))
}

/// The same for two of them.
pub fn navigation_within_2sd(frame: &MeasuredFrame<'_>) -> Option<FrameReading> {
    of_navigation(frame, |navigation| navigation.coverage_pct(2.0))
}

/// The stated error bar of the targets, mm.
pub fn navigation_bar(frame: &MeasuredFrame<'_>) -> Option<FrameReading> {
    of_navigation(frame, NavigationFrame::bar_mm)
}

// Means over frames.

fn values(readings: &[FrameReading]) -> Vec<f64> {
    readings.iter().filter_map(|reading| reading.ok()).collect()
}

/// The mean over the frames that have a value.
pub fn mean(measured: &Measured<'_>, readings: &[FrameReading]) -> Finding {
    Finding::of_series(&values(readings), measured.seed)
}

/// The same; where frames were claimed and none has a value, `why` says so.
fn mean_or(why: &str, measured: &Measured<'_>, readings: &[FrameReading]) -> Finding {
    match values(readings).is_empty() && !readings.is_empty() {
        true => Finding::new(None, Status::Degenerate, 0, why),
        false => mean(measured, readings),
    }
}

/// The mean of errors of depths.
pub fn mean_depth(measured: &Measured<'_>, readings: &[FrameReading]) -> Finding {
    mean_or("no frame has true depth", measured, readings)
}

fn mean_similarity(measured: &Measured<'_>, readings: &[FrameReading]) -> Finding {
    mean_or("no 11x11 window lies within image and mask", measured, readings)
}

/// The mean in dB, in which a frame that equals the truth counts with the ceiling.
fn mean_decibel(measured: &Measured<'_>, readings: &[FrameReading]) -> Finding {
    let identical = readings.iter().filter(|reading| reading.is_err()).count();
    if identical == readings.len() && identical > 0 {
        return Finding::new(None, Status::Identical, identical, "every frame equals the truth");
    }
    let ceiling_db = measured.ceiling_db;
    let decibels: Vec<f64> = readings.iter().map(|reading| reading.unwrap_or(ceiling_db)).collect();
    let mut found = Finding::of_series(&decibels, measured.seed);
    if identical > 0 {
        found.detail = format!("{identical} frames equal the truth and count as {ceiling_db:.2} dB");
    }
    found
}

/// Whether too many of the pictures are the truth's for any number of them to count.
pub(super) fn are_copies(pictures: &[Psnr]) -> bool {
    let is_copied = |psnr: &&Psnr| match psnr {
        Psnr::Identical => true,
        Psnr::Decibel(decibel) => *decibel > COPIED_DB,
    };
    pictures.iter().filter(is_copied).count() as f64 > COPIED_SHARE * pictures.len() as f64
}

/// What is found of the pictures, or that they are the input.
fn unless_copied(measured: &Measured<'_>, found: impl FnOnce() -> Finding) -> Finding {
    let pictures: Vec<Psnr> = measured.pictures.iter().map(|frame| frame.psnr).collect();
    match are_copies(&pictures) {
        true => Finding::new(None, Status::Copied, pictures.len(), COPIED),
        false => found(),
    }
}

/// The mean of the pictures' PSNR, unless they are the input.
pub fn mean_psnr(measured: &Measured<'_>, readings: &[FrameReading]) -> Finding {
    unless_copied(measured, || mean_decibel(measured, readings))
}

/// The mean of the pictures' SSIM, unless they are the input.
pub fn mean_ssim(measured: &Measured<'_>, readings: &[FrameReading]) -> Finding {
    unless_copied(measured, || mean_similarity(measured, readings))
}

/// The mean of the PSNR of the pictures that were rendered ahead, unless they are the input.
pub fn mean_psnr_ahead(measured: &Measured<'_>, readings: &[FrameReading]) -> Finding {
    let pictures: Vec<Psnr> = measured.pictures.iter().filter_map(|frame| frame.psnr_ahead).collect();
    match are_copies(&pictures) {
        true => Finding::new(None, Status::Copied, pictures.len(), COPIED),
        false => mean_decibel(measured, readings),
    }
}

/// What is found of the second cameras' pictures, unless they are nearly the truth's, or those of the frames' own cameras.
/// Pictures that equal the truth are marked as such; those that nearly do are no better.
fn unless_nearly_copied(measured: &Measured<'_>, found: impl FnOnce() -> Finding) -> Finding {
    let pictures: Vec<Psnr> = measured.novel.iter().filter_map(|view| view.psnr).collect();
    let of_frames: Vec<Psnr> = measured.novel.iter().filter_map(|view| view.psnr_to_frame).collect();
    let copied = |what| Finding::new(None, Status::Copied, measured.novel.len(), what);
    if are_copies(&pictures) && !pictures.iter().all(|psnr| *psnr == Psnr::Identical) {
        copied(NEARLY_COPIED)
    } else if are_copies(&of_frames) {
        copied(COPIED_BESIDE)
    } else {
        found()
    }
}

/// The mean of the second cameras' PSNR, unless their pictures are nearly the truth's.
pub fn mean_novel_psnr(measured: &Measured<'_>, readings: &[FrameReading]) -> Finding {
    unless_nearly_copied(measured, || mean_decibel(measured, readings))
}

/// The mean of the second cameras' SSIM, unless their pictures are nearly the truth's.
pub fn mean_novel_ssim(measured: &Measured<'_>, readings: &[FrameReading]) -> Finding {
    unless_nearly_copied(measured, || mean_similarity(measured, readings))
}

// The whole film.

/// SSIM with zeros outside of the image, mean over frames, unless the pictures are the input.
pub fn ssim_padded(measured: &Measured<'_>) -> Finding {
    let padded: Vec<f64> = measured.pictures.iter().map(|frame| frame.ssim.padded).collect();
    unless_copied(measured, || Finding::of_series(&padded, measured.seed))
}

/// Share of the true depths for which one was predicted, mean over frames.
pub fn depth_coverage(measured: &Measured<'_>) -> Finding {
    let of_frame = |frame: MeasuredFrame<'_>| of_depth(&frame.picture.depth, |depth| depth.coverage);
    mean_depth(measured, &measured.frames().filter_map(of_frame).collect::<Vec<_>>())
}

/// Pearson's correlation of predicted and true phase.
pub fn phase_correlation(measured: &Measured<'_>) -> Finding {
    let Some(predicted) = measured.prediction.phase() else { return Finding::plain(None, 0) };
    let phases: Vec<f64> = measured.truth.frames().iter().map(|frame| frame.phase).collect();
    match pearson(predicted, &phases) {
        Some(r) => Finding::new(Some(r), Status::Ok, phases.len(), ""),
        None => Finding::new(None, Status::Degenerate, phases.len(), "a phase trajectory without variance"),
    }
}

/// 95th percentile over all frames and targets of the distance from the true place, mm.
pub fn targets_p95(measured: &Measured<'_>) -> Finding {
    Finding::plain(quantile(&measured.distances_mm.concat(), 0.95), measured.pictures.len())
}

/// The same in the camera's axes, mm.
pub fn navigation_p95(measured: &Measured<'_>) -> Finding {
    let distances_mm: Vec<f64> = measured.navigation.iter().flat_map(NavigationFrame::distances_mm).collect();
    Finding::plain(quantile(&distances_mm, 0.95), measured.pictures.len())
}

/// Contour RMSE, mm.
pub fn contour(measured: &Measured<'_>) -> Finding {
    match &measured.target {
        TargetOutcome::Measured(t) => match (t.contour_rmse_mm, t.enclosure) {
            (Some(_), Enclosure::Inside) => {
                let detail = match t.cuts {
                    [own, other] if own == other => String::new(),
                    [own, other] => {
                        format!("branches otherwise in the plane: {own} cuts of the truth, {other} predicted")
                    }
                };
                Finding::new(t.contour_rmse_mm, Status::Ok, t.overlay.truth.len(), &detail)
            }
            (Some(_), Enclosure::Outside) => {
                let detail = "no predicted contour encloses the camera; the nearest one was taken";
                Finding::new(t.contour_rmse_mm, Status::CameraOutside, t.overlay.truth.len(), detail)
            }
            (None, _) => Finding::new(None, Status::NoContour, 0, "the plane does not meet the predicted surface"),
        },
        _ => of_target(measured, |_| None),
    }
}

fn of_target(measured: &Measured<'_>, part: impl Fn(&TargetErrors) -> Option<f64>) -> Finding {
    match &measured.target {
        TargetOutcome::NoSurface => Finding::plain(None, 0),
        TargetOutcome::NoTrueContour => {
            Finding::new(None, Status::NoContour, 0, "no contour of the true surface encloses the final camera")
        }
        TargetOutcome::Measured(t) => match part(t) {
            None => {
                let detail =
                    format!("the surface has other faces than the sequence's, and there is no {CORRESPONDENCE}");
                Finding::new(None, Status::NoCorrespondence, 0, &detail)
            }
            value => {
                let detail = match t.correspondence {
                    Correspondence::Stated => format!("other faces: by {CORRESPONDENCE}"),
                    Correspondence::Material | Correspondence::Missing => String::new(),
                };
                Finding::new(value, Status::Ok, t.overlay.truth.len(), &detail)
            }
        },
    }
}

/// Error of the target at the last frame, mm.
pub fn target(measured: &Measured<'_>) -> Finding {
    of_target(measured, |errors| errors.target_mm)
}

/// Mean of that error over all vertices of the contour, mm.
pub fn target_mean(measured: &Measured<'_>) -> Finding {
    of_target(measured, |errors| errors.mean_mm)
}

/// 95th percentile of that error over all vertices of the contour, mm.
pub fn target_p95(measured: &Measured<'_>) -> Finding {
    of_target(measured, |errors| errors.p95_mm)
}

/// Wall seconds.
pub fn time_total(measured: &Measured<'_>) -> Finding {
    Finding::plain(measured.prediction.time_total_s(), 1)
}

/// Wall seconds of a frame.
pub fn time_per_frame(measured: &Measured<'_>) -> Finding {
    let frames = measured.pictures.len();
    Finding::plain(measured.prediction.time_total_s().map(|total_s| total_s / frames as f64), frames)
}

/// CPU seconds.
pub fn time_cpu(measured: &Measured<'_>) -> Finding {
    Finding::plain(measured.prediction.time_cpu_s(), 1)
}
