//! The case file: one TOML that says everything about one patient-like film, read, checked and hashed.

use std::path::{Path, PathBuf};

use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize};

pub use super::case_clinical::{ClinicalSettings, Condition};
use super::case_scope;
pub use super::case_scope::{Effect, ExposureControl, ExposureSettings, ScopeSettings};
pub use super::case_steering::SteeringSettings;
use super::field::BreathingField;
use super::field_calibre::Calibre;
use super::grow::GrowthSettings;
use super::surface::SurfaceSettings;
use super::waveform::Waveform;
use crate::base::camera::fisheye_rises_to;
use crate::base::range::{
    FIELD_OF_VIEW_DEG, GENERATION, KeyRanges, LEAST_RADIUS_MM, NumberRange, SCOPE_RADIUS_MM, SEED,
};
use crate::base::{Camera, Error, ErrorKind, Result, case_id, files, hash};

/// Ranges of `[camera]`.
const CAMERA_RANGES: KeyRanges =
    KeyRanges(&[("fov_x_deg", FIELD_OF_VIEW_DEG), ("fisheye", NumberRange::new(-10.0, 10.0))]);
/// Ranges of `[trajectory]`.
const TRAJECTORY_RANGES: KeyRanges = KeyRanges(&[
    ("speed_mm_per_s", NumberRange::new(1e-3, 1e4)),
    ("scope_radius_mm", SCOPE_RADIUS_MM),
    ("seed", SEED),
    // More room than this would bring the lens into the wall; more tilt would have it look backwards.
    ("steering.sideways", NumberRange::new(0.0, 0.8)),
    ("steering.tilt_deg", NumberRange::new(0.0, 45.0)),
    ("steering.roll_deg", NumberRange::new(0.0, 180.0)),
    ("steering.speed_variation", NumberRange::new(0.0, 2.0)),
]);
/// Range of `light_intensity`, W/sr.
const LIGHT_INTENSITY: NumberRange = NumberRange::new(1e-6, 1e9);

/// Range of `registration_error_mm`.
const REGISTRATION_ERROR_MM: NumberRange = NumberRange::new(0.0, 20.0);

/// Where the anatomy comes from. Paths are relative to the case file.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "kebab-case")]
pub enum AnatomySource {
    /// A bronchial tree as a table (centreline points and radii per branch), surfaced by our generator.
    Tree {
        /// The table.
        path: PathBuf,
        /// Branches whose median radius in mm is below this are left out.
        least_radius_mm: f64,
        /// Generations beyond this one are left out.
        deepest: u32,
        /// How the surface is made.
        surface: SurfaceSettings,
    },
    /// A tree grown by seeded published rules, surfaced by our generator.
    Grown {
        /// Seed of the growth.
        seed: u64,
        /// What is grown.
        growth: GrowthSettings,
        /// How the surface is made.
        surface: SurfaceSettings,
    },
    /// One closed surface at inspiration; the breathing field makes the other.
    Mesh {
        /// PLY, STL or OBJ.
        path: PathBuf,
        /// Centreline made at import (CSV); extracted from the mesh when absent.
        #[serde(skip_serializing_if = "Option::is_none")]
        centerline: Option<PathBuf>,
    },
    /// Two registered surfaces of one topology.
    MeshPair {
        /// Surface at full inspiration.
        inspiration: PathBuf,
        /// The same faces at full expiration.
        expiration: PathBuf,
        /// Centreline at inspiration made at import (CSV); extracted from the mesh when absent.
        #[serde(skip_serializing_if = "Option::is_none")]
        centerline: Option<PathBuf>,
    },
}

