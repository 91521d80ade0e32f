//! The airway grown from the scan itself: trachea found, threshold raised until it leaks into the lung.
//!
//! The trachea is a chain of round pieces of air, one over the other, in the upper slices. From its middle a region of
//! voxels below a threshold grows; the threshold rises step by step, and the last one before the region suddenly swells
//! (the wall of a small bronchus gives way, and the lung fills) is taken. After Mori et al. (IEEE Trans Med Imaging
//! 15:507, 1996). It finds three to five generations; a network finds more.

use super::airway_mask::{AirwayMask, cleaned};
use super::parts::{VoxelContact, bounding_box, closed, spread};
use crate::airway::import_check::ExpectedAnatomy;
use crate::base::{Error, Progress, Result, Volume};

/// HU below which air in the trachea lies for sure.
const TRACHEA_HU: i16 = -800;
/// Area in mm^2 of a cross-section of a trachea, and its least filling of its own box.
const TRACHEA_MM2: [f64; 2] = [50.0, 700.0];
const LEAST_FILLING: f64 = 0.55;
/// Longest over shortest side of its box, at most.
const MOST_OBLONG: f64 = 2.2;
/// Least length in mm of the chain.
const LEAST_LENGTH_MM: f64 = 25.0;
/// Thresholds in HU: the first, the step, the last.
const THRESHOLDS_HU: [i16; 3] = [-950, 10, -500];
/// A step leaks when it adds more than this part of the volume and this many ml; and no airway is larger than this.
const LEAK_SHARE: f64 = 0.5;
const LEAK_ML: f64 = 12.0;
const MOST_ML: f64 = 200.0;
/// The ball in voxels that closes gaps of noise.
const CLOSING_VOXELS: f64 = 1.0;

/// A grown airway.
pub struct GrownAirway {
    /// The airway.
    pub airway: AirwayMask,
    /// The threshold in HU that was taken.
    pub threshold_hu: i16,
    /// The one that leaked; `None` when none did.
    pub leaked_at_hu: Option<i16>,
}

/// A round piece of air in a slice.
#[derive(Clone, Copy)]
struct RoundPiece {
    centre: [usize; 2],
    /// How many slices the chain of pieces down to this one is long, and the slice in which it begins.
    chain: usize,
    top: usize,
    /// A voxel of it.
    inside: [usize; 2],
}

/// Grows the airway of `scan`, whose k axis runs to the head.
///
/// Errors: no trachea; a region that leaks at once.
pub fn grow_airway(scan: &Volume<i16>, anatomy: ExpectedAnatomy, progress: &dyn Progress) -> Result<GrownAirway> {
    let (seed, top) = trachea_seed(scan)?;
    let to_ml = scan.grid.voxel_mm3() * 1e-3;
    let mut region = Volume::filled(scan.grid, 0u8);
    // Above the trachea lie glottis and throat: counted as taken, so that nothing grows there, and given back below.
    let throat = scan.grid.at([0, 0, top]) + scan.grid.size[0] * scan.grid.size[1];
    region.data[throat..].fill(1);
    let (mut volume, mut rim) = (0usize, vec![scan.grid.at(seed)]);
    let [first, step, last] = THRESHOLDS_HU;
    let thresholds: Vec<i16> = (first..=last).step_by(step as usize).collect();
    let mut best: Option<(Volume<u8>, i16)> = None;
    let mut leaked_at_hu = None;
    for (done, &threshold) in thresholds.iter().enumerate() {
        progress.proceed()?;
        progress.advance(done, thresholds.len());
        let before = volume as f64 * to_ml;
        let (added, next) = spread(scan, &mut region, rim, VoxelContact::Faces, |hu| hu < threshold);
        (volume, rim) = (volume + added, next);
        let after = volume as f64 * to_ml;
        let is_leak = before > LEAK_ML && after - before > (LEAK_SHARE * before).max(LEAK_ML);
        if is_leak || after > MOST_ML {
            leaked_at_hu = Some(threshold);
            break;
        }
        if volume > 0 {
            best = Some((region.clone(), threshold));
        }
    }
    let (mut region, threshold_hu) = best.ok_or_else(|| {
        Error::input(
            "the airway leaks into the lung at every threshold: give a mask of it with --airway-mask (TotalSegmentator, \
             3D Slicer, or any other program makes one)",
        )
    })?;
    region.data[throat..].fill(0);
    let radius_mm = CLOSING_VOXELS * scan.grid.spacing_mm().max_element();
    let airway = cleaned(closed_near(&region, radius_mm), anatomy)?;
    Ok(GrownAirway { airway, threshold_hu, leaked_at_hu })
}

