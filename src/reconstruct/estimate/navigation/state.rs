//! The state of knowledge of `ours-nav` and how it changes with time: a Gaussian over everything that is unknown now.
//!
//! | unknown | number | changes with time |
//! |---|--:|---|
//! | pose, `exp(xi) camera_from_world` (rad, mm) | 6 | by the twist |
//! | twist: its change per second, camera axes | 6 | Ornstein-Uhlenbeck |
//! | what the sensor is off by, world axes (rad, mm) | 6 | random walk |
//! | delay of the sensor (s) | 1 | constant |
//! | image centre (share of the width), log focal length | 3 | constant |
//! | phase `p` and its rate `q` (1/s) | 2 | an oscillator of the mean breath, shaken by white noise |
//! | offset of the wall here, per unit of phase, world (mm) | 3 | Ornstein-Uhlenbeck along the way |
//! | offset of the wall here, per unit of air flow, world (mm) | 3 | Ornstein-Uhlenbeck along the way |
//! | place of the lamp beside the lens (mm) | 2 | constant |
//! | what shading makes of the pose (rad, mm) | 6 | Ornstein-Uhlenbeck |
//!
//! The wall that is seen is at `r + p (d + F) + f G` (`d` the motion between the CTs, `f = q / (pi / period)` the air flow):
//! a correction of the field of rank two, of what is in view. The second is the motion with the air flow of Low et al. (Int
//! J Radiat Oncol Biol Phys 63:921, 2005), and takes up hysteresis and lag.

use glam::{DAffine3, DMat3, DVec3};
use nalgebra::{DMatrix, DVector};

use crate::reconstruct::geometry::rigid::{POSE, motion};
use crate::reconstruct::settings::OursNavSettings;

/// Where each unknown stands.
pub const TWIST: usize = POSE;
/// What the sensor is off by.
pub const BIAS: usize = 2 * POSE;
/// Delay of the sensor.
pub const DELAY: usize = 3 * POSE;
/// Image centre and focal length.
pub const LENS_AT: usize = DELAY + 1;
/// Phase.
pub const PHASE_AT: usize = LENS_AT + 3;
/// Rate of the phase.
pub const RATE: usize = PHASE_AT + 1;
/// Offset of the wall per unit of phase.
pub const FIELD: usize = RATE + 1;
/// Offset of the wall per unit of air flow.
pub const LOOP: usize = FIELD + 3;
/// Lamp.
pub const LAMP_AT: usize = LOOP + 3;
/// What shading makes of the pose.
pub const SHADE: usize = LAMP_AT + 2;
/// Number of unknowns.
pub const STATE: usize = SHADE + POSE;

/// Mean phase of a breath.
const MEAN_PHASE: f64 = 0.5;
/// Longest time in seconds that is stepped over at once.
const LONGEST_S: f64 = 1.0;

/// What is known.
#[derive(Clone, Debug)]
pub struct NavigationState {
    /// Pose: that of the unknowns at zero.
    pub camera_from_world: DAffine3,
    /// Means; those of the pose are zero.
    pub mean: DVector<f64>,
    /// Covariance.
    pub covariance: DMatrix<f64>,
    /// When.
    pub time_s: f64,
    /// Mean duration of a breath, s.
    pub period_s: f64,
    /// Until when the breath is held, s.
    held_until_s: f64,
}

/// `turn` and `shift` for three axes each.
fn six([turn, shift]: [f64; 2]) -> [f64; POSE] {
    [turn, turn, turn, shift, shift, shift]
}

/// The matrix of the cross product with `v`.
pub fn cross(v: DVec3) -> DMat3 {
    DMat3::from_cols(v.cross(DVec3::X), v.cross(DVec3::Y), v.cross(DVec3::Z))
}

/// Three unknowns from number `first` on.
pub fn vector(mean: &DVector<f64>, first: usize) -> DVec3 {
    DVec3::new(mean[first], mean[first + 1], mean[first + 2])
}

/// Six unknowns from number `first` on.
pub fn twist(mean: &DVector<f64>, first: usize) -> [f64; POSE] {
    std::array::from_fn(|k| mean[first + k])
}

/// Writes `block` with its corner at `row`, `column`.
pub fn put(into: &mut DMatrix<f64>, (row, column): (usize, usize), block: DMat3) {
    for j in 0..3 {
        for i in 0..3 {
            into[(row + i, column + j)] = block.col(j)[i];
        }
    }
}

