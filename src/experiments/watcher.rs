//! Progress of an experiment.

use crate::bench::Watcher;

/// Watches an experiment: its stages, the runs in it, and the user's wish to stop.
pub trait ExperimentWatcher: Watcher {
    /// A stage starts, for instance a case or a scene.
    fn stage_starts(&self, label: &str);
}
