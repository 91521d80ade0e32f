//! `ablate`: what each part of a method, and each property of a film, is worth.

use std::path::PathBuf;

use super::Terminal;
use super::selection::CatalogueFolder;
use crate::base::{Result, files};
use crate::bench::Ablations;
use crate::experiments::ablation::{AblationPlan, run as run_variants};
use crate::report::ablation::write;

/// Arguments of `ablate`.
#[derive(clap::Args)]
#[command(
    after_help = "Runs the lines of ablations.toml beside the cases, and each of their methods as shipped with several seeds: \
    the spread between seeds is the noise below which a difference says nothing. Finished cells are kept.\n\
    Example: respire-bench ablate --only activation --out reports/ablations"
)]
pub struct AblateArguments {
    /// Groups of the file; all when not given
    #[arg(long, value_delimiter = ',', value_name = "GROUP,..")]
    only: Vec<String>,
    /// Cases by id; the file's when not given
    #[arg(long, value_delimiter = ',', value_name = "CASE,..")]
    cases: Vec<String>,
    /// Size of the run: smoke, quick, paper, or the path of a profile file
    #[arg(long, default_value = "quick", value_name = "P")]
    profile: String,
    /// Folder for ablations.csv and ablations.md
    #[arg(long, default_value = "reports/ablations", value_name = "DIR")]
    out: PathBuf,
    /// Folder of sequences and finished cells
    #[arg(long, default_value = ".cache", value_name = "DIR")]
    cache: PathBuf,
    #[command(flatten)]
    catalogue: CatalogueFolder,
}

/// Runs the variants and writes the table.
pub fn run(arguments: AblateArguments, terminal: &Terminal) -> Result<()> {
    let catalogue = arguments.catalogue.open()?;
    let only = (!arguments.only.is_empty()).then_some(&arguments.only[..]);
    let ablations = Ablations::load(&catalogue.ablations_file(), only)?;
    let cases = if arguments.cases.is_empty() { &ablations.cases } else { &arguments.cases };
    let (profile, cache) = (&arguments.profile, &arguments.cache);
    let plan = AblationPlan { catalogue: &catalogue, ablations: &ablations, cases, profile, cache };
    let title = format!("Profile `{profile}`, cases {}", cases.join(", "));
    run_variants(&plan, terminal, |scores| write(scores, &title, &arguments.out).map(drop))?;
    terminal.finish();
    terminal.line(files::read_text(&arguments.out.join("ablations.md"))?.trim_end());
    Ok(())
}