/// [`closed`], on the part of the volume that the mask takes up.
fn closed_near(mask: &Volume<u8>, radius_mm: f64) -> Volume<u8> {
    let Some((low, high)) = bounding_box(mask) else { return mask.clone() };
    let margin = [0, 1, 2].map(|a| (2.0 * radius_mm / mask.grid.spacing_mm()[a]).ceil() as usize + 2);
    let low = [0, 1, 2].map(|a| low[a].saturating_sub(margin[a]));
    let high = [0, 1, 2].map(|a| (high[a] + margin[a]).min(mask.grid.size[a]));
    closed(&mask.cropped(low, high), radius_mm)
}

/// A voxel in the middle of the trachea, and the highest slice that shows it: the first of an unbroken chain of round
/// pieces, below the glottis where the scan shows a neck.
fn trachea_seed(scan: &Volume<i16>) -> Result<([usize; 3], usize)> {
    let [_, _, slices] = scan.grid.size;
    let thickness = scan.grid.spacing_mm().z;
    let mut above: Vec<RoundPiece> = Vec::new();
    // The longest chain so far: its length and its pieces from the bottom up are found again by walking up.
    let mut best: Option<(usize, [usize; 3], usize)> = None;
    for k in (0..slices).rev() {
        let mut here = round_pieces(scan, k);
        for piece in &mut here {
            let reach = (6.0 / scan.grid.spacing_mm().x).ceil();
            let near = above.iter().filter(|other| {
                let off = [0, 1].map(|a| other.centre[a] as f64 - piece.centre[a] as f64);
                off[0].hypot(off[1]) <= reach
            });
            if let Some(longest) = near.max_by_key(|other| other.chain) {
                (piece.chain, piece.top) = (1 + longest.chain, longest.top);
            }
            if best.is_none_or(|(length, ..)| piece.chain > length) {
                best = Some((piece.chain, [piece.inside[0], piece.inside[1], k], piece.top));
            }
        }
        above = here;
    }
    match best {
        // The chain's lower end still is the trachea: the bronchi below it are two.
        Some((length, seed, top)) if length as f64 * thickness >= LEAST_LENGTH_MM => Ok((seed, top)),
        _ => Err(Error::input(
            "no trachea was found: no round air, 8 to 30 mm wide, over 25 mm of slices; give a mask of the airway with \
             --airway-mask",
        )),
    }
}

