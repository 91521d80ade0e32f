//! From a mask on a scan's voxels to a smooth closed surface of genus 0.
//!
//! 1. The signed distance to the mask's boundary is smoothed, and held within half a voxel of what it was (Gibson's
//!    constraint, "Constrained elastic surface nets", MICCAI 1998, on the field instead of the mesh): steps of voxels
//!    and terraces of slices go, and the surface stays where the mask says. The smoothing is Taubin's (SIGGRAPH 1995),
//!    which shrinks no tube.
//! 2. The field is sampled on a finer grid along the body's axes; between slices it is the shape's own interpolation
//!    (Raya and Udupa, IEEE TMI 9:32, 1990).
//! 3. Handles and loose parts go (`topology.rs`).
//! 4. Surface nets and decimation (`isosurface.rs`), and remeshing with edges in proportion to the airway's radius.

use glam::DVec3;
use rayon::prelude::*;

use super::distance::signed_distance;
use super::isosurface::{self, decimated, isosurface};
use super::parts::bounding_box;
use super::topology::{BallReport, keep_ball};
use crate::airway::centerline_distance::SurfaceDistance;
use crate::airway::remesh::remesh;
use crate::airway::surface::smooth;
use crate::airway::surface_field::LumenField;
use crate::base::estimate::demand_memory;
use crate::base::{Error, Result, TriangleMesh, Volume, VoxelGrid};

/// Distances in mm are known this far from the boundary: the radius from which on edges have their greatest length.
const DEPTH_MM: f64 = 6.0;
/// Voxels of free room around the airway.
const MARGIN: usize = 3;
/// Rounds of smoothing, each with both factors of Taubin's filter; and how far, in half voxels, a value may move.
const SMOOTHING_ROUNDS: usize = 12;
const SMOOTHING: [f32; 2] = [0.6, -0.63];
const HELD: f64 = 0.9;
/// Spacing of the finer grid over that of the voxels, and its bounds in mm.
const FINER: f64 = 0.8;
const SPACING_MM: [f64; 2] = [0.45, 0.8];
/// Most nodes of the finer grid; it becomes coarser to stay below.
const MOST_NODES: f64 = 8e7;
/// Bytes a node: value, order and mark.
const NODE_BYTES: f64 = 16.0 + isosurface::NODE_BYTES;
/// Least size of a value over the grid's spacing: no vertex lies on a node, where several would coincide.
const LEAST_VALUE: f64 = 0.02;
/// A surface of this many times the faces that remeshing will leave is decimated first, to this many times them, as far
/// as it stays this near to itself in mm.
const DECIMATED_FROM: f64 = 3.0;
const SPARE: f64 = 1.5;
const DECIMATION_MM: f64 = 0.1;
/// Edge length over radius, and its bounds in mm.
const EDGE_PER_RADIUS: f64 = 0.32;
const EDGE_MM: [f64; 2] = [0.6, 1.6];
const REMESHING_ROUNDS: usize = 5;
/// Passes of the mesh's own smoothing after remeshing.
const POLISHING_ROUNDS: usize = 4;

/// Share, median, 95th percentile and greatest of some distances in mm.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct DistanceSpread {
    /// Half of the distances are at most this.
    pub median_mm: f64,
    /// 95 in 100 are at most this.
    pub p95_mm: f64,
    /// All are at most this.
    pub most_mm: f64,
}

impl DistanceSpread {
    /// Of some distances; zeros of none.
    pub fn of(mut distances_mm: Vec<f64>) -> DistanceSpread {
        distances_mm.sort_by(f64::total_cmp);
        let at = |share: f64| {
            let last = distances_mm.len().saturating_sub(1);
            distances_mm.get((share * last as f64).round() as usize).copied().unwrap_or(0.0)
        };
        DistanceSpread { median_mm: at(0.5), p95_mm: at(0.95), most_mm: at(1.0) }
    }
}

impl std::fmt::Display for DistanceSpread {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{:.2} / {:.2} / {:.2} mm", self.median_mm, self.p95_mm, self.most_mm)
    }
}

/// A mask's surface, and how well it is one.
pub struct LumenSurface {
    /// Closed, genus 0, normals into the lumen, LPS, mm.
    pub mesh: TriangleMesh,
    /// Spacing in mm of the voxels that it was made from.
    pub voxel_mm: DVec3,
    /// What the removal of handles and loose parts cost, in nodes of the finer grid.
    pub ball: BallReport,
    /// Distance of each vertex from the mask's boundary, mm.
    pub residual_mm: Vec<f64>,
    /// The spread of those distances.
    pub from_surface: DistanceSpread,
    /// Distance of the faces of the mask's boundary voxels from the surface: far where a branch was lost.
    pub from_mask: DistanceSpread,
}

