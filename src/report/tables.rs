//! The CSV files. Columns come from the registry; the names that others rely on are fixed.
//!
//! `results.csv` and `frames.csv` hold no time, date or machine: the same work gives the same bytes. What a machine
//! did stands in `timings.csv` and in the last metric columns of `comparison.csv` and `summary.csv`.

use std::path::Path;

use super::counted_run::CountedRun;
use super::differences::NeighbourDifference;
use super::run::{CellRecord, Outcome, Role, Run};
use super::summary::MethodSummary;
use crate::base::{Error, Result, files};
use crate::formats::prediction;
use crate::score::{Group, Metric, Split, Standing, Status, metric, paper_metrics, registry};

/// Columns of `results.csv`.
pub const RESULTS_COLUMNS: [&str; 22] = [
    "run_id",
    "case_id",
    "case_hash",
    "config",
    "seed",
    "split",
    "metric",
    "definition",
    "unit",
    "direction",
    "alignment",
    "mask",
    "value",
    "sd",
    "n",
    "ci_low",
    "ci_high",
    "status",
    "detail",
    "film_content",
    "track",
    "tree",
];

/// Columns of `frames.csv`.
const FRAMES_COLUMNS: [&str; 12] =
    ["run_id", "case_id", "config", "seed", "frame", "file", "time_s", "phase", "split", "metric", "value", "status"];

/// Columns of `timings.csv`.
const TIMINGS_COLUMNS: [&str; 10] =
    ["run_id", "case_id", "config", "stage", "wall_s", "cpu_s", "peak_rss_mib", "threads", "machine_id", "seed"];

/// A number as its shortest round-trip text; empty for none, NaN and infinity.
pub fn number(value: Option<f64>) -> String {
    match value {
        // Without the sign of a zero, which a mean of no differences can have.
        Some(v) if v.is_finite() => format!("{}", v + 0.0),
        _ => String::new(),
    }
}

/// Text that no spreadsheet takes for a formula.
pub fn text(value: &str) -> String {
    if value.starts_with(['=', '+', '-', '@', '\t', '\r']) { format!("'{value}") } else { value.to_owned() }
}

/// Writes a table; the error names the file.
pub fn write_csv(path: &Path, header: &[String], rows: &[Vec<String>]) -> Result<()> {
    let mut writer = csv::WriterBuilder::new().terminator(csv::Terminator::Any(b'\n')).from_writer(Vec::new());
    let failed = |e: csv::Error| Error::input(format!("encoding as CSV failed: {e}")).at(path);
    for row in std::iter::once(header).chain(rows.iter().map(Vec::as_slice)) {
        writer.write_record(row).map_err(failed)?;
    }
    let bytes = writer.into_inner().map_err(|e| Error::input(format!("encoding as CSV failed: {e}")).at(path))?;
    files::write_bytes(path, &bytes)
}

fn header(columns: &[&str]) -> Vec<String> {
    columns.iter().map(|c| c.to_string()).collect()
}

fn alignment_of(m: &Metric) -> &'static str {
    if matches!(m.group, Group::Depth | Group::Target) { "none" } else { "" }
}

/// Which pixels count: where the truth has a depth, or all. What a film's own mask hides counts nowhere.
fn mask_of(m: &Metric) -> &'static str {
    if m.group == Group::Depth { "true_depth" } else { "none" }
}

/// `results.csv`: one row per cell and metric, times left out.
pub fn write_results(run: &Run, path: &Path) -> Result<()> {
    let counted = CountedRun::new(run);
    let mut rows = Vec::new();
    for cell in &run.cells {
        for m in registry().iter().filter(|m| !m.is_runtime()) {
            rows.push(results_row(run, cell, counted.tree_of(&cell.case_id), m));
        }
    }
    write_csv(path, &header(&RESULTS_COLUMNS), &rows)
}

