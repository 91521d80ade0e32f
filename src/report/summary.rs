//! Means over cases, and the place of each method: one ranking per metric, over all cases and seeds of the table.
//!
//! A method is ranked by a metric when it is scored in every case, with every seed (`CountedRun::covers`): a mean over
//! other cases is another number. A surface that cannot be measured counts with the case's worst row, behind it.
//! A row is beaten only by one that sees no more than it does ([`own_row::Sees`]): one that is not first may still lead all
//! those. Bounds are not ranked, nor what equals the truth or the input, nor times that were not measured beside the others
//! (`CountedRun::is_timed`). Equal numbers, to the decimals that tables show, share a place.

use super::counted_run::CountedRun;
use super::run::{CaseInfo, MethodInfo, Role, Run};
use crate::base::own_row;
use crate::score::statistics::MeanInterval;
use crate::score::{Goal, Metric, Needs, Status, registry, told_by};
use crate::simulate::track::Track;

/// An error in the metric's unit (mm, degrees, phases) below that of any estimate by far, which is that of the truth.
const NO_ERROR: f64 = 1e-5;

/// One metric of one method, over the cases.
#[derive(Clone, Copy, Debug)]
pub struct MetricSummary {
    /// The metric.
    pub metric: &'static Metric,
    /// Mean over cases; `None` where no case has a value.
    pub mean: Option<MeanInterval>,
    /// Place among the ranked methods, 1 the best; `None` for bounds and where a value is missing or no estimate.
    pub rank: Option<usize>,
    /// It is ranked, not first, and ahead of every ranked row that sees no more than it, of which there is one.
    pub leads_equals: bool,
    /// The prediction of a ranked method equals the truth: no error at all, or every frame of a case to the bit.
    pub is_perfect: bool,
    /// A surface of a case cannot be measured: the case's worst row counts in its place, and an equal row stands before.
    pub is_marked: bool,
}

/// Mean over cases of every metric for one method.
#[derive(Clone, Debug)]
pub struct MethodSummary {
    /// The method.
    pub method: MethodInfo,
    /// Cases with at least one scored cell, of those that count.
    pub cases: usize,
    /// Cells that failed.
    pub failed: usize,
    /// Cells, those included.
    pub cells: usize,
    /// Seeds that count.
    pub seeds: usize,
    /// In the registry's order.
    pub metrics: Vec<MetricSummary>,
}

impl MethodSummary {
    /// What is known of the metric `id`.
    pub fn metric(&self, id: &str) -> Option<&MetricSummary> {
        self.metrics.iter().find(|m| m.metric.id == id)
    }

    /// Mean of the metric `id` over cases.
    pub fn mean(&self, id: &str) -> Option<MeanInterval> {
        self.metric(id).and_then(|m| m.mean)
    }
}

/// One summary per method, in the run's order. A case counts once, with the mean over its seeds.
pub fn summarise(run: &Run) -> Vec<MethodSummary> {
    let counted = CountedRun::new(run);
    let of = |method: &MethodInfo| {
        let is_scored = |case: &&&CaseInfo| counted.cells(&case.id, &method.id).any(|cell| cell.score().is_some());
        MethodSummary {
            method: method.clone(),
            cases: counted.ranking_cases().iter().filter(is_scored).count(),
            failed: run.cells.iter().filter(|c| c.method == method.id && c.score().is_none()).count(),
            cells: run.cells.iter().filter(|c| c.method == method.id).count(),
            seeds: counted.seeds(&method.id).len(),
            metrics: registry().iter().map(|m| metric_summary(run, &counted, method, m)).collect(),
        }
    };
    let mut summaries: Vec<MethodSummary> = run.methods.iter().map(of).collect();
    for (index, metric) in registry().iter().enumerate().filter(|(_, metric)| !metric.judges_error_bars()) {
        for (method, place) in places(run, &counted, &summaries, metric).into_iter().enumerate() {
            let summary = &mut summaries[method].metrics[index];
            summary.rank = place.map(|place| place.rank);
            summary.leads_equals = place.is_some_and(|place| place.leads_equals);
        }
    }
    summaries
}

