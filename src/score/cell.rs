//! Scores one prediction against one sequence: every metric of the registry, every frame.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::contour::ContourOverlay;
use super::finding::{Finding, Status};
use super::measured::{Measured, MeasuredFrame, TargetOutcome};
use super::metric::{FrameReading, Metric};
use super::prediction::{Prediction, Question};
use super::registry::{metric, registry};
use super::truth::Truth;
use crate::base::{Error, Result};

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

impl MetricScore {
    fn new(id: &str, found: Finding) -> Self {
        let Finding { value, status, deviation, count, interval, detail } = found;
        MetricScore { metric: id.to_owned(), value, status, deviation, count, interval, detail }
    }
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

impl FrameValue {
    fn new(id: &str, reading: FrameReading) -> Self {
        let status = reading.err().unwrap_or(Status::Ok);
        FrameValue { metric: id.to_owned(), value: reading.ok().filter(|v| v.is_finite()), status }
    }
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
    /// Values of the frame-wise metrics, those of one file of the prediction together.
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

    /// Drops what the method took: it was not measured, or beside other work.
    pub fn without_times(&mut self) {
        let is_time = |id: &str| metric(id).is_some_and(|m| m.is_runtime());
        for score in self.metrics.iter_mut().filter(|score| is_time(&score.metric)) {
            *score = MetricScore {
                value: None,
                status: Status::NotApplicable,
                deviation: None,
                interval: None,
                ..score.clone()
            };
        }
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
    let measured = Measured::of(truth, &prediction, settings.target_seed)?;
    let metrics = registry().iter().map(|m| MetricScore::new(m.id, m.finding(&measured))).collect();
    let method = settings.method.clone().or_else(|| prediction.method().map(str::to_owned));
    Ok(CellScore {
        case_id: truth.case_id().to_owned(),
        case_hash: truth.hash().to_owned(),
        film_content: truth.content().to_owned(),
        method: method.unwrap_or_else(|| "prediction".to_owned()),
        seed: settings.seed,
        frames,
        metrics,
        frame_scores: frame_scores(&measured),
        overlay: match measured.target {
            TargetOutcome::Measured(t) if !t.overlay.predicted.is_empty() => Some(t.overlay),
            _ => None,
        },
    })
}

/// The values of every frame, those of one file of the prediction together.
fn frame_scores(measured: &Measured<'_>) -> Vec<FrameScore> {
    let mut metrics: Vec<&Metric> = registry().iter().filter(|m| m.is_frame_wise()).collect();
    metrics.sort_by_key(|m| m.applies_to.file_place());
    let frame_score = |(frame, m): (usize, MeasuredFrame<'_>)| {
        let record = &measured.truth.frames()[frame];
        FrameScore {
            frame,
            time_s: record.time_s,
            phase: record.phase,
            phase_predicted: measured.prediction.phase().map(|p| p[frame]),
            values: metrics.iter().filter_map(|metric| Some(FrameValue::new(metric.id, metric.reading(&m)?))).collect(),
        }
    };
    measured.frames().enumerate().map(frame_score).collect()
}
