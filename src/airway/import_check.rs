//! Whether an imported airway can be one: its size, its trachea, which way up and which way round it lies.
//!
//! A file in centimetres, or with other axes than assumed, makes a case that can be filmed and means nothing. What is
//! held against it is the shape of human airways: the trachea is the widest branch that ends; it lies above its tree;
//! the tree is wider from side to side than from front to back; the left main bronchus is longer, narrower and flatter
//! than the right one; the trachea runs backwards on its way down. In the five airways of four patients at hand:
//! trachea 13 to 15 mm across, 16 to 34 mm backwards over 57 to 89 mm; sides 2.5 to 3.2 times the depth; left main
//! bronchus 1.8 to 2.9 times as long, .73 to .85 times as wide, its part downwards .10 to .17 less.

use glam::DVec3;
use nalgebra::{Matrix3, Vector3};

use super::centerline::Centerline;
use super::import_axes::PatientAxes;
use crate::base::statistics::upper_median;
use crate::base::{Error, Result};
use crate::formats::landmarks::LandmarkPair;

/// Longest side of the box around an airway in mm: a child's to the largest adult's.
const EXTENT_MM: [f64; 2] = [50.0, 400.0];
/// Diameter of a trachea in mm.
const TRACHEA_MM: [f64; 2] = [8.0, 30.0];
/// Least length in mm of an end branch that may be the trachea.
const LEAST_TRACHEA_MM: f64 = 15.0;
/// By how much more than its division the upper end of a trachea may move in mm.
const TRACHEA_BEYOND_MM: f64 = 3.0;
/// Longest side of the box around lung landmarks in mm.
const LUNGS_MM: [f64; 2] = [80.0, 500.0];
/// Furthest in mm that tissue moves between two breath holds: the lung's base, deeply breathed, moves 60 mm.
pub const FURTHEST_MM: f64 = 80.0;
/// What moves less than this many mm everywhere does not breathe, or is in metres.
pub const STILL_MM: f64 = 0.1;
/// Largest factor between the lungs' volumes at expiration and at inspiration: 1, and the error of landmarks.
const MOST_GROWTH: f64 = 1.02;
/// Variance of landmarks along an axis, as a part of the largest, below which they tell nothing about that axis.
const LEAST_VARIANCE: f64 = 1e-3;
/// Units that files come in, with their size in mm.
const UNITS: [(&str, f64); 4] = [("centimetres", 10.0), ("metres", 1000.0), ("inches", 25.4), ("micrometres", 1e-3)];
/// Part of the trachea's width that it still has at least below a side branch, and that such a branch has at most: the
/// narrower main bronchus has more than half of it.
const TRACHEA_GOES_ON: f64 = 0.8;
const SIDE_BRANCH: f64 = 0.5;
/// Part of the way from the tree to the trachea's top that lies along the axis to the head.
const UPRIGHT: f64 = 0.7;
/// How many times as wide from side to side as from front to back a tree is, at least.
const SIDEWAYS: f64 = 1.4;
/// How many times as long as the other, as wide, and how much steeper a main bronchus is, at least, to count.
const LONGER: f64 = 1.25;
const WIDER: f64 = 1.05;
const STEEPER: f64 = 0.05;
/// What part of its way down the trachea goes backwards, at least.
const BACKWARDS: f64 = 0.1;

/// The trachea and its two main bronchi, found without knowing which way is up.
#[derive(Clone, Debug)]
struct Stem {
    /// From the free end to the carina.
    trachea: Vec<usize>,
    /// From the carina to the next junction, the widest first.
    bronchi: Vec<MainBronchus>,
}

#[derive(Clone, Copy, Debug)]
struct MainBronchus {
    length_mm: f64,
    radius_mm: f64,
    end_mm: DVec3,
}

/// Which way the body lies, as far as an airway's shape tells.
struct BodySigns {
    /// Axis to the head, and whether along it.
    head: (usize, bool),
    /// Axis of the sides.
    side: usize,
    /// How many signs say that the left is along the axis of the sides, less those that say the contrary: -3 to 3.
    left: i32,
    /// Whether the back is along the remaining axis.
    back: Option<bool>,
}