/// [`AnatomySource`] with the kind as the name of a table: serde then knows the key of a value that it refuses, which
/// it does not where the kind is a key among the others.
#[derive(Deserialize)]
#[serde(remote = "AnatomySource", rename_all = "kebab-case", deny_unknown_fields)]
enum AnatomyByKind {
    Tree {
        path: PathBuf,
        #[serde(default = "default_least_radius_mm")]
        least_radius_mm: f64,
        #[serde(default = "default_deepest")]
        deepest: u32,
        #[serde(default)]
        surface: SurfaceSettings,
    },
    Grown {
        seed: u64,
        #[serde(default)]
        growth: GrowthSettings,
        #[serde(default)]
        surface: SurfaceSettings,
    },
    Mesh {
        path: PathBuf,
        #[serde(default)]
        centerline: Option<PathBuf>,
    },
    MeshPair {
        inspiration: PathBuf,
        expiration: PathBuf,
        #[serde(default)]
        centerline: Option<PathBuf>,
    },
}

impl<'de> Deserialize<'de> for AnatomySource {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let mut keys = toml::Table::deserialize(deserializer)?;
        let Some(toml::Value::String(kind)) = keys.remove("kind") else {
            return Err(D::Error::missing_field("kind"));
        };
        let by_kind = toml::Table::from_iter([(kind, toml::Value::Table(keys))]);
        let refused = |e: toml::de::Error| D::Error::custom(e.to_string().trim_end().replace('\n', " "));
        AnatomyByKind::deserialize(toml::Value::Table(by_kind)).map_err(refused)
    }
}

impl AnatomySource {
    /// Rejects numbers that no anatomy has; the element names the key.
    fn validate(&self) -> Result<()> {
        let check = |key: &str, range: NumberRange, value: f64| range.check(value).map_err(|e| e.element(key));
        match self {
            AnatomySource::Tree { least_radius_mm, deepest, surface, .. } => {
                check("anatomy.least_radius_mm", LEAST_RADIUS_MM, *least_radius_mm)?;
                check("anatomy.deepest", GENERATION, f64::from(*deepest))?;
                surface.validate("anatomy.surface")
            }
            AnatomySource::Grown { seed, growth, surface } => {
                check("anatomy.seed", SEED, *seed as f64)?;
                growth.validate("anatomy.growth")?;
                surface.validate("anatomy.surface")
            }
            AnatomySource::Mesh { .. } | AnatomySource::MeshPair { .. } => Ok(()),
        }
    }

    /// Whose airway it is: cases of one tree are alike, whatever their motion and route.
    pub fn tree(&self) -> String {
        let name = |path: &Path| path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        match self {
            AnatomySource::Tree { path, .. } | AnatomySource::Mesh { path, .. } => name(path),
            AnatomySource::Grown { seed, .. } => format!("grown-{seed}"),
            AnatomySource::MeshPair { inspiration, .. } => name(inspiration),
        }
    }

    /// Files it names, as written in the case file.
    pub fn files(&self) -> Vec<&Path> {
        match self {
            AnatomySource::Tree { path, .. } => vec![path],
            AnatomySource::Grown { .. } => vec![],
            AnatomySource::Mesh { path, centerline } => {
                std::iter::once(path.as_path()).chain(centerline.as_deref()).collect()
            }
            AnatomySource::MeshPair { inspiration, expiration, centerline } => {
                [inspiration.as_path(), expiration].into_iter().chain(centerline.as_deref()).collect()
            }
        }
    }
}

/// How the airway moves and narrows.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Breathing {
    /// Change of calibre around the centreline.
    #[serde(default)]
    pub calibre: Calibre,
    /// Displacement from inspiration to expiration.
    pub field: BreathingField,
}

/// Optics of the scope.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraSettings {
    /// Horizontal field of view in degrees.
    pub fov_x_deg: f64,
    /// `k1..k4` of OpenCV's fisheye model; absent is a pinhole.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fisheye: Option<[f64; 4]>,
}

