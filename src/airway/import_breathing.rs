//! Brings measured lung motion to an airway: placement by the lungs' box where it is not the patient's, fit, fold check.
//!
//! Landmarks of the airway's own patient are taken as they are. The airway stays where it is; another patient's
//! landmarks are carried into its frame. Carina goes to carina, assumed at
//! fixed fractions of the lungs' inspiration box, and each axis is scaled so that the airway fills as much of that box
//! as airways visible in CT do. So tree and motion are both real, but not of one patient, and case files say so. The
//! top of the trachea is held by anchors of small motion, unless own landmarks surround it: landmarks lie in the
//! parenchyma, and the trachea moves least.
//! When the interpolated mesh would fold anywhere, smoothing is raised step by step until it does not.

use std::path::Path;

use glam::DVec3;

use super::Anatomy;
use super::case::Breathing;
use super::case_build::{AirwayAtRest, FoldPolicy};
use super::centerline::Centerline;
use super::field::BreathingField;
use super::field_calibre::Calibre;
use super::field_fit::{Anchor, FitQuality, FitSettings, LAMBDAS, choose_centers, fit};
use crate::base::range::COORDINATE_MM;
use crate::base::{Error, Result, files};
use crate::formats::landmarks::LandmarkPair;
use crate::formats::number_table;

/// Where the carina lies in the lungs' box at inspiration, as fractions from its low (right, front, bottom) corner.
const CARINA_FRACTION: DVec3 = DVec3::new(0.5, 0.57, 0.64);
/// Fraction of the box's width, depth, and height below the carina that an airway with lumens above 2 mm fills.
const FILLED: DVec3 = DVec3::new(0.60, 0.44, 0.66);
/// Largest factor by which an axis is stretched or shrunk.
const MOST_STRETCH: f64 = 1.3;
/// Motion in mm of the top of the trachea at full excursion: slightly upwards.
const TRACHEA_TOP_MOTION_MM: DVec3 = DVec3::new(0.0, 0.3, 1.0);
/// Part of the trachea, from the top, that the anchors hold; and what one anchor weighs in landmarks.
const HELD_PART: f64 = 0.35;
const ANCHOR_MASS: f64 = 20.0;
/// Number of the kernel's centres, and its softening length.
const CENTERS: usize = 56;
const SOFTENING_MM: f64 = 15.0;
/// Rounds in which a motion is scaled to the wanted one: folds, and with them the field, depend a little on the scale.
const SCALING_ROUNDS: usize = 4;
/// Scales are rounded to a part of this.
const SCALE_DIGITS: f64 = 1e4;
/// Share of an airway that its own landmarks leave out at most: beyond it they lie in another frame.
const MOST_BEYOND: f64 = 0.9;
/// An end of the way that moves less than this many mm is taken to stand still.
const LEAST_MOTION_MM: f64 = 0.01;

/// Columns of a table of the lungs' boxes, of words and of numbers.
const BOX_COLUMNS: [&str; 2] = ["case", "phase"];
const BOX_SIDES_MM: [number_table::Column<'static>; 6] = [
    ("min_x", COORDINATE_MM),
    ("min_y", COORDINATE_MM),
    ("min_z", COORDINATE_MM),
    ("max_x", COORDINATE_MM),
    ("max_y", COORDINATE_MM),
    ("max_z", COORDINATE_MM),
];

/// Axis-aligned box in mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LungBox {
    /// Low corner.
    pub low_mm: DVec3,
    /// High corner.
    pub high_mm: DVec3,
}

impl LungBox {
    /// The box of `patient` in the phase `insp` of a table with the columns `case,phase,min_x,..,max_z`, in any order, mm.
    /// Errors name file and line: no such box, or two; corners that are swapped.
    pub fn read(path: &Path, patient: &str) -> Result<LungBox> {
        LungBox::parse(&files::read_bytes(path)?, patient).map_err(|e| e.at(path))
    }