/// Where the frame and the unit of an airway come from, and so what cures a wrong one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameSource {
    /// A surface's file says nothing: `--axes` and `--scale` do.
    Options,
    /// The affine in a volume's header.
    Header,
}

/// What is expected of an airway.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExpectedAnatomy {
    /// Size and shape of a human one.
    Human,
    /// Anything: an animal, a phantom, a part of an airway.
    Any,
}

/// Refuses an airway of an impossible size, and names the unit that would make it a possible one. `points` in mm.
pub fn check_extent(points: impl Iterator<Item = DVec3>, source: FrameSource) -> Result<()> {
    let extent = longest_side(points);
    if within(extent, EXTENT_MM) {
        return Ok(());
    }
    let sentence = format!(
        "the airway's longest side is {extent:.4} mm, and an airway's is {} to {} mm",
        EXTENT_MM[0], EXTENT_MM[1]
    );
    Err(Error::input(format!("{sentence}: {}", scale_cure(extent, EXTENT_MM, source))))
}

/// Refuses places in lungs that span no human ones; `what` they are.
pub fn check_lungs(what: &str, places: impl IntoIterator<Item = DVec3>, anatomy: ExpectedAnatomy) -> Result<()> {
    let extent = longest_side(places.into_iter());
    if anatomy == ExpectedAnatomy::Any || within(extent, LUNGS_MM) {
        return Ok(());
    }
    Err(Error::input(format!(
        "the longest side of these lungs is {extent:.4}, and lungs measure {} to {} mm: {what} are in mm (LPS); those of an \
         animal or a phantom are taken with --unusual",
        LUNGS_MM[0], LUNGS_MM[1]
    )))
}

/// Refuses a motion that no breathing is, and of humans landmarks of an impossible size. The element is the pair's number,
/// from 1.
pub fn check_landmarks(pairs: &[LandmarkPair], anatomy: ExpectedAnatomy) -> Result<()> {
    check_lungs("landmarks", pairs.iter().map(|pair| pair.inspiration_mm), anatomy)?;
    let is_human = anatomy == ExpectedAnatomy::Human;
    let moves = |pair: &LandmarkPair| pair.motion_mm().length();
    if let Some(at) = pairs.iter().position(|pair| is_human && moves(pair) > FURTHEST_MM) {
        let sentence =
            format!("the landmark moves by {:.0} mm, and breathing moves {FURTHEST_MM} mm at most", moves(&pairs[at]));
        return Err(Error::input(sentence).element(format!("pair {}", at + 1)));
    }
    let most = pairs.iter().map(moves).fold(0.0, f64::max);
    if most < STILL_MM {
        return Err(Error::input(format!("no landmark moves by {STILL_MM} mm or more (the most is {most:.3} mm)")));
    }
    let growth = growth(pairs);
    if growth > MOST_GROWTH {
        return Err(Error::input(format!(
            "the lungs are {growth:.2} times as large at expiration as at inspiration: are the columns insp and exp \
             swapped?"
        )));
    }
    Ok(())
}

/// The factor on volumes from inspiration to expiration: det(I + A), where the motion is nearest to A x + b.
fn growth(pairs: &[LandmarkPair]) -> f64 {
    let count = pairs.len().max(1) as f64;
    let place = pairs.iter().map(|p| p.inspiration_mm).sum::<DVec3>() / count;
    let motion = pairs.iter().map(LandmarkPair::motion_mm).sum::<DVec3>() / count;
    let (mut spread, mut product) = (Matrix3::<f64>::zeros(), Matrix3::<f64>::zeros());
    for pair in pairs {
        let x = Vector3::from((pair.inspiration_mm - place).to_array());
        let d = Vector3::from((pair.motion_mm() - motion).to_array());
        spread += x * x.transpose();
        product += d * x.transpose();
    }
    // Along an axis without spread nothing is known, and no growth is assumed.
    let least = LEAST_VARIANCE * spread.symmetric_eigenvalues().max();
    spread.pseudo_inverse(least).map_or(1.0, |inverse| (Matrix3::identity() + product * inverse).determinant())
}

