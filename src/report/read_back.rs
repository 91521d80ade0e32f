//! Reads a finished run back from the tables of its report, and refuses what does not hold together: a number that does
//! not follow from its frames, a table that was changed, a metric of another definition.

use std::collections::BTreeMap;
use std::path::Path;

use super::gate::redefinition;
use super::read::{CsvRow, CsvTable, LARGEST, distinct, no_such_row, unfit};
use super::run::{CellRecord, Outcome, Run, StageCost, StatedFacts};
use super::scene::Scenes;
use super::{RESULTS, seal};
use crate::base::range::{NumberRange, PREDICTED_PHASE, THREADS, TIME_S};
use crate::base::{Error, Result, case_id, files, method_name};
use crate::score::{CellScore, FrameScore, FrameValue, Metric, MetricScore, Status, check_means, metric, registry};
use crate::simulate::track::Track;

/// Numbers of frames.
const FRAME: NumberRange = NumberRange::new(0.0, 1e7);
/// Numbers of what a mean was taken over, and of seconds and MiB that a stage took.
const COUNT: NumberRange = NumberRange::new(0.0, 1e9);
const COST: NumberRange = NumberRange::new(0.0, 1e9);

/// Whether rows may lack what they are checked with: the report's manifest, and the frames from which its means follow.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PartEvidence {
    /// No: such a report is refused.
    Needed,
    /// Yes, and the report says which rows were not checked. What is there must still agree.
    Waived,
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
    let results = folder.join(RESULTS);
    let LongTable { mut cells, trees, track, redefined } = LongTable::read(&results, evidence)?;
    let Some(first) = cells.list.first() else { return Err(Error::input("has no rows").at(results)) };
    let (id, is_evaluated) = (first.run_id.clone(), first.is_evaluated());
    for row in CsvTable::read(&folder.join("comparison.csv"))?.rows() {
        let cell = cells.known(&row, "method")?;
        if let Outcome::Scored(score) = &mut cell.outcome {
            add_times(score, &row)?;
        }
    }
    for cell in cells.list.iter().filter(|cell| cell.is_foreign()) {
        let named = |e: Error| e.element(format!("row {} of {}", cell.method, cell.case_id)).at(&results);
        method_name::check_foreign(&cell.method).map_err(named)?;
    }
    read_frames(folder, &mut cells, evidence)?;
    let timings = folder.join("timings.csv");
    if timings.exists() {
        CsvTable::read(&timings)?.rows().try_for_each(|row| add_timing(&mut cells, &row))?;
    }
    let mut cells = cells.list;
    let missing = seal::check(folder)?;
    let notes = notes_of(folder, &cells, &missing, &redefined);
    if let Some(name) = missing.first().filter(|_| evidence == PartEvidence::Needed) {
        let sentence =
            "is missing, so that the rows of this report cannot be checked; --unchecked merges it and says so";
        return Err(Error::input(sentence).at(folder.join(name)));
    }
    let mut scenes = Scenes::read(folder)?;
    scenes.keep_rows_of(&cells.iter().map(CellRecord::row_key).collect());
    for cell in &mut cells {
        if let Outcome::Scored(score) = &mut cell.outcome {
            score.overlay = scenes.row(score).and_then(|row| row.contours.clone());
        }
    }
    let stated = StatedFacts::read(folder)?;
    // `<profile>-<hash of the plan>`, or `evaluate-<case>-<method>`.
    let cut = if is_evaluated { id.split_once('-') } else { id.rsplit_once('-') };
    let of_id = || cut.map_or(id.as_str(), |(profile, _)| profile).to_owned();
    let profile = if stated.profile.is_empty() { of_id() } else { stated.profile };
    let conditions = stated.conditions;
    let read_from = vec![folder.to_owned()];
    let mut run = Run { id, profile, track, scenes, read_from, conditions, notes, ..Run::of_cells(cells, &trees) };
    run.mark_changed(stated.changed.iter().map(String::as_str));
    for case in stated.cases {
        run.cases.iter_mut().filter(|c| c.id == case.id).for_each(|c| c.title = case.title.clone());
    }
    Ok(run)
}

/// What `results.csv` holds: all values but times.
struct LongTable {
    cells: Cells,
    /// The tree of each case.
    trees: BTreeMap<String, String>,
    track: Track,
    /// Metrics that were left out, since they have another definition now.
    redefined: Vec<String>,
}

