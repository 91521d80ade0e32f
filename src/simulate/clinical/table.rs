//! The truth of the clinical track's effects as a table, one row per frame: for evaluation, never for methods.

use glam::{DAffine3, DVec3};

use super::pose_sensor::PoseFault;
use super::tissue_motion::BodyState;

/// First line of the table.
const HEADER: &str = "frame,time_s,phase,flow,heartbeat,cough,shake_x_mm,shake_y_mm,shake_z_mm,contact,\
    drift_x_mm,drift_y_mm,drift_z_mm,drift_x_deg,drift_y_deg,drift_z_deg,distortion_x_mm,distortion_y_mm,\
    distortion_z_mm,pose_error_mm,pose_error_deg,lamp_x_mm,lamp_y_mm,lamp_z_mm,lens_film,clipped_pct,covered_pct\n";

/// What is known of a frame once the film is planned.
#[derive(Clone, Debug)]
pub struct FrameConditions {
    /// The state of the chest.
    pub body: BodyState,
    /// How far the tip touches the wall, 0 to 1.
    pub contact: f64,
    /// What the sensor told, and why.
    pub fault: PoseFault,
    /// Place of the lamp in camera axes, mm.
    pub lamp_mm: DVec3,
    /// Part of the light that the film on the lens scatters.
    pub lens_film: f64,
}

/// What is read from a frame's pictures.
#[derive(Clone, Copy, Debug, Default)]
pub struct PictureShares {
    /// Pixels with a channel at code 253 or above, %.
    pub clipped_pct: f64,
    /// Of the wall, what drops hide, %.
    pub covered_pct: f64,
}

/// The table: times, true poses and conditions of the frames, and what their pictures say.
pub fn table(times_s: &[f64], poses: &[DAffine3], frames: &[FrameConditions], pictures: &[PictureShares]) -> String {
    let mut text = HEADER.to_owned();
    for (i, (f, picture)) in frames.iter().zip(pictures).enumerate() {
        let told = &f.fault.told;
        let turn = glam::DQuat::from_mat3(&(poses[i].matrix3.transpose() * told.matrix3));
        let off_deg = (2.0 * turn.xyz().length().atan2(turn.w.abs())).to_degrees();
        let off_mm = told.translation.distance(poses[i].translation);
        let drift_deg = f.fault.drift_rad.map(f64::to_degrees);
        let vector = |v: DVec3| format!("{},{},{}", v.x, v.y, v.z);
        text += &format!(
            "{i},{},{},{},{},{},{},{},{},{},{},{off_mm},{off_deg},{},{},{},{}\n",
            times_s[i],
            f.body.phase,
            f.body.flow,
            f.body.beat,
            f.body.cough,
            vector(f.body.shake_mm),
            f.contact,
            vector(f.fault.drift_mm),
            vector(drift_deg),
            vector(f.fault.distortion_mm),
            vector(f.lamp_mm),
            f.lens_film,
            picture.clipped_pct,
            picture.covered_pct,
        );
    }
    text
}
