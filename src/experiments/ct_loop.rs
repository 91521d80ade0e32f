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
//! The wall within 1.5 radii of the trachea's inlet is left out: the scan shows a trachea that goes on.

use std::path::{Path, PathBuf};

use glam::DVec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::airway::case::Case;
use crate::airway::case_build::mended_pair;
use crate::airway::centerline::{Centerline, CenterlineSettings};
use crate::airway::centerline_distance::SurfaceDistance;
use crate::airway::centerline_extract::extract;
use crate::airway::remesh::remesh;
use crate::airway::{Anatomy, build};
use crate::base::{Error, ErrorKind, Progress, Result, TriangleMesh, Volume, files};
use crate::ct::lumen::{DistanceSpread, LumenSurface};
use crate::ct::motion_field::carried;
use crate::ct::scan::read_checked;
use crate::ct::scan_pair::{Facts, ScanRequest, airway_of, import_pair, surface_of};
use crate::ct::simulated::airway_wall::{NearestPoints, signed_lumen};
use crate::ct::simulated::chest::SimulatedChest;
use crate::ct::simulated::protocol::ScanProtocol;
use crate::ct::simulated::scan_truth::{AIRWAYS, LANDMARKS, RECORD, SCANS, write_pair};
use crate::formats::{landmarks, mesh};

/// Generations that are told apart; the last stands for all beyond.
const GENERATIONS: u32 = 6;
/// Radii of the inlet that are left out.
const INLET_RADII: f64 = 1.5;
/// A branch is found when this part of it, its start left out, has an imported centreline within a radius and at least
/// this many mm.
const FOUND_SHARE: f64 = 0.6;
const FOUND_MM: f64 = 1.2;
/// Part of a branch that counts as its start: it lies in its parent's lumen.
const START_SHARE: f64 = 0.3;
/// An imported branch is extra when half of it is farther than this many radii and mm from the true centreline.
const EXTRA: (f64, f64) = (1.5, 1.0);
/// Edge length of small surfaces over the radius, and its bounds in mm.
const SMALL_EDGE: (f64, f64, f64) = (0.6, 1.3, 3.2);
const SMALL_ROUNDS: usize = 4;
/// The result of one case.
const RESULT: &str = "ct-loop.json";

/// How the imported airway was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum AirwayWay {
    /// From the true label map, as a perfect network would give it.
    Mask,
    /// By region growing.
    Grown,
}

impl AirwayWay {
    /// In tables.
    pub fn name(self) -> &'static str {
        match self {
            AirwayWay::Mask => "true mask",
            AirwayWay::Grown => "region growing",
        }
    }
}

/// One generation of the true airway.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct GenerationLoss {
    /// 0 trachea; the last stands for all beyond.
    pub generation: u32,
    /// Branches there are, and those found.
    pub branches: usize,
    /// Branches found.
    pub found: usize,
    /// Distance of the wall of the found ones from the imported wall, mm.
    pub wall: DistanceSpread,
}

/// What one way of finding the airway gave.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct WayResult {
    /// Which.
    pub way: AirwayWay,
    /// Why there is nothing, where there is nothing.
    pub failure: Option<String>,
    /// By generation.
    pub generations: Vec<GenerationLoss>,
    /// Distance of the wall of all found branches from the imported wall, mm.
    pub wall: DistanceSpread,
    /// The same for generations 0 to 3.
    pub wall_to_3: DistanceSpread,
    /// Distance of the imported wall from the true one, mm.
    pub imported_wall: DistanceSpread,
    /// Imported branches that are none.
    pub extra_branches: usize,
    /// Distance of the true centreline from the imported one along found branches, mm.
    pub centerline: DistanceSpread,
    /// Distance of the wall of found branches at expiration from the imported one, mm.
    pub wall_expiration: DistanceSpread,
}

/// One case under one protocol.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LoopResult {
    /// Case.
    pub case_id: String,
    /// Protocol, by name.
    pub protocol: String,
    /// With the true mask, and grown.
    pub ways: Vec<WayResult>,
    /// Motion of the true airway, mm.
    pub motion: DistanceSpread,
    /// Error of the registered field at the true vertices of the airway, mm.
    pub airway_error: DistanceSpread,
    /// Error at forks of vessels, mm, and its mean.
    pub tissue_error: DistanceSpread,
    /// Mean error at forks of vessels, mm.
    pub tissue_error_mean_mm: f64,
    /// Voxels in the lungs that fold, of how many.
    pub folded: usize,
    /// Voxels in the lungs.
    pub voxels: usize,
}

