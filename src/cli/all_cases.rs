//! `all-cases`: the main job. Films, reconstructs, scores, reports; resumes by default.

use std::path::{Path, PathBuf};
use std::time::Duration;

use super::selection::{CacheFolder, Selection, TracksChoice};
use super::stopped::resumable;
use super::{Terminal, comparison};
use crate::base::estimate::Estimate;
use crate::base::{Error, ErrorKind, Progress, Result, files, hash};
use crate::bench::claim::{Asked, Claim, Claims};
use crate::bench::{
    Environment, FinishedCell, Freshness, Pipeline, Plan, Store, Unusable, execute, finished, is_filmed, is_finished,
};
use crate::report::summary::summarise;
use crate::report::table::ComparisonTable;
use crate::report::{self, TrackReports};
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
    #[command(flatten)]
    tracks: TracksChoice,
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

/// Runs the plan of each track and writes the reports; `ErrorKind::CellFailed` names the cells that failed.
pub fn run(arguments: AllCasesArguments, terminal: &Terminal) -> Result<()> {
    let runs = arguments.runs()?;
    let done = run_all(&arguments, &runs, terminal);
    // The same command would begin anew.
    if arguments.fresh { done } else { resumable(done) }
}

/// What is run on one track.
struct TrackRun {
    pipeline: Pipeline,
    plan: Plan,
}

impl AllCasesArguments {
    /// Everything that was chosen, read before any work.
    fn runs(&self) -> Result<Vec<TrackRun>> {
        let of = |track: Track| {
            let pipeline = self.selection.pipeline(track)?;
            Ok(TrackRun { plan: pipeline.plan()?, pipeline })
        };
        self.tracks.tracks(&self.selection)?.into_iter().map(of).collect()
    }
}

/// The name of the report's folder: that of the run, or of the runs of two tracks together.
fn report_name(runs: &[TrackRun]) -> Result<String> {
    let ids = runs.iter().map(|run| run.plan.run_id()).collect::<Result<Vec<String>>>()?;
    match &ids[..] {
        [id] => Ok(id.clone()),
        ids => Ok(format!("{}-both-{}", runs[0].pipeline.profile().name, &hash::of_value(&ids)?[..8])),
    }
}

fn run_all(arguments: &AllCasesArguments, runs: &[TrackRun], terminal: &Terminal) -> Result<()> {
    let name = report_name(runs)?;
    let folder = arguments.out.join(&name);
    let freshness = if arguments.fresh { Freshness::Fresh } else { Freshness::Resume };
    runs.iter().find_map(|run| run.pipeline.note_on_changes()).iter().for_each(|note| terminal.note(note));
    if arguments.dry_run {
        let store = Store::look(arguments.cache.path());
        runs.iter().try_for_each(|run| print_plan(&run.plan, &store, freshness, terminal))?;
        terminal.line(format_args!("report: {}", folder.display()));
        return Ok(());
    }
    if !arguments.cells_only {
        refuse_other_latest(&arguments.out)?;
    }
    if !arguments.report_only {
        let nothing = Estimate { resumable: true, ..Estimate::default() };
        terminal.accepts(&runs.iter().map(|run| run.pipeline.estimate()).fold(nothing, Estimate::then))?;
        if !arguments.cells_only {
            // Both folders are tried before any work: a run that cannot be written is refused now and not in ten minutes.
            claimed(&folder, terminal)?.release()?;
        }
    }
    // One after the other: what fails on one track must not keep the other from being run.
    let mut reports = (runs.len() > 1).then(|| TrackReports::new(&folder));
    let (mut failed, mut cells) = (Vec::new(), 0);
    for run in runs {
        let track = run.pipeline.track().word();
        if runs.len() > 1 {
            terminal.line(format_args!("track {track}"));
        }
        let finished = if arguments.report_only {
            finished(&run.plan, &Store::look(arguments.cache.path()))?
        } else {
            execute(&run.plan, &run.pipeline, &Store::open(arguments.cache.path())?, freshness, terminal)?
        };
        if arguments.cells_only {
            terminal.finish();
        } else {
            let of_cache = |e: Error| unless_damaged(&Store::look(arguments.cache.path()), arguments.report_only, e);
            report(&folder, run, &finished, reports.as_mut(), terminal).or_else(of_cache)?;
            // The report is there, and so will be that of the next track: not every file system has links.
            point_latest(&arguments.out, &name).unwrap_or_else(|error| terminal.note(&error.to_string()));
        }
        cells += finished.len();
        let of_run = finished.iter().filter(|cell| cell.failure.is_some()).map(|cell| cell.cell.id());
        failed.extend(of_run.map(|id| if runs.len() > 1 { format!("{id} ({track})") } else { id }));
    }
    if failed.is_empty() {
        return Ok(());
    }
    let sentence = format!("{} of {cells} cells failed: {}", failed.len(), failed.join(", "));
    Err(Error::new(ErrorKind::CellFailed, sentence))
}

