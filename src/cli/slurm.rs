//! `respire-bench slurm`: the main job as a Slurm job array.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use rayon::prelude::*;

use super::Terminal;
use super::selection::{CacheFolder, Selection, TracksChoice, absolute_path};
use crate::base::range::{NumberRange, PROCESSORS};
use crate::base::{Error, ErrorKind, Result, files};
use crate::bench::array_job::{ArrayJob, WorkCost};
use crate::bench::{Cell, Pipeline, Plan, Planned, Store, is_filmed, is_finished, timing};

/// Tasks at a time.
const AT_ONCE: NumberRange = NumberRange::new(1.0, 10_000.0);

/// What one task makes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Task {
    /// One case x one method x one seed.
    Cell,
    /// A case with all its methods and seeds.
    Case,
}

/// Arguments of `slurm`.
#[derive(clap::Args)]
#[command(
    after_help = "Writes work.txt, task.sh, report.sh and submit.sh into DIR; nothing is submitted. `bash DIR/submit.sh`\n\
    submits an array, and a job that writes the report when the array has ended. Cells that are finished are left out,\n\
    so that the same command makes the scripts for what failed. DIR, the cache and the reports must be folders that all\n\
    nodes see.\n\
    Example: respire-bench slurm --profile smoke --scripts slurm"
)]
pub struct SlurmArguments {
    #[command(flatten)]
    selection: Selection,
    #[command(flatten)]
    tracks: TracksChoice,
    /// An array of tasks, which is what is written with or without it
    #[arg(long)]
    array: bool,
    /// Folder of the scripts and of what the tasks print
    #[arg(long, value_name = "DIR")]
    scripts: PathBuf,
    /// What one task makes
    #[arg(long, value_enum, default_value = "cell", value_name = "T")]
    task: Task,
    /// Most tasks at a time
    #[arg(long, default_value_t = 100, value_name = "N", value_parser = AT_ONCE.parser::<usize>())]
    at_once: usize,
    /// Processors of a task
    #[arg(long, default_value_t = 2, value_name = "N", value_parser = PROCESSORS.parser::<usize>())]
    processors: usize,
    /// Folder of the reports
    #[arg(long, default_value = "reports", value_name = "DIR")]
    out: PathBuf,
    #[command(flatten)]
    cache: CacheFolder,
}