fn results_row(run: &Run, cell: &CellRecord, tree: &str, m: &Metric) -> Vec<String> {
    let score = cell.score().and_then(|s| s.metric(m.id));
    let (status, detail) = match (&cell.outcome, score) {
        (Outcome::Failed(why), _) => (Status::Failed, why.as_str()),
        (_, Some(score)) => (score.status, score.detail.as_str()),
        (_, None) => (Status::NotApplicable, "made before this metric existed"),
    };
    let interval = score.and_then(|s| s.interval);
    vec![
        text(&cell.run_id),
        text(&cell.case_id),
        cell.score().map_or_else(String::new, |s| s.case_hash.clone()),
        text(&cell.method),
        cell.seed.to_string(),
        m.split.word().into(),
        m.id.into(),
        m.definition_id(),
        m.unit.into(),
        m.direction.word().into(),
        alignment_of(m).into(),
        mask_of(m).into(),
        number(score.and_then(|s| s.value)),
        number(score.and_then(|s| s.deviation)),
        score.map_or(0, |s| s.count).to_string(),
        number(interval.map(|i| i[0])),
        number(interval.map(|i| i[1])),
        status.word().into(),
        text(detail),
        cell.score().map_or_else(String::new, |s| s.film_content.clone()),
        run.track.word().into(),
        text(tree),
    ]
}

/// `frames.csv`: one row per cell, frame and frame-wise metric, and one for the predicted phase.
pub fn write_frames(run: &Run, path: &Path) -> Result<()> {
    let mut rows = Vec::new();
    for cell in &run.cells {
        let Some(score) = cell.score() else { continue };
        for frame in &score.frame_scores {
            let mut push = |split: Split, metric: &str, value: Option<f64>, status: Status| {
                let is_depth = crate::score::metric(metric).is_some_and(|m| m.group == Group::Depth);
                let (folder, ending) = match split {
                    Split::Ahead => (prediction::AHEAD, prediction::PICTURE_ENDING),
                    Split::Novel if is_depth => (prediction::NOVEL_DEPTH, prediction::DEPTH_ENDING),
                    Split::Novel => (prediction::NOVEL, prediction::PICTURE_ENDING),
                    Split::Online | Split::Final if is_depth => (prediction::DEPTH, prediction::DEPTH_ENDING),
                    Split::Online | Split::Final => (prediction::COLOR, prediction::PICTURE_ENDING),
                };
                rows.push(vec![
                    text(&cell.run_id),
                    text(&cell.case_id),
                    text(&cell.method),
                    cell.seed.to_string(),
                    frame.frame.to_string(),
                    prediction::frame_file(folder, frame.frame, ending),
                    number(Some(frame.time_s)),
                    number(Some(frame.phase)),
                    split.word().into(),
                    metric.into(),
                    number(value),
                    status.word().into(),
                ]);
            };
            for v in &frame.values {
                push(metric(&v.metric).map_or(Split::Online, |m| m.split), &v.metric, v.value, v.status);
            }
            if frame.phase_predicted.is_some() {
                push(Split::Online, "phase_predicted", frame.phase_predicted, Status::Ok);
            }
        }
    }
    write_csv(path, &header(&FRAMES_COLUMNS), &rows)
}

/// `timings.csv`: what each stage of each cell cost on this machine.
pub fn write_timings(run: &Run, path: &Path) -> Result<()> {
    let mut rows = Vec::new();
    for cell in &run.cells {
        for t in &cell.timings {
            rows.push(vec![
                text(&cell.run_id),
                text(&cell.case_id),
                text(&cell.method),
                text(&t.stage),
                number(Some(t.wall_s)),
                number(Some(t.cpu_s)),
                number(Some(t.peak_memory_mib)),
                t.threads.to_string(),
                text(&t.machine_id),
                cell.seed.to_string(),
            ]);
        }
    }
    write_csv(path, &header(&TIMINGS_COLUMNS), &rows)
}

