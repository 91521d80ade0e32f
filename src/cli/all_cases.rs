//! `all-cases`: the main job. Films, reconstructs, scores, reports; resumes by default.

use std::path::{Path, PathBuf};
use std::time::Duration;

use super::selection::{CacheFolder, Selection};
use super::stopped::resumable;
use super::{Terminal, comparison};
use crate::base::{Error, ErrorKind, Progress, Result, files};
use crate::bench::claim::{Asked, Claim, Claims};
use crate::bench::store::{ProductState, cell_folder, film_folder};
use crate::bench::{Environment, FinishedCell, Freshness, Pipeline, Plan, Store, execute, finished};
use crate::report;
use crate::report::summary::summarise;
use crate::report::table::ComparisonTable;
use crate::simulate::track::Track;

/// How long to wait before a report that another run is writing is looked at again.
const WAIT: Duration = Duration::from_millis(200);

/// Arguments of `all-cases`.
#[derive(clap::Args)]
#[command(after_help = "Stop it with Ctrl-C at any time: the same command goes on from there.\n\
    Started again beside itself, on this machine or another one with the same cache, it shares the work.\n\
    Exit code 1 when a cell failed; the others are done and reported.\n\
    Example: respire-bench all-cases --profile smoke")]
pub struct AllCasesArguments {
    #[command(flatten)]
    selection: Selection,
    /// What the methods are told
    #[arg(long, value_enum, default_value = "ideal", value_name = "T")]
    track: TracksChoice,
    /// Folder of the reports; `latest` in it points to the newest
    #[arg(long, default_value = "reports", value_name = "DIR")]
    out: PathBuf,
    #[command(flatten)]
    cache: CacheFolder,
    /// Recompute everything, even what is finished
    #[arg(long)]
    fresh: bool,
    /// Print what would be done, and do nothing
    #[arg(long)]
    dry_run: bool,
    /// Make what is missing, and write no report
    #[arg(long, conflicts_with_all = ["report_only", "dry_run"])]
    cells_only: bool,
    /// Report what is finished, and make nothing; what is missing is named, and counts as failed
    #[arg(long, conflicts_with_all = ["fresh", "dry_run"])]
    report_only: bool,
}

/// The tracks that are run.
#[derive(Clone, Copy, clap::ValueEnum)]
enum TracksChoice {
    /// The paper's assumptions
    Ideal,
    /// What a hospital has (docs/clinical.md)
    Clinical,
    /// One after the other, each with a report of its own
    Both,
}

impl TracksChoice {
    fn tracks(self) -> &'static [Track] {
        match self {
            TracksChoice::Ideal => &[Track::Ideal],
            TracksChoice::Clinical => &[Track::Clinical],
            TracksChoice::Both => &[Track::Ideal, Track::Clinical],
        }
    }
}

/// Runs the plan and writes the report; `ErrorKind::CellFailed` names the cells that failed.
pub fn run(arguments: AllCasesArguments, terminal: &Terminal) -> Result<()> {
    // One after the other: what fails on one track must not keep the other from being run.
    let mut outcome = Ok(());
    for &track in arguments.track.tracks() {
        let done = run_track(&arguments, track, terminal);
        // The same command would begin anew.
        let done = if arguments.fresh { done } else { resumable(done) };
        match done {
            Err(error) if error.kind() != ErrorKind::CellFailed => return Err(error),
            Err(error) => outcome = Err(error),
            Ok(()) => {}
        }
    }
    outcome
}

