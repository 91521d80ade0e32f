//! Where the tissue that a scanner meets at full expiration was at full inspiration.
//!
//! U(x) = x + u(x), with u the case's breathing field, carries the whole body but for the chest wall. Around the airway
//! its own narrowing is added, r_j = e_j - U(v_j) at the vertices v_j with ends e_j, averaged near them and fading away
//! from them:
//!
//!   psi(y) = U^-1(y - r(y)).
//!
//! U^-1 by Newton's method; it is sampled on nodes, and everybody reads it there, so the truth is that of the picture
//! to the last digit. The way forward, phi = psi^-1, is found by fixed-point iteration.

use glam::{DMat3, DVec3};

use super::node_grid::NodeGrid;
use crate::airway::Anatomy;
use crate::airway::field::BreathingField;
use crate::airway::field_fit::{FitSettings, choose_centers, fit};
use crate::airway::nearest_points::NearestPoints;
use crate::base::{Error, Result};
use crate::formats::landmarks::LandmarkPair;

/// Spacing of the nodes in mm; the field's own centres are softened over 15 mm.
pub const NODES_MM: f64 = 2.5;
/// The narrowing is whole up to this distance in mm from the wall, and ends at the second.
const FADE_MM: [f64; 2] = [2.0, 10.0];
/// Vertices that the narrowing is averaged over, and their reach in mm.
const AVERAGED: usize = 24;
/// Newton steps and fixed-point steps, and the accuracy in mm at which they end.
const NEWTON_STEPS: usize = 30;
const FORWARD_STEPS: usize = 200;
const ACCURACY_MM: f64 = 1e-6;
/// Fit of a field to a registered pair of surfaces: points, centres, their spacing and reach in mm, softening in mm,
/// and least smoothing.
const FIT: (usize, usize, f64, f64, f64, f64) = (2500, 90, 12.0, 15.0, 12.0, 0.01);

/// The field of a case whose file has none: fitted to the two surfaces.
pub fn field_of_pair(anatomy: &Anatomy) -> Result<BreathingField> {
    let (points, centers, spacing, reach, softening_mm, least) = FIT;
    let step = (anatomy.inspiration.vertices.len() / points).max(1);
    let pairs: Vec<LandmarkPair> = anatomy
        .inspiration
        .vertices
        .iter()
        .zip(&anatomy.expiration.vertices)
        .step_by(step)
        .map(|(&inspiration_mm, &expiration_mm)| LandmarkPair { inspiration_mm, expiration_mm })
        .collect();
    let near: Vec<DVec3> = pairs.iter().map(|p| p.inspiration_mm).collect();
    let settings = FitSettings {
        source: "fitted to the two surfaces".to_owned(),
        centers_mm: choose_centers(&near, spacing, reach, centers),
        softening_mm,
        anchors: vec![],
    };
    Ok(fit(&pairs, &settings, least)?.0)
}

/// The motion of a body between the breath holds.
pub struct BodyMotion {
    field: BreathingField,
    wall: NearestPoints,
    ends: Vec<DVec3>,
    narrowing: Vec<DVec3>,
}

impl BodyMotion {
    /// Of an airway and the field that moves it.
    pub fn new(anatomy: &Anatomy, field: &BreathingField) -> Result<BodyMotion> {
        let ends = anatomy.expiration.vertices.clone();
        let narrowing = anatomy.inspiration.vertices.iter().zip(&ends);
        let narrowing = narrowing.map(|(v, e)| *e - *v - field.displacement(*v)).collect();
        Ok(BodyMotion { field: field.clone(), wall: NearestPoints::new(&ends)?, ends, narrowing })
    }

    /// r(y) in mm.
    fn narrowing(&self, y: DVec3) -> DVec3 {
        if self.wall.nearest(y).1 > FADE_MM[1] {
            return DVec3::ZERO;
        }
        let near = self.wall.several(y, AVERAGED.min(self.ends.len()));
        let Some(&(_, least)) = near.first() else { return DVec3::ZERO };
        let reach = near.last().map_or(least, |n| n.1) + 1e-6;
        let (mut sum, mut total) = (DVec3::ZERO, 0.0);
        for (vertex, distance) in near {
            let weight = (1.0 - (distance / reach).powi(2)).powi(2);
            sum += self.narrowing[vertex] * weight;
            total += weight;
        }
        let t = ((FADE_MM[1] - least) / (FADE_MM[1] - FADE_MM[0])).clamp(0.0, 1.0);
        if total > 0.0 { sum / total * (t * t * (3.0 - 2.0 * t)) } else { DVec3::ZERO }
    }