impl CameraSettings {
    /// Refuses a fisheye that bends back before the edge of the field of view, where its law means nothing.
    fn check_fisheye(&self) -> Result<()> {
        match self.fisheye {
            Some(k) if !fisheye_rises_to(self.fov_x_deg.to_radians() / 2.0, k) => {
                let half = self.fov_x_deg / 2.0;
                let sentence =
                    format!("stops rising before half of fov_x_deg, {half} degrees, and shows nothing there");
                Err(Error::input(sentence).element("camera.fisheye"))
            }
            _ => Ok(()),
        }
    }

    /// Intrinsics for a square image.
    pub fn camera(&self, width_px: u32, height_px: u32) -> Camera {
        let fov = self.fov_x_deg.to_radians();
        let mut camera = Camera::pinhole(width_px, height_px, fov);
        if let Some([k1, k2, k3, k4]) = self.fisheye {
            let t = fov / 2.0;
            let t2 = t * t;
            let edge = t * (1.0 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))));
            let focal = width_px as f64 / 2.0 / edge;
            camera = Camera { fl_x: focal, fl_y: focal, fisheye: self.fisheye, ..camera };
        }
        camera
    }
}

/// Part of the lungs in which a route ends. Sides are the patient's.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Region {
    /// Anywhere.
    #[default]
    Any,
    /// Right lung, not far below the carina.
    RightUpper,
    /// Right lung, well below the carina.
    RightLower,
    /// Left lung, not far below the carina.
    LeftUpper,
    /// Left lung, well below the carina.
    LeftLower,
}

/// The scope's route.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TrajectorySettings {
    /// Speed along the centreline at inspiration, mm/s; lowered when the route is too short for the film.
    pub speed_mm_per_s: f64,
    /// Radius of the scope in mm: the route ends where the lumen gets narrower.
    pub scope_radius_mm: f64,
    /// Which of the reachable ends is taken.
    pub seed: u64,
    /// Where the end must lie.
    pub region: Region,
    /// How the scope leaves the middle of the airway.
    pub steering: SteeringSettings,
}

impl Default for TrajectorySettings {
    fn default() -> Self {
        TrajectorySettings {
            speed_mm_per_s: 10.0,
            scope_radius_mm: 1.9,
            seed: 1,
            region: Region::Any,
            steering: SteeringSettings::default(),
        }
    }
}

/// A case file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Case {
    /// Name in tables and folders: letters, digits, `-`, `_`.
    pub id: String,
    /// One line for people.
    pub title: String,
    /// Seed of everything random in the film.
    pub seed: u64,
    /// Optics.
    pub camera: CameraSettings,
    /// The scope's route.
    #[serde(default)]
    pub trajectory: TrajectorySettings,
    /// Breathing over time.
    #[serde(default)]
    pub waveform: Waveform,
    /// Light at the scope's tip, W/sr per channel.
    #[serde(default = "default_light")]
    pub light_intensity: [f64; 3],
    /// Automatic exposure.
    #[serde(default)]
    pub exposure: ExposureSettings,
    /// Light guide, lens and sensor.
    #[serde(default)]
    pub scope: ScopeSettings,
    /// Look of the mucosa: the renderer's `[material]`. Here its numbers must be finite; their keys and ranges are
    /// checked when a film is made.
    #[serde(default)]
    pub material: toml::Table,
    /// Shape.
    pub anatomy: AnatomySource,
    /// Motion; absent only for a mesh pair.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub breathing: Option<Breathing>,
    /// Root mean square error in mm of the registration between the two CTs, as methods get it: a smooth random field
    /// is added to the expiration mesh that they are given. The film and the truth do not change.
    #[serde(default, skip_serializing_if = "super::waveform::is_zero")]
    pub registration_error_mm: f64,
    /// What its film of the clinical track has beyond the ideal one; `None` is the ideal track ([`Case::on_clinical_track`]).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub clinical: Option<ClinicalSettings>,
    /// `[clinical]` of the case file, for [`Case::on_clinical_track`].
    #[serde(skip)]
    pub clinical_table: ClinicalSettings,
    /// The case file: its relative paths begin beside it, and it is named where the case is wrong.
    #[serde(skip)]
    pub file: PathBuf,
}