/// What is to be said of a trachea that moves more at its upper end than where it divides, where breathing moves it most;
/// `expiration` are the points of the centreline at expiration, mm. None where it is as it should be.
pub fn trachea_note(centerline: &Centerline, expiration: &[DVec3]) -> Option<String> {
    let points = centerline.points.iter().zip(expiration).filter(|(point, _)| point.generation == 0);
    let moves: Vec<f64> = points.map(|(point, moved)| point.position_mm.distance(*moved)).collect();
    let carina = *moves.last()?;
    let upper = &moves[..moves.len().div_ceil(4)];
    let mean = upper.iter().sum::<f64>() / upper.len() as f64;
    (mean > carina + TRACHEA_BEYOND_MM).then(|| {
        format!(
            "the trachea's upper end moves by {mean:.0} mm, and its division by {carina:.0}: above the lungs there is little \
             that a registration can hold on to, so look at the page before you use that part"
        )
    })
}

/// Refuses an airway whose trachea is too narrow or too wide, or that does not lie in the body as `axes`, with which it
/// was read, say.
pub fn check_stem(centerline: &Centerline, axes: PatientAxes, source: FrameSource) -> Result<()> {
    let position = |p: usize| centerline.points[p].position_mm;
    let Some(stem) = stem(centerline, LEAST_TRACHEA_MM) else {
        let what = match stem(centerline, 0.0) {
            Some(_) => format!("no trachea of {LEAST_TRACHEA_MM} mm or more above its division"),
            None => "no bifurcation".to_owned(),
        };
        return Err(Error::input(format!(
            "the airway has {what}: a trachea with its bronchi is wanted; --unusual takes it"
        )));
    };
    let radii = stem.trachea.iter().map(|&p| centerline.points[p].radius_mm);
    let diameter = 2.0 * upper_median(radii).expect("a trachea has points");
    if !within(diameter, TRACHEA_MM) {
        return Err(Error::input(format!(
            "the widest branch that ends is {diameter:.1} mm across, and a trachea is {} to {} mm: {}",
            TRACHEA_MM[0],
            TRACHEA_MM[1],
            scale_cure(diameter, TRACHEA_MM, source)
        )));
    }
    let (top, carina) = (position(stem.trachea[0]), position(stem.trachea[stem.trachea.len() - 1]));
    let tree: Vec<DVec3> = (0..centerline.points.len()).filter(|p| !stem.trachea.contains(p)).map(position).collect();
    let Some(found) = body_signs(top, carina, &tree, &stem.bronchi).as_ref().and_then(directions) else {
        return Ok(());
    };
    if found == PatientAxes::LPS {
        return Ok(());
    }
    let corrected = axes.corrected(found);
    // One sign that is misread swaps left and right, and few programs write mirrored axes.
    let doubt = if corrected.is_mirrored() != axes.is_mirrored() {
        " (a mirror image of how it was read: look up in the scan which side is left)"
    } else {
        ""
    };
    Err(Error::input(match source {
        FrameSource::Options => format!(
            "its trachea and main bronchi lie as if the file's axes were `{corrected}` and not `{axes}`{doubt}: --axes \
             {corrected}, or --unusual if it is right"
        ),
        FrameSource::Header => format!(
            "its trachea and main bronchi lie as if its axes were `{corrected}` where its header says `{axes}`{doubt}: \
             the header's affine is missing or wrong, so export it anew from the DICOM, or --unusual if it is right"
        ),
    }))
}

fn within(value: f64, [least, most]: [f64; 2]) -> bool {
    (least..=most).contains(&value)
}

fn scale_cure(value: f64, range: [f64; 2], source: FrameSource) -> String {
    if source == FrameSource::Header {
        return "the spacing in the file's header is wrong; --unusual takes it as it is".to_owned();
    }
    let fits = UNITS.iter().filter(|(_, size)| within(value * size, range));
    let known: Vec<String> = fits.map(|(unit, size)| format!("if the file is in {unit}, --scale {size}")).collect();
    let cure = match known.is_empty() {
        false => known.join("; "),
        true => "--scale FACTOR gives the file's unit in mm".to_owned(),
    };
    format!("{cure}; --unusual takes it as it is")
}

