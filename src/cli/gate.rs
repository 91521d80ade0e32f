//! `gate`: passes or fails a finished run.

use std::path::PathBuf;

use super::Terminal;
use super::selection::CatalogueFolder;
use crate::base::{Error, ErrorKind, Result, files};
use crate::report::gate::{Check, Verdict, judge, read_thresholds};
use crate::report::{gate_files, read};

/// Arguments of `gate`.
#[derive(clap::Args)]
#[command(
    after_help = "Writes gate.md and gate.xml (JUnit) before it decides. Exit code 3 when anything fails: a value beyond \
    its limit, an empty or broken value, a missing case, method or metric.\n\
    Example: respire-bench gate --results reports/latest --baseline reports/reference/paper"
)]
pub struct GateArguments {
    /// Report folder to judge
    #[arg(long, value_name = "DIR")]
    results: PathBuf,
    /// Limits [default: gate.toml beside the cases]
    #[arg(long, value_name = "FILE")]
    thresholds: Option<PathBuf>,
    /// Report folder to compare with
    #[arg(long, value_name = "DIR")]
    baseline: Option<PathBuf>,
    /// Folder for gate.md and gate.xml [default: the results]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Print passed checks too
    #[arg(long)]
    all: bool,
    #[command(flatten)]
    catalogue: CatalogueFolder,
}

/// Judges, writes the reports, then decides; `ErrorKind::Regression` when a check fails.
pub fn run(arguments: GateArguments, terminal: &Terminal) -> Result<()> {
    let limits = match arguments.thresholds {
        Some(file) => file,
        None => arguments.catalogue.open()?.gate_file(),
    };
    let thresholds = read_thresholds(&limits)?;
    let results = read::read(&arguments.results)?;
    let baseline = arguments.baseline.as_deref().map(read::read).transpose()?;
    let checks = judge(&results, &thresholds, baseline.as_ref());

    let out = arguments.out.as_ref().unwrap_or(&arguments.results);
    gate_files::write_junit(&checks, &out.join("gate.xml"))?;
    files::write_bytes(&out.join("gate.md"), gate_files::markdown(&checks).as_bytes())?;

    print(&checks, arguments.all, terminal);
    let failed: Vec<&Check> = checks.iter().filter(|c| c.verdict == Verdict::Fail).collect();
    let Some(first) = failed.first() else {
        terminal.line(format_args!("passed: {} checks", checks.len()));
        return Ok(());
    };
    let place: Vec<&str> =
        [&first.case, &first.method, &first.metric].into_iter().map(String::as_str).filter(|w| !w.is_empty()).collect();
    let sentence = format!(
        "{} of {} checks failed, the first: {}: {}",
        failed.len(),
        checks.len(),
        place.join(" "),
        first.sentence
    );
    Err(Error::new(ErrorKind::Regression, sentence))
}

fn print(checks: &[Check], all: bool, terminal: &Terminal) {
    let shown: Vec<&Check> = checks.iter().filter(|c| all || c.verdict != Verdict::Pass).collect();
    let width = |get: fn(&Check) -> &str| shown.iter().map(|c| get(c).len()).max().unwrap_or(0);
    let (case, method, metric) = (width(|c| &c.case), width(|c| &c.method), width(|c| &c.metric));
    for c in shown {
        terminal.line(format_args!(
            "{:<5} {:<case$} {:<method$} {:<metric$} {}",
            c.verdict.word(),
            c.case,
            c.method,
            c.metric,
            c.sentence
        ));
    }
}
