//! Poses as a tracker in the tip of the scope would give them, for methods that do not assume exact poses. The error
//! of each is a motion of the camera in its own axes with the constant size [`SHIFT_MM`] and [`TURN_DEG`] and a
//! direction that turns slowly, once in [`TURNAROUND_S`]. It thus acts as an offset and a drift at once.

use std::f64::consts::TAU;

use glam::{DAffine3, DQuat, DVec3};

use crate::base::random::{CounterRng, Stage};

/// Distance of each given position from the true one.
pub const SHIFT_MM: f64 = 2.0;
/// Angle of each given orientation from the true one.
pub const TURN_DEG: f64 = 3.0;
/// Seconds for one revolution of the error's direction.
const TURNAROUND_S: f64 = 30.0;

/// Two random unit vectors at right angles.
fn plane(rng: &mut CounterRng) -> [DVec3; 2] {
    let mut vector = || DVec3::new(rng.normal(), rng.normal(), rng.normal());
    let first = vector().try_normalize().unwrap_or(DVec3::X);
    let second = vector().reject_from_normalized(first).try_normalize();
    [first, second.unwrap_or_else(|| first.any_orthonormal_vector())]
}

/// `poses` (world from camera) with the errors of `seed`.
pub fn rough_poses(poses: &[DAffine3], time_s: &[f64], seed: u64) -> Vec<DAffine3> {
    let mut rng = CounterRng::new(seed, Stage::Method, &[2]);
    let (shift, turn) = (plane(&mut rng), plane(&mut rng));
    let at = |plane: [DVec3; 2], time_s: f64| {
        let (sine, cosine) = (TAU * time_s / TURNAROUND_S).sin_cos();
        plane[0] * cosine + plane[1] * sine
    };
    let disturbed = |(pose, &t): (&DAffine3, &f64)| {
        let turn = DQuat::from_scaled_axis(at(turn, t) * TURN_DEG.to_radians());
        *pose * DAffine3::from_rotation_translation(turn, at(shift, t) * SHIFT_MM)
    };
    poses.iter().zip(time_s).map(disturbed).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_pose_is_off_by_as_much_as_is_said_and_neighbours_by_nearly_the_same() {
        let pose = |i: usize| {
            let turn = DQuat::from_rotation_y(0.1 * i as f64);
            DAffine3::from_rotation_translation(turn, DVec3::new(1.0, 2.0, i as f64))
        };
        let poses: Vec<DAffine3> = (0..40).map(pose).collect();
        let time_s: Vec<f64> = (0..40).map(|i| 0.1 * i as f64).collect();
        let rough = rough_poses(&poses, &time_s, 7);
        assert_ne!(rough, rough_poses(&poses, &time_s, 8));
        let error = |i: usize| poses[i].inverse() * rough[i];
        for i in 0..40 {
            let error = error(i);
            let angle = DQuat::from_mat3(&error.matrix3).to_scaled_axis().length().to_degrees();
            assert!((error.translation.length() - SHIFT_MM).abs() < 1e-9 && (angle - TURN_DEG).abs() < 1e-6);
        }
        let drift = (error(1).translation - error(0).translation).length();
        assert!((drift - SHIFT_MM * TAU * 0.1 / TURNAROUND_S).abs() < 1e-3, "{drift}");
    }
}
