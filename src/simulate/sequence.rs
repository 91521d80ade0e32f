//! A sequence on disk: the one place that knows its file names.

use std::path::PathBuf;

use glam::DAffine3;

use crate::base::Camera;

/// What is known of one frame, truth included.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameRecord {
    /// Time since the first frame in seconds.
    pub time_s: f64,
    /// True breathing phase.
    pub phase: f64,
    /// Exposure gain that was applied to the linear radiance.
    pub gain: f64,
    /// White-balance factors applied to red, green and blue.
    pub white_balance: [f64; 3],
    /// True pose in the scanner frame.
    pub world_from_camera: DAffine3,
}

/// An opened sequence folder.
#[derive(Clone, Debug)]
pub struct Sequence {
    /// The folder.
    pub root: PathBuf,
    /// Which case was filmed.
    pub case_id: String,
    /// Content hash of everything that determines the sequence.
    pub hash: String,
    /// Intrinsics, the same for all frames.
    pub camera: Camera,
    /// One record per frame, in order.
    pub frames: Vec<FrameRecord>,
}
