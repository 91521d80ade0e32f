//! Runs a plan: film what is not filmed, reconstruct what is not reconstructed, score what is not scored.
//!
//! Cells run one after the other, each on all threads, so that their timings do not disturb one another; or, where many
//! are to be compared and time is short, several at once ([`execute_at_once`]). Several processes may run the same plan
//! on one cache: what another one has claimed is left to it, and taken from the cache when it is done. A cell that fails
//! does not stop the others. What stops a run: the user, a full or unwritable disk, a machine that lacks something;
//! whatever is finished by then is kept, and the same command goes on from there.

use std::collections::{HashMap, HashSet, VecDeque};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Duration;

use super::claim::{self, Holder, lock};
use super::event::{CacheUse, Event, Watcher};
use super::plan::{Cell, Plan, Planned};
use super::stages::{Stages, caught};
use super::store::{Finish, ProductState, Scrutiny, Store, Unusable, Work, cell_folder, film_folder};
use super::timing::{self, StageTiming, measured};
use crate::base::{Error, ErrorKind, Progress, Result};
use crate::report::run::RECONSTRUCT;

/// Whether finished products may be used again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Freshness {
    /// Take what is finished and unchanged.
    Resume,
    /// Make everything of the plan again.
    Fresh,
}

/// A cell after the run: where its files are, what it cost, or why it failed.
#[derive(Clone, Debug)]
pub struct FinishedCell {
    /// The cell.
    pub cell: Cell,
    /// Folder of the sequence.
    pub sequence: PathBuf,
    /// Folder of the prediction.
    pub prediction: PathBuf,
    /// The score file.
    pub score: PathBuf,
    /// Costs of `simulate`, `reconstruct` and `score`, as far as they were run.
    pub timings: Vec<StageTiming>,
    /// Why there is no score.
    pub failure: Option<Error>,
}

impl FinishedCell {
    /// Whether what the method took was measured while no other cell of this program ran beside it: such alone have a
    /// timing of their own.
    pub fn is_timed(&self) -> bool {
        self.timings.iter().any(|timing| timing.stage == RECONSTRUCT)
    }
}

/// How long to wait before another process' work is looked at again.
const LOOK_AGAIN: Duration = Duration::from_millis(200);

/// Why a product is made again whose disk has failed, or that somebody changed.
const DAMAGED: &str = "its files are not what they were when it was finished";

/// How often a cell is tried again whose film or prediction was damaged: on a disk that goes on failing, its error counts.
const MOST_MENDED: usize = 3;

/// What came of trying a piece of work: done, or another process has it.
enum Tried<T> {
    Done(T),
    Held(Holder),
}

/// What becomes of a cell's error.
enum Mended {
    /// It stays.
    No,
    /// What it came of is gone.
    TryAgain,
    /// Another process works on what it came of.
    Held(Holder),
}

struct Execution<'a> {
    plan: &'a Plan,
    stages: &'a dyn Stages,
    store: &'a Store,
    /// What was finished before the run, where everything is to be made again.
    finished_before: Option<HashMap<String, Finish>>,
    watcher: &'a dyn Watcher,
    done: AtomicUsize,
    /// Cells of the plan.
    total: usize,
    /// Whether what a cell cost is kept: not where it shared the machine, and CPU seconds are those of all.
    alone: bool,
    /// Films that were tried, and what came of it.
    films: Mutex<HashMap<String, Result<()>>>,
    /// The claims that are or were waited for: each is told of once.
    waited_for: Mutex<HashSet<String>>,
}

/// Runs every cell of `plan`; the answer has one entry per cell, in the plan's order, failed ones included.
pub fn execute(
    plan: &Plan,
    stages: &dyn Stages,
    store: &Store,
    freshness: Freshness,
    watcher: &dyn Watcher,
) -> Result<Vec<FinishedCell>> {
    let run = Execution::new(plan, stages, store, freshness, watcher)?;
    let work = run.work();
    let mut finished: Vec<Option<FinishedCell>> = vec![None; work.len()];
    while finished.iter().any(Option::is_none) {
        let (mut advanced, mut waits_for) = (false, None);
        for (at, (case, cell)) in work.iter().enumerate().filter(|(at, _)| finished[*at].is_none()).collect::<Vec<_>>()
        {
            match run.tried(case, cell, watcher)? {
                Tried::Done(done) => (finished[at], advanced) = (Some(done), true),
                Tried::Held(holder) => waits_for = waits_for.or(Some((at, holder))),
            }
        }
        if let (false, Some((at, holder))) = (advanced, waits_for) {
            run.wait(&work[at].1, &holder)?;
        }
    }
    Ok(finished.into_iter().flatten().collect())
}