fn longest_side(points: impl Iterator<Item = DVec3>) -> f64 {
    let (low, high) = points.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), p| (low.min(p), high.max(p)));
    (high - low).max_element().max(0.0)
}

/// The widest branch that ends, as the trachea, with the bronchi where it divides; `None` without a bifurcation. A thin
/// branch of its side is none of them: one person in a hundred has a bronchus of the right upper lobe there. What is
/// shorter than `least_mm` is no trachea.
fn stem(centerline: &Centerline, least_mm: f64) -> Option<Stem> {
    let points = &centerline.points;
    let mut neighbours: Vec<Vec<usize>> = vec![Vec::new(); points.len()];
    for (p, point) in points.iter().enumerate() {
        if let Some(parent) = point.parent {
            neighbours[p].push(parent as usize);
            neighbours[parent as usize].push(p);
        }
    }
    // From `start` through `next` to the first point that is no mere link.
    let branch = |start: usize, next: usize| {
        let mut way = vec![start, next];
        while let [.., before, here] = way[..] {
            match neighbours[here].as_slice() {
                [a, b] => way.push(if *a == before { *b } else { *a }),
                _ => break,
            }
        }
        way
    };
    let length = |way: &[usize]| {
        way.windows(2).map(|w| points[w[0]].position_mm.distance(points[w[1]].position_mm)).sum::<f64>()
    };
    let width = |way: &[usize]| upper_median(way.iter().map(|&p| points[p].radius_mm)).expect("a branch has points");
    let ends = (0..points.len()).filter(|&p| neighbours[p].len() == 1);
    let mut trachea = ends
        .map(|end| branch(end, neighbours[end][0]))
        .filter(|way| neighbours[way[way.len() - 1]].len() > 2 && length(way) >= least_mm)
        .max_by(|a, b| width(a).total_cmp(&width(b)))?;
    let daughters = |way: &[usize]| -> Vec<Vec<usize>> {
        let (end, before) = (way[way.len() - 1], way[way.len() - 2]);
        let mut ways: Vec<_> =
            neighbours[end].iter().filter(|&&n| n != before).map(|&next| branch(end, next)).collect();
        ways.sort_by(|a, b| width(b).total_cmp(&width(a)));
        ways
    };
    let whole = width(&trachea);
    let mut ways = daughters(&trachea);
    while let [wide, thin @ ..] = ways.as_slice()
        && width(wide) > TRACHEA_GOES_ON * whole
        && thin.iter().all(|way| width(way) < SIDE_BRANCH * whole)
        && neighbours[wide[wide.len() - 1]].len() > 2
    {
        trachea.extend(&wide[1..]);
        ways = daughters(&trachea);
    }
    let bronchi = ways
        .iter()
        .map(|way| {
            let end_mm = points[way[way.len() - 1]].position_mm;
            MainBronchus { length_mm: length(way), radius_mm: width(way), end_mm }
        })
        .collect();
    Some(Stem { trachea, bronchi })
}

