//! `evaluate`: scores folders of predictions of any program, of one film or of many.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::{Terminal, comparison};
use crate::base::{Error, ErrorKind, Progress, Result, files, method_name};
use crate::report::run::evaluated_id;
use crate::report::scene::Scenes;
use crate::report::summary::summarise;
use crate::report::table::ComparisonTable;
use crate::report::{self, CaseInfo, CellRecord, MethodInfo, Outcome, Run};
use crate::score::{CellScore, Prediction, Question, ScoreSettings, Truth, registry, score};
use crate::simulate::sequence::{self, Sequence};
use crate::simulate::track::Track;

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

/// A film, what answers it, and what came of it.
struct Evaluated {
    film: PathBuf,
    prediction: PathBuf,
    scored: Result<(Sequence, CellScore)>,
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
        let scored = evaluate(film, &prediction, arguments.method.as_deref());
        evaluated.push(Evaluated { film: film.clone(), prediction, scored });
    }
    terminal.finish();
    // One film is all there is: its error is that of the command.
    if let [Evaluated { scored: Err(error), .. }] = &evaluated[..] {
        return Err(error.clone());
    }
    refuse_cases_twice(&evaluated)?;
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

/// The films that are meant: each folder itself, or those in it.
fn films(folders: &[PathBuf]) -> Result<Vec<PathBuf>> {
    let mut films = Vec::new();
    for folder in folders {
        // A report beside the films has a manifest, too.
        let is_film = |path: &Path| path.join(sequence::MANIFEST).is_file() && !path.join("results.csv").is_file();
        let inside = if folder.is_dir() { files::folders_in(folder)? } else { Vec::new() };
        // In a cache each film lies in a folder of its own, as `film`.
        let film_of = |path: PathBuf| [path.join("film"), path].into_iter().find(|path| is_film(path));
        let inside: Vec<PathBuf> = inside.into_iter().filter_map(film_of).collect();
        // A folder that is neither is refused by name when it is opened.
        films.extend(if is_film(folder) || inside.is_empty() { vec![folder.clone()] } else { inside });
    }
    Ok(films)
}

/// The folder of predictions for each film.
fn predictions(films: &[PathBuf], folders: &[PathBuf]) -> Result<Vec<PathBuf>> {
    if films.len() == folders.len() && (films.len() > 1 || !is_parent(&folders[0])) {
        return Ok(folders.to_vec());
    }
    let [parent] = folders else {
        let sentence = format!(
            "--predictions names {} folders for {} films: one per film, or one for all",
            folders.len(),
            films.len()
        );
        return Err(Error::usage(sentence));
    };
    Ok(films.iter().map(|film| of_film(film, parent)).collect())
}

/// Whether predictions stand in folders within `folder`, and none in itself.
fn is_parent(folder: &Path) -> bool {
    !folder.join("color").is_dir()
        && files::folders_in(folder).is_ok_and(|f| f.iter().any(|f| f.join("color").is_dir()))
}

/// The folder in `parent` that answers `film`: named as its case, or else as the film's folder.
fn of_film(film: &Path, parent: &Path) -> PathBuf {
    let folder_name = film.canonicalize().unwrap_or_else(|_| film.to_path_buf());
    let folder_name = folder_name.file_name().map(PathBuf::from).unwrap_or_default();
    let case = Sequence::open(film).map(|film| PathBuf::from(film.case_id));
    let names = case.into_iter().chain([folder_name.clone()]);
    names.map(|name| parent.join(name)).find(|path| path.is_dir()).unwrap_or_else(|| parent.join(folder_name))
}

fn evaluate(film: &Path, prediction: &Path, method: Option<&str>) -> Result<(Sequence, CellScore)> {
    let film = Sequence::open(film)?;
    if method.is_none() {
        check_name(prediction, &Question::of(&film))?;
    }
    let settings = ScoreSettings { method: method.map(str::to_owned), ..ScoreSettings::default() };
    let found = score(&film, prediction, &settings)?;
    Ok((film, found))
}

