//! What counts in the means and places of a run: which cases, which number of a cell, whose times. Cells are looked up by
//! case and method: the tables of a large plan ask millions of times.

use std::collections::{BTreeMap, BTreeSet};

use super::run::{CaseInfo, CellRecord, Role, Run};
use crate::score::statistics::{MeanInterval, mean, mean_over_cases};

/// A run, ready to be asked.
pub struct CountedRun<'a> {
    run: &'a Run,
    /// Cells of a case that set the measure for all: those of this program's own rows, or all where there are none. What a
    /// third party hands in decides neither over which cases a table ranks, nor what the worst value of a case is. Nor does
    /// a case rank that few of the rows have ([`common_cases`]).
    measure: BTreeMap<&'a str, Vec<&'a CellRecord>>,
    /// Cells of a case by method.
    of_row: BTreeMap<&'a str, BTreeMap<&'a str, Vec<&'a CellRecord>>>,
    /// Of a method.
    seeds: BTreeMap<&'a str, BTreeSet<u64>>,
    trees: BTreeMap<&'a str, &'a str>,
    ranking_cases: Vec<&'a CaseInfo>,
    machine: Option<(&'a str, usize)>,
}

impl<'a> CountedRun<'a> {
    /// Sorts the cells of `run`.
    pub fn new(run: &'a Run) -> Self {
        let has_own = run.cells.iter().any(|cell| !cell.is_foreign());
        let (mut measure, mut of_row) = (BTreeMap::new(), BTreeMap::new());
        for cell in &run.cells {
            let (case, method) = (cell.case_id.as_str(), cell.method.as_str());
            of_row.entry(case).or_insert_with(BTreeMap::new).entry(method).or_insert_with(Vec::new).push(cell);
            if !has_own || !cell.is_foreign() {
                measure.entry(case).or_insert_with(Vec::new).push(cell);
            }
        }
        let common = common_cases(run, &measure, has_own);
        measure.retain(|case, _| common.contains(case));
        let ranking_cases: Vec<&CaseInfo> =
            run.cases.iter().filter(|case| measure.contains_key(case.id.as_str())).collect();
        let ranking: BTreeSet<&str> = ranking_cases.iter().map(|case| case.id.as_str()).collect();
        let seeds = common_seeds(run, &ranking);
        let trees = run.cases.iter().map(|case| (case.id.as_str(), case.tree())).collect();
        CountedRun { run, measure, of_row, seeds, trees, ranking_cases, machine: machine(run) }
    }

    /// Cases over which means and places are taken, in order; others are only listed.
    pub fn ranking_cases(&self) -> &[&'a CaseInfo] {
        &self.ranking_cases
    }

    /// The seeds of a method that count, by [`common_seeds`].
    pub fn seeds(&self, method: &str) -> &BTreeSet<u64> {
        const NONE: &BTreeSet<u64> = &BTreeSet::new();
        self.seeds.get(method).unwrap_or(NONE)
    }

    /// The seeds of a method that it has in a case that counts, and that do not count themselves.
    pub fn seeds_left_out(&self, method: &str) -> BTreeSet<u64> {
        let of_case = |case: &&CaseInfo| self.of_row.get(case.id.as_str()).and_then(|of_case| of_case.get(method));
        let cells = self.ranking_cases.iter().filter_map(of_case).flatten();
        cells.map(|cell| cell.seed).filter(|seed| !self.seeds(method).contains(seed)).collect()
    }

