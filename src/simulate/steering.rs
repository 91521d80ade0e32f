//! How the scope is steered: where it is about the route at any time, and how far along the route.
//!
//! Each degree of freedom is a [`Wander`], a sum of sines of seeded frequencies from .05 to 1 Hz, squashed smoothly into
//! its limit. The room sideways is a part of the distance to the nearest wall, so the camera stays inside of the
//! sphere that fits into the lumen there: inside at every phase, without a test for collisions.

use glam::{DAffine3, DMat3, DVec2, DVec3};

use crate::airway::case::SteeringSettings;
use crate::base::random::{CounterRng, Stage};

/// Bands in Hz from each of which a sine's frequency is drawn, and its amplitude: a hand is slow.
const BANDS: [([f64; 2], f64); 5] =
    [([0.05, 0.1], 1.0), ([0.1, 0.2], 1.0), ([0.2, 0.35], 0.7), ([0.35, 0.6], 0.4), ([0.6, 1.0], 0.2)];
/// Time step of the integrated way in seconds, and the time kept before the first and after the last frame.
const STEP_S: f64 = 0.005;
const MARGIN_S: f64 = 1.0;
/// Below this part of the mean speed the scope rests.
const REST: f64 = 0.25;
/// It goes back at no more than this part of the mean speed.
const FASTEST_RETREAT: f64 = 0.6;

/// A smooth seeded signal of zero mean and unit variance.
#[derive(Clone, Copy, Debug)]
struct Wander([(f64, f64, f64); BANDS.len()]);

impl Wander {
    fn new(seed: u64, degree: Degree) -> Self {
        let mut random = CounterRng::new(seed, Stage::Steering, &[degree as u64]);
        let power: f64 = BANDS.iter().map(|(_, amplitude)| 0.5 * amplitude * amplitude).sum();
        Wander(BANDS.map(|([low, high], amplitude)| {
            let rate = std::f64::consts::TAU * random.range(low, high);
            (rate, random.range(0.0, std::f64::consts::TAU), amplitude / power.sqrt())
        }))
    }

    fn at(&self, time_s: f64) -> f64 {
        self.0.iter().map(|(rate, phase, amplitude)| amplitude * (rate * time_s + phase).sin()).sum()
    }
}

/// What is steered; each has its own stream of random numbers.
#[derive(Clone, Copy, Debug)]
enum Degree {
    Right,
    Down,
    Pan,
    Nod,
    Roll,
    Speed,
}

/// The steering of one film.
#[derive(Clone, Debug)]
pub(super) struct Steering {
    settings: SteeringSettings,
    sideways: [Wander; 2],
    tilt: [Wander; 2],
    roll: Wander,
    /// Way in mm at every [`STEP_S`] from [`MARGIN_S`] before the first frame on; 0 at the first frame.
    way_mm: Vec<f64>,
}

impl Steering {
    /// For a film of `duration_s` at a mean speed of `speed_mm_per_s` (before rests and retreats).
    pub(super) fn new(settings: SteeringSettings, speed_mm_per_s: f64, duration_s: f64, seed: u64) -> Self {
        let wander = |degree| Wander::new(seed, degree);
        let speed = wander(Degree::Speed);
        let steps = ((duration_s + 2.0 * MARGIN_S) / STEP_S).ceil() as usize + 1;
        let velocity = |step: usize| {
            let wanted = 1.0 + settings.speed_variation * speed.at(step as f64 * STEP_S - MARGIN_S);
            let rest = REST * settings.speed_variation.min(1.0);
            let moving = (wanted.abs() - rest).max(0.0).copysign(wanted);
            speed_mm_per_s * moving.max(-FASTEST_RETREAT)
        };
        let mut way_mm = vec![0.0];
        for step in 1..steps {
            way_mm.push(way_mm[step - 1] + STEP_S * 0.5 * (velocity(step - 1) + velocity(step)));
        }
        let mut steering = Steering {
            settings,
            sideways: [Degree::Right, Degree::Down].map(wander),
            tilt: [Degree::Pan, Degree::Nod].map(wander),
            roll: wander(Degree::Roll),
            way_mm,
        };
        let start = steering.way_mm(0.0);
        steering.way_mm.iter_mut().for_each(|way| *way -= start);
        steering
    }

    /// Way along the route since the first frame, mm.
    pub(super) fn way_mm(&self, time_s: f64) -> f64 {
        let place = ((time_s + MARGIN_S) / STEP_S).clamp(0.0, (self.way_mm.len() - 1) as f64);
        let step = (place.floor() as usize).min(self.way_mm.len() - 2);
        let part = place - step as f64;
        self.way_mm[step] * (1.0 - part) + self.way_mm[step + 1] * part
    }

