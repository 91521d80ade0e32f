//! The events of runs and experiments as lines and bars.

use super::Terminal;
use crate::base::Progress;
use crate::bench::{CacheUse, Event, Watcher};
use crate::experiments::ExperimentWatcher;

impl Watcher for Terminal {
    fn event(&self, event: &Event<'_>) {
        match event {
            Event::Started { plan } => {
                let (cases, methods, cells) = (plan.cases.len(), plan.methods.len(), plan.cells().len());
                let seeds = match plan.seeds.len() {
                    1 => String::new(),
                    several => format!(" x {several} seeds, where a method draws,"),
                };
                let threads = rayon::current_num_threads();
                let plan = &plan.profile;
                self.note(&format!(
                    "profile {plan}: {cases} cases x {methods} methods{seeds} = {cells} cells, {threads} threads"
                ));
            }
            Event::Filming { case_id } => self.stage(format_args!("{case_id}: filming")),
            Event::Filmed { case_id, cache_use: CacheUse::Made, wall_s } => {
                self.finish();
                self.note(&format!("{case_id}: filmed in {wall_s:.1} s"));
            }
            Event::Filmed { case_id, cache_use: CacheUse::Cached, .. } => {
                self.note(&format!("{case_id}: film is cached"))
            }
            Event::CellStarted { cell } => self.stage(format_args!("{}: {}", cell.case_id, cell.method)),
            Event::CellFinished { cell, cache_use, wall_s, done, total } => {
                self.finish();
                let how = match cache_use {
                    CacheUse::Made => format!("{wall_s:.1} s"),
                    CacheUse::Cached => "cached".to_owned(),
                };
                self.note(&format!("[{done}/{total}] {}: {how}", cell.id()));
            }
            Event::CellFailed { cell, error } => {
                self.finish();
                self.note(&format!("{} FAILED: {error}", cell.id()));
            }
            Event::Waiting { cell, holder } => self.note(&format!("waiting for {holder}, which has {}", cell.id())),
            Event::Discarded { path, reason } => self.note(&format!("making {} again: {reason}", path.display())),
        }
    }
}

impl ExperimentWatcher for Terminal {
    fn stage_starts(&self, label: &str) {
        self.stage(label);
    }
}
