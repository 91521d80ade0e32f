//! Reads the tables of a finished run back: the input of `gate` and `compare`.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use super::run::{EVALUATION, MethodInfo, RECONSTRUCT, StatedFacts, note_on_changed};
pub use super::seal::lacking_evidence;
use super::{RESULTS, seal, track_folders};
use crate::base::{Error, Result, files};
use crate::formats::number_table::line_of;
use crate::score::{Metric, Status, registry};
use crate::simulate::track::Track;

/// How far beyond its range a sum of many numbers may be.
const ROUNDING: f64 = 1e-9;
/// No number of a table is larger: squared or drawn on an axis it would be infinite.
pub(super) const LARGEST: f64 = 1e30;

/// Names a number of the tables.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Key {
    /// Case id.
    pub case: String,
    /// Method id.
    pub method: String,
    /// Seed of the method.
    pub seed: u64,
    /// Metric id.
    pub metric: String,
}

/// A number of the tables.
#[derive(Clone, Debug, PartialEq)]
pub struct ResultEntry {
    /// The value; NaN where the file says so.
    pub value: Option<f64>,
    /// The status word.
    pub status: String,
    /// `id/version` of the definition; empty for times.
    pub definition: String,
}

/// What the tables say of a case.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CaseFacts {
    /// Whose airway it is; the case's own id when unknown.
    pub tree: String,
    /// Hashes of the film's files that rows with a score name; an empty one where a row does not tell.
    pub film_contents: BTreeSet<String>,
}

impl CaseFacts {
    /// The film of all rows; none when one of them does not tell or names another.
    pub fn film(&self) -> Option<&str> {
        let mut films = self.film_contents.iter();
        let first = films.next().filter(|film| !film.is_empty())?;
        if films.next().is_none() { Some(first) } else { None }
    }
}

/// In what two runs are not of the same work.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct OtherWork {
    /// The conditions of both, where they differ: they make the numbers those of another task.
    pub conditions: Option<String>,
    /// Rows that are run by the program's settings in one run alone, sorted.
    pub settings: Vec<String>,
}

/// All numbers of a run.
#[derive(Clone, Debug, Default)]
pub struct Results {
    /// Sorted by case, method, seed, metric.
    pub entries: BTreeMap<Key, ResultEntry>,
    /// By case.
    pub facts: BTreeMap<String, CaseFacts>,
    /// What the methods were told.
    pub track: Track,
    /// Profile of the run, of a merged one all (`a + b`); empty where it is not known.
    pub profile: String,
    /// What holds for all that this program ran, a sentence each; its changed rows are told apart.
    pub conditions: Vec<String>,
    /// Own rows with other settings than those that come with the program.
    pub changed: Vec<String>,
    /// Machines on which the methods ran, and the threads that they could use, as far as `timings.csv` says.
    pub machines: BTreeSet<(String, String)>,
}