/// As [`execute`], taking what is finished, with `lanes` cells at once that share the threads: films first, one after
/// the other. The same bytes; seconds are those of a cell beside others.
pub fn execute_at_once(
    plan: &Plan,
    stages: &dyn Stages,
    store: &Store,
    lanes: usize,
    watcher: &dyn Watcher,
) -> Result<Vec<FinishedCell>> {
    if lanes < 2 {
        return execute(plan, stages, store, Freshness::Resume, watcher);
    }
    let mut run = Execution::new(plan, stages, store, Freshness::Resume, watcher)?;
    run.alone = false;
    let work = run.work();
    for (case, cell) in &work {
        while let Tried::Held(holder) = run.filmed(case)? {
            run.wait(cell, &holder)?;
        }
    }
    let (queue, stopped) = (Mutex::new((0..work.len()).collect::<VecDeque<_>>()), AtomicBool::new(false));
    let outcomes: Vec<Mutex<Option<Result<FinishedCell>>>> = work.iter().map(|_| Mutex::default()).collect();
    let threads = (rayon::current_num_threads() / lanes).max(1);
    let pools = (0..lanes.min(work.len())).map(|_| rayon::ThreadPoolBuilder::new().num_threads(threads).build());
    let pools = pools.collect::<std::result::Result<Vec<_>, _>>();
    let pools = pools.map_err(|e| Error::new(ErrorKind::Environment, format!("cannot start {lanes} lanes: {e}")))?;
    let lane = |pool: &rayon::ThreadPool| {
        while !stopped.load(Ordering::SeqCst) {
            let Some(at) = lock(&queue).pop_front() else { break };
            let (case, cell) = &work[at];
            let outcome = match pool.install(|| run.tried(case, cell, &Uncounted(watcher))) {
                Ok(Tried::Held(holder)) => {
                    lock(&queue).push_back(at);
                    match run.wait(cell, &holder) {
                        Ok(()) => continue,
                        Err(error) => Err(error),
                    }
                }
                Ok(Tried::Done(finished)) => Ok(finished),
                Err(error) => Err(error),
            };
            stopped.fetch_or(outcome.is_err(), Ordering::SeqCst);
            *lock(&outcomes[at]) = Some(outcome);
        }
    };
    std::thread::scope(|scope| pools.iter().for_each(|pool| drop(scope.spawn(|| lane(pool)))));
    // Cells are taken in order, so that what was not begun stands behind the error that stopped the others.
    outcomes.iter().filter_map(|outcome| lock(outcome).take()).collect()
}

/// Whether a case's film is in the cache, made by this program from this plan, and whole.
pub fn is_filmed(plan: &Plan, store: &Store, case: &Planned) -> Result<bool> {
    let film = format!("{}/film", film_folder(plan, case)?);
    Ok(store.state(&film, &plan.sequence_key(case)?, Scrutiny::Listing)? == ProductState::Whole)
}

/// Whether a cell's prediction and score are in the cache, made by this program from this plan, and whole; its film is
/// another question ([`is_filmed`]).
pub fn is_finished(plan: &Plan, store: &Store, cell: &Cell) -> Result<bool> {
    for (product, key) in cell_products(plan, cell)? {
        if store.state(&product, &key, scrutiny_of(&product))? != ProductState::Whole {
            return Ok(false);
        }
    }
    Ok(true)
}

/// A score is read by nobody who would notice, and is small; what becomes of other damage says who stumbles over it.
fn scrutiny_of(product: &str) -> Scrutiny {
    if product.ends_with("/score") { Scrutiny::Content } else { Scrutiny::Listing }
}

/// Prediction and score of a cell: where they lie in the cache, and their keys.
fn cell_products(plan: &Plan, cell: &Cell) -> Result<[(String, String); 2]> {
    let folder = cell_folder(plan, cell)?;
    Ok([
        (format!("{folder}/prediction"), plan.prediction_key(cell)?),
        (format!("{folder}/score"), plan.score_key(cell)?),
    ])
}

/// Every product of `plan` that is finished in the cache.
fn finished_products(plan: &Plan, store: &Store) -> Result<HashMap<String, Finish>> {
    let mut products = Vec::new();
    for case in &plan.cases {
        products.push(format!("{}/film", film_folder(plan, case)?));
    }
    for cell in plan.cells() {
        products.extend(cell_products(plan, &cell)?.map(|(product, _)| product));
    }
    let finish = |product: String| store.finish(&product).map(|finish| (product, finish));
    Ok(products.into_iter().filter_map(finish).collect())
}

