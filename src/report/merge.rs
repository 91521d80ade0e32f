//! Merges runs that were made separately: cells from several machines, renewed rows, a third party's predictions beside
//! the methods. Each is read back from its report folder; a cell that several runs have is taken from the last.
//!
//! Nothing is recomputed: values, intervals and times are those of the tables. Images that need films or predictions
//! (panels, contours) are left out.

use std::collections::BTreeMap;
use std::path::Path;

use super::read::{CsvRow, CsvTable};
use super::run::{CaseInfo, CellRecord, MethodInfo, Outcome, Run, StageCost};
use crate::base::{Error, Result, hash};
use crate::score::{CellScore, FrameScore, FrameValue, MetricScore, Status, registry};

/// Whether a table may hold scores of different films of one case.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Films {
    /// No: two runs that filmed a case differently are refused.
    Same,
    /// Yes, and the report says which cells they are.
    Other,
}

/// Reads the tables of a finished run back (`results.csv`, `comparison.csv`; `frames.csv` and `timings.csv` where they
/// are).
///
/// Errors name file, line and column; a metric or status that this version does not know is an error.
pub fn read_run(folder: &Path) -> Result<Run> {
    let mut cells: Vec<CellRecord> = Vec::new();
    let results = folder.join("results.csv");
    for row in CsvTable::read(&results)?.rows() {
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
        score.case_hash = row.text("case_hash")?;
        let (low, high) = (row.number("ci_low")?, row.number("ci_high")?);
        score.metrics.push(MetricScore {
            metric: metric_of(&row)?,
            value: row.number("value")?,
            status,
            deviation: row.number("sd")?,
            count: row.number("n")?.unwrap_or(0.0) as usize,
            interval: low.zip(high).map(|(low, high)| [low, high]),
            detail: plain(row.text("detail")?),
        });
    }
    let Some(first) = cells.first() else { return Err(Error::input("has no rows").at(results)) };
    let id = first.run_id.clone();
    for row in CsvTable::read(&folder.join("comparison.csv"))?.rows() {
        let cell = cell_of(&mut cells, &row, "method")?;
        if let Outcome::Scored(score) = &mut cell.outcome {
            add_times(score, &row)?;
        }
    }
    let frames = folder.join("frames.csv");
    if frames.exists() {
        CsvTable::read(&frames)?.rows().try_for_each(|row| add_frame(&mut cells, &row))?;
    }
    let timings = folder.join("timings.csv");
    if timings.exists() {
        CsvTable::read(&timings)?.rows().try_for_each(|row| add_timing(&mut cells, &row))?;
    }
    // `<profile>-<hash of the plan>`, or `evaluate-<case>-<method>`.
    let is_hash = |word: &str| word.len() == 8 && word.bytes().all(|b| b.is_ascii_hexdigit());
    let cut = id.rsplit_once('-').filter(|(_, hash)| is_hash(hash)).or(id.split_once('-'));
    let profile = cut.map_or(id.as_str(), |(profile, _)| profile).to_owned();
    Ok(Run { id, profile, ..gathered(cells) })
}

/// Merges `parts`; a cell that several runs have is taken from the last.
///
/// Errors: with [`Films::Same`], two parts that scored different films of one case.
pub fn merge(parts: Vec<Run>, films: Films) -> Result<Run> {
    // A part may itself be a merged run.
    let mut ids: Vec<String> = Vec::new();
    for id in parts.iter().flat_map(|run| &run.cells).map(|cell| &cell.run_id) {
        if !ids.contains(id) {
            ids.push(id.clone());
        }
    }
    let mut profiles: Vec<String> = Vec::new();
    let mut cells: Vec<CellRecord> = Vec::new();
    for run in parts {
        if !profiles.contains(&run.profile) {
            profiles.push(run.profile);
        }
        for cell in run.cells {
            match cells.iter_mut().find(|c| is_same(c, &cell)) {
                Some(before) => *before = cell,
                None => cells.push(cell),
            }
        }
    }
    let id = format!("merged-{}", &hash::of_value(&ids)?[..8]);
    let mut run = Run { id, profile: profiles.join(" + "), ..gathered(cells) };
    run.notes.push(format!("Put together from {}.", ids.join(", ")));
    for case in &run.cases {
        let of_film = films_of(&run.cells, &case.id);
        if of_film.len() < 2 {
            continue;
        }
        let named: Vec<String> =
            of_film.iter().map(|(film, methods)| format!("{film} ({})", methods.join(", "))).collect();
        let sentence = format!("{} was filmed more than once: {}", case.id, named.join("; "));
        if films == Films::Same {
            return Err(Error::input(format!("{sentence}; --other-films merges them and says so")));
        }
        run.notes.push(sentence + ".");
    }
    Ok(run)
}

/// A run of `cells` whose cases and methods are in the order in which they come.
fn gathered(mut cells: Vec<CellRecord>) -> Run {
    let mut cases: Vec<CaseInfo> = Vec::new();
    let mut methods: Vec<MethodInfo> = Vec::new();
    for cell in &cells {
        if cases.iter().all(|c| c.id != cell.case_id) {
            cases.push(CaseInfo { id: cell.case_id.clone(), title: String::new(), truth: None });
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
    Run { id: String::new(), profile: String::new(), notes: Vec::new(), cases, methods, cells }
}

/// Short hashes of the films of a case, each with the methods that were scored on it.
fn films_of(cells: &[CellRecord], case_id: &str) -> BTreeMap<String, Vec<String>> {
    let mut films: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for (cell, score) in cells.iter().filter(|c| c.case_id == case_id).filter_map(|c| Some((c, c.score()?))) {
        let film: String = score.case_hash.chars().take(12).collect();
        let methods = films.entry(film).or_default();
        if !methods.contains(&cell.method) {
            methods.push(cell.method.clone());
        }
    }
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
        let value = row.number(m.id)?;
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
    let Some(last) = score.frame_scores.last_mut() else { return Ok(()) };
    let value = row.number("value")?;
    if row.text("metric")? == "phase_predicted" {
        last.phase_predicted = value;
    } else {
        last.values.push(FrameValue { metric: metric_of(row)?, value, status: status_of(row)? });
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

fn metric_of(row: &CsvRow<'_>) -> Result<String> {
    let id = row.text("metric")?;
    if registry().iter().any(|m| m.id == id) {
        return Ok(id);
    }
    Err(row.refuse("metric", format!("\"{id}\" is no metric of this version")))
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
