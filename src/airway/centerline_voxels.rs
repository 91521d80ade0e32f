//! The inside of a closed mesh as a sparse set of voxels with their exact distance to the wall.
//!
//! Each row of voxels along x is one ray; the signed crossings with the surface are summed from its start, and a voxel
//! is inside where the sum (the winding number) is not zero. So the mesh may have either orientation and overlapping
//! closed parts. The edge test is computed from the lower to the higher vertex index, hence two faces that share an
//! edge never both take or both miss a ray.

use std::ops::RangeInclusive;

use glam::DVec3;
use rayon::prelude::*;

use super::centerline_distance::SurfaceDistance;
use crate::base::estimate::demand_memory;
use crate::base::{Error, Result, TriangleMesh};

/// No voxel.
pub const NONE: u32 = u32::MAX;
/// Most voxels of the bounding box; the spacing grows to stay below.
const BOX_VOXELS: f64 = 60e6;
/// Most pairs of a ray and a face whose box it meets; a closed surface without folds has a few for each ray, 20 million
/// in all. A pair takes some ten nanoseconds.
const MOST_MEETINGS: f64 = 5e8;
/// Most crossings, 24 bytes each.
const MOST_CROSSINGS: usize = 50_000_000;
/// Bytes of a voxel: its cell, its distance, and its neighbours.
const VOXEL_BYTES: f64 = 200.0;
/// Largest share of rays that may leave the surface more often than they enter it.
const OPEN_ROWS: f64 = 0.02;

/// The voxels inside, ordered by z, then y, then x.
pub struct Voxels {
    /// Edge length in mm.
    pub spacing_mm: f64,
    /// Distance in mm of each voxel's centre to the surface.
    pub distance_mm: Vec<f64>,
    origin: DVec3,
    size: [i32; 3],
    /// The voxels of row `y + size.y * z` are `row_offsets[row]..row_offsets[row + 1]`.
    row_offsets: Vec<u32>,
    cells: Vec<[i32; 3]>,
}

/// One crossing of a row's ray with a face.
struct Crossing {
    row: u32,
    x: f64,
    sign: i32,
}

impl Voxels {
    /// Fills `mesh` with voxels of `spacing_mm` or more.
    pub fn new(mesh: &TriangleMesh, surface: &SurfaceDistance, spacing_mm: f64) -> Result<Self> {
        let (low, high) = mesh.bounds();
        let extent = high - low;
        let spacing_mm = spacing_mm.max((extent.x * extent.y * extent.z / BOX_VOXELS).cbrt());
        // rays avoid round numbers, where meshes tend to have vertices
        let origin = low - DVec3::new(0.5, 0.5 + 0.0137, 0.5 + 0.0291) * spacing_mm;
        let size = ((high - origin) / spacing_mm).to_array().map(|n| n.ceil() as i32 + 1);
        let mut voxels =
            Self { spacing_mm, distance_mm: Vec::new(), origin, size, row_offsets: vec![0], cells: Vec::new() };
        voxels.fill(&mesh_crossings(mesh, &voxels)?)?;
        if voxels.cells.is_empty() {
            return Err(Error::input(format!("the mesh encloses no space at a spacing of {spacing_mm:.3} mm")));
        }
        demand_memory(format_args!("{} voxels", voxels.len()), voxels.len() as f64 * VOXEL_BYTES)?;
        voxels.distance_mm = voxels.distances(surface);
        Ok(voxels)
    }

    /// Number of voxels inside.
    pub(super) fn len(&self) -> usize {
        self.cells.len()
    }

    /// Centre of `voxel` in mm.
    pub fn center(&self, voxel: u32) -> DVec3 {
        let [x, y, z] = self.cells[voxel as usize];
        self.origin + DVec3::new(f64::from(x), f64::from(y), f64::from(z)) * self.spacing_mm
    }

