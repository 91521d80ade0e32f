//! `respire-bench import mesh` and `import mesh-pair`: airway surfaces become cases.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use serde::Serialize;

use super::Terminal;
use super::import_file::FileArguments;
use super::import_motion::{MotionArguments, still_breathing};
use crate::airway::case::{
    AnatomySource, Breathing, CameraSettings, Case, ExposureSettings, Region, ScopeSettings, TrajectorySettings,
};
use crate::airway::centerline::Centerline;
use crate::airway::import_breathing::breathing_toml;
use crate::airway::{self, case_build, case_centerline};
use crate::base::range::{FIELD_OF_VIEW_DEG, SCOPE_RADIUS_MM, SEED};
use crate::base::{Error, Progress, Result, Staging, TriangleMesh, files};
use crate::formats::mesh::write_ply;
use crate::simulate::trajectory::Route;

/// What the files of a case are called, after its id.
const AIRWAY: &str = "airway.ply";
const INSPIRATION: &str = "inspiration.ply";
const EXPIRATION: &str = "expiration.ply";
const CENTERLINE: &str = "centerline.csv";

/// Arguments of `import mesh`.
#[derive(Args)]
#[command(
    after_help = "Writes DIR/<id>.toml with its own mesh and centreline beside it.\nExample: respire-bench import \
    mesh airway.ply --axes ras --landmarks copd03.csv --lung-boxes lung_boxes.csv --id mine --out mine"
)]
pub struct MeshArguments {
    /// Closed airway surface (PLY, STL, OBJ) in mm
    #[arg(value_name = "MESH")]
    mesh: PathBuf,
    #[command(flatten)]
    common: CommonArguments,
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
    common: CommonArguments,
}

#[derive(Args)]
struct CommonArguments {
    #[command(flatten)]
    file: FileArguments,
    /// Name of the case: letters, digits, `-`, `_`
    #[arg(long)]
    id: String,
    /// Folder for the case
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Horizontal field of view in degrees
    #[arg(long, default_value_t = 100.0, value_name = "DEG", value_parser = FIELD_OF_VIEW_DEG.parser::<f64>())]
    fov_x_deg: f64,
    /// Radius of the scope in mm
    #[arg(long, default_value_t = 1.6, value_name = "MM", value_parser = SCOPE_RADIUS_MM.parser::<f64>())]
    scope_radius_mm: f64,
    /// Part of the lungs in which the way ends
    #[arg(long, value_enum, default_value = "any")]
    region: RegionChoice,
    /// Seed of everything random
    #[arg(long, default_value_t = 1, value_name = "N", value_parser = SEED.parser::<u64>())]
    seed: u64,
}

#[derive(Clone, Copy, ValueEnum)]
enum RegionChoice {
    Any,
    RightUpper,
    RightLower,
    LeftUpper,
    LeftLower,
}

impl CommonArguments {
    fn region(&self) -> Region {
        match self.region {
            RegionChoice::Any => Region::Any,
            RegionChoice::RightUpper => Region::RightUpper,
            RegionChoice::RightLower => Region::RightLower,
            RegionChoice::LeftUpper => Region::LeftUpper,
            RegionChoice::LeftLower => Region::LeftLower,
        }
    }

    /// The case, checked before anything is written under its name.
    fn case(&self, title: String, anatomy: AnatomySource, breathing: Option<Breathing>) -> Result<Case> {
        let case = Case {
            id: self.id.clone(),
            title,
            seed: self.seed,
            camera: CameraSettings { fov_x_deg: self.fov_x_deg, fisheye: None },
            trajectory: TrajectorySettings {
                scope_radius_mm: self.scope_radius_mm,
                seed: self.seed,
                region: self.region(),
                ..TrajectorySettings::default()
            },
            waveform: Default::default(),
            light_intensity: [1000.0; 3],
            exposure: ExposureSettings::default(),
            scope: ScopeSettings::default(),
            material: toml::Table::new(),
            anatomy,
            breathing,
            registration_error_mm: 0.0,
            folder: self.out.clone(),
        };
        case.validate()?;
        Ok(case)
    }

    fn file(&self, name: &str) -> PathBuf {
        PathBuf::from(format!("{}-{name}", self.id))
    }
}

/// A case on its way into its folder: files are put together beside it, and appear there once the case can be filmed.
struct NewCase<'a> {
    common: &'a CommonArguments,
    staging: Staging,
    files: Vec<PathBuf>,
}

