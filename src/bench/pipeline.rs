//! The real stages: the rooms `airway`, `simulate`, `reconstruct` and `score` behind the executor's trait.

use std::path::Path;
use std::sync::Arc;

use super::array_job::WorkCost;
use super::catalogue::Catalogue;
use super::executor::FinishedCell;
use super::plan::{Cell, Plan, Planned, choose};
use super::profile::Profile;
use super::revision::Revisions;
use super::stages::Stages;
use super::timing::StageTiming;
use super::variant::Variant;
use crate::airway::case::Case;
use crate::base::{Error, Estimate, Progress, Result, files, hash, own_row, shipped};
use crate::reconstruct::{self, Listing, MethodFile, Reconstruct};
use crate::report::run::note_on_changed;
use crate::report::scene::Scenes;
use crate::report::{CaseInfo, CellRecord, MethodInfo, Outcome, Run, StageCost};
use crate::score::{self, CellScore, Truth};
use crate::simulate::participant::{Given, Participant};
use crate::simulate::sequence::Sequence;
use crate::simulate::track::Track;
use crate::simulate::truth::TruthSet;
use crate::simulate::{self, MeshOutput, RadianceOutput, SimulationSettings};

/// Iterations of a frame of `ours`, and the core seconds that they take at the published scale in an image of 256x256
/// pixels and in one of no pixels; scoring included. The model behind [`Pipeline::estimate`].
const OUR_ITERATIONS: f64 = 130.0;
/// Discs on a face of `ours`. An iteration of BridgeSplat, which has 25, takes about as many times longer.
const OUR_DISCS_ON_A_FACE: f64 = 4.0;
const FRAME_S: f64 = 0.8;
const FRAME_PIXELS: f64 = 256.0 * 256.0;
const SMALL_FRAME_S: f64 = 0.1;
/// A report: CPU seconds for each frame of each cell, and MiB for each beside those of the program (measured: 126 cells
/// of `quick`).
const REPORT_FRAME_S: f64 = 1.3e-3;
const REPORT_FRAME_MIB: f64 = 0.014;
const REPORT_MIB: f64 = 75.0;
/// Memory of a reconstruction: of the Gaussians with their gradients, and of a pixel of a film that is held whole.
const CELL_BYTES: f64 = 3e8;
const FILM_PIXEL_BYTES: f64 = 8.0;

/// What the user asked for beyond the profile; `None` leaves it to the profile.
#[derive(Clone, Debug, Default)]
pub struct Wishes {
    /// Case ids or paths of case files.
    pub cases: Option<Vec<String>>,
    /// Method ids.
    pub methods: Option<Vec<String>>,
    /// Seeds.
    pub seeds: Option<Vec<u64>>,
    /// How the cases are filmed.
    pub track: Track,
}

/// Everything that a run needs, read and checked.
pub struct Pipeline {
    profile: Profile,
    track: Track,
    cases: Vec<Case>,
    methods: Vec<Method>,
    seeds: Vec<u64>,
}

struct Method {
    content: String,
    method: Box<dyn Reconstruct>,
    /// Iterations of a frame over those of `ours`, the profile's scale included.
    effort: f64,
    /// Whether it has the id of an own row and other keys than the file of that row which the program carries.
    is_changed: bool,
}

/// Iterations of a frame that a method's keys name; those of `ours` where they name none. Three are stages of a frame,
/// two those of the first frame and of the others.
fn iterations(keys: &toml::Table) -> f64 {
    let number = |value: &toml::Value| value.as_integer().unwrap_or_default() as f64;
    match keys.get("iterations").and_then(|key| key.get("value")).and_then(|value| value.as_array()).map(Vec::as_slice)
    {
        Some([_, others]) => number(others),
        Some(stages) => stages.iter().map(number).sum(),
        None => OUR_ITERATIONS,
    }
}

/// How many times as long an iteration takes as one of `ours`, by the discs on a face that the keys name.
fn work_of_iteration(keys: &toml::Table) -> f64 {
    let discs = keys.get("gaussians_per_face").and_then(|key| key.get("value")).and_then(toml::Value::as_integer);
    discs.map_or(1.0, |discs| (discs as f64 / OUR_DISCS_ON_A_FACE).max(1.0))
}