fn run_track(arguments: &AllCasesArguments, track: Track, terminal: &Terminal) -> Result<()> {
    let freshness = if arguments.fresh { Freshness::Fresh } else { Freshness::Resume };
    let pipeline = arguments.selection.pipeline(track)?;
    let plan = pipeline.plan()?;
    let run_id = plan.run_id()?;
    let folder = arguments.out.join(&run_id);
    if arguments.dry_run {
        return print_plan(&plan, &Store::look(arguments.cache.path()), &folder, freshness, terminal);
    }
    if arguments.report_only {
        let finished = finished(&plan, &Store::look(arguments.cache.path()))?;
        return report(&arguments.out, &pipeline, &plan, &finished, terminal);
    }
    terminal.accepts(&pipeline.estimate())?;
    if arguments.cells_only {
        let finished = execute(&plan, &pipeline, &Store::open(arguments.cache.path())?, freshness, terminal)?;
        terminal.finish();
        return failures(&finished);
    }
    // Both folders are tried before any work: a run that cannot be written is refused now and not in ten minutes.
    claimed(&folder, terminal)?.release()?;
    let store = Store::open(arguments.cache.path())?;
    let finished = execute(&plan, &pipeline, &store, freshness, terminal)?;

    report(&arguments.out, &pipeline, &plan, &finished, terminal)
}

/// Writes the report and says which cells failed. Two runs of one plan write the same report, one after the other.
fn report(out: &Path, pipeline: &Pipeline, plan: &Plan, finished: &[FinishedCell], terminal: &Terminal) -> Result<()> {
    let run_id = plan.run_id()?;
    let folder = out.join(&run_id);
    let claim = claimed(&folder, terminal)?;
    files::remove_unfinished(&folder)?;
    let record = pipeline.record(plan, finished)?;
    terminal.stage("writing the report");
    let written = report::write(&record, &folder, terminal)?;
    files::write_json(&folder.join("environment.json"), &Environment::examine())?;
    claim.release()?;
    point_latest(out, &run_id)?;
    terminal.finish();
    for table in ComparisonTable::all(record.track, &summarise(&record)) {
        comparison::lines(&table).iter().for_each(|line| terminal.line(line));
    }
    terminal.line(format_args!("report: {}", written.html.display()));

    failures(finished)
}

/// The cells that failed, as one error.
fn failures(finished: &[FinishedCell]) -> Result<()> {
    let failed: Vec<String> = finished.iter().filter(|c| c.failure.is_some()).map(|c| c.cell.id()).collect();
    if failed.is_empty() {
        return Ok(());
    }
    let sentence = format!("{} of {} cells failed: {}", failed.len(), finished.len(), failed.join(", "));
    Err(Error::new(ErrorKind::CellFailed, sentence))
}

/// The claim of a report's folder, once nobody else writes there.
fn claimed(folder: &Path, terminal: &Terminal) -> Result<Claim> {
    let claims = Claims::default();
    loop {
        match claims.ask(folder, &[])? {
            Asked::Granted(claim) => return Ok(claim),
            Asked::Held(_) if terminal.cancelled() => return Err(Error::interrupted()),
            Asked::Held(_) => std::thread::sleep(WAIT),
        }
    }
}

fn print_plan(plan: &Plan, store: &Store, folder: &Path, freshness: Freshness, terminal: &Terminal) -> Result<()> {
    let word = |state: ProductState| match state {
        ProductState::Whole if freshness == Freshness::Resume => "cached",
        _ => "to do",
    };
    for case in &plan.cases {
        let film = store.state(&format!("{}/film", film_folder(plan, case)?), &plan.sequence_key(case)?)?;
        terminal.line(format_args!("{:<8}film {}", word(film), case.id));
        for cell in plan.cells_of(&case.id) {
            let score = format!("{}/score", cell_folder(plan, &cell)?);
            terminal.line(format_args!("{:<8}cell {}", word(store.state(&score, &plan.score_key(&cell)?)?), cell.id()));
        }
    }
    terminal.line(format_args!("report: {}", folder.display()));
    Ok(())
}

/// Lets `<out>/latest` point to the run, in one step.
fn point_latest(out: &Path, run_id: &str) -> Result<()> {
    let (latest, next) = (out.join("latest"), out.join(".latest.tmp"));
    // Left behind only by a run that was killed between the next two lines.
    let _ = std::fs::remove_file(&next);
    let linked = std::os::unix::fs::symlink(run_id, &next).and_then(|()| std::fs::rename(&next, &latest));
    linked.map_err(|e| Error::io("writing", &latest, e))
}