/// Every cell of `plan`, in its order, as it lies in the cache; what is not finished there has failed.
pub fn finished(plan: &Plan, store: &Store) -> Result<Vec<FinishedCell>> {
    let mut cells = Vec::new();
    for case in &plan.cases {
        let is_filmed = is_filmed(plan, store, case)?;
        for cell in plan.cells_of(&case.id) {
            let failure = (!is_filmed || !is_finished(plan, store, &cell)?)
                .then(|| Error::new(ErrorKind::CellFailed, format!("{} is not finished", cell.id())));
            cells.push(described(plan, store, case, &cell, failure)?);
        }
    }
    Ok(cells)
}

/// The progress of one cell among several, whose frames would count over each other.
struct Uncounted<'a>(&'a dyn Watcher);

impl Progress for Uncounted<'_> {
    fn advance(&self, _: usize, _: usize) {}

    fn cancelled(&self) -> bool {
        self.0.cancelled()
    }

    fn note(&self, sentence: &str) {
        self.0.note(sentence);
    }
}

impl<'a> Execution<'a> {
    fn new(
        plan: &'a Plan,
        stages: &'a dyn Stages,
        store: &'a Store,
        freshness: Freshness,
        watcher: &'a dyn Watcher,
    ) -> Result<Self> {
        watcher.event(&Event::Started { plan });
        let finished_before = (freshness == Freshness::Fresh).then(|| finished_products(plan, store)).transpose()?;
        Ok(Execution {
            plan,
            stages,
            store,
            finished_before,
            watcher,
            done: AtomicUsize::new(0),
            total: plan.cells().len(),
            alone: true,
            films: Mutex::default(),
            waited_for: Mutex::default(),
        })
    }

    /// Every cell with its case, in the plan's order.
    fn work(&self) -> Vec<(&'a Planned, Cell)> {
        let of_case = |case: &'a Planned| self.plan.cells_of(&case.id).into_iter().map(move |cell| (case, cell));
        self.plan.cases.iter().flat_map(of_case).collect()
    }

    /// Film and cell. The outer error stops the run, the inner one is the cell's.
    fn attempt(&self, case: &Planned, cell: &Cell, progress: &dyn Progress) -> Result<Tried<Result<()>>> {
        Ok(match self.filmed(case)? {
            Tried::Held(holder) => Tried::Held(holder),
            Tried::Done(Err(error)) => Tried::Done(Err(error)),
            Tried::Done(Ok(())) => match self.cell(case, cell, progress) {
                Ok(Tried::Held(holder)) => Tried::Held(holder),
                outcome => Tried::Done(outcome.map(|_| ())),
            },
        })
    }

    /// What `error` of a cell comes to: its own, that of a product which was damaged since it was made and is removed now, by
    /// whichever process, or of one on which another process works.
    fn mended(&self, case: &Planned, film_before: Option<Finish>, error: &Error) -> Result<Mended> {
        let Some(path) = error.path() else { return Ok(Mended::No) };
        let film = format!("{}/film", film_folder(self.plan, case)?);
        // A cache that may not be written keeps what it has, and the cell its error.
        let unusable = self.store.discard_damaged(path).unwrap_or(Unusable::Whole);
        let outcome = match unusable {
            Unusable::Removed(place) => {
                self.watcher.event(&Event::Discarded { path: &place, reason: DAMAGED });
                Mended::TryAgain
            }
            Unusable::Held(holder) => Mended::Held(holder),
            // Made again while the cell read the one before.
            Unusable::Whole if film_before.is_some() && self.store.finish(&film) != film_before => Mended::TryAgain,
            Unusable::Whole => return Ok(Mended::No),
        };
        lock(&self.films).remove(&case.id);
        Ok(outcome)
    }

    /// Runs a cell, its film first. An error stops the run.
    fn tried(&self, case: &Planned, cell: &Cell, progress: &dyn Progress) -> Result<Tried<FinishedCell>> {
        let film = format!("{}/film", film_folder(self.plan, case)?);
        let mut before = self.store.finish(&film);
        let mut outcome = self.attempt(case, cell, progress)?;
        for _ in 0..MOST_MENDED {
            let Tried::Done(Err(error)) = &outcome else { break };
            match self.mended(case, before, error)? {
                Mended::No => break,
                Mended::Held(holder) => return Ok(Tried::Held(holder)),
                Mended::TryAgain => {
                    before = self.store.finish(&film);
                    outcome = self.attempt(case, cell, progress)?;
                }
            }
        }
        let failure = match outcome {
            Tried::Held(holder) => return Ok(Tried::Held(holder)),
            Tried::Done(outcome) => outcome.err(),
        };
        if let Some(error) = &failure {
            if self.stops_the_run(error) {
                return Err(error.clone());
            }
            self.done.fetch_add(1, Ordering::SeqCst);
            self.watcher.event(&Event::CellFailed { cell, error });
        }
        Ok(Tried::Done(described(self.plan, self.store, case, cell, failure)?))
    }