/// What is done, besides measuring.
pub struct LoopSettings {
    /// How the scanner is set.
    pub protocol: ScanProtocol,
    /// Folder of all.
    pub out: PathBuf,
    /// Whether scans stay on disk.
    pub keep_scans: bool,
}

/// The true airway, ready to be compared with.
struct TrueAirway {
    anatomy: Anatomy,
    /// Vertices that are compared, and the branch and generation of each.
    vertices: Vec<usize>,
    branch_of: Vec<u32>,
    generation_of: Vec<u32>,
}

impl TrueAirway {
    fn new(anatomy: Anatomy, highest_mm: f64) -> Result<TrueAirway> {
        let line = &anatomy.centerline.points;
        let points = NearestPoints::new(&line.iter().map(|p| p.position_mm).collect::<Vec<_>>())?;
        let inlet = line.first().ok_or_else(|| Error::input("the centreline has no points"))?;
        let widest = line.iter().take(20).map(|p| p.radius_mm).fold(0.0, f64::max);
        let rim = INLET_RADII * widest;
        let is_compared = |v: &DVec3| v.distance(inlet.position_mm) > rim && v.z < highest_mm;
        let compared = anatomy.inspiration.vertices.iter().enumerate().filter(|(_, v)| is_compared(v));
        let vertices: Vec<usize> = compared.map(|(k, _)| k).collect();
        let nearest = |&v: &usize| points.nearest(anatomy.inspiration.vertices[v]).0;
        let feet: Vec<usize> = vertices.par_iter().map(nearest).collect();
        let branch_of = feet.iter().map(|&p| line[p].branch).collect();
        let generation_of = feet.iter().map(|&p| line[p].generation.min(GENERATIONS - 1)).collect();
        Ok(TrueAirway { anatomy, vertices, branch_of, generation_of })
    }

    fn at(&self, vertices: &[DVec3]) -> Vec<DVec3> {
        self.vertices.iter().map(|&v| vertices[v]).collect()
    }
}

/// Distances to the polyline of a centreline.
struct LineDistance<'a> {
    line: &'a Centerline,
}

impl LineDistance<'_> {
    /// The least distance in mm of a place, and the radius there.
    fn nearest(&self, place: DVec3) -> (f64, f64) {
        let points = &self.line.points;
        let mut best = (f64::INFINITY, 0.0);
        for point in points {
            let Some(parent) = point.parent.map(|p| &points[p as usize]) else { continue };
            let (a, b) = (parent.position_mm, point.position_mm);
            let length2 = (b - a).length_squared();
            let t = if length2 > 0.0 { ((place - a).dot(b - a) / length2).clamp(0.0, 1.0) } else { 0.0 };
            let distance = place.distance(a.lerp(b, t));
            if distance < best.0 {
                best = (distance, parent.radius_mm + (point.radius_mm - parent.radius_mm) * t);
            }
        }
        best
    }
}

/// The points of each branch, in order.
fn branches(line: &Centerline) -> Vec<Vec<usize>> {
    let count = line.points.iter().map(|p| p.branch).max().map_or(0, |b| b as usize + 1);
    let mut of_branch = vec![Vec::new(); count];
    line.points.iter().enumerate().for_each(|(k, p)| of_branch[p.branch as usize].push(k));
    of_branch
}

/// Whether each true branch was found, and the distances of the found ones' points from the imported centreline.
fn found_branches(truth: &Centerline, imported: &Centerline) -> (Vec<bool>, Vec<f64>) {
    let to_imported = LineDistance { line: imported };
    let (mut is_found, mut distances) = (Vec::new(), Vec::new());
    for branch in branches(truth) {
        let body = &branch[(branch.len() as f64 * START_SHARE) as usize..];
        let off: Vec<f64> = body.par_iter().map(|&k| to_imported.nearest(truth.points[k].position_mm).0).collect();
        let near = |&(&k, &off): &(&usize, &f64)| off < truth.points[k].radius_mm.max(FOUND_MM);
        let count = body.iter().zip(&off).filter(near).count();
        let found = !body.is_empty() && count as f64 >= FOUND_SHARE * body.len() as f64;
        is_found.push(found);
        if found {
            distances.extend(body.iter().zip(&off).filter(near).map(|(_, off)| *off));
        }
    }
    (is_found, distances)
}