impl LongTable {
    fn read(path: &Path, evidence: PartEvidence) -> Result<LongTable> {
        let (mut cells, mut trees) = (Cells::default(), BTreeMap::new());
        let (mut tracks, mut redefined) = (Vec::new(), Vec::new());
        for row in CsvTable::read(path)?.rows() {
            let case = plain(row.text("case_id")?);
            case_id::check(&case).map_err(|e| row.refuse("case_id", format!("\"{case}\" {e}")))?;
            trees.insert(case, plain(row.text_or_empty("tree")));
            let track = Track::of_word(&row.text_or_empty("track")).map_err(|e| row.refuse("track", e.to_string()))?;
            if !tracks.contains(&track) {
                tracks.push(track);
            }
            let cell = cells.of_row(&row, "config")?;
            cell.run_id = plain(row.text("run_id")?);
            add_value(cell, &row, evidence, &mut redefined)?;
        }
        let is_of_unknown_film = |score: &&CellScore| score.film_content.is_empty() && !score.metrics.is_empty();
        let unknown = cells.list.iter().filter_map(CellRecord::score).find(is_of_unknown_film);
        if let Some(score) = unknown.filter(|_| evidence == PartEvidence::Needed) {
            let sentence = "is empty, so that nobody can tell which film was scored; --unchecked merges it and says so";
            let element = format!("row {} of {}, column film_content", score.method, score.case_id);
            return Err(Error::input(sentence).element(element).at(path));
        }
        match &tracks[..] {
            &[track] => Ok(LongTable { cells, trees, track, redefined }),
            [] => Err(Error::input("has no rows").at(path)),
            _ => Err(Error::input("has rows of two tracks").at(path)),
        }
    }
}

/// Adds what a row of `results.csv` says to its cell. The name of a metric of another definition goes to `redefined`
/// where evidence is waived.
fn add_value(
    cell: &mut CellRecord,
    row: &CsvRow<'_>,
    evidence: PartEvidence,
    redefined: &mut Vec<String>,
) -> Result<()> {
    let status = status_of(row)?;
    if status == Status::Failed {
        if cell.score().is_some_and(|score| !score.metrics.is_empty()) {
            return Err(row.refuse("status", "the cell has values in rows before and has failed here".into()));
        }
        cell.outcome = Outcome::Failed(plain(row.text("detail")?));
        return Ok(());
    }
    let Outcome::Scored(score) = &mut cell.outcome else {
        return Err(row.refuse("status", "the cell has failed in a row before and has a value here".into()));
    };
    let (hash, content) = (row.text("case_hash")?, row.text_or_empty("film_content"));
    if !score.metrics.is_empty() && (&hash, &content) != (&score.case_hash, &score.film_content) {
        return Err(row.refuse("film_content", "is of another film than the rows before of this cell".into()));
    }
    (score.case_hash, score.film_content) = (hash, content);
    let metric = metric_of(row)?;
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
        return Ok(());
    }
    let finite = |column: &str| in_range(row, column, NumberRange::new(-LARGEST, LARGEST));
    let (low, high, deviation) = (finite("ci_low")?, finite("ci_high")?, finite("sd")?);
    let value = row.number("value")?;
    fits(row, "value", metric, value)?;
    score.metrics.push(MetricScore {
        metric: metric.id.to_owned(),
        value,
        status,
        deviation,
        count: whole(row, "n", COUNT)?,
        interval: low.zip(high).map(|(low, high)| [low, high]),
        detail: plain(row.text("detail")?),
    });
    Ok(())
}

