//! Merges runs that were made separately: cells from several machines, renewed rows, a third party's predictions beside
//! the methods. Each is read back from its report folder ([`super::read_back`]); a cell that several runs have is taken
//! from the last.
//!
//! Nothing is recomputed: values, intervals and times are those of the tables. Contours, airways and films are those that
//! the runs kept (`scenes.json`, `films/`); panels, which need films and predictions, are left out.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

use super::counted_run::CountedRun;
use super::read::distinct;
use super::run::{CellRecord, MethodInfo, PROFILES_BETWEEN, Role, Run};
use super::scene::{FilmKey, Scenes};
use crate::base::{Error, Result, hash, method_name};
use crate::score::CellScore;

/// Whether a table may hold scores of different films of one case.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Films {
    /// No: two runs that filmed a case differently are refused.
    Same,
    /// Yes, and the report says which cells they are.
    Other,
}

/// A report to merge.
#[derive(Clone)]
pub struct Part {
    /// Its folder, by which notes name it.
    pub folder: PathBuf,
    /// What its tables hold.
    pub run: Run,
}

/// Merges `parts`; a cell that several have is taken from the last, and the report says so.
///
/// Errors: a method with rows of this program's runs and of predictions that `evaluate` scored; two different
/// predictions of one name, or of names that look alike; with [`Films::Same`], two parts that scored different films of one
/// case.
pub fn merge(parts: Vec<Part>, films: Films) -> Result<Run> {
    // A part may itself be a merged run.
    let mut ids: Vec<String> = Vec::new();
    for id in parts.iter().flat_map(|part| &part.run.cells).map(|cell| &cell.run_id) {
        if !ids.contains(id) {
            ids.push(id.clone());
        }
    }
    let track = parts.first().map(|part| part.run.track).unwrap_or_default();
    if let Some(other) = parts.iter().find(|part| part.run.track != track) {
        let (a, b) = (track.word(), other.run.track.word());
        return Err(Error::input(format!("a table holds one track, and these are of {a} and of {b}")));
    }
    let mut trees: BTreeMap<String, String> = BTreeMap::new();
    // Those that this program filmed itself first: a third party's scores say of a tree what its film says, or nothing, and
    // are then written with the case as its own.
    let is_own = |part: &&Part| part.run.cells.iter().any(|cell| !cell.is_evaluated());
    let own_first = parts.iter().filter(is_own).chain(parts.iter().filter(|part| !is_own(part)));
    for case in own_first.flat_map(|part| &part.run.cases).filter(|case| !case.tree.is_empty()) {
        let known = trees.entry(case.id.clone()).or_default();
        if known.is_empty() || *known == case.id {
            *known = case.tree.clone();
        }
    }
    let mut titles: BTreeMap<String, String> = BTreeMap::new();
    for case in parts.iter().flat_map(|part| &part.run.cases).filter(|case| !case.title.is_empty()) {
        // `evaluate` does not know the title, and gives the id.
        let known = titles.entry(case.id.clone()).or_default();
        if known.is_empty() || *known == case.id {
            *known = case.title.clone();
        }
    }
    let conditions = conditions_of(&parts);
    let changed = changed_rows(&parts)?;
    let mut profiles: Vec<String> = Vec::new();
    let mut cells: Vec<CellRecord> = Vec::new();
    // Where a cell stands, by case, method and seed; and the first one of a method.
    let mut places: BTreeMap<(String, String, u64), usize> = BTreeMap::new();
    let mut firsts: BTreeMap<String, usize> = BTreeMap::new();
    let mut scenes = Scenes::default();
    let mut read_from = Vec::new();
    let mut notes = vec![format!("Put together from {}.", ids.join(", "))];
    for Part { folder, run } in parts {
        notes.extend(run.notes);
        let mut replaced: BTreeMap<String, Vec<String>> = BTreeMap::new();
        // A cell that is renewed takes its pictures along, even where the new run kept none.
        scenes.drop_rows_of(&run.cells.iter().map(CellRecord::row_key).collect());
        scenes.add(run.scenes);
        read_from.extend(run.read_from);
        for profile in run.profile.split(PROFILES_BETWEEN) {
            if profiles.iter().all(|known| known != profile) {
                profiles.push(profile.to_owned());
            }
        }
        for cell in run.cells {
            let key = (cell.case_id.clone(), cell.method.clone(), cell.seed);
            let place = places.get(&key).copied();
            let first = firsts.get(&cell.method).map(|&first| &cells[first]);
            refuse_other_origin(first, place.map(|place| &cells[place]), &cell)?;
            if let Some(place) = place {
                if !has_same_numbers(&cells[place], &cell) {
                    replaced.entry(cell.method.clone()).or_default().push(cell.case_id.clone());
                }
                cells[place] = cell;
            } else {
                firsts.entry(cell.method.clone()).or_insert(cells.len());
                places.insert(key, cells.len());
                cells.push(cell);
            }
        }
        for (method, cases) in replaced {
            let cases = distinct(cases.iter().map(String::as_str)).join(", ");
            notes.push(format!("`{method}` of {cases} is that of {}, in place of an earlier one.", folder.display()));
        }
    }
    refuse_alike(&cells)?;
    let id = format!("merged-{}", &hash::of_value(&ids)?[..8]);
    // A film that a part kept is shown with the rows that were scored on it, and with no others.
    let film = |cell: &CellRecord| cell.score().map(FilmKey::of);
    scenes.keep_scored(&cells.iter().filter_map(|cell| Some((cell.row_key(), film(cell)?))).collect());
    let profile = profiles.join(PROFILES_BETWEEN);
    let mut run = Run { id, profile, track, scenes, read_from, conditions, notes, ..Run::of_cells(cells, &trees) };
    run.mark_changed(changed.iter().map(String::as_str));
    for case in &mut run.cases {
        case.title = titles.remove(&case.id).unwrap_or_default();
    }
    run.notes.extend(notes_on_places(&run));
    for case in &run.cases {
        let of_film = films_of(&run.cells, &case.id);
        if of_film.len() < 2 {
            continue;
        }
        let named: Vec<String> = of_film.iter().map(FilmRows::words).collect();
        let sentence = format!("{} was filmed more than once: {}", case.id, named.join("; "));
        if films == Films::Same {
            return Err(Error::input(format!("{sentence}; --other-films merges them and says so")));
        }
        run.notes.push(sentence + ".");
    }
    Ok(run)
}

