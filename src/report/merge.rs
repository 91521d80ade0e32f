//! Merges runs that were made separately: cells from several machines, renewed rows, a third party's predictions beside
//! the methods. Each is read back from its report folder; a cell that several runs have is taken from the last.
//!
//! Nothing is recomputed: values, intervals and times are those of the tables. Contours, airways and reduced films are
//! those that the runs kept (`scenes.json`); panels, which need whole films and predictions, are left out.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::gate::redefinition;
use super::read::{CsvRow, CsvTable, distinct, unfit};
use super::run::{CaseInfo, CellRecord, MethodInfo, Outcome, Role, Run, StageCost};
use super::scene::{FilmKey, Scenes};
use super::seal;
use crate::base::{Error, Result, files, hash, method_name};
use crate::score::{CellScore, FrameScore, FrameValue, Metric, MetricScore, Status, check_means, metric, registry};
use crate::simulate::track::Track;

/// Whether a table may hold scores of different films of one case.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Films {
    /// No: two runs that filmed a case differently are refused.
    Same,
    /// Yes, and the report says which cells they are.
    Other,
}

/// Whether rows may lack what they are checked with: the report's manifest, and the frames from which its means follow.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PartEvidence {
    /// No: such a report is refused.
    Needed,
    /// Yes, and the report says which rows were not checked. What is there must still agree.
    Waived,
}

/// A report to merge.
#[derive(Clone)]
pub struct Part {
    /// Its folder, by which notes name it.
    pub folder: PathBuf,
    /// What its tables hold.
    pub run: Run,
}

/// The machines that the report in `folder`, of the run `id`, was made on, by the id of the run: its own
/// (`environment.json`), and those of runs that it was merged from (`environments.json`). None where it has neither.
///
/// Errors name the file that is no JSON of that form.
pub fn read_environments(folder: &Path, id: &str) -> Result<BTreeMap<String, serde_json::Value>> {
    let mut environments = BTreeMap::new();
    let path = folder.join("environment.json");
    if path.exists() {
        environments.insert(id.to_owned(), files::read_json(&path)?);
    }
    let path = folder.join("environments.json");
    if path.exists() {
        environments.extend(files::read_json::<BTreeMap<String, serde_json::Value>>(&path)?);
    }
    Ok(environments)
}

