//! `ablations.csv` and `ablations.md`: what each part of a method, and each property of a film, is worth, and which value
//! of a number is best.

use std::collections::BTreeSet;
use std::fmt::Write;
use std::path::{Path, PathBuf};

use super::markdown::escape;
use super::table::arrow;
use super::tables::{number, write_csv};
use crate::base::{Result, files};
use crate::score::statistics::{deviation, mean};
use crate::score::{CellScore, Metric, metric};

/// The cells of one variant.
#[derive(Clone, Debug)]
pub struct VariantScores {
    /// What is varied; empty for the method as shipped.
    pub group: String,
    /// What it is set to.
    pub setting: String,
    /// Id of the method.
    pub method: String,
    /// Nothing is changed: a shipped method under the name of its setting, beside others.
    pub is_shipped: bool,
    /// It is a value of an axis, of which the best is looked for.
    pub of_axis: bool,
    /// One per case and seed that did not fail.
    pub cells: Vec<CellScore>,
    /// How many failed.
    pub failed: usize,
}

/// Columns of `ablations.csv`.
const COLUMNS: [&str; 11] =
    ["group", "setting", "method", "metric", "cells", "failed", "mean", "shipped", "difference", "noise", "best"];

/// Mean over the cells that have the metric.
fn value(scores: &VariantScores, metric: &Metric) -> Option<f64> {
    value_of(scores, metric, |_| true)
}

/// The same over those of the cells that `counts`.
fn value_of(scores: &VariantScores, metric: &Metric, counts: impl Fn(&CellScore) -> bool) -> Option<f64> {
    let cells = scores.cells.iter().filter(|cell| counts(cell));
    mean(&cells.filter_map(|cell| cell.value(metric.id)).collect::<Vec<_>>())
}

/// The shipped method's mean over the cases and seeds that `scores` has: a line is run with fewer seeds than it.
fn beside(scores: &VariantScores, shipped: &VariantScores, metric: &Metric) -> Option<f64> {
    let is_same = |cell: &CellScore| scores.cells.iter().any(|s| (&s.case_id, s.seed) == (&cell.case_id, cell.seed));
    value_of(shipped, metric, is_same)
}

/// Mean difference from the method as shipped, over the cases and seeds in which both have the metric.
fn difference(scores: &VariantScores, shipped: &VariantScores, metric: &Metric) -> Option<f64> {
    let of_cell = |cell: &CellScore| {
        let same = shipped.cells.iter().find(|s| (&s.case_id, s.seed) == (&cell.case_id, cell.seed))?;
        cell.value(metric.id).zip(same.value(metric.id)).map(|(own, before)| own - before)
    };
    mean(&scores.cells.iter().filter_map(of_cell).collect::<Vec<_>>())
}

/// Standard deviation between seeds of the mean over cases.
fn noise(scores: &VariantScores, metric: &Metric) -> Option<f64> {
    let mut seeds: Vec<u64> = scores.cells.iter().map(|c| c.seed).collect();
    seeds.sort_unstable();
    seeds.dedup();
    let of_seed = |seed: &u64| {
        let cells = scores.cells.iter().filter(|c| c.seed == *seed);
        mean(&cells.filter_map(|c| c.value(metric.id)).collect::<Vec<_>>())
    };
    deviation(&seeds.iter().filter_map(of_seed).collect::<Vec<_>>())
}

/// The shipped row of the same method.
fn shipped<'a>(all: &'a [VariantScores], of: &VariantScores) -> Option<&'a VariantScores> {
    all.iter().find(|s| s.group.is_empty() && s.method == of.method)
}

/// Whether no other value of the axis is better. A value that lost a cell, or the metric in one, is no candidate.
fn is_best(all: &[VariantScores], of: &VariantScores, metric: &Metric) -> bool {
    let is_whole = |s: &VariantScores| s.failed == 0 && s.cells.iter().all(|cell| cell.value(metric.id).is_some());
    let whole = |s: &VariantScores| if is_whole(s) { value(s, metric) } else { None };
    let Some(own) = whole(of).filter(|_| of.of_axis) else { return false };
    let others = all.iter().filter(|s| s.of_axis && s.group == of.group && s.method == of.method);
    others.filter_map(whole).all(|other| !metric.direction.better(other, own))
}

