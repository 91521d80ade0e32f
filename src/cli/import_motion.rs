//! The measured motion of an imported case: its arguments, and how well the airway was given it.

use std::path::{Path, PathBuf};

use clap::Args;

use super::Terminal;
use super::import_case::name_of;
use crate::airway::case::{Breathing, Case};
use crate::airway::case_build::AirwayAtRest;
use crate::airway::centerline::Centerline;
use crate::airway::field::BreathingField;
use crate::airway::field_calibre::Calibre;
use crate::airway::field_fit::check_pairs;
use crate::airway::fold_mending::Mending;
use crate::airway::import_breathing::{Beyond, LungBox, MeasuredBreathing, WantedMotion, fitted_breathing, moving};
use crate::airway::import_carried::scaled_carried_breathing;
use crate::airway::import_check::{ExpectedAnatomy, check_landmarks, check_lungs};
use crate::airway::{Anatomy, case_build};
use crate::base::range::NumberRange;
use crate::base::{Error, Progress, Result};
use crate::bench::Catalogue;
use crate::formats::landmarks::{self, LandmarkPair};
use crate::simulate::trajectory::Route;

/// Motion in mm of the end of a route; lungs are no longer than 300 mm.
const END_MOTION_MM: NumberRange = NumberRange::new(0.01, 100.0);

/// Where the motion comes from and how large it is.
#[derive(Args)]
pub(super) struct MotionArguments {
    /// Landmark pairs: insp_x,insp_y,insp_z,exp_x,exp_y,exp_z in mm (LPS), in the frame of the airway
    #[arg(long, value_name = "CSV", conflicts_with = "motion")]
    landmarks: Option<PathBuf>,
    /// Measured motion of a carried case, by its patient: copd01 to copd09
    #[arg(long, value_name = "PATIENT")]
    motion: Option<String>,
    /// The landmarks are another patient's: carina and extent of the airway are fitted to the box of the lungs
    #[arg(long, requires = "landmarks")]
    other_patient: bool,
    /// Table of lung boxes for another patient's landmarks: case,phase,min_x,..,max_z; the box around them without
    #[arg(long, value_name = "CSV", requires = "landmarks")]
    lung_boxes: Option<PathBuf>,
    /// Motion in mm of the end of the scope's way; without it the measured motion is kept
    #[arg(long, value_name = "MM", value_parser = END_MOTION_MM.parser::<f64>())]
    end_motion_mm: Option<f64>,
    /// Where the landmarks come from, for the case file; the name of their file without
    #[arg(long)]
    source: Option<String>,
}

/// A motion that has been read.
pub(super) enum ReadMotion {
    /// Landmark pairs of the airway's own patient, or of another one with these lungs.
    Landmarks { pairs: Vec<LandmarkPair>, lungs: Option<LungBox>, path: PathBuf },
    /// The motion of a carried case, and the centreline of its airway.
    Carried { breathing: Breathing, line: Centerline, patient: String },
}

impl MotionArguments {
    /// Whether a motion is wanted at all.
    pub(super) fn is_given(&self) -> bool {
        self.landmarks.is_some() || self.motion.is_some()
    }

    /// What it is called. Errors: no motion is named.
    pub(super) fn name(&self) -> Result<String> {
        match (&self.landmarks, &self.motion) {
            (Some(path), _) => Ok(name_of(path)),
            (None, Some(patient)) => Ok(patient.clone()),
            (None, None) => Err(Error::usage(
                "no motion is named: --landmarks CSV gives a measured one, --motion copd05 one of those of the carried cases",
            )),
        }
    }

    /// Refuses options that would change nothing.
    pub(super) fn check_options(&self) -> Result<()> {
        let unused = match (self.end_motion_mm, &self.source) {
            (Some(_), _) if !self.is_given() => "--end-motion-mm is for --landmarks and --motion: other motion is kept",
            (_, Some(_)) if self.landmarks.is_none() => "--source says where --landmarks come from",
            _ => return Ok(()),
        };
        Err(Error::usage(unused))
    }

    /// Reads the motion; whatever is wrong with it is said before any work.
    pub(super) fn read(&self, anatomy: ExpectedAnatomy) -> Result<ReadMotion> {
        self.check_options()?;
        let Some(path) = &self.landmarks else {
            return carried_motion(&self.name()?);
        };
        let pairs = landmarks::read(path)?;
        check_pairs(&pairs).and_then(|()| check_landmarks(&pairs, anatomy)).map_err(|e| e.at(path))?;
        let patient = path.file_stem().map(|s| s.to_string_lossy().to_string()).unwrap_or_default();
        let lungs = match &self.lung_boxes {
            Some(path) => {
                let lungs = LungBox::read(path, &patient)?;
                check_lungs("boxes", [lungs.low_mm, lungs.high_mm], anatomy).map_err(|e| e.at(path))?;
                Some(lungs)
            }
            None => self.other_patient.then(|| LungBox::around(&pairs)),
        };
        Ok(ReadMotion::Landmarks { pairs, lungs, path: path.clone() })
    }

    /// Where landmarks come from, for the case file.
    fn source_of(&self, path: &Path, is_other_patient: bool) -> String {
        let patient = path.file_stem().unwrap_or_default().to_string_lossy();
        let from = match &self.source {
            Some(source) => format!("{patient} of {source}"),
            None => name_of(path),
        };
        match is_other_patient {
            true => format!(
                "{from}: real motion, but not of this airway's patient; carina and extent fitted to the lungs' box"
            ),
            false => format!("{from}: landmarks in the airway's own frame"),
        }
    }

