//! Relative limits of a baseline, from runs: an allowance for each method and metric of four standard deviations of what
//! changes for no reason.
//!
//! The deviation is that between the seeds of a case, pooled over cases. A method that draws nothing, so that seeds change
//! none of its values, has none; then it is that of the differences of single cases between two films of the case that differ in
//! nothing but their sampling, nine of them at least. No allowance is less than half a unit of the last decimal that
//! tables show: a difference that no table shows is none. Of a method that draws nothing, a metric that fewer than nine
//! cases have has no limit.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;
use std::path::Path;

use super::gate::Relative;
use super::read::Results;
use crate::base::{Error, Result, files};
use crate::score::statistics::{deviation, mean};
use crate::score::{Metric, metric, registry};

/// Standard deviations that a value may be worse. A sound build of another film exceeds them once in 30,000 values; one
/// that draws other numbers, where they are of single values and the loss is a difference of two, once in 430.
const DEVIATIONS: f64 = 4.0;
/// Fewest differences from which a deviation is taken.
const LEAST_DIFFERENCES: usize = 9;

/// Where a deviation comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LimitSource {
    /// The seeds of a case.
    Seeds,
    /// Differences of single cases between two films.
    SingleCases,
}

/// A computed limit and what it rests on.
#[derive(Clone, Debug)]
pub struct ComputedLimit {
    /// The limit.
    pub limit: Relative,
    /// Where the deviation comes from.
    pub source: LimitSource,
    /// The deviation, in the metric's unit.
    pub deviation: f64,
}

/// The limits of every method and metric that the runs have values of; methods sorted, metrics in the registry's order.
///
/// Errors: runs of two tracks; a method without spread between seeds that fewer than nine single cases show on two films,
/// unless no more cases have the metric.
pub fn limits_from(runs: &[Results]) -> Result<Vec<ComputedLimit>> {
    let Some(first) = runs.first() else { return Ok(Vec::new()) };
    runs.iter().try_for_each(|run| first.check_track(run))?;
    let mut methods: Vec<&str> = runs.iter().flat_map(Results::methods).collect();
    methods.sort_unstable();
    methods.dedup();
    let mut found = Vec::new();
    let metrics = || registry().iter().filter(|m| !m.is_runtime());
    for method in methods {
        let source = if draws(runs, method) { LimitSource::Seeds } else { LimitSource::SingleCases };
        let of_method: Vec<ComputedLimit> =
            metrics().filter_map(|metric| limit_of(runs, method, metric, source).transpose()).collect::<Result<_>>()?;
        if of_method.is_empty() && source == LimitSource::SingleCases {
            return Err(too_few(method, "any metric", 0));
        }
        found.extend(of_method);
    }
    Ok(found)
}

fn too_few(method: &str, metric: &str, cases: usize) -> Error {
    Error::input(format!(
        "{method} has no spread between seeds, and {cases} single cases with {metric} on two films: {LEAST_DIFFERENCES} are needed"
    ))
}

fn limit_of(runs: &[Results], method: &str, metric: &Metric, source: LimitSource) -> Result<Option<ComputedLimit>> {
    if runs.iter().all(|run| run.case_values(method, metric.id).is_empty()) {
        return Ok(None);
    }
    let deviation = match source {
        LimitSource::Seeds => deviation_of_seeds(runs, method, metric).unwrap_or(0.0),
        LimitSource::SingleCases => {
            let differences = single_case_differences(runs, method, metric);
            if differences.len() < LEAST_DIFFERENCES {
                let of_runs = runs.iter().flat_map(|run| run.case_values(method, metric.id));
                let cases: BTreeSet<&str> = of_runs.map(|(case, _)| case).collect();
                let is_rare = cases.len() < LEAST_DIFFERENCES;
                return if is_rare { Ok(None) } else { Err(too_few(method, metric.id, differences.len())) };
            }
            deviation(&differences).unwrap_or(0.0)
        }
    };
    let least = 0.5 * 10f64.powi(-(metric.digits as i32));
    let limit = Relative {
        metric: metric.id.to_owned(),
        method: Some(method.to_owned()),
        worse_by: rounded(least.max(DEVIATIONS * deviation)),
        worse_by_percent: 0.0,
        advisory: false,
    };
    Ok(Some(ComputedLimit { limit, source, deviation }))
}

/// Two digits are what nine differences say.
fn rounded(value: f64) -> f64 {
    format!("{value:.1e}").parse().unwrap_or(value)
}

/// Whether two seeds of a method give different values of anything but time. (A deviation above 0 would not tell: the
/// mean of three equal numbers may be another one.)
fn draws(runs: &[Results], method: &str) -> bool {
    let is_runtime = |id: &str| metric(id).is_none_or(Metric::is_runtime);
    runs.iter().any(|run| {
        let mut first: BTreeMap<(&str, &str), Option<f64>> = BTreeMap::new();
        let of_method = run.entries.iter().filter(|(key, _)| key.method == method && !is_runtime(&key.metric));
        of_method.into_iter().any(|(key, entry)| {
            *first.entry((key.case.as_str(), key.metric.as_str())).or_insert(entry.value) != entry.value
        })
    })
}

/// The root of the mean over cases of the variance between seeds.
fn deviation_of_seeds(runs: &[Results], method: &str, metric: &Metric) -> Option<f64> {
    let of_run = |run: &Results| -> Vec<f64> {
        let mut by_case: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
        for (key, entry) in run.entries.iter().filter(|(key, _)| key.method == method && key.metric == metric.id) {
            by_case.entry(&key.case).or_default().extend(entry.value.filter(|v| v.is_finite()));
        }
        by_case.values().filter_map(|values| deviation(values)).collect()
    };
    let squares: Vec<f64> = runs.iter().flat_map(of_run).map(|d| d * d).collect();
    mean(&squares).map(f64::sqrt)
}

/// Values of a case in one run minus those in an earlier one that filmed it differently.
fn single_case_differences(runs: &[Results], method: &str, metric: &Metric) -> Vec<f64> {
    let mut found = Vec::new();
    for (at, run) in runs.iter().enumerate() {
        for (key, entry) in run.entries.iter().filter(|(k, _)| k.method == method && k.metric == metric.id) {
            let others = runs[..at].iter().filter(|other| run.has_other_film(other, &key.case));
            let values = others.filter_map(|other| other.entries.get(key)?.value.zip(entry.value));
            found.extend(values.map(|(before, now)| now - before).filter(|difference| difference.is_finite()));
        }
    }
    found
}

/// Writes the limits as a thresholds file that says where each comes from.
pub fn write_limits(limits: &[ComputedLimit], path: &Path) -> Result<()> {
    let mut out = "# Written by `respire-bench gate --limits-from`: worse_by is four standard deviations of the seeds \
        or, of a method that draws nothing,\n# of the differences of single cases between two samplings of their films \
        (docs/statistics.md).\n"
        .to_owned();
    for computed in limits {
        let source = match computed.source {
            LimitSource::Seeds => "seeds",
            LimitSource::SingleCases => "single cases",
        };
        let _ = write!(
            out,
            "\n[[relative]]\nmetric = \"{}\"\nmethod = \"{}\"\nworse_by = {:?} # {source}\n",
            computed.limit.metric,
            computed.limit.method.as_deref().unwrap_or_default(),
            computed.limit.worse_by
        );
    }
    files::write_bytes(path, out.as_bytes())
}
