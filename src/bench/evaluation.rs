//! Predictions of others: which films are meant, which folder answers each, its score, and all of them as a run.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::base::{Error, Result, case_id, files, method_name};
use crate::formats::prediction::{ABOUT, COLOR};
use crate::report::run::{EVALUATION, evaluated_id};
use crate::report::scene::Scenes;
use crate::report::{CaseInfo, CellRecord, MethodInfo, Outcome, Run};
use crate::score::{CellScore, Prediction, Question, ScoreSettings, Truth, score};
use crate::simulate::sequence::{self, Sequence};
use crate::simulate::track::Track;

/// The films that `folders` mean: each folder itself, or those in it.
///
/// Errors: a folder that cannot be read.
pub fn films(folders: &[PathBuf]) -> Result<Vec<PathBuf>> {
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

/// The folder of predictions for each film: one per film in the same order, or those within one, by their names.
///
/// Errors: neither as many folders as films nor one.
pub fn predictions(films: &[PathBuf], folders: &[PathBuf]) -> Result<Vec<PathBuf>> {
    if films.len() == folders.len() && (films.len() > 1 || !folders.iter().any(|folder| is_parent(folder))) {
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
    !folder.join(COLOR).is_dir() && files::folders_in(folder).is_ok_and(|f| f.iter().any(|f| f.join(COLOR).is_dir()))
}

/// The folder in `parent` that answers `film`: named as its case, or else as the film's folder.
fn of_film(film: &Path, parent: &Path) -> PathBuf {
    // A link goes by its own name; only `.` and `..` have none.
    let named = |path: &Path| path.file_name().map(PathBuf::from);
    let folder_name = named(film).or_else(|| named(&film.canonicalize().ok()?)).unwrap_or_default();
    let case = Sequence::open(film).map(|film| PathBuf::from(film.case_id));
    let mut folders = case.into_iter().chain([folder_name]).map(|name| parent.join(name));
    let first = folders.next().expect("a film's folder has a name");
    if first.is_dir() { first } else { folders.find(|path| path.is_dir()).unwrap_or(first) }
}

/// Refuses a prediction that names itself as a row of this program.
pub fn check_name(prediction: &Path, question: &Question) -> Result<()> {
    let opened = Prediction::open(prediction, question)?;
    let named = |e: Error| e.element("method").at(prediction.join(ABOUT));
    opened.method().map_or(Ok(()), method_name::check_foreign).map_err(named)
}

fn scored(film: &Path, prediction: &Path, method: Option<&str>) -> Result<(Sequence, CellScore)> {
    let film = Sequence::open(film)?;
    if method.is_none() {
        check_name(prediction, &Question::of(&film))?;
    }
    let settings = ScoreSettings { method: method.map(str::to_owned), ..ScoreSettings::default() };
    let found = score(&film, prediction, &settings)?;
    Ok((film, found))
}

/// A film, what answers it, and what came of it.
pub struct Evaluated {
    /// Folder of the film.
    pub film: PathBuf,
    /// Folder of the predictions.
    pub prediction: PathBuf,
    /// The film and its score, or what is wrong with one of the two folders.
    pub scored: Result<(Sequence, CellScore)>,
}

impl Evaluated {
    /// Scores `prediction`, as that of `method` where one is named; else it names its own, which is none of this program.
    pub fn new(film: PathBuf, prediction: PathBuf, method: Option<&str>) -> Self {
        let scored = scored(&film, &prediction, method);
        Evaluated { film, prediction, scored }
    }
}

/// The case of the film in `folder`, or one named as the folder where it cannot be opened.
fn case_of(folder: &Path, film: Option<&Sequence>) -> String {
    let name = folder.file_name().unwrap_or_default().to_string_lossy();
    film.map_or_else(|| case_id::of_folder(&name), |film| film.case_id.clone())
}

/// Refuses two films of one case, answered by one method: a table has one cell per case and method. A film that failed
/// may have been answered by any.
pub fn refuse_cases_twice(evaluated: &[Evaluated]) -> Result<()> {
    let row = |one: &Evaluated| match &one.scored {
        Ok((_, found)) => (found.case_id.clone(), Some(found.method.clone())),
        Err(_) => (case_of(&one.film, Sequence::open(&one.film).ok().as_ref()), None),
    };
    let rows: Vec<(String, Option<String>)> = evaluated.iter().map(row).collect();
    for (place, (case, method)) in rows.iter().enumerate() {
        let is_same = |(other_case, other): &(String, Option<String>)| {
            other_case == case && (other.is_none() || method.is_none() || other == method)
        };
        if let Some(before) = rows[..place].iter().position(is_same) {
            let other = evaluated[before].film.display();
            let sentence = format!("is of {case} as {other} is: one film of a case at a time");
            return Err(Error::input(sentence).at(&evaluated[place].film));
        }
    }
    Ok(())
}

/// Refuses films of both tracks: a table holds one.
pub fn refuse_two_tracks(evaluated: &[Evaluated]) -> Result<()> {
    let films: Vec<(&Path, bool)> = (evaluated.iter())
        .filter_map(|one| Some((one.film.as_path(), one.scored.as_ref().ok()?.0.clinical.is_some())))
        .collect();
    let track = |is_clinical| if is_clinical { Track::Clinical } else { Track::Ideal }.word();
    match films.iter().find(|film| film.1 != films[0].1) {
        Some((film, is_clinical)) => {
            let (first, [a, b]) = (films[0].0.display(), [*is_clinical, !is_clinical].map(track));
            let sentence =
                format!("is of the track `{a}` and {first} of `{b}`: a table holds one, evaluate them apart");
            Err(Error::input(sentence).at(film))
        }
        None => Ok(()),
    }
}

/// The report of these predictions: a cell per film. A film that failed has the name of its folder and the method of
/// the others.
pub fn as_run(evaluated: Vec<Evaluated>, method: Option<&str>) -> Run {
    let named = evaluated.iter().find_map(|e| Some(e.scored.as_ref().ok()?.1.method.clone()));
    let common = method.map(str::to_owned).or(named).unwrap_or_default();
    let (mut cases, mut cells, mut methods) = (Vec::new(), Vec::new(), Vec::<MethodInfo>::new());
    let mut is_clinical = false;
    for Evaluated { film, prediction, scored } in evaluated {
        let (case_id, method, seed, truth, outcome) = match scored {
            Ok((film, found)) => {
                let (case_id, method, seed) = (found.case_id.clone(), found.method.clone(), found.seed);
                (case_id, method, seed, Some(film), Outcome::Scored(Box::new(found)))
            }
            Err(error) => {
                let opened = Sequence::open(&film).ok();
                let case_id = case_of(&film, opened.as_ref());
                (case_id, common.clone(), 0, opened, Outcome::Failed(error.to_string()))
            }
        };
        if !methods.iter().any(|known| known.id == method) {
            methods.push(MethodInfo::of(&method));
        }
        is_clinical |= truth.as_ref().is_some_and(|film| film.clinical.is_some());
        // A film may be answered by several methods.
        if cases.iter().all(|known: &CaseInfo| known.id != case_id) {
            cases.push(CaseInfo {
                title: case_id.clone(),
                id: case_id.clone(),
                tree: truth.as_ref().map(Sequence::tree).unwrap_or_default(),
                truth: truth.map(|film| Arc::new(film) as Arc<dyn Truth>),
            });
        }
        let (run_id, timings) = (evaluated_id(&case_id, &method), Vec::new());
        cells.push(CellRecord { run_id, case_id, method, seed, prediction, outcome, timings });
    }
    let id = match &cells[..] {
        [one] => one.run_id.clone(),
        _ => evaluated_id(&format!("{}-films", cases.len()), &common),
    };
    Run {
        profile: EVALUATION.into(),
        track: if is_clinical { Track::Clinical } else { Track::Ideal },
        conditions: Vec::new(),
        notes: Vec::new(),
        methods,
        cells,
        id,
        cases,
        scenes: Scenes::default(),
        read_from: Vec::new(),
    }
}