/// Own rows with other settings than those that come with the program.
///
/// Errors: a row that has them in one part and not in another.
fn changed_rows(parts: &[Part]) -> Result<BTreeSet<String>> {
    let changed: BTreeSet<String> = parts.iter().flat_map(|part| part.run.changed()).map(str::to_owned).collect();
    for id in &changed {
        let of = |is_changed: bool| {
            let has = |part: &&Part| part.run.methods.iter().any(|m| m.id == *id && m.is_changed == is_changed);
            parts.iter().find(has).map(|part| part.folder.display())
        };
        if let (Some(changed), Some(shipped)) = (of(true), of(false)) {
            return Err(Error::input(format!(
                "`{id}` has other settings in {changed} than in {shipped}, where they are those that come with the program: \
                 give the changed method an id of its own"
            )));
        }
    }
    Ok(changed)
}

/// What holds for the rows that this program ran, a sentence each; where not for those of all parts, with the parts' ids.
fn conditions_of(parts: &[Part]) -> Vec<String> {
    let own: Vec<&Run> =
        parts.iter().map(|part| &part.run).filter(|run| run.cells.iter().any(|cell| !cell.is_foreign())).collect();
    let sentences = distinct(own.iter().flat_map(|run| run.conditions.iter().map(String::as_str)));
    let stated = |sentence: &str| {
        let of: Vec<&str> = own
            .iter()
            .filter(|run| run.conditions.iter().any(|condition| condition == sentence))
            .map(|run| run.id.as_str())
            .collect();
        if of.len() == own.len() { sentence.to_owned() } else { format!("{}: {sentence}", of.join(", ")) }
    };
    sentences.into_iter().map(stated).collect()
}

/// Which cases and times of a merged run count in no place.
fn notes_on_places(run: &Run) -> Vec<String> {
    let counted = CountedRun::new(run);
    let ranking: BTreeSet<&str> = counted.ranking_cases().iter().map(|case| case.id.as_str()).collect();
    let others: Vec<&str> = run.cases.iter().map(|c| c.id.as_str()).filter(|id| !ranking.contains(id)).collect();
    let has_time = |method: &MethodInfo| !counted.case_values(&method.id, "time_total_s").is_empty();
    let stated: Vec<&str> = run
        .methods
        .iter()
        .filter(|m| m.role == Role::Ranked && has_time(m) && !counted.is_timed(&m.id))
        .map(|m| m.id.as_str())
        .collect();
    let mut notes = Vec::new();
    let has_no_place = |m: &&MethodInfo| m.role == Role::Ranked && !counted.is_complete(&m.id);
    let partly: Vec<&str> = run.methods.iter().filter(has_no_place).map(|m| m.id.as_str()).collect();
    if !partly.is_empty() {
        let partly = partly.join(", ");
        notes.push(format!(
            "Without a place, since not scored in every case that counts with the same seeds: {partly}."
        ));
    }
    if !others.is_empty() {
        let others = others.join(", ");
        notes.push(format!(
            "Listed, but of less than half of the rows that rank, so that they count in no mean or place: {others}."
        ));
    }
    let left_out = |m: &MethodInfo| {
        let seeds: Vec<String> = counted.seeds_left_out(&m.id).iter().map(u64::to_string).collect();
        (!seeds.is_empty()).then(|| format!("{} ({})", m.id, seeds.join(", ")))
    };
    let left_out: Vec<String> = run.methods.iter().filter_map(left_out).collect();
    if !left_out.is_empty() {
        let left_out = left_out.join(", ");
        notes.push(format!(
            "Seeds that a row has in half of the cases or fewer, which count in no mean or place: {left_out}."
        ));
    }
    if !stated.is_empty() {
        let stated = stated.join(", ");
        notes
            .push(format!("Times as stated, not measured beside the others, and therefore without a place: {stated}."));
    }
    notes
}

