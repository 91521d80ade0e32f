//! The methods. Each is handed an [`Observation`]: what it may see, and nothing else.
//!
//! Protocol (the paper's, online): frames arrive in order; the method fits frame `t` and hands back its rendering
//! of it. Every eighth frame is also rendered *before* its image is looked at (`ahead`).

use glam::DAffine3;

use crate::base::{Camera, Image, Progress, Result, TriangleMesh};

/// What a method asks to see beyond images, times, camera and poses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Access {
    /// The expiration mesh (a second CT).
    pub expiration_mesh: bool,
    /// The depth image of the first frame.
    pub first_depth: bool,
    /// The true phase of every frame (the `oracle-phase` row only).
    pub true_phase: bool,
}

/// What a method is handed.
#[derive(Clone, Debug)]
pub struct Observation {
    /// Intrinsics.
    pub camera: Camera,
    /// Known pose of each frame.
    pub world_from_camera: Vec<DAffine3>,
    /// Seconds since the first frame.
    pub time_s: Vec<f64>,
    /// 8-bit sRGB images, one per frame.
    pub images: Vec<Image<u8>>,
    /// CT surface at inspiration; normals point into the lumen.
    pub inspiration: TriangleMesh,
    /// CT surface at expiration, same faces; only if asked for.
    pub expiration: Option<TriangleMesh>,
    /// z-depth in mm of frame 0, 0 where nothing was hit; only if asked for.
    pub first_depth_mm: Option<Image<f32>>,
    /// True phases; only if asked for.
    pub true_phase: Option<Vec<f64>>,
    /// Seed of the method's own randomness.
    pub seed: u64,
}

/// A method's answer for one frame.
#[derive(Clone, Debug)]
pub struct FramePrediction {
    /// Index of the frame.
    pub frame: usize,
    /// Rendered image, encoded sRGB in [0, 1].
    pub color: Image<f32>,
    /// Rendered z-depth in mm, 0 where nothing is.
    pub depth_mm: Image<f32>,
    /// Estimated breathing phase, where the method has one.
    pub phase: Option<f64>,
    /// Rendering made before the frame's image was looked at (every eighth frame).
    pub ahead: Option<Image<f32>>,
}

/// What remains when all frames are done.
#[derive(Clone, Debug, Default)]
pub struct Reconstruction {
    /// Airway surface at the last frame, where the method keeps one.
    pub final_mesh: Option<TriangleMesh>,
    /// Seconds of the method alone: no reading, writing or scoring.
    pub seconds: f64,
}

/// A reconstruction method.
pub trait Reconstruct: Send + Sync {
    /// Its id in tables and folders.
    fn id(&self) -> &str;

    /// What it asks to see.
    fn access(&self) -> Access;

    /// Fits all frames in order, handing each answer to `emit`.
    fn run(
        &self,
        observation: &Observation,
        emit: &mut dyn FnMut(FramePrediction) -> Result<()>,
        progress: &dyn Progress,
    ) -> Result<Reconstruction>;
}
