//! `run`: one cell, one case x one method x one seed.

use std::path::PathBuf;

use super::Terminal;
use super::selection::{CacheFolder, CatalogueFolder, PoseChoice, ProfileChoice, TrackChoice};
use super::stopped::resumable;
use crate::base::range::SEED;
use crate::base::{Progress, Result, files};
use crate::bench::{Freshness, Pipeline, SeededMethod, Store, Wishes, execute, reconstruct_folder};
use crate::score::{self, CellScore};

/// Arguments of `run`.
#[derive(clap::Args)]
#[command(
    after_help = "With --sequence, the method answers a film that is there already, a participant's folder among them \
    (simulate --blind), and its prediction is written to --out; `evaluate` scores it.\n\
    Example: respire-bench run --case case1 --method ours --profile smoke"
)]
pub struct RunArguments {
    /// Case by id, or the path of a case file
    #[arg(long, value_name = "CASE", required_unless_present = "sequence")]
    case: Option<String>,
    /// A film or a participant's folder, in place of a case
    #[arg(long, value_name = "DIR", conflicts_with_all = ["case", "track", "cache", "fresh", "json"], requires = "out")]
    sequence: Option<PathBuf>,
    /// New folder of the prediction of --sequence
    #[arg(long, value_name = "DIR", requires = "sequence", conflicts_with = "case")]
    out: Option<PathBuf>,
    /// Method by id
    #[arg(long, value_name = "METHOD")]
    method: String,
    #[command(flatten)]
    track: TrackChoice,
    /// Seed of the method's randomness
    #[arg(long, default_value_t = 1, value_name = "N", value_parser = SEED.parser::<u64>())]
    seed: u64,
    #[command(flatten)]
    profile: ProfileChoice,
    #[command(flatten)]
    cache: CacheFolder,
    /// Recompute it even when it is finished
    #[arg(long)]
    fresh: bool,
    /// Write the score as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    poses: PoseChoice,
    #[command(flatten)]
    catalogue: CatalogueFolder,
}

/// Runs the cell and prints its score.
pub fn run(arguments: RunArguments, terminal: &Terminal) -> Result<()> {
    let methods = arguments.poses.rows(Some(vec![arguments.method]))?;
    if let (Some(film), Some(out)) = (&arguments.sequence, &arguments.out) {
        let catalogue = arguments.catalogue.open()?;
        for id in methods.iter().flatten() {
            terminal.stage(format!("{id}: {}", film.display()));
            let method = SeededMethod { id, seed: arguments.seed };
            reconstruct_folder(&catalogue, arguments.profile.name(), method, film, out, terminal)?;
        }
        terminal.finish();
        terminal.line(format_args!("prediction: {}", out.display()));
        return Ok(());
    }
    let track = arguments.track.track();
    let (cases, seeds) = (arguments.case.map(|case| vec![case]), Some(vec![arguments.seed]));
    let wishes = Wishes { cases, methods, seeds, track };
    let pipeline = Pipeline::new(&arguments.catalogue.open()?, arguments.profile.name(), wishes)?;
    terminal.accepts(&pipeline.estimate())?;
    let freshness = if arguments.fresh { Freshness::Fresh } else { Freshness::Resume };
    let store = Store::open(arguments.cache.path())?;
    let finished = execute(&pipeline.plan()?, &pipeline, &store, freshness, terminal);
    // With --fresh, the same command would begin anew.
    let finished = if arguments.fresh { finished? } else { resumable(finished)? };
    for cell in finished {
        if let Some(error) = cell.failure {
            return Err(error);
        }
        let scored: CellScore = files::read_json(&cell.score)?;
        if arguments.json {
            terminal.json(&scored)?;
            continue;
        }
        for metric in score::registry() {
            let value = scored.value(metric.id).map_or_else(|| "-".to_owned(), |value| metric.format(value));
            terminal.line(format_args!("{:<28}{value:>12} {}", metric.id, metric.unit));
        }
        terminal.line(format_args!("prediction: {}", cell.prediction.display()));
        terminal.line(format_args!("sequence:   {}", cell.sequence.display()));
    }
    Ok(())
}
