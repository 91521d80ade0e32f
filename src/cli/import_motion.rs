//! The measured motion of an imported case: its arguments, and the fit to the airway.

use std::path::PathBuf;

use clap::Args;

use super::Terminal;
use crate::airway::case::{Breathing, Case};
use crate::airway::field::BreathingField;
use crate::airway::field_calibre::Calibre;
use crate::airway::field_fit::check_pairs;
use crate::airway::import_breathing::{LungBox, MeasuredBreathing, measured_breathing};
use crate::airway::{self, case_build};
use crate::base::Result;
use crate::base::range::NumberRange;
use crate::formats::landmarks;
use crate::simulate::trajectory::Route;

/// Motion in mm of the end of a route; lungs are no longer than 300 mm.
const END_MOTION_MM: NumberRange = NumberRange::new(0.01, 200.0);

/// Where the motion comes from and how large it is.
#[derive(Args)]
pub(super) struct MotionArguments {
    /// Landmark pairs: insp_x,insp_y,insp_z,exp_x,exp_y,exp_z in mm (LPS)
    #[arg(long, value_name = "CSV")]
    pub(super) landmarks: PathBuf,
    /// Table of lung boxes: case,phase,min_x,..,max_z; without it the box around the landmarks is used
    #[arg(long, value_name = "CSV")]
    lung_boxes: Option<PathBuf>,
    /// Motion in mm of the end of the scope's way; without it the measured motion is kept
    #[arg(long, value_name = "MM", value_parser = END_MOTION_MM.parser::<f64>())]
    end_motion_mm: Option<f64>,
    /// Where the landmarks come from, for the case file
    #[arg(
        long,
        default_value = "DIR-Lab COPDgene (Castillo et al., Phys Med Biol 58:2861, 2013) by way of Lung250M-4B"
    )]
    source: String,
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

/// Fits, scales to the wanted motion of the route's end, and says how well it went.
pub(super) fn fit_motion(
    rest: &airway::Anatomy,
    case: &Case,
    motion: &MotionArguments,
    terminal: &Terminal,
) -> Result<MeasuredBreathing> {
    let pairs = landmarks::read(&motion.landmarks)?;
    check_pairs(&pairs).map_err(|e| e.at(&motion.landmarks))?;
    let patient = motion.landmarks.file_stem().map(|s| s.to_string_lossy().to_string()).unwrap_or_default();
    let lungs = match &motion.lung_boxes {
        Some(path) => LungBox::read(path, &patient)?,
        None => LungBox::around(&pairs),
    };
    let mut source = format!(
        "{patient} of {}: real motion, but not of this airway's patient; carina and extent fitted to the lungs' box",
        motion.source
    );
    let (mesh, line) = (&rest.inspiration, &rest.centerline);
    let mut scale = 1.0;
    let mut found = measured_breathing(mesh, line, &pairs, &lungs, &source, scale)?;
    for _ in 0..4 {
        let Some(wanted) = motion.end_motion_mm else { break };
        found.breathing.field.scale = scale;
        let moved = case_build::from_field(mesh.clone(), line.clone(), Some(vec![]), &found.breathing)?;
        scale *= wanted / Route::plan(&moved, &case.trajectory)?.end_motion_mm();
        scale = (scale * 1e4).round() / 1e4;
        found = measured_breathing(mesh, line, &pairs, &lungs, &source, scale)?;
    }
    found.breathing.field.scale = scale;
    let q = found.quality;
    source = format!(
        "{source}; landmarks move {:.1} mm, held-out error {:.2} mm (affine alone {:.2} mm)",
        q.motion_mm, q.held_out_mm, q.affine_held_out_mm
    );
    found.breathing.field.source = source;
    let moved = case_build::from_field(mesh.clone(), line.clone(), Some(vec![]), &found.breathing)?;
    let route = Route::plan(&moved, &case.trajectory)?;
    let s = found.placement.stretch;
    terminal.line(format!(
        "{}: way {:.0} mm, its end moves {:.1} mm, scale {scale:.3}, held-out {:.2} mm of {:.1} mm (affine {:.2}), \
         lambda {}, {} steps of extra smoothing, stretch {:.2} {:.2} {:.2}",
        case.id,
        route.length_mm(),
        route.end_motion_mm(),
        q.held_out_mm,
        q.motion_mm,
        q.affine_held_out_mm,
        q.lambda,
        found.extra_smoothing,
        s.x,
        s.y,
        s.z
    ));
    Ok(found)
}