/// What the shape tells; `None` where it does not even tell which way is up.
fn body_signs(top: DVec3, carina: DVec3, tree: &[DVec3], bronchi: &[MainBronchus]) -> Option<BodySigns> {
    let middle = tree.iter().sum::<DVec3>() / tree.len().max(1) as f64;
    let up = (top - middle).normalize_or_zero();
    let head = (0..3).max_by(|&a, &b| up[a].abs().total_cmp(&up[b].abs()))?;
    if up[head].abs() < UPRIGHT {
        return None;
    }
    let spread = |axis: usize| tree.iter().map(|p| (p[axis] - middle[axis]).powi(2)).sum::<f64>().sqrt();
    let (first, second) = ((head + 1) % 3, (head + 2) % 3);
    let (first, second) = (first.min(second), first.max(second));
    // Where the shape does not tell, the order of the axes is as in the file.
    let side = if spread(second) > SIDEWAYS * spread(first) { second } else { first };
    let depth = first + second - side;
    let left = match bronchi {
        [a, b, ..] => {
            let down = |m: &MainBronchus| (carina - m.end_mm)[head] * up[head].signum() / m.length_mm.max(1e-9);
            let sign = |is_a: bool, is_b: bool| i32::from(is_a) - i32::from(is_b);
            let a_is_left = sign(a.length_mm > LONGER * b.length_mm, b.length_mm > LONGER * a.length_mm)
                + sign(b.radius_mm > WIDER * a.radius_mm, a.radius_mm > WIDER * b.radius_mm)
                + sign(down(b) > down(a) + STEEPER, down(a) > down(b) + STEEPER);
            if a.end_mm[side] > b.end_mm[side] { a_is_left } else { -a_is_left }
        }
        _ => 0,
    };
    let way = carina - top;
    let back = Some(way[depth]).filter(|b| b.abs() > BACKWARDS * way.length()).map(|b| b > 0.0);
    Some(BodySigns { head: (head, up[head] > 0.0), side, left, back })
}

/// The axes in which the airway lies. What the shape does not tell is as assumed, or follows from a right hand.
fn directions(signs: &BodySigns) -> Option<PatientAxes> {
    let BodySigns { head, side, left, back } = *signs;
    let depth = 3 - head.0 - side;
    let lying = |left: bool, back: bool| PatientAxes::from_directions([(side, left), (depth, back), head]);
    if head == (2, true) && side == 0 {
        // A bent neck turns the trachea's slope round, so that it tells nothing alone; and what says that the sides are
        // exchanged, but not front and back, must be unanimous: few files are mirrored.
        return match (left, back) {
            (-3, Some(true)) => lying(false, true),
            (-3 | -2, None | Some(false)) => lying(false, false),
            _ => lying(true, true),
        };
    }
    let candidates = [(true, true), (true, false), (false, true), (false, false)];
    let fits = |&(to_left, to_back): &(bool, bool)| {
        let agrees = |known: Option<bool>, said: bool| known.is_none_or(|known| known == said);
        let right_handed = lying(to_left, to_back).is_some_and(|axes| !axes.is_mirrored());
        let told = if left.abs() >= 2 { agrees(Some(left > 0), to_left) } else { agrees(back, to_back) };
        right_handed && told
    };
    let (to_left, to_back) = candidates.into_iter().find(fits)?;
    lying(to_left, to_back)
}

#[cfg(test)]
mod tests {
    use super::super::case::Case;
    use super::super::case_build::rest_centerline;
    use super::super::centerline::CenterlinePoint;
    use super::*;

    /// An airway of four branches a side, after the measured ones; parents first.
    fn airway() -> Centerline {
        let mut points: Vec<CenterlinePoint> = Vec::new();
        let mut grow = |from: Option<u32>, start: DVec3, end: DVec3, radius_mm: f64| -> u32 {
            let mut parent = from;
            for step in usize::from(from.is_some())..=20 {
                let position_mm = start.lerp(end, step as f64 / 20.0);
                points.push(CenterlinePoint { position_mm, radius_mm, branch: 0, generation: 0, parent });
                parent = Some(points.len() as u32 - 1);
            }
            points.len() as u32 - 1
        };
        let at = DVec3::new;
        let carina = at(0.0, 25.0, 0.0);
        let trachea = grow(None, at(0.0, 0.0, 85.0), carina, 7.0);
        for (end, radius_mm) in [(at(40.0, 30.0, -36.0), 4.7), (at(-12.0, 28.0, -20.0), 5.7)] {
            let main = grow(Some(trachea), carina, end, radius_mm);
            let out = end.x.signum();
            grow(Some(main), end, end + at(out * 25.0, -15.0, 20.0), 2.5);
            grow(Some(main), end, end + at(out * 30.0, 12.0, -60.0), 3.0);
        }
        Centerline { points }
    }

    fn mapped(line: &Centerline, map: impl Fn(DVec3) -> DVec3) -> Centerline {
        let mut line = line.clone();
        line.points.iter_mut().for_each(|p| p.position_mm = map(p.position_mm));
        line
    }

