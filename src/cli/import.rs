//! `respire-bench import`: a user's anatomy or a measured motion becomes a case.

use std::path::PathBuf;

use clap::{Args, Subcommand};

use super::Terminal;
use super::import_ct::{self, CtArguments};
use super::import_file::expected_anatomy;
use super::import_mesh::{self, MeshArguments, PairArguments};
use super::import_motion::{MotionArguments, still_breathing};
use super::import_tree::{self, TreeArguments};
use super::stopped::all_or_nothing;
use crate::airway;
use crate::airway::breathing_text::with_breathing;
use crate::airway::case::Case;
use crate::base::{Progress, Result, files};

/// Arguments of `import`.
#[derive(Args)]
#[command(after_help = "Example: respire-bench import mesh airway.ply --landmarks motion.csv --id own --out cases\n\
    Each kind has one of its own: respire-bench import ct --help")]
pub struct ImportArguments {
    #[command(subcommand)]
    kind: ImportKind,
}

#[derive(Subcommand)]
enum ImportKind {
    /// Fits measured landmark motion and writes it as the `[breathing]` part of a case file
    Breathing(BreathingArguments),
    /// Makes a case of two CT scans, or of one scan or airway mask and a measured motion
    Ct(Box<CtArguments>),
    /// Makes a case of one airway surface and measured landmark motion
    Mesh(MeshArguments),
    /// Makes a case of two registered airway surfaces
    MeshPair(PairArguments),
    /// Measures a bronchial tree from a surface or a centreline table
    Tree(TreeArguments),
}

#[derive(Args)]
#[command(after_help = "Example: respire-bench import breathing cases/own.toml --landmarks copd01.csv --other-patient")]
struct BreathingArguments {
    /// Case file; its `[breathing]` is replaced, or added, and all else in it stays
    #[arg(value_name = "CASE.toml")]
    case: PathBuf,
    #[command(flatten)]
    motion: MotionArguments,
    /// Take landmarks that are no human lung's by their size or motion (an animal, a phantom)
    #[arg(long)]
    unusual: bool,
}

/// Runs the command.
pub fn run(arguments: ImportArguments, terminal: &Terminal) -> Result<()> {
    all_or_nothing(match arguments.kind {
        ImportKind::Breathing(arguments) => import_breathing(&arguments, terminal),
        ImportKind::Ct(arguments) => import_ct::run(&arguments, terminal),
        ImportKind::Mesh(arguments) => import_mesh::run(&arguments, terminal),
        ImportKind::MeshPair(arguments) => import_mesh::run_pair(&arguments, terminal),
        ImportKind::Tree(arguments) => import_tree::run(&arguments, terminal),
    })
}

fn import_breathing(arguments: &BreathingArguments, terminal: &Terminal) -> Result<()> {
    let motion = arguments.motion.read(expected_anatomy(arguments.unusual))?;
    let text = files::read_text(&arguments.case)?;
    let still = with_breathing(&text, &arguments.case, &still_breathing())?;
    let mut case: Case = files::parse_toml(&still, &arguments.case)?;
    case.file = arguments.case.clone();
    case.validate().map_err(|e| e.at(&arguments.case))?;
    let rest = airway::build(&case).map_err(|e| case.blamed(e))?;
    terminal.proceed()?;
    let breathing = arguments.motion.fit(&rest, &case, &motion, terminal)?;
    terminal.proceed()?;
    let written = with_breathing(&text, &arguments.case, &breathing)?;
    files::write_bytes(&arguments.case, written.as_bytes())
}
