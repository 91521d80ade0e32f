//! What happens during a run, as data: for the command line and the tests, which then need not parse text.

use std::path::Path;

use super::claim::Holder;
use super::plan::{Cell, Plan};
use crate::base::{Error, Progress};

/// Whether a product was made now or taken from the cache.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CacheUse {
    /// Made in this run.
    Made,
    /// Made before, by the same code from the same input, and still whole.
    Cached,
}

/// One step of a run.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub enum Event<'a> {
    /// The run starts.
    Started {
        /// What it will do.
        plan: &'a Plan,
    },
    /// A sequence is about to be filmed (not sent when it is cached).
    Filming {
        /// The case.
        case_id: &'a str,
    },
    /// A sequence is ready.
    Filmed {
        /// The case.
        case_id: &'a str,
        /// Made or cached.
        cache_use: CacheUse,
        /// Seconds it took now.
        wall_s: f64,
    },
    /// A cell is about to be computed (not sent when it is cached).
    CellStarted {
        /// The cell.
        cell: &'a Cell,
    },
    /// A cell is scored.
    CellFinished {
        /// The cell.
        cell: &'a Cell,
        /// Made or cached.
        cache_use: CacheUse,
        /// Seconds it took now.
        wall_s: f64,
        /// Cells that are done, this one included.
        done: usize,
        /// Cells of the plan.
        total: usize,
    },
    /// A cell failed; the run goes on.
    CellFailed {
        /// The cell.
        cell: &'a Cell,
        /// Why.
        error: &'a Error,
    },
    /// Nothing is left to do but what another process is doing. Sent once for each claim that is waited for.
    Waiting {
        /// The first cell that waits, for itself or for its film.
        cell: &'a Cell,
        /// Who works on it.
        holder: &'a Holder,
    },
    /// A cached product cannot be used and is made again.
    Discarded {
        /// Folder or file.
        path: &'a Path,
        /// Why, as a clause.
        reason: &'a str,
    },
}

/// Watches a run: progress within a stage, and the events between them.
pub trait Watcher: Progress {
    /// Called for every event, in order, from the thread that runs the plan; where cells run at once, from theirs.
    fn event(&self, event: &Event<'_>);
}
