//! A chest that breathes: the tissue of one patient, and what stands at each place at a breath hold.

use glam::DVec3;

use super::airway_wall::{AirwayWall, KNOWN_MM};
use super::body_motion::{BodyMotion, NODES_MM, TissueMap, field_of_pair};
use super::node_grid::NodeGrid;
use super::protocol::ScannerSettings;
use super::texture::LungTexture;
use super::thorax::{AIR_HU, Thorax, coverage};
use super::vessels::VesselTree;
use crate::airway::case::Case;
use crate::airway::{Anatomy, build};
use crate::base::{Error, Result, VoxelGrid};

/// Density of the parenchyma at full inspiration over that of water, its rise from front to back, and the deviation of
/// its texture, both over the density. With the vessels, lungs of about -860 HU, as COPD subjects have at full
/// inspiration.
const LUNG_DENSITY: f64 = 0.105;
const GRAVITY: f64 = 0.18;
const TEXTURE: f64 = 0.24;
/// Least density of parenchyma.
const LEAST_DENSITY: f64 = 0.01;
/// HU of vessels, of the wall, of a fissure, and of the air in the airway.
const VESSEL_HU: f64 = 42.0;
const WALL_HU: f64 = 35.0;
const FISSURE_HU: f64 = -350.0;
const LUMEN_HU: f64 = -995.0;
/// Half the thickness of a fissure in mm.
const FISSURE_MM: f64 = 0.3;
/// Vessels are drawn up to this distance in mm outside of the lung: the hilum.
const HILUM_MM: f64 = 12.0;
/// Widest lungs in mm that are scanned.
const WIDEST_LUNGS_MM: f64 = 600.0;
/// Room in mm around the body and below the lungs.
const AROUND_MM: f64 = 5.0;
const BELOW_MM: f64 = 14.0;
const ABOVE_MM: f64 = 6.0;

/// The two breath holds of a pair of scans.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BreathState {
    /// Full inspiration.
    Inspiration,
    /// Full expiration.
    Expiration,
}

/// A chest around the airway of a case.
pub struct SimulatedChest {
    /// The airway in both states: the truth.
    pub anatomy: Anatomy,
    /// Vessels, at full inspiration.
    pub vessels: VesselTree,
    /// Shapes around the airway.
    pub thorax: Thorax,
    texture: LungTexture,
    motion: BodyMotion,
    low: DVec3,
    high: DVec3,
    seed: u64,
}

impl SimulatedChest {
    /// Of a case: its airway, its field, its seed.
    ///
    /// Errors: those of [`build`]; an airway without a trachea, or one that is larger than a chest.
    pub fn new(case: &Case) -> Result<SimulatedChest> {
        build(case).and_then(|anatomy| SimulatedChest::around(anatomy, case)).map_err(|e| case.blamed(e))
    }

    fn around(anatomy: Anatomy, case: &Case) -> Result<SimulatedChest> {
        let field = match &case.breathing {
            Some(breathing) => breathing.field.clone(),
            None => field_of_pair(&anatomy)?,
        };
        let thorax = Thorax::new(&anatomy.centerline, &field)?;
        let (lungs_low, lungs_high) = thorax.lungs_box();
        let extent = lungs_high - lungs_low;
        if !extent.is_finite() || extent.max_element() >= WIDEST_LUNGS_MM {
            return Err(Error::input(format!(
                "its lungs would be {:.0} x {:.0} x {:.0} mm wide, and {WIDEST_LUNGS_MM} mm is the most",
                extent.x, extent.y, extent.z
            )));
        }
        let lung = |x: DVec3| thorax.lung(x);
        let vessels = VesselTree::new(&anatomy.centerline, lungs_low, lungs_high, lung, case.seed);
        let inlet = anatomy.inspiration.bounds().1.z;
        let (low, high) = thorax.body_box();
        let low = low - DVec3::new(AROUND_MM, AROUND_MM, BELOW_MM);
        let high = (high + DVec3::new(AROUND_MM, AROUND_MM, ABOVE_MM)).max(DVec3::new(low.x, low.y, inlet + ABOVE_MM));
        let motion = BodyMotion::new(&anatomy, &field)?;
        let texture = LungTexture::new(case.seed);
        Ok(SimulatedChest { anatomy, vessels, thorax, texture, motion, low, high, seed: case.seed })
    }

    /// The voxels of a scan: the whole body, from below the lungs to above them and the trachea's inlet.
    pub fn grid(&self, settings: &ScannerSettings) -> VoxelGrid {
        let spacing = DVec3::new(settings.pixel_mm, settings.pixel_mm, settings.slice_mm);
        let size = ((self.high - self.low) / spacing).to_array().map(|n| n.ceil() as usize + 1);
        VoxelGrid::upright(size, self.low, spacing)
    }

    /// Seed of what is random.
    pub fn seed(&self) -> u64 {
        self.seed
    }