fn default_light() -> [f64; 3] {
    [1000.0; 3]
}

fn default_least_radius_mm() -> f64 {
    1.1
}

fn default_deepest() -> u32 {
    9
}

impl Case {
    /// Reads and checks a case file. The error names the file and the line, key or missing file.
    pub fn load(path: &Path) -> Result<Case> {
        Case::checked(files::read_toml(path)?, path)
    }

    /// As [`Case::load`], with the keys of `changes` (paths with dots) set to other values first.
    pub fn load_changed(path: &Path, changes: &toml::Table) -> Result<Case> {
        if changes.is_empty() {
            return Case::load(path);
        }
        let mut table: toml::Table = files::read_toml(path)?;
        for (key, value) in changes {
            let keys: Vec<&str> = key.split('.').collect();
            files::insert_toml(&mut table, &keys, value.clone()).map_err(|e| e.at(path))?;
        }
        let refused = |e: toml::de::Error| Error::input(e.to_string().trim_end().replace('\n', " ")).at(path);
        let case = table.try_into().map_err(refused)?;
        Case::checked(case, path)
    }

    fn checked(mut case: Case, path: &Path) -> Result<Case> {
        case.file = path.to_path_buf();
        case.clinical_table = case.clinical.take().unwrap_or_default();
        case.clinical_table.validate().map_err(|e| e.at(path))?;
        case.validate().map_err(|e| e.at(path))?;
        for file in case.anatomy.files() {
            if !files::is_file(&case.resolve(file)) {
                let sentence = format!("names {}, which is not there", case.resolve(file).display());
                return Err(Error::input(sentence).element("anatomy").at(path));
            }
        }
        if let Some(folder) = &case.clinical_table.surfaces.folder {
            let named = case.resolve(folder);
            if !["inspiration.ply", "expiration.ply"].iter().all(|name| files::is_file(&named.join(name))) {
                let sentence = format!("{} holds no inspiration.ply and expiration.ply", named.display());
                return Err(Error::input(sentence).element("clinical.surfaces.folder").at(path));
            }
        }
        Ok(case)
    }

    /// A path of the case file, from the working folder.
    pub fn resolve(&self, path: &Path) -> PathBuf {
        self.file.with_file_name("").join(path)
    }

    /// What is wrong with the case, and with no file that it names, said of its own file.
    pub fn blamed(&self, error: Error) -> Error {
        let is_its_own = error.path().is_none() && error.kind() == ErrorKind::InputOutput && self.file.is_file();
        if is_its_own { error.at(&self.file) } else { error }
    }

    /// Content hash of the case and of every file it names, 64 hex digits.
    pub fn hash(&self) -> Result<String> {
        let mut parts = vec![hash::of_value(self)?];
        for file in self.anatomy.files() {
            parts.push(hash::of_file(&self.resolve(file))?);
        }
        for file in self.given_surfaces().into_iter().flatten() {
            parts.push(hash::of_file(&file)?);
        }
        hash::of_value(&parts)
    }

    /// The case as the clinical track films it, with `[clinical]` of its file: the ideal track knows nothing of it.
    pub fn on_clinical_track(mut self) -> Case {
        self.clinical = Some(self.clinical_table.clone());
        self
    }

    /// Paths of the surfaces at inspiration and expiration that methods of the clinical track are given in place of the
    /// true ones; `None` where they are given those.
    pub fn given_surfaces(&self) -> Option<[PathBuf; 2]> {
        let settings = self.clinical.as_ref().filter(|settings| settings.has(Condition::Surfaces))?;
        let beside = Path::new("clinical").join(&self.id);
        let folders = match &settings.surfaces.folder {
            Some(folder) => vec![self.resolve(folder)],
            None => vec![self.resolve(&beside), self.resolve(&Path::new("..").join(&beside))],
        };
        let pair = |folder: PathBuf| ["inspiration.ply", "expiration.ply"].map(|name| folder.join(name));
        folders.into_iter().map(pair).find(|pair| pair.iter().all(|file| files::is_file(file)))
    }

