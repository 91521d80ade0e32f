//! Whether the numbers of a cell follow from its frames: what can be told of a table that somebody else hands in.
//!
//! Means over frames, their deviations and counts, and the correlation of the phase are computed again from the frames.
//! Surfaces and times leave no trace there: of them only what contradicts itself is found.

use super::cell::{CellScore, FrameValue, MetricScore};
use super::finding::Status;
use super::image_quality::Psnr;
use super::measures::are_copies;
use super::metric::{Metric, Needs, Trace};
use super::registry;
use super::statistics::{deviation, mean, pearson};
use crate::base::{Error, Result};

/// Largest relative difference of two sums of the same numbers that were written and read again.
const ROUNDING: f64 = 1e-9;
/// More than any image that this program reads can have, in dB: what a frame that equals the truth may count as.
const HIGHEST_PSNR_DB: f64 = 160.0;

/// Refuses a cell whose table says something else than its frames. The error names case, method and metric.
pub fn check_means(cell: &CellScore) -> Result<()> {
    let named = |id: &str| format!("{} {} {id}", cell.case_id, cell.method);
    let refused = |id: &str, why: String| Err(Error::input(why).element(named(id)));
    if cell.frames != cell.frame_scores.len() {
        let sentence = format!("are {} in comparison.csv and {} in frames.csv", cell.frames, cell.frame_scores.len());
        return refused("frames", sentence);
    }
    for metric in &cell.metrics {
        let Some(known) = registry::metric(&metric.metric) else { continue };
        let wrong = match known.trace {
            _ if metric.value.is_some() && shows_copies(cell, known) => {
                Some("has a value, and by frames.csv the pictures are the input or the truth: one was changed".into())
            }
            _ if known.is_frame_wise() => wrong_mean(cell, metric),
            Trace::Phases => wrong_correlation(cell, metric),
            Trace::TotalTime => wrong_time(cell, metric),
            Trace::None => None,
        };
        if let Some(sentence) = wrong {
            return refused(&metric.metric, sentence);
        }
    }
    Ok(())
}

fn wrong_mean(cell: &CellScore, metric: &MetricScore) -> Option<String> {
    let of_metric = |frame: &FrameValue| frame.metric == metric.metric;
    let frames: Vec<&FrameValue> = cell.frame_scores.iter().flat_map(|f| &f.values).filter(|v| of_metric(v)).collect();
    let values: Vec<f64> = frames.iter().filter_map(|v| v.value).collect();
    let identical = frames.iter().filter(|v| v.status == Status::Identical).count();
    let counted = values.len() + identical;
    let told = |what: &str, table: String, frames: String| {
        Some(format!("has {what} {table} in results.csv, but the frames of frames.csv give {frames}: one was changed"))
    };
    let Some(value) = metric.value else {
        return match values.is_empty() || metric.status == Status::Copied {
            true => None,
            false => told("the value", "nothing".into(), format!("a mean over {counted}")),
        };
    };
    if metric.count != counted {
        return told("the count", metric.count.to_string(), counted.to_string());
    }
    let centre = mean(&values).unwrap_or(0.0);
    if identical > 0 {
        // Each frame that equals the truth counts as one high value, the same for all.
        let each = (value * counted as f64 - centre * values.len() as f64) / identical as f64;
        let highest = values.iter().copied().fold(0.0, f64::max);
        return match (highest - ROUNDING..HIGHEST_PSNR_DB).contains(&each) {
            true => None,
            false => told("the value", value.to_string(), format!("{each} for each frame that equals the truth")),
        };
    }
    if !is_same(value, centre) {
        return told("the value", value.to_string(), centre.to_string());
    }
    let (table, frames) = (metric.deviation.unwrap_or(0.0), deviation(&values).unwrap_or(0.0));
    if is_same(table, frames) { None } else { told("the deviation", table.to_string(), frames.to_string()) }
}

/// Whether the pictures that `metric` judges are, by the PSNR of their frames, those that they are compared with.
fn shows_copies(cell: &CellScore, metric: &Metric) -> bool {
    let by = registry::told_by(metric).unwrap_or(metric);
    if by.unit != "dB" {
        return false;
    }
    let picture = |frame: &FrameValue| match (frame.status, frame.value) {
        (Status::Identical, _) => Some(Psnr::Identical),
        (_, value) => value.map(Psnr::Decibel),
    };
    let frames = cell.frame_scores.iter().flat_map(|f| &f.values).filter(|v| v.metric == by.id);
    let pictures: Vec<Psnr> = frames.filter_map(picture).collect();
    // A second camera's pictures that all equal the truth are marked by their PSNR, and have an SSIM.
    let is_marked =
        by.applies_to == Needs::Novel && by.id != metric.id && pictures.iter().all(|p| *p == Psnr::Identical);
    are_copies(&pictures) && !is_marked
}