impl NavigationState {
    /// At the start of a film, in the breath hold of the first CT, with the told pose.
    pub fn new(settings: &OursNavSettings, told: DAffine3, time_s: f64, period_s: f64) -> Self {
        let OursNavSettings { sensor, tip, tissue, optics, matching, .. } = settings;
        let mut deviation = [0.0; STATE];
        // The first pose is the sensor's: as far off as that is, and as far as the tip moves within its delay.
        let ([bias, noise], moved) = ([*sensor.bias, *sensor.noise], *tip.rate);
        let start =
            [0, 1].map(|k| (bias[k].powi(2) + noise[k].powi(2) + (moved[k] * sensor.delay_s[0]).powi(2)).sqrt());
        deviation[..POSE].copy_from_slice(&six(start));
        deviation[TWIST..BIAS].copy_from_slice(&six(moved));
        deviation[BIAS..DELAY].copy_from_slice(&six(bias));
        deviation[DELAY] = sensor.delay_s[1];
        deviation[LENS_AT..PHASE_AT].copy_from_slice(&[*optics.centre, *optics.centre, *optics.focal]);
        deviation[PHASE_AT..FIELD].copy_from_slice(tissue.start.as_slice());
        deviation[FIELD..LOOP].fill(*tissue.registration_mm);
        deviation[LOOP..LAMP_AT].fill(*tissue.loop_mm);
        deviation[LAMP_AT..SHADE].fill(*optics.lamp_mm);
        deviation[SHADE..].copy_from_slice(&six(*matching.shade));
        let mut mean = DVector::zeros(STATE);
        mean[DELAY] = sensor.delay_s[0];
        let variances = DVector::from_column_slice(&deviation).map(|d| d * d);
        NavigationState {
            camera_from_world: told.inverse(),
            mean,
            covariance: DMatrix::from_diagonal(&variances),
            time_s,
            period_s,
            held_until_s: time_s + *tissue.hold_s,
        }
    }

    /// Air flow: rate of the phase over the peak rate of a sinusoidal breath.
    pub fn flow(&self) -> f64 {
        self.mean[RATE] / self.peak_rate()
    }

    /// Peak rate of a sinusoidal breath, 1/s.
    pub fn peak_rate(&self) -> f64 {
        std::f64::consts::PI / self.period_s
    }

    /// What is expected at `time_s`, before anything is measured.
    pub fn advance(&mut self, settings: &OursNavSettings, time_s: f64) {
        let mut left_s = time_s - self.time_s;
        while left_s > 0.0 {
            let now_s = time_s - left_s;
            let held_s = self.held_until_s - now_s;
            let step_s = left_s.min(LONGEST_S).min(if held_s > 1e-9 { held_s } else { f64::INFINITY });
            self.time_s = now_s;
            self.drift_on(settings, step_s);
            left_s -= step_s;
        }
        self.time_s = time_s;
    }

    fn drift_on(&mut self, settings: &OursNavSettings, seconds: f64) {
        let OursNavSettings { sensor, tip, tissue, matching, .. } = settings;
        let mut transition = DMatrix::identity(STATE, STATE);
        let mut noise = DVector::zeros(STATE);

        // Pose: C -> exp(v s) C, so an error xi becomes Ad(exp(v s)) xi + s v.
        let rate = twist(&self.mean, TWIST);
        let moved = motion(rate.map(|v| v * seconds));
        let turn = moved.matrix3;
        put(&mut transition, (0, 0), turn);
        put(&mut transition, (3, 3), turn);
        put(&mut transition, (3, 0), cross(moved.translation) * turn);
        (0..POSE).for_each(|k| transition[(k, TWIST + k)] = seconds);
        self.camera_from_world = moved * self.camera_from_world;
        let kept = (-seconds / *tip.steady_s).exp();
        for (k, deviation) in six(*tip.rate).into_iter().enumerate() {
            transition[(TWIST + k, TWIST + k)] = kept;
            noise[TWIST + k] = deviation * deviation * (1.0 - kept * kept);
            // A rate that changes within the step moves the tip by a third of that.
            noise[k] = noise[TWIST + k] * seconds * seconds / 3.0;
        }

        // The sensor's drift.
        for (k, deviation) in six(*sensor.drift).into_iter().enumerate() {
            noise[BIAS + k] = deviation * deviation * seconds;
        }

        // The breath: p'' = -w^2 (p - 1/2), shaken; nothing happens while it is held.
        let is_held = self.time_s + 0.5 * seconds < self.held_until_s;
        let (sine, cosine) = (std::f64::consts::TAU / self.period_s * seconds).sin_cos();
        let pace = std::f64::consts::TAU / self.period_s;
        if !is_held {
            transition[(PHASE_AT, PHASE_AT)] = cosine;
            transition[(PHASE_AT, RATE)] = sine / pace;
            transition[(RATE, PHASE_AT)] = -pace * sine;
            transition[(RATE, RATE)] = cosine;
            let shaken = tissue.unrest.powi(2) * seconds;
            noise[RATE] = shaken;
            noise[PHASE_AT] = shaken * seconds * seconds / 3.0;
        }
        let (phase, rate_of_phase) = (self.mean[PHASE_AT] - MEAN_PHASE, self.mean[RATE]);

        // The wall's offsets change along the way, shading with time.
        let way_mm = DVec3::from_slice(&rate[3..]).length() * seconds;
        let other = [
            (FIELD..LOOP, (-way_mm / *tissue.reach_mm).exp(), [*tissue.registration_mm; POSE]),
            (LOOP..LAMP_AT, (-way_mm / *tissue.reach_mm).exp(), [*tissue.loop_mm; POSE]),
            (SHADE..STATE, (-seconds / *matching.shade_s).exp(), six(*matching.shade)),
        ];
        for (places, kept, deviations) in other {
            for (place, deviation) in places.zip(deviations) {
                transition[(place, place)] = kept;
                noise[place] = deviation * deviation * (1.0 - kept * kept);
            }
        }

        let pose_free = self.mean.clone();
        self.mean = &transition * pose_free;
        self.mean.rows_mut(0, POSE).fill(0.0);
        if !is_held {
            self.mean[PHASE_AT] = (MEAN_PHASE + cosine * phase + sine / pace * rate_of_phase).clamp(0.0, 1.0);
            self.mean[RATE] = cosine * rate_of_phase - pace * sine * phase;
        }
        self.covariance = &transition * &self.covariance * transition.transpose() + DMatrix::from_diagonal(&noise);
    }

