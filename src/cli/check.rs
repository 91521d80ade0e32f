//! `check`: says in one sentence what is wrong with a folder.

use std::path::PathBuf;

use super::Terminal;
use super::evaluate::check_name;
use crate::base::Result;
use crate::score::{check_prediction, check_truth};
use crate::simulate::sequence::Sequence;

/// Arguments of `check`.
#[derive(clap::Args)]
#[command(
    after_help = "Without --sequence the folder is checked as a sequence. Exit code 4 when something is wrong.\n\
    Example: respire-bench check my-method/case1 --sequence .cache/sequences/case1-0123456789ab"
)]
pub struct CheckArguments {
    /// Folder of predictions, or a sequence
    #[arg(value_name = "DIR")]
    folder: PathBuf,
    /// The sequence that the predictions are of
    #[arg(long, value_name = "DIR")]
    sequence: Option<PathBuf>,
    /// Write JSON
    #[arg(long)]
    json: bool,
}

/// Reads every file; says what is there, or fails with the first thing that is wrong.
pub fn run(arguments: CheckArguments, terminal: &Terminal) -> Result<()> {
    let Some(sequence) = &arguments.sequence else {
        let sequence = Sequence::open(&arguments.folder)?;
        sequence.verify()?;
        let frames = check_truth(&sequence).map_err(|e| e.at(&arguments.folder))?;
        if arguments.json {
            return terminal.json(&serde_json::json!({ "frames": frames }));
        }
        terminal.line(format_args!("a sound sequence of {frames} frames"));
        return Ok(());
    };
    let sequence = Sequence::open(sequence)?;
    check_name(&arguments.folder, &sequence)?;
    let found = check_prediction(&sequence, &arguments.folder)?;
    if arguments.json {
        return terminal.json(&found);
    }
    let without = match found.not_applicable.as_slice() {
        [] => "every metric applies".to_owned(),
        ids => format!("not applicable: {}", ids.join(", ")),
    };
    terminal.line(format_args!("a sound prediction of {} frames; {without}", found.frames));
    Ok(())
}
