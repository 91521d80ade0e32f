//! What the sensor's pose tells: the pose of a while ago, off by a bias and white noise.
//!
//! With `C` the pose (camera from world), `v` its twist, `s` the delay and `b = (b_w, b_t)` the bias in world axes, the
//! sensor is expected to tell the inverse of `exp(-s v) C`, turned by `b_w` and moved by `b_t`. In the camera's axes the
//! difference of told and expected is, to first order,
//!
//!   y = -xi + s v + ds v + R^T b + noise,   R the rotation of world from camera.

use glam::{DAffine3, DMat3, DQuat, DVec3};
use nalgebra::{DMatrix, DVector};

use super::state::{BIAS, DELAY, NavigationState, STATE, TWIST, put, twist, vector};
use crate::reconstruct::geometry::rigid::{POSE, motion};
use crate::reconstruct::settings::OursNavSettings;

/// A pose that is off by more than this many standard deviations is no measurement: a sensor that lost its field.
const MOST_DEVIATIONS: f64 = 8.0;

/// The rotation vector of `turn`, rad.
fn rotation_vector(turn: DMat3) -> DVec3 {
    DQuat::from_mat3(&turn).normalize().to_scaled_axis()
}

impl NavigationState {
    /// Difference in camera axes of the `told` pose and the expected one.
    fn sensor_difference(&self, told: &DAffine3) -> DVector<f64> {
        let delay_s = self.mean[DELAY];
        let then = (motion(twist(&self.mean, TWIST).map(|v| -delay_s * v)) * self.camera_from_world).inverse();
        let turn = DMat3::from_quat(DQuat::from_scaled_axis(vector(&self.mean, BIAS))) * then.matrix3;
        let place = then.translation + vector(&self.mean, BIAS + 3);
        let off = rotation_vector(turn.transpose() * told.matrix3);
        let shift = then.matrix3.transpose() * (told.translation - place);
        DVector::from_column_slice(&[off.x, off.y, off.z, shift.x, shift.y, shift.z])
    }

    /// Takes in the pose (world from camera) that the sensor tells now. Returns by how many standard deviations it is off;
    /// one that is off by far too many changes nothing.
    pub fn take_pose(&mut self, settings: &OursNavSettings, told: &DAffine3) -> f64 {
        let difference = self.sensor_difference(told);
        let mut by = DMatrix::zeros(POSE, STATE);
        let rate = twist(&self.mean, TWIST);
        let camera_from_world = self.camera_from_world.matrix3;
        for k in 0..POSE {
            by[(k, k)] = -1.0;
            by[(k, TWIST + k)] = self.mean[DELAY];
            by[(k, DELAY)] = rate[k];
        }
        put(&mut by, (0, BIAS), camera_from_world);
        put(&mut by, (3, BIAS + 3), camera_from_world);
        let [turn, shift] = *settings.sensor.noise;
        let noise = DVector::from_fn(POSE, |k, _| if k < 3 { turn * turn } else { shift * shift });
        let spread = &by * &self.covariance * by.transpose() + DMatrix::from_diagonal(&noise);
        let Some(factor) = spread.cholesky() else { return f64::INFINITY };
        let off = (difference.dot(&factor.solve(&difference)) / POSE as f64).sqrt();
        if off > MOST_DEVIATIONS {
            return off;
        }
        let gain = factor.solve(&(&by * &self.covariance)).transpose();
        let mean = &self.mean + &gain * difference;
        let covariance = &self.covariance - &gain * by * &self.covariance;
        self.settle(mean, covariance);
        off
    }
}

#[cfg(test)]
mod tests {
    use super::super::state::LENS_AT;
    use super::super::tests::settings;
    use super::*;

    /// Where one unknown alone is uncertain, by as much as the noise of a told pose leaves of it, half of its variance is
    /// left (Kalman); how a told pose changes with it is taken from differences.
    #[test]
    fn a_told_pose_tells_of_all_that_it_depends_on() {
        let settings = settings();
        let start = DAffine3::from_rotation_translation(DQuat::from_rotation_y(0.4), DVec3::new(5.0, -3.0, 20.0));
        let mut state = NavigationState::new(&settings, start, 0.0, 4.0);
        let rate = [0.15, -0.1, 0.25, 12.0, -7.0, 20.0];
        (0..POSE).for_each(|k| state.mean[TWIST + k] = rate[k]);
        // What is expected is told, so that the means stay.
        let told = (motion(rate.map(|v| -state.mean[DELAY] * v)) * state.camera_from_world).inverse();
        assert!(state.sensor_difference(&told).norm() < 1e-9);
        let [turn, shift] = *settings.sensor.noise;
        for unknown in 0..LENS_AT {
            let with = |by: f64| {
                let mut other = state.clone();
                if unknown < POSE {
                    let mut xi = [0.0; POSE];
                    xi[unknown] = by;
                    other.camera_from_world = motion(xi) * other.camera_from_world;
                } else {
                    other.mean[unknown] += by;
                }
                other.sensor_difference(&told)
            };
            let slope = (with(1e-5) - with(-1e-5)) / 2e-5;
            let information: f64 = (0..POSE).map(|k| (slope[k] / if k < 3 { turn } else { shift }).powi(2)).sum();
            let mut known = state.clone();
            known.covariance.fill(0.0);
            known.covariance[(unknown, unknown)] = 1.0 / information;
            known.take_pose(&settings, &told);
            let left = known.covariance[(unknown, unknown)] * information;
            assert!((left - 0.5).abs() < 0.02, "unknown {unknown}: {left}");
        }
    }
}