/// Adds the frames of `frames.csv`, if it is there, and checks that the cells' numbers follow from them.
fn read_frames(folder: &Path, cells: &mut Cells, evidence: PartEvidence) -> Result<()> {
    let path = folder.join("frames.csv");
    if !path.exists() {
        return Ok(());
    }
    CsvTable::read(&path)?.rows().try_for_each(|row| add_frame(cells, &row))?;
    let has_frames = |score: &&CellScore| evidence == PartEvidence::Needed || !score.frame_scores.is_empty();
    let scores = || cells.list.iter().filter_map(CellRecord::score).filter(has_frames);
    scores().try_for_each(check_means).map_err(|e| e.at(folder.join(RESULTS)))?;
    match scores().find(|score| score.frame_scores.is_empty()) {
        Some(score) => {
            let sentence =
                format!("has no frames of {} in {}, from which its numbers follow", score.method, score.case_id);
            Err(Error::input(sentence).at(path))
        }
        None => Ok(()),
    }
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

/// The cells of a report, in the order of their first rows, and where each stands: a large plan has millions of rows.
#[derive(Default)]
struct Cells {
    list: Vec<CellRecord>,
    /// By case, method and seed.
    places: BTreeMap<(String, String, u64), usize>,
}

impl Cells {
    /// The cell of a row, made where it is new.
    fn of_row(&mut self, row: &CsvRow<'_>, method_column: &str) -> Result<&mut CellRecord> {
        let key = row.key(method_column, String::new())?;
        let Cells { list, places } = self;
        let place = places.entry((plain(key.case), plain(key.method), key.seed));
        let at = *place.or_insert_with_key(|(case_id, method, seed)| {
            list.push(empty_cell(case_id, method, *seed));
            list.len() - 1
        });
        Ok(&mut list[at])
    }

    /// The cell of a row of another table. Refuses one that `results.csv` does not have.
    fn known(&mut self, row: &CsvRow<'_>, method_column: &str) -> Result<&mut CellRecord> {
        let before = self.list.len();
        self.of_row(row, method_column)?;
        if self.list.len() > before {
            return Err(row.refuse("seed", no_such_row()));
        }
        self.of_row(row, method_column)
    }
}

/// A cell of which nothing has been read yet.
fn empty_cell(case_id: &str, method: &str, seed: u64) -> CellRecord {
    CellRecord {
        run_id: String::new(),
        outcome: Outcome::Scored(Box::new(CellScore {
            case_id: case_id.to_owned(),
            case_hash: String::new(),
            film_content: String::new(),
            method: method.to_owned(),
            seed,
            frames: 0,
            metrics: Vec::new(),
            frame_scores: Vec::new(),
            overlay: None,
        })),
        case_id: case_id.to_owned(),
        method: method.to_owned(),
        seed,
        prediction: Default::default(),
        timings: Vec::new(),
    }
}

/// Times and the number of frames stand in `comparison.csv` alone.
fn add_times(score: &mut CellScore, row: &CsvRow<'_>) -> Result<()> {
    score.frames = whole(row, "frames", FRAME)?;
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

fn add_frame(cells: &mut Cells, row: &CsvRow<'_>) -> Result<()> {
    let Outcome::Scored(score) = &mut cells.known(row, "config")?.outcome else { return Ok(()) };
    let number = |column: &str, range| in_range(row, column, range).map(|v| v.unwrap_or(f64::NAN));
    let frame = number("frame", FRAME)? as usize;
    let (time_s, phase) = (number("time_s", TIME_S)?, number("phase", PREDICTED_PHASE)?);
    if score.frame_scores.last().is_none_or(|last| last.frame != frame) {
        score.frame_scores.push(FrameScore { frame, time_s, phase, phase_predicted: None, values: Vec::new() });
    }
    if row.text("metric")? == "phase_predicted" {
        let value = in_range(row, "value", PREDICTED_PHASE)?;
        if let Some(last) = score.frame_scores.last_mut() {
            last.phase_predicted = value;
        }
    } else {
        let (metric, value) = (metric_of(row)?, row.number("value")?);
        fits(row, "value", metric, value)?;
        // A metric of another definition is left out here as in the table.
        let is_kept = score.metric(metric.id).is_some();
        if let Some(last) = score.frame_scores.last_mut().filter(|_| is_kept) {
            last.values.push(FrameValue { metric: metric.id.to_owned(), value, status: status_of(row)? });
        }
    }
    Ok(())
}

fn add_timing(cells: &mut Cells, row: &CsvRow<'_>) -> Result<()> {
    let number = |column: &str| in_range(row, column, COST).map(|v| v.unwrap_or(0.0));
    let cost = StageCost {
        stage: plain(row.text("stage")?),
        wall_s: number("wall_s")?,
        cpu_s: number("cpu_s")?,
        peak_memory_mib: number("peak_rss_mib")?,
        threads: whole(row, "threads", THREADS)?,
        machine_id: plain(row.text("machine_id")?),
    };
    cells.known(row, "config")?.timings.push(cost);
    Ok(())
}

fn metric_of(row: &CsvRow<'_>) -> Result<&'static Metric> {
    let id = row.text("metric")?;
    metric(&id).ok_or_else(|| row.refuse("metric", format!("\"{id}\" is no metric of this version")))
}

/// The number in a column, if there is one, of a range.
fn in_range(row: &CsvRow<'_>, column: &str, range: NumberRange) -> Result<Option<f64>> {
    let value = row.number(column)?;
    value.map_or(Ok(()), |value| range.check(value)).map_err(|e| row.refuse(column, e.to_string()))?;
    Ok(value)
}

/// A number that counts; 0 where there is none.
fn whole(row: &CsvRow<'_>, column: &str, range: NumberRange) -> Result<usize> {
    match in_range(row, column, range)?.unwrap_or(0.0) {
        count if count.fract() == 0.0 => Ok(count as usize),
        part => Err(row.refuse(column, format!("{part} is no whole number"))),
    }
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