impl Method {
    fn new(file: &MethodFile, profile: &Profile) -> Result<Self> {
        let scale = profile.iteration_scale;
        // Hash of the parsed keys, inherited ones included, so that changing a comment or a blank recomputes no cell.
        let content = hash::of_value(&(file.keys(), scale))?;
        let effort = scale * work_of_iteration(file.keys()) * iterations(file.keys()) / OUR_ITERATIONS;
        Ok(Method { content, method: file.method(scale)?, effort, is_changed: false })
    }

    /// The same, compared with the file that the program carries under its id.
    fn compared(self, file: &MethodFile) -> Result<Self> {
        let carried = Path::new(shipped::ROOT).join("methods").join(format!("{}.toml", self.method.id()));
        let is_changed = files::is_file(&carried) && MethodFile::load(&carried)?.keys() != file.keys();
        Ok(Method { is_changed, ..self })
    }
}

impl Pipeline {
    /// Reads the profile, the cases and the methods. Every mistake in them is found here, before any work.
    pub fn new(catalogue: &Catalogue, profile: &str, wishes: Wishes) -> Result<Self> {
        let track = wishes.track;
        let methods = |catalogue: &Catalogue, profile: &Profile, wanted: Option<&[String]>| {
            methods(catalogue, profile, wanted, track)
        };
        Self::assemble(catalogue, profile, wishes, &toml::Table::new(), methods)
    }

    /// The stages of one variant: its method alone, on cases with its changes.
    pub fn of_variant(
        catalogue: &Catalogue,
        profile: &str,
        cases: &[String],
        seeds: &[u64],
        variant: &Variant,
    ) -> Result<Self> {
        let (cases, seeds) = (Some(cases.to_vec()), Some(seeds.to_vec()));
        let wishes = Wishes { cases, methods: None, seeds, track: variant.track };
        Self::assemble(catalogue, profile, wishes, &variant.case, |catalogue, profile, _| {
            Ok(vec![Method::new(&variant.method_file(&catalogue.methods())?, profile)?])
        })
    }

