//! The measured motion of an imported case: its arguments, and how well the airway was given it.

use std::path::PathBuf;

use clap::Args;

use super::Terminal;
use crate::airway::Anatomy;
use crate::airway::case::{Breathing, Case};
use crate::airway::field::BreathingField;
use crate::airway::field_calibre::Calibre;
use crate::airway::field_fit::check_pairs;
use crate::airway::import_breathing::{LungBox, MeasuredBreathing, WantedMotion, fitted_breathing, moving};
use crate::airway::import_check::check_landmarks;
use crate::base::Result;
use crate::base::range::NumberRange;
use crate::formats::landmarks::{self, LandmarkPair};
use crate::simulate::trajectory::Route;

/// Motion in mm of the end of a route; lungs are no longer than 300 mm.
const END_MOTION_MM: NumberRange = NumberRange::new(0.01, 100.0);

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

impl MotionArguments {
    /// Reads the landmarks; whatever is wrong with them is said before any work.
    pub(super) fn read(&self) -> Result<Vec<LandmarkPair>> {
        let pairs = landmarks::read(&self.landmarks)?;
        check_pairs(&pairs).and_then(|()| check_landmarks(&pairs)).map_err(|e| e.at(&self.landmarks))?;
        Ok(pairs)
    }

    /// Gives `rest` the motion of `pairs`, and says how well it went.
    pub(super) fn fit(
        &self,
        rest: &Anatomy,
        case: &Case,
        pairs: &[LandmarkPair],
        terminal: &Terminal,
    ) -> Result<MeasuredBreathing> {
        let patient = self.landmarks.file_stem().map(|s| s.to_string_lossy().to_string()).unwrap_or_default();
        let lungs = match &self.lung_boxes {
            Some(path) => LungBox::read(path, &patient)?,
            None => LungBox::around(pairs),
        };
        let source = format!(
            "{patient} of {}: real motion, but not of this airway's patient; carina and extent fitted to the lungs' box",
            self.source
        );
        let wanted = WantedMotion { pairs, lungs, source, end_motion_mm: self.end_motion_mm };
        let (mesh, line) = (&rest.inspiration, &rest.centerline);
        let plan = |anatomy: &Anatomy| Route::plan(anatomy, &case.trajectory);
        let found = fitted_breathing(mesh, line, &wanted, |anatomy| Ok(plan(anatomy)?.end_motion_mm()))?;
        let route = plan(&moving(mesh, line, &found.breathing)?)?;
        terminal.line(words(&case.id, &route, &found));
        Ok(found)
    }
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
    let (q, s) = (found.quality, found.placement.stretch);
    format!(
        "{case_id}: way {:.0} mm, its end moves {:.1} mm, scale {:.3}, held-out {:.2} mm of {:.1} mm (affine {:.2}), \
         lambda {}, {} steps of extra smoothing, stretch {:.2} {:.2} {:.2}",
        route.length_mm(),
        route.end_motion_mm(),
        found.breathing.field.scale,
        q.held_out_mm,
        q.motion_mm,
        q.affine_held_out_mm,
        q.lambda,
        found.extra_smoothing,
        s.x,
        s.y,
        s.z
    )
}
