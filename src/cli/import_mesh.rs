//! `respire-bench import mesh` and `import mesh-pair`: airway surfaces become cases.

use std::path::PathBuf;

use clap::Args;

use super::Terminal;
use super::import_case::{AIRWAY, CENTERLINE, CaseArguments, EXPIRATION, INSPIRATION, NewCase, case_head, name_of};
use super::import_file::FileArguments;
use super::import_motion::{MotionArguments, still_breathing};
use crate::airway::case::AnatomySource;
use crate::airway::case_build;
use crate::airway::import_breathing::breathing_toml;
use crate::base::{Error, ErrorKind, Progress, Result};

/// Arguments of `import mesh`.
#[derive(Args)]
#[command(
    after_help = "Writes DIR/<id>.toml with its own mesh and centreline beside it.\nExample: respire-bench import \
    mesh airway.ply --axes ras --landmarks motion.csv --id mine --out mine"
)]
pub struct MeshArguments {
    /// Closed airway surface (PLY, STL, OBJ) in mm
    #[arg(value_name = "MESH")]
    mesh: PathBuf,
    #[command(flatten)]
    file: FileArguments,
    #[command(flatten)]
    case: CaseArguments,
    #[command(flatten)]
    motion: MotionArguments,
}

/// Arguments of `import mesh-pair`.
#[derive(Args)]
#[command(
    after_help = "Both meshes must have the same faces in the same order.\nExample: respire-bench import mesh-pair \
    inspiration.ply expiration.ply --id mine --out mine"
)]
pub struct PairArguments {
    /// Closed surface at full inspiration (PLY, STL, OBJ) in mm
    #[arg(value_name = "INSPIRATION")]
    inspiration: PathBuf,
    /// The same faces at full expiration
    #[arg(value_name = "EXPIRATION")]
    expiration: PathBuf,
    #[command(flatten)]
    file: FileArguments,
    #[command(flatten)]
    case: CaseArguments,
}

/// Runs `import mesh`.
pub fn run(arguments: &MeshArguments, terminal: &Terminal) -> Result<()> {
    let wanted = &arguments.case;
    let meaning = arguments.file.meaning();
    let title = format!("{} with the motion of {}", name_of(&arguments.mesh), arguments.motion.name()?);
    let anatomy = AnatomySource::Mesh { path: wanted.file(AIRWAY), centerline: Some(wanted.file(CENTERLINE)) };
    let mut case = wanted.case(title, anatomy, Some(still_breathing()))?;
    terminal.stage(format_args!("{}: surface and centreline", wanted.id));
    let mesh = meaning.read_surface(&arguments.mesh)?;
    // The motion is read before the long work, so that a wrong file is reported at once.
    let motion = arguments.motion.read(meaning.anatomy)?;
    let line = meaning.centerline(&mesh, terminal).map_err(|e| e.at(&arguments.mesh))?;
    terminal.proceed()?;
    let mut new = NewCase::new(wanted)?;
    new.mesh(AIRWAY, &mesh)?;
    new.centerline(&line)?;
    let rest = case_build::from_field(mesh, line, None, &still_breathing()).map_err(|e| e.at(&arguments.mesh))?;
    terminal.stage(format_args!("{}: motion", wanted.id));
    terminal.proceed()?;
    let of_mesh = |e: Error| {
        let is_bare = e.path().is_none() && e.kind() == ErrorKind::InputOutput;
        if is_bare { e.at(&arguments.mesh) } else { e }
    };
    let breathing = arguments.motion.fit(&rest, &case, &motion, terminal).map_err(of_mesh)?;
    case.breathing = None;
    new.finish(&format!("{}\n{}", case_head(&case)?, breathing_toml(&breathing)), terminal)
}

/// Runs `import mesh-pair`.
pub fn run_pair(arguments: &PairArguments, terminal: &Terminal) -> Result<()> {
    let wanted = &arguments.case;
    let meaning = arguments.file.meaning();
    let title = format!("{} and {}", name_of(&arguments.inspiration), name_of(&arguments.expiration));
    let anatomy = AnatomySource::MeshPair {
        inspiration: wanted.file(INSPIRATION),
        expiration: wanted.file(EXPIRATION),
        centerline: Some(wanted.file(CENTERLINE)),
    };
    let case = wanted.case(title, anatomy, None)?;
    terminal.stage(format_args!("{}: surfaces and centreline", wanted.id));
    let rest = meaning.read_surface(&arguments.inspiration)?;
    let other = meaning.read_surface(&arguments.expiration)?;
    meaning.check_pair(&rest, &other).map_err(|e| e.at(&arguments.expiration))?;
    let line = meaning.centerline(&rest, terminal).map_err(|e| e.at(&arguments.inspiration))?;
    terminal.proceed()?;
    let mut new = NewCase::new(wanted)?;
    new.mesh(INSPIRATION, &rest)?;
    new.mesh(EXPIRATION, &other)?;
    new.centerline(&line)?;
    new.finish(&case_head(&case)?, terminal)
}