    fn assemble(
        catalogue: &Catalogue,
        profile: &str,
        wishes: Wishes,
        changes: &toml::Table,
        methods: impl FnOnce(&Catalogue, &Profile, Option<&[String]>) -> Result<Vec<Method>>,
    ) -> Result<Self> {
        let profile = Profile::load(&catalogue.profiles(), profile)?;
        // What the profile's file says wrong is not said on the command line.
        let of_profile = |key: &'static str, asked: bool| {
            let file = profile.file.clone();
            move |e: Error| if asked { e } else { Error::input(e.to_string()).element(key).at(&file) }
        };
        let (asks_cases, asks_seeds) = (wishes.cases.is_some(), wishes.seeds.is_some());
        let wanted_cases = match wishes.cases.or_else(|| profile.cases.clone()) {
            Some(wanted) if wanted.is_empty() => {
                return Err(of_profile("cases", asks_cases)(Error::usage("names no case")));
            }
            Some(wanted) => wanted,
            None => catalogue.case_ids()?,
        };
        if wanted_cases.is_empty() {
            return Err(Error::input("there are no case files").at(catalogue.root()));
        }
        let load = |wish: &String| -> Result<Case> {
            let file = catalogue.case_file(wish).map_err(of_profile("cases", asks_cases))?;
            let case = wishes.track.filming(Case::load_changed(&file, changes)?).without(&profile.without);
            simulate::material(&case).map_err(|e| e.at(&file))?;
            film_settings(&profile, &case).check().map_err(|e| {
                Error::input(format!("profile `{}` gives {} no film: {e}", profile.name, case.id)).at(&file)
            })?;
            Ok(case)
        };
        let cases: Vec<Case> = wanted_cases.iter().map(load).collect::<Result<_>>()?;
        refuse_doubles(cases.iter().map(|case| case.id.as_str()), "case").map_err(of_profile("cases", asks_cases))?;
        let seeds = wishes.seeds.unwrap_or_else(|| profile.seeds.clone());
        refuse_doubles(seeds.iter(), "seed").map_err(of_profile("seeds", asks_seeds))?;
        let methods = methods(catalogue, &profile, wishes.methods.or_else(|| profile.methods.clone()).as_deref())?;
        Ok(Pipeline { profile, track: wishes.track, cases, methods, seeds })
    }

    /// The plan of these stages, with the revisions of this program.
    pub fn plan(&self) -> Result<Plan> {
        let cases = self.cases.iter().map(|case| {
            let content = hash::of_value(&(case.hash()?, self.simulation_settings(case)))?;
            Ok(Planned { id: case.id.clone(), content, draws: false })
        });
        let planned =
            |m: &Method| Planned { id: m.method.id().to_owned(), content: m.content.clone(), draws: m.method.draws() };
        let methods = self.methods.iter().map(planned).collect();
        Ok(Plan {
            profile: self.track.run_name(&self.profile.name),
            cases: cases.collect::<Result<_>>()?,
            methods,
            seeds: self.seeds.clone(),
            revisions: Revisions::of_this_program(),
        })
    }

    /// The track of its films.
    pub fn track(&self) -> Track {
        self.track
    }

    /// The profile.
    pub fn profile(&self) -> &Profile {
        &self.profile
    }

    /// What the whole plan would cost, were nothing in the cache.
    pub fn estimate(&self) -> Estimate {
        let nothing = Estimate { resumable: true, ..Estimate::default() };
        let effort: f64 = self.methods.iter().map(|method| method.effort * self.runs_of(method) as f64).sum();
        self.cases.iter().map(|case| self.case_estimate(case, effort)).fold(nothing, Estimate::then)
    }

    /// Cells of a method on each case: one stands for every seed where it draws nothing.
    fn runs_of(&self, method: &Method) -> usize {
        if method.method.draws() { self.seeds.len() } else { 1 }
    }

    /// A case's film, and cells that together take `effort` times the iterations of `ours`.
    fn case_estimate(&self, case: &Case, effort: f64) -> Estimate {
        let film = self.simulation_settings(case);
        let (frames, pixels) = (film.frames as f64, f64::from(film.width_px) * f64::from(film.height_px));
        let frame_s = effort * (SMALL_FRAME_S + FRAME_S * pixels / FRAME_PIXELS);
        let cells = Estimate {
            memory_bytes: CELL_BYTES + frames * pixels * FILM_PIXEL_BYTES,
            seconds: frames * frame_s / rayon::current_num_threads() as f64,
            resumable: true,
        };
        film.estimate(case).then(cells)
    }

    /// What a cell would cost, its film included, were nothing in the cache.
    pub fn cell_cost(&self, cell: &Cell) -> WorkCost {
        let of_case = self.cases.iter().find(|case| case.id == cell.case_id);
        let of_method = self.methods.iter().find(|method| method.method.id() == cell.method);
        let effort = of_method.map_or(1.0, |method| method.effort);
        let cost = of_case.map_or_else(Estimate::default, |case| self.case_estimate(case, effort));
        WorkCost {
            cpu_s: cost.seconds * rayon::current_num_threads() as f64,
            memory_mib: cost.memory_bytes / (1024.0 * 1024.0),
        }
    }

    /// What a report of all its cells costs.
    pub fn report_cost(&self) -> WorkCost {
        let rows: usize = self.methods.iter().map(|method| self.runs_of(method)).sum();
        let frames: usize = self.cases.iter().map(|case| self.simulation_settings(case).frames).sum();
        let pictures = (rows * frames) as f64;
        WorkCost { cpu_s: pictures * REPORT_FRAME_S, memory_mib: REPORT_MIB + pictures * REPORT_FRAME_MIB }
    }

    /// The cases that were chosen.
    pub fn cases(&self) -> &[Case] {
        &self.cases
    }

    /// The methods that were chosen, as reports show them.
    pub fn method_infos(&self) -> Vec<MethodInfo> {
        let info = |m: &Method| {
            let info = MethodInfo::of(m.method.id());
            if m.is_changed { info.changed() } else { info }
        };
        self.methods.iter().map(info).collect()
    }

    /// What a report is made of.
    pub fn record(&self, plan: &Plan, finished: &[FinishedCell]) -> Result<Run> {
        let cases = self.cases.iter().map(|case| {
            let of_case = |cell: &&FinishedCell| cell.cell.case_id == case.id;
            // Where every cell has failed, the film itself may have. A film that was scored can be read, or the report
            // would lack its truth without a word.
            let scored = finished.iter().filter(of_case).find(|cell| cell.failure.is_none());
            let sequence = match scored.or(finished.iter().find(of_case)) {
                Some(cell) if cell.failure.is_none() => Some(Sequence::open(&cell.sequence)?),
                Some(cell) => Sequence::open(&cell.sequence).ok(),
                None => None,
            };
            let truth = sequence.map(|sequence| Arc::new(sequence) as Arc<dyn Truth>);
            Ok(CaseInfo { id: case.id.clone(), title: case.title.clone(), tree: case.anatomy.tree(), truth })
        });
        let id = plan.run_id()?;
        Ok(Run {
            profile: self.profile.name.clone(),
            track: self.track,
            conditions: self.profile.note_on_iterations().into_iter().chain(self.note_on_changes()).collect(),
            notes: Vec::new(),
            cases: cases.collect::<Result<_>>()?,
            methods: self.method_infos(),
            cells: finished.iter().map(|cell| cell_record(cell, &id)).collect::<Result<_>>()?,
            scenes: Scenes::default(),
            read_from: Vec::new(),
            id,
        })
    }

    /// What a report says of rows that have an own row's id and are not run by its file.
    pub fn note_on_changes(&self) -> Option<String> {
        let ids: Vec<&str> = self.methods.iter().filter(|m| m.is_changed).map(|m| m.method.id()).collect();
        note_on_changed(&ids)
    }

    fn simulation_settings(&self, case: &Case) -> SimulationSettings {
        film_settings(&self.profile, case)
    }
}