fn wrong_correlation(cell: &CellScore, metric: &MetricScore) -> Option<String> {
    let pairs: Option<Vec<(f64, f64)>> =
        cell.frame_scores.iter().map(|f| f.phase_predicted.map(|predicted| (predicted, f.phase))).collect();
    let (predicted, phase): (Vec<f64>, Vec<f64>) = pairs.unwrap_or_default().into_iter().unzip();
    let again = pearson(&predicted, &phase);
    match (metric.value, again) {
        (None, None) => None,
        (Some(table), Some(frames)) if is_same(table, frames) => None,
        (table, frames) => {
            let word = |v: Option<f64>| v.map_or("nothing".to_owned(), |v| v.to_string());
            Some(format!(
                "is {} in results.csv, but the phases of frames.csv give {}: one was changed",
                word(table),
                word(frames)
            ))
        }
    }
}

fn wrong_time(cell: &CellScore, metric: &MetricScore) -> Option<String> {
    let (total_s, frame_s) = (cell.value("time_total_s")?, metric.value?);
    let again = total_s / cell.frames as f64;
    (!is_same(frame_s, again))
        .then(|| format!("is {frame_s} in comparison.csv, where {total_s} s for {} frames give {again}", cell.frames))
}

fn is_same(a: f64, b: f64) -> bool {
    (a - b).abs() <= ROUNDING * (1.0 + a.abs().max(b.abs()))
}

#[cfg(test)]
mod tests {
    use super::super::cell::{ScoreSettings, score};
    use super::super::fixture::{Distortion, TubeTruth, write_prediction};
    use super::*;

    /// The score of a noisy prediction; one of its two views of second cameras equals the truth.
    fn scored() -> CellScore {
        let folder = tempfile::tempdir().unwrap();
        let truth = TubeTruth::new("case1", 24, 17);
        let distortion = Distortion {
            noise: 6.0,
            depth_scale: 0.1,
            lag: 1,
            pose_shift: 0.2,
            surface_shift_mm: 0.3,
            ..Default::default()
        };
        write_prediction(&truth, folder.path(), &distortion);
        score(&truth, folder.path(), &ScoreSettings::default()).unwrap()
    }

    #[test]
    fn every_number_that_follows_from_the_frames_is_held_to_them() {
        let honest = scored();
        check_means(&honest).unwrap();
        let held: Vec<&str> =
            (registry().iter()).filter(|m| m.is_frame_wise() || m.trace != Trace::None).map(|m| m.id).collect();
        assert_eq!(held.len(), 25, "{held:?}");
        for id in held {
            let place = honest.metrics.iter().position(|m| m.metric == id).unwrap();
            let value = honest.metrics[place].value.unwrap_or_else(|| panic!("{id} has no value"));
            let mut edited = honest.clone();
            edited.metrics[place].value = Some(value * 1.001 + 1e-3);
            let said = check_means(&edited).unwrap_err().to_string();
            assert!(said.contains(&format!("case1 prediction {id}")) && said.contains("csv"), "{said}");
        }
        // A PSNR with a frame that equals the truth leaves room for what that counts as.
        // (One in a hundred: more would be copies.)
        let mut equal = honest.clone();
        equal.metrics.retain(|m| m.metric == "psnr_db");
        equal.frame_scores = (0..7).flat_map(|_| honest.frame_scores.clone()).collect();
        equal.frames = equal.frame_scores.len();
        equal.metrics[0].count = equal.frames;
        let first = equal.frame_scores[0].values.iter_mut().find(|v| v.metric == "psnr_db").unwrap();
        let was = first.value.take().unwrap();
        first.status = Status::Identical;
        let mean = equal.metrics.iter_mut().find(|m| m.metric == "psnr_db").unwrap();
        mean.value = mean.value.map(|value| value + (70.0 - was) / mean.count as f64);
        check_means(&equal).unwrap();
        let mean = equal.metrics.iter_mut().find(|m| m.metric == "psnr_db").unwrap();
        mean.value = mean.value.map(|value| value * 6.0);
        assert!(check_means(&equal).is_err());
        // Two of 119 are copies, which have no value.
        equal.frame_scores[1].values.iter_mut().filter(|v| v.metric == "psnr_db").for_each(|v| v.value = Some(80.0));
        assert!(check_means(&equal).unwrap_err().to_string().contains("the pictures are the input or the truth"));
        let mut fewer = honest.clone();
        fewer.frame_scores.pop();
        assert!(check_means(&fewer).unwrap_err().to_string().contains("frames: are 17"));
        let mut counted = honest.clone();
        counted.metrics.iter_mut().find(|m| m.metric == "ssim").unwrap().count = 8;
        assert!(check_means(&counted).unwrap_err().to_string().contains("the count 8"));
        let mut spread = honest;
        spread.metrics.iter_mut().find(|m| m.metric == "ssim").unwrap().deviation = Some(0.0);
        assert!(check_means(&spread).unwrap_err().to_string().contains("the deviation 0"));
    }
}
