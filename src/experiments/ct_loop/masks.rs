//! How far several people's masks of one airway differ, by generation: what a mask may be wrong by in practice.
//!
//! Every mask becomes a surface and a centreline, as an import makes them, and every other one is held against it as an
//! import is held against the truth. Nobody is right here: the generations are those of whoever is the reference.

use std::path::PathBuf;

use super::compare::{ReferenceAirway, distances};
use super::result::{GENERATIONS, GenerationLoss};
use crate::airway::centerline::{Centerline, CenterlineSettings};
use crate::airway::centerline_extract::extract;
use crate::airway::import_check::ExpectedAnatomy;
use crate::base::{Error, Progress, Result, TriangleMesh};
use crate::ct::airway_mask::read_mask;
use crate::ct::lumen::{DistanceSpread, surface_of_mask};

/// Compares each of `masks`, label maps of one airway with one label each, with every other one: branches of all
/// references together, and how many of them the others have; distances in mm of the references' walls from the others',
/// along branches that both have.
///
/// Errors: fewer than two masks; what an import says of one of them.
pub fn differences(masks: &[PathBuf], progress: &dyn Progress) -> Result<Vec<GenerationLoss>> {
    if masks.len() < 2 {
        return Err(Error::usage("one mask differs from nothing: give two or more of one airway"));
    }
    let mut airways: Vec<(TriangleMesh, Centerline)> = Vec::new();
    for (done, path) in masks.iter().enumerate() {
        progress.proceed()?;
        progress.advance(done, masks.len());
        let surface = surface_of_mask(&read_mask(path, None, ExpectedAnatomy::Human)?.mask).map_err(|e| e.at(path))?;
        let line = extract(&surface.mesh, &CenterlineSettings::default()).map_err(|e| e.at(path))?;
        airways.push((surface.mesh, line));
    }
    let mut pooled = vec![(0, 0, Vec::new()); GENERATIONS as usize];
    for (k, (mesh, line)) in airways.iter().enumerate() {
        let reference = ReferenceAirway::new(mesh, line.clone(), f64::INFINITY)?;
        let places = reference.at(&mesh.vertices);
        for (_, (other, other_line)) in airways.iter().enumerate().filter(|(other, _)| *other != k) {
            let (is_found, _) = reference.found_in(other_line);
            let wall = distances(other, &places);
            for (generation, (branches, found, walls)) in pooled.iter_mut().enumerate() {
                let generation = generation as u32;
                let (all, both) = reference.count(generation, &is_found);
                (*branches, *found) = (*branches + all, *found + both);
                walls.extend(reference.of_found(&wall, &is_found, |g| g == generation));
            }
        }
    }
    let row = |(generation, (branches, found, walls)): (usize, (usize, usize, Vec<f64>))| GenerationLoss {
        generation: generation as u32,
        branches,
        found,
        wall: DistanceSpread::of(walls),
    };
    Ok(pooled.into_iter().enumerate().map(row).filter(|row| row.branches > 0).collect())
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::base::{NoProgress, Volume, VoxelGrid};
    use crate::formats::nifti;

    /// A trachea with one or two bronchi, as a label map.
    fn fork(bronchi: &[f64]) -> Volume<u8> {
        let grid = VoxelGrid::upright([90, 24, 110], DVec3::new(-45.0, -12.0, -65.0), DVec3::ONE);
        let tube = |p: DVec3, a: DVec3, b: DVec3, radius: f64| {
            let along = ((p - a).dot(b - a) / (b - a).length_squared()).clamp(0.0, 1.0);
            p.distance(a.lerp(b, along)) < radius
        };
        let is_lumen = |p: DVec3| {
            tube(p, 40.0 * DVec3::Z, DVec3::ZERO, 7.0)
                || bronchi.iter().any(|side| tube(p, DVec3::ZERO, DVec3::new(35.0 * side, 0.0, -45.0), 5.0))
        };
        Volume { grid, data: (0..grid.count()).map(|at| u8::from(is_lumen(grid.centre(at)))).collect() }
    }

    #[test]
    fn a_mask_without_a_branch_lacks_it_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let written = |name: &str, mask: &Volume<u8>| {
            let path = folder.path().join(name);
            nifti::write(&path, mask).unwrap();
            path
        };
        let (whole, less) = (written("a.nii.gz", &fork(&[1.0, -1.0])), written("b.nii.gz", &fork(&[1.0])));
        let same = differences(&[whole.clone(), whole.clone()], &NoProgress).unwrap();
        assert!(same.iter().all(|row| row.found == row.branches && row.wall.most_mm < 1e-9), "{same:?}");
        let rows = differences(&[whole.clone(), less], &NoProgress).unwrap();
        let counts: Vec<[usize; 2]> = rows.iter().map(|row| [row.branches, row.found]).collect();
        // The mask of one bronchus is a single branch, which the whole one has.
        assert_eq!(counts, [[2, 2], [2, 1]]);
        assert!(rows[0].wall.median_mm < 0.3, "{rows:?}");
        assert_eq!(differences(&[whole], &NoProgress).unwrap_err().kind().exit_code(), 2);
    }
}