/// Reads `results.csv` of `folder`, and the times from its `comparison.csv` where there is one.
///
/// Errors name file, line and column, and a table that does not have the hash of the manifest, where there is one.
pub fn read(folder: &Path) -> Result<Results> {
    if let [first, ..] = &track_folders(folder)[..] {
        let sentence = format!("holds a report for each track: name one, for instance {}", first.display());
        return Err(Error::input(sentence).at(folder));
    }
    let mut results = Results::default();
    let path = folder.join(RESULTS);
    for (at, row) in CsvTable::read(&path)?.rows().enumerate() {
        let key = row.key("config", row.text("metric")?)?;
        let track = Track::of_word(&row.text_or_empty("track")).map_err(|e| row.refuse("track", e.to_string()))?;
        if at > 0 && track != results.track {
            return Err(row.refuse("track", "is not that of the rows before".into()));
        }
        results.track = track;
        let facts = results.facts.entry(key.case.clone()).or_default();
        let (tree, content) = (row.text_or_empty("tree"), row.text_or_empty("film_content"));
        facts.tree = if tree.is_empty() { key.case.clone() } else { tree };
        // A cell that failed has no film.
        if row.text("status")? != Status::Failed.word() {
            facts.film_contents.insert(content);
        }
        let entry = ResultEntry {
            value: row.number("value")?,
            status: row.text("status")?,
            definition: row.text("definition")?,
        };
        let is_of_truth = [Status::Identical, Status::Copied].iter().any(|status| entry.status == status.word());
        if is_of_truth && entry.value.is_some() {
            return Err(row.refuse("value", format!("is there, and what is {} has none", entry.status)));
        }
        if results.entries.insert(key.clone(), entry).is_some() {
            return Err(Error::input(format!("{} {} {} is there twice", key.case, key.method, key.metric))
                .element(row.line())
                .at(path));
        }
    }
    let path = folder.join("comparison.csv");
    if path.exists() {
        let cell = |key: &Key| (key.case.clone(), key.method.clone(), key.seed);
        let known: BTreeSet<(String, String, u64)> = results.entries.keys().map(cell).collect();
        for row in CsvTable::read(&path)?.rows() {
            if !known.contains(&cell(&row.key("method", String::new())?)) {
                return Err(row.refuse("method", no_such_row()));
            }
            for m in registry().iter().filter(|m| m.is_runtime()) {
                let value = row.seconds(m.id)?;
                let status = if value.is_some() { Status::Ok } else { Status::NotApplicable };
                let entry = ResultEntry { value, status: status.word().into(), definition: String::new() };
                results.entries.insert(row.key("method", m.id.into())?, entry);
            }
        }
    }
    let path = folder.join("timings.csv");
    if path.exists() {
        for row in CsvTable::read(&path)?.rows() {
            if row.text("stage")? == RECONSTRUCT {
                results.machines.insert((row.text_or_empty("machine_id"), row.text_or_empty("threads")));
            }
        }
    }
    seal::check(folder)?;
    let StatedFacts { profile, mut conditions, changed, .. } = StatedFacts::read(folder)?;
    let on_changed = note_on_changed(&changed.iter().map(String::as_str).collect::<Vec<_>>());
    conditions.retain(|sentence| Some(sentence) != on_changed.as_ref());
    (results.profile, results.conditions, results.changed) = (profile, conditions, changed);
    Ok(results)
}

/// What is said of a row of another table whose cell `results.csv` does not have.
pub(super) fn no_such_row() -> String {
    format!("{RESULTS} has no row of this case, method and seed")
}

/// What is wrong with a value that the metric cannot have; none for a sound one.
pub(super) fn unfit(metric: &Metric, value: f64) -> Option<String> {
    let [low, high] = metric.range;
    let (low, high) = (low.unwrap_or(-LARGEST), high.unwrap_or(LARGEST));
    let is_sound = value.is_finite() && (low - ROUNDING..=high + ROUNDING).contains(&value);
    (!is_sound).then(|| format!("{value} is no value of {}, which lies between {low} and {high}", metric.id))
}

impl Results {
    /// Case ids, sorted.
    pub fn cases(&self) -> Vec<&str> {
        distinct(self.entries.keys().map(|k| k.case.as_str()))
    }

    /// Method ids, sorted.
    pub fn methods(&self) -> Vec<&str> {
        distinct(self.entries.keys().map(|k| k.method.as_str()))
    }

    /// Seeds of the method, in any case.
    pub fn seeds_of(&self, method: &str) -> BTreeSet<u64> {
        self.entries.keys().filter(|key| key.method == method).map(|key| key.seed).collect()
    }

    /// Whether there are rows of the method in the case.
    pub fn has_rows(&self, method: &str, case: &str) -> bool {
        self.entries.keys().any(|key| key.method == method && key.case == case)
    }

    /// Whether both are known to have run on one machine with one number of threads, and both are the same.
    pub fn is_of_the_machine_of(&self, other: &Results) -> bool {
        let is_known = self.machines.iter().all(|(machine, _)| !machine.is_empty());
        is_known && self.machines.len() == 1 && self.machines == other.machines
    }

