//! Metrics: registry, one file per family, protocol, aggregation. Reads folders; does not know how predictions were
//! made.
//!
//! ```text
//! Truth (a sequence) + Prediction (a folder) -> Measured -> each Metric of the registry -> CellScore -> report, gate
//! ```

mod cell;
mod check;
pub mod contour;
mod correspondence;
pub mod depth;
mod finding;
#[cfg(test)]
pub(crate) mod fixture;
pub mod image_quality;
mod measured;
mod measures;
mod metric;
mod navigation;
mod other_frame;
mod prediction;
#[cfg(test)]
mod protocol_tests;
mod recompute;
mod registry;
pub mod slice;
pub mod statistics;
mod truth;

pub use cell::{CellScore, FrameScore, FrameValue, MetricScore, ScoreSettings, score};
pub use check::{Contents, check_prediction, check_truth};
pub use correspondence::by_told_faces;
pub use finding::Status;
pub use metric::{Goal, Group, Metric, Needs, Split, Standing};
pub use prediction::{Prediction, Question};
pub use recompute::check_means;
pub use registry::{
    metric, navigation_bar_metrics, navigation_metrics, paper_metrics, ranking_metrics, registry, told_by,
};
pub use truth::{Truth, final_mesh};