    fn parse(bytes: &[u8], patient: &str) -> Result<LungBox> {
        let names: Vec<&str> = BOX_COLUMNS.into_iter().chain(BOX_SIDES_MM.map(|(name, _)| name)).collect();
        let [cases, phases] = BOX_COLUMNS.map(|column| number_table::words(bytes, column, &names));
        let (cases, phases) = (cases?, phases?);
        let is_wanted = |row: usize| cases[row] == patient && phases[row].eq_ignore_ascii_case("insp");
        let rows = number_table::rows_where(bytes, BOX_SIDES_MM, is_wanted)?;
        let mut of_patient = rows.iter();
        let row = match (of_patient.next(), of_patient.next()) {
            (Some(row), None) => row,
            (None, _) => return Err(Error::input(format!("has no box of case `{patient}` in phase `insp`"))),
            (_, Some(second)) => return Err(second.refuse(Error::input(format!("`{patient}` is there twice")))),
        };
        let [low, high] = [0, 3].map(|k| DVec3::new(row.numbers[k], row.numbers[k + 1], row.numbers[k + 2]));
        match (0..3).find(|&axis| low[axis] >= high[axis]) {
            Some(axis) => {
                let [below, above] = [axis, axis + 3].map(|k| BOX_SIDES_MM[k].0);
                Err(row.refuse(Error::input(format!("{below} must be less than {above}"))))
            }
            None => Ok(LungBox { low_mm: low, high_mm: high }),
        }
    }

    /// The box around landmarks, a twentieth wider on each side: for patients without a measured box.
    pub fn around(pairs: &[LandmarkPair]) -> LungBox {
        let (low, high) = pairs.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), p| {
            (low.min(p.inspiration_mm), high.max(p.inspiration_mm))
        });
        let margin = (high - low) * 0.05;
        LungBox { low_mm: low - margin, high_mm: high + margin }
    }
}

/// Axis-aligned map between the airway's frame and the patient's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    carina_mm: DVec3,
    carina_in_lungs_mm: DVec3,
    /// Patient's mm per airway mm, along each axis.
    pub stretch: DVec3,
}

impl Placement {
    /// Puts the airway of `centerline` into the lungs of `lungs`. Both in LPS.
    ///
    /// Errors: a centreline without trachea, a box without volume.
    pub fn fit(centerline: &Centerline, lungs: &LungBox) -> Result<Placement> {
        let carina_mm = centerline.carina_mm().ok_or_else(|| Error::input("the centreline has no trachea"))?;
        let size = lungs.high_mm - lungs.low_mm;
        if size.min_element() <= 0.0 || !size.is_finite() {
            return Err(Error::input("the lungs' box has no volume"));
        }
        let below = centerline.points.iter().filter(|p| p.generation > 0).map(|p| p.position_mm);
        let (low, high) = below.fold((carina_mm, carina_mm), |(low, high), p| (low.min(p), high.max(p)));
        let carina_in_lungs_mm = lungs.low_mm + size * CARINA_FRACTION;
        let wanted = DVec3::new(size.x, size.y, carina_in_lungs_mm.z - lungs.low_mm.z) * FILLED;
        let extent = DVec3::new(high.x - low.x, high.y - low.y, carina_mm.z - low.z).max(DVec3::ONE);
        let stretch = (wanted / extent).clamp(DVec3::splat(1.0 / MOST_STRETCH), DVec3::splat(MOST_STRETCH));
        Ok(Placement { carina_mm, carina_in_lungs_mm, stretch })
    }

    /// Whether the airway fills the lungs as an airway does along each axis; else it was stretched as far as is allowed.
    pub fn fits(&self) -> bool {
        self.stretch
            .to_array()
            .iter()
            .all(|s| (1.0 / MOST_STRETCH..MOST_STRETCH).contains(s) && *s > 1.0 / MOST_STRETCH)
    }

    /// A landmark pair in the airway's frame.
    pub fn to_airway(&self, pair: &LandmarkPair) -> LandmarkPair {
        let point = |p: DVec3| (p - self.carina_in_lungs_mm) / self.stretch + self.carina_mm;
        LandmarkPair { inspiration_mm: point(pair.inspiration_mm), expiration_mm: point(pair.expiration_mm) }
    }
}

/// Result of [`measured_breathing`].
#[derive(Clone, Debug)]
pub struct MeasuredBreathing {
    /// For the case file; scale 1.
    pub breathing: Breathing,
    /// How good the fit is.
    pub quality: FitQuality,
    /// How the airway lies in another patient's lungs; `None` with landmarks of its own.
    pub placement: Option<Placement>,
    /// Smoothing steps that were needed beyond the best-predicting one to avoid folds.
    pub extra_smoothing: usize,
}

/// How far an airway reaches beyond the box of its own landmarks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Beyond {
    /// Share of its vertices that lie outside.
    pub share: f64,
    /// Distance in mm of the farthest.
    pub farthest_mm: f64,
}

