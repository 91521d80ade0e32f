//! How long work reports and how it is stopped; the rooms below the command line never print.

/// Watches a piece of long work and may stop it.
pub trait Progress: Sync {
    /// `done` of `total` steps (frames, mostly) are finished.
    fn advance(&self, done: usize, total: usize);

    /// True when the work should stop at the next safe point, with `ErrorKind::Interrupted`.
    fn cancelled(&self) -> bool;

    /// One sentence for the user that is neither progress nor failure.
    fn note(&self, _sentence: &str) {}
}

/// Nobody watches, nobody stops.
pub struct NoProgress;

impl Progress for NoProgress {
    fn advance(&self, _done: usize, _total: usize) {}

    fn cancelled(&self) -> bool {
        false
    }
}