/// Reads the tables of a finished run back (`results.csv`, `comparison.csv`, `frames.csv`, `timings.csv`).
///
/// Errors name file, line and column: a metric or status that this version does not know, or a definition of a metric that
/// is not this version's; a value that the metric cannot have; a number that does not follow from the frames; a table
/// that was changed since it was written; a foreign row under the name of an own one. A report without frames, manifest or
/// other tables is refused unless that is waived; then metrics of another definition are left out.
pub fn read_run(folder: &Path, evidence: PartEvidence) -> Result<Run> {
    let mut cells: Vec<CellRecord> = Vec::new();
    let results = folder.join("results.csv");
    let (mut trees, mut tracks) = (BTreeMap::new(), Vec::new());
    let mut redefined: Vec<String> = Vec::new();
    for row in CsvTable::read(&results)?.rows() {
        trees.insert(plain(row.text("case_id")?), plain(row.text_or_empty("tree")));
        let track = Track::of_word(&row.text_or_empty("track")).map_err(|e| row.refuse("track", e.to_string()))?;
        if !tracks.contains(&track) {
            tracks.push(track);
        }
        let cell = cell_of(&mut cells, &row, "config")?;
        cell.run_id = plain(row.text("run_id")?);
        let status = status_of(&row)?;
        if status == Status::Failed {
            cell.outcome = Outcome::Failed(plain(row.text("detail")?));
            continue;
        }
        let Outcome::Scored(score) = &mut cell.outcome else {
            return Err(row.refuse("status", "the cell has failed in a row before and has a value here".into()));
        };
        let (hash, content) = (row.text("case_hash")?, row.text_or_empty("film_content"));
        if !score.metrics.is_empty() && (&hash, &content) != (&score.case_hash, &score.film_content) {
            return Err(row.refuse("film_content", "is of another film than the rows before of this cell".into()));
        }
        (score.case_hash, score.film_content) = (hash, content);
        let metric = metric_of(&row)?;
        if score.metric(metric.id).is_some() {
            return Err(row.refuse("metric", format!("\"{}\" of this cell is there twice", metric.id)));
        }
        let (known, definition) = (metric.definition_id(), row.text("definition")?);
        if definition != known {
            if evidence == PartEvidence::Needed {
                return Err(row.refuse("definition", redefinition(&definition, &known)));
            }
            if !redefined.contains(&definition) {
                redefined.push(definition);
            }
            continue;
        }
        let (low, high) = (row.number("ci_low")?, row.number("ci_high")?);
        let value = row.number("value")?;
        fits(&row, "value", metric, value)?;
        score.metrics.push(MetricScore {
            metric: metric.id.to_owned(),
            value,
            status,
            deviation: row.number("sd")?,
            count: row.number("n")?.unwrap_or(0.0) as usize,
            interval: low.zip(high).map(|(low, high)| [low, high]),
            detail: plain(row.text("detail")?),
        });
    }
    let &[track] = &tracks[..] else {
        let what = if tracks.is_empty() { "has no rows" } else { "has rows of two tracks" };
        return Err(Error::input(what).at(results));
    };
    let Some(first) = cells.first() else { return Err(Error::input("has no rows").at(results)) };
    let (id, is_evaluated) = (first.run_id.clone(), first.is_evaluated());
    for row in CsvTable::read(&folder.join("comparison.csv"))?.rows() {
        let cell = cell_of(&mut cells, &row, "method")?;
        if let Outcome::Scored(score) = &mut cell.outcome {
            add_times(score, &row)?;
        }
    }
    for cell in cells.iter().filter(|cell| cell.is_foreign()) {
        let named = |e: Error| e.element(format!("row {} of {}", cell.method, cell.case_id)).at(&results);
        method_name::check_foreign(&cell.method).map_err(named)?;
    }
    let frames = folder.join("frames.csv");
    if frames.exists() {
        CsvTable::read(&frames)?.rows().try_for_each(|row| add_frame(&mut cells, &row))?;
        let has_frames = |score: &&CellScore| evidence == PartEvidence::Needed || !score.frame_scores.is_empty();
        let scores = || cells.iter().filter_map(CellRecord::score).filter(has_frames);
        scores().try_for_each(check_means).map_err(|e| e.at(&results))?;
        if let Some(score) = scores().find(|score| score.frame_scores.is_empty()) {
            let sentence =
                format!("has no frames of {} in {}, from which its numbers follow", score.method, score.case_id);
            return Err(Error::input(sentence).at(frames));
        }
    }
    let timings = folder.join("timings.csv");
    if timings.exists() {
        CsvTable::read(&timings)?.rows().try_for_each(|row| add_timing(&mut cells, &row))?;
    }
    let missing = seal::check(folder)?;
    let notes = notes_of(folder, &cells, &missing, &redefined);
    if let Some(name) = missing.first().filter(|_| evidence == PartEvidence::Needed) {
        let sentence =
            "is missing, so that the rows of this report cannot be checked; --unchecked merges it and says so";
        return Err(Error::input(sentence).at(folder.join(name)));
    }
    let scenes = Scenes::read(folder)?;
    for cell in &mut cells {
        if let Outcome::Scored(score) = &mut cell.outcome {
            score.overlay = scenes.row(score).and_then(|row| row.contours.clone());
        }
    }
    // `<profile>-<hash of the plan>`, or `evaluate-<case>-<method>`.
    let cut = if is_evaluated { id.split_once('-') } else { id.rsplit_once('-') };
    let profile = cut.map_or(id.as_str(), |(profile, _)| profile).to_owned();
    Ok(Run { id, profile, track, scenes, notes, ..gathered(cells, &trees) })
}

/// What a report must say of a part that is less than a whole report of this version.
fn notes_of(folder: &Path, cells: &[CellRecord], missing: &[&str], redefined: &[String]) -> Vec<String> {
    let is_bare = |cell: &&CellRecord| cell.score().is_some_and(|score| score.frame_scores.is_empty());
    let unchecked =
        distinct(cells.iter().filter(|cell| !missing.is_empty() || is_bare(cell)).map(|c| c.method.as_str()));
    let mut notes = Vec::new();
    if !unchecked.is_empty() {
        let what = if missing.is_empty() { "their frames".to_owned() } else { missing.join(", ") };
        let (place, rows) = (folder.display(), unchecked.join(", "));
        notes.push(format!("Rows of {place} were not checked, for want of {what}: {rows}."));
    }
    if !redefined.is_empty() {
        let which = redefined.join(", ");
        notes.push(format!("Left out of {}, since they are defined otherwise now: {which}.", folder.display()));
    }
    notes
}