    /// The voxels inside whose centres lie within `radius_mm` of `point`, in order.
    pub fn in_ball(&self, point: DVec3, radius_mm: f64) -> Vec<u32> {
        let middle = (point - self.origin) / self.spacing_mm;
        let reach = radius_mm / self.spacing_mm;
        let range = |axis: usize| {
            let from = ((middle[axis] - reach).ceil() as i32).max(0);
            let to = ((middle[axis] + reach).floor() as i32).min(self.size[axis] - 1);
            (from, to)
        };
        let ((x0, x1), (y0, y1), (z0, z1)) = (range(0), range(1), range(2));
        let mut found = Vec::new();
        for z in z0..=z1 {
            for y in y0..=y1 {
                let (start, row) = self.row(y, z);
                let skip = row.partition_point(|cell| cell[0] < x0);
                for (k, _) in row.iter().enumerate().skip(skip).take_while(|(_, cell)| cell[0] <= x1) {
                    let voxel = start + k as u32;
                    if self.center(voxel).distance_squared(point) <= radius_mm * radius_mm {
                        found.push(voxel);
                    }
                }
            }
        }
        found
    }

    /// Whether `point` is certainly inside: it lies in the free ball of a voxel nearby.
    pub fn contains(&self, point: DVec3) -> bool {
        self.in_ball(point, 1.8 * self.spacing_mm)
            .iter()
            .any(|&v| self.center(v).distance(point) < 0.999 * self.distance_mm[v as usize])
    }

    /// The voxel nearest to `point`.
    pub fn nearest(&self, point: DVec3) -> u32 {
        let key = |v: &u32| self.center(*v).distance_squared(point);
        (0..self.len() as u32).min_by(|a, b| key(a).total_cmp(&key(b))).expect("the constructor refuses an empty set")
    }

    /// The up to 26 neighbours of every voxel; [`NONE`] fills the rest.
    pub fn neighbours(&self) -> Vec<[u32; 26]> {
        (0..self.len()).into_par_iter().map(|v| self.neighbours_of(v as u32)).collect()
    }

    fn neighbours_of(&self, voxel: u32) -> [u32; 26] {
        let [x, y, z] = self.cells[voxel as usize];
        let mut found = [NONE; 26];
        let mut count = 0;
        for (dz, dy) in (-1..=1).flat_map(|dz| (-1..=1).map(move |dy| (dz, dy))) {
            if !(0..self.size[1]).contains(&(y + dy)) || !(0..self.size[2]).contains(&(z + dz)) {
                continue;
            }
            let (start, row) = self.row(y + dy, z + dz);
            let skip = row.partition_point(|cell| cell[0] < x - 1);
            for (k, _) in row.iter().enumerate().skip(skip).take_while(|(_, cell)| cell[0] <= x + 1) {
                let other = start + k as u32;
                if other != voxel {
                    found[count] = other;
                    count += 1;
                }
            }
        }
        found
    }

    /// First voxel and the voxels of row (y, z).
    fn row(&self, y: i32, z: i32) -> (u32, &[[i32; 3]]) {
        let row = (y + self.size[1] * z) as usize;
        let (start, end) = (self.row_offsets[row], self.row_offsets[row + 1]);
        (start, &self.cells[start as usize..end as usize])
    }

    /// Walks along every ray and takes the voxels between entry and exit.
    fn fill(&mut self, crossings: &[Crossing]) -> Result<()> {
        let (mut hit_rows, mut open_rows, mut next) = (0usize, 0usize, 0usize);
        for row in 0..(self.size[1] * self.size[2]) as u32 {
            let count = crossings[next..].iter().take_while(|c| c.row == row).count();
            let along = &crossings[next..next + count];
            next += count;
            hit_rows += usize::from(count > 0);
            if along.iter().map(|c| c.sign).sum::<i32>() == 0 {
                self.fill_row(row as i32, along);
            } else {
                open_rows += 1;
            }
            self.row_offsets.push(self.cells.len() as u32);
        }
        if open_rows as f64 > OPEN_ROWS * hit_rows as f64 {
            return Err(Error::input(format!(
                "the mesh is not closed: {open_rows} of {hit_rows} rays leave it more or less often than they enter it"
            )));
        }
        Ok(())
    }

    fn fill_row(&mut self, row: i32, along: &[Crossing]) {
        let mut winding = 0;
        for pair in along.windows(2) {
            winding += pair[0].sign;
            if winding != 0 {
                let index = |x: f64| ((x - self.origin.x) / self.spacing_mm).ceil() as i32;
                let (y, z) = (row % self.size[1], row / self.size[1]);
                self.cells.extend((index(pair[0].x)..index(pair[1].x)).map(|x| [x, y, z]));
            }
        }
    }