impl Beyond {
    /// Measures it. Errors: landmarks so far away that they lie in another frame.
    pub fn of(vertices: &[DVec3], pairs: &[LandmarkPair]) -> Result<Beyond> {
        let outside = Outside::of(pairs);
        let off: Vec<f64> = vertices.iter().map(|v| outside.distance_mm(*v)).collect();
        let share = off.iter().filter(|d| **d > 0.0).count() as f64 / off.len().max(1) as f64;
        let beyond = Beyond { share, farthest_mm: off.iter().copied().fold(0.0, f64::max) };
        if share > MOST_BEYOND {
            return Err(Error::input(format!(
                "{:.0} % of the airway lies outside of the landmarks' box, up to {:.0} mm: both must have one frame (LPS), \
                 and landmarks of another patient need --other-patient",
                100.0 * share,
                beyond.farthest_mm
            )));
        }
        Ok(beyond)
    }
}

/// The box around landmarks at inspiration, and what lies outside of it.
struct Outside {
    low_mm: DVec3,
    high_mm: DVec3,
}

impl Outside {
    fn of(pairs: &[LandmarkPair]) -> Outside {
        let places = || pairs.iter().map(|p| p.inspiration_mm);
        Outside {
            low_mm: places().fold(DVec3::INFINITY, DVec3::min),
            high_mm: places().fold(DVec3::NEG_INFINITY, DVec3::max),
        }
    }

    fn distance_mm(&self, place: DVec3) -> f64 {
        (self.low_mm - place).max(place - self.high_mm).max(DVec3::ZERO).length()
    }
}

/// Fits the motion of `pairs` for the airway `rest`, checked free of folds at up to `largest_scale`
/// times the measured motion. With `lungs` the landmarks are another patient's, who has these.
///
/// Where faces turn over even at the strongest smoothing, the narrowing yields around them at the best-predicting one.
///
/// Errors: too few landmarks; a field that folds even at the strongest smoothing.
pub fn measured_breathing(
    rest: &AirwayAtRest<'_>,
    pairs: &[LandmarkPair],
    lungs: Option<&LungBox>,
    source: &str,
    largest_scale: f64,
) -> Result<MeasuredBreathing> {
    let centerline = rest.centerline;
    let placement = lungs.map(|lungs| Placement::fit(centerline, lungs)).transpose()?;
    let placed: Vec<LandmarkPair> =
        pairs.iter().map(|p| placement.map_or(*p, |placement| placement.to_airway(p))).collect();
    let mut anchors = trachea_anchors(centerline);
    if placement.is_none() {
        // What is measured there is not stated.
        let outside = Outside::of(&placed);
        anchors.retain(|anchor| outside.distance_mm(anchor.position_mm) > 0.0);
    }
    let near: Vec<DVec3> = placed
        .iter()
        .map(|p| p.inspiration_mm)
        .chain(centerline.points.iter().step_by(10).map(|p| p.position_mm))
        .collect();
    let settings = FitSettings {
        source: source.into(),
        centers_mm: choose_centers(&near, 14.0, 22.0, CENTERS),
        softening_mm: SOFTENING_MM,
        anchors,
    };
    let (first, quality) = fit(&placed, &settings, 0.0)?;
    let mut candidate = (first, quality);
    let stronger: Vec<f64> = LAMBDAS.iter().copied().filter(|l| *l > quality.lambda).collect();
    let mut folds = None;
    for extra in 0..=stronger.len() {
        if extra > 0 {
            candidate = fit(&placed, &settings, stronger[extra - 1])?;
        }
        let breathing = Breathing { calibre: Calibre::default(), field: candidate.0.clone() };
        let at_most =
            Breathing { field: BreathingField { scale: largest_scale, ..candidate.0.clone() }, ..breathing.clone() };
        match rest.moved(&at_most, Some(vec![]), FoldPolicy::Strict) {
            Ok(_) => {
                return Ok(MeasuredBreathing { breathing, quality: candidate.1, placement, extra_smoothing: extra });
            }
            Err(error) => folds = Some(error),
        }
    }
    // The narrowing does it, and not the field: it yields where faces would turn over.
    for extra in 0..=stronger.len() {
        let lambda = if extra > 0 { stronger[extra - 1] } else { 0.0 };
        let (field, quality) = fit(&placed, &settings, lambda)?;
        let at_most =
            Breathing { calibre: Calibre::default(), field: BreathingField { scale: largest_scale, ..field.clone() } };
        match moving(rest, &at_most) {
            Ok(_) => {
                let breathing = Breathing { calibre: Calibre::default(), field };
                return Ok(MeasuredBreathing { breathing, quality, placement, extra_smoothing: extra });
            }
            Err(error) => folds = Some(error),
        }
    }
    Err(folds.unwrap_or_else(|| Error::input("no smoothing strength was tried")))
}

