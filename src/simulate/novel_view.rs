//! The second camera of every eighth frame: the same instant seen from elsewhere, a view that no method fits.

use glam::{DAffine3, DMat3, DQuat, DVec3};

use super::trajectory::nearest_mm;
use crate::base::Result;
use crate::base::random::{CounterRng, Stage};
use crate::render::Scene;

/// Distance in mm from the frame's camera, and angle in degrees between the two optical axes.
const DISTANCE_MM: [f64; 2] = [1.0, 2.0];
const TURN_DEG: [f64; 2] = [8.0, 12.0];
/// The cameras look at the same tissue: the turn may miss the direction back to the first axis by this angle.
const TURN_SPREAD_DEG: f64 = 60.0;
/// The second camera keeps at least this part of the first one's distance from the wall: it shares its exposure.
const CLEARANCE: f64 = 0.9;
/// Draws before the distance is halved.
const DRAWS: u64 = 32;

/// Pose of the second camera beside the one at `pose` in frame `frame`: inside the lumen, [`DISTANCE_MM`] to the side,
/// turned by [`TURN_DEG`]. Where the lumen leaves no room, nearer. `scene` is deformed to the frame's phase and `wall`
/// are its vertices.
pub(super) fn beside(scene: &Scene, wall: &[DVec3], pose: &DAffine3, seed: u64, frame: usize) -> Result<DAffine3> {
    let least_mm = CLEARANCE * nearest_mm(wall, pose.translation);
    for draw in 0.. {
        let mut random = CounterRng::new(seed, Stage::NovelView, &[frame as u64, draw]);
        let nearer = 0.5f64.powi((draw / DRAWS) as i32);
        let distance_mm = nearer * random.range(DISTANCE_MM[0], DISTANCE_MM[1]);
        let aside = DMat3::from_rotation_z(random.range(0.0, std::f64::consts::TAU)) * DVec3::X;
        let turn = random.range(TURN_DEG[0], TURN_DEG[1]).to_radians();
        let spread = random.range(-TURN_SPREAD_DEG, TURN_SPREAD_DEG).to_radians();
        let axis = DMat3::from_rotation_z(spread) * aside.cross(DVec3::Z);
        let direction = pose.matrix3 * aside;
        let place = pose.translation + direction * distance_mm;
        let free_mm = f64::from(scene.distances(&[pose.translation], &[direction])?[0]);
        // The last resort is the camera's own place.
        if free_mm > distance_mm && nearest_mm(wall, place) >= least_mm || distance_mm < 1e-3 {
            let turned = pose.matrix3 * DMat3::from_quat(DQuat::from_axis_angle(axis, turn));
            return Ok(DAffine3 { matrix3: turned, translation: place });
        }
    }
    unreachable!("the distance is halved until it is small enough")
}