/// The pieces of air in slice `k` that may be a cross-section of a trachea.
fn round_pieces(scan: &Volume<i16>, k: usize) -> Vec<RoundPiece> {
    let [nx, ny, _] = scan.grid.size;
    let spacing = scan.grid.spacing_mm();
    let is_air = |i: usize, j: usize| scan.value([i, j, k]) < TRACHEA_HU;
    let mut seen = vec![false; nx * ny];
    let mut pieces = Vec::new();
    for start in 0..nx * ny {
        if seen[start] || !is_air(start % nx, start / nx) {
            continue;
        }
        let (mut open, mut cells) = (vec![start], Vec::new());
        seen[start] = true;
        let mut touches_rim = false;
        while let Some(at) = open.pop() {
            let (i, j) = (at % nx, at / nx);
            cells.push([i, j]);
            if i == 0 || j == 0 || i + 1 == nx || j + 1 == ny {
                touches_rim = true;
                continue;
            }
            for next in [at - 1, at + 1, at - nx, at + nx] {
                if !seen[next] && is_air(next % nx, next / nx) {
                    seen[next] = true;
                    open.push(next);
                }
            }
        }
        let area_mm2 = cells.len() as f64 * spacing.x * spacing.y;
        if touches_rim || !(TRACHEA_MM2[0]..=TRACHEA_MM2[1]).contains(&area_mm2) {
            continue;
        }
        let (mut low, mut high) = ([usize::MAX; 2], [0usize; 2]);
        for cell in &cells {
            for a in 0..2 {
                (low[a], high[a]) = (low[a].min(cell[a]), high[a].max(cell[a] + 1));
            }
        }
        let side = [0, 1].map(|a| (high[a] - low[a]) as f64 * spacing[a]);
        let oblong = side[0].max(side[1]) / side[0].min(side[1]);
        if area_mm2 < LEAST_FILLING * side[0] * side[1] || oblong > MOST_OBLONG {
            continue;
        }
        let centre = [0, 1].map(|a| cells.iter().map(|c| c[a]).sum::<usize>() / cells.len());
        let off = |c: &&[usize; 2]| (0..2).map(|a| c[a].abs_diff(centre[a]).pow(2)).sum::<usize>();
        let inside = *cells.iter().min_by_key(off).unwrap_or(&cells[0]);
        pieces.push(RoundPiece { centre, chain: 1, top: k, inside });
    }
    pieces
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::base::random::{CounterRng, Stage};
    use crate::base::{NoProgress, VoxelGrid};

    /// A chest of tissue with two lungs of parenchyma and a fork of air whose wall is thinner in the right lung.
    fn chest() -> Volume<i16> {
        let grid = VoxelGrid::upright([80, 64, 70], DVec3::new(-80.0, -64.0, -100.0), DVec3::splat(2.0));
        let mut rng = CounterRng::new(3, Stage::Test, &[]);
        let tube = |p: DVec3, a: DVec3, b: DVec3, radius: f64| {
            let along = ((p - a).dot(b - a) / (b - a).length_squared()).clamp(0.0, 1.0);
            p.distance(a.lerp(b, along)) - radius
        };
        let carina = DVec3::new(0.0, 0.0, -20.0);
        let value = |p: DVec3| {
            let airway = tube(p, DVec3::new(0.0, 0.0, 60.0), carina, 8.0)
                .min(tube(p, carina, DVec3::new(35.0, 0.0, -55.0), 6.0))
                .min(tube(p, carina, DVec3::new(-35.0, 0.0, -55.0), 6.0));
            let body = (p.truncate() / glam::DVec2::new(74.0, 58.0)).length();
            if airway < 0.0 {
                -1000.0
            } else if airway < if p.x < -14.0 { 0.6 } else { 2.5 } {
                -300.0
            } else if (p - DVec3::new(p.x.signum() * 40.0, 0.0, -50.0)).length() < 34.0 {
                -830.0
            } else if body < 1.0 {
                40.0
            } else {
                -1000.0
            }
        };
        let data = (0..grid.count()).map(|at| (value(grid.centre(at)) + 15.0 * rng.normal()) as i16).collect();
        Volume { grid, data }
    }

    /// Where a scan shows the neck, the throat above the narrow glottis is no part of the airway.
    #[test]
    fn the_throat_is_left_out() {
        let mut scan = chest();
        let grid = scan.grid;
        for at in 0..grid.count() {
            let p = grid.centre(at);
            let radius = if p.z > 14.0 { 14.0 } else { 3.0 };
            if p.z > 8.0 && p.truncate().length() < 16.0 {
                scan.data[at] = if p.truncate().length() < radius { -990 } else { 40 };
            }
        }
        let found = grow_airway(&scan, ExpectedAnatomy::Human, &NoProgress).unwrap().airway.mask;
        let highest = (0..found.grid.count()).filter(|&at| found.data[at] > 0).map(|at| found.grid.centre(at).z);
        let highest = highest.fold(f64::NEG_INFINITY, f64::max);
        assert!((2.0..=10.0).contains(&highest), "{highest}");
    }

    #[test]
    fn the_fork_is_found_and_the_lung_is_not() {
        let mut scan = chest();
        let found = grow_airway(&scan, ExpectedAnatomy::Human, &NoProgress).unwrap();
        assert!(
            found.leaked_at_hu.is_some() && (-900..=-830).contains(&found.threshold_hu),
            "{:?}",
            found.leaked_at_hu
        );
        let truth = (58.0 * 201.0 + 2.0 * 49.5 * 113.0) * 1e-3;
        assert!((found.airway.volume_ml - truth).abs() < 0.3 * truth, "{} {truth}", found.airway.volume_ml);
        scan.data.iter_mut().for_each(|v| *v = (*v).max(-700));
        assert!(
            grow_airway(&scan, ExpectedAnatomy::Human, &NoProgress).err().unwrap().to_string().contains("no trachea")
        );
    }
}
