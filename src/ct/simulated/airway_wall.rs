//! The airway of one breath hold as a scanner meets it: lumen, and the wall around it.
//!
//! Signed distance to the surface on a grid, exact near it. The wall's thickness follows the radius of the nearest
//! point of the centreline,
//!
//!   t = 0.55 mm + 0.14 r,  at most 1.8 mm,
//!
//! which is 1.5 mm in a trachea of 14 mm and 0.75 mm in a bronchus of 3 mm, between what histology (Weibel) and CT
//! (which shows it thicker) give. The trachea goes on beyond the inlet, as it does in a patient.

use glam::DVec3;
use rayon::prelude::*;

use super::node_grid::NodeGrid;
use crate::airway::centerline_distance::SurfaceDistance;
use crate::airway::centerline_voxels::Voxels;
use crate::airway::nearest_points::NearestPoints;
use crate::airway::surface_field::LumenField;
use crate::base::estimate::demand_memory;
use crate::base::{Result, TriangleMesh};

/// Spacing of the grid in mm; a lumen of 1.1 mm radius is then off by 0.03 mm.
const SPACING_MM: f64 = 0.6;
/// Distances outside are known up to here, mm: the thickest wall and its blurred edge.
pub const KNOWN_MM: f64 = 4.0;
/// Thickness of the wall: constant part in mm, part of the radius, most in mm.
const WALL: (f64, f64, f64) = (0.55, 0.14, 1.8);
/// Spacing in mm of the grid of the thickness.
const WALL_SPACING_MM: f64 = 4.0;
/// Length in mm by which the trachea goes on.
const EXTENSION_MM: f64 = 120.0;

/// A straight continuation of the trachea beyond the inlet.
#[derive(Clone, Copy, Debug)]
pub struct TrachealExtension {
    /// Where it begins, inside of the lumen.
    pub from_mm: DVec3,
    /// Unit vector away from the lungs.
    pub direction: DVec3,
    /// Radius in mm.
    pub radius_mm: f64,
}

impl TrachealExtension {
    /// From the first points of a centreline: where the lumen has its full width, in the direction of its axis.
    pub fn of_line(places: &[DVec3], radii_mm: &[f64]) -> Option<TrachealExtension> {
        let inlet = *places.first()?;
        let within = |mm: f64| places.iter().take(400).position(|p| p.distance(inlet) > mm);
        let (near, far) = (within(8.0)?, within(25.0)?);
        let direction = (places[near] - places[far]).try_normalize()?;
        Some(TrachealExtension { from_mm: places[near], direction, radius_mm: radii_mm[near] })
    }

    fn distance(&self, place: DVec3) -> f64 {
        let along = (place - self.from_mm).dot(self.direction).clamp(0.0, EXTENSION_MM);
        place.distance(self.from_mm + self.direction * along) - self.radius_mm
    }
}

/// Lumen and wall at one breath hold.
pub struct AirwayWall {
    lumen: LumenField,
    thickness_mm: NodeGrid<1>,
    extension: Option<TrachealExtension>,
}

impl AirwayWall {
    /// Of the closed surface `mesh` and the points of its centreline with their radii in mm.
    ///
    /// Errors: a surface that is not closed; too large a one for this machine.
    pub fn new(mesh: &TriangleMesh, places: &[DVec3], radii_mm: &[f64]) -> Result<AirwayWall> {
        let lumen = signed_lumen(mesh)?;
        let points = NearestPoints::new(places)?;
        let (low, high) = mesh.bounds();
        let margin = DVec3::splat(2.0 * KNOWN_MM);
        let thickness_mm = NodeGrid::sampled(low - margin, high + margin, WALL_SPACING_MM, |p| {
            let (constant, share, most) = WALL;
            [(constant + share * radii_mm[points.nearest(p).0]).min(most)]
        });
        Ok(AirwayWall { lumen, thickness_mm, extension: TrachealExtension::of_line(places, radii_mm) })
    }

    /// Distance in mm to the lumen (negative inside, at most [`KNOWN_MM`]) and thickness of the wall in mm there.
    pub fn at(&self, place: DVec3) -> (f64, f64) {
        let own = self.lumen.sample(place).map_or(KNOWN_MM, |(value, _)| value);
        let longer = self.extension.map_or(KNOWN_MM, |e| e.distance(place)).min(own).min(KNOWN_MM);
        if longer >= KNOWN_MM { (KNOWN_MM, 0.0) } else { (longer, self.thickness_mm.at(place)[0]) }
    }

    /// The continuation of the trachea.
    pub fn extension(&self) -> Option<TrachealExtension> {
        self.extension
    }
}

/// Signed distance to `mesh`: exact inside and up to [`KNOWN_MM`] outside.
pub fn signed_lumen(mesh: &TriangleMesh) -> Result<LumenField> {
    let surface = SurfaceDistance::new(mesh);
    let inside = Voxels::new(mesh, &surface, SPACING_MM)?;
    let spacing = inside.spacing_mm;
    let (low, high) = mesh.bounds();
    // The nodes are the voxels' centres.
    let first = inside.center(0);
    let steps = ((first - (low - 2.0 * KNOWN_MM)) / spacing).ceil();
    let origin = first - steps * spacing;
    let size = ((high + 2.0 * KNOWN_MM - origin) / spacing).to_array().map(|n| n.ceil() as usize + 1);
    let count: usize = size.iter().product();
    demand_memory("distances to the airway", count as f64 * 6.0)?;
    let node_of = |place: DVec3| ((place - origin) / spacing).round().to_array().map(|n| n.max(0.0) as usize);
    let index = |[i, j, k]: [usize; 3]| (k * size[1] + j) * size[0] + i;
    let mut is_near = vec![false; count];
    let reach = (KNOWN_MM / spacing).ceil() as usize + 1;
    for vertex in &mesh.vertices {
        let node = node_of(*vertex);
        let range = |a: usize| node[a].saturating_sub(reach)..(node[a] + reach + 1).min(size[a]);
        for k in range(2) {
            for j in range(1) {
                let row = index([0, j, k]);
                is_near[row + range(0).start..row + range(0).end].fill(true);
            }
        }
    }
    let mut values: Vec<f32> = is_near
        .into_par_iter()
        .enumerate()
        .map(|(at, near)| {
            if !near {
                return KNOWN_MM as f32;
            }
            let node =
                DVec3::new((at % size[0]) as f64, (at / size[0] % size[1]) as f64, (at / size[0] / size[1]) as f64);
            surface.distance_below(origin + node * spacing, KNOWN_MM) as f32
        })
        .collect();
    for (voxel, distance) in inside.distance_mm.iter().enumerate() {
        values[index(node_of(inside.center(voxel as u32)))] = -distance as f32;
    }
    Ok(LumenField::from_values(origin, spacing, size, values))
}
