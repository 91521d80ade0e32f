//! From a case to two scans and back: what an import loses, measured where the truth is known.
//!
//! A case is scanned (`ct::simulated`), the scans are imported as those of a patient (`ct::scan_pair`), once with the
//! true mask of the airway and once with none, and what comes out is held against the case. Measured:
//!
//! - distance of the true wall from the imported one, by generation of the true airway;
//! - branches: found when the imported centreline runs along them; extra when it runs where no airway is;
//! - distance of the true centreline from the imported one, along the branches that were found;
//! - registration: how far a true vertex, or a fork of vessels, carried by the registered field lands from its place.
//!
//! [`masks`] measures with the same ruler how far several people's masks of one airway differ.

pub mod compare;
pub mod masks;
pub mod result;
pub mod tables;

use std::path::{Path, PathBuf};

use glam::DVec3;

use self::compare::{TrueAirway, compared, failed};
use self::result::{AirwayWay, LoopResult};
use crate::airway::build;
use crate::airway::case::Case;
use crate::airway::case_build::mended_pair;
use crate::airway::centerline::CenterlineSettings;
use crate::airway::centerline_extract::extract;
use crate::airway::import_check::ExpectedAnatomy;
use crate::airway::nearest_points::NearestPoints;
use crate::airway::remesh::remesh;
use crate::base::{Error, ErrorKind, Progress, Result, TriangleMesh, Volume, files, hash, revision};
use crate::ct::lumen::{DistanceSpread, LumenSurface};
use crate::ct::motion_field::carried;
use crate::ct::registration::{demand_elastix, elastix_version};
use crate::ct::scan::read_checked;
use crate::ct::scan_pair::{Facts, ScanRequest, airway_of, import_pair, surface_of};
use crate::ct::simulated::airway_wall::signed_lumen;
use crate::ct::simulated::chest::SimulatedChest;
use crate::ct::simulated::protocol::ScanProtocol;
use crate::ct::simulated::scan_truth::{AIRWAYS, LANDMARKS, RECORD, SCANS, write_pair};
use crate::formats::{landmarks, mesh};

/// Edge length of small surfaces over the radius, and its bounds in mm.
const SMALL_EDGE: (f64, f64, f64) = (0.6, 1.3, 3.2);
const SMALL_ROUNDS: usize = 4;
/// The result of one case.
const RESULT: &str = "ct-loop.json";
/// How the name of the folder of its scans begins; digits of its key follow.
const SCANS_FOLDER: &str = "scans-";

/// What is done, besides measuring.
pub struct LoopSettings {
    /// How the scanner is set.
    pub protocol: ScanProtocol,
    /// Folder of all.
    pub out: PathBuf,
    /// Whether scans stay on disk.
    pub keep_scans: bool,
}

/// An imported airway with fewer faces, in both states, as the clinical track hands it out: the grown one, which lacks
/// what growing did not reach.
fn small_pair(surface: &LumenSurface, field: &Volume<[f32; 3]>) -> Result<[TriangleMesh; 2]> {
    let lumen = signed_lumen(&surface.mesh)?;
    let line = extract(&surface.mesh, &CenterlineSettings::default())?;
    let points = NearestPoints::new(&line.points.iter().map(|p| p.position_mm).collect::<Vec<_>>())?;
    let (share, least, most) = SMALL_EDGE;
    let edge = |place: DVec3| (share * line.points[points.nearest(place).0].radius_mm).clamp(least, most);
    let rest = remesh(&surface.mesh, SMALL_ROUNDS, edge, |place| lumen.project(place));
    rest.validate_closed()?;
    let (moved, _) = mended_pair(&rest, carried(field, &rest.vertices))?;
    let expiration = TriangleMesh { vertices: moved, faces: rest.faces.clone() };
    Ok([rest, expiration])
}

/// What a result depends on: the case with all its files, the protocol, and the code that scans, imports, registers and
/// compares.
fn key_of(case: &Case, protocol: ScanProtocol) -> Result<String> {
    let code = revision::of_rooms(&["outside", "base", "formats", "airway", "ct", "experiments"]);
    hash::of_value(&("ct-loop", case.hash()?, protocol.name(), code, elastix_version()))
}

/// The result that is there, where it has that key.
fn kept(result: &Path, key: &str) -> Result<Option<LoopResult>> {
    if !result.exists() {
        return Ok(None);
    }
    let found = LoopResult::read(result)?;
    Ok((found.key == key).then_some(found))
}

