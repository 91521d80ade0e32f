//! Runs a plan: film what is not filmed, reconstruct what is not reconstructed, score what is not scored.
//!
//! Cells run one after the other, each on all threads, so that their timings do not disturb one another; or, where many
//! are to be compared and time is short, several at once ([`execute_at_once`]). A cell that fails does not stop the others. What stops a run: the user, a full or unwritable disk, a machine that lacks
//! something; whatever is finished by then is kept, and the same command goes on from there.

use std::fs::{self, File};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use super::event::{CacheUse, Event, Watcher};
use super::plan::{Cell, Plan, Planned};
use super::stages::Stages;
use super::store::{ProductState, Store, cell_folder, sequence_product};
use super::timing::{self, StageTiming, measured};
use crate::base::{Error, ErrorKind, Progress, Result};

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

struct Execution<'a> {
    plan: &'a Plan,
    stages: &'a dyn Stages,
    root: PathBuf,
    store: Mutex<&'a mut Store>,
    freshness: Freshness,
    watcher: &'a dyn Watcher,
    done: AtomicUsize,
    /// Whether what a cell cost is kept: not where it shared the machine, and CPU seconds are those of all.
    alone: bool,
}

/// Runs every cell of `plan`; the answer has one entry per cell, in the plan's order, failed ones included.
pub fn execute(
    plan: &Plan,
    stages: &dyn Stages,
    store: &mut Store,
    freshness: Freshness,
    watcher: &dyn Watcher,
) -> Result<Vec<FinishedCell>> {
    let run = Execution::new(plan, stages, store, freshness, watcher);
    let mut finished = Vec::new();
    for case in &plan.cases {
        let filmed = run.filmed(case)?;
        for cell in plan.cells_of(&case.id) {
            finished.push(run.finished(case, &cell, &filmed, watcher)?);
        }
    }
    Ok(finished)
}

/// As [`execute`], taking what is finished, with `lanes` cells at once that share the threads: films first, one after
/// the other. The same bytes; seconds are those of a cell beside others.
pub fn execute_at_once(
    plan: &Plan,
    stages: &dyn Stages,
    store: &mut Store,
    lanes: usize,
    watcher: &dyn Watcher,
) -> Result<Vec<FinishedCell>> {
    if lanes < 2 {
        return execute(plan, stages, store, Freshness::Resume, watcher);
    }
    let mut run = Execution::new(plan, stages, store, Freshness::Resume, watcher);
    let films = plan.cases.iter().map(|case| run.filmed(case)).collect::<Result<Vec<_>>>()?;
    run.alone = false;
    let work: Vec<_> = plan
        .cases
        .iter()
        .zip(&films)
        .flat_map(|(case, filmed)| plan.cells_of(&case.id).into_iter().map(move |cell| (case, cell, filmed)))
        .collect();
    let (next, stopped) = (AtomicUsize::new(0), AtomicBool::new(false));
    let outcomes: Vec<Mutex<Option<Result<FinishedCell>>>> = work.iter().map(|_| Mutex::default()).collect();
    let threads = (rayon::current_num_threads() / lanes).max(1);
    let pools = (0..lanes.min(work.len())).map(|_| rayon::ThreadPoolBuilder::new().num_threads(threads).build());
    let pools = pools.collect::<std::result::Result<Vec<_>, _>>();
    let pools = pools.map_err(|e| Error::new(ErrorKind::Environment, format!("cannot start {lanes} lanes: {e}")))?;
    let lane = |pool: &rayon::ThreadPool| {
        while !stopped.load(Ordering::SeqCst) {
            let at = next.fetch_add(1, Ordering::SeqCst);
            let Some((case, cell, filmed)) = work.get(at) else { break };
            let outcome = pool.install(|| run.finished(case, cell, filmed, &Uncounted(watcher)));
            stopped.fetch_or(outcome.is_err(), Ordering::SeqCst);
            *lock(&outcomes[at]) = Some(outcome);
        }
    };
    std::thread::scope(|scope| pools.iter().for_each(|pool| drop(scope.spawn(|| lane(pool)))));
    // Cells are taken in order, so that what was not begun stands behind the error that stopped the others.
    outcomes.iter().filter_map(|outcome| lock(outcome).take()).collect()
}

