//! What is found for one metric: a value with its spread, or why there is none.

use serde::{Deserialize, Serialize};

use super::statistics::{MeanInterval, bootstrap_series};

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

/// The value of one metric, before it has the metric's name.
#[derive(Clone, Debug, PartialEq)]
pub struct Finding {
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

impl Finding {
    /// A value of that status, or none because of it.
    pub fn new(value: Option<f64>, status: Status, count: usize, detail: &str) -> Self {
        // Scores hold no NaN and no infinity, whatever the prediction was.
        let (value, status) = match value {
            Some(v) if !v.is_finite() => (None, Status::Degenerate),
            value => (value, status),
        };
        Finding { value, status, deviation: None, count, interval: None, detail: detail.into() }
    }

    /// A value, or none because the prediction does not claim what is measured.
    pub fn plain(value: Option<f64>, count: usize) -> Self {
        match value {
            Some(_) => Self::new(value, Status::Ok, count, ""),
            None => Self::new(None, Status::NotApplicable, 0, ""),
        }
    }

    /// The mean of a series of frames; not applicable without any.
    pub fn of_series(values: &[f64], seed: u64) -> Self {
        let of_mean = |MeanInterval { mean, deviation, count, interval }| Finding {
            deviation,
            interval,
            ..Self::new(Some(mean), Status::Ok, count, "")
        };
        bootstrap_series(values, seed).map_or_else(|| Self::plain(None, 0), of_mean)
    }
}