/// Scans, imports and compares one case. A result that is there already is read where it was made from the same case,
/// protocol and code; so are scans. Works in `OUT/PROTOCOL/CASE`.
///
/// Errors: what the import says of the scans; elastix missing.
pub fn measure(case: &Case, settings: &LoopSettings, progress: &dyn Progress) -> Result<LoopResult> {
    let folder = settings.out.join(settings.protocol.name()).join(&case.id);
    let (result, key) = (folder.join(RESULT), key_of(case, settings.protocol)?);
    if let Some(found) = kept(&result, &key)? {
        return Ok(found);
    }
    // Before the scans, which take a minute.
    demand_elastix()?;
    let leave = |folder: &Path| std::fs::remove_dir_all(folder).map_err(|e| Error::io("removing", folder, e));
    // The key stands in the name, so that a run that was stopped goes on with its own scans and no others.
    let scans = folder.join(format!("{SCANS_FOLDER}{}", &key[..12]));
    if folder.is_dir() {
        for other in files::folders_in(&folder)?.iter().filter(|other| **other != scans) {
            let name = other.file_name().unwrap_or_default().to_string_lossy();
            if name.starts_with(SCANS_FOLDER) {
                leave(other)?;
            }
        }
    }
    if !scans.join(RECORD).exists() {
        write_pair(&SimulatedChest::new(case)?, settings.protocol, scans.clone(), progress)?;
    }
    let work = folder.join("work");
    let mut found = imported(case, settings.protocol, &scans, &work, &folder, progress)?;
    found.key = key;
    files::write_json(&result, &found)?;
    leave(&work)?;
    if !settings.keep_scans {
        leave(&scans)?;
    }
    Ok(found)
}

fn imported(
    case: &Case,
    protocol: ScanProtocol,
    scans: &Path,
    work: &Path,
    folder: &Path,
    progress: &dyn Progress,
) -> Result<LoopResult> {
    let [inspiration, expiration] = SCANS.map(|name| scans.join(name));
    let mask = scans.join(AIRWAYS[0]);
    let request = ScanRequest {
        inspiration: &inspiration,
        expiration: Some(&expiration),
        airway: Some(&mask),
        airway_expiration: None,
        label: None,
        lungs: [None; 2],
        field: None,
        way_back: false,
        anatomy: ExpectedAnatomy::Human,
    };
    let pair = import_pair(&request, work, progress)?;
    let scan = read_checked(&inspiration, progress)?;
    let anatomy = build(case).map_err(|e| case.blamed(e))?;
    let truth = TrueAirway::new(anatomy, scan.grid.bounds_mm().1.z)?;
    let moved = |rest: &TriangleMesh| Ok(mended_pair(rest, carried(&pair.field, &rest.vertices))?.0);
    let given = compared(AirwayWay::Mask, &truth, &pair.surface.mesh, moved(&pair.surface.mesh)?)?;
    let mut facts = Facts::new();
    let mut grow = || -> Result<_> {
        let airway = airway_of(None, None, Some(&scan), ExpectedAnatomy::Human, &mut facts, progress)?;
        let surface = surface_of(&airway, &mut facts)?;
        let result = compared(AirwayWay::Grown, &truth, &surface.mesh, moved(&surface.mesh)?)?;
        Ok((result, surface))
    };
    let (grown, surface) = match grow() {
        Err(error) if error.kind() == ErrorKind::Interrupted => return Err(error),
        Ok((grown, surface)) => (grown, surface),
        // A network would have found it: the true mask stands for one.
        Err(error) => (failed(AirwayWay::Grown, &error), pair.surface),
    };
    for (name, part) in ["inspiration.ply", "expiration.ply"].iter().zip(small_pair(&surface, &pair.field)?) {
        mesh::write_small_ply(&folder.join(name), &part, &["space LPS", "normals point into the lumen"])?;
    }
    let misses = |from: &[DVec3], to: &[DVec3]| -> Vec<f64> {
        carried(&pair.field, from).iter().zip(to).map(|(a, b)| a.distance(*b)).collect()
    };
    let wall = truth.walls();
    let forks = landmarks::read(&scans.join(LANDMARKS))?;
    let from: Vec<DVec3> = forks.iter().map(|f| f.inspiration_mm).collect();
    let to: Vec<DVec3> = forks.iter().map(|f| f.expiration_mm).collect();
    let tissue = misses(&from, &to);
    Ok(LoopResult {
        key: String::new(),
        case_id: case.id.clone(),
        protocol: protocol.name().to_owned(),
        ways: vec![given, grown],
        motion: DistanceSpread::of(wall[0].iter().zip(&wall[1]).map(|(a, b)| a.distance(*b)).collect()),
        airway_error: DistanceSpread::of(misses(&wall[0], &wall[1])),
        tissue_error_mean_mm: tissue.iter().sum::<f64>() / tissue.len().max(1) as f64,
        tissue_error: DistanceSpread::of(tissue),
        folded: pair.change.folded,
        voxels: pair.change.voxels,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::shipped::ROOT;

    #[test]
    fn a_result_of_another_case_or_protocol_is_not_taken() {
        let case = Case::load(&Path::new(ROOT).join("case1.toml")).unwrap();
        let key = |case: &Case, protocol| key_of(case, protocol).unwrap();
        let mut edited = case.clone();
        edited.seed += 1;
        let thin = key(&case, ScanProtocol::Thin);
        assert!(thin != key(&edited, ScanProtocol::Thin) && thin != key(&case, ScanProtocol::Thick));

        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join(RESULT);
        assert_eq!(kept(&file, &thin).unwrap(), None);
        let found = LoopResult { key: thin.clone(), case_id: "case1".into(), ..LoopResult::default() };
        files::write_json(&file, &found).unwrap();
        assert_eq!(kept(&file, &thin).unwrap(), Some(found));
        assert_eq!(kept(&file, &key(&edited, ScanProtocol::Thin)).unwrap(), None);
        files::write_bytes(&file, b"{").unwrap();
        assert_eq!(kept(&file, &thin).unwrap_err().kind(), ErrorKind::InputOutput);
    }
}
