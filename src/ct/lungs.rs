//! The lungs of a scan: air that is not outside of the body and not in the airway, closed over its vessels.
//!
//! A threshold, the air that reaches the sides of the picture taken away, the large parts inside of the body kept (the
//! foam of a table may be closed, too), closed by a ball. What is dense (a tumour, water, a lung without air) is not
//! found; the registration does without it.
//!
//! [`chest_air`] has the airways, too, which a registration needs in both scans of a pair.

use glam::DVec3;

use super::parts::{VoxelContact, closed, fill_holes, grown, mask_of, parts, reached};
use crate::base::{Error, Result, Volume};

/// HU below which lies air or lung; a lung at full expiration still does.
const LUNG_HU: i16 = -400;
/// Least volume in ml of a lung, and its least share of the larger one.
const LEAST_LUNG_ML: f64 = 150.0;
const LEAST_SHARE: f64 = 0.05;
/// Least volume in ml of air that may be an airway apart from the lungs: half a trachea, and more than most of the gas in
/// the gullet.
const LEAST_AIRWAY_ML: f64 = 10.0;
/// The ball in mm that closes the lungs over their vessels, and the airway's wall in mm.
const CLOSING_MM: f64 = 6.0;
const WALL_MM: f64 = 2.0;
/// Furthest in mm that breathing moves the middle of the lungs, generously: their base moves so far, and their apex does
/// not.
const MIDDLE_MOVES_MM: f64 = 60.0;

/// Finds the lungs in `scan`; `airway`, on any grid, is no part of them. Without it, they have what hangs together with
/// them of the airways.
///
/// Errors: no part that could be a lung.
pub fn find_lungs(scan: &Volume<i16>, airway: Option<&Volume<u8>>) -> Result<Volume<u8>> {
    let found = inner_air(scan, airway, LEAST_LUNG_ML);
    let largest = found.first().map_or(0, Vec::len);
    let is_lung = |part: &&Vec<usize>| part.len() as f64 >= LEAST_SHARE * largest as f64;
    let kept: Vec<usize> = found.iter().filter(is_lung).flatten().copied().collect();
    if kept.is_empty() {
        return Err(Error::input(
            "no lung was found: no connected air of 150 ml inside of the body; give masks of the lungs with --lung-masks",
        ));
    }
    Ok(over_vessels(&mask_of(scan.grid, &kept)))
}

/// The air of a chest with these `lungs`: the lungs, and what is air inside of the body, as airways are, from the lungs'
/// lower end upwards. One rule for both scans of a pair, and for each alone: it asks for no airway.
pub fn chest_air(scan: &Volume<i16>, lungs: &Volume<u8>) -> Volume<u8> {
    let grid = scan.grid;
    let height = |at: usize| grid.centre(at).z;
    let lowest = (0..grid.count()).filter(|&at| lungs.data[at] > 0).map(height).fold(f64::INFINITY, f64::min);
    let found = inner_air(scan, None, LEAST_AIRWAY_ML);
    let mut air = over_vessels(&mask_of(grid, &found.concat()));
    for at in 0..air.data.len() {
        air.data[at] = u8::from((air.data[at] > 0 && height(at) >= lowest) || lungs.data[at] > 0);
    }
    air
}

/// The connected parts of what is air inside of the body and at least so large, the largest first.
fn inner_air(scan: &Volume<i16>, airway: Option<&Volume<u8>>, least_ml: f64) -> Vec<Vec<usize>> {
    let [nx, ny, _] = scan.grid.size;
    let sides: Vec<usize> = (0..scan.data.len())
        .filter(|&at| {
            let [i, j, _] = scan.grid.cell(at);
            i == 0 || j == 0 || i + 1 == nx || j + 1 == ny
        })
        .collect();
    let outside = reached(scan, &sides, VoxelContact::Faces, |hu| hu < LUNG_HU);
    let mut air = Volume::filled(scan.grid, 0u8);
    for at in 0..air.data.len() {
        air.data[at] = u8::from(scan.data[at] < LUNG_HU && outside.data[at] == 0);
    }
    if let Some(airway) = airway {
        let tube = grown(&on_grid(airway, scan), WALL_MM);
        air.data.iter_mut().zip(&tube.data).filter(|(_, tube)| **tube > 0).for_each(|(value, _)| *value = 0);
    }
    let to_ml = scan.grid.voxel_mm3() * 1e-3;
    let body = parts(&scan.map(|hu| u8::from(hu >= LUNG_HU)), VoxelContact::Faces).into_iter().next();
    let body = mask_of(scan.grid, &body.unwrap_or_default());
    let mut found = parts(&air, VoxelContact::Faces);
    found.retain(|part| part.len() as f64 * to_ml >= least_ml && is_inside(part, scan, &body));
    found
}