    /// psi(y). Errors: a field that has no inverse there.
    pub fn tissue(&self, y: DVec3) -> Result<DVec3> {
        let wanted = y - self.narrowing(y);
        let mut x = wanted - self.field.displacement(wanted);
        for _ in 0..NEWTON_STEPS {
            let miss = x + self.field.displacement(x) - wanted;
            if miss.length() < ACCURACY_MM {
                return Ok(x);
            }
            let slope = DMat3::IDENTITY + self.field.gradient(x);
            if slope.determinant() < 0.05 {
                break;
            }
            x -= slope.inverse() * miss;
        }
        Err(Error::input(format!("folds space near {:.0} {:.0} {:.0} mm", y.x, y.y, y.z)).element("breathing.field"))
    }
}

/// psi on nodes: displacement psi(y) - y in mm, and the determinant of its gradient (how much denser tissue is at y).
pub struct TissueMap {
    nodes: NodeGrid<4>,
}

impl TissueMap {
    /// The identity: full inspiration.
    pub fn still(low: DVec3, high: DVec3) -> TissueMap {
        TissueMap { nodes: NodeGrid::sampled(low, high, (high - low).max_element(), |_| [0.0, 0.0, 0.0, 1.0]) }
    }

    /// That of `motion` in the box from `low` to `high`, with the number of nodes near the body's rim at which it
    /// cannot be inverted; those stay where they are.
    pub fn moving(motion: &BodyMotion, low: DVec3, high: DVec3) -> (TissueMap, usize) {
        let lost = std::sync::atomic::AtomicUsize::new(0);
        let places = NodeGrid::sampled(low, high, NODES_MM, |y| match motion.tissue(y) {
            Ok(x) => (x - y).to_array(),
            Err(_) => {
                lost.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
                [0.0; 3]
            }
        });
        let psi = |y: DVec3| y + DVec3::from_array(places.at(y));
        let nodes = NodeGrid::sampled(low, high, NODES_MM, |y| {
            let along = |axis: DVec3| (psi(y + axis * NODES_MM) - psi(y - axis * NODES_MM)) / (2.0 * NODES_MM);
            let density = DMat3::from_cols(along(DVec3::X), along(DVec3::Y), along(DVec3::Z)).determinant();
            let [x, y, z] = places.at(y);
            [x, y, z, density]
        });
        (TissueMap { nodes }, lost.into_inner())
    }

    /// psi(y) in mm and the density there over that at full inspiration.
    pub fn at(&self, y: DVec3) -> (DVec3, f64) {
        let [dx, dy, dz, density] = self.nodes.at(y);
        (y + DVec3::new(dx, dy, dz), density)
    }

    /// phi(x): where the tissue at x is. y <- y + (x - psi(y)), damped.
    pub fn forward(&self, x: DVec3) -> DVec3 {
        let mut y = x;
        for _ in 0..FORWARD_STEPS {
            let step = x - self.at(y).0;
            y += step * 0.8;
            if step.length() < ACCURACY_MM {
                break;
            }
        }
        y
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A body that shrinks evenly: density is that of the closed form, and there and back is the start.
    #[test]
    fn an_even_breath_has_the_density_of_its_determinant() {
        let field = BreathingField {
            source: String::new(),
            scale: 1.0,
            softening_mm: 10.0,
            origin_mm: [0.0; 3],
            affine: [[1.0, -5.0, 0.0, 0.0], [0.0, 0.0, -8.0, 1.0], [9.0, 0.0, 0.0, -20.0]],
            centers: vec![],
        };
        let motion = BodyMotion {
            field: field.clone(),
            wall: NearestPoints::new(&[DVec3::splat(1e4)]).unwrap(),
            ends: vec![DVec3::splat(1e4)],
            narrowing: vec![DVec3::ZERO],
        };
        let (map, lost) = TissueMap::moving(&motion, DVec3::splat(-30.0), DVec3::splat(40.0));
        assert_eq!(lost, 0);
        let truth = 1.0 / (0.95 * (0.92 * 0.8));
        for place in [DVec3::ZERO, DVec3::new(7.0, -12.0, 20.0)] {
            let (x, density) = map.at(place);
            assert!((density - truth).abs() < 1e-4, "{density} {truth}");
            assert!((x + field.displacement(x) - place).length() < 1e-4);
            assert!((map.forward(x) - place).length() < 1e-4);
        }
        let still = TissueMap::still(DVec3::ZERO, DVec3::splat(9.0));
        assert_eq!(still.at(DVec3::splat(3.0)), (DVec3::splat(3.0), 1.0));
    }
}
