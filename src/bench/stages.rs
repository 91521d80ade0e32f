//! What the executor asks of the rooms below: film, reconstruct, score. A trait, so that the executor is tested
//! without them.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

use super::plan::Cell;
use crate::base::{Error, ErrorKind, Progress, Result};

/// The three stages, joined by folders.
pub trait Stages: Sync {
    /// Makes the sequence of a case in `folder`. Continues what an interrupted call left there.
    fn film(&self, case_id: &str, folder: &Path, progress: &dyn Progress) -> Result<()>;

    /// Runs the cell's method on `sequence` and writes its prediction to the empty folder `prediction`.
    fn reconstruct(&self, cell: &Cell, sequence: &Path, prediction: &Path, progress: &dyn Progress) -> Result<()>;

    /// Scores `prediction` against `sequence` and writes the score to the file `score`.
    fn score(&self, cell: &Cell, sequence: &Path, prediction: &Path, score: &Path) -> Result<()>;
}

/// The answer of `work`, or an error where it panics: a panic is a bug of one stage or thread, and costs its cell or its
/// film, not the run.
pub(super) fn caught<T>(work: impl FnOnce() -> Result<T>) -> Result<T> {
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|payload| {
        let text = payload.downcast_ref::<String>().map(String::as_str);
        let text = text.or_else(|| payload.downcast_ref::<&str>().copied()).unwrap_or("no message");
        Err(Error::new(ErrorKind::CellFailed, format!("a bug in the program: {text}")))
    })
}