/// Air with the vessels in it.
fn over_vessels(air: &Volume<u8>) -> Volume<u8> {
    let mut air = closed(air, CLOSING_MM);
    fill_holes(&mut air);
    air
}

/// Whether most of what is dense around a part of air is the body.
fn is_inside(part: &[usize], scan: &Volume<i16>, body: &Volume<u8>) -> bool {
    let grid = scan.grid;
    let (mut dense, mut of_body) = (0usize, 0usize);
    for &at in part {
        let cell = grid.cell(at);
        for (axis, count) in grid.size.into_iter().enumerate() {
            for index in [cell[axis].checked_sub(1), Some(cell[axis] + 1).filter(|i| *i < count)].into_iter().flatten()
            {
                let mut beside = cell;
                beside[axis] = index;
                let beside = grid.at(beside);
                dense += usize::from(scan.data[beside] >= LUNG_HU);
                of_body += usize::from(body.data[beside] > 0);
            }
        }
    }
    2 * of_body > dense
}

/// The mask, sampled at the voxels of `like`.
pub fn on_grid<T>(mask: &Volume<u8>, like: &Volume<T>) -> Volume<u8> {
    let to_index = mask.grid.index_from_place();
    let data = (0..like.grid.count()).map(|at| mask.nearest(to_index(like.grid.centre(at))).unwrap_or(0)).collect();
    Volume { grid: like.grid, data }
}

/// Volume of a mask in litres.
pub fn litres(mask: &Volume<u8>) -> f64 {
    mask.data.iter().filter(|v| **v > 0).count() as f64 * mask.grid.voxel_mm3() * 1e-6
}

/// Volume at expiration over that at inspiration, of lungs of so many litres. Refuses a pair whose first lungs are not the
/// fuller ones, or that cannot be of one patient.
pub fn check_pair(full: f64, empty: f64) -> Result<f64> {
    let ratio = empty / full;
    let sentence = |what: &str| {
        Err(Error::input(format!(
            "the lungs hold {full:.2} l in the first scan and {empty:.2} l in the second: {what}"
        )))
    };
    if ratio > 1.02 {
        return sentence("the inspiration comes first: exchange the two");
    }
    if ratio < 0.25 {
        return sentence("they are not of one patient, or one of them shows a part of the chest");
    }
    Ok(ratio)
}

/// Refuses a pair whose lungs lie so far apart that no breath is the reason: a registration would look for minutes and not
/// find them.
pub fn check_place(full: &Volume<u8>, empty: &Volume<u8>) -> Result<()> {
    let away = between_middles(full, empty);
    if away.length() <= MIDDLE_MOVES_MM {
        return Ok(());
    }
    Err(Error::input(format!(
        "the lungs lie {:.0} mm from those of the first scan ({:.0} {:.0} {:.0}: left, back, head), and breathing moves \
         their middle by {MIDDLE_MOVES_MM} mm at most: the patient or the table was moved between the scans, or one of the \
         headers does not say where its scan lies; --unusual takes them as they are",
        away.length(),
        away.x,
        away.y,
        away.z
    )))
}

/// From the middle of the full lungs to that of the empty ones. Where a scan ends within the lungs, over the heights that
/// both scans show, if there are any.
fn between_middles(full: &Volume<u8>, empty: &Volume<u8>) -> DVec3 {
    let all = [f64::NEG_INFINITY, f64::INFINITY];
    let [a, b] = [full, empty].map(heights_mm);
    let shown = if is_cut(full) || is_cut(empty) { [a[0].max(b[0]), a[1].min(b[1])] } else { all };
    let way = |heights| Some(middle(empty, heights)? - middle(full, heights)?);
    way(shown).or_else(|| way(all)).unwrap_or_default()
}

/// Whether a mask reaches the first or the last slice.
fn is_cut(mask: &Volume<u8>) -> bool {
    let slice = mask.grid.size[0] * mask.grid.size[1];
    let of = |part: &[u8]| part.iter().any(|v| *v > 0);
    of(&mask.data[..slice]) || of(&mask.data[mask.data.len() - slice..])
}

