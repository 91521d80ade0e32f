//! `respire-bench import mesh` and `import mesh-pair`: airway surfaces become cases.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use serde::Serialize;

use super::Terminal;
use super::import_axes::AxesChoice;
use super::import_motion::{MotionArguments, fit_motion, still_breathing};
use crate::airway::case::{
    AnatomySource, Breathing, CameraSettings, Case, ExposureSettings, Region, ScopeSettings, TrajectorySettings,
};
use crate::airway::case_build::{self, read_mesh};
use crate::airway::centerline::{Centerline, CenterlineSettings};
use crate::airway::centerline_extract::extract;
use crate::airway::import_breathing::breathing_toml;
use crate::airway::{self, case_centerline};
use crate::base::range::{FIELD_OF_VIEW_DEG, SCOPE_RADIUS_MM, SEED};
use crate::base::{Error, Progress, Result, TriangleMesh, files};
use crate::formats::mesh::write_ply;
use crate::simulate::trajectory::Route;

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
    /// Which way the files' axes point (landmarks are always LPS)
    #[arg(long, value_enum, default_value = "lps")]
    axes: AxesChoice,
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

    /// A surface in LPS with normals into the lumen.
    fn read(&self, path: &Path) -> Result<TriangleMesh> {
        let axes = self.axes.axes();
        let mut mesh = read_mesh(path)?;
        mesh.vertices.iter_mut().for_each(|v| *v = axes.to_lps(*v));
        Ok(mesh)
    }

    fn case(&self, title: String, anatomy: AnatomySource, breathing: Option<Breathing>) -> Case {
        Case {
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
        }
    }

    fn file(&self, name: &str) -> PathBuf {
        PathBuf::from(format!("{}-{name}", self.id))
    }

    /// Writes mesh and centreline beside the case file.
    fn write(&self, name: &str, mesh: &TriangleMesh) -> Result<PathBuf> {
        let file = self.file(name);
        write_ply(&self.out.join(&file), mesh, &["units mm", "space LPS", "normals point into the lumen"])?;
        Ok(file)
    }

    fn write_centerline(&self, mesh: &TriangleMesh, source: &Path) -> Result<(PathBuf, Centerline)> {
        let line = extract(mesh, &CenterlineSettings::default()).map_err(|e| e.at(source))?;
        let file = self.file("centerline.csv");
        files::write_bytes(&self.out.join(&file), case_centerline::to_csv(&line).as_bytes())?;
        Ok((file, line))
    }
}

fn name_of(path: &Path) -> String {
    path.file_name().map(|n| n.to_string_lossy().to_string()).unwrap_or_default()
}

/// Runs `import mesh`.
pub fn run(arguments: &MeshArguments, terminal: &Terminal) -> Result<()> {
    let common = &arguments.common;
    let mesh = common.read(&arguments.mesh)?;
    // Landmarks are read before the long work, so that a wrong file is reported at once.
    crate::formats::landmarks::read(&arguments.motion.landmarks)?;
    let path = common.write("airway.ply", &mesh)?;
    let (centerline, line) = common.write_centerline(&mesh, &arguments.mesh)?;
    let title = format!("{} with the motion of {}", name_of(&arguments.mesh), name_of(&arguments.motion.landmarks));
    let anatomy = AnatomySource::Mesh { path, centerline: Some(centerline) };
    let mut case = common.case(title, anatomy, Some(still_breathing()));
    case.validate()?;
    let rest = case_build::from_field(mesh, line, None, &still_breathing()).map_err(|e| e.at(&arguments.mesh))?;
    let found = fit_motion(&rest, &case, &arguments.motion, terminal)?;
    case.breathing = None;
    let text = format!("{}\n{}", case_head(&case)?, breathing_toml(&found.breathing));
    finish(&common.out.join(format!("{}.toml", common.id)), &text, terminal)
}

/// Runs `import mesh-pair`.
pub fn run_pair(arguments: &PairArguments, terminal: &Terminal) -> Result<()> {
    let common = &arguments.common;
    let (rest, other) = (common.read(&arguments.inspiration)?, common.read(&arguments.expiration)?);
    if rest.faces != other.faces || rest.vertices.len() != other.vertices.len() {
        return Err(Error::input("has other faces than the inspiration mesh: the two are not registered")
            .at(&arguments.expiration));
    }
    let inspiration = common.write("inspiration.ply", &rest)?;
    let expiration = common.write("expiration.ply", &other)?;
    let (centerline, _) = common.write_centerline(&rest, &arguments.inspiration)?;
    let title = format!("{} and {}", name_of(&arguments.inspiration), name_of(&arguments.expiration));
    let anatomy = AnatomySource::MeshPair { inspiration, expiration, centerline: Some(centerline) };
    let case = common.case(title, anatomy, None);
    case.validate()?;
    finish(&common.out.join(format!("{}.toml", common.id)), &case_head(&case)?, terminal)
}

fn case_head(case: &impl Serialize) -> Result<String> {
    toml::to_string(case).map_err(|e| Error::input(format!("cannot write the case file: {e}")))
}

/// Writes the case file and proves that it can be filmed.
fn finish(path: &Path, text: &str, terminal: &Terminal) -> Result<()> {
    files::write_bytes(path, text.as_bytes())?;
    let case = Case::load(path)?;
    let anatomy = airway::build(&case)?;
    let route = Route::plan(&anatomy, &case.trajectory)?;
    terminal.note(&format!("the way is {:.0} mm, its end moves {:.1} mm", route.length_mm(), route.end_motion_mm()));
    terminal.line(path.display());
    Ok(())
}