/// Merges `parts`; a cell that several have is taken from the last, and the report says so.
///
/// Errors: a method with rows of this program's runs and of predictions that `evaluate` scored; two different
/// predictions of one name; with [`Films::Same`], two parts that scored different films of one case.
pub fn merge(parts: Vec<Part>, films: Films) -> Result<Run> {
    // A part may itself be a merged run.
    let mut ids: Vec<String> = Vec::new();
    for id in parts.iter().flat_map(|part| &part.run.cells).map(|cell| &cell.run_id) {
        if !ids.contains(id) {
            ids.push(id.clone());
        }
    }
    let track = parts.first().map(|part| part.run.track).unwrap_or_default();
    if let Some(other) = parts.iter().find(|part| part.run.track != track) {
        let (a, b) = (track.word(), other.run.track.word());
        return Err(Error::input(format!("a table holds one track, and these are of {a} and of {b}")));
    }
    let mut trees: BTreeMap<String, String> = BTreeMap::new();
    for case in parts.iter().flat_map(|part| &part.run.cases).filter(|case| !case.tree.is_empty()) {
        // A third party's scores do not know the tree, and are written with the case as its own.
        let known = trees.entry(case.id.clone()).or_default();
        if known.is_empty() || *known == case.id {
            *known = case.tree.clone();
        }
    }
    let mut profiles: Vec<String> = Vec::new();
    let mut cells: Vec<CellRecord> = Vec::new();
    let mut scenes = Scenes::default();
    let mut notes = vec![format!("Put together from {}.", ids.join(", "))];
    for Part { folder, run } in parts {
        notes.extend(run.notes);
        let mut replaced: BTreeMap<String, Vec<String>> = BTreeMap::new();
        // A cell that is renewed takes its pictures along, even where the new run kept none.
        scenes.rows.retain(|row| {
            let is_of = |c: &CellRecord| (&c.case_id, &c.method, c.seed) == (&row.film.case_id, &row.method, row.seed);
            !run.cells.iter().any(is_of)
        });
        scenes.add(run.scenes);
        if !profiles.contains(&run.profile) {
            profiles.push(run.profile);
        }
        for cell in run.cells {
            refuse_other_origin(&cells, &cell)?;
            match cells.iter_mut().find(|c| is_same(c, &cell)) {
                Some(before) => {
                    if !has_same_numbers(before, &cell) {
                        replaced.entry(cell.method.clone()).or_default().push(cell.case_id.clone());
                    }
                    *before = cell;
                }
                None => cells.push(cell),
            }
        }
        for (method, cases) in replaced {
            let cases = distinct(cases.iter().map(String::as_str)).join(", ");
            notes.push(format!("`{method}` of {cases} is that of {}, in place of an earlier one.", folder.display()));
        }
    }
    let id = format!("merged-{}", &hash::of_value(&ids)?[..8]);
    // A film that a part kept is shown with the rows that were scored on it, and with no others.
    scenes.rows.retain(|row| {
        let is_of = |score: &CellScore| FilmKey::of(score) == row.film && score.seed == row.seed;
        cells.iter().any(|cell| cell.method == row.method && cell.score().is_some_and(is_of))
    });
    let mut run = Run { id, profile: profiles.join(" + "), track, scenes, notes, ..gathered(cells, &trees) };
    run.notes.extend(notes_on_places(&run));
    for case in &run.cases {
        let of_film = films_of(&run.cells, &case.id);
        if of_film.len() < 2 {
            continue;
        }
        let named: Vec<String> = of_film.iter().map(FilmRows::words).collect();
        let sentence = format!("{} was filmed more than once: {}", case.id, named.join("; "));
        if films == Films::Same {
            return Err(Error::input(format!("{sentence}; --other-films merges them and says so")));
        }
        run.notes.push(sentence + ".");
    }
    Ok(run)
}

/// Which cases and times of a merged run count in no place.
fn notes_on_places(run: &Run) -> Vec<String> {
    let counted = run.ranking_cases();
    let others: Vec<&str> =
        run.cases.iter().map(|c| c.id.as_str()).filter(|id| counted.iter().all(|c| c.id != *id)).collect();
    let has_time = |method: &MethodInfo| !run.case_values(&method.id, "time_total_s").is_empty();
    let stated: Vec<&str> = run
        .methods
        .iter()
        .filter(|m| m.role == Role::Ranked && has_time(m) && !run.is_timed(&m.id))
        .map(|m| m.id.as_str())
        .collect();
    let mut notes = Vec::new();
    if !others.is_empty() {
        let others = others.join(", ");
        notes.push(format!("Listed, but of no row of this program, so that they count in no mean or place: {others}."));
    }
    if !stated.is_empty() {
        let stated = stated.join(", ");
        notes
            .push(format!("Times as stated, not measured beside the others, and therefore without a place: {stated}."));
    }
    notes
}

