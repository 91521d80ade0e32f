//! What every import ends in: the arguments that make a case of an airway, and its files, which appear together or not
//! at all.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use serde::Serialize;

use super::Terminal;
use crate::airway::case::{
    AnatomySource, Breathing, CameraSettings, Case, ExposureSettings, Region, ScopeSettings, TrajectorySettings,
};
use crate::airway::centerline::Centerline;
use crate::airway::{self, case_centerline};
use crate::base::range::{FIELD_OF_VIEW_DEG, SCOPE_RADIUS_MM, SEED};
use crate::base::{Error, Progress, Result, Staging, TriangleMesh, files};
use crate::formats::mesh::write_ply;
use crate::simulate::trajectory::Route;

/// What the files of a case are called, after its id.
pub(super) const AIRWAY: &str = "airway.ply";
pub(super) const INSPIRATION: &str = "inspiration.ply";
pub(super) const EXPIRATION: &str = "expiration.ply";
pub(super) const CENTERLINE: &str = "centerline.csv";

/// The case that an import makes.
#[derive(Args)]
pub(super) struct CaseArguments {
    /// Name of the case: letters, digits, `-`, `_`
    #[arg(long, value_parser = case_id)]
    pub(super) id: String,
    /// Folder for the case
    #[arg(long, value_name = "DIR")]
    pub(super) out: PathBuf,
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

/// A name that files may have.
fn case_id(text: &str) -> Result<String, String> {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
    match !text.is_empty() && text.chars().all(is_plain) {
        true => Ok(text.to_owned()),
        false => Err("must be letters, digits, `-` and `_`".to_owned()),
    }
}

#[derive(Clone, Copy, ValueEnum)]
enum RegionChoice {
    Any,
    RightUpper,
    RightLower,
    LeftUpper,
    LeftLower,
}

impl CaseArguments {
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
    pub(super) fn case(&self, title: String, anatomy: AnatomySource, breathing: Option<Breathing>) -> Result<Case> {
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
            clinical: None,
            clinical_table: Default::default(),
            file: self.out.join(format!("{}.toml", self.id)),
        };
        case.validate()?;
        Ok(case)
    }

    pub(super) fn file(&self, name: &str) -> PathBuf {
        PathBuf::from(format!("{}-{name}", self.id))
    }
}

/// A case on its way into its folder: files are put together beside it, and appear there once the case can be filmed.
pub(super) struct NewCase<'a> {
    case: &'a CaseArguments,
    staging: Staging,
    files: Vec<PathBuf>,
}

impl<'a> NewCase<'a> {
    pub(super) fn new(case: &'a CaseArguments) -> Result<Self> {
        // It may have been edited: lens, waveform and scope have no other place. And the surfaces may be anybody's.
        let names = std::iter::once(PathBuf::from(format!("{}.toml", case.id)));
        let names = names.chain([AIRWAY, INSPIRATION, EXPIRATION, CENTERLINE].map(|name| case.file(name)));
        if let Some(file) = names.map(|name| case.out.join(name)).find(|file| file.exists()) {
            let sentence = "is there already, and nothing is overwritten: remove it, or take another --id";
            return Err(Error::input(sentence).at(file));
        }
        Ok(NewCase { case, staging: Staging::new(&case.out)?, files: Vec::new() })
    }

    pub(super) fn mesh(&mut self, name: &str, mesh: &TriangleMesh) -> Result<()> {
        let file = self.case.file(name);
        write_ply(&self.staging.path(&file), mesh, &["units mm", "space LPS", "normals point into the lumen"])?;
        self.files.push(file);
        Ok(())
    }

    pub(super) fn centerline(&mut self, line: &Centerline) -> Result<()> {
        let file = self.case.file(CENTERLINE);
        files::write_bytes(&self.staging.path(&file), case_centerline::to_csv(line).as_bytes())?;
        self.files.push(file);
        Ok(())
    }

    /// A file of text that belongs to the case.
    pub(super) fn text(&mut self, name: &str, text: &str) -> Result<()> {
        let file = self.case.file(name);
        files::write_bytes(&self.staging.path(&file), text.as_bytes())?;
        self.files.push(file);
        Ok(())
    }

    /// Where files that are of no use afterwards may be put.
    pub(super) fn workshop(&self) -> PathBuf {
        self.staging.path("work")
    }

    /// Writes the case file, proves that the case can be filmed, and moves all to where it belongs, the case file last.
    pub(super) fn finish(mut self, text: &str, terminal: &Terminal) -> Result<()> {
        let file = PathBuf::from(format!("{}.toml", self.case.id));
        let path = self.staging.path(&file);
        files::write_bytes(&path, text.as_bytes())?;
        let case = Case::load(&path)?;
        terminal.proceed()?;
        let anatomy = airway::build(&case)?;
        terminal.proceed()?;
        let route = Route::plan(&anatomy, &case.trajectory)?;
        terminal.proceed()?;
        self.files.push(file.clone());
        self.staging.publish(&self.files)?;
        terminal.note(&format!(
            "the way is {:.0} mm, its end moves {:.1} mm",
            route.length_mm(),
            route.end_motion_mm()
        ));
        terminal.line(self.case.out.join(file).display());
        Ok(())
    }
}

/// The name of a file, for a title.
pub(super) fn name_of(path: &Path) -> String {
    path.file_name().map(|n| n.to_string_lossy().to_string()).unwrap_or_default()
}

/// A case as text.
pub(super) fn case_head(case: &impl Serialize) -> Result<String> {
    toml::to_string(case).map_err(|e| Error::input(format!("cannot write the case file: {e}")))
}