    /// Cells of a method in a case, one per seed that counts.
    pub fn cells(&self, case: &str, method: &str) -> impl Iterator<Item = &'a CellRecord> {
        let cells = self.of_row.get(case).and_then(|of_case| of_case.get(method)).into_iter().flatten();
        let seeds = self.seeds(method);
        cells.copied().filter(|cell| seeds.contains(&cell.seed))
    }

    /// The number with which a cell counts in means and ranks, and whether it is not its own: a surface that was handed
    /// in and cannot be measured counts with the worst value that any row of this program has in its case.
    fn counted(&self, cell: &CellRecord, metric: &str) -> Option<(f64, bool)> {
        let own = cell.score()?.metric(metric)?;
        if let Some(value) = own.value {
            return Some((value, false));
        }
        if !own.status.counts_as_worst() {
            return None;
        }
        let goal = crate::score::metric(metric)?.direction;
        let worst = |a: f64, b: f64| if goal.better(a, b) { b } else { a };
        let case = cell.case_id.as_str();
        let value = |other: &CellRecord| other.score()?.value(metric);
        let known = self.measure_of(case).filter_map(value).reduce(worst);
        known.or_else(|| self.all_of(case).filter_map(value).reduce(worst)).map(|value| (value, true))
    }

    fn measure_of(&self, case: &str) -> impl Iterator<Item = &'a CellRecord> {
        self.measure.get(case).into_iter().flatten().copied()
    }

    fn all_of(&self, case: &str) -> impl Iterator<Item = &'a CellRecord> {
        self.of_row.get(case).into_iter().flat_map(BTreeMap::values).flatten().copied()
    }

    /// Whether all times of the method were measured by this program, on the machine of the others and with as many threads.
    pub fn is_timed(&self, method: &str) -> bool {
        let is_timed =
            |cell: &CellRecord| is_run(self.run, cell) && self.machine.is_some() && cell.machine() == self.machine;
        self.run.cells.iter().filter(|cell| cell.method == method).all(is_timed)
    }

    /// Whether another row's number counts in place of one of the method's.
    pub fn is_marked(&self, method: &str, metric: &str) -> bool {
        let is_another = |cell: &CellRecord| self.counted(cell, metric).is_some_and(|(_, is_another)| is_another);
        self.run.cells.iter().any(|c| c.method == method && is_another(c))
    }

    /// The tree of a case.
    pub fn tree_of<'b>(&self, case: &'b str) -> &'b str
    where
        'a: 'b,
    {
        self.trees.get(case).copied().unwrap_or(case)
    }

    /// Whether the method is scored in every case that counts, with the same seeds in each, and has a number of `metric` in
    /// each of them in which an own row has a value: the condition of a place in the ranking.
    pub fn covers(&self, method: &str, metric: &str) -> bool {
        if !self.is_complete(method) {
            return false;
        }
        let has = |cell: &CellRecord| cell.score().is_some_and(|s| s.value(metric).is_some());
        let is_known = self.measure.values().flatten().any(|cell| has(cell));
        let in_question = |case: &&&CaseInfo| match is_known {
            true => self.measure_of(&case.id).any(has),
            false => self.all_of(&case.id).any(has),
        };
        let counts = |cell: &CellRecord| self.counted(cell, metric).is_some();
        self.ranking_cases.iter().filter(in_question).all(|case| self.cells(&case.id, method).all(counts))
    }

    /// Whether the method is scored in every case that counts, with every seed that counts.
    pub fn is_complete(&self, method: &str) -> bool {
        let seeds = self.seeds(method);
        let scored = |case: &CaseInfo| -> BTreeSet<u64> {
            self.cells(&case.id, method).filter(|cell| cell.score().is_some()).map(|cell| cell.seed).collect()
        };
        !seeds.is_empty() && self.ranking_cases.iter().all(|case| scored(case) == *seeds)
    }

    /// One value per case that counts (mean over seeds) of a metric of a method, in the order of the cases; cases without
    /// a value are left out.
    pub fn case_values(&self, method: &str, metric: &str) -> Vec<(&'a str, f64)> {
        let value = |case: &&'a CaseInfo| {
            let cells = self.cells(&case.id, method);
            let values: Vec<f64> = cells.filter_map(|c| self.counted(c, metric)).map(|(value, _)| value).collect();
            mean(&values).map(|value| (case.id.as_str(), value))
        };
        self.ranking_cases.iter().filter_map(value).collect()
    }

    /// Mean of one value per case, with the interval over trees and cases.
    pub fn mean(&self, of_cases: &[(&str, f64)]) -> Option<MeanInterval> {
        mean_over_cases(of_cases.iter().map(|(case, value)| (*value, self.tree_of(case))))
    }
}

/// The cases over which means and places are taken: those that half of the rows that rank have, or more, of this program's
/// rows where there are any; without bounds, unless there is nothing else. One more case of few rows would take the others
/// their places. Of rows of third parties alone, more than half: of two, who hands in one more case would be the only one.
fn common_cases<'a>(run: &Run, measure: &BTreeMap<&'a str, Vec<&'a CellRecord>>, has_own: bool) -> BTreeSet<&'a str> {
    let bounds: BTreeSet<&str> = run.methods.iter().filter(|m| m.role == Role::Sanity).map(|m| m.id.as_str()).collect();
    let rows = |cells: &[&'a CellRecord]| -> BTreeSet<&'a str> {
        cells.iter().map(|cell| cell.method.as_str()).filter(|method| !bounds.contains(method)).collect()
    };
    let all = measure.values().flat_map(|cells| rows(cells)).collect::<BTreeSet<&str>>().len();
    let is_common = |cells: &[&'a CellRecord]| {
        let twice = 2 * rows(cells).len();
        if has_own { twice >= all } else { twice > all }
    };
    let common: BTreeSet<&str> = measure.iter().filter(|(_, cells)| is_common(cells)).map(|(case, _)| *case).collect();
    if common.is_empty() { measure.keys().copied().collect() } else { common }
}

/// The seeds of each method that count: those that it has in more than half of the ranking cases. A cell of another seed,
/// handed in for one case, neither counts nor takes the row its place.
fn common_seeds<'a>(run: &'a Run, ranking: &BTreeSet<&str>) -> BTreeMap<&'a str, BTreeSet<u64>> {
    let mut cases_of = BTreeMap::<&str, BTreeMap<u64, usize>>::new();
    for cell in run.cells.iter().filter(|cell| ranking.contains(cell.case_id.as_str())) {
        *cases_of.entry(cell.method.as_str()).or_default().entry(cell.seed).or_default() += 1;
    }
    let common = |cases_of: BTreeMap<u64, usize>| {
        // A row of few cases has no place, and its seeds are those that it has.
        let most = cases_of.values().max().copied().unwrap_or(0);
        let enough = (ranking.len() / 2 + 1).min(most);
        cases_of.into_iter().filter(|(_, cases)| *cases >= enough).map(|(seed, _)| seed).collect()
    };
    cases_of.into_iter().map(|(method, cases_of)| (method, common(cases_of))).collect()
}

/// The machine and the threads whose times rank: those of most cells of the run's own, the first of equals; none where
/// nobody measured.
fn machine(run: &Run) -> Option<(&str, usize)> {
    let machines = || run.cells.iter().filter(|cell| is_run(run, cell)).filter_map(|cell| cell.machine());
    let mut cells_of = BTreeMap::<(&str, usize), usize>::new();
    machines().for_each(|machine| *cells_of.entry(machine).or_default() += 1);
    let most = cells_of.values().max()?;
    machines().find(|machine| cells_of.get(machine) == Some(most))
}

/// Whether the program ran the method itself: any one in the run at hand, an own row in others.
fn is_run(run: &Run, cell: &CellRecord) -> bool {
    !cell.is_foreign() || (!cell.is_evaluated() && cell.run_id == run.id)
}
