//! What a metric is: everything that the program knows of one stands in one record of this type (`registry.rs`).

use serde::{Serialize, Serializer};

use super::finding::{Finding, Status};
use super::measured::{Measured, MeasuredFrame};

/// Which way a metric gets better.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Goal {
    /// Larger is better.
    Higher,
    /// Smaller is better.
    Lower,
}

impl Goal {
    /// `higher` or `lower`, as in `results.csv`.
    pub fn word(self) -> &'static str {
        match self {
            Goal::Higher => "higher",
            Goal::Lower => "lower",
        }
    }

    /// True when `a` is strictly better than `b`. False as soon as one of them is not a number.
    pub fn better(self, a: f64, b: f64) -> bool {
        match self {
            Goal::Higher => a > b,
            Goal::Lower => a < b,
        }
    }

    /// How much worse `value` is than `reference`, in the metric's unit; negative when it is better.
    pub fn loss(self, value: f64, reference: f64) -> f64 {
        match self {
            Goal::Higher => reference - value,
            Goal::Lower => value - reference,
        }
    }
}

/// The paper's column groups (its Table 1), and navigation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Group {
    /// PSNR, SSIM.
    Rendering,
    /// RMSE, delta < 1.25.
    Depth,
    /// Phase MAE and correlation.
    Breathing,
    /// Contour and target error at the final frame.
    Target,
    /// Targets in the camera's axes.
    Navigation,
    /// Seconds.
    Runtime,
}

impl Group {
    /// Heading in tables.
    pub fn title(self) -> &'static str {
        match self {
            Group::Rendering => "Rendering",
            Group::Depth => "Depth",
            Group::Breathing => "Breathing",
            Group::Target => "Target",
            Group::Navigation => "Navigation",
            Group::Runtime => "Runtime",
        }
    }
}

/// Whether a metric is one of the paper's ten columns.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Standing {
    /// A column of the paper's Table 1 and of `comparison.csv`.
    Paper,
    /// An addition of ours.
    Extra,
}

/// The frames over which the number is taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Split {
    /// Every frame, rendered after it was fitted (the paper's protocol).
    Online,
    /// Every eighth frame, rendered before the method read its image.
    Ahead,
    /// Every eighth frame, seen by a second camera whose picture no method is given.
    Novel,
    /// The last frame alone.
    Final,
}

impl Split {
    /// As in `results.csv`.
    pub fn word(self) -> &'static str {
        match self {
            Split::Online => "online",
            Split::Ahead => "ahead",
            Split::Novel => "novel",
            Split::Final => "final",
        }
    }
}

/// What a metric needs of a prediction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Needs {
    /// The pictures, which every prediction has.
    Pictures,
    /// Depth images.
    Depth,
    /// Phases.
    Phase,
    /// Standard deviations of the phases.
    PhaseDeviation,
    /// Poses of its own.
    Poses,
    /// Views of the second cameras.
    Novel,
    /// Depth images of the second cameras.
    NovelDepth,
    /// Pictures rendered before the frame's own was read.
    Ahead,
    /// Places of the targets.
    Targets,
    /// The same, of a film in which they can be lost.
    DisturbedTargets,
    /// Covariances of those places.
    TargetCovariance,
    /// A surface at the last frame.
    Surface,
    /// Wall seconds.
    Time,
    /// CPU seconds.
    CpuTime,
}

impl Needs {
    /// The predictions that have it, in words.
    pub fn words(self) -> &'static str {
        match self {
            Needs::Pictures => "every prediction",
            Needs::Depth => "predictions with depth images",
            Needs::Phase => "predictions with phase.csv: methods that model the respiratory state",
            Needs::PhaseDeviation => "predictions whose phase.csv states phase_sd in every row",
            Needs::Poses => "methods that estimate poses",
            Needs::Novel => "predictions with novel/NNNNNN.png for every second camera",
            Needs::NovelDepth => "predictions with novel_depth/ for every second camera",
            Needs::Ahead => "predictions with an ahead folder",
            Needs::Targets => "predictions with targets.csv",
            Needs::DisturbedTargets => "predictions with targets.csv, of films with a cough or a touch of the wall",
            Needs::TargetCovariance => "predictions with target_covariance.csv",
            Needs::Surface => "predictions with mesh/final.ply: methods that keep an explicit surface",
            Needs::Time => "predictions with timing.json",
            Needs::CpuTime => "predictions with time_cpu_s in timing.json",
        }
    }

    /// The place of a frame's value in `frames.csv`, where those of one file of the prediction stand together.
    pub fn file_place(self) -> usize {
        match self {
            Needs::Pictures => 0,
            Needs::Depth => 1,
            Needs::Phase | Needs::PhaseDeviation => 2,
            Needs::Poses => 3,
            Needs::Novel => 4,
            Needs::NovelDepth => 5,
            Needs::Ahead => 6,
            Needs::Targets | Needs::DisturbedTargets | Needs::TargetCovariance => 7,
            Needs::Surface => 8,
            Needs::Time | Needs::CpuTime => 9,
        }
    }
}

