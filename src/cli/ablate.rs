//! `ablate`: what each part of a method, and each property of a film, is worth, and which value of a number is best.

use std::path::{Path, PathBuf};

use super::Terminal;
use super::selection::{CacheFolder, CatalogueFolder, ProfileChoice};
use super::stopped::resumable;
use crate::base::range::THREADS;
use crate::base::{Error, ErrorKind, Result, files};
use crate::bench::Ablations;
use crate::experiments::ablation::{AblationPlan, ScoredCases, run as run_variants};
use crate::report::ablation::write;

/// Arguments of `ablate`.
#[derive(clap::Args)]
#[command(
    after_help = "Runs the lines of ablations.toml beside the cases, and each of their methods as shipped with several seeds: \
    the spread between seeds is the noise below which a difference says nothing. With --file, the lines of another file, for \
    instance a sweep over the values of numbers: the shipped ones are ours, ours-nomesh, ours-window, ours-gn, \
    ours-gn-pose, bridgesplat, clinical and virtual-bronchoscopy; the best value of each number is marked.\n\
    Lines run on the tuning cases (tune1 to tune4), which are never scored. Finished cells are kept: the same command goes \
    on. --profile smoke is a first look.\n\
    Examples: respire-bench ablate --only schedule\n          \
    respire-bench ablate --file ours --only iterations"
)]
pub struct AblateArguments {
    /// Name of a sweep, or path of a file of lines [default: ablations.toml beside the cases]
    #[arg(long, value_name = "FILE")]
    file: Option<String>,
    /// Groups of the file (of a sweep: its keys); all when not given
    #[arg(long, value_delimiter = ',', value_name = "GROUP,..")]
    only: Vec<String>,
    /// Cases by id; the file's when not given
    #[arg(long, value_delimiter = ',', value_name = "CASE,..")]
    cases: Vec<String>,
    /// Run on scored cases too, for an answer by which nothing is chosen
    #[arg(long)]
    scored_cases: bool,
    /// Cells that run at once and share the threads; 0 is one for each thread, the quickest. 1 for seconds that other
    /// commands print too
    #[arg(long, default_value_t = 0, value_name = "N", value_parser = THREADS.parser::<usize>())]
    at_once: usize,
    #[command(flatten)]
    profile: ProfileChoice,
    /// Folder for ablations.csv and ablations.md [default: reports/ablations, with --file reports/sweeps/NAME]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    #[command(flatten)]
    cache: CacheFolder,
    #[command(flatten)]
    catalogue: CatalogueFolder,
}

/// Runs the variants and writes the table.
pub fn run(arguments: AblateArguments, terminal: &Terminal) -> Result<()> {
    let catalogue = arguments.catalogue.open()?;
    let only = (!arguments.only.is_empty()).then_some(&arguments.only[..]);
    let file = match &arguments.file {
        None => catalogue.ablations_file(),
        Some(wish) => catalogue.sweep_file(wish)?,
    };
    let ablations = Ablations::load(&file, only)?;
    let threads = rayon::current_num_threads();
    let at_once = if arguments.at_once == 0 { threads } else { arguments.at_once };
    let plan = AblationPlan {
        catalogue: &catalogue,
        file: &file,
        ablations: &ablations,
        scored_cases: if arguments.scored_cases { ScoredCases::Taken } else { ScoredCases::Refused },
        at_once,
        cases: if arguments.cases.is_empty() { &ablations.cases } else { &arguments.cases },
        profile: arguments.profile.name(),
        cache: arguments.cache.path(),
    };
    let out = arguments.out.unwrap_or_else(|| match &arguments.file {
        None => PathBuf::from("reports/ablations"),
        Some(_) => Path::new("reports/sweeps").join(file.file_stem().unwrap_or_default()),
    });
    let name = file.file_name().unwrap_or_default().to_string_lossy();
    let title = format!(
        "Lines of `{name}`, profile `{}`, cases {}, seed {}. {at_once} cells at once on {threads} threads",
        arguments.profile.name(),
        plan.cases.join(", "),
        ablations.noise_seeds[0],
    );
    let metrics = &ablations.metrics;
    let mut failed = 0;
    resumable(run_variants(&plan, terminal, |scores| {
        failed = scores.iter().map(|variant| variant.failed).sum();
        write(scores, metrics, &title, &out).map(drop)
    }))?;
    terminal.finish();
    terminal.line(files::read_text(&out.join("ablations.md"))?.trim_end());
    match failed {
        0 => Ok(()),
        _ => Err(Error::new(ErrorKind::CellFailed, format!("{failed} cells failed, the table says in which lines"))),
    }
}
