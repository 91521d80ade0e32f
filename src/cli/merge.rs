//! `merge`: several runs, or scores of a third party, as one report.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::{Terminal, comparison};
use crate::base::{Error, Result, files};
use crate::report::merge::{Films, Part, merge};
use crate::report::read_back::{PartEvidence, read_environments, read_run};
use crate::report::summary::summarise;
use crate::report::table::ComparisonTable;
use crate::report::{self, Run};

/// Arguments of `merge`.
#[derive(clap::Args)]
#[command(
    after_help = "For cells that were run on several machines, rows that were renewed, and predictions of another program \
    beside the methods. A cell that several runs have is taken from the last, and the report names it; a prediction \
    never takes the place of another one, or of a method. Cases that only predictions have are listed and rank nobody; \
    times that were not measured beside the others have no place. A report must be whole (manifest.json, frames.csv), as \
    `all-cases` leaves it; --unchecked takes less. Films, airways and contours are those \
    that the runs kept; panels need films and predictions and are left out. Runs of different tracks share a page and no table: \
    each track has a folder of its own in --out.\n\
    Example: respire-bench merge reports/latest mine/case1 mine/case2 --out table"
)]
pub struct MergeArguments {
    /// Report folders, of `all-cases` or of `evaluate --out`; of both tracks' reports all that are in it
    #[arg(value_name = "DIR", required = true, num_args = 1..)]
    runs: Vec<PathBuf>,
    /// Folder of the merged report
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Merge reports without manifest.json, frames.csv or timings.csv too, and metrics that are defined otherwise now (which
    /// are left out); the report says which rows were not checked
    #[arg(long)]
    unchecked: bool,
    /// Merge scores of different films of a case (another revision of the simulator) too; the report says which they
    /// are
    #[arg(long)]
    other_films: bool,
}

/// Reads, merges, writes, and prints the table.
pub fn run(arguments: MergeArguments, terminal: &Terminal) -> Result<()> {
    report::refuse_other_folder(&arguments.out)?;
    terminal.stage("reading the runs");
    let evidence = if arguments.unchecked { PartEvidence::Waived } else { PartEvidence::Needed };
    let part = |folder: PathBuf| Ok(Part { run: read_run(&folder, evidence)?, folder });
    let parts =
        arguments.runs.iter().flat_map(|folder| whole_reports(folder)).map(part).collect::<Result<Vec<Part>>>()?;
    if let Some(folder) = arguments.runs.iter().find(|folder| same_folder(folder, &arguments.out)) {
        return Err(Error::usage(format!("--out is one of the runs: {}", folder.display())));
    }
    let mut environments: BTreeMap<String, serde_json::Value> = BTreeMap::new();
    for part in &parts {
        environments.extend(read_environments(&part.folder, &part.run.id)?);
    }
    let films = if arguments.other_films { Films::Other } else { Films::Same };
    let merged = by_track(parts).into_iter().map(|parts| merge(parts, films)).collect::<Result<Vec<Run>>>()?;
    terminal.stage("writing the report");
    let written = report::write_tracks(&merged, &arguments.out, terminal)?;
    files::write_json(&arguments.out.join("environments.json"), &environments)?;
    terminal.finish();
    for run in &merged {
        if merged.len() > 1 {
            terminal.line(format_args!("track {}", run.track.word()));
        }
        for table in ComparisonTable::all(run.track, &summarise(run)) {
            comparison::lines(&table).iter().for_each(|line| terminal.line(line));
        }
    }
    terminal.line(format_args!("report: {}", written.html.display()));
    Ok(())
}

/// `folder`, or the reports of the tracks that it holds.
fn whole_reports(folder: &Path) -> Vec<PathBuf> {
    let of_tracks = report::track_folders(folder);
    if of_tracks.is_empty() { vec![folder.to_owned()] } else { of_tracks }
}

/// The parts of each track, tracks in the order in which they come.
fn by_track(parts: Vec<Part>) -> Vec<Vec<Part>> {
    let mut tracks: Vec<Vec<Part>> = Vec::new();
    for part in parts {
        match tracks.iter_mut().find(|of_track| of_track[0].run.track == part.run.track) {
            Some(of_track) => of_track.push(part),
            None => tracks.push(vec![part]),
        }
    }
    tracks
}

fn same_folder(a: &Path, b: &Path) -> bool {
    a.canonicalize().ok().zip(b.canonicalize().ok()).is_some_and(|(a, b)| a == b)
}