    /// Takes over `mean`, whose pose is a change of this one's, and its covariance.
    pub fn settle(&mut self, mut mean: DVector<f64>, covariance: DMatrix<f64>) {
        self.camera_from_world = motion(twist(&mean, 0)) * self.camera_from_world;
        mean.rows_mut(0, POSE).fill(0.0);
        keep_phase_inside(&mut mean);
        self.mean = mean;
        self.covariance = (&covariance + covariance.transpose()) * 0.5;
    }

    /// Where the wall that is in view is beyond its motion by the phase, mm, world.
    pub fn wall_offset_mm(&self, mean: &DVector<f64>) -> DVec3 {
        vector(mean, FIELD) * mean[PHASE_AT] + vector(mean, LOOP) * (mean[RATE] / self.peak_rate())
    }
}

/// Brings the phase back into 0 to 1; at an end of the breath it rests, or comes back.
pub fn keep_phase_inside(mean: &mut DVector<f64>) {
    let inside = mean[PHASE_AT].clamp(0.0, 1.0);
    if inside != mean[PHASE_AT] {
        mean[RATE] = if inside > 0.5 { mean[RATE].min(0.0) } else { mean[RATE].max(0.0) };
    }
    mean[PHASE_AT] = inside;
}

#[cfg(test)]
mod tests {
    use glam::DQuat;

    use super::super::tests::settings;
    use super::*;

    /// An error of the pose goes on as the difference of two poses does, and what is certain gets only the drift's noise.
    #[test]
    fn errors_of_the_pose_are_carried_along() {
        let (settings, seconds) = (settings(), 0.2);
        let mut start = NavigationState::new(&settings, DAffine3::from_translation(DVec3::Z * 9.0), 0.0, 4.0);
        let rate = [0.5, -0.3, 0.8, 10.0, -5.0, 20.0];
        (0..POSE).for_each(|k| start.mean[TWIST + k] = rate[k]);
        start.covariance.fill(0.0);
        let after = |state: &NavigationState| {
            let mut state = state.clone();
            state.advance(&settings, seconds);
            state
        };
        let certain = after(&start);
        for unknown in 0..POSE {
            let mut xi = [0.0; POSE];
            xi[unknown] = 1e-5;
            let off = NavigationState { camera_from_world: motion(xi) * start.camera_from_world, ..start.clone() };
            let apart = after(&off).camera_from_world * certain.camera_from_world.inverse();
            let turn = DQuat::from_mat3(&apart.matrix3).to_scaled_axis();
            let apart = [turn.to_array(), apart.translation.to_array()].concat().into_iter().map(|v| v / 1e-5);
            let apart = DVector::from_iterator(POSE, apart);
            let mut uncertain = start.clone();
            uncertain.covariance[(unknown, unknown)] = 1.0;
            let carried = after(&uncertain).covariance - &certain.covariance;
            let wrong = carried.view((0, 0), (POSE, POSE)) - &apart * apart.transpose();
            assert!(wrong.amax() < 1e-3 * apart.norm_squared(), "unknown {unknown}: {wrong}");
        }
        // A random walk: its variance grows with the time.
        for (k, deviation) in six(*settings.sensor.drift).into_iter().enumerate() {
            let grown = certain.covariance[(BIAS + k, BIAS + k)];
            assert!((grown / (deviation * deviation * seconds) - 1.0).abs() < 1e-9, "{k}: {grown}");
        }
    }

    /// Held at the start of a film, and then as `p'' = -w^2 (p - 1/2)` has it: from rest at 0 to 1 in half a period.
    #[test]
    fn a_breath_goes_on_when_it_is_no_longer_held() {
        let settings = settings();
        let mut state = NavigationState::new(&settings, DAffine3::IDENTITY, 0.0, 4.0);
        let held_s = *settings.tissue.hold_s;
        for (time_s, phase) in [(0.5 * held_s, 0.0), (held_s, 0.0), (held_s + 1.0, 0.5), (held_s + 2.0, 1.0)] {
            state.advance(&settings, time_s);
            assert!((state.mean[PHASE_AT] - phase).abs() < 1e-9, "{time_s} s: {}", state.mean[PHASE_AT]);
        }
    }
}
