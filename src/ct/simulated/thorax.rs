//! A chest around an airway, of smooth implicit shapes: lungs, fissures, mediastinum, heart, diaphragm, bones, fat, skin.
//!
//! All functions are signed distances in mm, or nearly so: negative inside. Lungs, heart and great vessels are given at
//! full inspiration, in coordinates of the tissue. Ribs, spine and skin stay where they are while the lungs slide along
//! them; ribs follow the lungs' surface at a fixed depth, as they do when a chest falls in. The box of the lungs is that
//! of the airway and of the field's centres, which lie among the landmarks of a real lung.

use glam::{DVec2, DVec3};

use crate::airway::centerline::Centerline;
use crate::airway::field::BreathingField;
use crate::airway::nearest_points::NearestPoints;
use crate::base::{Error, Result};

/// Room in mm between the outermost centres or airways and the pleura.
const PLEURA_MM: [f64; 2] = [10.0, 16.0];
/// Lung around every airway from generation 2 on, and mediastinum around the trachea and the main bronchi, mm.
const LUNG_AROUND_MM: f64 = 11.0;
const HILUM_MM: f64 = 7.0;
/// Thickness of the chest wall in mm: to the sides, and front and back.
const WALL_MM: [f64; 2] = [30.0, 26.0];
/// Of it fat and skin, mm.
const FAT_MM: f64 = 11.0;
const SKIN_MM: f64 = 2.0;
/// Domes of the diaphragm: height in mm right and left, and half width over that of the chest.
const DOME_MM: [f64; 2] = [42.0, 34.0];
const DOME_WIDTH: f64 = 0.6;
/// Ribs: distance along the spine, fall from back to front per mm, half height, depth and half depth in mm.
const RIB_STEP_MM: f64 = 27.0;
const RIB_FALL: f64 = 0.42;
const RIB_MM: [f64; 3] = [6.0, 7.0, 4.0];
/// Vertebrae: radius, height with the disc, half height of the disc, distance of the middle behind the carina, mm.
const VERTEBRA_MM: [f64; 4] = [17.0, 25.0, 3.0, 34.0];
/// HU of tissues.
const MUSCLE_HU: f64 = 50.0;
const FAT_HU: f64 = -95.0;
const SKIN_HU: f64 = 15.0;
const HEART_HU: f64 = 42.0;
const LIVER_HU: f64 = 58.0;
const SPONGY_BONE_HU: f64 = 210.0;
const HARD_BONE_HU: f64 = 650.0;
const DISC_HU: f64 = 85.0;
const MEDIASTINUM_HU: f64 = -70.0;
/// HU outside of the body.
pub const AIR_HU: f64 = -1000.0;
/// Least slope of the difference of the distances to two lobes at which there is a fissure between them.
const FLATTEST: f64 = 0.3;
/// Far from everything, mm.
const FAR_MM: f64 = 1e3;

