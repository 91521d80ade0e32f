//! `respire-bench import tree`: a bronchial tree as a table, measured from a surface or a centreline.

use std::path::PathBuf;

use clap::Args;

use super::Terminal;
use super::import_file::FileArguments;
use crate::airway::import_tree::{from_mesh, from_table};
use crate::base::range::{GENERATION, LEAST_RADIUS_MM};
use crate::base::{Error, Progress, Result, files};

/// Arguments of `import tree`.
#[derive(Args)]
#[command(
    after_help = "Example: respire-bench import tree airway.ply --axes ras --source \"who, licence\" --out tree.toml"
)]
pub struct TreeArguments {
    /// Closed airway surface (PLY, STL, OBJ), or a centreline table (CSV:
    /// id,x_mm,y_mm,z_mm,radius_mm,branch,generation,parent_id)
    #[arg(value_name = "MESH_OR_CSV")]
    input: PathBuf,
    #[command(flatten)]
    file: FileArguments,
    /// Data set, citation and licence, kept in the table
    #[arg(long)]
    source: String,
    /// Branches of a smaller median radius in mm are left out; those of a surface below 1 mm are not found at all
    #[arg(long, default_value_t = 1.2, value_name = "MM", value_parser = LEAST_RADIUS_MM.parser::<f64>())]
    least_radius_mm: f64,
    /// Generations beyond this one are left out
    #[arg(long, default_value_t = 8, value_name = "GENERATION", value_parser = GENERATION.parser::<u32>())]
    deepest: u32,
    /// Table to write
    #[arg(long, value_name = "TOML")]
    out: PathBuf,
}

/// Runs the command.
pub fn run(arguments: &TreeArguments, terminal: &Terminal) -> Result<()> {
    let meaning = arguments.file.meaning();
    let input = &arguments.input;
    if arguments.out.exists() {
        return Err(Error::input("is there already, and nothing is overwritten").at(&arguments.out));
    }
    terminal.stage("centreline and tree");
    let tree = if input.extension().is_some_and(|e| e.eq_ignore_ascii_case("csv")) {
        from_table(input, &meaning, &arguments.source)?
    } else {
        from_mesh(input, &meaning, &arguments.source, terminal)?
    };
    let tree = tree.reachable(arguments.least_radius_mm, arguments.deepest);
    terminal.proceed()?;
    let text = toml::to_string(&tree).map_err(|e| Error::input(e.to_string()))?;
    files::write_bytes(&arguments.out, text.as_bytes())?;
    terminal.note(&format!("{}: {} branches", arguments.out.display(), tree.branches.len()));
    Ok(())
}
