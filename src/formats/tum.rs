//! Trajectories as the RGB-D benchmark of TUM writes them, which evo and most SLAM programs read: a line
//! `timestamp tx ty tz qx qy qz qw` per frame, world from camera, seconds, the quaternion's w last.

use std::fmt::Write;

use glam::{DAffine3, DQuat};

/// The text of a trajectory of times in seconds and poses (world from camera). No blank ends a line: evo refuses it.
pub fn trajectory(frames: impl IntoIterator<Item = (f64, DAffine3)>) -> String {
    let mut text = "# timestamp tx ty tz qx qy qz qw\n".to_owned();
    for (time_s, world_from_camera) in frames {
        let t = world_from_camera.translation;
        let q = DQuat::from_mat3(&world_from_camera.matrix3).normalize();
        // Writing to a string cannot fail.
        let _ = writeln!(text, "{time_s} {} {} {} {} {} {} {}", t.x, t.y, t.z, q.x, q.y, q.z, q.w);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    #[test]
    fn a_line_holds_time_place_and_rotation() {
        let turned = DAffine3::from_rotation_translation(DQuat::from_rotation_z(1.0), DVec3::new(1.0, -2.0, 0.5));
        let text = trajectory([(0.0, DAffine3::IDENTITY), (0.04, turned)]);
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines[1], "0 0 0 0 0 0 0 1");
        let numbers: Vec<f64> = lines[2].split(' ').map(|v| v.parse().unwrap()).collect();
        assert_eq!(numbers[..6], [0.04, 1.0, -2.0, 0.5, 0.0, 0.0]);
        assert!((numbers[6] - 0.5f64.sin()).abs() < 1e-15 && (numbers[7] - 0.5f64.cos()).abs() < 1e-15);
    }
}