    /// In what this run is not of the work of `other`. Nothing where either is of an older version or of predictions alone,
    /// which say nothing of it.
    pub fn other_work(&self, other: &Results) -> OtherWork {
        let is_told = |results: &Results| !results.profile.is_empty() && results.profile != EVALUATION;
        if !is_told(self) || !is_told(other) {
            return OtherWork::default();
        }
        let words = |conditions: &[String]| match conditions {
            [] => "none in particular".to_owned(),
            some => some.join(" "),
        };
        let conditions = (self.conditions != other.conditions)
            .then(|| format!("{} There: {}", words(&self.conditions), words(&other.conditions)));
        let has = |results: &Results, id: &String| results.changed.contains(id);
        let one_sided = self.changed.iter().chain(&other.changed).filter(|id| has(self, id) != has(other, id));
        let settings = distinct(one_sided.map(String::as_str)).into_iter().map(str::to_owned).collect();
        OtherWork { conditions, settings }
    }

    /// Refuses results of another track: their numbers are of another task.
    pub fn check_track(&self, other: &Results) -> Result<()> {
        if self.track == other.track {
            return Ok(());
        }
        let (own, other) = (self.track.word(), other.track.word());
        Err(Error::input(format!(
            "one run is of the track `{own}` and the other of `{other}`: they are not comparable"
        )))
    }

    /// Whether both tell the film of a case, and it is not the same.
    pub fn has_other_film(&self, other: &Results, case: &str) -> bool {
        let film = |facts: &CaseFacts| facts.film().map(str::to_owned);
        let films = [self, other].map(|results| results.facts.get(case).and_then(film));
        matches!(films, [Some(own), Some(known)] if own != known)
    }

    /// Cases that both have and that were filmed otherwise there, as far as all rows tell.
    pub fn other_films(&self, other: &Results) -> Vec<&str> {
        self.facts.keys().map(String::as_str).filter(|case| self.has_other_film(other, case)).collect()
    }

    /// Whether both are of one track and have cases in common, all of which are known to be the same films; a case of this
    /// one that has no film, since all in it failed, is passed over.
    pub fn is_of_films_of(&self, other: &Results) -> bool {
        let film = |results: &Results, case: &String| {
            results.facts.get(case).and_then(|facts| facts.film().map(str::to_owned))
        };
        let is_filmed = |case: &&String| self.facts.get(*case).is_some_and(|facts| !facts.film_contents.is_empty());
        let is_common = |case: &&String| other.facts.contains_key(*case) && is_filmed(case);
        let mut common = self.facts.keys().filter(is_common).peekable();
        let is_same = |case: &String| film(self, case).is_some_and(|own| Some(own) == film(other, case));
        self.track == other.track && common.peek().is_some() && common.all(is_same)
    }

    /// The tree of a case.
    pub fn tree_of<'a>(&'a self, case: &'a str) -> &'a str {
        self.facts.get(case).map_or(case, |facts| facts.tree.as_str())
    }

    /// The number with which a row counts in a mean: a surface that cannot be measured counts with the worst value that any
    /// row of this program has in its case, as in the tables (`CountedRun::counted`).
    fn counted(&self, key: &Key, entry: &ResultEntry) -> Option<f64> {
        if entry.value.is_some() || !Status::of_word(&entry.status).is_some_and(Status::counts_as_worst) {
            return entry.value.filter(|v| v.is_finite());
        }
        let goal = crate::score::metric(&key.metric)?.direction;
        let others = || self.entries.iter().filter(|(k, _)| k.case == key.case && k.metric == key.metric);
        let worst = |a: f64, b: f64| if goal.better(a, b) { b } else { a };
        let value = |(_, entry): (&Key, &ResultEntry)| entry.value.filter(|v| v.is_finite());
        let own = others().filter(|(k, _)| MethodInfo::is_own(&k.method)).filter_map(value).reduce(worst);
        own.or_else(|| others().filter_map(value).reduce(worst))
    }

    /// Cases in which the method has a row of the metric without a number, and does not equal the truth.
    pub fn cases_without(&self, method: &str, metric: &str) -> Vec<&str> {
        let is_without = |(key, entry): &(&Key, &ResultEntry)| {
            let is_asked = key.method == method && key.metric == metric;
            is_asked && entry.status != Status::Identical.word() && self.counted(key, entry).is_none()
        };
        distinct(self.entries.iter().filter(is_without).map(|(k, _)| k.case.as_str()))
    }