/// A table has one cell per case and method.
fn refuse_cases_twice(evaluated: &[Evaluated]) -> Result<()> {
    for (place, one) in evaluated.iter().enumerate() {
        let Ok((_, found)) = &one.scored else { continue };
        let same = |other: &&Evaluated| {
            other.scored.as_ref().is_ok_and(|(_, o)| (&o.case_id, &o.method) == (&found.case_id, &found.method))
        };
        if let Some(other) = evaluated[..place].iter().find(same) {
            let sentence =
                format!("is of {} as {} is: one film of a case at a time", found.case_id, other.film.display());
            return Err(Error::input(sentence).at(&one.film));
        }
    }
    Ok(())
}

/// Names every film that failed; the error says how many.
fn failures(evaluated: &[Evaluated], terminal: &Terminal) -> Result<()> {
    let failed = || evaluated.iter().filter_map(|e| Some((e, e.scored.as_ref().err()?)));
    for (Evaluated { film, .. }, error) in failed() {
        terminal.note(&format!("{}: failed: {error}", film.display()));
    }
    match failed().count() {
        0 => Ok(()),
        count => {
            let sentence = format!("{count} of {} films failed; they are named above", evaluated.len());
            Err(Error::new(ErrorKind::CellFailed, sentence))
        }
    }
}

/// Refuses a prediction that names itself as an own row.
pub(super) fn check_name(prediction: &Path, question: &Question) -> Result<()> {
    let opened = Prediction::open(prediction, question)?;
    let named = |e: Error| e.element("method").at(prediction.join("prediction.json"));
    opened.method().map_or(Ok(()), method_name::check_foreign).map_err(named)
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

/// One line per film: what ranks.
fn print_rows(run: &Run, terminal: &Terminal) {
    for cell in &run.cells {
        let Some(score) = cell.score() else {
            terminal.line(format_args!("{:<24} failed", cell.case_id));
            continue;
        };
        let shown = ["psnr_db", "ssim", "depth_rmse_mm", "phase_mae", "target_mean_mm"].into_iter().filter_map(|id| {
            let metric = crate::score::metric(id)?;
            let value = score.value(id).map_or_else(|| "-".to_owned(), |value| metric.format(value));
            Some(format!("{id} {value}"))
        });
        terminal.line(format_args!("{:<24} {}", cell.case_id, shown.collect::<Vec<_>>().join("  ")));
    }
}

/// The report of these predictions: a cell per film. A film that failed has the name of its folder and the method of
/// the others.
fn as_run(evaluated: Vec<Evaluated>, method: Option<&str>) -> Run {
    let named = evaluated.iter().find_map(|e| Some(e.scored.as_ref().ok()?.1.method.clone()));
    let common = method.map(str::to_owned).or(named).unwrap_or_default();
    let (mut cases, mut cells, mut methods) = (Vec::new(), Vec::new(), Vec::<MethodInfo>::new());
    let mut is_clinical = false;
    for Evaluated { film, prediction, scored } in evaluated {
        let folder_name = film.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let (case_id, method, seed, truth, outcome) = match scored {
            Ok((film, found)) => {
                let (case_id, method, seed) = (found.case_id.clone(), found.method.clone(), found.seed);
                (case_id, method, seed, Some(film), Outcome::Scored(Box::new(found)))
            }
            Err(error) => {
                let film = Sequence::open(&film).ok();
                let case_id = film.as_ref().map_or(folder_name, |film| film.case_id.clone());
                (case_id, common.clone(), 0, film, Outcome::Failed(error.to_string()))
            }
        };
        if !methods.iter().any(|known| known.id == method) {
            methods.push(MethodInfo::of(&method));
        }
        is_clinical |= truth.as_ref().is_some_and(|film| film.clinical.is_some());
        cases.push(CaseInfo {
            title: case_id.clone(),
            id: case_id.clone(),
            tree: truth.as_ref().map(Sequence::tree).unwrap_or_default(),
            truth: truth.map(|film| Arc::new(film) as Arc<dyn Truth>),
        });
        let (run_id, timings) = (evaluated_id(&case_id, &method), Vec::new());
        cells.push(CellRecord { run_id, case_id, method, seed, prediction, outcome, timings });
    }
    let id = match &cells[..] {
        [one] => one.run_id.clone(),
        all => evaluated_id(&format!("{}-films", all.len()), &common),
    };
    Run {
        profile: "evaluate".into(),
        track: if is_clinical { Track::Clinical } else { Track::Ideal },
        notes: Vec::new(),
        methods,
        cells,
        id,
        cases,
        scenes: Scenes::default(),
    }
}