/// How a profile films a case.
fn film_settings(profile: &Profile, case: &Case) -> SimulationSettings {
    SimulationSettings {
        width_px: profile.image_width_px,
        height_px: profile.image_width_px,
        frames_per_second: profile.frames_per_second,
        frames: profile.frames(case.waveform.period_s()),
        samples_per_pixel: profile.samples_per_pixel,
        meshes: MeshOutput::default(),
        radiance: RadianceOutput::default(),
        truth: TruthSet::default(),
        light: profile.light,
    }
}

fn cell_record(finished: &FinishedCell, run_id: &str) -> Result<CellRecord> {
    let outcome = match &finished.failure {
        Some(error) => Outcome::Failed(error.to_string()),
        None => {
            let mut score: CellScore = files::read_json(&finished.score)?;
            if !finished.is_timed() {
                score.without_times();
            }
            Outcome::Scored(Box::new(score))
        }
    };
    let cost = |t: &StageTiming| StageCost {
        stage: t.stage.clone(),
        wall_s: t.wall_s,
        cpu_s: t.cpu_s,
        peak_memory_mib: t.peak_memory_mib,
        threads: t.threads,
        machine_id: t.machine_id.clone(),
    };
    Ok(CellRecord {
        run_id: run_id.to_owned(),
        case_id: finished.cell.case_id.clone(),
        method: finished.cell.method.clone(),
        seed: finished.cell.seed,
        prediction: finished.prediction.clone(),
        outcome,
        timings: finished.timings.iter().map(cost).collect(),
    })
}

fn refuse_doubles<T: PartialEq + std::fmt::Display>(items: impl Iterator<Item = T>, what: &str) -> Result<()> {
    let mut seen = Vec::new();
    for item in items {
        if seen.contains(&item) {
            return Err(Error::usage(format!("the {what} `{item}` is named twice")));
        }
        seen.push(item);
    }
    Ok(())
}

