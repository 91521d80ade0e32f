//! A touch of the wall, once a film: the tip drifts across the lumen until the lens nearly lies on the mucosa, turns
//! towards it, rests there and comes back. What the picture then shows (red, bright, out of focus) is rendered, not
//! painted. The tip stops short of the wall along the ray that leads to it, so that it stays in the lumen.

use glam::{DAffine3, DMat3, DQuat, DVec3};

use crate::base::random::{CounterRng, Stage};

/// Gap in mm that is left between lens and wall.
const GAP_MM: f64 = 0.6;
/// Longest way across the lumen, mm.
const MOST_WAY_MM: f64 = 8.0;
/// How far the tip turns towards the wall, degrees.
const TURN_DEG: f64 = 50.0;
/// Seconds in which it gets there, and back.
const APPROACH_S: f64 = 0.35;
/// A touch falls into this part of the film.
const PART: [f64; 2] = [0.3, 0.5];

/// The touch of one film.
#[derive(Clone, Debug)]
pub struct WallContact {
    /// Middle of the touch, seconds after the start.
    pub middle_s: f64,
    half_s: f64,
    /// Direction across the lumen in the route's frame: x right, y down.
    across: DVec3,
    frames_per_second: f64,
    /// Way across the lumen at every frame, mm; known once the film is planned.
    way_mm: Vec<f64>,
}

impl WallContact {
    /// For a film of `duration_s`; `None` without a touch.
    pub fn new(contact_s: f64, duration_s: f64, frames_per_second: f64, seed: u64) -> Option<WallContact> {
        let mut random = CounterRng::new(seed, Stage::Clinical, &[6]);
        let middle_s = duration_s * random.range(PART[0], PART[1]);
        let angle = random.range(0.0, std::f64::consts::TAU);
        let across = DVec3::new(angle.cos(), angle.sin(), 0.0);
        (contact_s > 0.0).then(|| WallContact {
            middle_s,
            half_s: 0.5 * contact_s,
            across,
            frames_per_second,
            way_mm: Vec::new(),
        })
    }

    /// How far the tip has given way, 0 to 1: smooth in time.
    pub fn weight(&self, time_s: f64) -> f64 {
        let t = ((self.half_s + APPROACH_S - (time_s - self.middle_s).abs()) / APPROACH_S).clamp(0.0, 1.0);
        t * t * (3.0 - 2.0 * t)
    }

    /// Direction in the world in which the tip drifts, `on_route` being the pose on the middle of the airway.
    pub fn direction(&self, on_route: &DAffine3) -> DVec3 {
        (on_route.matrix3 * self.across).normalize()
    }

    /// Takes down how far the wall is along that direction at the next frame.
    pub fn record(&mut self, wall_mm: f64) {
        let free = if wall_mm.is_finite() { wall_mm } else { 0.0 };
        self.way_mm.push((free - GAP_MM).max(0.3 * free).min(MOST_WAY_MM));
    }

    /// `steered` (world from camera) as the touch has it at `time_s`.
    pub fn touched(&self, on_route: &DAffine3, steered: &DAffine3, time_s: f64) -> DAffine3 {
        let weight = self.weight(time_s);
        if weight <= 0.0 || self.way_mm.is_empty() {
            return *steered;
        }
        let place = (time_s * self.frames_per_second).clamp(0.0, (self.way_mm.len() - 1) as f64);
        let (low, high) = (place.floor() as usize, place.ceil() as usize);
        let way_mm = self.way_mm[low] + (self.way_mm[high] - self.way_mm[low]) * (place - low as f64);
        let across = on_route.matrix3 * self.across;
        let at_wall = on_route.translation + across * way_mm;
        // The steered scope is rolled against its route.
        let axis = DVec3::Z.cross(steered.matrix3.transpose() * across).normalize_or(DVec3::X);
        let turn = DMat3::from_quat(DQuat::from_axis_angle(axis, (weight * TURN_DEG).to_radians()));
        DAffine3 { matrix3: steered.matrix3 * turn, translation: steered.translation.lerp(at_wall, weight) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tip_goes_to_the_wall_and_comes_back_smoothly() {
        let mut contact = WallContact::new(0.6, 16.0, 25.0, 3).unwrap();
        (0..400).for_each(|_| contact.record(6.0));
        let places: Vec<DAffine3> =
            (0..4000).map(|i| contact.touched(&DAffine3::IDENTITY, &DAffine3::IDENTITY, i as f64 * 0.004)).collect();
        let farthest = places.iter().map(|p| p.translation.length()).fold(0.0, f64::max);
        assert!((farthest - 5.4).abs() < 1e-9, "{farthest}");
        assert!(places.windows(2).all(|w| w[0].translation.distance(w[1].translation) < 0.12));
        let away = places.iter().filter(|p| p.translation.length() > 0.0).count() as f64 * 0.004;
        assert!((away - 1.3).abs() < 0.02, "{away} s");
        let at_wall = contact.touched(&DAffine3::IDENTITY, &DAffine3::IDENTITY, contact.middle_s);
        assert!(at_wall.matrix3.z_axis.dot(contact.across) > 0.7, "it looks at the wall");
        assert!((at_wall.matrix3 * at_wall.matrix3.transpose()).abs_diff_eq(DMat3::IDENTITY, 1e-12));
        assert!(WallContact::new(0.0, 16.0, 25.0, 3).is_none());
    }

    #[test]
    fn a_rolled_tip_turns_to_the_wall_that_it_drifts_to() {
        let mut contact = WallContact::new(0.6, 16.0, 25.0, 3).unwrap();
        (0..400).for_each(|_| contact.record(6.0));
        let on_route = DAffine3::from_mat3(DMat3::from_rotation_y(0.4));
        for roll_deg in [25f64, 90.0, 180.0] {
            let steered = on_route * DAffine3::from_mat3(DMat3::from_rotation_z(roll_deg.to_radians()));
            let touched = contact.touched(&on_route, &steered, contact.middle_s);
            let towards = contact.direction(&on_route);
            assert!((touched.translation.normalize() - towards).length() < 1e-9);
            assert!((touched.matrix3.z_axis.dot(towards) - TURN_DEG.to_radians().sin()).abs() < 1e-9, "{roll_deg}");
        }
    }
}
