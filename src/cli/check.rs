//! `check`: says in one sentence what is wrong with a folder.

use std::path::PathBuf;

use super::Terminal;
use crate::base::{ErrorKind, Result};
use crate::bench::evaluation::check_name;
use crate::score::{Question, check_prediction, check_truth};
use crate::simulate::participant::{Given, Participant};
use crate::simulate::sequence::Sequence;

/// Arguments of `check`.
#[derive(clap::Args)]
#[command(after_help = "\
    Without --sequence the folder is checked as a sequence, or as a participant's folder. Exit code 4 when something is \
    wrong; what is sound but most likely meant otherwise (a phase in percent, a depth in metres, a mesh under another \
    name) is a warning.\n\
    Example: respire-bench check my-method/case1 --sequence .cache/sequences/case1-0123456789ab/film")]
pub struct CheckArguments {
    /// Folder of predictions, a sequence, or a participant's folder
    #[arg(value_name = "DIR")]
    folder: PathBuf,
    /// The sequence that the predictions are of; a participant's folder will do
    #[arg(long, visible_alias = "truth", value_name = "DIR")]
    sequence: Option<PathBuf>,
    /// Write JSON: what is there and the warnings, or `error` and `path`
    #[arg(long)]
    json: bool,
}

/// Reads every file; says what is there, or fails with the first thing that is wrong, as JSON too where that is wanted.
pub fn run(arguments: CheckArguments, terminal: &Terminal) -> Result<()> {
    let checked = checked(&arguments, terminal);
    match &checked {
        Err(error) if arguments.json && error.kind() == ErrorKind::InputOutput => {
            terminal.json(&serde_json::json!({ "error": error.to_string(), "path": error.path() }))?;
        }
        _ => {}
    }
    checked
}

fn checked(arguments: &CheckArguments, terminal: &Terminal) -> Result<()> {
    terminal.stage("reading every file");
    let Some(sequence) = &arguments.sequence else {
        let (what, frames) = if Participant::is_at(&arguments.folder) {
            ("participant's folder", Participant::open(&arguments.folder)?.check()?)
        } else {
            let sequence = Sequence::open(&arguments.folder)?;
            sequence.verify()?;
            ("sequence", check_truth(&sequence).map_err(|e| e.at(&arguments.folder))?)
        };
        if arguments.json {
            return terminal.json(&serde_json::json!({ "frames": frames }));
        }
        terminal.line(format_args!("a sound {what} of {frames} frames"));
        return Ok(());
    };
    let question = if Participant::is_at(sequence) {
        let film = Participant::open(sequence)?;
        // On the clinical track the surface that is told has other vertices than the true one.
        let is_true = !film.given_poses_are_measured();
        let vertices = is_true.then(|| film.given_inspiration()).transpose()?.map(|surface| surface.vertices.len());
        Question::of_participant(&film).with_vertices(vertices)
    } else {
        let film = Sequence::open(sequence)?;
        Question::of(&film).with_vertices(Some(film.inspiration()?.vertices.len()))
    };
    check_name(&arguments.folder, &question)?;
    let found = check_prediction(&question, &arguments.folder)?;
    if arguments.json {
        return terminal.json(&found);
    }
    let without = match found.not_applicable.as_slice() {
        [] => "every metric applies".to_owned(),
        ids => format!("not applicable: {}", ids.join(", ")),
    };
    terminal.line(format_args!("a sound prediction of {} frames; {without}", found.frames));
    found.warnings.iter().for_each(|warning| terminal.line(format_args!("warning: {warning}")));
    Ok(())
}