/// Writes the scripts, and says how much there is to do.
pub fn run(arguments: SlurmArguments, terminal: &Terminal) -> Result<()> {
    let tracks = arguments.tracks.tracks(&arguments.selection)?;
    // Nobody can be asked in a task, and the array asks Slurm for what a task needs.
    let mut common = ["all-cases", "--yes"].map(str::to_owned).to_vec();
    common.extend(arguments.selection.place_words()?);
    common.extend([
        "--out".to_owned(),
        absolute_path(&arguments.out)?,
        "--cache".to_owned(),
        absolute_path(arguments.cache.path())?,
    ]);
    let scripts = absolute_path(&arguments.scripts)?;
    // A line of a script that Slurm reads ends there, and it takes the other one for an escape.
    if scripts.contains(['\n', '\\']) {
        return Err(Error::usage(
            "--scripts: Slurm cannot write into a folder with a line break or a backslash in its path",
        ));
    }
    let (wishes, rows) = (arguments.selection.case_wishes()?, arguments.selection.row_words());
    let on_track = |track: &str| ["--track", track].map(str::to_owned).to_vec();
    let of_case = |wish: &String| vec!["--cases".to_owned(), wish.clone()];
    let all_tracks = if let [track] = tracks[..] { track.word() } else { "both" };
    if let Some(wish) = wishes.iter().find(|wish| wish.contains(',')) {
        let sentence = "a case file with a comma in its path would be two on the command line of a task: rename it";
        return Err(Error::usage(sentence).at(wish));
    }
    // The profile has its list, and that of a large plan is longer than a command line may be.
    let chosen = if arguments.selection.has_cases() { &wishes[..] } else { &[] };
    let everything = [on_track(all_tracks), chosen.iter().flat_map(of_case).collect(), rows.clone()].concat();
    terminal.stage("looking for what is finished");
    let store = Store::look(arguments.cache.path());
    let measured = timing::measured_costs(store.root());
    let (mut work, mut cost, mut report_cost) = (Vec::new(), WorkCost::default(), WorkCost::default());
    let (mut missing, mut all) = (0, 0);
    for track in tracks {
        let pipeline = arguments.selection.pipeline(track)?;
        let plan = pipeline.plan()?;
        let costs = Costs { pipeline: &pipeline, plan: &plan, measured: &measured };
        report_cost = report_cost.then(pipeline.report_cost());
        all += plan.cells().len();
        for (case, wish) in plan.cases.iter().zip(&wishes) {
            let is_filmed = is_filmed(&plan, &store, case)?;
            // Those of a large plan are a million files.
            let is_missing = |cell: Cell| match is_filmed && is_finished(&plan, &store, &cell)? {
                true => Ok(None),
                false => Ok(Some(cell)),
            };
            let looked: Vec<Option<Cell>> =
                plan.cells_of(&case.id).into_par_iter().map(is_missing).collect::<Result<_>>()?;
            let cells: Vec<Cell> = looked.into_iter().flatten().collect();
            missing += cells.len();
            match arguments.task {
                Task::Cell => {
                    for cell in &cells {
                        let row = ["--methods", &cell.method, "--seeds", &cell.seed.to_string()].map(str::to_owned);
                        work.push([on_track(track.word()), of_case(wish), row.to_vec()].concat());
                        cost = cost.or(costs.of_task(case, std::slice::from_ref(cell))?);
                    }
                }
                Task::Case if !cells.is_empty() => {
                    work.push([on_track(track.word()), of_case(wish), rows.clone()].concat());
                    cost = cost.or(costs.of_task(case, &cells)?);
                }
                Task::Case => {}
            }
        }
    }
    if work.is_empty() {
        terminal.line("every cell is finished; `all-cases` writes the report");
        return Ok(());
    }
    let program = std::env::current_exe()
        .map_err(|e| Error::new(ErrorKind::Environment, format!("this program's own path is not known: {e}")))?;
    let job = ArrayJob {
        program: program.to_string_lossy().into_owned(),
        common,
        work,
        everything,
        started_in: absolute_path(Path::new("."))?,
        folder: scripts,
        processors: arguments.processors,
        at_once: arguments.at_once,
        cost,
        report_cost,
    };
    let write = |name: &str, text: String| files::write_bytes(&arguments.scripts.join(name), text.as_bytes());
    write("work.txt", job.work_file())?;
    write("task.sh", job.task_script())?;
    write("report.sh", job.report_script())?;
    write("submit.sh", job.submit_script())?;
    terminal.line(format_args!(
        "{missing} of {all} cells to do in {} tasks; submit them by: {}",
        job.tasks(),
        job.submit_command()
    ));
    Ok(())
}

/// What work is expected to cost.
struct Costs<'a> {
    pipeline: &'a Pipeline,
    plan: &'a Plan,
    /// By the plan's cost keys.
    measured: &'a HashMap<String, WorkCost>,
}

impl Costs<'_> {
    /// A task that makes `cells` of `case`, its film included: as measured where all of it was run before, with
    /// whatever revision and seed, by the model otherwise.
    fn of_task(&self, case: &Planned, cells: &[Cell]) -> Result<WorkCost> {
        let mut keys = vec![self.plan.sequence_cost_key(case)?];
        for cell in cells {
            keys.push(self.plan.cell_cost_key(cell)?);
        }
        let measured: Option<Vec<WorkCost>> = keys.iter().map(|key| self.measured.get(key).copied()).collect();
        let costs = measured.unwrap_or_else(|| cells.iter().map(|cell| self.pipeline.cell_cost(cell)).collect());
        Ok(costs.into_iter().fold(WorkCost::default(), WorkCost::then))
    }
}
