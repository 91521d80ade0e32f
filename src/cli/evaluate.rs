//! `evaluate`: scores a folder of predictions of any program.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::Terminal;
use crate::base::{Error, Result};
use crate::report::run::evaluated_id;
use crate::report::scene::Scenes;
use crate::report::{self, CaseInfo, CellRecord, MethodInfo, Outcome, Run};
use crate::score::{CellScore, Prediction, Question, ScoreSettings, registry, score};
use crate::simulate::sequence::Sequence;
use crate::simulate::track::Track;

/// Arguments of `evaluate`.
#[derive(clap::Args)]
#[command(
    after_help = "The folder holds color/NNNNNN.png, and as far as the method has them depth/NNNNNN.{exr,npy,png}, \
    ahead/NNNNNN.png, phase.csv (frame,phase), mesh/final.ply, correspondence.csv, timing.json ({\"time_total_s\": ..}), prediction.json \
    ({\"method\": .., \"case\": .., \"depth_unit_mm\": ..}); see docs/predictions.md. Names of this program's own rows are \
    reserved.\n\
    Example: respire-bench evaluate --sequence .cache/sequences/case1-0123456789ab --predictions my-method/case1 --out report"
)]
pub struct EvaluateArguments {
    /// Sequence folder with the truth; of a blind comparison, its `truth`
    #[arg(long, visible_alias = "truth", value_name = "DIR")]
    sequence: PathBuf,
    /// Folder of the predictions
    #[arg(long, value_name = "DIR")]
    predictions: PathBuf,
    /// Name of the method in tables [default: the one in prediction.json]
    #[arg(long, value_name = "NAME")]
    method: Option<String>,
    /// Write the whole report here: CSV, Markdown, LaTeX, HTML, plots, panels
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Write every number as JSON
    #[arg(long)]
    json: bool,
}

/// Scores, prints, and writes a report where asked for.
pub fn run(arguments: EvaluateArguments, terminal: &Terminal) -> Result<()> {
    let sequence = Sequence::open(&arguments.sequence)?;
    // Before the work.
    match &arguments.method {
        Some(name) => MethodInfo::check_foreign(name).map_err(|e| Error::usage(format!("--method: {e}")))?,
        None => check_name(&arguments.predictions, &Question::of(&sequence))?,
    }
    let settings = ScoreSettings { method: arguments.method.clone(), ..ScoreSettings::default() };
    let found = score(&sequence, &arguments.predictions, &settings)?;
    if arguments.json {
        terminal.json(&found)?;
    } else {
        print(&found, terminal);
    }
    if let Some(folder) = &arguments.out {
        terminal.stage("writing the report");
        let run = as_run(sequence, found, arguments.predictions.clone());
        let written = report::write(&run, folder, terminal)?;
        terminal.finish();
        if !arguments.json {
            terminal.line(format_args!("report: {}", written.html.display()));
        }
    }
    Ok(())
}

/// Refuses a prediction that names itself as an own row.
pub(super) fn check_name(prediction: &Path, question: &Question) -> Result<()> {
    let opened = Prediction::open(prediction, question)?;
    let named = |e: Error| e.element("method").at(prediction.join("prediction.json"));
    opened.method().map_or(Ok(()), MethodInfo::check_foreign).map_err(named)
}

fn print(found: &CellScore, terminal: &Terminal) {
    terminal.line(format_args!("{} on {}: {} frames", found.method, found.case_id, found.frames));
    for m in registry() {
        let Some(score) = found.metric(m.id) else { continue };
        let value = score.value.map_or_else(|| "-".to_owned(), |v| m.format(v));
        let interval =
            score.interval.map_or_else(String::new, |[low, high]| format!("({} to {})", m.format(low), m.format(high)));
        let status = if score.status.word() == "ok" { "" } else { score.status.word() };
        let line = format!("{:<22}{value:>10} {:<4}{interval:<22}{status} {}", m.id, m.unit, score.detail);
        terminal.line(line.trim_end());
    }
}

/// One case, one method: the report of a single prediction.
fn as_run(sequence: Sequence, found: CellScore, prediction: PathBuf) -> Run {
    let case_id = found.case_id.clone();
    let id = evaluated_id(&case_id, &found.method);
    Run {
        profile: "evaluate".into(),
        track: Track::Ideal,
        notes: Vec::new(),
        methods: vec![MethodInfo::of(&found.method)],
        cells: vec![CellRecord {
            run_id: id.clone(),
            case_id: case_id.clone(),
            method: found.method.clone(),
            seed: found.seed,
            prediction,
            outcome: Outcome::Scored(Box::new(found)),
            timings: Vec::new(),
        }],
        id,
        cases: vec![CaseInfo {
            title: String::new(),
            id: case_id,
            tree: String::new(),
            truth: Some(Arc::new(sequence)),
        }],
        scenes: Scenes::default(),
    }
}