/// Measured motion that an airway is to be given.
pub struct WantedMotion<'a> {
    /// Landmarks of the lungs' motion.
    pub pairs: &'a [LandmarkPair],
    /// Box around the lungs of another patient, whose landmarks these are; `None` where they are the airway's own.
    pub lungs: Option<LungBox>,
    /// Where the landmarks come from, for the case file.
    pub source: String,
    /// How far the end of the scope's way is to move, mm; the measured motion is kept without it.
    pub end_motion_mm: Option<f64>,
}

/// The scale, from `scale` on, at which the end of the scope's way moves by `wanted_mm`; `end_motion_mm` measures it at
/// a scale, and each scale found is rounded by `rounded`.
///
/// Errors: those of measuring, and an end that does not move, which nothing can scale.
pub(super) fn scaled_to(
    wanted_mm: f64,
    mut scale: f64,
    rounded: impl Fn(f64) -> f64,
    mut end_motion_mm: impl FnMut(f64) -> Result<f64>,
) -> Result<f64> {
    for _ in 0..SCALING_ROUNDS {
        let moves_mm = end_motion_mm(scale)?;
        if moves_mm < LEAST_MOTION_MM {
            let sentence = format!("the end of the scope's way moves by {moves_mm:.3} mm, which nothing can scale");
            return Err(Error::input(sentence));
        }
        scale = rounded(scale * (wanted_mm / moves_mm));
    }
    Ok(scale)
}

/// [`measured_breathing`], scaled so that the end of the scope's way moves as far as is wanted; `end_motion_mm`
/// measures that on a breathing airway. The field's source says how well the motion is met.
///
/// Errors: those of the fit, and an end that does not move, which nothing can scale.
pub fn fitted_breathing(
    rest: &AirwayAtRest<'_>,
    wanted: &WantedMotion<'_>,
    end_motion_mm: impl Fn(&Anatomy) -> Result<f64>,
) -> Result<MeasuredBreathing> {
    let fit = |scale: f64| {
        let mut found = measured_breathing(rest, wanted.pairs, wanted.lungs.as_ref(), &wanted.source, scale)?;
        found.breathing.field.scale = scale;
        Ok(found)
    };
    let rounded = |scale: f64| (scale * SCALE_DIGITS).round() / SCALE_DIGITS;
    let at_scale = |scale: f64| end_motion_mm(&moving(rest, &fit(scale)?.breathing)?);
    let scale = wanted.end_motion_mm.map_or(Ok(1.0), |wanted_mm| scaled_to(wanted_mm, 1.0, rounded, at_scale))?;
    let mut found = fit(scale)?;
    let q = found.quality;
    found.breathing.field.source = format!(
        "{}; landmarks move {:.1} mm, held-out error {:.2} mm (affine alone {:.2} mm)",
        wanted.source, q.motion_mm, q.held_out_mm, q.affine_held_out_mm
    );
    Ok(found)
}

/// The airway in both breath holds, for what does not ask for generations.
pub fn moving(rest: &AirwayAtRest<'_>, breathing: &Breathing) -> Result<Anatomy> {
    rest.moved(breathing, Some(vec![]), FoldPolicy::Yield)
}

/// Anchors every few millimetres along the upper part of the trachea.
fn trachea_anchors(centerline: &Centerline) -> Vec<Anchor> {
    let trachea: Vec<DVec3> = centerline.trachea_mm().collect();
    let held = ((trachea.len() as f64 * HELD_PART).ceil() as usize).max(1);
    let step = (held / 6).max(1);
    trachea[..held.min(trachea.len())]
        .iter()
        .step_by(step)
        .map(|&position_mm| Anchor { position_mm, motion_mm: TRACHEA_TOP_MOTION_MM, mass: ANCHOR_MASS })
        .collect()
}