    #[test]
    fn a_trachea_that_moves_more_above_than_below_is_told() {
        let line = airway();
        let moved = |by: &dyn Fn(f64) -> f64| -> Vec<DVec3> {
            let along = |i: usize| DVec3::X * by(i as f64 / (line.points.len() - 1) as f64);
            line.points.iter().enumerate().map(|(i, point)| point.position_mm + along(i)).collect()
        };
        // As breathing moves it, as a whole, and as a registration that has lost it does.
        assert!(trachea_note(&line, &moved(&|t| 12.0 * t)).is_none());
        assert!(trachea_note(&line, &moved(&|_| 5.0)).is_none());
        let said = trachea_note(&line, &moved(&|t| 50.0 * (1.0 - t))).unwrap();
        assert!(said.contains("upper end moves by 4") && said.contains("division by 0"), "{said}");
        assert!(trachea_note(&Centerline::default(), &[]).is_none());
    }

    #[test]
    fn every_wrong_reading_of_right_handed_axes_is_refused_with_the_right_one() {
        let line = airway();
        check_stem(&line, PatientAxes::LPS, FrameSource::Options).unwrap();
        for letters in ["ras", "lsa", "rsp", "lai", "rpi", "psl", "als", "sal", "slp", "asr"] {
            let truth: PatientAxes = letters.parse().unwrap();
            // What the file of these axes holds, read as LPS.
            let inverse = |p: DVec3| {
                let along = |axis: DVec3| truth.to_lps(axis).dot(p);
                DVec3::new(along(DVec3::X), along(DVec3::Y), along(DVec3::Z))
            };
            let file = mapped(&line, inverse);
            let said = check_stem(&file, PatientAxes::LPS, FrameSource::Options).unwrap_err().to_string();
            if truth.is_mirrored() {
                continue;
            }
            assert!(said.contains(&format!("--axes {letters},")) && !said.contains("mirror"), "{letters}: {said}");
            check_stem(&mapped(&file, |p| truth.to_lps(p)), truth, FrameSource::Options).unwrap();
        }
        let mirrored = mapped(&line, |p| DVec3::new(-p.x, p.y, p.z));
        let said = check_stem(&mirrored, PatientAxes::LPS, FrameSource::Options).unwrap_err().to_string();
        assert!(said.contains("a mirror image of how it was read") && said.contains("--axes rps"), "{said}");
        // A bent neck is no error.
        let trachea = |p: DVec3| if p.z > 0.0 { DVec3::new(p.x, 50.0 - p.y, p.z) } else { p };
        check_stem(&mapped(&line, trachea), PatientAxes::LPS, FrameSource::Options).unwrap();
    }

    /// A bronchus of the right upper lobe that leaves the trachea above its division is a part of a human airway.
    #[test]
    fn a_tracheal_bronchus_is_no_main_bronchus() {
        let mut line = airway();
        let trachea = line.points[14].position_mm;
        let mut parent = 14;
        for step in 1..=20 {
            let position_mm = trachea + f64::from(step) * DVec3::new(-1.6, 0.3, 0.4);
            line.points.push(CenterlinePoint {
                position_mm,
                radius_mm: 3.0,
                branch: 9,
                generation: 1,
                parent: Some(parent),
            });
            parent = line.points.len() as u32 - 1;
        }
        let found = stem(&line, LEAST_TRACHEA_MM).unwrap();
        assert_eq!((found.trachea.len(), found.bronchi.len()), (21, 2));
        check_stem(&line, PatientAxes::LPS, FrameSource::Options).unwrap();
        let turned = mapped(&line, |p| DVec3::new(-p.x, -p.y, p.z));
        let said = check_stem(&turned, PatientAxes::LPS, FrameSource::Options).unwrap_err().to_string();
        assert!(said.contains("--axes ras,"), "{said}");
    }