impl Serialize for Needs {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.words())
    }
}

/// The value of a metric in one frame of a prediction that claims it, or why there is none.
pub type FrameReading = Result<f64, Status>;

/// Reads one frame; `None` where the prediction does not claim what the metric measures.
pub type FrameFunction = fn(&MeasuredFrame<'_>) -> Option<FrameReading>;

/// Takes the mean over the frames that are claimed.
pub type MeanFunction = fn(&Measured<'_>, &[FrameReading]) -> Finding;

/// How a metric is computed from what was measured.
#[derive(Clone, Copy, Debug)]
pub enum Computation {
    /// Frame by frame (`frames.csv`), and then the mean over the frames.
    Frames(FrameFunction, MeanFunction),
    /// In one piece.
    Film(fn(&Measured<'_>) -> Finding),
}

/// From what else in a report's tables the value of a metric follows, beside its own values of the frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Trace {
    /// From nothing.
    None,
    /// From the predicted and the true phase of the frames: their correlation.
    Phases,
    /// From the total time and the number of frames.
    TotalTime,
}

/// One metric.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Metric {
    /// Name in every file.
    pub id: &'static str,
    /// Short heading in tables.
    pub label: &'static str,
    /// Unit; empty for a pure number.
    pub unit: &'static str,
    /// Which way is better.
    pub direction: Goal,
    /// What it is, in full.
    pub definition: &'static str,
    /// Goes up when the definition changes; results of different versions are never compared.
    pub version: u32,
    /// Lowest and highest value it can take (`null` in JSON: unbounded).
    pub range: [Option<f64>; 2],
    /// Its value when truth itself is the prediction; `None` for PSNR (status `identical` or `copied`), and where the truth has none
    /// (times, error bars).
    pub perfect: Option<f64>,
    /// Decimals in tables.
    pub digits: usize,
    /// Column group.
    pub group: Group,
    /// One of the paper's columns or an extra.
    pub standing: Standing,
    /// The frames over which it is taken.
    pub split: Split,
    /// To which predictions it applies: those that have what it needs.
    pub applies_to: Needs,
    /// How it is computed.
    #[serde(skip)]
    pub(super) computation: Computation,
    /// From what else in a report's tables it follows.
    #[serde(skip)]
    pub(super) trace: Trace,
    /// The metric of the same pictures, depths or phases that tells whether they equal the truth: a share of pixels that
    /// are near enough does not, nor would an SSIM of nearly 1. `None` where it tells itself.
    #[serde(skip)]
    pub(super) told_by: Option<&'static str>,
}

impl Metric {
    /// `id/version`, the `definition` column of `results.csv`.
    pub fn definition_id(&self) -> String {
        format!("{}/{}", self.id, self.version)
    }

    /// Heading with unit: `Depth RMSE [mm]`.
    pub fn heading(&self) -> String {
        if self.unit.is_empty() { self.label.to_owned() } else { format!("{} [{}]", self.label, self.unit) }
    }

    /// Its value over all frames that were measured.
    pub(super) fn finding(&self, measured: &Measured<'_>) -> Finding {
        match self.computation {
            Computation::Frames(of_frame, mean) => {
                let readings: Vec<FrameReading> = measured.frames().filter_map(|frame| of_frame(&frame)).collect();
                mean(measured, &readings)
            }
            Computation::Film(of_film) => of_film(measured),
        }
    }

    /// Its value in one frame; `None` for a metric that has none in frames, and where the prediction does not claim it.
    pub(super) fn reading(&self, frame: &MeasuredFrame<'_>) -> Option<FrameReading> {
        match self.computation {
            Computation::Frames(of_frame, _) => of_frame(frame),
            Computation::Film(_) => None,
        }
    }

    /// Whether it is a mean over values of frames, which stand in `frames.csv`.
    pub(super) fn is_frame_wise(&self) -> bool {
        matches!(self.computation, Computation::Frames(..))
    }

    /// Times differ from run to run and stay out of `results.csv`.
    pub fn is_runtime(&self) -> bool {
        self.group == Group::Runtime
    }

    /// Whether it judges what a method states of its own errors. Wider bars alone improve it, so it ranks nobody.
    pub fn judges_error_bars(&self) -> bool {
        matches!(self.applies_to, Needs::PhaseDeviation | Needs::TargetCovariance)
    }

    /// `value` with the metric's decimals.
    pub fn format(&self, value: f64) -> String {
        format!("{value:.*}", self.digits)
    }
}