/// A run of `cells` whose cases and methods are in the order in which they come.
fn gathered(mut cells: Vec<CellRecord>, trees: &BTreeMap<String, String>) -> Run {
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
    cells.sort_by_key(place);
    Run {
        id: String::new(),
        profile: String::new(),
        track: Track::default(),
        notes: Vec::new(),
        cases,
        methods,
        cells,
        scenes: Scenes::default(),
    }
}

/// Rows of different origin are never one row: neither a run's and a third party's, nor two predictions of one name.
fn refuse_other_origin(cells: &[CellRecord], new: &CellRecord) -> Result<()> {
    let rename = "score the prediction again with `evaluate --method NAME`";
    if let Some(other) = cells.iter().find(|c| c.method == new.method && c.is_evaluated() != new.is_evaluated()) {
        return Err(Error::input(format!(
            "`{}` is a method of {} and a prediction in {}: one row cannot be both; {rename}",
            new.method,
            if new.is_evaluated() { &other.run_id } else { &new.run_id },
            if new.is_evaluated() { &new.run_id } else { &other.run_id },
        )));
    }
    let is_other = |c: &&CellRecord| c.is_foreign() && is_same(c, new) && !has_same_numbers(c, new);
    match cells.iter().find(is_other) {
        Some(_) => Err(Error::input(format!(
            "`{}` has two different predictions of {}: leave one out, or {rename}",
            new.method, new.case_id
        ))),
        None => Ok(()),
    }
}

fn has_same_numbers(a: &CellRecord, b: &CellRecord) -> bool {
    let numbers = |cell: &CellRecord| cell.score().map(|s| (s.case_hash.clone(), s.metrics.clone()));
    numbers(a) == numbers(b)
}

/// A film of a case and the methods that were scored on it.
struct FilmRows {
    /// What the film was made from.
    case_hash: String,
    /// What it held; empty where no row tells.
    content: String,
    methods: Vec<String>,
}

impl FilmRows {
    fn is_of(&self, score: &CellScore) -> bool {
        let (known, told) = (&self.content, &score.film_content);
        self.case_hash == score.case_hash && (known == told || known.is_empty() || told.is_empty())
    }

    fn words(&self) -> String {
        let short = |hash: &str| hash.chars().take(12).collect::<String>();
        let content = if self.content.is_empty() { String::new() } else { format!("{} of ", short(&self.content)) };
        format!("{content}{} ({})", short(&self.case_hash), self.methods.join(", "))
    }
}

/// The films of a case, sorted.
fn films_of(cells: &[CellRecord], case_id: &str) -> Vec<FilmRows> {
    let of_case = || cells.iter().filter(|c| c.case_id == case_id).filter_map(|c| Some((c, c.score()?)));
    let mut films: Vec<FilmRows> = Vec::new();
    // Rows that tell what the film held come first: the others join them.
    for tells in [true, false] {
        for (cell, score) in of_case().filter(|(_, score)| score.film_content.is_empty() != tells) {
            let at = films.iter().position(|film| film.is_of(score)).unwrap_or_else(|| {
                let (case_hash, content) = (score.case_hash.clone(), score.film_content.clone());
                films.push(FilmRows { case_hash, content, methods: Vec::new() });
                films.len() - 1
            });
            if !films[at].methods.contains(&cell.method) {
                films[at].methods.push(cell.method.clone());
            }
        }
    }
    films.sort_by(|a, b| (&a.case_hash, &a.content).cmp(&(&b.case_hash, &b.content)));
    films
}

fn is_same(a: &CellRecord, b: &CellRecord) -> bool {
    (&a.case_id, &a.method, a.seed) == (&b.case_id, &b.method, b.seed)
}

