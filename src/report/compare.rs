//! Two runs side by side: for every method and metric the mean difference over the cases they share, with a paired
//! 95 % interval over trees and cases.

use std::collections::BTreeSet;

use serde::Serialize;

use super::read::{Results, distinct};
use crate::score::statistics::{FEWEST_TREES, mean_over_cases};
use crate::score::{Goal, Metric, registry};

/// What a difference means.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Change {
    /// The interval lies wholly on the better side.
    Better,
    /// The interval lies wholly on the worse side.
    Worse,
    /// The interval holds 0.
    Unclear,
    /// All values are equal.
    Same,
    /// The first run has a value in a case that both have, and the second none.
    Lost,
    /// One case only: a difference without an interval.
    Single,
    /// Fewer trees than can tell a difference from chance.
    Few,
    /// Times that were not measured on the same machine.
    Machines,
    /// The metric's definition differs between the runs: no comparison.
    Redefined,
}

/// One method and metric.
#[derive(Clone, Debug, Serialize)]
pub struct Comparison {
    /// Method id.
    pub method: String,
    /// Metric id.
    pub metric: &'static str,
    /// Cases in both runs with a value in both.
    pub cases: usize,
    /// Mean of the first run over them.
    pub a: f64,
    /// Mean of the second.
    pub b: f64,
    /// Mean of b - a.
    pub difference: f64,
    /// Its 95 % bounds, paired by case.
    pub interval: Option<[f64; 2]>,
    /// What it means.
    pub change: Change,
}

/// In what two runs are not of the same work, a sentence each: conditions, settings, and seeds of a method.
pub fn differences_of_work(a: &Results, b: &Results) -> Vec<String> {
    let other = b.other_work(a);
    let mut found: Vec<String> =
        other.conditions.map(|c| format!("B ran under other conditions: {c}")).into_iter().collect();
    if !other.settings.is_empty() {
        found.push(format!("run by the program's settings in one of both alone: {}", other.settings.join(", ")));
    }
    let methods_b = b.methods();
    for method in a.methods().into_iter().filter(|m| methods_b.contains(m)) {
        let [in_a, in_b] = [a, b].map(|results| results.seeds_of(method));
        if in_a != in_b {
            let words = |seeds: &BTreeSet<u64>| seeds.iter().map(u64::to_string).collect::<Vec<_>>().join(", ");
            found.push(format!("`{method}` has the seeds {} in A and {} in B", words(&in_a), words(&in_b)));
        }
    }
    found
}

/// What only the first run has, a sentence each: methods, and cases.
pub fn only_in_first(a: &Results, b: &Results) -> Vec<String> {
    let (methods, cases) = (b.methods(), b.cases());
    let missing = |of_a: Vec<&str>, of_b: Vec<&str>, what: &str| -> Option<String> {
        let gone: Vec<&str> = of_a.into_iter().filter(|id| !of_b.contains(id)).collect();
        (!gone.is_empty()).then(|| format!("{what} of A that B has not: {}", gone.join(", ")))
    };
    [missing(a.methods(), methods, "methods"), missing(a.cases(), cases, "cases")].into_iter().flatten().collect()
}

/// All methods and metrics that both runs have, methods sorted, metrics in the registry's order.
pub fn compare(a: &Results, b: &Results) -> Vec<Comparison> {
    let mut found = Vec::new();
    let methods_b = b.methods();
    for method in a.methods().into_iter().filter(|m| methods_b.contains(m)) {
        found.extend(registry().iter().filter_map(|m| compare_one(a, b, method, m)));
    }
    found
}

fn compare_one(a: &Results, b: &Results, method: &str, m: &'static Metric) -> Option<Comparison> {
    let (values_a, values_b) = (a.case_values(method, m.id), b.case_values(method, m.id));
    let (mut pairs, mut trees) = (Vec::new(), Vec::new());
    for (case, value_a) in &values_a {
        if let Some((_, value_b)) = values_b.iter().find(|(other, _)| other == case) {
            pairs.push((*value_a, *value_b));
            trees.push(a.tree_of(case));
        }
    }
    let without = b.cases_without(method, m.id);
    // A case that the second run has, but not of this method, is lost, too.
    let is_gone = |case: &str| b.facts.contains_key(case) && !b.has_rows(method, case);
    let has_lost = values_a.iter().any(|(case, _)| without.contains(case) || is_gone(case));
    let few = distinct(trees.iter().copied()).len() < FEWEST_TREES;
    let differences: Vec<f64> = pairs.iter().map(|(va, vb)| vb - va).collect();
    let Some(mean) = mean_over_cases(differences.iter().copied().zip(trees)) else {
        let nothing = Comparison {
            method: method.to_owned(),
            metric: m.id,
            cases: 0,
            a: f64::NAN,
            b: f64::NAN,
            difference: f64::NAN,
            interval: None,
            change: Change::Lost,
        };
        return has_lost.then_some(nothing);
    };
    let side = |get: fn(&(f64, f64)) -> f64| pairs.iter().map(get).sum::<f64>() / pairs.len() as f64;
    let definitions = |r: &Results| -> Vec<String> {
        let mut all: Vec<String> = r
            .entries
            .iter()
            .filter(|(k, _)| k.metric == m.id && k.method == method)
            .map(|(_, e)| e.definition.clone())
            .collect();
        all.sort();
        all.dedup();
        all
    };
    let change = if definitions(a) != definitions(b) {
        Change::Redefined
    } else if has_lost {
        Change::Lost
    } else if differences.iter().all(|d| *d == 0.0) {
        Change::Same
    } else if m.is_runtime() && !a.is_of_the_machine_of(b) {
        Change::Machines
    } else {
        match mean.interval {
            None => Change::Single,
            Some(_) if few => Change::Few,
            Some([low, high]) if low > 0.0 || high < 0.0 => {
                if (low > 0.0) == (m.direction == Goal::Higher) {
                    Change::Better
                } else {
                    Change::Worse
                }
            }
            Some(_) => Change::Unclear,
        }
    };
    Some(Comparison {
        method: method.to_owned(),
        metric: m.id,
        cases: pairs.len(),
        a: side(|p| p.0),
        b: side(|p| p.1),
        difference: mean.mean,
        interval: mean.interval,
        change,
    })
}
