//! How far neighbours in the ranking are apart: paired by case, with an interval over trees and cases. Two rows may have
//! wide intervals and yet differ in every case alike; and a first place may be nothing but the draw of the cases.

use super::counted_run::CountedRun;
use super::run::{MethodInfo, Run};
use super::summary::MethodSummary;
use crate::base::own_row;
use crate::score::statistics::{FEWEST_TREES, MeanInterval};
use crate::score::{Metric, navigation_metrics, ranking_metrics};
use crate::simulate::track::Track;

/// Follows the word of a pair whose better row sees more.
pub const SEES_MORE: &str = ", sees more";

/// A ranked row and the next one, by one metric.
#[derive(Clone, Debug)]
pub struct NeighbourDifference {
    /// The metric.
    pub metric: &'static Metric,
    /// Place of the better row.
    pub rank: usize,
    /// The better row.
    pub method: MethodInfo,
    /// The row behind it.
    pub next: MethodInfo,
    /// Cases that both have: all that count for the metric.
    pub cases: usize,
    /// Trees of those cases.
    pub trees: usize,
    /// By how much the better row is ahead, in the metric's unit: mean over cases of the paired difference.
    pub ahead: MeanInterval,
}

impl NeighbourDifference {
    /// Whether the interval lies above 0: the order would be the same on other cases like these. `None` where there are too
    /// few of them to say.
    pub fn is_clear(&self) -> Option<bool> {
        let [low, _] = self.ahead.interval.filter(|_| self.trees >= FEWEST_TREES)?;
        Some(low > 0.0)
    }

    /// Whether the better row sees more than the one behind it, so that it does not beat it.
    pub fn sees_more(&self) -> bool {
        !own_row::sees(&self.method.id).is_within(own_row::sees(&self.next.id))
    }

    /// `is_clear` as a word, with what it sees more; a dash where nobody can say.
    pub fn word(&self) -> String {
        let clear = match self.is_clear() {
            None => "–",
            Some(true) => "yes",
            Some(false) => "no",
        };
        format!("{clear}{}", if self.sees_more() { SEES_MORE } else { "" })
    }
}

/// All pairs of neighbours: metric by metric in the order of the table, from the first place down. Rows that share a
/// place stand in the run's order.
pub fn neighbours(run: &Run, summaries: &[MethodSummary]) -> Vec<NeighbourDifference> {
    let counted = CountedRun::new(run);
    let of_navigation = navigation_metrics().filter(|_| run.track == Track::Clinical);
    of_navigation.chain(ranking_metrics()).flat_map(|metric| of_metric(&counted, summaries, metric)).collect()
}

fn of_metric(
    counted: &CountedRun<'_>,
    summaries: &[MethodSummary],
    metric: &'static Metric,
) -> Vec<NeighbourDifference> {
    let place = |s: &MethodSummary| s.metric(metric.id).and_then(|m| m.rank);
    let mut ranked: Vec<(usize, &MethodInfo)> =
        summaries.iter().filter_map(|s| place(s).map(|rank| (rank, &s.method))).collect();
    ranked.sort_by_key(|(rank, _)| *rank);
    let pair = |pair: &[(usize, &MethodInfo)]| {
        let [(rank, method), (_, next)] = pair else { return None };
        let values = counted.case_values(&next.id, metric.id);
        let behind = |case: &str| values.iter().find(|(other, _)| *other == case).map(|(_, value)| *value);
        let ahead: Vec<(&str, f64)> = counted
            .case_values(&method.id, metric.id)
            .into_iter()
            .filter_map(|(case, value)| behind(case).map(|behind| (case, metric.direction.loss(behind, value))))
            .collect();
        let mut trees: Vec<&str> = ahead.iter().map(|(case, _)| counted.tree_of(case)).collect();
        trees.sort_unstable();
        trees.dedup();
        Some(NeighbourDifference {
            metric,
            rank: *rank,
            method: (*method).clone(),
            next: (*next).clone(),
            cases: ahead.len(),
            trees: trees.len(),
            ahead: counted.mean(&ahead)?,
        })
    };
    ranked.windows(2).filter_map(pair).collect()
}