/// Imported branches that run where no true airway is, below `highest_mm`.
fn extra_branches(truth: &Centerline, imported: &Centerline, highest_mm: f64) -> usize {
    let to_truth = LineDistance { line: truth };
    let is_off = |&k: &usize| {
        let (distance, radius) = to_truth.nearest(imported.points[k].position_mm);
        distance > (EXTRA.0 * radius).max(EXTRA.1)
    };
    let is_extra = |branch: &Vec<usize>| {
        let low: Vec<usize> =
            branch.iter().copied().filter(|&k| imported.points[k].position_mm.z < highest_mm).collect();
        !low.is_empty() && 2 * low.par_iter().filter(|k| is_off(k)).count() > low.len()
    };
    branches(imported).iter().filter(|branch| is_extra(branch)).count()
}

/// Holds an imported airway against the truth. `moved` are its vertices at expiration.
fn compared(way: AirwayWay, truth: &TrueAirway, rest: &TriangleMesh, moved: Vec<DVec3>) -> Result<WayResult> {
    let line = extract(rest, &CenterlineSettings::default())?;
    let true_line = &truth.anatomy.centerline;
    let (is_found, off_line) = found_branches(true_line, &line);
    let (surface, true_surface) = (SurfaceDistance::new(rest), SurfaceDistance::new(&truth.anatomy.inspiration));
    let other = TriangleMesh { vertices: moved, faces: rest.faces.clone() };
    let surface_expiration = SurfaceDistance::new(&other);
    let off = |surface: &SurfaceDistance, places: Vec<DVec3>| -> Vec<f64> {
        places.par_iter().map(|p| surface.distance(*p)).collect()
    };
    let wall = off(&surface, truth.at(&truth.anatomy.inspiration.vertices));
    let wall_expiration = off(&surface_expiration, truth.at(&truth.anatomy.expiration.vertices));
    let of_found = |distances: &[f64], wanted: &dyn Fn(u32) -> bool| {
        let chosen = (0..distances.len())
            .filter(|&k| is_found[truth.branch_of[k] as usize] && wanted(truth.generation_of[k]))
            .map(|k| distances[k]);
        DistanceSpread::of(chosen.collect())
    };
    let of_generation = |generation: u32| {
        let members: Vec<usize> = branches(true_line)
            .iter()
            .enumerate()
            .filter(|(_, points)| {
                points.first().is_some_and(|&k| true_line.points[k].generation.min(GENERATIONS - 1) == generation)
            })
            .map(|(branch, _)| branch)
            .collect();
        GenerationLoss {
            generation,
            branches: members.len(),
            found: members.iter().filter(|&&b| is_found[b]).count(),
            wall: of_found(&wall, &|g| g == generation),
        }
    };
    let inlet = true_line.points[0];
    let highest = inlet.position_mm.z - INLET_RADII * inlet.radius_mm;
    let below: Vec<DVec3> = rest.vertices.iter().copied().filter(|v| v.z < highest).collect();
    Ok(WayResult {
        way,
        failure: None,
        generations: (0..GENERATIONS).map(of_generation).filter(|row| row.branches > 0).collect(),
        wall: of_found(&wall, &|_| true),
        wall_to_3: of_found(&wall, &|g| g <= 3),
        imported_wall: DistanceSpread::of(off(&true_surface, below)),
        extra_branches: extra_branches(true_line, &line, highest),
        centerline: DistanceSpread::of(off_line),
        wall_expiration: of_found(&wall_expiration, &|_| true),
    })
}

/// A row that says why there is none.
fn failed(way: AirwayWay, error: &Error) -> WayResult {
    let none = DistanceSpread::of(Vec::new());
    WayResult {
        way,
        failure: Some(error.to_string()),
        generations: Vec::new(),
        wall: none,
        wall_to_3: none,
        imported_wall: none,
        extra_branches: 0,
        centerline: none,
        wall_expiration: none,
    }
}

/// The imported airway with fewer faces, in both states, as a clinical track hands it out.
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

