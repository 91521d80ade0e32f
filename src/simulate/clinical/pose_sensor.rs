//! The pose that an electromagnetic sensor in the scope's tip tells: late, bent by the field, drifting, noisy.
//!
//!   place(t) = x + g(x) + d(t) + n,  x the true place at t - delay
//!   directions(t) = turn(m) turn(r(t)) turn(curl g(x) / 2) * the true ones at t - delay
//!
//! The field's distortion g is a sum of long plane waves of a stated root mean square; a field that bends positions bends
//! directions with half its curl, so the orientation's error follows from it. The drift d, r is a seeded random walk,
//! smoothed, that begins at 0 (the sensor is registered at the start) and whose largest value over the walk, which
//! goes on for up to a second after the film, is the stated one. Noise n, m is white along and about each axis of the
//! world. Everything is a function of (seed, frame).

use std::f64::consts::TAU;

use glam::{DAffine3, DMat3, DQuat, DVec3};

use crate::airway::case::ClinicalSettings;
use crate::base::random::{CounterRng, Stage};

/// Waves of the field's distortion, and their lengths in mm.
const WAVES: usize = 8;
const WAVE_MM: [f64; 2] = [150.0, 400.0];
/// Steps of the random walk per second, and the steps over which it is averaged.
const WALK_HZ: f64 = 2.0;
const WALK_AVERAGE: usize = 5;

/// The sensor of one film.
#[derive(Clone, Debug)]
pub struct PoseSensor {
    settings: ClinicalSettings,
    seed: u64,
    /// Wave vector, phase and amplitude of each wave.
    waves: Vec<(DVec3, f64, DVec3)>,
    /// Drift at every step of the walk: mm, and radians about the axes of the world.
    drift: Vec<[DVec3; 2]>,
}

/// What the sensor did to one pose: truth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseFault {
    /// The pose that is told.
    pub told: DAffine3,
    /// Drift of the position, mm.
    pub drift_mm: DVec3,
    /// Drift of the orientation, radians about the axes of the world.
    pub drift_rad: DVec3,
    /// Displacement by the field's distortion, mm.
    pub distortion_mm: DVec3,
}

impl PoseSensor {
    /// For a film of `duration_s`; `settings` are the film's own, `seed` the case's.
    pub fn new(settings: &ClinicalSettings, duration_s: f64, seed: u64) -> PoseSensor {
        let sensor = &settings.sensor;
        let mut random = CounterRng::new(seed, Stage::Clinical, &[3]);
        let vector = |random: &mut CounterRng| DVec3::new(random.normal(), random.normal(), random.normal());
        // A wave of amplitude a has the mean square |a|^2 / 2; an amplitude of three normal numbers has the mean square 3.
        let size = sensor.distortion_mm / (1.5 * WAVES as f64).sqrt();
        let waves = (0..WAVES)
            .map(|_| {
                let direction = vector(&mut random).normalize_or(DVec3::X);
                let number = TAU / random.range(WAVE_MM[0], WAVE_MM[1]);
                (direction * number, random.range(0.0, TAU), vector(&mut random) * size)
            })
            .collect();
        let steps = (duration_s * WALK_HZ).ceil() as usize + 2;
        let limits = [sensor.drift_mm, sensor.drift_deg.to_radians()];
        let [shift, turn] = limits.map(|limit| walk(&mut random, steps, limit));
        let drift = shift.into_iter().zip(turn).map(|(mm, rad)| [mm, rad]).collect();
        PoseSensor { settings: settings.clone(), seed, waves, drift }
    }

    /// What is told of the pose at `frame`, `time_s` after the start; `pose_at` is the true pose at any time.
    pub fn told(&self, frame: usize, time_s: f64, pose_at: impl Fn(f64) -> DAffine3) -> PoseFault {
        let sensor = &self.settings.sensor;
        let late = pose_at(time_s - sensor.delay_s);
        // Field, then drift, then noise.
        let place = late.translation;
        let (bend_mm, curl) = self.distortion(place);
        let [drift_mm, drift_rad] = self.drift_at(time_s);
        let mut random = CounterRng::new(self.seed, Stage::Clinical, &[4, frame as u64]);
        let mut noise = |size: f64| DVec3::new(random.normal(), random.normal(), random.normal()) * size;
        let (noise_mm, noise_rad) = (noise(sensor.noise_mm), noise(sensor.noise_deg.to_radians()));
        let turn = turned(noise_rad) * turned(drift_rad) * turned(0.5 * curl);
        let told = DAffine3 { matrix3: turn * late.matrix3, translation: place + bend_mm + drift_mm + noise_mm };
        PoseFault { told, drift_mm, drift_rad, distortion_mm: bend_mm }
    }

    /// Displacement by the field at `place`, and its curl.
    fn distortion(&self, place: DVec3) -> (DVec3, DVec3) {
        let (mut sum, mut curl) = (DVec3::ZERO, DVec3::ZERO);
        for (number, start, amplitude) in &self.waves {
            let (sine, cosine) = (number.dot(place) + start).sin_cos();
            sum += *amplitude * sine;
            curl += number.cross(*amplitude) * cosine;
        }
        (sum, curl)
    }

