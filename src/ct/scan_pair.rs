//! The recipe: two scans (or one and somebody's field) become an airway in two states, and all that is to be said of it.

use std::path::{Path, PathBuf};

use glam::DVec3;

use super::airway_mask::{AirwayMask, read_mask};
use super::lumen::{DistanceSpread, LumenSurface, distances_from_mask, surface_of_mask};
use super::lungs::{check_pair, check_place, find_lungs, litres, on_grid};
use super::motion_field::{VolumeChange, carried, check_field, check_motion, inverse_consistency, volume_change};
use super::region::grow_airway;
use super::registration::{
    PARAMETERS, REGISTRATION_MM, RegistrationInput, demand_elastix, mean_displacement, register,
};
use super::scan::{coarser, read_checked};
use crate::airway::import_check::ExpectedAnatomy;
use crate::base::{Error, Progress, Result, Volume, hash};
use crate::formats::volume::{frame_note, read_field};

/// What is measured and done, for the user and the page: what, and in words.
pub type Facts = Vec<(&'static str, String)>;

/// Most that the lungs may grow between inspiration and expiration, in the median over their voxels.
const MOST_GROWTH: f64 = 1.02;
/// Radiodensity in HU below which lies the inside of an airway, and how far inside of a mask in mm that is asked: masks
/// of some programs hold the wall of the airway, too.
const INSIDE_HU: i16 = -500;
const INSIDE_MM: f64 = 2.0;
/// Least share of a mask's inside that must be air in its scan, and the fewest voxels that say so.
const LEAST_AIR: f64 = 0.93;
const FEWEST_INSIDE: usize = 50;
/// By how much larger that share must be for a mask that is mirrored: a straight tube is its own mirror image.
const LEAST_GAIN: f64 = 0.01;
/// Axes of a mask (left, back, head) that a header may have the wrong way round, and what the mask is then.
const TURNED_ROUND: [([bool; 3], &str); 4] = [
    ([true, false, false], "mirrored left to right"),
    ([false, true, false], "mirrored front to back"),
    ([false, false, true], "mirrored head to foot"),
    ([true, true, false], "turned by half around the axis of the body"),
];

/// The files of an import.
pub struct ScanRequest<'a> {
    /// Scan at full inspiration.
    pub inspiration: &'a Path,
    /// Scan at full expiration; without it a field is needed.
    pub expiration: Option<&'a Path>,
    /// Mask of the airway at inspiration; grown from the scan without it.
    pub airway: Option<&'a Path>,
    /// Mask of the airway at expiration: only compared with.
    pub airway_expiration: Option<&'a Path>,
    /// What is expected of the airway.
    pub anatomy: ExpectedAnatomy,
    /// Label of the airway in its masks.
    pub label: Option<u16>,
    /// Masks of the lungs at both; found in the scans without them.
    pub lungs: [Option<&'a Path>; 2],
    /// Somebody else's displacement field.
    pub field: Option<&'a Path>,
    /// Whether expiration is registered to inspiration, too, to see how far the way back misses the start.
    pub way_back: bool,
}

/// What two scans became.
pub struct ScanPair {
    /// The airway at inspiration.
    pub surface: LumenSurface,
    /// Its vertices at expiration, as the field has them: faces may turn over.
    pub expiration: Vec<DVec3>,
    /// The displacement from inspiration to expiration, LPS, mm.
    pub field: Volume<[f32; 3]>,
    /// The scans as the page shows them, inspiration first.
    pub scans: Vec<Volume<i16>>,
    /// How volumes change in the lungs.
    pub change: VolumeChange,
    /// What was measured.
    pub facts: Facts,
    /// Files to keep with the case: name and text.
    pub kept: Vec<(&'static str, String)>,
}

/// The airway of a mask's file, or grown from `scan`; what is to be said of it goes to `facts`.
pub fn airway_of(
    mask: Option<&Path>,
    label: Option<u16>,
    scan: Option<&Volume<i16>>,
    anatomy: ExpectedAnatomy,
    facts: &mut Facts,
    progress: &dyn Progress,
) -> Result<AirwayMask> {
    let airway = match (mask, scan) {
        (Some(path), _) => {
            let airway = read_mask(path, label, anatomy)?;
            frame_note(path).iter().for_each(|note| progress.note(note));
            facts.push(("airway mask", format!("{}, {:.1} ml", path.display(), airway.volume_ml)));
            airway
        }
        (None, Some(scan)) => {
            let grown = grow_airway(scan, anatomy, progress)?;
            let leak = match grown.leaked_at_hu {
                Some(leak) => format!("it leaks into the lung below {leak} HU"),
                None => "it never leaked".to_owned(),
            };
            let words = format!(
                "grown from the trachea, voxels below {} HU; {leak}; {:.1} ml",
                grown.threshold_hu, grown.airway.volume_ml
            );
            facts.push(("airway mask", words));
            grown.airway
        }
        (None, None) => return Err(Error::usage("without a scan an airway mask is wanted: --airway-mask MASK")),
    };
    if airway.loose_parts > 0 {
        let share = 100.0 * airway.loose_share;
        facts.push(("loose parts", format!("{} left out, {share:.2} % of the mask", airway.loose_parts)));
    }
    Ok(airway)
}

/// The surface of an airway mask; what is to be said of it goes to `facts`.
pub fn surface_of(airway: &AirwayMask, facts: &mut Facts) -> Result<LumenSurface> {
    let surface = surface_of_mask(&airway.mask)?;
    let (voxel, ball) = (surface.voxel_mm, surface.ball);
    facts.push((
        "surface",
        format!(
            "{} faces, closed, genus 0; voxels {:.2} x {:.2} x {:.2} mm",
            surface.mesh.faces.len(),
            voxel.x,
            voxel.y,
            voxel.z
        ),
    ));
    facts.push(("surface from mask", format!("{} (median / 95 % / most)", surface.from_surface)));
    facts.push(("mask from surface", format!("{} (median / 95 % / most)", surface.from_mask)));
    let lost = 100.0 * (1.0 - ball.taken as f64 / ball.nodes.max(1) as f64);
    facts.push(("handles and bits", format!("{} nodes cut, {lost:.2} % of the lumen left out", ball.cut)));
    Ok(surface)
}

/// Whether both are one file or folder, or files of one content.
fn is_same_file(a: &Path, b: &Path) -> bool {
    let place = |path: &Path| path.canonicalize().ok();
    let content = |path: &Path| hash::of_file(path).ok().filter(|_| path.is_file());
    let size = |path: &Path| path.metadata().map(|m| m.len()).ok();
    place(a).is_some_and(|a| Some(a) == place(b))
        || (size(a) == size(b) && content(a).is_some_and(|hash| Some(hash) == content(b)))
}

/// Does it all. `workshop` is a folder for elastix, which the caller removes.
///
/// Errors: what is wrong with a file, with its cure; scans in the wrong order; elastix missing or failing. Folds are
/// counted and told, and no error: the airway may lie elsewhere.
pub fn import_pair(request: &ScanRequest<'_>, workshop: &Path, progress: &dyn Progress) -> Result<ScanPair> {
    // What would fail at the end is said at the beginning.
    if request.expiration.is_none() && request.field.is_none() {
        return Err(Error::usage("one scan has no motion: give the expiration, or a field"));
    }
    let version = if request.field.is_none() { Some(demand_elastix()?) } else { None };
    if let Some(path) = request.expiration.filter(|path| is_same_file(path, request.inspiration)) {
        return Err(Error::input("is the scan at inspiration once more: two breath holds are wanted").at(path));
    }
    let given = request.field.map(|path| own_field(path, progress)).transpose()?;
    let mut facts = Facts::new();
    let (surface, full, full_l) = inspiration_of(request, given.as_ref(), &mut facts, progress)?;
    progress.proceed()?;
    let empty = request
        .expiration
        .map(|path| expiration_of(request, path, (&full.lungs, full_l), &mut facts, progress))
        .transpose()?;
    progress.proceed()?;
    let (field, region) = match (given, &empty) {
        (Some((path, field)), _) => {
            facts.push(("field", path.display().to_string()));
            let region = on_grid(&full.lungs, &Volume::filled(field.grid, 0u8));
            (field, region)
        }
        (None, Some(empty)) => {
            let program = version.as_deref().unwrap_or_default();
            let airway = &surface.mesh.vertices;
            let field = registered(request, [&full, empty], airway, program, workshop, &mut facts, progress)?;
            (field, full.lungs.clone())
        }
        (None, None) => return Err(Error::usage("without a second scan a field is wanted")),
    };
    progress.proceed()?;
    let change = describe_field(&field, &region, &mut facts);
    if let Some(path) = request.field.filter(|_| change.voxels > 0 && change.median > MOST_GROWTH) {
        let sentence = format!(
            "the lungs grow to {:.2} of their volume by it: a field from inspiration to expiration is wanted, and this is \
             one of the way back",
            change.median
        );
        return Err(Error::input(sentence).at(path));
    }
    let expiration = carried(&field, &surface.mesh.vertices);
    if let Some(path) = request.airway_expiration {
        let other = read_mask(path, request.label, request.anatomy)?;
        let off = DistanceSpread::of(distances_from_mask(&other.mask, &expiration)?);
        facts.push(("carried from other mask", format!("{off} (median / 95 % / most; {})", path.display())));
    }
    let mut scans = vec![full.scan];
    scans.extend(empty.map(|input| input.scan));
    let stated = |version: &String| {
        PARAMETERS.map(|(name, text)| (name, format!("// As they were given to elastix {version}.\n{text}"))).to_vec()
    };
    let kept = version.as_ref().map(stated).unwrap_or_default();
    Ok(ScanPair { surface, expiration, field, scans, change, facts, kept })
}

/// The airway's surface at inspiration, what is registered of that scan, and the volume of the lungs in litres. A `given`
/// field that does not cover the surface is refused as soon as that is known.
fn inspiration_of(
    request: &ScanRequest<'_>,
    given: Option<&(&Path, Volume<[f32; 3]>)>,
    facts: &mut Facts,
    progress: &dyn Progress,
) -> Result<(LumenSurface, RegistrationInput, f64)> {
    let scan = read_checked(request.inspiration, progress)?;
    let coarse = coarser(&scan, REGISTRATION_MM);
    let named = |e: Error| e.at(request.inspiration);
    let airway =
        airway_of(request.airway, request.label, Some(&scan), request.anatomy, facts, progress).map_err(named)?;
    // What is wrong with a mask is not the scan's fault.
    let of_airway = |e: Error| e.at(request.airway.unwrap_or(request.inspiration));
    if request.airway.is_some() {
        check_mask(&airway.mask, &scan).map_err(of_airway)?;
    }
    progress.proceed()?;
    let surface = surface_of(&airway, facts).map_err(of_airway)?;
    drop(scan);
    if let Some((path, field)) = given {
        check_field(field, &surface.mesh.vertices).map_err(|e| e.at(path))?;
    }
    progress.proceed()?;
    let lungs = lungs_of(&coarse, request.lungs[0], Some(&airway.mask)).map_err(named)?;
    let full = RegistrationInput::new(&coarse, &lungs, Some(&airway.mask));
    // With the airway in it, as at expiration, where nobody knows it.
    let volume_l = litres(&lungs_of(&coarse, request.lungs[0], None).map_err(named)?);
    Ok((surface, full, volume_l))
}

/// Refuses a mask of the airway whose inside is no air in `scan`, or less so than its mirror image's: one of another patient,
/// or whose header lies.
pub fn check_mask(mask: &Volume<u8>, scan: &Volume<i16>) -> Result<()> {
    let (size, spacing_mm) = (mask.grid.size, mask.grid.spacing_mm());
    let reach: [usize; 3] = std::array::from_fn(|axis| (INSIDE_MM / spacing_mm[axis]).ceil() as usize);
    let is_inside = |at: usize| {
        let cell = mask.grid.cell(at);
        (0..3).all(|axis| {
            let along = |index: usize| {
                let mut beside = cell;
                beside[axis] = index;
                mask.data[mask.grid.at(beside)] > 0
            };
            cell[axis] >= reach[axis]
                && cell[axis] + reach[axis] < size[axis]
                && along(cell[axis] - reach[axis])
                && along(cell[axis] + reach[axis])
        })
    };
    let inside: Vec<[usize; 3]> =
        (0..mask.data.len()).filter(|&at| mask.data[at] > 0 && is_inside(at)).map(|at| mask.grid.cell(at)).collect();
    if inside.len() < FEWEST_INSIDE {
        return Ok(());
    }
    let to_index = scan.grid.index_from_place();
    // The share of air where the mask lies once the axes that are `turned` are counted from their other end.
    let air_share = |turned: [bool; 3]| {
        let place = |cell: &[usize; 3]| {
            let cell = std::array::from_fn(|axis| if turned[axis] { size[axis] - 1 - cell[axis] } else { cell[axis] });
            mask.grid.centre(mask.grid.at(cell))
        };
        let is_air = |cell: &&[usize; 3]| scan.nearest(to_index(place(cell))).is_some_and(|hu| hu < INSIDE_HU);
        inside.iter().filter(is_air).count() as f64 / inside.len() as f64
    };
    let share = air_share([false; 3]);
    let better = TURNED_ROUND.iter().map(|(turned, how)| (air_share(*turned), how));
    if let Some((most, how)) =
        better.filter(|(turned, _)| *turned >= LEAST_AIR.max(share + LEAST_GAIN)).max_by(|a, b| a.0.total_cmp(&b.0))
    {
        let sentence = format!(
            "{:.1} % of the inside of this airway is air in the scan, and {:.1} % once it is {how}: one of the two headers has \
             an axis the wrong way round",
            100.0 * share,
            100.0 * most
        );
        return Err(Error::input(sentence));
    }
    if share < LEAST_AIR {
        let sentence = format!(
            "only {:.0} % of the inside of this airway is air in the scan: it was made for another one, or one of the two \
             headers does not say where it lies",
            100.0 * share
        );
        return Err(Error::input(sentence));
    }
    Ok(())
}

/// What is registered of the scan at expiration, whose lungs must be the emptier ones, and lie where the full ones do.
fn expiration_of(
    request: &ScanRequest<'_>,
    path: &Path,
    (full, full_l): (&Volume<u8>, f64),
    facts: &mut Facts,
    progress: &dyn Progress,
) -> Result<RegistrationInput> {
    let coarse = coarser(&read_checked(path, progress)?, REGISTRATION_MM);
    let lungs = lungs_of(&coarse, request.lungs[1], None).map_err(|e| e.at(path))?;
    let empty = RegistrationInput::new(&coarse, &lungs, None);
    let empty_l = litres(&lungs);
    let ratio = check_pair(full_l, empty_l).map_err(|e| e.at(path))?;
    if request.anatomy == ExpectedAnatomy::Human && request.field.is_none() {
        check_place(full, &lungs).map_err(|e| e.at(path))?;
    }
    facts.push(("lungs", format!("{full_l:.2} l at inspiration, {empty_l:.2} l at expiration, ratio {ratio:.2}")));
    Ok(empty)
}

/// The motion from the full lungs to the empty ones by elastix of `version`; on request how far the way back misses, in
/// the lungs and at the vertices of the `airway`.
fn registered(
    request: &ScanRequest<'_>,
    [full, empty]: [&RegistrationInput; 2],
    airway: &[DVec3],
    version: &str,
    workshop: &Path,
    facts: &mut Facts,
    progress: &dyn Progress,
) -> Result<Volume<[f32; 3]>> {
    let field = register(full, empty, &workshop.join("there"), progress)?;
    facts.push(("registration", format!("elastix {version}, affine and B-spline")));
    if request.way_back {
        let back = register(empty, full, &workshop.join("back"), progress)?;
        let lungs = &full.lungs;
        let voxels = (0..lungs.data.len()).filter(|&at| lungs.data[at] > 0).map(|at| lungs.grid.centre(at));
        let miss = inverse_consistency(&field, &back, &voxels.collect::<Vec<_>>());
        facts.push(("there and back", format!("{miss} (median / 95 % / most, in the lungs)")));
        let miss = inverse_consistency(&field, &back, airway);
        facts.push(("there and back, airway", format!("{miss} (median / 95 % / most)")));
    }
    Ok(field)
}

/// What a field does to the lungs of `region`; folds, change of volume and mean motion go to `facts`.
fn describe_field(field: &Volume<[f32; 3]>, region: &Volume<u8>, facts: &mut Facts) -> VolumeChange {
    let change = volume_change(field, region);
    facts.push((
        "folds",
        format!(
            "{} of {} voxels in the lungs; volume change {:.2} to {:.2}",
            change.folded, change.voxels, change.least, change.greatest
        ),
    ));
    let mean = mean_displacement(field, region);
    facts.push((
        "motion of the lungs",
        format!("{:.1} {:.1} {:.1} mm in the mean (left, back, head)", mean.x, mean.y, mean.z),
    ));
    change
}

/// Somebody's field, and what is wrong with it before any work.
fn own_field<'a>(path: &'a Path, progress: &dyn Progress) -> Result<(&'a Path, Volume<[f32; 3]>)> {
    let field = read_field(path)?;
    check_motion(&field).map_err(|e| e.at(path))?;
    frame_note(path).iter().for_each(|note| progress.note(note));
    progress.proceed()?;
    Ok((path, field))
}

fn lungs_of(scan: &Volume<i16>, mask: Option<&Path>, airway: Option<&Volume<u8>>) -> Result<Volume<u8>> {
    let Some(path) = mask else { return find_lungs(scan, airway) };
    let labels = super::scan::turned(crate::formats::volume::read_labels(path)?);
    let lungs = on_grid(&labels.map(|v| u8::from(v > 0)), scan);
    match lungs.data.iter().any(|v| *v > 0) {
        true => Ok(lungs),
        false => Err(Error::input("marks no voxel of the scan: it was made for another one").at(PathBuf::from(path))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::VoxelGrid;

    #[test]
    fn a_mask_must_lie_in_the_air_of_its_scan() {
        let grid = VoxelGrid::upright([60, 60, 40], DVec3::ZERO, DVec3::new(0.7, 0.7, 1.0));
        let tube = |at: usize, x_mm: f64| {
            let place = grid.centre(at);
            (place.truncate() - glam::DVec2::new(x_mm, 21.0)).length() < 8.0
        };
        let hu = |at: usize| if tube(at, 21.0) { -980i16 } else { 30 };
        let scan = Volume { grid, data: (0..grid.count()).map(hu).collect() };
        let mask = |x_mm: f64| Volume { grid, data: (0..grid.count()).map(|at| u8::from(tube(at, x_mm))).collect() };
        check_mask(&mask(21.0), &scan).unwrap();
        // Half a millimetre off is rounding, not another scan.
        check_mask(&mask(21.5), &scan).unwrap();
        let said = check_mask(&mask(28.0), &scan).unwrap_err().to_string();
        assert!(said.contains("% of the inside of this airway is air"), "{said}");
        // A mask on a grid of its own, which lies elsewhere.
        let mut moved = mask(21.0);
        moved.grid.origin_mm.y += 40.0;
        assert!(check_mask(&moved, &scan).unwrap_err().to_string().contains("only 0 %"));
    }

    /// The trachea is nearly its own mirror image, and most of an airway's volume.
    #[test]
    fn a_mask_that_fits_better_as_its_mirror_image_is_refused() {
        let grid = VoxelGrid::upright([60, 60, 40], DVec3::ZERO, DVec3::new(0.7, 0.7, 1.0));
        let middle_mm = grid.centre(0).x + 0.5 * 59.0 * 0.7;
        let airway = |at: usize, side: f64| {
            let place = grid.centre(at) - DVec3::new(middle_mm, 21.0, 0.0);
            let bronchus = (place - DVec3::new(13.0 * side, 4.0, 10.0)).length() < 5.0;
            place.truncate().length() < 8.0 || bronchus
        };
        let of = |side: f64| (0..grid.count()).map(move |at| airway(at, side));
        let scan = Volume { grid, data: of(1.0).map(|air| if air { -980i16 } else { 30 }).collect() };
        let mask = |side: f64| Volume { grid, data: of(side).map(u8::from).collect() };
        check_mask(&mask(1.0), &scan).unwrap();
        let said = check_mask(&mask(-1.0), &scan).unwrap_err().to_string();
        assert!(said.contains("and 100.0 % once it is mirrored left to right"), "{said}");
    }
}