impl<'a> NewCase<'a> {
    fn new(common: &'a CommonArguments) -> Result<Self> {
        Ok(NewCase { common, staging: Staging::new(&common.out)?, files: Vec::new() })
    }

    fn mesh(&mut self, name: &str, mesh: &TriangleMesh) -> Result<()> {
        let file = self.common.file(name);
        write_ply(&self.staging.path(&file), mesh, &["units mm", "space LPS", "normals point into the lumen"])?;
        self.files.push(file);
        Ok(())
    }

    fn centerline(&mut self, line: &Centerline) -> Result<()> {
        let file = self.common.file(CENTERLINE);
        files::write_bytes(&self.staging.path(&file), case_centerline::to_csv(line).as_bytes())?;
        self.files.push(file);
        Ok(())
    }

    /// Writes the case file, proves that the case can be filmed, and moves all to where it belongs, the case file last.
    fn finish(mut self, text: &str, terminal: &Terminal) -> Result<()> {
        let file = PathBuf::from(format!("{}.toml", self.common.id));
        let path = self.staging.path(&file);
        files::write_bytes(&path, text.as_bytes())?;
        let case = Case::load(&path)?;
        let route = Route::plan(&airway::build(&case)?, &case.trajectory)?;
        self.files.push(file.clone());
        self.staging.publish(&self.files)?;
        terminal.note(&format!(
            "the way is {:.0} mm, its end moves {:.1} mm",
            route.length_mm(),
            route.end_motion_mm()
        ));
        terminal.line(self.common.out.join(file).display());
        Ok(())
    }
}

fn name_of(path: &Path) -> String {
    path.file_name().map(|n| n.to_string_lossy().to_string()).unwrap_or_default()
}

/// Runs `import mesh`.
pub fn run(arguments: &MeshArguments, terminal: &Terminal) -> Result<()> {
    let common = &arguments.common;
    let meaning = common.file.meaning();
    let title = format!("{} with the motion of {}", name_of(&arguments.mesh), name_of(&arguments.motion.landmarks));
    let anatomy = AnatomySource::Mesh { path: common.file(AIRWAY), centerline: Some(common.file(CENTERLINE)) };
    let mut case = common.case(title, anatomy, Some(still_breathing()))?;
    let mesh = meaning.read_surface(&arguments.mesh)?;
    // Landmarks are read before the long work, so that a wrong file is reported at once.
    let pairs = arguments.motion.read()?;
    let line = meaning.centerline(&mesh).map_err(|e| e.at(&arguments.mesh))?;
    let mut new = NewCase::new(common)?;
    new.mesh(AIRWAY, &mesh)?;
    new.centerline(&line)?;
    let rest = case_build::from_field(mesh, line, None, &still_breathing()).map_err(|e| e.at(&arguments.mesh))?;
    let found = arguments.motion.fit(&rest, &case, &pairs, terminal)?;
    case.breathing = None;
    new.finish(&format!("{}\n{}", case_head(&case)?, breathing_toml(&found.breathing)), terminal)
}

/// Runs `import mesh-pair`.
pub fn run_pair(arguments: &PairArguments, terminal: &Terminal) -> Result<()> {
    let common = &arguments.common;
    let meaning = common.file.meaning();
    let title = format!("{} and {}", name_of(&arguments.inspiration), name_of(&arguments.expiration));
    let anatomy = AnatomySource::MeshPair {
        inspiration: common.file(INSPIRATION),
        expiration: common.file(EXPIRATION),
        centerline: Some(common.file(CENTERLINE)),
    };
    let case = common.case(title, anatomy, None)?;
    let rest = meaning.read_surface(&arguments.inspiration)?;
    let other = meaning.read_surface(&arguments.expiration)?;
    meaning.check_pair(&rest, &other).map_err(|e| e.at(&arguments.expiration))?;
    let line = meaning.centerline(&rest).map_err(|e| e.at(&arguments.inspiration))?;
    let mut new = NewCase::new(common)?;
    new.mesh(INSPIRATION, &rest)?;
    new.mesh(EXPIRATION, &other)?;
    new.centerline(&line)?;
    new.finish(&case_head(&case)?, terminal)
}

fn case_head(case: &impl Serialize) -> Result<String> {
    toml::to_string(case).map_err(|e| Error::input(format!("cannot write the case file: {e}")))
}