    /// Films a case, once. The outer error stops the run, the inner one costs the case's cells.
    fn filmed(&self, case: &Planned) -> Result<Tried<Result<()>>> {
        if let Some(outcome) = lock(&self.films).get(&case.id) {
            return Ok(Tried::Done(outcome.clone()));
        }
        let outcome = match self.film(case) {
            Err(error) if self.stops_the_run(&error) => return Err(error),
            Ok(Tried::Held(holder)) => return Ok(Tried::Held(holder)),
            outcome => outcome.map(|_| ()),
        };
        lock(&self.films).insert(case.id.clone(), outcome.clone());
        Ok(Tried::Done(outcome))
    }

    /// Waits a moment for another process.
    fn wait(&self, cell: &Cell, holder: &Holder) -> Result<()> {
        self.watcher.proceed()?;
        if lock(&self.waited_for).insert(holder.token.clone()) {
            self.watcher.event(&Event::Waiting { cell, holder });
        }
        std::thread::sleep(LOOK_AGAIN);
        Ok(())
    }

    /// True for errors that would hit every further cell too; any other failure is reported in its cell's row.
    fn stops_the_run(&self, error: &Error) -> bool {
        match error.kind() {
            ErrorKind::Interrupted | ErrorKind::Environment => true,
            ErrorKind::InputOutput => {
                error.is_of_system() && error.path().is_some_and(|path| path.starts_with(self.store.root()))
            }
            _ => false,
        }
    }

    fn film(&self, case: &Planned) -> Result<Tried<()>> {
        let (folder, key) = (film_folder(self.plan, case)?, self.plan.sequence_key(case)?);
        let film = [(format!("{folder}/film"), key.clone())];
        let cached =
            || self.watcher.event(&Event::Filmed { case_id: &case.id, cache_use: CacheUse::Cached, wall_s: 0.0 });
        if self.is_done(&folder, &film)? {
            cached();
            return Ok(Tried::Done(()));
        }
        let work = match self.store.claim(&folder, &["film"])? {
            Ok(work) => work,
            Err(holder) => return Ok(Tried::Held(holder)),
        };
        if self.usable(&film[0], &work)? {
            cached();
        } else {
            self.watcher.event(&Event::Filming { case_id: &case.id });
            let made = self.make_film(case, &folder, &work).and_then(|wall_s| {
                work.publish("film", &key)?;
                Ok(wall_s)
            });
            let wall_s = match made {
                Err(_) if !work.is_held()? => return self.lost(&work),
                made => made?,
            };
            self.watcher.event(&Event::Filmed { case_id: &case.id, cache_use: CacheUse::Made, wall_s });
        }
        work.release().map(Tried::Done)
    }

    /// Work that another process took over while this one stood still: whatever failed, the other one's product counts.
    fn lost<T>(&self, work: &Work) -> Result<Tried<T>> {
        work.holder_now().map(Tried::Held)
    }

    fn make_film(&self, case: &Planned, folder: &str, work: &Work) -> Result<f64> {
        let timing_file = self.store.path(folder).join("timing.json");
        // What an ended process had begun is of before, too.
        let making = if self.finished_before.is_none() { work.resume("film")? } else { work.begin("film")? };
        if self.finished_before.is_some() || !making.exists() {
            claim::remove_folder(&timing_file)?;
        }
        let film = || caught(|| self.stages.film(&case.id, &making, self.watcher));
        let (outcome, timing) = measured("simulate", self.plan.sequence_cost_key(case)?, film);
        let wall_s = timing.wall_s;
        if making.exists() && work.is_held()? {
            timing::add(&timing_file, timing)?;
        }
        outcome.map(|()| wall_s)
    }

