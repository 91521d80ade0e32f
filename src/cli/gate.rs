//! `gate`: passes or fails a finished run.

use std::path::{Path, PathBuf};

use super::Terminal;
use super::selection::CatalogueFolder;
use crate::base::{Error, ErrorKind, Progress, Result, files};
use crate::report::gate::{Check, LIMITS_FILE, Verdict, judge, read_thresholds, with_limits_of};
use crate::report::read::Results;
use crate::report::{benchmark_json, gate_files, gate_limits, read};

/// Arguments of `gate`.
#[derive(clap::Args)]
#[command(
    after_help = "Writes gate.md and gate.xml (JUnit) before it decides. Exit code 3 when anything fails: a value beyond \
    its limit, an empty or broken value, a missing case, method or metric, a film that is unknown or not the baseline's, a \
    limit that no row meets, or nothing to check. Exit code 4 when a table does not have the hash of its manifest.json; without \
    one, and without run.json, which tells the profile, a note says so.\n\
    A baseline holds on every processor with AVX2, which all give the same bytes.\n\
    A baseline folder with a limits.toml brings relative limits of its own, which must hold too. --limits-from writes it, judging nothing: four \
    standard deviations of the seeds or, of a method that draws nothing, of single cases between two samplings of their films \
    (scripts/baseline.sh).\n\
    Example: respire-bench gate --results target/smoke/latest --baseline reports/baselines/ideal"
)]
pub struct GateArguments {
    /// Report folder to judge
    #[arg(long, value_name = "DIR", required_unless_present = "limits_from")]
    results: Option<PathBuf>,
    /// Limits; docs/statistics.md has the keys [default: gate.toml beside the cases, for a run of the clinical track
    /// gate-clinical.toml, both for the profile smoke]
    #[arg(long, value_name = "FILE")]
    thresholds: Option<PathBuf>,
    /// Report folder to compare with; of several, the first one that was made from the same films
    #[arg(long, value_delimiter = ',', value_name = "DIR,..")]
    baseline: Vec<PathBuf>,
    /// Report folders from which limits are computed and written to limits.toml in --out, instead of judging
    #[arg(long, value_delimiter = ',', value_name = "DIR,..", requires = "out", conflicts_with_all = ["results", "baseline"])]
    limits_from: Vec<PathBuf>,
    /// Folder for gate.md and gate.xml [default: the results], or for limits.toml
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Write the means for github-action-benchmark (benchmark-smaller-is-better.json, benchmark-bigger-is-better.json)
    /// and Bencher (benchmark-bencher.json) too, whatever the verdict
    #[arg(long, conflicts_with = "limits_from")]
    benchmark_json: bool,
    /// Print passed checks too
    #[arg(long)]
    all: bool,
    #[command(flatten)]
    catalogue: CatalogueFolder,
}

/// Judges, writes the reports, then decides; `ErrorKind::Regression` when a check fails.
pub fn run(arguments: GateArguments, terminal: &Terminal) -> Result<()> {
    let Some(folder) = &arguments.results else {
        let out = arguments.out.unwrap_or_default();
        return write_limits(&arguments.limits_from, &out, terminal);
    };
    terminal.stage("reading the results");
    let results = read::read(folder)?;
    for name in read::lacking_evidence(folder) {
        terminal.note(&format!(
            "{} has no {name}: nobody can tell whether its tables are as they were written",
            folder.display()
        ));
    }
    let limits = match arguments.thresholds {
        Some(file) => file,
        None => arguments.catalogue.open()?.gate_file(results.track),
    };
    let mut thresholds = read_thresholds(&limits)?;
    thresholds.check_profile(&results).map_err(|e| e.at(&limits))?;
    let baseline = chosen(&results, &arguments.baseline)?;
    if let Some((baseline, path)) = &baseline {
        results.check_track(baseline).map_err(|e| e.at(path))?;
        thresholds = with_limits_of(thresholds, baseline, path)?;
        terminal.note(&format!("compared with {}", path.display()));
    }
    let checks = judge(&results, &thresholds, baseline.as_ref().map(|(baseline, _)| baseline));

    let out = arguments.out.as_ref().unwrap_or(folder);
    gate_files::write_junit(&checks, &out.join("gate.xml"))?;
    files::write_bytes(&out.join("gate.md"), gate_files::markdown(&checks).as_bytes())?;
    if arguments.benchmark_json {
        benchmark_json::write(&results, out)?;
    }

    print(&checks, arguments.all, terminal);
    let failed: Vec<&Check> = checks.iter().filter(|c| c.verdict == Verdict::Fail).collect();
    let Some(first) = failed.first() else {
        terminal.line(format_args!("passed: {} checks", checks.len()));
        return Ok(());
    };
    let place = [&first.case, &first.method, &first.metric].into_iter().filter(|word| !word.is_empty());
    let mut place = place.map(String::as_str).collect::<Vec<_>>().join(" ");
    if !place.is_empty() {
        place += ": ";
    }
    let (failed, all) = (failed.len(), checks.len());
    let sentence = format!("{failed} of {all} checks failed, the first: {place}{}", first.sentence);
    Err(Error::new(ErrorKind::Regression, sentence))
}

/// The first baseline of the same films as the results; where there is none the first one, which the gate then refuses.
fn chosen<'a>(results: &Results, folders: &'a [PathBuf]) -> Result<Option<(Results, &'a Path)>> {
    let mut first: Option<(Results, &Path)> = None;
    for folder in folders {
        let baseline = read::read(folder)?;
        if results.is_of_films_of(&baseline) {
            return Ok(Some((baseline, folder)));
        }
        // One of the same track has what can be compared.
        if first.as_ref().is_none_or(|(first, _)| first.track != results.track && baseline.track == results.track) {
            first = Some((baseline, folder.as_path()));
        }
    }
    Ok(first)
}

fn write_limits(runs: &[PathBuf], out: &Path, terminal: &Terminal) -> Result<()> {
    let runs = runs.iter().map(|folder| read::read(folder)).collect::<Result<Vec<_>>>()?;
    let limits = gate_limits::limits_from(&runs)?;
    let path = out.join(LIMITS_FILE);
    gate_limits::write_limits(&limits, &path)?;
    terminal.line(format_args!("{}: {} limits", path.display(), limits.len()));
    Ok(())
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
