//! A run's means as programs read them that draw numbers over commits: github-action-benchmark and Bencher.
//!
//! github-action-benchmark knows one direction per file (`customSmallerIsBetter`, `customBiggerIsBetter`), so there are
//! two: arrays of `{"name", "unit", "value", "range", "extra"}`. Bencher's Metric Format is
//! `{benchmark: {measure: {"value", "lower_value", "upper_value"}}}`; here a method is a benchmark and a metric a measure.

use std::collections::BTreeMap;
use std::path::Path;

use serde::Serialize;

use super::read::Results;
use super::table::counted;
use crate::base::{Result, files};
use crate::score::statistics::mean_over_cases;
use crate::score::{Goal, registry};

/// `customSmallerIsBetter` of github-action-benchmark.
pub const SMALLER_FILE: &str = "benchmark-smaller-is-better.json";
/// `customBiggerIsBetter` of github-action-benchmark.
pub const BIGGER_FILE: &str = "benchmark-bigger-is-better.json";
/// Bencher Metric Format, Bencher's adapter `json`.
pub const BENCHER_FILE: &str = "benchmark-bencher.json";

/// An entry of github-action-benchmark.
#[derive(Serialize)]
struct CustomEntry {
    name: String,
    unit: &'static str,
    value: f64,
    /// The 95 % interval over cases, where there is more than one.
    #[serde(skip_serializing_if = "Option::is_none")]
    range: Option<String>,
    /// What a chart's tooltip shows.
    extra: String,
}

/// A metric of Bencher.
#[derive(Serialize)]
struct BencherMetric {
    value: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    lower_value: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    upper_value: Option<f64>,
}

/// Writes the three files into `folder`: for each method and metric the mean over the cases that have a value, with its
/// 95 % interval over trees and cases. Metrics without a value are left out, since neither format knows an absent one.
///
/// Errors: an unwritable folder.
pub fn write(results: &Results, folder: &Path) -> Result<()> {
    let (mut smaller, mut bigger) = (Vec::new(), Vec::new());
    let mut bencher: BTreeMap<&str, BTreeMap<&str, BencherMetric>> = BTreeMap::new();
    for method in results.methods() {
        for metric in registry() {
            let of_cases = results.case_values(method, metric.id);
            let of_cases = of_cases.iter().map(|(case, value)| (*value, results.tree_of(case)));
            let Some(mean) = mean_over_cases(of_cases) else { continue };
            let of_direction = match metric.direction {
                Goal::Lower => &mut smaller,
                Goal::Higher => &mut bigger,
            };
            let count = counted(mean.count, "case");
            // Times have none.
            let definition = results.entries.iter().find(|(key, _)| key.method == method && key.metric == metric.id);
            let definition = definition.map_or("", |(_, entry)| entry.definition.as_str());
            let track = format!("track {}", results.track.word());
            let facts = [track.as_str(), &count, definition].into_iter().filter(|fact| !fact.is_empty());
            of_direction.push(CustomEntry {
                name: format!("{method}: {}", metric.id),
                unit: metric.unit,
                value: mean.mean,
                range: mean.interval.map(|[low, high]| format!("{} to {}", metric.format(low), metric.format(high))),
                extra: facts.collect::<Vec<_>>().join(", "),
            });
            let [lower_value, upper_value] = mean.interval.map_or([None; 2], |bounds| bounds.map(Some));
            let measure = BencherMetric { value: mean.mean, lower_value, upper_value };
            bencher.entry(method).or_default().insert(metric.id, measure);
        }
    }
    files::write_json(&folder.join(SMALLER_FILE), &smaller)?;
    files::write_json(&folder.join(BIGGER_FILE), &bigger)?;
    files::write_json(&folder.join(BENCHER_FILE), &bencher)
}