/// Whether a ranked method's numbers of `metric` are of the truth itself.
fn equals_truth(run: &Run, counted: &CountedRun<'_>, method: &MethodInfo, metric: &Metric) -> bool {
    if let Some(telling) = told_by(metric) {
        return equals_truth(run, counted, method, telling);
    }
    let mean = counted.mean(&counted.case_values(&method.id, metric.id));
    // That no frame of a hundred is lost is an estimate like any other.
    let is_share = metric.unit == "%";
    let is_exact = |m: MeanInterval| metric.perfect.is_some_and(|perfect| (m.mean - perfect).abs() <= NO_ERROR);
    let no_error = metric.direction == Goal::Lower && !is_share && mean.is_some_and(is_exact);
    let is_identical = run
        .cells
        .iter()
        .filter(|c| c.method == method.id)
        .filter_map(|c| c.score()?.metric(metric.id))
        .any(|score| score.status == Status::Identical);
    method.role == Role::Ranked && (no_error || is_identical)
}

fn metric_summary(run: &Run, counted: &CountedRun<'_>, method: &MethodInfo, metric: &'static Metric) -> MetricSummary {
    let mean = counted.mean(&counted.case_values(&method.id, metric.id));
    let is_perfect = equals_truth(run, counted, method, metric);
    let is_marked = counted.is_marked(&method.id, metric.id);
    MetricSummary { metric, mean, rank: None, leads_equals: false, is_perfect, is_marked }
}

/// As tables and bars show them: what is ranked, then bounds.
pub fn in_order_of_tables(summaries: &[MethodSummary]) -> impl Iterator<Item = &MethodSummary> {
    let of = |role: Role| summaries.iter().filter(move |s| s.method.role == role);
    of(Role::Ranked).chain(of(Role::Sanity))
}

/// Where a ranked method stands by a metric.
#[derive(Clone, Copy)]
struct Place {
    rank: usize,
    leads_equals: bool,
}

/// By what a ranked method's place is found.
struct RankedValue {
    /// As tables show it.
    value: f64,
    /// Whether another row's number counts in it.
    is_marked: bool,
    /// Whether that stands behind all without: a third party that expects worse than the worst own row would gain by a
    /// surface that cannot be measured.
    is_behind: bool,
}

/// The place of each method by `metric`: 1 + the number of better ones.
fn places(run: &Run, counted: &CountedRun<'_>, summaries: &[MethodSummary], metric: &Metric) -> Vec<Option<Place>> {
    let shown = |s: &MethodSummary| s.mean(metric.id).and_then(|m| metric.format(m.mean).parse::<f64>().ok());
    let is_estimate = |s: &MethodSummary| {
        let is_perfect = s.metric(metric.id).is_some_and(|m| m.is_perfect);
        let mut scores =
            run.cells.iter().filter(|c| c.method == s.method.id).filter_map(|c| c.score()?.metric(metric.id));
        !is_perfect && scores.all(|score| score.status != Status::Copied)
    };
    // On the ideal track the true poses are told: who gives them back has estimated none.
    let is_told = |s: &MethodSummary| {
        metric.applies_to == Needs::Poses && run.track == Track::Ideal && own_row::sees(&s.method.id).told_poses
    };
    let is_ranked = |s: &MethodSummary| {
        s.method.role == Role::Ranked
            && !is_told(s)
            && counted.covers(&s.method.id, metric.id)
            && is_estimate(s)
            && (!metric.is_runtime() || counted.is_timed(&s.method.id))
    };
    let standing = |s: &MethodSummary| {
        let value = shown(s).filter(|_| is_ranked(s))?;
        let is_marked = s.metric(metric.id).is_some_and(|m| m.is_marked);
        Some(RankedValue { value, is_marked, is_behind: is_marked && !MethodInfo::is_own(&s.method.id) })
    };
    let values: Vec<Option<RankedValue>> = summaries.iter().map(standing).collect();
    let stands_before = |a: &RankedValue, b: &RankedValue| match (a.is_behind, b.is_behind) {
        (false, true) => true,
        (true, false) => false,
        _ => metric.direction.better(a.value, b.value) || (a.value == b.value && b.is_marked && !a.is_marked),
    };
    let place = |(index, own): (usize, &Option<RankedValue>)| {
        let own = own.as_ref()?;
        let better = |other: &RankedValue| stands_before(other, own);
        let rank = 1 + values.iter().flatten().filter(|other| better(other)).count();
        let sees = own_row::sees(&summaries[index].method.id);
        let sees_no_more = |k: &usize| *k != index && own_row::sees(&summaries[*k].method.id).is_within(sees);
        let mut equals = (0..values.len()).filter(sees_no_more).filter_map(|k| values[k].as_ref()).peekable();
        let leads_equals = rank > 1 && equals.peek().is_some() && !equals.any(better);
        Some(Place { rank, leads_equals })
    };
    values.iter().enumerate().map(place).collect()
}