/// The surface of `mask` (above 0 in the lumen).
///
/// Errors: an empty mask; one that is too large for this machine.
pub fn surface_of_mask(mask: &Volume<u8>) -> Result<LumenSurface> {
    let mask = around_lumen(mask)?;
    let boundary = signed_distance(&mask, DEPTH_MM);
    let smoothed = smoothed(&boundary);
    let (mut values, size, origin, spacing_mm) = on_finer_grid(&smoothed)?;
    let ball = keep_ball(&mut values, size, 0.05 * spacing_mm as f32);
    let rough = isosurface(&values, size, origin, spacing_mm);
    rough.validate_closed()?;
    let field = LumenField::from_values(origin, spacing_mm, size, values);
    let edge = |place: DVec3| (EDGE_PER_RADIUS * radius_mm(&field, place)).clamp(EDGE_MM[0], EDGE_MM[1]);
    let wanted = faces_of_edges(&rough, edge);
    // Remeshing decimates, too, edge by edge; where the grid is much finer than the edges, this comes sooner to it.
    let coarse = if rough.faces.len() as f64 > DECIMATED_FROM * wanted {
        decimated(&rough, (SPARE * wanted) as usize, DECIMATION_MM)
    } else {
        rough
    };
    let mut mesh = remesh(&coarse, REMESHING_ROUNDS, edge, |place| field.project(place));
    smooth(&mut mesh, POLISHING_ROUNDS);
    mesh.validate_closed()?;
    let residual_mm = from_boundary(&boundary, &mesh.vertices);
    let from_surface = DistanceSpread::of(residual_mm.clone());
    let surface = SurfaceDistance::new(&mesh);
    let from_mask =
        DistanceSpread::of(boundary_faces(&mask).par_iter().map(|place| surface.distance(*place)).collect());
    Ok(LumenSurface { mesh, voxel_mm: mask.grid.spacing_mm(), ball, residual_mm, from_surface, from_mask })
}

/// How many equilateral faces of these edge lengths cover a surface.
fn faces_of_edges(mesh: &TriangleMesh, edge_mm: impl Fn(DVec3) -> f64) -> f64 {
    let share = |face: &[u32; 3]| {
        let [a, b, c] = face.map(|v| mesh.vertices[v as usize]);
        let area = 0.5 * (b - a).cross(c - a).length();
        area / (0.25 * 3f64.sqrt() * edge_mm((a + b + c) / 3.0).powi(2))
    };
    mesh.faces.iter().map(share).sum()
}

/// Distance in mm of places from the boundary of a mask, at most 6.
pub fn distances_from_mask(mask: &Volume<u8>, places: &[DVec3]) -> Result<Vec<f64>> {
    Ok(from_boundary(&signed_distance(&around_lumen(mask)?, DEPTH_MM), places))
}

fn from_boundary(boundary: &Volume<f32>, places: &[DVec3]) -> Vec<f64> {
    let to_index = boundary.grid.index_from_place();
    places.par_iter().map(|place| boundary.sample(to_index(*place)).unwrap_or(DEPTH_MM).abs()).collect()
}

/// Euler characteristic of a closed surface: 2 for a ball, 2 less for each handle.
pub fn euler_characteristic(mesh: &TriangleMesh) -> i64 {
    mesh.vertices.len() as i64 - mesh.edges().len() as i64 + mesh.faces.len() as i64
}

/// The part of a mask that holds the airway, with free voxels around it where the volume ended before.
fn around_lumen(mask: &Volume<u8>) -> Result<Volume<u8>> {
    let (low, high) = bounding_box(mask).ok_or_else(|| Error::input("the airway mask is empty"))?;
    let size = [0, 1, 2].map(|a| high[a] - low[a] + 2 * MARGIN);
    let corner = DVec3::new(low[0] as f64, low[1] as f64, low[2] as f64) - MARGIN as f64;
    let grid = VoxelGrid { size, origin_mm: mask.grid.position(corner), ..mask.grid };
    demand_memory("the airway's distances", grid.count() as f64 * 20.0)?;
    let mut wider = Volume::filled(grid, 0u8);
    for k in low[2]..high[2] {
        for j in low[1]..high[1] {
            let from = mask.grid.at([low[0], j, k]);
            let to = grid.at([MARGIN, j - low[1] + MARGIN, k - low[2] + MARGIN]);
            let length = high[0] - low[0];
            wider.data[to..to + length].copy_from_slice(&mask.data[from..from + length]);
        }
    }
    Ok(wider)
}

