//! How long-running work reports progress and is stopped; rooms below the command line never print.

use super::error::{Error, Result};
use super::estimate::Estimate;

/// Receives the progress of long-running work and may stop it.
pub trait Progress: Sync {
    /// `done` of `total` steps (frames, mostly) are finished.
    fn advance(&self, done: usize, total: usize);

    /// True when the work should stop at the next safe point, with `ErrorKind::Interrupted`.
    fn cancelled(&self) -> bool;

    /// An error when the work should stop: for the places between two stages.
    fn proceed(&self) -> Result<()> {
        if self.cancelled() { Err(Error::interrupted()) } else { Ok(()) }
    }

    /// Whether work of this size may begin; an error when the user would have to be asked first. Who calls the library
    /// decides alone: by default all work may.
    fn accepts(&self, _estimate: &Estimate) -> Result<()> {
        Ok(())
    }

    /// One sentence for the user that is neither progress nor failure.
    fn note(&self, _sentence: &str) {}
}

/// Shows no progress and never stops the work.
pub struct NoProgress;

impl Progress for NoProgress {
    fn advance(&self, _done: usize, _total: usize) {}

    fn cancelled(&self) -> bool {
        false
    }
}