/// `comparison.csv`: one row per cell, one column per metric; then the extras, and the sentence of a failure.
pub fn write_comparison(run: &Run, path: &Path) -> Result<()> {
    let extras = || registry().iter().filter(|m| m.standing == Standing::Extra);
    let mut columns = header(&["case_id", "method", "seed"]);
    columns.extend(paper_metrics().map(|m| m.id.to_owned()));
    columns.extend(header(&["frames", "status"]));
    columns.extend(extras().map(|m| m.id.to_owned()));
    columns.push("detail".into());
    let rows: Vec<Vec<String>> = run
        .cells
        .iter()
        .map(|cell| {
            let value = |m: &Metric| number(cell.score().and_then(|s| s.value(m.id)));
            let mut row = vec![text(&cell.case_id), text(&cell.method), cell.seed.to_string()];
            row.extend(paper_metrics().map(value));
            row.push(cell.score().map_or_else(String::new, |s| s.frames.to_string()));
            row.push(if cell.score().is_some() { Status::Ok.word().into() } else { Status::Failed.word().into() });
            row.extend(extras().map(value));
            row.push(if let Outcome::Failed(why) = &cell.outcome { text(why) } else { String::new() });
            row
        })
        .collect();
    write_csv(path, &columns, &rows)
}

/// `differences.csv`: one row per metric that ranks and pair of neighbours: by how much the better is ahead.
pub fn write_differences(differences: &[NeighbourDifference], path: &Path) -> Result<()> {
    let columns =
        ["metric", "rank", "method", "next", "cases", "trees", "ahead_by", "ci_low", "ci_high", "clear", "sees_more"];
    let row = |d: &NeighbourDifference| {
        let interval = d.ahead.interval;
        vec![
            d.metric.id.into(),
            d.rank.to_string(),
            text(&d.method.id),
            text(&d.next.id),
            d.cases.to_string(),
            d.trees.to_string(),
            number(Some(d.ahead.mean)),
            number(interval.map(|i| i[0])),
            number(interval.map(|i| i[1])),
            d.is_clear().map_or("", |is_clear| if is_clear { "yes" } else { "no" }).into(),
            if d.sees_more() { "yes" } else { "no" }.into(),
        ]
    };
    write_csv(path, &header(&columns), &differences.iter().map(row).collect::<Vec<_>>())
}

/// `summary.csv`: one row per method, means over cases with their 95 % bounds, the number of cases behind them, and the
/// place among the ranked methods.
pub fn write_summary(summaries: &[MethodSummary], path: &Path) -> Result<()> {
    let mut columns = header(&["method", "role", "cases", "failed"]);
    let metrics: Vec<&Metric> =
        paper_metrics().chain(registry().iter().filter(|m| m.standing == Standing::Extra)).collect();
    for m in &metrics {
        columns.extend([
            m.id.to_owned(),
            format!("{}_ci_low", m.id),
            format!("{}_ci_high", m.id),
            format!("{}_n", m.id),
            format!("{}_rank", m.id),
        ]);
    }
    let rows: Vec<Vec<String>> = summaries
        .iter()
        .map(|s| {
            let role = if s.method.role == Role::Ranked { "ranked" } else { "sanity" };
            let mut row = vec![text(&s.method.id), role.into(), s.cases.to_string(), s.failed.to_string()];
            for m in &metrics {
                let mean = s.mean(m.id);
                let interval = mean.and_then(|m| m.interval);
                row.push(number(mean.map(|m| m.mean)));
                row.push(number(interval.map(|i| i[0])));
                row.push(number(interval.map(|i| i[1])));
                row.push(mean.map_or(0, |m| m.count).to_string());
                row.push(s.metric(m.id).and_then(|m| m.rank).map_or_else(String::new, |rank| rank.to_string()));
            }
            row
        })
        .collect();
    write_csv(path, &columns, &rows)
}
