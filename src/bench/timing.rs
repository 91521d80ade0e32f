//! What a stage cost: wall and CPU seconds, memory, threads. Kept beside the products, never inside them, so that
//! results stay the same bytes whatever the machine was doing.

use std::path::Path;
use std::time::Instant;

use serde::{Deserialize, Serialize};

use crate::base::{Result, files};
use crate::ffi::system;

/// The cost of one stage of one cell or sequence.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StageTiming {
    /// `simulate`, `reconstruct` or `score`.
    pub stage: String,
    /// Wall seconds.
    pub wall_s: f64,
    /// User and system CPU seconds of all threads.
    pub cpu_s: f64,
    /// Highest resident memory of the process when the stage ended, in MiB.
    pub peak_memory_mib: f64,
    /// Threads that the stage could use.
    pub threads: usize,
}

/// Runs `work` as `stage` and reports what it cost, whether it succeeded or not.
pub fn measured<T>(stage: &str, work: impl FnOnce() -> Result<T>) -> (Result<T>, StageTiming) {
    let (wall, cpu_s) = (Instant::now(), system::cpu_time_s());
    let outcome = work();
    let timing = StageTiming {
        stage: stage.into(),
        wall_s: wall.elapsed().as_secs_f64(),
        cpu_s: system::cpu_time_s() - cpu_s,
        peak_memory_mib: system::peak_memory_mib(),
        threads: rayon::current_num_threads(),
    };
    (outcome, timing)
}

/// The timings kept at `path`; none when there is no such file.
pub fn read(path: &Path) -> Result<Vec<StageTiming>> {
    if path.exists() { files::read_json(path) } else { Ok(Vec::new()) }
}

/// Replaces the kept timing of the same stage.
pub fn keep(path: &Path, timing: StageTiming) -> Result<()> {
    let mut all = read(path).unwrap_or_default();
    all.retain(|t| t.stage != timing.stage);
    all.push(timing);
    files::write_json(path, &all)
}

/// Adds to the kept timing of the same stage: for work that an interruption split.
pub fn add(path: &Path, mut timing: StageTiming) -> Result<()> {
    if let Some(before) = read(path).unwrap_or_default().into_iter().find(|t| t.stage == timing.stage) {
        timing.wall_s += before.wall_s;
        timing.cpu_s += before.cpu_s;
        timing.peak_memory_mib = timing.peak_memory_mib.max(before.peak_memory_mib);
    }
    keep(path, timing)
}
