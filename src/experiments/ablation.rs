//! What each part of a method, and each property of a film, is worth, and which value of a number is best: the lines of
//! an ablations file, and each of their methods as shipped with several seeds, scored beside each other.
//!
//! They are run on tuning cases: whoever chooses a number by what it scores on a case has fitted the case.

use std::path::Path;

use crate::base::{Error, Estimate, Result, files};
use crate::bench::{Ablations, Catalogue, FinishedCell, Pipeline, Store, Variant, execute_at_once};
use crate::experiments::ExperimentWatcher;
use crate::report::ablation::VariantScores;
use crate::score::CellScore;

/// Whether variants may be run on cases that are scored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ScoredCases {
    /// No.
    Refused,
    /// Yes: nothing will be chosen by the answer.
    Taken,
}

/// Which variants are run, and on what.
pub struct AblationPlan<'a> {
    /// Where cases, methods and profiles are described.
    pub catalogue: &'a Catalogue,
    /// The file of the lines.
    pub file: &'a Path,
    /// The lines of the file.
    pub ablations: &'a Ablations,
    /// Whether the cases may be scored ones.
    pub scored_cases: ScoredCases,
    /// Cells that run at once.
    pub at_once: usize,
    /// Ids of the cases.
    pub cases: &'a [String],
    /// Name of the profile, or the path of its file.
    pub profile: &'a str,
    /// Folder of sequences and finished cells.
    pub cache: &'a Path,
}

/// Runs the shipped methods and then the variants. `each` is handed all scores so far after every variant, so that a
/// long run can be inspected and stopped.
pub fn run(
    plan: &AblationPlan<'_>,
    watcher: &dyn ExperimentWatcher,
    mut each: impl FnMut(&[VariantScores]) -> Result<()>,
) -> Result<()> {
    let seeds = &plan.ablations.noise_seeds;
    let shipped = plan.ablations.methods();
    let track = plan.ablations.track();
    let shipped = shipped.iter().map(|method| (Variant { track, ..Variant::shipped(method) }, &seeds[..]));
    // A line that changes nothing shows a shipped method beside others.
    let of_line = |v: &Variant| if v.is_shipped() { &seeds[..] } else { &seeds[..1] };
    let varied = plan.ablations.ablation.iter().map(|v| (v.clone(), of_line(v)));
    let mut pipelines = Vec::new();
    for (variant, seeds) in shipped.chain(varied) {
        // All are read before the first is run: a mistake in the last line shows now.
        let pipeline = Pipeline::of_variant(plan.catalogue, plan.profile, plan.cases, seeds, &variant)
            .map_err(|e| if variant.group.is_empty() { e } else { at_line(plan.file, &variant, &e) })?;
        if plan.scored_cases == ScoredCases::Refused {
            refuse_scored(plan.catalogue, &pipeline)?;
        }
        pipelines.push((variant, pipeline));
    }
    let nothing = Estimate { resumable: true, ..Estimate::default() };
    watcher.accepts(&pipelines.iter().map(|(_, pipeline)| pipeline.estimate()).fold(nothing, Estimate::then))?;
    let store = Store::open(plan.cache)?;
    let mut all = Vec::new();
    let count = pipelines.len();
    for (i, (variant, pipeline)) in pipelines.into_iter().enumerate() {
        let group = if variant.group.is_empty() { "as shipped" } else { &variant.group };
        let label = format!("{} of {count}: {} {group} {}", i + 1, variant.method, variant.setting);
        watcher.stage_starts(label.trim_end());
        let finished = execute_at_once(&pipeline.plan()?, &pipeline, &store, plan.at_once, watcher)?;
        all.push(scores(variant, &finished, plan.at_once)?);
        each(&all)?;
    }
    Ok(())
}

/// The error of a line of the ablations file, which may have changed a method or a case.
fn at_line(file: &Path, variant: &Variant, error: &Error) -> Error {
    let line = format!("group \"{}\", setting \"{}\"", variant.group, variant.setting);
    Error::new(error.kind(), error.to_string()).element(line).at(file)
}

/// Refuses the cases that methods are compared on, by whatever path they are named.
fn refuse_scored(catalogue: &Catalogue, pipeline: &Pipeline) -> Result<()> {
    let scored = catalogue.case_ids()?;
    match pipeline.cases().iter().find(|case| scored.contains(&case.id)) {
        None => Ok(()),
        Some(case) => Err(Error::usage(format!(
            "{} is a scored case, and what is chosen by the answer would be fitted to it: take the tuning cases ({}), or \
             say --scored-cases",
            case.id,
            catalogue.tuning_ids()?.join(", ")
        ))),
    }
}

/// Cells that were made beside others have no seconds that are comparable with those of a run of one at a time.
fn scores(variant: Variant, finished: &[FinishedCell], at_once: usize) -> Result<VariantScores> {
    let read = |cell: &FinishedCell| {
        let mut score: CellScore = files::read_json(&cell.score)?;
        if at_once == 1 && !cell.is_timed() {
            score.without_times();
        }
        // A score may have been made, and kept, before it knew its seed.
        Ok(CellScore { seed: cell.cell.seed, ..score })
    };
    let scored = finished.iter().filter(|cell| cell.failure.is_none());
    let cells = scored.map(read).collect::<Result<Vec<_>>>()?;
    Ok(VariantScores {
        is_shipped: variant.is_shipped(),
        of_axis: variant.of_axis,
        group: variant.group,
        setting: variant.setting,
        method: variant.method,
        failed: finished.len() - cells.len(),
        cells,
    })
}
