//! What a stage cost: wall and CPU seconds, memory, threads. Kept beside the products, never inside them, so that
//! results stay the same bytes whatever the machine was doing.

use std::collections::HashMap;
use std::path::Path;
use std::time::Instant;

use serde::{Deserialize, Serialize};

use super::array_job::WorkCost;
use super::environment::machine_id;
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
    /// Which work it was: a key of the plan that leaves out the code's revision and the seed. Empty in files of earlier
    /// versions.
    #[serde(default)]
    pub cost_key: String,
    /// The machine that did the work, which need not be the one that reports on it; empty in files of earlier versions, and
    /// where two machines shared the work.
    #[serde(default)]
    pub machine_id: String,
}

/// Runs `work` as `stage` and reports what it cost, whether it succeeded or not.
pub fn measured<T>(stage: &str, cost_key: String, work: impl FnOnce() -> Result<T>) -> (Result<T>, StageTiming) {
    let (wall, cpu_s) = (Instant::now(), system::cpu_time_s());
    let outcome = work();
    let timing = StageTiming {
        stage: stage.into(),
        wall_s: wall.elapsed().as_secs_f64(),
        cpu_s: system::cpu_time_s() - cpu_s,
        peak_memory_mib: system::peak_memory_mib(),
        threads: rayon::current_num_threads(),
        cost_key,
        machine_id: machine_id().to_owned(),
    };
    (outcome, timing)
}

/// The timings kept at `path`; none when there is no such file, or a damaged one: no result depends on them.
///
/// Errors: a file that cannot be read.
pub fn read(path: &Path) -> Result<Vec<StageTiming>> {
    if !path.exists() {
        return Ok(Vec::new());
    }
    Ok(serde_json::from_slice(&files::read_bytes(path)?).unwrap_or_default())
}

/// Replaces the kept timing of the same stage.
///
/// Errors: the file cannot be read or written.
pub fn keep(path: &Path, timing: StageTiming) -> Result<()> {
    let mut all = read(path)?;
    all.retain(|t| t.stage != timing.stage);
    all.push(timing);
    files::write_json(path, &all)
}

/// Adds to the kept timing of the same stage: for work that an interruption split.
pub fn add(path: &Path, mut timing: StageTiming) -> Result<()> {
    if let Some(before) = read(path)?.into_iter().find(|t| t.stage == timing.stage) {
        timing.wall_s += before.wall_s;
        timing.cpu_s += before.cpu_s;
        timing.peak_memory_mib = timing.peak_memory_mib.max(before.peak_memory_mib);
        if timing.machine_id != before.machine_id {
            timing.machine_id.clear();
        }
    }
    keep(path, timing)
}

/// What was measured in the cache at `root`, of any revision and seed: by [`StageTiming::cost_key`], CPU seconds and
/// highest memory in MiB over the stages, the largest where work was done more than once. What cannot be read is left
/// out: an expectation needs no more.
pub fn measured_costs(root: &Path) -> HashMap<String, WorkCost> {
    let mut costs = HashMap::new();
    for kind in ["sequences", "cells"] {
        for folder in files::folders_in(&root.join(kind)).unwrap_or_default() {
            let mut of_folder: HashMap<String, WorkCost> = HashMap::new();
            for stage in read(&folder.join("timing.json")).unwrap_or_default() {
                let cost = WorkCost { cpu_s: stage.cpu_s, memory_mib: stage.peak_memory_mib };
                let sum = of_folder.entry(stage.cost_key).or_default();
                *sum = sum.then(cost);
            }
            for (key, cost) in of_folder {
                let largest: &mut WorkCost = costs.entry(key).or_default();
                *largest = largest.or(cost);
            }
        }
    }
    costs.remove("");
    costs
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn work_that_two_machines_shared_is_of_none() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("timing.json");
        let timing = |machine: &str| {
            let (_, timing) = measured("simulate", "a".into(), || Ok(()));
            assert_eq!(timing.machine_id, machine_id());
            StageTiming { wall_s: 1.0, machine_id: machine.into(), ..timing }
        };
        for (machine, wall_s, of) in [("one", 1.0, "one"), ("one", 2.0, "one"), ("other", 3.0, ""), ("other", 4.0, "")]
        {
            add(&path, timing(machine)).unwrap();
            let kept = read(&path).unwrap();
            assert_eq!((kept.len(), kept[0].wall_s, kept[0].machine_id.as_str()), (1, wall_s, of));
        }
    }

    #[test]
    fn costs_are_found_whatever_the_revision_and_the_seed() {
        let root = tempfile::tempdir().unwrap();
        let keep_cost = |folder: &str, stage: &str, cost_key: &str, cpu_s: f64| {
            let timing = StageTiming {
                stage: stage.into(),
                cpu_s,
                peak_memory_mib: 10.0 * cpu_s,
                cost_key: cost_key.into(),
                ..StageTiming::default()
            };
            keep(&root.path().join(folder).join("timing.json"), timing).unwrap();
        };
        keep_cost("cells/case1-ours-s1-0123", "reconstruct", "a", 5.0);
        keep_cost("cells/case1-ours-s1-0123", "score", "a", 2.0);
        keep_cost("cells/case1-ours-s2-4567", "reconstruct", "a", 6.0);
        keep_cost("sequences/case1-89ab", "simulate", "b", 3.0);
        keep_cost("sequences/case1-cdef", "simulate", "", 99.0);
        std::fs::create_dir_all(root.path().join("cells/case1-ours-s3-0000")).unwrap();
        std::fs::write(root.path().join("cells/case1-ours-s3-0000/timing.json"), "{").unwrap();
        let costs = measured_costs(root.path());
        assert_eq!(costs.len(), 2);
        assert_eq!(costs["a"], WorkCost { cpu_s: 7.0, memory_mib: 60.0 });
        assert_eq!(costs["b"], WorkCost { cpu_s: 3.0, memory_mib: 30.0 });
        assert!(measured_costs(&root.path().join("nowhere")).is_empty());
    }
}