    fn cell(&self, case: &Planned, cell: &Cell, progress: &dyn Progress) -> Result<Tried<()>> {
        self.watcher.proceed()?;
        let (folder, products) = (cell_folder(self.plan, cell)?, cell_products(self.plan, cell)?);
        let (mut wall_s, mut cache_use): (f64, CacheUse) = (0.0, CacheUse::Cached);
        if !self.is_done(&folder, &products)? {
            let work = match self.store.claim(&folder, &[])? {
                Ok(work) => work,
                Err(holder) => return Ok(Tried::Held(holder)),
            };
            let [prediction, score] = &products;
            let predicted = self.usable(prediction, &work)?;
            if !predicted {
                work.discard("score")?;
            }
            // A claim may have come back with the work done.
            if !predicted || !self.usable(score, &work)? {
                cache_use = CacheUse::Made;
                self.watcher.event(&Event::CellStarted { cell });
                let sequence = self.store.path(&film_folder(self.plan, case)?).join("film");
                let timing_file = self.store.path(&folder).join("timing.json");
                let place = self.store.path(&prediction.0);
                let cost_key = self.plan.cell_cost_key(cell)?;
                let make = |(product, stage): (&str, &str), key: &str, made: &dyn Fn(&Path) -> Result<()>| {
                    let making = work.begin(product)?;
                    let (outcome, timing) = measured(stage, cost_key.clone(), || caught(|| made(&making)));
                    if let Err(error) = outcome {
                        work.abandon(product)?;
                        return Err(error);
                    }
                    let wall_s = timing.wall_s;
                    if self.alone && work.is_held()? {
                        timing::keep(&timing_file, timing)?;
                    }
                    work.publish(product, key).map(|()| wall_s)
                };
                let make_both = || {
                    let mut wall_s = 0.0;
                    if !predicted {
                        let reconstruct = |out: &Path| self.stages.reconstruct(cell, &sequence, out, progress);
                        wall_s += make(("prediction", RECONSTRUCT), &prediction.1, &reconstruct)?;
                    }
                    let scored = |out: &Path| self.stages.score(cell, &sequence, &place, &out.join("score.json"));
                    Ok(wall_s + make(("score", "score"), &score.1, &scored)?)
                };
                wall_s = match make_both() {
                    Err(_) if !work.is_held()? => return self.lost(&work),
                    made => made?,
                };
            }
            work.release()?;
        }
        let done = self.done.fetch_add(1, Ordering::SeqCst) + 1;
        self.watcher.event(&Event::CellFinished { cell, cache_use, wall_s, done, total: self.total });
        Ok(Tried::Done(()))
    }

    /// Whether all products of a piece of work are there, from the same keys, and whole, and may be used.
    fn is_done(&self, work: &str, products: &[(String, String)]) -> Result<bool> {
        for (product, key) in products {
            if !self.may_use(product) || self.store.state(product, key, scrutiny_of(product))? != ProductState::Whole {
                return Ok(false);
            }
        }
        self.store.tidy(work)?;
        Ok(true)
    }

    /// Whether a finished product counts: any, or what was made since the run began, by whichever process.
    fn may_use(&self, product: &str) -> bool {
        let Some(before) = &self.finished_before else { return true };
        self.store.finish(product).is_some_and(|finish| before.get(product) != Some(&finish))
    }

    /// True when the product of claimed work is finished, from the same key, and whole: more is made of it. Otherwise it is
    /// removed.
    fn usable(&self, (product, key): &(String, String), work: &Work) -> Result<bool> {
        let reason = match self.store.state(product, key, Scrutiny::Content)? {
            ProductState::Absent => return Ok(false),
            ProductState::Whole if self.may_use(product) => return Ok(true),
            ProductState::Whole => None,
            ProductState::Outdated => Some("it was made by another version of the program or from other input"),
            ProductState::Damaged => Some(DAMAGED),
        };
        let path = self.store.path(product);
        if let Some(reason) = reason {
            self.watcher.event(&Event::Discarded { path: &path, reason });
        }
        work.discard(product.rsplit('/').next().unwrap_or(product))?;
        Ok(false)
    }
}

/// Where the files of a cell are, and what it cost.
fn described(plan: &Plan, store: &Store, case: &Planned, cell: &Cell, failure: Option<Error>) -> Result<FinishedCell> {
    let film = store.path(&film_folder(plan, case)?);
    let folder = store.path(&cell_folder(plan, cell)?);
    let mut timings = timing::read(&film.join("timing.json"))?;
    timings.extend(timing::read(&folder.join("timing.json"))?);
    Ok(FinishedCell {
        cell: cell.clone(),
        sequence: film.join("film"),
        prediction: folder.join("prediction"),
        score: folder.join("score/score.json"),
        timings,
        failure,
    })
}

#[cfg(test)]
#[path = "executor_tests.rs"]
mod tests;