    /// Rejects values that no film can have; the error names the key.
    pub fn validate(&self) -> Result<()> {
        case_id::check(&self.id).map_err(|e| e.element("id"))?;
        let needs_field = !matches!(self.anatomy, AnatomySource::MeshPair { .. });
        if self.breathing.is_some() != needs_field {
            let sentence =
                if needs_field { "is missing" } else { "does not belong to a mesh pair, which has its motion" };
            return Err(Error::input(sentence).element("breathing"));
        }
        SEED.check(self.seed as f64).map_err(|e| e.element("seed"))?;
        REGISTRATION_ERROR_MM.check(self.registration_error_mm).map_err(|e| e.element("registration_error_mm"))?;
        for (channel, &power) in self.light_intensity.iter().enumerate() {
            LIGHT_INTENSITY.check(power).map_err(|e| e.element(format!("light_intensity[{channel}]")))?;
        }
        CAMERA_RANGES.check("camera", &self.camera)?;
        TRAJECTORY_RANGES.check("trajectory", &self.trajectory)?;
        self.anatomy.validate()?;
        self.camera.check_fisheye()?;
        self.camera.camera(64, 64).validate().map_err(|e| e.element("camera.fisheye"))?;
        case_scope::validate(&self.exposure, &self.scope)?;
        self.waveform.validate()?;
        if let Some(key) = self.material.iter().find(|(_, value)| !is_finite(value)).map(|(key, _)| key) {
            return Err(Error::input("must be finite").element(format!("material.{key}")));
        }
        if let Some(breathing) = &self.breathing {
            breathing.calibre.validate()?;
            breathing.field.validate()?;
        }
        Ok(())
    }

    /// The case with `effects` switched off.
    pub fn without(mut self, effects: &[Effect]) -> Case {
        for effect in effects {
            match effect {
                Effect::Emission => self.scope.emission_half_angle_deg = 0.0,
                Effect::AutoExposure => self.exposure.control = ExposureControl::Fixed,
                Effect::Lag => self.exposure.lag_s = 0.0,
                Effect::Overshoot => self.exposure.overshoot = 0.0,
                Effect::GainDrift => self.exposure.drift = 0.0,
                Effect::WhiteBalance => self.exposure.white_balance_drift = 0.0,
                Effect::ShotNoise => self.scope.shot_noise = 0.0,
                Effect::ReadNoise => self.scope.read_noise = 0.0,
                Effect::Vignette => self.scope.vignette = 0.0,
                Effect::Distortion => self.camera.fisheye = None,
                Effect::MotionBlur => self.scope.shutter_s = 0.0,
                Effect::Mask => self.scope.mask_radius = 0.0,
                Effect::Steering => self.trajectory.steering = SteeringSettings::NONE,
            }
        }
        self
    }
}