/// Nothing is left half done by a panic: those of stages are caught.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
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
        store: &'a mut Store,
        freshness: Freshness,
        watcher: &'a dyn Watcher,
    ) -> Self {
        watcher.event(&Event::Started { plan });
        let (root, done) = (store.root().to_path_buf(), AtomicUsize::new(0));
        Execution { plan, stages, root, store: Mutex::new(store), freshness, watcher, done, alone: true }
    }

    /// Films a case. The outer error stops the run, the inner one costs the case's cells.
    fn filmed(&self, case: &Planned) -> Result<Result<()>> {
        match self.film(case) {
            Err(error) if self.stops_the_run(&error) => Err(error),
            filmed => Ok(filmed),
        }
    }

    /// Runs a cell whose film was tried. An error stops the run.
    fn finished(
        &self,
        case: &Planned,
        cell: &Cell,
        filmed: &Result<()>,
        progress: &dyn Progress,
    ) -> Result<FinishedCell> {
        let failure = match filmed {
            Err(error) => Some(error.clone()),
            Ok(()) => self.cell(cell, progress).err(),
        };
        if let Some(error) = &failure {
            if self.stops_the_run(error) {
                return Err(error.clone());
            }
            self.done.fetch_add(1, Ordering::SeqCst);
            self.watcher.event(&Event::CellFailed { cell, error });
        }
        self.describe(case, cell, failure)
    }

    fn path(&self, product: &str) -> PathBuf {
        self.root.join(product)
    }

    /// True for errors that would hit every further cell too; any other failure is reported in its cell's row.
    fn stops_the_run(&self, error: &Error) -> bool {
        match error.kind() {
            ErrorKind::Interrupted | ErrorKind::Environment => true,
            ErrorKind::InputOutput => error.path().is_some_and(|path| path.starts_with(&self.root)),
            _ => false,
        }
    }

    fn film(&self, case: &Planned) -> Result<()> {
        let (product, key) = sequence_product(self.plan, case)?;
        let folder = self.path(&product);
        let timing_file = folder.with_extension("timing.json");
        if self.usable(&product, &key)? {
            self.watcher.event(&Event::Filmed { case_id: &case.id, cache_use: CacheUse::Cached, wall_s: 0.0 });
            return Ok(());
        }
        if !folder.exists() {
            remove_if_there(&timing_file)?;
        }
        self.watcher.event(&Event::Filming { case_id: &case.id });
        let work = || caught(|| self.stages.film(&case.id, &folder, self.watcher));
        let (outcome, timing) = measured("simulate", work);
        let wall_s = timing.wall_s;
        if folder.exists() {
            timing::add(&timing_file, timing)?;
        }
        outcome?;
        lock(&self.store).commit(&product, &key)?;
        self.watcher.event(&Event::Filmed { case_id: &case.id, cache_use: CacheUse::Made, wall_s });
        Ok(())
    }

    fn cell(&self, cell: &Cell, progress: &dyn Progress) -> Result<()> {
        if self.watcher.cancelled() {
            return Err(Error::interrupted());
        }
        let folder = cell_folder(self.plan, cell)?;
        let case = self.plan.cases.iter().find(|c| c.id == cell.case_id).expect("cells are made from the plan's cases");
        let sequence = self.path(&sequence_product(self.plan, case)?.0);
        let (prediction, score) = (format!("{folder}/prediction"), format!("{folder}/score.json"));
        let (prediction_key, score_key) = (self.plan.prediction_key(cell)?, self.plan.score_key(cell)?);
        let timing_file = self.path(&folder).join("timing.json");

        let mut wall_s = 0.0;
        let mut started = false;
        if !self.usable(&prediction, &prediction_key)? {
            self.watcher.event(&Event::CellStarted { cell });
            started = true;
            lock(&self.store).discard(&score)?;
            let timing = self.reconstruct(cell, &sequence, &prediction, progress)?;
            wall_s += timing.wall_s;
            self.keep(&timing_file, timing)?;
            lock(&self.store).commit(&prediction, &prediction_key)?;
        }
        let rescored = !self.usable(&score, &score_key)?;
        if rescored {
            if !started {
                self.watcher.event(&Event::CellStarted { cell });
            }
            let (prediction_path, score_path) = (self.path(&prediction), self.path(&score));
            let work = || caught(|| self.stages.score(cell, &sequence, &prediction_path, &score_path));
            let (outcome, timing) = measured("score", work);
            outcome?;
            wall_s += timing.wall_s;
            self.keep(&timing_file, timing)?;
            lock(&self.store).commit(&score, &score_key)?;
        }
        let cache_use = if started || rescored { CacheUse::Made } else { CacheUse::Cached };
        let (done, total) = (self.done.fetch_add(1, Ordering::SeqCst) + 1, self.plan.cells().len());
        self.watcher.event(&Event::CellFinished { cell, cache_use, wall_s, done, total });
        Ok(())
    }

    fn keep(&self, file: &Path, timing: StageTiming) -> Result<()> {
        if self.alone { timing::keep(file, timing) } else { Ok(()) }
    }

    /// Makes the prediction under another name and then renames it, so that readers see a whole one or none.
    fn reconstruct(
        &self,
        cell: &Cell,
        sequence: &Path,
        prediction: &str,
        progress: &dyn Progress,
    ) -> Result<StageTiming> {
        let whole = self.path(prediction);
        let partial = whole.with_file_name(".partial");
        lock(&self.store).discard(prediction)?;
        remove_folder_if_there(&partial)?;
        fs::create_dir_all(&partial).map_err(|e| Error::io("making the folder", &partial, e))?;
        let work = || caught(|| self.stages.reconstruct(cell, sequence, &partial, progress));
        let (outcome, timing) = measured("reconstruct", work);
        if let Err(error) = outcome {
            remove_folder_if_there(&partial)?;
            return Err(error);
        }
        let parent = whole.parent().expect("a prediction lies in the cell's folder");
        let moved = fs::rename(&partial, &whole).and_then(|()| File::open(parent)?.sync_all());
        moved.map_err(|e| Error::io("writing", &whole, e))?;
        Ok(timing)
    }

    /// True when the product is finished, from the same key, and whole. Otherwise the files of a *finished*
    /// product are removed; those that an interrupted stage left behind stay, so that the stage can resume.
    fn usable(&self, product: &str, key: &str) -> Result<bool> {
        let state = lock(&self.store).state(product, key);
        let path = self.path(product);
        let reason = match (state, self.freshness) {
            (ProductState::Whole, Freshness::Resume) => return Ok(true),
            (ProductState::Absent, Freshness::Resume) => return Ok(false),
            (ProductState::Absent | ProductState::Whole, Freshness::Fresh) => None,
            (ProductState::Outdated, _) => Some("it was made by another version of the program or from other input"),
            (ProductState::Damaged, _) => Some("its files are not what they were when it was finished"),
        };
        if let Some(reason) = reason {
            self.watcher.event(&Event::Discarded { path: &path, reason });
        }
        lock(&self.store).discard(product)?;
        Ok(false)
    }

    fn describe(&self, case: &Planned, cell: &Cell, failure: Option<Error>) -> Result<FinishedCell> {
        let sequence = self.path(&sequence_product(self.plan, case)?.0);
        let folder = self.path(&cell_folder(self.plan, cell)?);
        let mut timings = timing::read(&sequence.with_extension("timing.json"))?;
        timings.extend(timing::read(&folder.join("timing.json"))?);
        Ok(FinishedCell {
            cell: cell.clone(),
            sequence,
            prediction: folder.join("prediction"),
            score: folder.join("score.json"),
            timings,
            failure,
        })
    }
}

/// A panic is a bug of one stage; it costs its cell, not the run.
fn caught<T>(work: impl FnOnce() -> Result<T>) -> Result<T> {
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|payload| {
        let text = payload.downcast_ref::<String>().map(String::as_str);
        let text = text.or_else(|| payload.downcast_ref::<&str>().copied()).unwrap_or("no message");
        Err(Error::new(ErrorKind::CellFailed, format!("a bug in the program: {text}")))
    })
}

fn remove_if_there(path: &Path) -> Result<()> {
    match fs::remove_file(path) {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => Err(Error::io("removing", path, e)),
        _ => Ok(()),
    }
}

fn remove_folder_if_there(path: &Path) -> Result<()> {
    match fs::remove_dir_all(path) {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => Err(Error::io("removing", path, e)),
        _ => Ok(()),
    }
}

#[cfg(test)]
#[path = "executor_tests.rs"]
mod tests;
