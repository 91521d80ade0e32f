//! `ablate`: what each part of a method, and each property of a film, is worth.

use std::path::PathBuf;

use crate::base::{Result, files};
use crate::bench::{Ablations, FinishedCell, Freshness, Pipeline, Store, Variant, execute};
use crate::cli::Terminal;
use crate::cli::selection::Places;
use crate::report::ablation::{VariantScores, write};
use crate::score::CellScore;

/// Arguments of `ablate`.
#[derive(clap::Args)]
#[command(
    after_help = "Runs the lines of bench-cases/ablations.toml, and each of their methods as shipped with several seeds: \
    the spread between seeds is the noise below which a difference says nothing. Finished cells are kept.\n\
    Example: respire-bench ablate --only activation --out reports/ablations"
)]
pub struct Arguments {
    /// Groups of the file; all when not given
    #[arg(long, value_delimiter = ',', value_name = "GROUP,..")]
    only: Vec<String>,
    /// Cases by id; the file's when not given
    #[arg(long, value_delimiter = ',', value_name = "CASE,..")]
    cases: Vec<String>,
    /// How much of everything: smoke, quick, paper, or the path of a profile file
    #[arg(long, default_value = "quick", value_name = "P")]
    profile: String,
    /// Folder for ablations.csv and ablations.md
    #[arg(long, default_value = "reports/ablations", value_name = "DIR")]
    out: PathBuf,
    /// Folder of sequences and finished cells
    #[arg(long, default_value = ".cache", value_name = "DIR")]
    cache: PathBuf,
    #[command(flatten)]
    places: Places,
}

/// Runs the variants and writes the table.
pub fn run(arguments: Arguments, terminal: &Terminal) -> Result<()> {
    let catalogue = arguments.places.catalogue()?;
    let only = (!arguments.only.is_empty()).then_some(&arguments.only[..]);
    let ablations = Ablations::load(&catalogue.ablations_file(), only)?;
    let cases = if arguments.cases.is_empty() { &ablations.cases } else { &arguments.cases };
    let shipped = ablations.methods();
    let shipped = shipped.iter().map(|method| (Variant::shipped(method), &ablations.noise_seeds[..]));
    let varied = ablations.ablation.iter().map(|v| (v.clone(), &ablations.noise_seeds[..1]));
    let mut stages = Vec::new();
    for (variant, seeds) in shipped.chain(varied) {
        // All are read before the first is run: a mistake in the last line shows now.
        let pipeline = Pipeline::of_variant(&catalogue, &arguments.profile, cases, seeds, &variant)?;
        stages.push((variant, pipeline));
    }
    let mut store = Store::open(&arguments.cache)?;
    let mut all = Vec::new();
    let count = stages.len();
    for (i, (variant, pipeline)) in stages.into_iter().enumerate() {
        let group = if variant.group.is_empty() { "as shipped" } else { &variant.group };
        terminal.stage(format!("{} of {count}: {} {group} {}", i + 1, variant.method, variant.setting).trim_end());
        let finished = execute(&pipeline.plan()?, &pipeline, &mut store, Freshness::Resume, terminal)?;
        let scored = finished.iter().filter(|cell| cell.failure.is_none());
        let read = |cell: &FinishedCell| {
            let score: CellScore = files::read_json(&cell.score)?;
            // A score may have been made, and kept, before it knew its seed.
            Ok(CellScore { seed: cell.cell.seed, ..score })
        };
        let cells = scored.map(read).collect::<Result<Vec<_>>>()?;
        all.push(VariantScores {
            group: variant.group,
            setting: variant.setting,
            method: variant.method,
            failed: finished.len() - cells.len(),
            cells,
        });
        // After every variant, so that a long run can be looked at, and stopped.
        let title = format!("Profile `{}`, cases {}", arguments.profile, cases.join(", "));
        write(&all, &title, &arguments.out)?;
    }
    terminal.finish();
    terminal.line(files::read_text(&arguments.out.join("ablations.md"))?.trim_end());
    Ok(())
}