    /// Value of each case (mean over seeds) of a metric of a method; cases in which a seed has no value are left out.
    pub fn case_values(&self, method: &str, metric: &str) -> Vec<(&str, f64)> {
        let mut by_case: BTreeMap<&str, Vec<Option<f64>>> = BTreeMap::new();
        for (key, entry) in self.entries.iter().filter(|(k, _)| k.method == method && k.metric == metric) {
            by_case.entry(&key.case).or_default().push(self.counted(key, entry));
        }
        by_case
            .into_iter()
            .filter_map(|(case, values)| {
                let values: Option<Vec<f64>> = values.into_iter().collect();
                crate::score::statistics::mean(&values?).map(|mean| (case, mean))
            })
            .collect()
    }
}

/// Sorted, each once.
pub(super) fn distinct<'a>(words: impl Iterator<Item = &'a str>) -> Vec<&'a str> {
    let mut words: Vec<&str> = words.collect();
    words.sort_unstable();
    words.dedup();
    words
}

pub(super) struct CsvTable {
    path: std::path::PathBuf,
    columns: BTreeMap<String, usize>,
    records: Vec<csv::StringRecord>,
    /// The line in which each begins.
    lines: Vec<u64>,
}

pub(super) struct CsvRow<'a> {
    table: &'a CsvTable,
    index: usize,
}

impl CsvTable {
    pub(super) fn read(path: &Path) -> Result<CsvTable> {
        let bytes = files::read_bytes(path)?;
        let mut reader = csv::Reader::from_reader(bytes.as_slice());
        let bad = |e: csv::Error| Error::input(e.to_string().replace('\n', " ")).at(path);
        let mut columns = BTreeMap::new();
        for (place, name) in reader.headers().map_err(bad)?.iter().enumerate() {
            if columns.insert(name.to_owned(), place).is_some() {
                return Err(Error::input("is there twice").element(format!("column {name}")).at(path));
            }
        }
        let records: Vec<csv::StringRecord> = reader.records().collect::<std::result::Result<_, _>>().map_err(bad)?;
        let lines = records.iter().map(|record| line_of(&bytes, record.position())).collect();
        Ok(CsvTable { path: path.to_path_buf(), columns, records, lines })
    }

    pub(super) fn rows(&self) -> impl Iterator<Item = CsvRow<'_>> {
        (0..self.records.len()).map(|index| CsvRow { table: self, index })
    }
}

impl CsvRow<'_> {
    fn line(&self) -> String {
        format!("line {}", self.table.lines[self.index])
    }

    pub(super) fn text(&self, column: &str) -> Result<String> {
        let place = self
            .table
            .columns
            .get(column)
            .ok_or_else(|| Error::input("is missing").element(format!("column {column}")).at(&self.table.path))?;
        Ok(self.table.records[self.index].get(*place).unwrap_or("").to_owned())
    }

    /// The text of a column that older tables lack; empty there.
    pub(super) fn text_or_empty(&self, column: &str) -> String {
        let place = self.table.columns.get(column);
        place.and_then(|place| self.table.records[self.index].get(*place)).unwrap_or("").to_owned()
    }

    pub(super) fn number(&self, column: &str) -> Result<Option<f64>> {
        let text = self.text(column)?;
        if text.is_empty() {
            return Ok(None);
        }
        text.parse().map(Some).map_err(|_| self.refuse(column, format!("\"{text}\" is not a number")))
    }

    /// Seconds in a column that older tables may lack; none for 0, which no work takes.
    pub(super) fn seconds(&self, column: &str) -> Result<Option<f64>> {
        if !self.table.columns.contains_key(column) {
            return Ok(None);
        }
        Ok(self.number(column)?.filter(|&seconds| seconds != 0.0))
    }

    /// An error that names this row and the column.
    pub(super) fn refuse(&self, column: &str, why: String) -> Error {
        Error::input(why).element(format!("{}, column {column}", self.line())).at(&self.table.path)
    }

    pub(super) fn key(&self, method_column: &str, metric: String) -> Result<Key> {
        let seed = self.text("seed")?;
        let seed = seed
            .parse()
            .map_err(|_| Error::input(format!("\"{seed}\" is not a seed")).element(self.line()).at(&self.table.path))?;
        Ok(Key { case: self.text("case_id")?, method: self.text(method_column)?, seed, metric })
    }
}
