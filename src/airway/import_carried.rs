//! Carries the motion that one airway's case was given to another airway: a measured motion without its landmarks.
//!
//! The two airways are laid over each other by their carinas, scaled by their height and width below it. A field scales
//! exactly: with y = c + s (x - c'), the field u'(x) = u(y) / s has the same affine part A, the constant a / s, the same
//! weights, and centres, origin and softening length over s.

use glam::DVec3;

use super::Anatomy;
use super::case::Breathing;
use super::case_build::AirwayAtRest;
use super::centerline::Centerline;
use super::field::BreathingField;
use super::import_breathing::{moving, scaled_to};
use crate::base::{Error, Result};

/// Largest factor between two airways: a child's and a large man's.
const MOST_SCALE: f64 = 1.6;
/// Where the field would fold, the motion is made smaller by this factor, at most so often.
const SMALLER: f64 = 0.9;
const MOST_STEPS: usize = 12;

/// Extent in mm below the carina, sideways and down, as one length.
fn reach_mm(line: &Centerline, carina_mm: DVec3) -> f64 {
    let below = line.points.iter().filter(|p| p.generation > 0).map(|p| p.position_mm);
    let (low, high) = below.fold((carina_mm, carina_mm), |(low, high), p| (low.min(p), high.max(p)));
    ((high.x - low.x).max(1.0) * (carina_mm.z - low.z).max(1.0)).sqrt()
}

/// The field of `from`, whose airway has the centreline `line`, for the airway of `to`; with the whole measured motion.
///
/// Errors: an airway without a trachea; airways of too different sizes.
pub fn carried_field(from: &BreathingField, line: &Centerline, to: &Centerline) -> Result<BreathingField> {
    let without = || Error::input("the centreline has no trachea");
    let (there, here) = (line.carina_mm().ok_or_else(without)?, to.carina_mm().ok_or_else(without)?);
    let s = reach_mm(line, there) / reach_mm(to, here);
    if !(1.0 / MOST_SCALE..=MOST_SCALE).contains(&s) {
        return Err(Error::input(format!(
            "below the carina the airway is {:.2} times as large as the one whose motion is wanted: it is a child's, or its \
             tree ends early or has one lung; --landmarks FILE --other-patient takes any",
            1.0 / s
        )));
    }
    let origin = here + (DVec3::from_array(from.origin_mm) - there) / s;
    let center = |&[x, y, z, wx, wy, wz]: &[f64; 6]| [x / s, y / s, z / s, wx, wy, wz];
    Ok(BreathingField {
        source: from.source.clone(),
        scale: 1.0,
        softening_mm: from.softening_mm / s,
        origin_mm: origin.to_array(),
        affine: from.affine.map(|[a, x, y, z]| [a / s, x, y, z]),
        centers: from.centers.iter().map(center).collect(),
    })
}

/// The motion of another airway's case for the airway `rest`, as large as was measured, or as it may be without folds.
///
/// Errors: those of [`carried_field`]; a field that folds however small.
fn carried_breathing(from: &Breathing, line: &Centerline, rest: &AirwayAtRest<'_>) -> Result<Breathing> {
    let field = carried_field(&from.field, line, rest.centerline)?;
    let mut breathing = Breathing { calibre: from.calibre.clone(), field };
    let mut last = None;
    for _ in 0..MOST_STEPS {
        match moving(rest, &breathing) {
            Ok(_) => return Ok(breathing),
            Err(error) => last = Some(error),
        }
        breathing.field.scale *= SMALLER;
    }
    Err(last.unwrap_or_else(|| Error::input("no motion was tried")))
}

/// The motion of another airway's case, whose centreline is `line`, for the airway `rest`: so large that the end of the
/// scope's way moves by `wanted_mm`, or, where nothing is wanted, as it was measured, or as it may be without folds.
/// `end_motion_mm` measures that on a breathing airway.
///
/// Errors: those of [`carried_field`]; a field that folds however small; an end that does not move, which nothing can
/// scale.
pub fn scaled_carried_breathing(
    from: &Breathing,
    line: &Centerline,
    rest: &AirwayAtRest<'_>,
    wanted_mm: Option<f64>,
    end_motion_mm: impl Fn(&Anatomy) -> Result<f64>,
) -> Result<Breathing> {
    let carried = carried_breathing(from, line, rest)?;
    let Some(wanted_mm) = wanted_mm else { return Ok(carried) };
    let scaled = |scale| Breathing { field: BreathingField { scale, ..carried.field.clone() }, ..carried.clone() };
    let at_scale = |scale| end_motion_mm(&moving(rest, &scaled(scale))?);
    Ok(scaled(scaled_to(wanted_mm, carried.field.scale, |scale| scale, at_scale)?))
}

#[cfg(test)]
mod tests {
    use super::super::centerline::CenterlinePoint;
    use super::*;

    fn line(origin: DVec3, size: f64) -> Centerline {
        let at = |x: f64, z: f64, generation, parent| CenterlinePoint {
            position_mm: origin + DVec3::new(x, 0.0, z) * size,
            radius_mm: 5.0,
            branch: generation,
            generation,
            parent,
        };
        Centerline {
            points: vec![
                at(0.0, 80.0, 0, None),
                at(0.0, 0.0, 0, Some(0)),
                at(60.0, -90.0, 1, Some(1)),
                at(-50.0, -70.0, 1, Some(1)),
            ],
        }
    }

    #[test]
    fn a_field_is_carried_with_carina_and_size() {
        let from = BreathingField {
            source: "s".into(),
            scale: 0.5,
            softening_mm: 12.0,
            origin_mm: [3.0, 4.0, -5.0],
            affine: [[1.0, 2.0, 0.5, 0.1], [0.3, -2.0, 1.0, 4.0], [9.0, 0.0, 1.0, -8.0]],
            centers: vec![[10.0, 20.0, -30.0, 1.0, -2.0, 3.0], [-10.0, 5.0, 30.0, -1.0, 2.0, -3.0]],
        };
        let whole = BreathingField { scale: 1.0, ..from.clone() };
        let (there, here) = (DVec3::new(5.0, -30.0, -700.0), DVec3::new(100.0, 20.0, 40.0));
        let (old, new) = (line(there, 1.0), line(here, 0.8));
        let carried = carried_field(&from, &old, &new).unwrap();
        for x in [DVec3::ZERO, DVec3::new(30.0, 10.0, -60.0), DVec3::new(-40.0, -3.0, 20.0)] {
            let expected = whole.displacement(there + x) * 0.8;
            assert!((carried.displacement(here + x * 0.8) - expected).length() < 1e-9);
        }
        assert!(carried_field(&from, &old, &line(here, 0.3)).unwrap_err().to_string().contains("times as large"));
    }
}
