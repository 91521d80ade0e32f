//! `evaluate`: scores folders of predictions of any program, of one film or of many.

use std::path::PathBuf;

use super::{Terminal, comparison};
use crate::base::{Error, ErrorKind, Progress, Result, method_name};
use crate::bench::evaluation::{Evaluated, as_run, films, predictions, refuse_cases_twice, refuse_two_tracks};
use crate::report::summary::summarise;
use crate::report::table::ComparisonTable;
use crate::report::{self, Run};
use crate::score::{CellScore, registry};

/// Arguments of `evaluate`.
#[derive(clap::Args)]
#[command(
    after_help = "The folder holds color/NNNNNN.png, and as far as the method has them depth/NNNNNN.{exr,npy,png}, \
    ahead/NNNNNN.png, novel/NNNNNN.png, novel_depth/NNNNNN.{exr,npy,png}, phase.csv (frame,phase), targets.csv, \
    target_covariance.csv, poses.csv, mesh/final.ply, correspondence.csv, timing.json ({\"time_total_s\": ..}), prediction.json \
    ({\"method\": .., \"case\": .., \"depth_unit_mm\": ..}); see docs/predictions.md. Names of this program's own rows are \
    reserved.\n\
    Of several films, --predictions is a folder with one folder for each, named as its case or as the film's folder, or \
    one folder per film in the same order. A folder of films stands for all films in it. A film that fails is named, \
    loses no other, and makes the exit code 1.\n\
    Example: respire-bench evaluate --sequence .cache/sequences/case1-0123456789ab/film --predictions my-method/case1 --out report\n\
    Example: respire-bench evaluate --sequence films --predictions my-method --out report"
)]
pub struct EvaluateArguments {
    /// Sequence folders with the truth; of a blind comparison, its `truth`; or a folder of such
    #[arg(long, visible_alias = "truth", value_name = "DIR", required = true, num_args = 1..)]
    sequence: Vec<PathBuf>,
    /// Folder of the predictions, or one per film
    #[arg(long, value_name = "DIR", required = true, num_args = 1..)]
    predictions: Vec<PathBuf>,
    /// Name of the method in tables [default: the one in prediction.json]
    #[arg(long, value_name = "NAME")]
    method: Option<String>,
    /// Write the whole report here: CSV, Markdown, LaTeX, HTML, plots, panels
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Write every number as JSON; of several films, an array
    #[arg(long)]
    json: bool,
}

/// Scores, prints, and writes a report where asked for.
pub fn run(arguments: EvaluateArguments, terminal: &Terminal) -> Result<()> {
    let films = films(&arguments.sequence)?;
    let predictions = predictions(&films, &arguments.predictions)?;
    // Before the work.
    arguments.out.as_deref().map_or(Ok(()), report::refuse_other_folder)?;
    let given = arguments.method.as_deref().map_or(Ok(()), method_name::check_foreign);
    given.map_err(|e| Error::usage(format!("--method: {e}")))?;
    let mut evaluated = Vec::new();
    terminal.stage("scoring");
    for (film, prediction) in films.iter().zip(predictions) {
        terminal.advance(evaluated.len(), films.len());
        terminal.proceed()?;
        evaluated.push(Evaluated::new(film.clone(), prediction, arguments.method.as_deref()));
    }
    terminal.finish();
    // One film is all there is: its error is that of the command.
    if let [Evaluated { scored: Err(error), .. }] = &evaluated[..] {
        return Err(error.clone());
    }
    refuse_cases_twice(&evaluated)?;
    refuse_two_tracks(&evaluated)?;
    let scores: Vec<&CellScore> = evaluated.iter().filter_map(|e| Some(&e.scored.as_ref().ok()?.1)).collect();
    match (arguments.json, &scores[..]) {
        (true, [one]) if evaluated.len() == 1 => terminal.json(one)?,
        (true, all) => terminal.json(&all)?,
        (false, [one]) if evaluated.len() == 1 => print(one, terminal),
        (false, _) => {}
    }
    let failed = failures(&evaluated, terminal);
    if scores.is_empty() {
        return failed;
    }
    let run = as_run(evaluated, arguments.method.as_deref());
    if !arguments.json && run.cells.len() > 1 {
        for table in ComparisonTable::all(run.track, &summarise(&run)) {
            comparison::lines(&table).iter().for_each(|line| terminal.line(line));
        }
        print_rows(&run, terminal);
    }
    if let Some(folder) = &arguments.out {
        terminal.stage("writing the report");
        let written = report::write(&run, folder, terminal)?;
        terminal.finish();
        if !arguments.json {
            terminal.line(format_args!("report: {}", written.html.display()));
        }
    }
    failed
}

/// Names the films that failed; the error says how many, and names the first.
fn failures(evaluated: &[Evaluated], terminal: &Terminal) -> Result<()> {
    let failed = || evaluated.iter().filter_map(|e| Some((e, e.scored.as_ref().err()?)));
    for (Evaluated { film, .. }, error) in failed().skip(1) {
        terminal.note(&format!("{}: failed: {error}", film.display()));
    }
    let Some((first, error)) = failed().next() else { return Ok(()) };
    let count = format!("{} of {} films failed", failed().count(), evaluated.len());
    Err(Error::new(ErrorKind::CellFailed, format!("{count}, first {}: {error}", first.film.display())))
}

fn print(found: &CellScore, terminal: &Terminal) {
    terminal.line(format_args!("{} on {}: {} frames", found.method, found.case_id, found.frames));
    for m in registry() {
        let Some(score) = found.metric(m.id) else { continue };
        let value = score.value.map_or_else(|| "-".to_owned(), |v| m.format(v));
        let interval =
            score.interval.map_or_else(String::new, |[low, high]| format!("({} to {})", m.format(low), m.format(high)));
        let status = if score.status.word() == "ok" { "" } else { score.status.word() };
        let line = format!("{:<28}{value:>10} {:<4}{interval:<22}{status} {}", m.id, m.unit, score.detail);
        terminal.line(line.trim_end());
    }
}

/// One line per film, and per method where there are several: what ranks.
fn print_rows(run: &Run, terminal: &Terminal) {
    for cell in &run.cells {
        let name = if run.methods.len() > 1 { &format!("{} {}", cell.case_id, cell.method) } else { &cell.case_id };
        let Some(score) = cell.score() else {
            terminal.line(format_args!("{name:<24} failed"));
            continue;
        };
        let shown = ["psnr_db", "ssim", "depth_rmse_mm", "phase_mae", "target_mean_mm"].into_iter().filter_map(|id| {
            let metric = crate::score::metric(id)?;
            let value = score.value(id).map_or_else(|| "-".to_owned(), |value| metric.format(value));
            Some(format!("{id} {value}"))
        });
        terminal.line(format_args!("{name:<24} {}", shown.collect::<Vec<_>>().join("  ")));
    }
}