/// Rows of different origin are never one row: neither a run's and a third party's, nor two predictions of one name.
/// `first`: the first cell of the new one's method so far; `same`: the cell that it would replace.
fn refuse_other_origin(first: Option<&CellRecord>, same: Option<&CellRecord>, new: &CellRecord) -> Result<()> {
    let rename = "score the prediction again with `evaluate --method NAME`";
    if let Some(other) = first.filter(|other| other.is_evaluated() != new.is_evaluated()) {
        return Err(Error::input(format!(
            "`{}` is a method of {} and a prediction in {}: one row cannot be both; {rename}",
            new.method,
            if new.is_evaluated() { &other.run_id } else { &new.run_id },
            if new.is_evaluated() { &new.run_id } else { &other.run_id },
        )));
    }
    match same.filter(|other| other.is_foreign() && !has_same_numbers(other, new)) {
        Some(_) => Err(Error::input(format!(
            "`{}` has two different predictions of {}: leave one out, or {rename}",
            new.method, new.case_id
        ))),
        None => Ok(()),
    }
}

/// Two third parties' rows must not look like one.
fn refuse_alike(cells: &[CellRecord]) -> Result<()> {
    let foreign = distinct(cells.iter().filter(|cell| cell.is_foreign()).map(|cell| cell.method.as_str()));
    for (at, a) in foreign.iter().enumerate() {
        if let Some(b) = foreign[..at].iter().find(|b| method_name::look_alike(a, b)) {
            return Err(Error::input(format!(
                "`{b}` and `{a}` look alike in a table: score one of them again with `evaluate --method NAME`"
            )));
        }
    }
    Ok(())
}

fn has_same_numbers(a: &CellRecord, b: &CellRecord) -> bool {
    let numbers = |cell: &CellRecord| cell.score().map(|s| (s.case_hash.clone(), s.metrics.clone()));
    numbers(a) == numbers(b)
}

/// A film of a case and the methods that were scored on it.
struct FilmRows {
    /// What the film was made from.
    case_hash: String,
    /// What it held; empty where no row tells.
    content: String,
    methods: Vec<String>,
}

impl FilmRows {
    fn is_of(&self, score: &CellScore) -> bool {
        let (known, told) = (&self.content, &score.film_content);
        self.case_hash == score.case_hash && (known == told || known.is_empty() || told.is_empty())
    }

    fn words(&self) -> String {
        let short = |hash: &str| hash.chars().take(12).collect::<String>();
        let content = if self.content.is_empty() { String::new() } else { format!("{} of ", short(&self.content)) };
        format!("{content}{} ({})", short(&self.case_hash), self.methods.join(", "))
    }
}

/// The films of a case, sorted.
fn films_of(cells: &[CellRecord], case_id: &str) -> Vec<FilmRows> {
    let of_case = || cells.iter().filter(|c| c.case_id == case_id).filter_map(|c| Some((c, c.score()?)));
    let mut films: Vec<FilmRows> = Vec::new();
    // Rows that tell what the film held come first: the others join them.
    for tells in [true, false] {
        for (cell, score) in of_case().filter(|(_, score)| score.film_content.is_empty() != tells) {
            let at = films.iter().position(|film| film.is_of(score)).unwrap_or_else(|| {
                let (case_hash, content) = (score.case_hash.clone(), score.film_content.clone());
                films.push(FilmRows { case_hash, content, methods: Vec::new() });
                films.len() - 1
            });
            if !films[at].methods.contains(&cell.method) {
                films[at].methods.push(cell.method.clone());
            }
        }
    }
    films.sort_by(|a, b| (&a.case_hash, &a.content).cmp(&(&b.case_hash, &b.content)));
    films
}