    /// Gives `rest` the motion, and says how well it went.
    pub(super) fn fit(
        &self,
        rest: &Anatomy,
        case: &Case,
        motion: &ReadMotion,
        terminal: &Terminal,
    ) -> Result<Breathing> {
        let rest = &AirwayAtRest::new(&rest.inspiration, &rest.centerline)?;
        let plan = |anatomy: &Anatomy| Route::plan(anatomy, &case.trajectory);
        let end_motion_mm = |anatomy: &Anatomy| {
            terminal.proceed()?;
            Ok(plan(anatomy)?.end_motion_mm())
        };
        let breathing = match motion {
            ReadMotion::Landmarks { pairs, lungs, path } => {
                if lungs.is_none() {
                    let beyond = Beyond::of(&rest.mesh.vertices, pairs).map_err(|e| e.at(path))?;
                    if beyond.share > 0.0 {
                        terminal.note(&beyond_words(&beyond));
                    }
                }
                let source = self.source_of(path, lungs.is_some());
                let wanted = WantedMotion { pairs, lungs: *lungs, source, end_motion_mm: self.end_motion_mm };
                let found = fitted_breathing(rest, &wanted, end_motion_mm)?;
                if let Some(placement) = found.placement.filter(|placement| !placement.fits()) {
                    let [x, y, z] = placement.stretch.to_array();
                    terminal.note(&format!(
                        "the airway does not fit into the lungs of the motion's patient (has it one lung, or few branches?): \
                         it was placed by factors of {x:.2}, {y:.2} and {z:.2}, as far as is allowed"
                    ));
                }
                let route = plan(&moving(rest, &found.breathing)?)?;
                terminal.line(words(&case.id, &route, &found));
                found.breathing
            }
            ReadMotion::Carried { breathing, line: from, patient } => {
                let found = scaled_carried_breathing(breathing, from, rest, self.end_motion_mm, end_motion_mm)?;
                let route = plan(&moving(rest, &found)?)?;
                terminal.line(format_args!(
                    "{}: way {:.0} mm, its end moves {:.1} mm, {:.0} % of the measured motion of {patient}",
                    case.id,
                    route.length_mm(),
                    route.end_motion_mm(),
                    100.0 * found.field.scale
                ));
                found
            }
        };
        terminal.proceed()?;
        let mending = rest.mending(&moving(rest, &breathing)?.expiration.vertices, &breathing);
        if mending.vertices > 0 {
            terminal.note(&mended_words(&mending, rest.mesh.vertices.len()));
        }
        Ok(breathing)
    }
}

/// How far an airway reaches beyond its landmarks, in a sentence.
fn beyond_words(beyond: &Beyond) -> String {
    format!(
        "{:.0} % of the airway lies outside of the landmarks' box, up to {:.0} mm: its motion there is not measured but \
         extrapolated, and the top of the trachea outside is taken to move 1 mm",
        100.0 * beyond.share,
        beyond.farthest_mm
    )
}

/// What mending did, in a sentence.
pub(super) fn mended_words(mending: &Mending, vertices: usize) -> String {
    format!(
        "{} faces would turn over between the breath holds: mended by moving {} of {vertices} vertices by {:.3} mm in the mean, \
         {:.2} mm at most",
        mending.faces, mending.vertices, mending.mean_mm, mending.most_mm
    )
}

/// The motion of the carried case whose patient is `patient`.
fn carried_motion(patient: &str) -> Result<ReadMotion> {
    let catalogue = Catalogue::open(None)?;
    let mut known = Vec::new();
    for id in catalogue.case_ids()? {
        let case = Case::load(&catalogue.case_file(&id)?)?;
        let Some(breathing) = &case.breathing else { continue };
        let name = breathing.field.source.split(' ').next().unwrap_or_default().to_owned();
        if name == patient {
            let line = case_build::rest_centerline(&case)?;
            return Ok(ReadMotion::Carried { breathing: breathing.clone(), line, patient: name });
        }
        known.push(name);
    }
    Err(Error::usage(format!("there is no motion `{patient}`; there are {}", known.join(", "))))
}

/// No motion at all: stands in while the route is planned.
pub(super) fn still_breathing() -> Breathing {
    let field = BreathingField {
        source: String::new(),
        scale: 1.0,
        softening_mm: 1.0,
        origin_mm: [0.0; 3],
        affine: [[0.0; 4]; 3],
        centers: vec![],
    };
    Breathing { calibre: Calibre::default(), field }
}

fn words(case_id: &str, route: &Route, found: &MeasuredBreathing) -> String {
    let q = found.quality;
    let stretch = found.placement.map(|placement| placement.stretch);
    let stretched = stretch.map_or_else(String::new, |s| format!(", stretch {:.2} {:.2} {:.2}", s.x, s.y, s.z));
    format!(
        "{case_id}: way {:.0} mm, its end moves {:.1} mm, scale {:.3}, held-out {:.2} mm of {:.1} mm (affine {:.2}), \
         lambda {}, {} steps of extra smoothing{stretched}",
        route.length_mm(),
        route.end_motion_mm(),
        found.breathing.field.scale,
        q.held_out_mm,
        q.motion_mm,
        q.affine_held_out_mm,
        q.lambda,
        found.extra_smoothing
    )
}