/// Whether every number in `value` is finite.
fn is_finite(value: &toml::Value) -> bool {
    match value {
        toml::Value::Float(number) => number.is_finite(),
        toml::Value::Array(items) => items.iter().all(is_finite),
        toml::Value::Table(table) => table.values().all(is_finite),
        _ => true,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TREE: &str = r#"
id = "test"
title = "a test"
seed = 3
[camera]
fov_x_deg = 100.0
[anatomy]
kind = "tree"
path = "case.toml"
[breathing.field]
source = "made up"
scale = 1.0
softening_mm = 10.0
origin_mm = [0.0, 0.0, 0.0]
affine = [[0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0], [10.0, 0.0, 0.0, -5.0]]
centers = []
"#;

    fn load(text: &str) -> Result<Case> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("case.toml");
        std::fs::write(&path, text).unwrap();
        Case::load(&path)
    }

    #[test]
    fn defaults_fill_in_and_the_text_form_is_stable() {
        let case = load(TREE).unwrap();
        assert_eq!(case.waveform.period_s(), 4.0);
        let again: Case = toml::from_str(&toml::to_string(&case).unwrap()).unwrap();
        assert_eq!(Case { file: case.file.clone(), ..again }, case);
    }

    #[test]
    fn a_material_with_a_number_that_is_none_is_refused() {
        let refused = load(&format!("{TREE}\n[material]\nkind = \"mucosa\"\nalbedo = [0.5, nan, 0.5]\n"));
        let sentence = refused.unwrap_err().to_string();
        assert!(sentence.contains("material.albedo") && sentence.contains("finite"), "{sentence}");
    }

    #[test]
    fn every_change_changes_the_hash_files_included() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("case.toml");
        std::fs::write(&path, TREE.replace("\"case.toml\"", "\"a.toml\"")).unwrap();
        assert!(Case::load(&path).unwrap_err().to_string().contains("a.toml, which is not there"));
        std::fs::write(folder.path().join("a.toml"), "one").unwrap();
        let load = || Case::load(&path).unwrap();
        let one = load().hash().unwrap();
        assert_eq!(one, load().hash().unwrap());
        assert_ne!(one, Case { seed: 4, ..load() }.hash().unwrap());
        let exposure = ExposureSettings { lag_s: 0.3, ..load().exposure };
        assert_ne!(one, Case { exposure, ..load() }.hash().unwrap());
        std::fs::write(folder.path().join("a.toml"), "two").unwrap();
        assert_ne!(one, load().hash().unwrap());
    }

    #[test]
    fn what_is_wrong_is_named_with_the_file() {
        for (from, to, said) in [
            ("fov_x_deg = 100.0", "fov_x_deg = 10.0", "camera.fov_x_deg"),
            (
                "fov_x_deg = 100.0",
                "fov_x_deg = 100.0\nfisheye = [-0.9, 0.0, 0.0, 0.0]",
                "camera.fisheye: stops rising before half of fov_x_deg, 50 degrees",
            ),
            ("fov_x_deg", "fov", "unknown field `fov`"),
            ("id = \"test\"", "id = \"a/b\"", "id: must be letters"),
            ("centers = []", "centers = [[1.0, 2.0, 3.0, nan, 0.0, 0.0]]", "centers[0]"),
            ("seed = 3", "seed = -3", "seed"),
            ("[anatomy]", "[waveform]\ninhale_s = 0.0\n[anatomy]", "waveform.inhale_s: 0 must lie in 0.1 to 60"),
            ("path = \"case.toml\"", "path = \"case.toml\"\nsurface = { rounds = -1 }", "in `surface.rounds`"),
            (
                "path = \"case.toml\"",
                "path = \"case.toml\"\nsurface = { spacing_mm = nan }",
                "anatomy.surface.spacing_mm",
            ),
            (
                "path = \"case.toml\"",
                "path = \"case.toml\"\nsurface = { longest_edge_mm = 0.1 }",
                "longest_edge_mm: 0.1 is",
            ),
            ("path = \"case.toml\"", "path = \"case.toml\"\ndepest = 3", "depest"),
            ("kind = \"tree\"", "kind = \"bush\"", "bush"),
        ] {
            let error = load(&TREE.replace(from, to)).unwrap_err();
            assert!(error.to_string().contains(said), "{to}: {error}");
            assert!(error.path().is_some_and(|p| p.ends_with("case.toml")), "{error}");
            assert_eq!(error.kind().exit_code(), 4);
        }
    }

    #[test]
    fn a_fisheye_sees_the_stated_angle_at_the_edge() {
        let settings = CameraSettings { fov_x_deg: 120.0, fisheye: Some([-0.03, 0.002, 0.0, 0.0]) };
        let edge = settings.camera(200, 200).direction(glam::DVec2::new(200.0, 100.0));
        assert!((edge.x.atan2(edge.z).to_degrees() - 60.0).abs() < 1e-9);
    }
}