    /// The chest at a breath hold.
    ///
    /// Errors: an airway that is too large for this machine.
    pub fn at(&self, state: BreathState) -> Result<ChestState<'_>> {
        let (map, folded) = match state {
            BreathState::Inspiration => (TissueMap::still(self.low, self.high), 0),
            BreathState::Expiration => TissueMap::moving(&self.motion, self.low, self.high),
        };
        let shapes = NodeGrid::sampled(self.low, self.high, NODES_MM, |y| {
            let x = map.at(y).0;
            let lung_mm = self.thorax.lung(x);
            let fissure_mm = if lung_mm < 3.0 * NODES_MM { self.thorax.fissure(x).clamp(-30.0, 30.0) } else { 30.0 };
            [lung_mm, fissure_mm]
        });
        let line = &self.anatomy.centerline.points;
        let wall = match state {
            BreathState::Inspiration => {
                let places: Vec<DVec3> = line.iter().map(|p| p.position_mm).collect();
                let radii: Vec<f64> = line.iter().map(|p| p.radius_mm).collect();
                AirwayWall::new(&self.anatomy.inspiration, &places, &radii)?
            }
            BreathState::Expiration => AirwayWall::new(
                &self.anatomy.expiration,
                &self.anatomy.centerline_expiration,
                &self.anatomy.radius_expiration_mm,
            )?,
        };
        Ok(ChestState { chest: self, map, shapes, wall, folded })
    }
}

/// A chest at a breath hold.
pub struct ChestState<'a> {
    chest: &'a SimulatedChest,
    /// Where each place's tissue was at full inspiration.
    pub map: TissueMap,
    shapes: NodeGrid<2>,
    wall: AirwayWall,
    /// Nodes near the rim of the scan at which the field could not be inverted.
    pub folded: usize,
}

impl ChestState<'_> {
    /// Signed distance in mm to the lungs.
    pub fn lung(&self, y: DVec3) -> f64 {
        self.shapes.at(y)[0]
    }

    /// Signed distance in mm to the lumen, at most 4, and the thickness of the wall in mm.
    pub fn airway(&self, y: DVec3) -> (f64, f64) {
        self.wall.at(y)
    }

    /// The lobe of a place, 1 to 4 as [`Thorax::lobe`] counts; 0 outside of the lungs and in the airway.
    pub fn lobe(&self, y: DVec3) -> u8 {
        let [lung_mm, fissure_mm] = self.shapes.at(y);
        let (lumen_mm, thickness_mm) = self.wall.at(y);
        if lung_mm >= 0.0 || lumen_mm < thickness_mm {
            return 0;
        }
        self.chest.thorax.lobe(self.map.at(y).0, fissure_mm)
    }

    /// Density of the parenchyma alone at a place, over that of water; `None` outside of the lungs.
    pub fn density(&self, y: DVec3) -> Option<f64> {
        let (x, density) = self.map.at(y);
        (self.lung(y) < 0.0).then(|| self.parenchyma(x, density) / 1000.0 + 1.0)
    }

    /// HU of the parenchyma alone at tissue `x`, which is `density` times as dense as at full inspiration: mass is
    /// conserved, density_E = density_I / det(I + grad u).
    fn parenchyma(&self, x: DVec3, density: f64) -> f64 {
        let (low, high) = self.chest.thorax.lungs_box();
        let back = ((x.y - low.y) / (high.y - low.y) - 0.5) * 2.0;
        let at_rest = LUNG_DENSITY * (1.0 + GRAVITY * back) * (1.0 + TEXTURE * self.chest.texture.at(x));
        ((at_rest * density).max(LEAST_DENSITY) - 1.0) * 1000.0
    }

    /// HU at a place, with edges as soft as [`coverage`].
    pub fn hu(&self, y: DVec3) -> f64 {
        let chest = self.chest;
        if chest.thorax.body(y) > 1.0 {
            return AIR_HU;
        }
        let (x, density) = self.map.at(y);
        let [lung_mm, fissure_mm] = self.shapes.at(y);
        let in_lung = coverage(lung_mm);
        let mut value = if in_lung < 1.0 { chest.thorax.solid(x, y, lung_mm) } else { 0.0 };
        if in_lung > 0.0 {
            let mut tissue = self.parenchyma(x, density);
            tissue += (FISSURE_HU - tissue) * coverage(fissure_mm.abs() - FISSURE_MM);
            value += (tissue - value) * in_lung;
        }
        if lung_mm < HILUM_MM {
            value += (VESSEL_HU - value) * coverage(chest.vessels.distance(x));
        }
        let (lumen_mm, thickness_mm) = self.wall.at(y);
        if lumen_mm < KNOWN_MM {
            value += (WALL_HU - value) * coverage(lumen_mm - thickness_mm);
            value += (LUMEN_HU - value) * coverage(lumen_mm);
        }
        value
    }
}
