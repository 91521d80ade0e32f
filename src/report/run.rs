//! What a report is made of: cells with their scores, and where images can be read from.

use std::path::PathBuf;
use std::sync::Arc;

use serde::Serialize;

use crate::score::{CellScore, Truth};

/// Everything of one run, in the order in which tables show it.
#[derive(Clone)]
pub struct Run {
    /// `<profile>-<plan hash>`; the same for the same work.
    pub id: String,
    /// Profile name.
    pub profile: String,
    /// Notes on the origin of the cells, a sentence each; none for a single run.
    pub notes: Vec<String>,
    /// Cases in order.
    pub cases: Vec<CaseInfo>,
    /// Methods in order.
    pub methods: Vec<MethodInfo>,
    /// One per case x method x seed, failed ones included.
    pub cells: Vec<CellRecord>,
}

/// One case.
#[derive(Clone)]
pub struct CaseInfo {
    /// Id in tables and folders.
    pub id: String,
    /// One line; empty when unknown.
    pub title: String,
    /// Its sequence, for images; `None` leaves them out.
    pub truth: Option<Arc<dyn Truth>>,
}

impl CaseInfo {
    /// Id and, where it is known, title.
    pub fn heading(&self) -> String {
        if self.title.is_empty() { self.id.clone() } else { format!("{}: {}", self.id, self.title) }
    }
}

/// Whether a method is ranked.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Role {
    /// Ranked.
    Ranked,
    /// A bound from above or below: shown, never ranked.
    Sanity,
}

/// One method.
#[derive(Clone, Debug)]
pub struct MethodInfo {
    /// Id in tables and folders.
    pub id: String,
    /// Name in tables.
    pub title: String,
    /// Whether it is ranked.
    pub role: Role,
    /// How many CT scans it is given, if known.
    pub ct_scans: Option<u8>,
    /// Whether it keeps an explicit mesh, if known.
    pub mesh: Option<bool>,
}

impl MethodInfo {
    /// The paper's four, ours beyond the paper, the two bounds, and for any other id a ranked method of that name.
    pub fn of(id: &str) -> Self {
        let (title, role, ct_scans, mesh) = match id {
            "bridgesplat" => ("BridgeSplat", Role::Ranked, Some(1), Some(true)),
            "bridgesplat-release" => ("BridgeSplat, as released", Role::Ranked, Some(1), Some(true)),
            "bridgesplat-nomesh" => ("BridgeSplat (no mesh)", Role::Ranked, Some(1), Some(false)),
            "ours-nomesh" => ("Ours (no mesh)", Role::Ranked, Some(2), Some(false)),
            "ours" => ("Ours", Role::Ranked, Some(2), Some(true)),
            "ours-gn" => ("Ours (Gauss-Newton)", Role::Ranked, Some(2), Some(true)),
            "ours-plain" => ("Ours, the paper's equations alone", Role::Ranked, Some(2), Some(true)),
            "ours-gn-pose" => ("Ours (Gauss-Newton), rough poses", Role::Ranked, Some(2), Some(true)),
            "static-ct" => ("Static CT", Role::Sanity, Some(1), Some(true)),
            "oracle-phase" => ("Oracle phase", Role::Sanity, Some(2), Some(true)),
            other => (other, Role::Ranked, None, None),
        };
        MethodInfo { id: id.into(), title: title.into(), role, ct_scans, mesh }
    }
}

/// The outcome of one cell.
#[derive(Clone, Debug)]
pub enum Outcome {
    /// It was scored.
    Scored(Box<CellScore>),
    /// It failed, and why.
    Failed(String),
}

/// One cell.
#[derive(Clone, Debug)]
pub struct CellRecord {
    /// Id of the run that made it.
    pub run_id: String,
    /// Case id.
    pub case_id: String,
    /// Method id.
    pub method: String,
    /// Seed of the method.
    pub seed: u64,
    /// Folder of the prediction (images are read from it).
    pub prediction: PathBuf,
    /// Its score, or why there is none.
    pub outcome: Outcome,
    /// What its stages cost.
    pub timings: Vec<StageCost>,
}

/// What one stage of one cell cost.
#[derive(Clone, Debug)]
pub struct StageCost {
    /// `simulate`, `reconstruct`, `score`.
    pub stage: String,
    /// Wall seconds.
    pub wall_s: f64,
    /// CPU seconds of all threads.
    pub cpu_s: f64,
    /// Highest resident memory in MiB.
    pub peak_memory_mib: f64,
    /// Threads it could use.
    pub threads: usize,
    /// Id of the machine; empty when unknown.
    pub machine_id: String,
}

impl CellRecord {
    /// The score, unless the cell failed.
    pub fn score(&self) -> Option<&CellScore> {
        match &self.outcome {
            Outcome::Scored(score) => Some(score),
            Outcome::Failed(_) => None,
        }
    }
}

impl Run {
    /// The method called `id`.
    pub fn method(&self, id: &str) -> Option<&MethodInfo> {
        self.methods.iter().find(|m| m.id == id)
    }

    /// Scored cells of a case in the order of the methods, the first seed of each: what curves and images show.
    pub fn shown(&self, case_id: &str) -> Vec<(&MethodInfo, &CellRecord, &CellScore)> {
        let of = |method: &MethodInfo| {
            let mut cells = self.cells.iter().filter(|c| c.case_id == case_id && c.method == method.id);
            cells.find_map(|c| c.score().map(|s| (c, s)))
        };
        self.methods.iter().filter_map(|m| of(m).map(|(c, s)| (m, c, s))).collect()
    }

    /// One value per case (mean over seeds) of a metric of a method, in the order of the cases; cases without a value
    /// are left out.
    pub fn case_values(&self, method: &str, metric: &str) -> Vec<(&str, f64)> {
        let value = |case: &CaseInfo| {
            let cells = self.cells.iter().filter(|c| c.case_id == case.id && c.method == method);
            let values: Vec<f64> = cells.filter_map(|c| c.score().and_then(|s| s.value(metric))).collect();
            crate::score::statistics::mean(&values)
        };
        self.cases.iter().filter_map(|case| value(case).map(|v| (case.id.as_str(), v))).collect()
    }
}