/// The distances, smoothed and held within half a voxel.
fn smoothed(boundary: &Volume<f32>) -> Volume<f32> {
    let grid = boundary.grid;
    let [nx, ny, nz] = grid.size;
    let spacing = grid.spacing_mm();
    let near = 3.0 * spacing.max_element() as f32;
    let weight = [0, 1, 2].map(|a| (spacing.min_element() / spacing[a]).powi(2) as f32);
    let total = 2.0 * weight.iter().sum::<f32>();
    let stride = [1, nx, nx * ny];
    let inner = |at: usize| {
        let [i, j, k] = grid.cell(at);
        i > 0 && j > 0 && k > 0 && i + 1 < nx && j + 1 < ny && k + 1 < nz
    };
    // Nodes near the boundary, and how far each may move: half a voxel along the boundary's normal.
    let band: Vec<(usize, f32)> = (0..grid.count())
        .into_par_iter()
        .filter(|&at| boundary.data[at].abs() < near && inner(at))
        .map(|at| {
            let slope = |a: usize| f64::from(boundary.data[at + stride[a]] - boundary.data[at - stride[a]]);
            let normal = (DVec3::new(slope(0), slope(1), slope(2)) / spacing).normalize_or_zero();
            let across = (normal * spacing).length().max(spacing.min_element());
            (at, (0.5 * HELD * across) as f32)
        })
        .collect();
    let mut field = boundary.data.clone();
    for factor in (0..SMOOTHING_ROUNDS).flat_map(|_| SMOOTHING) {
        let moved: Vec<f32> = band
            .par_iter()
            .map(|&(at, held)| {
                let mean = (0..3).map(|a| weight[a] * (field[at + stride[a]] + field[at - stride[a]])).sum::<f32>();
                let value = field[at] + factor * (mean / total - field[at]);
                value.clamp(boundary.data[at] - held, boundary.data[at] + held)
            })
            .collect();
        band.iter().zip(moved).for_each(|(&(at, _), value)| field[at] = value);
    }
    Volume { grid, data: field }
}

/// The field on a cubic grid along the axes of the body: values, size, origin, spacing.
fn on_finer_grid(field: &Volume<f32>) -> Result<(Vec<f32>, [usize; 3], DVec3, f64)> {
    let (low, high) = field.grid.bounds_mm();
    let extent = high - low;
    let voxel_mm = field.grid.spacing_mm().min_element();
    let fine = (FINER * voxel_mm).clamp(SPACING_MM[0], SPACING_MM[1]);
    let spacing_mm = fine.max((extent.element_product() / MOST_NODES).cbrt());
    let size = (extent / spacing_mm).to_array().map(|n| n.ceil() as usize + 3);
    let nodes: usize = size.iter().product();
    demand_memory("the grid of the airway's surface", nodes as f64 * NODE_BYTES)?;
    let origin = low - spacing_mm;
    let to_index = field.grid.index_from_place();
    let near = 1.5 * field.grid.spacing_mm().max_element();
    let far = DEPTH_MM as f32;
    let least = (LEAST_VALUE * spacing_mm) as f32;
    let node = |at: usize| {
        let (i, j, k) = (at % size[0], at / size[0] % size[1], at / size[0] / size[1]);
        let is_rim = [i, j, k].iter().zip(&size).any(|(&n, &count)| n == 0 || n + 1 == count);
        let index = to_index(origin + DVec3::new(i as f64, j as f64, k as f64) * spacing_mm);
        let value = match field.sample(index) {
            Some(value) if !is_rim && value.abs() < near => cubic(field, index).unwrap_or(value) as f32,
            Some(value) if !is_rim => value as f32,
            _ => far,
        };
        if value.abs() < least { least.copysign(value) } else { value }
    };
    Ok(((0..nodes).into_par_iter().map(node).collect(), size, origin, spacing_mm))
}

/// Catmull and Rom's cubic interpolation; `None` near the rim.
fn cubic(field: &Volume<f32>, index: DVec3) -> Option<f64> {
    let base = index.floor();
    let size = field.grid.size;
    if (0..3).any(|a| base[a] < 1.0 || base[a] as usize + 2 >= size[a]) {
        return None;
    }
    let weights = [0, 1, 2].map(|a| {
        let t = index[a] - base[a];
        let (t2, t3) = (t * t, t * t * t);
        [
            0.5 * (-t3 + 2.0 * t2 - t),
            0.5 * (3.0 * t3 - 5.0 * t2 + 2.0),
            0.5 * (-3.0 * t3 + 4.0 * t2 + t),
            0.5 * (t3 - t2),
        ]
    });
    let corner = [0, 1, 2].map(|a| base[a] as usize - 1);
    let mut sum = 0.0;
    for (k, wz) in weights[2].iter().enumerate() {
        for (j, wy) in weights[1].iter().enumerate() {
            let start = field.grid.at([corner[0], corner[1] + j, corner[2] + k]);
            let row = (0..4).map(|i| weights[0][i] * f64::from(field.data[start + i])).sum::<f64>();
            sum += wz * wy * row;
        }
    }
    Some(sum)
}

