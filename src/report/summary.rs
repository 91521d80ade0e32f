//! Means over cases, and the best method of each metric.

use super::run::{MethodInfo, Role, Run};
use crate::score::statistics::{MeanInterval, bootstrap};
use crate::score::{Metric, registry};

/// Seed of the bootstrap over cases: fixed, so that the same scores give the same bounds.
const BOOTSTRAP_SEED: u64 = 1;

/// Mean over cases of every metric for one method.
#[derive(Clone, Debug)]
pub struct MethodSummary {
    /// The method.
    pub method: MethodInfo,
    /// Cases with at least one scored cell.
    pub cases: usize,
    /// Cells that failed.
    pub failed: usize,
    /// In the registry's order; `None` where no case has a value.
    pub means: Vec<(&'static Metric, Option<MeanInterval>)>,
}

impl MethodSummary {
    /// Mean of the metric `id` over cases.
    pub fn mean(&self, id: &str) -> Option<MeanInterval> {
        self.means.iter().find(|(m, _)| m.id == id).and_then(|(_, mean)| *mean)
    }
}

/// One summary per method, in the run's order. A case counts once, with the mean over its seeds.
pub fn summarise(run: &Run) -> Vec<MethodSummary> {
    let of = |method: &MethodInfo| {
        let scored =
            |case: &str| run.cells.iter().any(|c| c.case_id == case && c.method == method.id && c.score().is_some());
        let mean = |m: &'static Metric| {
            let values: Vec<f64> = run.case_values(&method.id, m.id).into_iter().map(|(_, v)| v).collect();
            (m, bootstrap(&values, BOOTSTRAP_SEED))
        };
        MethodSummary {
            method: method.clone(),
            cases: run.cases.iter().filter(|c| scored(&c.id)).count(),
            failed: run.cells.iter().filter(|c| c.method == method.id && c.score().is_none()).count(),
            means: registry().iter().map(mean).collect(),
        }
    };
    run.methods.iter().map(of).collect()
}

/// Ids of the ranked methods whose mean is the best of `metric`, to the decimals that tables show. A method that was
/// scored on fewer cases than others is left out: its mean is over different cases.
pub fn best(summaries: &[MethodSummary], metric: &Metric) -> Vec<String> {
    let shown = |s: &MethodSummary| s.mean(metric.id).and_then(|m| metric.format(m.mean).parse::<f64>().ok());
    let most = summaries.iter().map(|s| s.cases).max().unwrap_or(0);
    let whole = summaries.iter().filter(|s| s.cases == most);
    let ranked: Vec<(&MethodSummary, f64)> =
        whole.filter(|s| s.method.role == Role::Ranked).filter_map(|s| shown(s).map(|v| (s, v))).collect();
    let top = |v: f64| !ranked.iter().any(|(_, other)| metric.direction.better(*other, v));
    ranked.iter().filter(|(_, v)| top(*v)).map(|(s, _)| s.method.id.clone()).collect()
}
