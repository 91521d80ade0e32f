//! What the executor asks of the rooms below: film, reconstruct, score. A trait, so that the executor is tested
//! without them.

use std::path::Path;

use super::plan::Cell;
use crate::base::{Progress, Result};

/// The three stages, joined by folders.
pub trait Stages: Sync {
    /// Makes the sequence of a case in `folder`. Continues what an interrupted call left there.
    fn film(&self, case_id: &str, folder: &Path, progress: &dyn Progress) -> Result<()>;

    /// Runs the cell's method on `sequence` and writes its prediction to the empty folder `prediction`.
    fn reconstruct(&self, cell: &Cell, sequence: &Path, prediction: &Path, progress: &dyn Progress) -> Result<()>;

    /// Scores `prediction` against `sequence` and writes the score to the file `score`.
    fn score(&self, cell: &Cell, sequence: &Path, prediction: &Path, score: &Path) -> Result<()>;
}
