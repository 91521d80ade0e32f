//! What a report is made of: cells with their scores, and where images can be read from.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::scene::{RowKey, Scenes};
pub use crate::base::own_row::Role;
use crate::base::{Result, files, method_name, own_row};
use crate::score::{CellScore, Truth};
use crate::simulate::track::Track;

/// Name of what says of what the tables of a report are.
pub const RUN_FACTS: &str = "run.json";

/// Everything of one run, in the order in which tables show it.
#[derive(Clone)]
pub struct Run {
    /// `<profile>-<plan hash>`; the same for the same work.
    pub id: String,
    /// Profile name.
    pub profile: String,
    /// What the methods were told.
    pub track: Track,
    /// What holds for all that this program ran, a sentence each: that it was less than a method's whole work.
    pub conditions: Vec<String>,
    /// Notes on the origin of the cells, a sentence each; none for a single run.
    pub notes: Vec<String>,
    /// Cases in order.
    pub cases: Vec<CaseInfo>,
    /// Methods in order.
    pub methods: Vec<MethodInfo>,
    /// One per case x method x seed, failed ones included.
    pub cells: Vec<CellRecord>,
    /// What is shown of cases whose film is not at hand: kept by the runs that were merged.
    pub scenes: Scenes,
    /// The folders of these runs' reports, which may have whole films; what a later one has is shown.
    pub read_from: Vec<PathBuf>,
}

/// What the tables of a run are of.
#[derive(Debug, Serialize)]
pub struct RunFacts<'a> {
    id: &'a str,
    profile: &'a str,
    track: &'a str,
    cases: Vec<CaseInRun<'a>>,
    methods: Vec<&'a str>,
    /// Own rows with other settings than those that come with the program.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    changed: Vec<&'a str>,
    seeds: Vec<u64>,
    conditions: &'a [String],
    notes: &'a [String],
}

/// A case, what it is, and whose airway.
#[derive(Debug, Serialize)]
struct CaseInRun<'a> {
    id: &'a str,
    title: &'a str,
    tree: &'a str,
}

/// What `run.json` says that no table does; nothing where it is of an older version.
#[derive(Debug, Default, Deserialize)]
pub struct StatedFacts {
    /// As in [`Run`]; empty where it is not known.
    #[serde(default)]
    pub profile: String,
    /// As in [`Run`].
    #[serde(default)]
    pub conditions: Vec<String>,
    /// Cases with their titles.
    #[serde(default)]
    pub cases: Vec<StatedCase>,
    /// Own rows with other settings than those that come with the program.
    #[serde(default)]
    pub changed: Vec<String>,
}

/// What is said of rows that were run by other method files than the program's.
pub fn note_on_changed(ids: &[&str]) -> Option<String> {
    let ids: Vec<String> = ids.iter().map(|id| format!("`{id}`")).collect();
    let sentence = format!("Run by method files that differ from those of this program: {}.", ids.join(", "));
    (!ids.is_empty()).then_some(sentence)
}

impl StatedFacts {
    /// Those of the report in `folder`.
    pub fn read(folder: &Path) -> Result<StatedFacts> {
        let path = folder.join(RUN_FACTS);
        if path.exists() { files::read_json(&path) } else { Ok(StatedFacts::default()) }
    }
}

/// A case of [`StatedFacts`].
#[derive(Debug, Deserialize)]
pub struct StatedCase {
    /// Id in tables and folders.
    pub id: String,
    /// One line; empty when unknown.
    #[serde(default)]
    pub title: String,
}

/// One case.
#[derive(Clone)]
pub struct CaseInfo {
    /// Id in tables and folders.
    pub id: String,
    /// One line; empty when unknown.
    pub title: String,
    /// Whose airway it is; empty when unknown.
    pub tree: String,
    /// Its sequence, for images; `None` leaves them out.
    pub truth: Option<Arc<dyn Truth>>,
}

impl CaseInfo {
    /// Id and, where it is known, title.
    pub fn heading(&self) -> String {
        if self.title.is_empty() || self.title == self.id {
            self.id.clone()
        } else {
            format!("{}: {}", self.id, self.title)
        }
    }

    fn facts(&self) -> CaseInRun<'_> {
        CaseInRun { id: &self.id, title: &self.title, tree: self.tree() }
    }

    /// Whose airway it is; an unknown one is nobody else's.
    pub fn tree(&self) -> &str {
        if self.tree.is_empty() { &self.id } else { &self.tree }
    }
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
    /// Whether it is an own row with other settings than those that come with the program.
    pub is_changed: bool,
}

impl MethodInfo {
    /// One of this program's own rows, and for any other id a ranked method of that name.
    pub fn of(id: &str) -> Self {
        match own_row::own(id) {
            Some(row) => MethodInfo {
                id: row.id.into(),
                title: row.title.into(),
                role: row.role,
                ct_scans: Some(row.sees.ct_scans),
                mesh: Some(row.keeps_mesh),
                is_changed: false,
            },
            None => MethodInfo {
                id: id.into(),
                title: id.into(),
                role: Role::Ranked,
                ct_scans: None,
                mesh: None,
                is_changed: false,
            },
        }
    }

    /// The same with other settings than those that come with the program, which its title says.
    pub fn changed(self) -> Self {
        if self.is_changed {
            return self;
        }
        MethodInfo { title: method_name::title_of_changed(&self.title), is_changed: true, ..self }
    }