    /// Smallest and largest way at the times from 0 to `duration_s`, mm.
    pub(super) fn extent_mm(&self, duration_s: f64) -> [f64; 2] {
        let inside = |step: &usize| (0.0..=duration_s).contains(&(*step as f64 * STEP_S - MARGIN_S));
        let steps = (0..self.way_mm.len()).filter(inside).map(|step| self.way_mm[step]);
        steps.fold([0.0, 0.0], |[low, high], way| [low.min(way), high.max(way)])
    }

    /// `on_route` (world from camera, on the middle of the airway) as the hand has it at `time_s`, where the wall is
    /// `room_mm` away from the middle.
    pub(super) fn steered(&self, on_route: &DAffine3, room_mm: f64, time_s: f64) -> DAffine3 {
        let s = &self.settings;
        let sideways = squashed(self.sideways.map(|w| w.at(time_s))) * s.sideways * room_mm;
        let [pan, nod] = (squashed(self.tilt.map(|w| w.at(time_s))) * s.tilt_deg.to_radians()).to_array();
        let roll = squashed([self.roll.at(time_s), 0.0]).x * s.roll_deg.to_radians();
        let tilt = DVec3::new(nod, pan, 0.0);
        let turned = DMat3::from_quat(glam::DQuat::from_scaled_axis(tilt)) * DMat3::from_rotation_z(roll);
        DAffine3 {
            matrix3: on_route.matrix3 * turned,
            translation: on_route.translation + on_route.matrix3 * sideways.extend(0.0),
        }
    }
}

/// A point of the plane, pulled smoothly into the unit disc.
fn squashed(point: [f64; 2]) -> DVec2 {
    let point = DVec2::from(point);
    point / (1.0 + point.length_squared()).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hand_stays_in_its_limits_moves_smoothly_and_uses_its_room() {
        let settings = SteeringSettings::default();
        for seed in 0..20 {
            let steering = Steering::new(settings, 10.0, 30.0, seed);
            let poses: Vec<DAffine3> =
                (0..3000).map(|i| steering.steered(&DAffine3::IDENTITY, 5.0, i as f64 * 0.01)).collect();
            let sideways = |pose: &DAffine3| pose.translation.length();
            let tilt = |pose: &DAffine3| pose.matrix3.z_axis.z.acos().to_degrees();
            assert!(poses.iter().all(|p| sideways(p) < 3.0 && p.translation.z == 0.0 && tilt(p) < 20.0));
            assert!(poses.iter().any(|p| sideways(p) > 2.0) && poses.iter().any(|p| tilt(p) > 14.0), "seed {seed}");
            let jump = |w: &[DAffine3]| w[0].translation.distance(w[1].translation);
            assert!(poses.windows(2).all(|w| jump(w) < 0.15));
            for pose in &poses {
                let off = pose.matrix3 * pose.matrix3.transpose() - DMat3::IDENTITY;
                assert!(off.to_cols_array().iter().all(|v| v.abs() < 1e-12));
            }
        }
    }

    #[test]
    fn it_rests_and_goes_back_at_times_but_gets_on() {
        let (mut rests, mut retreats, mut speed) = (0, 0, 0.0);
        for seed in 0..50 {
            let steering = Steering::new(SteeringSettings::default(), 10.0, 20.0, seed);
            assert_eq!(steering.way_mm(0.0), 0.0);
            let [low, high] = steering.extent_mm(20.0);
            for i in 0..400 {
                let (before, after) = (steering.way_mm(i as f64 * 0.05), steering.way_mm((i + 1) as f64 * 0.05));
                assert!(low <= before && before <= high && after - before > -0.05 * 10.0 * FASTEST_RETREAT - 1e-9);
                rests += usize::from(before == after);
                retreats += usize::from(after < before);
            }
            speed += steering.way_mm(20.0) / 20.0 / 50.0;
        }
        assert!(rests > 500 && retreats > 500, "{rests} rests, {retreats} steps back");
        assert!((5.0..15.0).contains(&speed), "{speed} mm/s");
    }

    #[test]
    fn without_steering_the_route_is_left_as_it_is() {
        let steering = Steering::new(SteeringSettings::NONE, 8.0, 10.0, 3);
        assert_eq!(steering.steered(&DAffine3::IDENTITY, 5.0, 2.7), DAffine3::IDENTITY);
        assert!((steering.way_mm(7.3) - 58.4).abs() < 1e-9);
        assert_eq!(steering.extent_mm(10.0)[0], 0.0);
    }
}