    /// Exact distances; the neighbour before bounds each search.
    fn distances(&self, surface: &SurfaceDistance) -> Vec<f64> {
        let chunks: Vec<Vec<f64>> = self
            .cells
            .par_chunks(1024)
            .enumerate()
            .map(|(chunk, cells)| {
                let first = chunk * 1024;
                let mut before: Option<(DVec3, f64)> = None;
                let measure = |k: usize| {
                    let center = self.center((first + k) as u32);
                    let limit = before.map_or(f64::INFINITY, |(p, d)| (d + p.distance(center)) * 1.000_001 + 1e-9);
                    let distance = surface.distance_below(center, limit);
                    before = Some((center, distance));
                    distance
                };
                (0..cells.len()).map(measure).collect()
            })
            .collect();
        chunks.concat()
    }
}

/// The rays whose boxes a face meets, along `axis`.
fn span(corners: &[DVec3; 3], grid: &Voxels, axis: usize) -> RangeInclusive<i32> {
    let to_index = |x: f64| (x - grid.origin[axis]) / grid.spacing_mm;
    let (low, high) = corners.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), c| {
        (low.min(to_index(c[axis])), high.max(to_index(c[axis])))
    });
    low.ceil() as i32..=high.floor() as i32
}

/// All crossings of the rows of `grid` with the surface, ordered by row and x.
///
/// Errors: faces that lie over each other many times.
fn mesh_crossings(mesh: &TriangleMesh, grid: &Voxels) -> Result<Vec<Crossing>> {
    let folded = |what: f64| {
        Error::input(format!(
            "the mesh lies over itself too often: its faces cross the rays of a grid {what:.0e} times"
        ))
    };
    let length = |range: RangeInclusive<i32>| (f64::from(*range.end()) - f64::from(*range.start()) + 1.0).max(0.0);
    let meetings = |f: usize| length(span(&mesh.corners(f), grid, 1)) * length(span(&mesh.corners(f), grid, 2));
    let all: f64 = (0..mesh.faces.len()).map(meetings).sum();
    if all > MOST_MEETINGS {
        return Err(folded(all));
    }
    let mut crossings: Vec<Crossing> = Vec::with_capacity(mesh.faces.len() * 2);
    for (f, face) in mesh.faces.iter().enumerate() {
        let corners = mesh.corners(f);
        if crossings.len() > MOST_CROSSINGS {
            return Err(folded(crossings.len() as f64));
        }
        for z in span(&corners, grid, 2) {
            for y in span(&corners, grid, 1) {
                let (ray_y, ray_z) =
                    (grid.origin.y + f64::from(y) * grid.spacing_mm, grid.origin.z + f64::from(z) * grid.spacing_mm);
                if let Some((x, sign)) = cross(face, &corners, ray_y, ray_z) {
                    crossings.push(Crossing { row: (y + grid.size[1] * z) as u32, x, sign });
                }
            }
        }
    }
    crossings.sort_by(|a, b| a.row.cmp(&b.row).then(a.x.total_cmp(&b.x)).then(a.sign.cmp(&b.sign)));
    Ok(crossings)
}

/// Where the ray along x through (`y`, `z`) crosses the face, and the sign of the face's normal there.
fn cross(face: &[u32; 3], corners: &[DVec3; 3], y: f64, z: f64) -> Option<(f64, i32)> {
    let side = |i: usize, j: usize| {
        let (i, j, turn) = if face[i] < face[j] { (i, j, 1.0) } else { (j, i, -1.0) };
        let (a, b) = (corners[i], corners[j]);
        let area = (b.y - a.y) * (z - a.z) - (b.z - a.z) * (y - a.y);
        (if area >= 0.0 { 1.0 } else { -1.0 }) * turn * area.abs().max(f64::MIN_POSITIVE)
    };
    let weights = [side(1, 2), side(2, 0), side(0, 1)];
    let positive = weights.iter().filter(|w| **w > 0.0).count();
    if positive != 0 && positive != 3 {
        return None;
    }
    let x = (0..3).map(|k| weights[k] * corners[k].x).sum::<f64>() / weights.iter().sum::<f64>();
    Some((x, if positive == 3 { 1 } else { -1 }))
}