    /// Whether `id` is one of this program's own rows.
    pub fn is_own(id: &str) -> bool {
        own_row::own(id).is_some()
    }
}

/// How the id of a run begins whose one cell was scored by `evaluate`.
const EVALUATED: &str = "evaluate-";

/// The stage in which a method works.
pub const RECONSTRUCT: &str = "reconstruct";

/// Profile of predictions that `evaluate` scored.
pub const EVALUATION: &str = "evaluate";
/// What stands between the profiles of a merged run.
pub const PROFILES_BETWEEN: &str = " + ";

/// The id of the run of a prediction that `evaluate` scored.
pub fn evaluated_id(case_id: &str, method: &str) -> String {
    format!("{EVALUATED}{case_id}-{method}")
}

/// Whether a run of this id is of `evaluate`.
pub fn is_evaluated_id(run_id: &str) -> bool {
    run_id.starts_with(EVALUATED)
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
    /// What tells it apart from the other cells of a run.
    pub fn row_key(&self) -> RowKey<'_> {
        (&self.case_id, &self.method, self.seed)
    }

    /// Whether `evaluate` scored it, as it says itself.
    pub fn is_evaluated(&self) -> bool {
        is_evaluated_id(&self.run_id)
    }

    /// Whether it is not one of this program's own rows. An id that is reserved for those is none of `evaluate`, and
    /// `merge` takes it only from a report whose frames bear its numbers out.
    pub fn is_foreign(&self) -> bool {
        self.is_evaluated() || !MethodInfo::is_own(&self.method)
    }

    /// The machine on which the method ran, and the threads that it could use; none where nobody measured it.
    pub fn machine(&self) -> Option<(&str, usize)> {
        let cost = self.timings.iter().find(|cost| cost.stage == RECONSTRUCT)?;
        Some((cost.machine_id.as_str(), cost.threads)).filter(|(id, _)| !id.is_empty())
    }

    /// The score, unless the cell failed.
    pub fn score(&self) -> Option<&CellScore> {
        match &self.outcome {
            Outcome::Scored(score) => Some(score),
            Outcome::Failed(_) => None,
        }
    }
}

impl Run {
    /// A run of `cells` whose cases and methods are in the order in which they come; `trees`: whose airway a case is, by
    /// its id. Name, profile and notes are the caller's to fill in.
    pub fn of_cells(mut cells: Vec<CellRecord>, trees: &BTreeMap<String, String>) -> Run {
        let mut cases: Vec<CaseInfo> = Vec::new();
        let mut methods: Vec<MethodInfo> = Vec::new();
        for cell in &cells {
            if cases.iter().all(|c| c.id != cell.case_id) {
                let tree = trees.get(&cell.case_id).cloned().unwrap_or_default();
                cases.push(CaseInfo { id: cell.case_id.clone(), title: String::new(), tree, truth: None });
            }
            if methods.iter().all(|m| m.id != cell.method) {
                methods.push(MethodInfo::of(&cell.method));
            }
        }
        let place = |c: &CellRecord| {
            let case = cases.iter().position(|case| case.id == c.case_id);
            (case, methods.iter().position(|m| m.id == c.method), c.seed)
        };
        cells.sort_by_cached_key(place);
        Run {
            id: String::new(),
            profile: String::new(),
            track: Track::default(),
            conditions: Vec::new(),
            notes: Vec::new(),
            cases,
            methods,
            cells,
            scenes: Scenes::default(),
            read_from: Vec::new(),
        }
    }

    /// Marks the own rows that had other settings than those that come with the program.
    pub fn mark_changed<'b>(&mut self, ids: impl Iterator<Item = &'b str>) {
        for id in ids {
            for method in self.methods.iter_mut().filter(|method| method.id == id) {
                *method = method.clone().changed();
            }
        }
    }

    /// Ids of the own rows that had other settings than those that come with the program.
    pub fn changed(&self) -> impl Iterator<Item = &str> {
        self.methods.iter().filter(|method| method.is_changed).map(|method| method.id.as_str())
    }

    /// Scored cells of a case in the order of the methods, the first seed of each: what curves and images show.
    pub fn shown(&self, case_id: &str) -> Vec<(&MethodInfo, &CellRecord, &CellScore)> {
        let of = |method: &MethodInfo| {
            let mut cells = self.cells.iter().filter(|c| c.case_id == case_id && c.method == method.id);
            cells.find_map(|c| c.score().map(|s| (c, s)))
        };
        self.methods.iter().filter_map(|m| of(m).map(|(c, s)| (m, c, s))).collect()
    }

    /// What the tables are of, as `run.json` says it.
    pub fn facts(&self) -> RunFacts<'_> {
        let mut seeds: Vec<u64> = self.cells.iter().map(|cell| cell.seed).collect();
        seeds.sort_unstable();
        seeds.dedup();
        RunFacts {
            id: &self.id,
            profile: &self.profile,
            track: self.track.word(),
            cases: self.cases.iter().map(CaseInfo::facts).collect(),
            methods: self.methods.iter().map(|method| method.id.as_str()).collect(),
            changed: self.changed().collect(),
            seeds,
            conditions: &self.conditions,
            notes: &self.notes,
        }
    }
}
