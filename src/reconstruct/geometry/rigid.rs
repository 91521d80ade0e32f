//! Rigid motions `exp(xi)` of the camera, `xi = (omega, tau)` in camera axes: an angle vector (rad) and a shift (mm).

use glam::{DAffine3, DMat3, DQuat, DVec3};

use crate::splat::View;

/// Unknowns of a pose.
pub const POSE: usize = 6;

/// `exp(xi) x = R(omega) x + tau`: the rotation first.
pub fn motion(xi: [f64; POSE]) -> DAffine3 {
    let turn = DQuat::from_scaled_axis(DVec3::new(xi[0], xi[1], xi[2]));
    DAffine3::from_mat3_translation(DMat3::from_quat(turn), DVec3::new(xi[3], xi[4], xi[5]))
}

/// `view` with its pose corrected by `xi`: `camera_from_world = exp(xi) given`.
pub fn moved(view: &View, xi: [f64; POSE]) -> View {
    View { camera_from_world: motion(xi) * view.camera_from_world, ..*view }
}

/// The derivative of `exp(xi) x` by angle `k` of `xi` is `turns[k] x (exp(xi) x - tau)`. `turns` are the
/// columns of the left Jacobian of rotations, `J e = e + a (omega x e) + b (omega x (omega x e))`,
/// `a = (1 - cos) / angle^2`, `b = (angle - sin) / angle^3`.
pub fn turns(xi: [f64; POSE]) -> [DVec3; 3] {
    let omega = DVec3::new(xi[0], xi[1], xi[2]);
    let angle2 = omega.length_squared();
    let (a, b) = if angle2 < 1e-8 {
        // Their series: the quotients lose all digits near 0.
        (0.5 - angle2 / 24.0, 1.0 / 6.0 - angle2 / 120.0)
    } else {
        let angle = angle2.sqrt();
        ((1.0 - angle.cos()) / angle2, (angle - angle.sin()) / (angle2 * angle))
    };
    DVec3::AXES.map(|axis| {
        let once = omega.cross(axis);
        axis + a * once + b * omega.cross(once)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn turns_are_the_derivatives_of_a_motion() {
        for xi in [[0.2, -0.5, 0.3, 1.0, 2.0, -1.0], [1e-5, 2e-5, -1e-5, 0.0, 0.0, 0.0]] {
            let point = DVec3::new(3.0, -2.0, 8.0);
            let (there, shift) = (motion(xi).transform_point3(point), DVec3::from_slice(&xi[3..]));
            for (k, turn) in turns(xi).into_iter().enumerate() {
                let side = |h: f64| {
                    let mut moved = xi;
                    moved[k] += h;
                    motion(moved).transform_point3(point)
                };
                let numeric = (side(1e-5) - side(-1e-5)) / 2e-5;
                assert!((turn.cross(there - shift) - numeric).length() < 1e-7, "{k}: {numeric}");
            }
        }
    }
}