/// The lowest and the highest place of a grid.
fn heights_mm(volume: &Volume<u8>) -> [f64; 2] {
    let last = volume.grid.size.map(|n| n.saturating_sub(1));
    let corner = |k: usize| std::array::from_fn(|axis| if k >> axis & 1 == 1 { last[axis] } else { 0 });
    let heights = (0..8).map(|k| volume.grid.centre(volume.grid.at(corner(k))).z);
    heights.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], z| [low.min(z), high.max(z)])
}

/// The middle of what a mask marks at these heights.
fn middle(mask: &Volume<u8>, [low, high]: [f64; 2]) -> Option<DVec3> {
    let places = (0..mask.data.len()).filter(|&at| mask.data[at] > 0).map(|at| mask.grid.centre(at));
    let shown = places.filter(|place| (low..=high).contains(&place.z));
    let (sum, count) = shown.fold((DVec3::ZERO, 0), |(sum, count), place| (sum + place, count + 1));
    (count > 0).then(|| sum / f64::from(count))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::VoxelGrid;

    #[test]
    fn lungs_are_found_closed_over_vessels_and_the_pair_is_in_order() {
        let grid = VoxelGrid::upright([90, 70, 60], DVec3::new(-180.0, -140.0, -120.0), DVec3::splat(4.0));
        let chest = |radius: f64| {
            let value = |p: DVec3| {
                let lung = (p - DVec3::new(p.x.signum() * 70.0, 0.0, 0.0)) / DVec3::new(1.0, 1.3, 1.5);
                let vessel = (p.y.abs() < 3.0 && p.z.abs() < 3.0) as i16;
                match () {
                    _ if (p.truncate() / glam::DVec2::new(165.0, 125.0)).length() > 1.0 => -1000,
                    _ if lung.length() < radius => -830 + vessel * 870,
                    _ => 40,
                }
            };
            Volume { grid, data: (0..grid.count()).map(|at| value(grid.centre(at))).collect::<Vec<i16>>() }
        };
        let (full, empty) = (find_lungs(&chest(55.0), None).unwrap(), find_lungs(&chest(48.0), None).unwrap());
        let truth = |r: f64| 2.0 * 4.18879 * r.powi(3) * 1.3 * 1.5 * 1e-6;
        assert!((litres(&full) / truth(55.0) - 1.0).abs() < 0.08, "{} {}", litres(&full), truth(55.0));
        let ratio = check_pair(litres(&full), litres(&empty)).unwrap();
        assert!((ratio - (48f64 / 55.0).powi(3)).abs() < 0.05, "{ratio}");
        assert!(check_pair(litres(&empty), litres(&full)).unwrap_err().to_string().contains("exchange the two"));
        // On a table that was moved.
        check_place(&full, &empty).unwrap();
        let mut moved = empty.clone();
        moved.grid.origin_mm += DVec3::new(0.0, 8.0, -100.0);
        let said = check_place(&full, &moved).unwrap_err().to_string();
        assert!(said.contains("lie 100 mm from") && said.contains("0 8 -100: left, back, head"), "{said}");
        // A scan that ends in the middle of the chest shows the same lungs.
        let upper = |whole: &Volume<u8>| {
            let (mut grid, from) = (whole.grid, whole.grid.at([0, 0, 30]));
            grid.origin_mm.z += 30.0 * 4.0;
            grid.size[2] = 30;
            Volume { grid, data: whole.data[from..].to_vec() }
        };
        let away = between_middles(&full, &upper(&empty));
        assert!(away.length() < 10.0 && between_middles(&upper(&full), &empty).length() < 10.0, "{away}");
        assert!(check_place(&upper(&full), &upper(&moved)).is_err());
        // A table below the back, a mattress between the two: foam in a shell that is closed at its ends.
        let mut table = chest(55.0);
        for at in 0..table.data.len() {
            let place = grid.centre(at);
            let ends = (place.x / 150.0).abs().max(((place.z + 2.0) / 100.0).abs());
            table.data[at] = match place.y {
                y if y < 122.0 => continue,
                y if y < 126.0 || ends > 1.0 => -1000,
                y if (130.0..134.0).contains(&y) && ends < 0.95 => -900,
                _ => -100,
            };
        }
        assert!(table.data.iter().filter(|hu| **hu == -900).count() as f64 * grid.voxel_mm3() > 1e3 * LEAST_LUNG_ML);
        assert_eq!(find_lungs(&table, None).unwrap().data, full.data);
        let mut tissue = chest(55.0);
        tissue.data.iter_mut().for_each(|v| *v = (*v).max(0));
        assert!(find_lungs(&tissue, None).unwrap_err().to_string().contains("--lung-masks"));
    }
}