/// How wide the airway is at a place on its wall, mm: the depth of the lumen's middle, found by going in.
fn radius_mm(field: &LumenField, place: DVec3) -> f64 {
    let mut deepest = 0.0f64;
    let mut at = place;
    for _ in 0..16 {
        let Some((value, gradient)) = field.sample(at) else { break };
        if value > 0.5 || -value < deepest - 1e-3 {
            break;
        }
        deepest = deepest.max(-value);
        at -= gradient.normalize_or_zero() * 0.4;
    }
    deepest
}

/// Middles of the faces between the mask's voxels and the others.
fn boundary_faces(mask: &Volume<u8>) -> Vec<DVec3> {
    let grid = mask.grid;
    let mut places = Vec::new();
    for at in 0..grid.count() {
        let cell = grid.cell(at);
        for axis in 0..3 {
            if cell[axis] + 1 == grid.size[axis] {
                continue;
            }
            let mut next = cell;
            next[axis] += 1;
            if (mask.data[at] > 0) != (mask.value(next) > 0) {
                places.push(0.5 * (grid.centre(at) + grid.centre(grid.at(next))));
            }
        }
    }
    places
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::{CounterRng, Stage};

    /// Distance to a fork of round tubes: trachea 7 mm, daughters 4 and 3 mm.
    pub(crate) fn fork(place: DVec3) -> f64 {
        let tube = |a: DVec3, b: DVec3, radius: f64| {
            let along = ((place - a).dot(b - a) / (b - a).length_squared()).clamp(0.0, 1.0);
            place.distance(a.lerp(b, along)) - radius
        };
        let carina = DVec3::new(0.0, 0.0, -40.0);
        tube(DVec3::ZERO, carina, 7.0).min(tube(carina, DVec3::new(28.0, 4.0, -70.0), 4.0)).min(tube(
            carina,
            DVec3::new(-25.0, 3.0, -72.0),
            3.0,
        ))
    }

    /// The fork seen by a scanner: partial volume, noise, threshold at the half.
    fn scanned(grid: VoxelGrid) -> Volume<u8> {
        let mut rng = CounterRng::new(5, Stage::Test, &[]);
        let data = (0..grid.count())
            .map(|at| {
                let centre = grid.centre(at);
                let inside = (0..27).filter(|s| {
                    let part = DVec3::new((s % 3) as f64, (s / 3 % 3) as f64, (s / 9) as f64) / 3.0 - 1.0 / 3.0;
                    fork(centre + grid.axes_mm * part) < 0.0
                });
                let share = inside.count() as f64 / 27.0 + 0.12 * rng.normal();
                u8::from(share > 0.5)
            })
            .collect();
        Volume { grid, data }
    }

    #[test]
    fn a_scanned_fork_becomes_a_sphere_like_surface_within_half_a_voxel() {
        let turn = glam::DMat3::from_rotation_z(0.2) * glam::DMat3::from_rotation_x(0.1);
        for spacing in [DVec3::new(0.8, 0.8, 1.0), DVec3::new(0.7, 0.7, 2.5)] {
            let extent = DVec3::new(96.0, 60.0, 116.0);
            let size = (extent / spacing).to_array().map(|n| n as usize);
            let axes_mm = turn * glam::DMat3::from_diagonal(spacing);
            let origin_mm = DVec3::new(0.0, 0.0, -34.0) - turn * (0.5 * extent);
            let mask = scanned(VoxelGrid { size, origin_mm, axes_mm });
            let found = surface_of_mask(&mask).unwrap();
            assert_eq!(euler_characteristic(&found.mesh), 2);
            assert!(found.mesh.signed_volume() < 0.0, "normals must point into the lumen");
            let truth = DistanceSpread::of(found.mesh.vertices.iter().map(|v| fork(*v).abs()).collect());
            println!(
                "{spacing}: {} faces, from truth {truth}, from mask {} and {}, {:?}",
                found.mesh.faces.len(),
                found.from_surface,
                found.from_mask,
                found.ball
            );
            assert!(truth.median_mm < 0.25 * spacing.max_element() && truth.p95_mm < 0.5 * spacing.max_element());
            assert!(found.from_surface.p95_mm < 0.5 * spacing.max_element());
            // No tube shrinks: the mean error along the normal is a small part of a voxel.
            let mean = found.mesh.vertices.iter().map(|v| fork(*v)).sum::<f64>() / found.mesh.vertices.len() as f64;
            assert!(mean.abs() < 0.1 * spacing.max_element(), "{mean}");
        }
    }

    #[test]
    fn an_empty_mask_is_refused() {
        let grid = VoxelGrid::upright([4, 4, 4], DVec3::ZERO, DVec3::ONE);
        assert!(surface_of_mask(&Volume::filled(grid, 0u8)).is_err());
    }
}