    #[test]
    fn wrong_units_are_named_with_their_factor() {
        let positions = |line: &Centerline| line.points.iter().map(|p| p.position_mm).collect::<Vec<_>>();
        let whole = positions(&airway());
        check_extent(whole.iter().copied(), FrameSource::Options).unwrap();
        for (unit, factor) in [("centimetres, --scale 10", 0.1), ("metres, --scale 1000", 1e-3)] {
            let said = check_extent(whole.iter().map(|p| *p * factor), FrameSource::Options).unwrap_err().to_string();
            assert!(said.contains(unit), "{said}");
        }
        assert!(
            check_extent(whole.iter().map(|p| *p * 30.0), FrameSource::Options)
                .unwrap_err()
                .to_string()
                .contains("--scale FACTOR")
        );
        let mut narrow = airway();
        narrow.points.iter_mut().for_each(|p| p.radius_mm *= 0.4);
        let short = mapped(&airway(), |p| p * 0.1);
        let said = check_stem(&short, PatientAxes::LPS, FrameSource::Options).unwrap_err().to_string();
        assert!(said.contains("no trachea of 15 mm or more above its division"), "{said}");
        assert!(
            check_stem(&narrow, PatientAxes::LPS, FrameSource::Options)
                .unwrap_err()
                .to_string()
                .contains("5.6 mm across")
        );
        let header = check_extent(whole.iter().map(|p| *p * 0.1), FrameSource::Header).unwrap_err().to_string();
        assert!(header.contains("in the file's header") && !header.contains("--scale"), "{header}");
        let turned = mapped(&airway(), |p| DVec3::new(-p.x, -p.y, p.z));
        let header = check_stem(&turned, PatientAxes::LPS, FrameSource::Header).unwrap_err().to_string();
        assert!(header.contains("header's affine is missing or wrong") && !header.contains("--axes"), "{header}");
    }

    /// Landmarks on a grid of `spacing_mm`, each moved by `motion`.
    fn lungs(spacing_mm: f64, motion: impl Fn(DVec3) -> DVec3) -> Vec<LandmarkPair> {
        (0..125)
            .map(|k| {
                let inspiration_mm = DVec3::new((k % 5) as f64, (k / 5 % 5) as f64, (k / 25) as f64) * spacing_mm;
                LandmarkPair { inspiration_mm, expiration_mm: inspiration_mm + motion(inspiration_mm) }
            })
            .collect()
    }

    #[test]
    fn landmarks_that_no_breathing_moves_are_refused() {
        let breath = |p: DVec3| DVec3::new(0.0, 3.0, 20.0 - 0.1 * p.z);
        let said = |pairs: &[LandmarkPair]| check_landmarks(pairs, ExpectedAnatomy::Human).unwrap_err().to_string();
        let good = lungs(50.0, breath);
        check_landmarks(&good, ExpectedAnatomy::Human).unwrap();
        // In one plane, or moved as a whole, the volume stays.
        check_landmarks(&good[..25], ExpectedAnatomy::Human).unwrap();
        check_landmarks(&lungs(50.0, |_| DVec3::splat(9.0)), ExpectedAnatomy::Human).unwrap();
        assert!(said(&lungs(5.0, breath)).contains("mm (LPS)"));
        let mut outlier = good.clone();
        outlier[7].expiration_mm.x += 200.0;
        assert!(said(&outlier).contains("pair 8: the landmark moves by 201 mm"), "{}", said(&outlier));
        let swapped: Vec<LandmarkPair> = good
            .iter()
            .map(|p| LandmarkPair { inspiration_mm: p.expiration_mm, expiration_mm: p.inspiration_mm })
            .collect();
        assert!(said(&swapped).contains("1.11 times as large at expiration"), "{}", said(&swapped));
        assert!(said(&lungs(50.0, |p| breath(p) * 1e-3)).contains("no landmark moves by 0.1 mm"));
    }

    #[test]
    fn the_shipped_airways_lie_as_they_should() {
        for number in 1..=9 {
            let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("bench-cases/case{number}.toml"));
            let line = rest_centerline(&Case::load(&path).unwrap()).unwrap();
            check_extent(line.points.iter().map(|p| p.position_mm), FrameSource::Options).unwrap();
            check_stem(&line, PatientAxes::LPS, FrameSource::Options).unwrap_or_else(|e| panic!("case{number}: {e}"));
        }
    }
}