/// 1 inside of a shape at distance `mm`, 0 outside, smooth over half a millimetre on both sides: what a voxel holds.
pub fn coverage(mm: f64) -> f64 {
    let t = (0.5 - mm / (2.0 * EDGE_MM)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Half width in mm of [`coverage`].
const EDGE_MM: f64 = 0.55;
/// Standard deviation in mm of the blur that [`coverage`] is: half width times the root of 1/5.
pub const EDGE_DEVIATION_MM: f64 = EDGE_MM * 0.447_213_6;

/// Radius over which a point is outside of an oval, as a signed distance along the ray from its middle: between ellipse
/// and superellipse of power 4, which is how chests are cut.
fn oval(offset: DVec2, half: DVec2) -> f64 {
    let p = (offset / half) * (offset / half);
    let n = (0.5 * (p.x + p.y) + 0.5 * (p.x * p.x + p.y * p.y).sqrt()).sqrt();
    if n < 1e-3 { -half.min_element() } else { offset.length() * (1.0 - 1.0 / n) }
}

fn ellipsoid(offset: DVec3, half: DVec3) -> f64 {
    let n = (offset / half).length();
    if n < 1e-3 { -half.min_element() } else { offset.length() * (1.0 - 1.0 / n) }
}

fn tube(p: DVec3, a: DVec3, b: DVec3, radius_mm: f64) -> f64 {
    let along = ((p - a).dot(b - a) / (b - a).length_squared()).clamp(0.0, 1.0);
    p.distance(a.lerp(b, along)) - radius_mm
}

/// Points of a part of the airway with their radii.
struct AirwayPart {
    points: NearestPoints,
    places: Vec<DVec3>,
    radii_mm: Vec<f64>,
}

impl AirwayPart {
    fn new(line: &Centerline, wanted: impl Fn(usize) -> bool) -> Result<Option<AirwayPart>> {
        let chosen: Vec<usize> = (0..line.points.len()).filter(|&k| wanted(k)).collect();
        if chosen.is_empty() {
            return Ok(None);
        }
        let places: Vec<DVec3> = chosen.iter().map(|&k| line.points[k].position_mm).collect();
        let radii_mm = chosen.iter().map(|&k| line.points[k].radius_mm).collect();
        Ok(Some(AirwayPart { points: NearestPoints::new(&places)?, places, radii_mm }))
    }

    /// Distance to its lumen, nearly.
    fn distance(&self, place: DVec3) -> f64 {
        let (nearest, distance) = self.points.nearest(place);
        distance - self.radii_mm[nearest]
    }

    /// Distance to its lumen, nearly, and the unit vector away from it.
    fn away(&self, place: DVec3) -> (f64, DVec3) {
        let (nearest, distance) = self.points.nearest(place);
        (distance - self.radii_mm[nearest], (place - self.places[nearest]).normalize_or_zero())
    }
}

/// The chest of one patient.
pub struct Thorax {
    low: DVec3,
    high: DVec3,
    carina: DVec3,
    central: AirwayPart,
    distal: Option<AirwayPart>,
    /// Upper lobe and the rest, right lung first.
    lobes: [[Option<AirwayPart>; 2]; 2],
}

/// The lung's box, and which lobe each point of the centreline goes to: 2 * side + (0 upper, 1 the rest).
fn lobe_of_points(line: &Centerline, carina: DVec3) -> Vec<Option<usize>> {
    // The subtree of each branch of generation 2.
    let mut root = vec![None::<usize>; line.points.len()];
    for (k, point) in line.points.iter().enumerate() {
        let before = point.parent.map(|p| p as usize);
        root[k] = match (point.generation, before) {
            (0 | 1, _) | (_, None) => None,
            (2, Some(b)) => root[b].filter(|&r| line.points[r].branch == point.branch).or(Some(k)),
            (_, Some(b)) => root[b].or(Some(k)),
        };
    }
    let mut roots: Vec<usize> = root.iter().flatten().copied().collect();
    roots.sort_unstable();
    roots.dedup();
    let members = |r: usize| root.iter().enumerate().filter(move |(_, own)| **own == Some(r)).map(|(k, _)| k);
    let mean = |r: usize| {
        let count = members(r).count().max(1) as f64;
        members(r).map(|k| line.points[k].position_mm).sum::<DVec3>() / count
    };
    let means: Vec<(usize, DVec3)> = roots.iter().map(|&r| (r, mean(r))).collect();
    let side = |m: &DVec3| usize::from(m.x > carina.x);
    let highest = [0, 1].map(|s| {
        let of_side = means.iter().filter(|(_, m)| side(m) == s);
        of_side.max_by(|a, b| a.1.z.total_cmp(&b.1.z)).map(|(r, _)| *r)
    });
    let lobe = |r: usize| {
        let s = means.iter().find(|(k, _)| *k == r).map_or(0, |(_, m)| side(m));
        2 * s + usize::from(highest[s] != Some(r))
    };
    root.iter().map(|r| r.map(lobe)).collect()
}

impl Thorax {
    /// Around an airway and, where it is known, the region that a field was measured in.
    ///
    /// Errors: an airway without a trachea.
    pub fn new(line: &Centerline, field: &BreathingField) -> Result<Thorax> {
        let no_trachea = || Error::input("the centreline has no trachea: no points of generation 0");
        let carina = line.carina_mm().ok_or_else(no_trachea)?;
        let mut low = DVec3::splat(f64::INFINITY);
        let mut high = -low;
        let mut cover = |p: DVec3, room: f64| {
            low = low.min(p - room);
            high = high.max(p + room);
        };
        line.points.iter().filter(|p| p.generation > 0).for_each(|p| cover(p.position_mm, PLEURA_MM[1]));
        let origin = DVec3::from_array(field.origin_mm);
        field.centers.iter().for_each(|c| cover(origin + DVec3::new(c[0], c[1], c[2]), PLEURA_MM[0]));
        // The domes of the diaphragm rise into the box.
        low.z -= 8.0;
        let lobe = lobe_of_points(line, carina);
        let part = |wanted: usize| AirwayPart::new(line, |k| lobe[k] == Some(wanted));
        Ok(Thorax {
            low,
            high,
            carina,
            central: AirwayPart::new(line, |k| line.points[k].generation < 2)?.ok_or_else(no_trachea)?,
            distal: AirwayPart::new(line, |k| line.points[k].generation >= 2)?,
            lobes: [[part(0)?, part(1)?], [part(2)?, part(3)?]],
        })
    }

    /// Lowest and highest corner in mm of the box around the lungs.
    pub fn lungs_box(&self) -> (DVec3, DVec3) {
        (self.low, self.high)
    }

    /// Lowest and highest corner in mm of the box around the body, in the height of the lungs.
    pub fn body_box(&self) -> (DVec3, DVec3) {
        let (middle, half) = self.body_oval();
        let edge = DVec3::new(half.x, half.y, 0.0);
        (middle.extend(self.low.z) - edge, middle.extend(self.high.z) + edge)
    }

    /// Where the trachea divides, mm.
    pub fn carina(&self) -> DVec3 {
        self.carina
    }

    fn body_oval(&self) -> (DVec2, DVec2) {
        let (low, high) = (self.low.truncate(), self.high.truncate());
        ((low + high) / 2.0, (high - low) / 2.0 + DVec2::new(WALL_MM[0], WALL_MM[1]))
    }

    /// Signed distance to the skin at a place of the room.
    pub fn body(&self, y: DVec3) -> f64 {
        let (middle, half) = self.body_oval();
        oval(y.truncate() - middle, half)
    }

    /// Whether tissue at `x` is chest wall, which stays where it is.
    pub fn is_wall(&self, x: DVec3) -> bool {
        self.cage(x) > 1.0
    }

    /// The rib cage from inside: an oval cylinder with a dome on it.
    fn cage(&self, x: DVec3) -> f64 {
        let middle = (self.low + self.high) / 2.0;
        let half = (self.high - self.low) / 2.0;
        let height = ((x.z - self.low.z) / (self.high.z - self.low.z)).clamp(0.0, 1.0);
        let narrowing = ((height - 0.35) / 0.65).max(0.0);
        let width = (1.0 - narrowing.powi(3)).max(0.0).sqrt().max(0.02);
        oval((x - middle).truncate(), half.truncate() * width).max(x.z - self.high.z)
    }

    fn diaphragm(&self, x: DVec3) -> f64 {
        let half = (self.high - self.low) / 2.0;
        let middle_y = (self.low.y + self.high.y) / 2.0 - 0.12 * half.y;
        let mut height = 0.0f64;
        for (side, tall) in [(-1.0, DOME_MM[0]), (1.0, DOME_MM[1])] {
            let off = DVec2::new(x.x - self.carina.x - side * 0.5 * half.x, x.y - middle_y);
            let n = (off / (half.truncate() * DVec2::new(DOME_WIDTH, 0.85))).length_squared();
            height = height.max(tall * (1.0 - n).max(0.0));
        }
        (self.low.z + height - x.z) * 0.8
    }

    fn spine_middle(&self) -> DVec2 {
        let y = (self.carina.y + VERTEBRA_MM[3]).min(self.high.y - VERTEBRA_MM[0] + 6.0);
        DVec2::new(self.carina.x, y)
    }

    fn heart(&self, x: DVec3) -> f64 {
        ellipsoid(x - self.carina - DVec3::new(20.0, -34.0, -68.0), DVec3::new(50.0, 36.0, 46.0))
    }

    /// Aorta and the pulmonary trunk.
    fn great_vessels(&self, x: DVec3) -> f64 {
        let at = |dx: f64, dy: f64, dz: f64| self.carina + DVec3::new(dx, dy, dz);
        let arch = [
            at(-4.0, -38.0, -40.0),
            at(-6.0, -34.0, 10.0),
            at(2.0, -22.0, 30.0),
            at(16.0, 4.0, 36.0),
            at(24.0, 24.0, 22.0),
            at(25.0, 30.0, -20.0),
            at(22.0, 34.0, -220.0),
        ];
        let aorta = arch.windows(2).map(|pair| tube(x, pair[0], pair[1], 12.0)).fold(FAR_MM, f64::min);
        let trunk = tube(x, at(8.0, -40.0, -40.0), at(14.0, -22.0, -12.0), 11.0);
        let veins = tube(x, at(-22.0, -24.0, 70.0), at(-20.0, -20.0, -40.0), 8.0);
        aorta.min(trunk).min(veins)
    }

    /// What lies between the lungs.
    fn mediastinum(&self, x: DVec3) -> f64 {
        let spine = (x.truncate() - self.spine_middle()).length() - VERTEBRA_MM[0] - 2.0;
        // A sheet from the breastbone to the spine, thin in front.
        let depth = ((x.y - self.low.y) / (self.spine_middle().y - self.low.y)).clamp(0.0, 1.0);
        let sheet = (x.x - self.carina.x).abs() - (4.0 + 15.0 * depth.min(0.75));
        sheet.min(spine).min(self.heart(x) - 4.0).min(self.great_vessels(x) - 3.0)
    }

    /// Signed distance to the lungs at a place of tissue at full inspiration.
    pub fn lung(&self, x: DVec3) -> f64 {
        let cage = self.cage(x).max(self.diaphragm(x));
        if cage > 30.0 {
            return cage;
        }
        let around = self.distal.as_ref().map_or(FAR_MM, |d| d.distance(x)) - LUNG_AROUND_MM;
        let filled = cage.max(-self.mediastinum(x));
        filled.min(around.max(self.cage(x))).max(HILUM_MM - self.central.distance(x))
    }

    /// Signed distance to the oblique fissure of the lung on whose side `x` is: negative in the upper lobe. Far where the
    /// two lobes' airways lie in one direction: no fissure is seen there.
    pub fn fissure(&self, x: DVec3) -> f64 {
        let side = usize::from(x.x > self.carina.x);
        let away = |lobe: usize| self.lobes[side][lobe].as_ref().map(|part| part.away(x));
        match (away(0), away(1)) {
            (Some((upper, from_upper)), Some((rest, from_rest))) => {
                let slope = (0.5 * (from_upper - from_rest)).length();
                let difference = 0.5 * (upper - rest) / slope.max(FLATTEST);
                if slope < FLATTEST { difference.signum() * FAR_MM } else { difference }
            }
            (Some(_), None) => -FAR_MM,
            _ => FAR_MM,
        }
    }

    /// The lobe of a place of tissue in a lung: 1 right upper, 2 right middle and lower, 3 left upper, 4 left lower.
    pub fn lobe(&self, x: DVec3, fissure_mm: f64) -> u8 {
        2 * u8::from(x.x > self.carina.x) + 1 + u8::from(fissure_mm >= 0.0)
    }

    /// HU outside of lungs and airway: of the place `y` in the room and of its tissue `x`, `lung_mm` from the lungs.
    pub fn solid(&self, x: DVec3, y: DVec3, lung_mm: f64) -> f64 {
        let skin = self.body(y);
        if skin > EDGE_MM {
            return AIR_HU;
        }
        let mut value = self.below_skin(x, y, lung_mm, skin);
        // From the muscles outwards: fat, skin, air.
        let fat = coverage(-(skin + FAT_MM)) * coverage(-(lung_mm - 12.0));
        value += (FAT_HU - value) * fat;
        value += (SKIN_HU - value) * coverage(-(skin + SKIN_MM));
        value + (AIR_HU - value) * coverage(-skin)
    }

    fn below_skin(&self, x: DVec3, y: DVec3, lung_mm: f64, skin: f64) -> f64 {
        let mut value = MUSCLE_HU;
        let cage = self.cage(x);
        if self.diaphragm(x) > 0.0 && cage < 3.0 {
            // Right the liver; left stomach and spleen in fat.
            let left = coverage(self.carina.x + 14.0 - x.x);
            let organ = ellipsoid(
                x - DVec3::new(self.high.x - 45.0, self.carina.y + 12.0, self.low.z - 8.0),
                DVec3::new(36.0, 46.0, 40.0),
            );
            let other = FAT_HU + (LIVER_HU - 8.0 - FAT_HU) * coverage(organ);
            value = LIVER_HU + (other - LIVER_HU) * left;
            // The diaphragm itself.
            value += (MUSCLE_HU - value) * coverage(lung_mm - 3.0);
        } else if cage < 0.0 {
            let inner = coverage(self.mediastinum(x) + 2.0);
            value += (MEDIASTINUM_HU - value) * inner;
            value += (HEART_HU - value) * coverage(self.heart(x).min(self.great_vessels(x)));
        }
        let spine = self.spine_middle();
        let from_spine = (y.truncate() - spine).length();
        if from_spine < 60.0 || lung_mm < 14.0 || skin > -24.0 {
            value = self.bones(value, y, lung_mm, from_spine);
        }
        value
    }

    fn bones(&self, soft: f64, y: DVec3, lung_mm: f64, from_spine: f64) -> f64 {
        let mut value = soft;
        let blend = |value: f64, hu: f64, inside: f64| value + (hu - value) * inside;
        // Ribs: an oval across, which runs round the chest and falls to the front.
        let spine = self.spine_middle();
        let rise = y.z + RIB_FALL * (spine.y - y.y);
        let along = (rise / RIB_STEP_MM - (rise / RIB_STEP_MM).floor() - 0.5) * RIB_STEP_MM;
        let is_chest = y.z > self.low.z - 30.0 && self.cage(y) > -14.0 && y.z < self.high.z - 4.0;
        if is_chest && self.diaphragm(y) < 25.0 {
            let off = DVec2::new(along / RIB_MM[0], (lung_mm - RIB_MM[1]) / RIB_MM[2]);
            let rib = (off.length() - 1.0) * RIB_MM[2];
            let marrow = blend(HARD_BONE_HU, SPONGY_BONE_HU, coverage(rib + 1.6));
            value = blend(value, marrow, coverage(rib));
        }
        // The breastbone.
        let front = DVec3::new(self.carina.x, self.low.y - 8.0, y.z);
        let breastbone = oval((y - front).truncate(), DVec2::new(17.0, 6.0)).max(self.low.z + 60.0 - y.z);
        value = blend(value, SPONGY_BONE_HU - 40.0, coverage(breastbone));
        // Vertebrae, discs, the canal behind, and the arch around it.
        let beside = y.truncate() - spine;
        let body = (from_spine - VERTEBRA_MM[0]).max(-FAR_MM);
        let height = (y.z / VERTEBRA_MM[1] - (y.z / VERTEBRA_MM[1]).floor() - 0.5) * VERTEBRA_MM[1];
        let disc = VERTEBRA_MM[1] / 2.0 - height.abs() - VERTEBRA_MM[2];
        let bone = blend(HARD_BONE_HU - 100.0, SPONGY_BONE_HU - 20.0, coverage(body + 1.5) * coverage(1.5 - disc));
        value = blend(value, blend(bone, DISC_HU, coverage(disc)), coverage(body));
        let canal = (beside - DVec2::new(0.0, VERTEBRA_MM[0] + 8.0)).length();
        let arch = ((canal - 11.0).abs() - 2.2).max(-disc - 4.0);
        value = blend(value, HARD_BONE_HU - 150.0, coverage(arch) * coverage(-body));
        value = blend(value, 25.0, coverage(canal - 8.5) * coverage(-body));
        value
    }
}
