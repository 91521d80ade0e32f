//! What is true of a simulated pair of scans, as files beside them.
//!
//! ```text
//! inspiration.nii.gz, expiration.nii.gz     the scans, HU
//! airway-*.nii.gz                           label 1: lumen, the trachea up to the top of the scan
//! lobes-*.nii.gz                            1 right upper, 2 right middle and lower, 3 left upper, 4 left lower
//! inspiration.ply, expiration.ply           the airway's surface, the same faces
//! centerline.csv                            centreline with generations at inspiration
//! field.nii.gz                              displacement from inspiration to expiration, LPS, mm; 0 in the chest wall
//! landmarks.csv                             forks of vessels: inspiration and expiration, LPS, mm
//! scan.json                                 how the scanner was set
//! ```

use std::path::PathBuf;

use glam::DVec3;
use rayon::prelude::*;

use super::chest::{BreathState, ChestState, SimulatedChest};
use super::protocol::ScanProtocol;
use super::scanner::{NoiseSeed, scan};
use crate::airway::case_centerline;
use crate::base::{Error, Progress, Result, Staging, Volume, VoxelGrid, files};
use crate::ct::motion_field::sampled_field;
use crate::formats::landmarks::LandmarkPair;
use crate::formats::{mesh, nifti};

/// Files of a pair, in the order in which they appear.
const FILES: [&str; 12] = [
    AIRWAYS[0],
    AIRWAYS[1],
    "lobes-inspiration.nii.gz",
    "lobes-expiration.nii.gz",
    "inspiration.ply",
    "expiration.ply",
    "centerline.csv",
    FIELD,
    LANDMARKS,
    SCANS[0],
    SCANS[1],
    RECORD,
];
/// The scans, inspiration first.
pub const SCANS: [&str; 2] = ["inspiration.nii.gz", "expiration.nii.gz"];
/// The label maps of the airway.
pub const AIRWAYS: [&str; 2] = ["airway-inspiration.nii.gz", "airway-expiration.nii.gz"];
const FIELD: &str = "field.nii.gz";
/// The landmarks.
pub const LANDMARKS: &str = "landmarks.csv";
/// Written last: a folder that has it is whole.
pub const RECORD: &str = "scan.json";
/// Spacing of the field's voxels in mm.
const FIELD_MM: f64 = 3.0;
/// Landmarks, and their least distance from each other in mm: as many as DIR-Lab has.
const LANDMARK_COUNT: usize = 300;
const LANDMARK_SPACING_MM: f64 = 7.0;
/// Least distance in mm of a landmark from the airway's wall.
const FROM_WALL_MM: f64 = 1.0;

/// Forks of vessels in both states, spread over the lungs, a little away from the airway.
pub fn landmarks(chest: &SimulatedChest, expiration: &ChestState<'_>) -> Vec<LandmarkPair> {
    let pair = |&x: &DVec3| LandmarkPair { inspiration_mm: x, expiration_mm: expiration.map.forward(x) };
    let all: Vec<LandmarkPair> = chest.vessels.forks_mm.par_iter().map(pair).collect();
    let mut chosen: Vec<LandmarkPair> = Vec::new();
    // Forks stand in the order of growth, which is random in place.
    for fork in all {
        let is_far = |other: &LandmarkPair| other.inspiration_mm.distance(fork.inspiration_mm) >= LANDMARK_SPACING_MM;
        let (lumen_mm, thickness_mm) = expiration.airway(fork.expiration_mm);
        let is_clear = lumen_mm > thickness_mm + FROM_WALL_MM;
        if chosen.len() < LANDMARK_COUNT && is_clear && chosen.iter().all(is_far) {
            chosen.push(fork);
        }
    }
    chosen
}

/// The displacement from inspiration to expiration on voxels of 3 mm; none in the chest wall.
pub fn truth_field(chest: &SimulatedChest, expiration: &ChestState<'_>, over: &VoxelGrid) -> Volume<[f32; 3]> {
    let (low, high) = over.bounds_mm();
    let size = ((high - low) / FIELD_MM).to_array().map(|n| n.ceil() as usize + 1);
    let grid = VoxelGrid::upright(size, low, DVec3::splat(FIELD_MM));
    sampled_field(grid, |x| if chest.thorax.is_wall(x) { DVec3::ZERO } else { expiration.map.forward(x) - x })
}

/// Scans `chest` twice and writes scans and truth into `out`, all or nothing.
///
/// Errors: no memory; the folder cannot be written; the user stopped the work.
pub fn write_pair(chest: &SimulatedChest, protocol: ScanProtocol, out: PathBuf, progress: &dyn Progress) -> Result<()> {
    let staging = Staging::new(&out)?;
    let settings = protocol.settings();
    let grid = chest.grid(&settings);
    grid.validate(8.0)?;
    let mut folded = 0;
    for (number, state) in [BreathState::Inspiration, BreathState::Expiration].into_iter().enumerate() {
        let held = chest.at(state)?;
        let noise = NoiseSeed { seed: chest.seed(), exposure: (2 * (protocol as usize) + number) as u64 };
        let volume = scan(grid, &settings, noise, |y| held.hu(y), progress)?;
        nifti::write(&staging.path(SCANS[number]), &volume)?;
        drop(volume);
        let labels = |value: &(dyn Fn(DVec3) -> u8 + Sync)| Volume {
            grid,
            data: (0..grid.count()).into_par_iter().map(|at| value(grid.centre(at))).collect(),
        };
        nifti::write(&staging.path(AIRWAYS[number]), &labels(&|y| u8::from(held.airway(y).0 < 0.0)))?;
        nifti::write(&staging.path(FILES[2 + number]), &labels(&|y| held.lobe(y)))?;
        if state == BreathState::Expiration {
            nifti::write(&staging.path(FIELD), &truth_field(chest, &held, &grid))?;
            files::write_bytes(&staging.path(LANDMARKS), landmark_text(&landmarks(chest, &held)).as_bytes())?;
            folded = held.folded;
        }
    }
    let comments = ["space LPS", "normals point into the lumen"];
    mesh::write_ply(&staging.path(FILES[4]), &chest.anatomy.inspiration, &comments)?;
    mesh::write_ply(&staging.path(FILES[5]), &chest.anatomy.expiration, &comments)?;
    files::write_bytes(&staging.path(FILES[6]), case_centerline::to_csv(&chest.anatomy.centerline).as_bytes())?;
    let record = serde_json::json!({
        "protocol": protocol.name(),
        "pixel_mm": settings.pixel_mm,
        "slice_mm": settings.slice_mm,
        "thickness_mm": settings.thickness_mm,
        "point_spread_mm": settings.point_spread_mm,
        "noise_hu": settings.noise_hu,
        "voxels": grid.size,
        "seed": chest.seed(),
        "nodes_without_motion": folded,
    });
    let text = serde_json::to_string_pretty(&record).map_err(|e| Error::input(format!("cannot be written: {e}")))?;
    files::write_bytes(&staging.path(RECORD), text.as_bytes())?;
    staging.publish(&FILES.map(PathBuf::from))
}

fn landmark_text(pairs: &[LandmarkPair]) -> String {
    let mut text = "insp_x,insp_y,insp_z,exp_x,exp_y,exp_z\n".to_owned();
    for pair in pairs {
        let (a, b) = (pair.inspiration_mm, pair.expiration_mm);
        text += &format!("{:.4},{:.4},{:.4},{:.4},{:.4},{:.4}\n", a.x, a.y, a.z, b.x, b.y, b.z);
    }
    text
}