/// The `[breathing]` part of a case file, one centre per line.
pub fn breathing_toml(breathing: &Breathing) -> String {
    let f = &breathing.field;
    let row = |values: &[f64]| {
        let cells: Vec<String> = values.iter().map(|v| format!("{v:?}")).collect();
        format!("[{}]", cells.join(", "))
    };
    let rows = |list: Vec<String>| list.iter().map(|r| format!("    {r},\n")).collect::<String>();
    format!(
        "[breathing.calibre]\ndiameter_ratio = {}\ntracheal_invagination = {:?}\n\n[breathing.field]\nsource = {}\n\
         scale = {:?}\nsoftening_mm = {:?}\norigin_mm = {}\naffine = [\n{}]\ncenters = [\n{}]\n",
        row(&breathing.calibre.diameter_ratio),
        breathing.calibre.tracheal_invagination,
        toml::Value::String(f.source.clone()),
        f.scale,
        f.softening_mm,
        row(&f.origin_mm),
        rows(f.affine.iter().map(|r| row(r)).collect()),
        rows(f.centers.iter().map(|r| row(r)).collect()),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_motion_is_scaled_to_the_wanted_one_and_one_that_stands_still_is_refused() {
        // Folds take more of a larger motion.
        let moves_mm = |scale: f64| Ok(20.0 * scale - scale * scale);
        let scale = scaled_to(8.0, 1.0, |scale| scale, moves_mm).unwrap();
        assert!((moves_mm(scale).unwrap() - 8.0).abs() < 1e-4, "{scale}");
        let error = scaled_to(8.0, 1.0, |scale| scale, |scale| Ok(0.005 * scale)).unwrap_err();
        assert!(error.to_string().contains("0.005 mm, which nothing can scale"), "{error}");
    }

    #[test]
    fn a_lungs_box_is_found_by_the_names_of_the_columns() {
        let head = "case,phase,min_x,min_y,min_z,max_x,max_y,max_z";
        let read = |text: &str| LungBox::parse(text.as_bytes(), "a");
        let of = |text: &str| read(text).unwrap();
        let wanted = LungBox { low_mm: DVec3::new(1.0, 2.0, 3.0), high_mm: DVec3::new(4.0, 5.0, 6.0) };
        assert_eq!(of(&format!("{head}\na,exp,0,0,0,1,1,1\nb,insp,0,0,0,1,1,1\na,insp,1,2,3,4,5,6\n")), wanted);
        // Another patient's row is nobody's business.
        assert_eq!(of(&format!("{head}\na,exp,,,,,,\na,insp,1,2,3,4,5,6\n")), wanted);
        assert_eq!(of("max_z,note,max_y,max_x,Phase,min_z,min_y,min_x,case\n6,x,5,4,Insp,3,2,1,\"a\"\n"), wanted);
        for (text, says) in [
            (format!("{head}\na,insp,4,2,3,1,5,6\n"), "line 2: min_x must be less than max_x"),
            (format!("{head}\na,insp,1,2,3,4,5,6\n\na,insp,1,2,3,4,5,6\n"), "line 4: `a` is there twice"),
            (format!("{head}\nb,insp,1,2,3,4,5,6\n"), "has no box of case `a` in phase `insp`"),
            (format!("{head}\na,insp,1,2,3,4,5\n"), "line 2"),
            ("a,insp,1,2,3,4,5,6\n".to_owned(), "column case: is missing; the columns are case,phase,min_x"),
        ] {
            let said = read(&text).unwrap_err().to_string();
            assert!(said.contains(says), "{said}");
        }
    }

    #[test]
    fn what_landmarks_do_not_surround_is_measured() {
        let pair = |x: f64| LandmarkPair { inspiration_mm: DVec3::splat(x), expiration_mm: DVec3::splat(x) };
        let pairs = [pair(0.0), pair(100.0)];
        let airway = [10.0, 50.0, 90.0].map(DVec3::splat).to_vec();
        assert_eq!(Beyond::of(&airway, &pairs).unwrap(), Beyond { share: 0.0, farthest_mm: 0.0 });
        let higher = [airway, vec![DVec3::new(50.0, 50.0, 140.0)]].concat();
        assert_eq!(Beyond::of(&higher, &pairs).unwrap(), Beyond { share: 0.25, farthest_mm: 40.0 });
        let elsewhere: Vec<DVec3> = higher.iter().map(|v| v + 500.0).collect();
        assert!(Beyond::of(&elsewhere, &pairs).unwrap_err().to_string().contains("--other-patient"));
    }
}