/// The methods that are wanted; without a wish, those that are listed on `track`.
fn methods(catalogue: &Catalogue, profile: &Profile, wanted: Option<&[String]>, track: Track) -> Result<Vec<Method>> {
    let mut found = Vec::new();
    for file in reconstruct::method_files(&catalogue.methods())? {
        let method = Method::new(&file, profile)?;
        let is_carried = catalogue.root() == Path::new(shipped::ROOT);
        found.push(if is_carried { method } else { method.compared(&file)? });
    }
    // Further methods follow by name, as they were read.
    found.sort_by_key(|m| own_row::place(m.method.id()));
    let known: Vec<String> = found.iter().map(|m| m.method.id().to_owned()).collect();
    let chosen = choose(&known, wanted, "method")?;
    found.retain(|m| chosen.iter().any(|id| id == m.method.id()));
    if wanted.is_none() {
        found.retain(|m| match m.method.listing() {
            Listing::Always => true,
            Listing::Clinical => track == Track::Clinical,
            Listing::OnRequest => false,
        });
    }
    Ok(found)
}

/// A method by its id, and the seed of its randomness.
#[derive(Clone, Copy, Debug)]
pub struct SeededMethod<'a> {
    /// Id.
    pub id: &'a str,
    /// Seed.
    pub seed: u64,
}

/// Runs `method`, with the profile's iterations, on a film or a participant's folder, and writes its prediction
/// to the empty folder `out`.
///
/// Errors: an unknown profile or method, a folder that is not empty, those of reading, of the method and of writing.
pub fn reconstruct_folder(
    catalogue: &Catalogue,
    profile: &str,
    SeededMethod { id, seed }: SeededMethod<'_>,
    film: &Path,
    out: &Path,
    progress: &dyn Progress,
) -> Result<()> {
    let method = method_of(catalogue, profile, id)?;
    if out.exists() && out.read_dir().map_err(|e| Error::io("reading", out, e))?.next().is_some() {
        return Err(Error::input("is not empty: nothing is overwritten").at(out));
    }
    let film = open_given(film)?;
    let observation = reconstruct::observe(film.as_ref(), method.access(), seed)?;
    reconstruct::write_prediction(method.as_ref(), &observation, out, progress)
}

/// The method `id` at the size of `profile`. Errors: one of the two is unknown.
pub(super) fn method_of(catalogue: &Catalogue, profile: &str, id: &str) -> Result<Box<dyn Reconstruct>> {
    let profile = Profile::load(&catalogue.profiles(), profile)?;
    let found = methods(catalogue, &profile, Some(&[id.to_owned()]), Track::Ideal)?;
    let first = found.into_iter().next().map(|found| found.method);
    first.ok_or_else(|| Error::usage(format!("there is no method `{id}`")))
}

/// A film, or a participant's folder. Errors: it is neither.
pub fn open_given(folder: &Path) -> Result<Box<dyn Given>> {
    Ok(if Participant::is_at(folder) {
        Box::new(Participant::open(folder)?)
    } else {
        Box::new(Sequence::open(folder)?)
    })
}

impl Stages for Pipeline {
    fn film(&self, case_id: &str, folder: &Path, progress: &dyn Progress) -> Result<()> {
        let case = self.cases.iter().find(|c| c.id == case_id).expect("the plan is made from these cases");
        simulate::simulate(case, &self.simulation_settings(case), folder, progress).map(drop)
    }

    fn reconstruct(&self, cell: &Cell, sequence: &Path, prediction: &Path, progress: &dyn Progress) -> Result<()> {
        let method = self.methods.iter().find(|m| m.method.id() == cell.method);
        let method = &method.expect("the plan is made from these methods").method;
        let observation = reconstruct::observe(&Sequence::open(sequence)?, method.access(), cell.seed)?;
        reconstruct::write_prediction(method.as_ref(), &observation, prediction, progress)
    }

    fn score(&self, cell: &Cell, sequence: &Path, prediction: &Path, score: &Path) -> Result<()> {
        let method = Some(cell.method.clone());
        let settings = score::ScoreSettings { method, seed: cell.seed, ..score::ScoreSettings::default() };
        let scored = score::score(&Sequence::open(sequence)?, prediction, &settings)?;
        files::write_json(score, &scored)
    }
}