/// Writes both files; `metrics` are the columns of the tables, `title` names cases and profile. Returns the path of the
/// Markdown.
pub fn write(all: &[VariantScores], metrics: &[String], title: &str, folder: &Path) -> Result<PathBuf> {
    let metrics: Vec<&Metric> = metrics.iter().filter_map(|id| metric(id)).collect();
    let mut rows = Vec::new();
    for scores in all {
        let reference = shipped(all, scores);
        for metric in &metrics {
            let (mean, of_shipped) = (value(scores, metric), reference.and_then(|r| beside(scores, r, metric)));
            let difference = reference.and_then(|r| difference(scores, r, metric));
            let noise = reference.and_then(|r| noise(r, metric));
            let words = [scores.group.as_str(), &scores.setting, &scores.method, metric.id].map(str::to_owned);
            let counts = [scores.cells.len(), scores.failed].map(|n| n.to_string());
            let numbers = [mean, of_shipped, difference, noise].map(number);
            let best = if is_best(all, scores, metric) { "yes" } else { "" }.to_owned();
            rows.push(words.into_iter().chain(counts).chain(numbers).chain([best]).collect());
        }
    }
    write_csv(&folder.join("ablations.csv"), &COLUMNS.map(String::from), &rows)?;
    let path = folder.join("ablations.md");
    files::write_bytes(&path, markdown(all, &metrics, title).as_bytes())?;
    Ok(path)
}

/// A table for each group, which begins with its methods as shipped. Until the first group is there: those alone.
fn markdown(all: &[VariantScores], metrics: &[&Metric], title: &str) -> String {
    let mut out = format!(
        "# Ablations\n\n{title}. ± is the standard deviation between seeds of the method as shipped, whose mean is over the \
         seeds of the lines that vary it; a difference within it says nothing. **Bold**: the best value of a number.\n"
    );
    let groups: Vec<&str> = all.iter().map(|s| s.group.as_str()).filter(|group| !group.is_empty()).collect();
    let mut seen: Vec<&str> = Vec::new();
    for group in if groups.is_empty() { vec![""] } else { groups } {
        if !seen.contains(&group) {
            seen.push(group);
            table_of(&mut out, all, group, metrics);
        }
    }
    out
}

fn table_of(out: &mut String, all: &[VariantScores], group: &str, metrics: &[&Metric]) {
    let heading = if group.is_empty() { "as shipped" } else { group };
    let columns: String = metrics.iter().map(|m| format!(" {} {} |", escape(&m.heading()), arrow(m))).collect();
    let numbers = "--:|".repeat(metrics.len());
    let _ = write!(out, "\n## {}\n\n| Setting |{columns}\n|---|{numbers}\n", escape(heading));
    let of_group: Vec<&VariantScores> = all.iter().filter(|s| s.group == group && !group.is_empty()).collect();
    // A method whose shipped form is a line of the group needs no second one.
    let is_line = |s: &VariantScores| of_group.iter().any(|line| line.is_shipped && line.method == s.method);
    let is_of_group = |s: &VariantScores| group.is_empty() || of_group.iter().any(|line| line.method == s.method);
    let begin = all.iter().filter(|s| s.group.is_empty() && is_of_group(s) && !is_line(s));
    for scores in begin.chain(of_group.iter().copied()) {
        let cells: String = metrics.iter().map(|m| format!(" {} |", shown(all, scores, m))).collect();
        let failed = if scores.failed > 0 { format!(" ({} failed)", scores.failed) } else { String::new() };
        let setting = if scores.group.is_empty() { "*as shipped*".to_owned() } else { escape(&scores.setting) };
        let _ = writeln!(out, "| {}: {setting}{failed} |{cells}", escape(&scores.method));
    }
}

/// The mean; of a shipped method over the seeds of the lines that vary it, which are fewer, where there are any.
fn shown_value(all: &[VariantScores], scores: &VariantScores, metric: &Metric) -> Option<f64> {
    let lines = all.iter().filter(|line| !line.is_shipped && line.method == scores.method);
    let seeds: BTreeSet<u64> = lines.flat_map(|line| &line.cells).map(|cell| cell.seed).collect();
    let has_lines = scores.is_shipped && !seeds.is_empty();
    value_of(scores, metric, |cell| !has_lines || seeds.contains(&cell.seed))
}

