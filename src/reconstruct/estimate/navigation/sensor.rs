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