/// Scans, imports and compares one case; a result that is there already is read. Works in `OUT/PROTOCOL/CASE`.
///
/// Errors: what the import says of the scans; elastix missing.
pub fn measure(case: &Case, settings: &LoopSettings, progress: &dyn Progress) -> Result<LoopResult> {
    let folder = settings.out.join(settings.protocol.name()).join(&case.id);
    let result = folder.join(RESULT);
    if result.exists() {
        let text = files::read_text(&result)?;
        return serde_json::from_str(&text).map_err(|e| Error::input(format!("is no result: {e}")).at(&result));
    }
    let scans = folder.join("scans");
    if !scans.join(RECORD).exists() {
        write_pair(&SimulatedChest::new(case)?, settings.protocol, scans.clone(), progress)?;
    }
    let work = folder.join("work");
    let found = imported(case, settings.protocol, &scans, &work, &folder, progress)?;
    let text = serde_json::to_string_pretty(&found).map_err(|e| Error::input(format!("cannot be written: {e}")))?;
    files::write_bytes(&result, text.as_bytes())?;
    let leave = |folder: &Path| std::fs::remove_dir_all(folder).map_err(|e| Error::io("removing", folder, e));
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
        lungs: None,
        field: None,
        way_back: false,
    };
    let pair = import_pair(&request, work, progress)?;
    let scan = read_checked(&inspiration)?;
    let truth = TrueAirway::new(build(case)?, scan.grid.bounds_mm().1.z)?;
    let moved = |rest: &TriangleMesh| Ok(mended_pair(rest, carried(&pair.field, &rest.vertices))?.0);
    let given = compared(AirwayWay::Mask, &truth, &pair.surface.mesh, moved(&pair.surface.mesh)?)?;
    let mut facts = Facts::new();
    let mut grow = || {
        let airway = airway_of(None, None, Some(&scan), &mut facts, progress)?;
        let surface = surface_of(&airway, &mut facts)?;
        compared(AirwayWay::Grown, &truth, &surface.mesh, moved(&surface.mesh)?)
    };
    let grown = match grow() {
        Err(error) if error.kind() == ErrorKind::Interrupted => return Err(error),
        outcome => outcome.unwrap_or_else(|error| failed(AirwayWay::Grown, &error)),
    };
    for (name, part) in ["inspiration.ply", "expiration.ply"].iter().zip(small_pair(&pair.surface, &pair.field)?) {
        mesh::write_small_ply(&folder.join(name), &part, &["space LPS", "normals point into the lumen"])?;
    }
    let misses = |from: &[DVec3], to: &[DVec3]| -> Vec<f64> {
        carried(&pair.field, from).iter().zip(to).map(|(a, b)| a.distance(*b)).collect()
    };
    let wall = [&truth.anatomy.inspiration, &truth.anatomy.expiration].map(|mesh| truth.at(&mesh.vertices));
    let forks = landmarks::read(&scans.join(LANDMARKS))?;
    let from: Vec<DVec3> = forks.iter().map(|f| f.inspiration_mm).collect();
    let to: Vec<DVec3> = forks.iter().map(|f| f.expiration_mm).collect();
    let tissue = misses(&from, &to);
    Ok(LoopResult {
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

/// Columns of the CSV: a row per case, protocol, way and generation; `all` holds what is of the whole case.
pub const COLUMNS: [&str; 16] = [
    "case",
    "protocol",
    "way",
    "generation",
    "branches",
    "found",
    "extra",
    "wall_median_mm",
    "wall_p95_mm",
    "wall_expiration_median_mm",
    "centerline_median_mm",
    "centerline_p95_mm",
    "airway_registration_median_mm",
    "airway_registration_p95_mm",
    "tissue_registration_mean_mm",
    "folded_voxels",
];

/// The rows of [`COLUMNS`].
pub fn records(results: &[LoopResult]) -> Vec<Vec<String>> {
    let number = |value: f64| format!("{value:.4}");
    let mut rows = Vec::new();
    for result in results {
        for way in &result.ways {
            let head = |generation: String| {
                vec![result.case_id.clone(), result.protocol.clone(), way.way.name().to_owned(), generation]
            };
            for row in &way.generations {
                let mut cells = head(row.generation.to_string());
                cells.extend([row.branches.to_string(), row.found.to_string(), String::new()]);
                cells.extend([number(row.wall.median_mm), number(row.wall.p95_mm)]);
                cells.resize(COLUMNS.len(), String::new());
                rows.push(cells);
            }
            let (all, found) = totals(way);
            let mut cells = head("all".to_owned());
            cells.extend([all.to_string(), found.to_string(), way.extra_branches.to_string()]);
            cells.extend(
                [
                    way.wall.median_mm,
                    way.wall.p95_mm,
                    way.wall_expiration.median_mm,
                    way.centerline.median_mm,
                    way.centerline.p95_mm,
                    result.airway_error.median_mm,
                    result.airway_error.p95_mm,
                    result.tissue_error_mean_mm,
                ]
                .map(number),
            );
            cells.push(result.folded.to_string());
            rows.push(cells);
        }
    }
    rows
}

fn totals(way: &WayResult) -> (usize, usize) {
    way.generations.iter().fold((0, 0), |(all, found), row| (all + row.branches, found + row.found))
}

/// Tables for people.
pub fn markdown(results: &[LoopResult]) -> String {
    let mut text = "# From a case to two CTs and back\n\nmm; median / 95th percentile. `wall` is the distance of the \
                    true wall from the imported one, along branches that were found.\n\n## Surface and tree\n\n\
                    | case, protocol, way | branches found / extra | wall, generations 0 to 3 | wall, all found | wall \
                    at expiration | centreline |\n|---|---|---|---|---|---|\n"
        .to_owned();
    let two = |spread: &DistanceSpread| format!("{:.2} / {:.2}", spread.median_mm, spread.p95_mm);
    for result in results {
        for way in &result.ways {
            let name = format!("{}, {}, {}", result.case_id, result.protocol, way.way.name());
            if let Some(failure) = &way.failure {
                text += &format!("| {name} | {failure} | | | | |\n");
                continue;
            }
            let (all, found) = totals(way);
            text += &format!(
                "| {name} | {found} of {all} / {} | {} | {} | {} | {} |\n",
                way.extra_branches,
                two(&way.wall_to_3),
                two(&way.wall),
                two(&way.wall_expiration),
                two(&way.centerline)
            );
        }
    }
    text += "\n## Registration\n\n| case, protocol | motion of the airway | error on the airway | error on forks of vessels \
             | its mean | voxels that fold |\n|---|---|---|---|---|---|\n";
    for result in results {
        text += &format!(
            "| {}, {} | {} | {} | {} | {:.2} | {} of {} |\n",
            result.case_id,
            result.protocol,
            two(&result.motion),
            two(&result.airway_error),
            two(&result.tissue_error),
            result.tissue_error_mean_mm,
            result.folded,
            result.voxels
        );
    }
    text += "\n## By generation\n\n| protocol, way | generation | found | wall, median of cases | worst case |\n\
             |---|---|---|---|---|\n";
    for protocol in ScanProtocol::ALL {
        for way in [AirwayWay::Mask, AirwayWay::Grown] {
            for generation in 0..GENERATIONS {
                text += &generation_line(results, protocol, way, generation).unwrap_or_default();
            }
        }
    }
    text
}

fn generation_line(results: &[LoopResult], protocol: ScanProtocol, way: AirwayWay, generation: u32) -> Option<String> {
    let rows: Vec<&GenerationLoss> = results
        .iter()
        .filter(|result| result.protocol == protocol.name())
        .flat_map(|result| result.ways.iter().filter(|w| w.way == way))
        .flat_map(|w| w.generations.iter().filter(|row| row.generation == generation))
        .collect();
    let mut medians: Vec<f64> = rows.iter().filter(|row| row.found > 0).map(|row| row.wall.median_mm).collect();
    medians.sort_by(f64::total_cmp);
    let branches: usize = rows.iter().map(|row| row.branches).sum();
    if branches == 0 {
        return None;
    }
    let found: usize = rows.iter().map(|row| row.found).sum();
    let last = if generation + 1 == GENERATIONS { " and beyond" } else { "" };
    let walls = match (medians.get(medians.len() / 2), medians.last()) {
        (Some(middle), Some(worst)) => format!("{middle:.2} | {worst:.2}"),
        _ => " | ".to_owned(),
    };
    Some(format!("| {}, {} | {generation}{last} | {found} of {branches} | {walls} |\n", protocol.name(), way.name()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::airway::centerline::CenterlinePoint;

    /// A trachea down to a fork with two branches of 30 mm, of which the second may be missing.
    fn fork(branches: u32) -> Centerline {
        let mut points = Vec::new();
        for branch in 0..=branches {
            let way = [-DVec3::Z, DVec3::new(0.7, 0.0, -0.7), DVec3::new(-0.7, 0.0, -0.7)][branch as usize];
            for k in 0..=30 {
                points.push(CenterlinePoint {
                    position_mm: if branch == 0 { DVec3::ZERO } else { -30.0 * DVec3::Z } + way * f64::from(k),
                    radius_mm: 5.0,
                    branch,
                    generation: branch.min(1),
                    parent: match (branch, k) {
                        (0, 0) => None,
                        (1.., 0) => Some(30),
                        _ => Some(points.len() as u32 - 1),
                    },
                });
            }
        }
        Centerline { points }
    }

    /// A tree without one of its ends has lost one branch, and has an extra one against the tree without it.
    #[test]
    fn a_branch_that_is_missing_is_counted() {
        let (whole, less) = (fork(2), fork(1));
        let (found, off) = found_branches(&whole, &whole);
        assert!(found.iter().all(|f| *f) && off.iter().all(|d| *d < 1e-9));
        let (found, _) = found_branches(&whole, &less);
        assert_eq!(found, [true, true, false]);
        assert_eq!(extra_branches(&less, &whole, 1e9), 1);
        assert_eq!(extra_branches(&whole, &less, 1e9), 0);
    }
}