fn shown(all: &[VariantScores], scores: &VariantScores, metric: &Metric) -> String {
    let spread = scores.is_shipped.then(|| noise(scores, metric)).flatten();
    match (shown_value(all, scores, metric), spread) {
        (None, _) => "–".to_owned(),
        (Some(v), _) if is_best(all, scores, metric) => format!("**{}**", metric.format(v)),
        (Some(v), None) => metric.format(v),
        (Some(v), Some(n)) => format!("{} ± {}", metric.format(v), metric.format(n)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::score::{MetricScore, Status};

    /// A cell that has a phase error and nothing else.
    fn cell(seed: u64, value: f64) -> CellScore {
        let metric = MetricScore {
            metric: "phase_mae".into(),
            value: Some(value),
            status: Status::Ok,
            deviation: None,
            count: 1,
            interval: None,
            detail: String::new(),
        };
        CellScore {
            case_id: "case1".into(),
            case_hash: String::new(),
            film_content: String::new(),
            method: "ours".into(),
            seed,
            frames: 1,
            metrics: vec![metric],
            frame_scores: Vec::new(),
            overlay: None,
        }
    }

    fn scores(group: &str, setting: &str, values: &[(u64, f64)]) -> VariantScores {
        let cells = values.iter().map(|&(seed, value)| cell(seed, value)).collect();
        VariantScores {
            group: group.into(),
            setting: setting.into(),
            method: "ours".into(),
            is_shipped: group.is_empty(),
            of_axis: false,
            cells,
            failed: 0,
        }
    }

    fn written(all: &[VariantScores]) -> (String, String) {
        let folder = tempfile::tempdir().unwrap();
        let metrics = ["phase_mae".to_owned()];
        let text = std::fs::read_to_string(write(all, &metrics, "two", folder.path()).unwrap()).unwrap();
        (text, std::fs::read_to_string(folder.path().join("ablations.csv")).unwrap())
    }

    #[test]
    fn a_variant_stands_beside_the_shipped_method_and_its_noise() {
        let (text, csv) = written(&[scores("", "", &[(0, 0.02), (1, 0.04)]), scores("w_t", "0", &[(0, 0.05)])]);
        assert!(text.contains("ours: *as shipped* | 0.020 ± 0.014") && text.contains("ours: 0 | 0.050"), "{text}");
        let row = csv.lines().find(|l| l.starts_with("w_t,0,ours,phase_mae")).unwrap();
        let fields: Vec<f64> = row.split(',').skip(6).take(4).map(|v| v.parse().unwrap()).collect();
        // Shipped value and difference are those of the seed which both have.
        let expected = [0.05, 0.02, 0.03, 0.02 / 2f64.sqrt()];
        assert!(fields.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{row}");
    }

    /// Two cases that differ by 0.1, two seeds that differ by 0.02 in both: the noise is that of the mean over cases.
    #[test]
    fn noise_is_between_seeds_and_not_between_cases() {
        let (text, _) = written(&[scores("", "", &[(0, 0.02), (1, 0.04), (0, 0.12), (1, 0.14)])]);
        assert!(text.contains("ours: *as shipped* | 0.080 ± 0.014"), "{text}");
    }

    #[test]
    fn the_best_value_of_an_axis_is_marked_and_one_that_failed_is_none() {
        let axis = |setting: &str, value: f64, failed: usize| VariantScores {
            of_axis: true,
            failed,
            ..scores("rate", setting, &[(0, value)])
        };
        let all = [scores("", "", &[(0, 0.03)]), axis("1", 0.05, 0), axis("2", 0.02, 0), axis("3", 0.01, 1)];
        let (text, csv) = written(&all);
        assert!(text.contains("ours: 2 | **0.020** |") && text.matches("**").count() == 4, "{text}");
        let best: Vec<&str> = csv.lines().filter(|l| l.ends_with(",yes")).collect();
        assert!(best.len() == 1 && best[0].starts_with("rate,2,"), "{csv}");
        let columns = text.lines().filter(|l| l.starts_with('|')).map(|l| l.matches('|').count() - 1).max();
        assert_eq!(columns, Some(2));
    }
}
