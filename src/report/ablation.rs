//! `ablations.csv` and `ablations.md`: what each part of a method, and each property of a film, is worth.

use std::fmt::Write;
use std::path::{Path, PathBuf};

use super::markdown::escape;
use super::table::{arrow, heading};
use super::tables::{number, write_csv};
use crate::base::{Result, files};
use crate::score::statistics::{deviation, mean};
use crate::score::{CellScore, Metric, paper_metrics};

/// The cells of one variant.
#[derive(Clone, Debug)]
pub struct VariantScores {
    /// What is varied; empty for the method as shipped.
    pub group: String,
    /// What it is set to.
    pub setting: String,
    /// Id of the method.
    pub method: String,
    /// One per case and seed that did not fail.
    pub cells: Vec<CellScore>,
    /// How many failed.
    pub failed: usize,
}

/// Columns of `ablations.csv`.
const COLUMNS: [&str; 10] =
    ["group", "setting", "method", "metric", "cells", "failed", "mean", "shipped", "difference", "noise"];

/// Mean over the cells that have the metric.
fn value(scores: &VariantScores, metric: &Metric) -> Option<f64> {
    mean(&scores.cells.iter().filter_map(|c| c.value(metric.id)).collect::<Vec<_>>())
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

/// Writes both files; `title` names cases and profile. Returns the path of the Markdown.
pub fn write(all: &[VariantScores], title: &str, folder: &Path) -> Result<PathBuf> {
    let mut rows = Vec::new();
    for scores in all {
        let reference = shipped(all, scores);
        for metric in paper_metrics() {
            let (mean, of_shipped) = (value(scores, metric), reference.and_then(|r| value(r, metric)));
            let difference = mean.zip(of_shipped).map(|(m, s)| m - s);
            let noise = reference.and_then(|r| noise(r, metric));
            let words = [scores.group.as_str(), &scores.setting, &scores.method, metric.id].map(str::to_owned);
            let counts = [scores.cells.len(), scores.failed].map(|n| n.to_string());
            let numbers = [mean, of_shipped, difference, noise].map(number);
            rows.push(words.into_iter().chain(counts).chain(numbers).collect());
        }
    }
    write_csv(&folder.join("ablations.csv"), &COLUMNS.map(String::from), &rows)?;
    let path = folder.join("ablations.md");
    files::write_bytes(&path, markdown(all, title).as_bytes())?;
    Ok(path)
}

fn markdown(all: &[VariantScores], title: &str) -> String {
    let headings: String = paper_metrics().map(|m| format!(" {} {} |", escape(heading(m)), arrow(m))).collect();
    let mut out = format!(
        "# Ablations\n\n{title}. ± is the standard deviation between seeds of the method as shipped; a difference within \
         it says nothing.\n\n| What | Setting | Method |{headings}\n|---|---|---|{}\n",
        "--:|".repeat(paper_metrics().count())
    );
    for scores in all {
        let what = if scores.group.is_empty() { "*as shipped*".to_owned() } else { escape(&scores.group) };
        let cells: String = paper_metrics()
            .map(|metric| {
                match (value(scores, metric), scores.group.is_empty().then(|| noise(scores, metric)).flatten()) {
                    (None, _) => " – |".to_owned(),
                    (Some(v), None) => format!(" {} |", metric.format(v)),
                    (Some(v), Some(n)) => format!(" {} ± {} |", metric.format(v), metric.format(n)),
                }
            })
            .collect();
        let failed = if scores.failed > 0 { format!(" ({} failed)", scores.failed) } else { String::new() };
        let _ = writeln!(out, "| {what} | {}{failed} | {} |{cells}", escape(&scores.setting), scores.method);
    }
    out
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

    fn scores(group: &str, values: &[(u64, f64)]) -> VariantScores {
        let cells = values.iter().map(|&(seed, value)| cell(seed, value)).collect();
        VariantScores { group: group.into(), setting: "0".into(), method: "ours".into(), cells, failed: 0 }
    }

    #[test]
    fn a_variant_stands_beside_the_shipped_method_and_its_noise() {
        let folder = tempfile::tempdir().unwrap();
        let all = [scores("", &[(0, 0.02), (1, 0.04)]), scores("w_t", &[(0, 0.05)])];
        let text = std::fs::read_to_string(write(&all, "two", folder.path()).unwrap()).unwrap();
        assert!(text.contains("*as shipped*") && text.contains("0.030 ± 0.014") && text.contains("0.050"), "{text}");
        let csv = std::fs::read_to_string(folder.path().join("ablations.csv")).unwrap();
        let row = csv.lines().find(|l| l.starts_with("w_t,0,ours,phase_mae")).unwrap();
        let fields: Vec<f64> = row.split(',').skip(6).map(|v| v.parse().unwrap()).collect();
        let expected = [0.05, 0.03, 0.02, 0.02 / 2f64.sqrt()];
        assert!(fields.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{row}");
    }
}