/// The cell of a row, made where it is new.
fn cell_of<'a>(cells: &'a mut Vec<CellRecord>, row: &CsvRow<'_>, method_column: &str) -> Result<&'a mut CellRecord> {
    let key = row.key(method_column, String::new())?;
    let (case_id, method) = (plain(key.case), plain(key.method));
    let at = cells.iter().position(|c| c.case_id == case_id && c.method == method && c.seed == key.seed);
    let at = at.unwrap_or_else(|| {
        cells.push(CellRecord {
            run_id: String::new(),
            outcome: Outcome::Scored(Box::new(CellScore {
                case_id: case_id.clone(),
                case_hash: String::new(),
                film_content: String::new(),
                method: method.clone(),
                seed: key.seed,
                frames: 0,
                metrics: Vec::new(),
                frame_scores: Vec::new(),
                overlay: None,
            })),
            case_id,
            method,
            seed: key.seed,
            prediction: Default::default(),
            timings: Vec::new(),
        });
        cells.len() - 1
    });
    Ok(&mut cells[at])
}

/// Times and the number of frames stand in `comparison.csv` alone.
fn add_times(score: &mut CellScore, row: &CsvRow<'_>) -> Result<()> {
    score.frames = row.number("frames")?.unwrap_or(0.0) as usize;
    for m in registry().iter().filter(|m| m.is_runtime()) {
        let value = row.seconds(m.id)?;
        fits(row, m.id, m, value)?;
        let status = if value.is_some() { Status::Ok } else { Status::NotApplicable };
        let (metric, detail) = (m.id.to_owned(), String::new());
        score.metrics.push(MetricScore { metric, value, status, deviation: None, count: 0, interval: None, detail });
    }
    let place = |m: &MetricScore| registry().iter().position(|r| r.id == m.metric);
    score.metrics.sort_by_key(place);
    Ok(())
}

fn add_frame(cells: &mut Vec<CellRecord>, row: &CsvRow<'_>) -> Result<()> {
    let Outcome::Scored(score) = &mut cell_of(cells, row, "config")?.outcome else { return Ok(()) };
    let number = |column: &str| row.number(column).map(|v| v.unwrap_or(f64::NAN));
    let (frame, time_s, phase) = (number("frame")? as usize, number("time_s")?, number("phase")?);
    if score.frame_scores.last().is_none_or(|last| last.frame != frame) {
        score.frame_scores.push(FrameScore { frame, time_s, phase, phase_predicted: None, values: Vec::new() });
    }
    let value = row.number("value")?;
    if row.text("metric")? == "phase_predicted" {
        if let Some(last) = score.frame_scores.last_mut() {
            last.phase_predicted = value;
        }
    } else {
        let metric = metric_of(row)?;
        fits(row, "value", metric, value)?;
        // A metric of another definition is left out here as in the table.
        let is_kept = score.metric(metric.id).is_some();
        if let Some(last) = score.frame_scores.last_mut().filter(|_| is_kept) {
            last.values.push(FrameValue { metric: metric.id.to_owned(), value, status: status_of(row)? });
        }
    }
    Ok(())
}

fn add_timing(cells: &mut Vec<CellRecord>, row: &CsvRow<'_>) -> Result<()> {
    let number = |column: &str| row.number(column).map(|v| v.unwrap_or(0.0));
    let cost = StageCost {
        stage: plain(row.text("stage")?),
        wall_s: number("wall_s")?,
        cpu_s: number("cpu_s")?,
        peak_memory_mib: number("peak_rss_mib")?,
        threads: number("threads")? as usize,
        machine_id: plain(row.text("machine_id")?),
    };
    cell_of(cells, row, "config")?.timings.push(cost);
    Ok(())
}

fn metric_of(row: &CsvRow<'_>) -> Result<&'static Metric> {
    let id = row.text("metric")?;
    metric(&id).ok_or_else(|| row.refuse("metric", format!("\"{id}\" is no metric of this version")))
}

/// Refuses a value that the metric cannot have.
fn fits(row: &CsvRow<'_>, column: &str, metric: &Metric, value: Option<f64>) -> Result<()> {
    value.and_then(|value| unfit(metric, value)).map_or(Ok(()), |sentence| Err(row.refuse(column, sentence)))
}

fn status_of(row: &CsvRow<'_>) -> Result<Status> {
    let word = row.text("status")?;
    Status::of_word(&word).ok_or_else(|| row.refuse("status", format!("\"{word}\" is no status")))
}

/// Undoes [`super::tables::text`].
fn plain(text: String) -> String {
    match text.strip_prefix('\'') {
        Some(rest) if super::tables::text(rest) == text => rest.to_owned(),
        _ => text,
    }
}