/// What keeps a report from being written: what it says, or a product of the cache that was damaged since it was made. It is
/// removed, so that the next run makes it again; a run that only reads leaves it there.
fn unless_damaged(store: &Store, report_only: bool, error: Error) -> Result<()> {
    let Some(path) = error.path() else { return Err(error) };
    if report_only {
        let sentence = "was damaged in the cache: the same command without --report-only makes it again";
        return Err(store.damaged(path).map_or(error.clone(), |place| Error::input(sentence).at(place)));
    }
    match store.discard_damaged(path) {
        Ok(Unusable::Removed(place)) => {
            let sentence = "was damaged in the cache and is removed now: the same command makes it again";
            Err(Error::input(sentence).at(place))
        }
        _ => Err(error),
    }
}

/// Writes the report of a run into `folder`, or into its own folder there, and prints its table. Two runs of one plan write
/// the same report, one after the other.
fn report(
    folder: &Path,
    run: &TrackRun,
    finished: &[FinishedCell],
    reports: Option<&mut TrackReports<'_>>,
    terminal: &Terminal,
) -> Result<()> {
    let claim = claimed(folder, terminal)?;
    files::remove_unfinished(folder)?;
    let record = run.pipeline.record(&run.plan, finished)?;
    terminal.stage("writing the report");
    let tables = ComparisonTable::all(record.track, &summarise(&record));
    let written = match reports {
        None => report::write(&record, folder, terminal)?,
        Some(reports) => reports.add(record, terminal)?,
    };
    files::write_json(&written.markdown.with_file_name("environment.json"), &Environment::examine())?;
    claim.release()?;
    terminal.finish();
    for table in &tables {
        comparison::lines(table).iter().for_each(|line| terminal.line(line));
    }
    terminal.line(format_args!("report: {}", written.html.display()));
    Ok(())
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

fn print_plan(plan: &Plan, store: &Store, freshness: Freshness, terminal: &Terminal) -> Result<()> {
    let word = |is_there: bool| if is_there && freshness == Freshness::Resume { "cached" } else { "to do" };
    for case in &plan.cases {
        terminal.line(format_args!("{:<8}film {}", word(is_filmed(plan, store, case)?), case.id));
        for cell in plan.cells_of(&case.id) {
            terminal.line(format_args!("{:<8}cell {}", word(is_finished(plan, store, &cell)?), cell.id()));
        }
    }
    Ok(())
}

/// Refuses an output folder in which something else than a link is called `latest`: a copy of reports, for instance, that
/// resolved the link.
fn refuse_other_latest(out: &Path) -> Result<()> {
    let latest = out.join("latest");
    match std::fs::symlink_metadata(&latest) {
        Ok(data) if !data.is_symlink() => {
            Err(Error::input("is no link to the newest report, which would take its place: rename it").at(latest))
        }
        _ => Ok(()),
    }
}

/// Lets `<out>/latest` point to the run, in one step, whoever else ends at this moment.
fn point_latest(out: &Path, run_id: &str) -> Result<()> {
    let latest = out.join("latest");
    let link = tempfile::Builder::new().prefix(".latest").make_in(out, |next| std::os::unix::fs::symlink(run_id, next));
    let linked = link.and_then(|link| link.persist(&latest).map_err(|e| e.error));
    linked.map(|_| ()).map_err(|e| Error::io("writing", &latest, e))
}