    fn drift_at(&self, time_s: f64) -> [DVec3; 2] {
        let place = (time_s.max(0.0) * WALK_HZ).min((self.drift.len() - 1) as f64);
        let low = (place.floor() as usize).min(self.drift.len() - 2);
        let t = place - low as f64;
        [0, 1].map(|k| self.drift[low][k].lerp(self.drift[low + 1][k], t))
    }
}

/// A rotation vector as a matrix.
fn turned(vector: DVec3) -> DMat3 {
    DMat3::from_quat(DQuat::from_scaled_axis(vector))
}

/// A smoothed random walk that begins at 0 and whose longest vector has the length `limit`.
fn walk(random: &mut CounterRng, steps: usize, limit: f64) -> Vec<DVec3> {
    let mut place = DVec3::ZERO;
    let rough: Vec<DVec3> = (0..steps + WALK_AVERAGE)
        .map(|_| {
            place += DVec3::new(random.normal(), random.normal(), random.normal());
            place
        })
        .collect();
    let smooth: Vec<DVec3> =
        rough.windows(WALK_AVERAGE).map(|w| w.iter().sum::<DVec3>() / WALK_AVERAGE as f64).take(steps).collect();
    let from = smooth[0];
    let longest = smooth.iter().map(|p| p.distance(from)).fold(0.0, f64::max).max(1e-300);
    smooth.iter().map(|p| (*p - from) * (limit / longest)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::airway::case::Condition;

    fn sensor(only: &[Condition]) -> PoseSensor {
        let settings = ClinicalSettings { only: Some(only.to_vec()), spread: 0.0, ..ClinicalSettings::default() };
        PoseSensor::new(&settings.drawn(9), 16.0, 9)
    }

    fn path(time_s: f64) -> DAffine3 {
        DAffine3::from_translation(DVec3::new(0.0, 2.0, -10.0 * time_s))
    }

    fn errors(sensor: &PoseSensor) -> Vec<(f64, f64)> {
        let one = |i: usize| {
            let (t, told) = (i as f64 * 0.04, sensor.told(i, i as f64 * 0.04, path).told);
            let turn = DQuat::from_mat3(&told.matrix3);
            (told.translation.distance(path(t).translation), turn.xyz().length().min(1.0).asin() * 2.0)
        };
        (0..400).map(one).collect()
    }

    #[test]
    fn without_faults_the_pose_is_the_true_one() {
        assert!(errors(&sensor(&[])).iter().all(|e| *e == (0.0, 0.0)));
    }

    /// Small things that a smooth field carries along are turned by half its curl.
    #[test]
    fn a_field_that_bends_places_turns_directions_by_half_its_curl() {
        let sensor = sensor(&[Condition::FieldDistortion]);
        let place = DVec3::new(20.0, -40.0, 100.0);
        let by = |axis: DVec3| (sensor.distortion(place + axis).0 - sensor.distortion(place - axis).0) / 2.0;
        let (x, y, z) = (by(DVec3::X * 0.1) * 10.0, by(DVec3::Y * 0.1) * 10.0, by(DVec3::Z * 0.1) * 10.0);
        let curl = DVec3::new(y.z - z.y, z.x - x.z, x.y - y.x);
        let told = sensor.told(3, 1.0, |_| DAffine3::from_translation(place)).told;
        let turn = DQuat::from_mat3(&told.matrix3).to_scaled_axis();
        assert!(curl.length() > 1e-3 && turn.distance(0.5 * curl) < 1e-3 * curl.length(), "{turn} {curl}");
    }

    #[test]
    fn every_fault_has_its_stated_size() {
        let rms = |values: &[f64]| (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt();
        let of = |row| -> (Vec<f64>, Vec<f64>) { errors(&sensor(&[row])).into_iter().unzip() };
        let (mm, rad) = of(Condition::PoseNoise);
        assert!((rms(&mm) / (0.3 * 3f64.sqrt()) - 1.0).abs() < 0.1, "{}", rms(&mm));
        assert!((rms(&rad).to_degrees() / (0.3 * 3f64.sqrt()) - 1.0).abs() < 0.1);
        let (mm, rad) = of(Condition::PoseDrift);
        let most = |values: &[f64]| values.iter().copied().fold(0.0, f64::max);
        assert!(mm[0] < 1e-12 && (most(&mm) - 2.0).abs() < 0.1 && (most(&rad).to_degrees() - 2.0).abs() < 0.1);
        assert!(mm.windows(2).all(|w| (w[1] - w[0]).abs() < 0.15), "smooth");
        let (mm, _) = of(Condition::PoseDelay);
        assert!(mm.iter().all(|m| (m - 0.4).abs() < 1e-9), "40 ms at 10 mm/s");
        let told = sensor(&[Condition::PoseDelay]).told(25, 1.0, path).told;
        assert!(
            (told.translation.z - path(0.96).translation.z).abs() < 1e-9,
            "where the tip was, not where it will be"
        );
        // Over many films, the field's distortion has its root mean square everywhere.
        let settings =
            ClinicalSettings { only: Some(vec![Condition::FieldDistortion]), spread: 0.0, ..Default::default() };
        let at = DVec3::new(20.0, -40.0, 100.0);
        let bends: Vec<f64> =
            (0..400).map(|seed| PoseSensor::new(&settings.drawn(seed), 4.0, seed).distortion(at).0.length()).collect();
        assert!((rms(&bends) - 1.0).abs() < 0.1, "{}", rms(&bends));
    }
}
