//! The inputs and outputs of a method: the contract between the protocol and the methods.
//!
//! Protocol (the paper's, online): frames arrive in order; the method fits frame `t` and returns its rendering
//! of it. Every eighth frame is also rendered *before* its image may be used (`ahead`), and after it was fitted from a
//! second camera whose picture the method never sees (`novel`).

use std::sync::Arc;

use glam::{DAffine3, DMat3, DVec3};

use super::settings::{Listing, MethodHeader};
use super::stopwatch::Spent;
use crate::base::{Camera, Error, Image, Mask, Progress, Result, TriangleMesh};

/// What a method asks for beyond images, times, camera and poses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Access {
    /// The expiration mesh (a second CT).
    pub expiration_mesh: bool,
    /// The depth image of the first frame.
    pub first_depth: bool,
    /// The true phase of every frame (the `oracle-phase` row only).
    pub true_phase: bool,
    /// How well the poses are known.
    pub poses: PoseAccuracy,
}

/// Accuracy of the poses given to a method.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PoseAccuracy {
    /// Exact: the paper's assumption.
    True,
    /// Wrong by 2 mm and 3 degrees ([`super::rough_poses()`]).
    Rough,
}

/// The inputs of a method.
#[derive(Clone, Debug)]
pub struct Observation {
    /// Intrinsics.
    pub camera: Camera,
    /// Known pose of each frame.
    pub world_from_camera: Vec<DAffine3>,
    /// Whether those poses are a sensor's, which is off by millimetres and degrees (the clinical track).
    pub poses_are_measured: bool,
    /// Per frame the pose of a second camera, where it has one: a view to render, without an image.
    pub novel_pose: Vec<Option<DAffine3>>,
    /// Seconds since the first frame.
    pub time_s: Vec<f64>,
    /// 8-bit sRGB images, one per frame.
    pub images: Vec<Image<u8>>,
    /// Mask of the valid pixels of the images; `None` if all are valid.
    pub mask: Option<Mask>,
    /// CT surface at inspiration; normals point into the lumen.
    pub inspiration: TriangleMesh,
    /// CT surface at expiration, same faces; only if asked for.
    pub expiration: Option<TriangleMesh>,
    /// Points of the lumen's centreline at inspiration, mm.
    pub centerline_mm: Vec<DVec3>,
    /// Mean duration of a breath in seconds, as a ventilator or a spirometer tells it.
    pub breathing_period_s: f64,
    /// Targets as planned on the CT at inspiration, mm.
    pub targets_mm: Vec<DVec3>,
    /// z-depth in mm of frame 0, 0 where nothing was hit; only if asked for.
    pub first_depth_mm: Option<Image<f32>>,
    /// True phases; only if asked for.
    pub true_phase: Option<Vec<f64>>,
    /// Seed of the method's own randomness.
    pub seed: u64,
}

impl Observation {
    /// A film without frames, for tests to fill.
    #[cfg(test)]
    pub fn bare(camera: Camera, inspiration: TriangleMesh) -> Observation {
        Observation {
            camera,
            world_from_camera: Vec::new(),
            poses_are_measured: false,
            novel_pose: Vec::new(),
            time_s: Vec::new(),
            images: Vec::new(),
            mask: None,
            inspiration,
            expiration: None,
            centerline_mm: Vec::new(),
            breathing_period_s: 4.0,
            targets_mm: Vec::new(),
            first_depth_mm: None,
            true_phase: None,
            seed: 1,
        }
    }

    /// A weight per pixel for losses; `None` if all count alike.
    pub fn pixel_weights(&self) -> Option<Vec<f32>> {
        self.mask.as_ref().map(Mask::weights)
    }

    /// Whether pixel `index` (row-major) is valid.
    pub fn shows(&self, index: usize) -> bool {
        self.mask.as_ref().is_none_or(|mask| mask.shows(index))
    }

    /// Errors when arrays differ in length or something is missing that `access` asks for.
    pub fn validate(&self, access: Access) -> Result<()> {
        let frames = self.images.len();
        let lengths = [self.world_from_camera.len(), self.novel_pose.len(), self.time_s.len()];
        if frames == 0 || lengths != [frames; 3] {
            return Err(Error::input("an observation needs as many poses and times as images, and at least one"));
        }
        let size = (self.camera.width as usize, self.camera.height as usize, 3);
        if let Some(i) = self.images.iter().position(|i| (i.width, i.height, i.channels) != size) {
            return Err(Error::input("the image has another size than the camera").element(format!("frame {i}")));
        }
        if self.mask.as_ref().is_some_and(|m| (m.width, m.height) != (size.0, size.1)) {
            return Err(Error::input("the mask has another size than the camera"));
        }
        self.inspiration.validate()?;
        if access.expiration_mesh && self.expiration.as_ref().is_none_or(|e| e.faces != self.inspiration.faces) {
            return Err(Error::input("an expiration mesh with the faces of the inspiration mesh is needed"));
        }
        if access.first_depth && self.first_depth_mm.is_none() {
            return Err(Error::input("the depth of the first frame is needed"));
        }
        if access.true_phase && self.true_phase.as_ref().is_none_or(|p| p.len() != frames) {
            return Err(Error::input("the true phase of every frame is needed"));
        }
        Ok(())
    }
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
    /// Standard deviation of that estimate, where the method knows one.
    pub phase_deviation: Option<f64>,
    /// Estimated pose, where the method has one of its own.
    pub world_from_camera: Option<DAffine3>,
    /// Rendering made before the frame's image was used (every eighth frame).
    pub ahead: Option<Image<f32>>,
    /// Where the targets are, mm, where the method knows how the airway moves.
    pub targets_mm: Option<Vec<DVec3>>,
    /// Covariance of each target's place in the camera's axes, mm squared, where the method knows it.
    pub target_covariance_mm2: Option<Vec<DMat3>>,
    /// Rendering from the frame's second camera, made after the frame was fitted.
    pub novel: Option<NovelPrediction>,
}

/// A view without an image, rendered.
#[derive(Clone, Debug)]
pub struct NovelPrediction {
    /// Rendered image, encoded sRGB in [0, 1].
    pub color: Image<f32>,
    /// Rendered z-depth in mm, 0 where nothing is.
    pub depth_mm: Image<f32>,
}

/// Results after the last frame.
#[derive(Clone, Debug, Default)]
pub struct Reconstruction {
    /// Airway surface at the last frame, where the method keeps one.
    pub final_mesh: Option<TriangleMesh>,
    /// What the method alone spent: no reading, writing or scoring.
    pub spent: Spent,
}

/// A frame as it reaches a method that follows a scope.
#[derive(Clone, Debug)]
pub struct ArrivedFrame {
    /// 8-bit sRGB image, of the camera's size; shared with who shows it.
    pub image: Arc<Image<u8>>,
    /// Seconds since the first frame.
    pub time_s: f64,
    /// Known pose.
    pub world_from_camera: DAffine3,
    /// Frames since the one before that the method does not get to see.
    pub left_out: usize,
}

/// How far a live answer is to be relied on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TrackState {
    /// The picture agrees with the answer.
    Tracking,
    /// It agrees, and says little about the phase.
    Unsure,
    /// It does not agree, not even after a search over all phases.
    Lost,
}

/// The answer for one frame as soon as there is one.
#[derive(Clone, Debug)]
pub struct LiveAnswer {
    /// How far it is to be relied on.
    pub state: TrackState,
    /// Breathing phase.
    pub phase: f64,
    /// Its standard deviation, where the method knows one.
    pub phase_deviation: Option<f64>,
    /// Pose of the camera.
    pub world_from_camera: DAffine3,
    /// Where the targets are, mm.
    pub targets_mm: Vec<DVec3>,
    /// Covariance of each target's place in the camera's axes, mm squared: of all that the method takes to be uncertain.
    pub target_covariance_mm2: Vec<DMat3>,
    /// Share of the picture that the method left out because it does not show the wall (secretions, glare, a film on the
    /// lens), 0 to 1; `None` where it does not tell them apart.
    pub masked_share: Option<f64>,
    /// How much each pixel of the picture counted; likewise.
    pub mask: Option<WallMask>,
}

/// How much each pixel of a picture counted as wall; drawn only where it is asked for.
#[derive(Clone, Debug)]
pub struct WallMask {
    /// Width of the picture, pixels.
    pub width: usize,
    /// Share of wall by colour, 0 to 1, of each pixel of the picture.
    pub shares: Vec<f32>,
    /// How well each pixel fitted the expected wall, 0 to 1, at a lower resolution; empty where the picture did not.
    pub weights: Vec<f32>,
    /// Width of that resolution, pixels.
    pub weights_width: usize,
}

impl WallMask {
    /// The mask at the picture's size, one channel, 0 to 255: the product of both, all 0 where nothing fitted.
    pub fn picture(&self) -> Image<u8> {
        let (width, height) = (self.width, self.shares.len() / self.width.max(1));
        let rows = self.weights.len() / self.weights_width.max(1);
        let counted = |(index, share): (usize, &f32)| {
            let at = (index / width * rows / height) * self.weights_width + index % width * self.weights_width / width;
            (255.0 * share * self.weights.get(at).copied().unwrap_or(0.0)).round() as u8
        };
        Image { width, height, channels: 1, data: self.shares.iter().enumerate().map(counted).collect() }
    }
}

/// A method that answers while the film goes on.
pub trait FollowFrames {
    /// Takes frames from `next` until there are none, the first one of `known` first, and hands each answer to
    /// `answer`. Of `known`, images, times and poses are not read: they come with the frames.
    ///
    /// Errors: those of [`Observation::validate`], of `next` and of `answer`.
    fn follow(
        &self,
        known: &Observation,
        next: &mut dyn FnMut() -> Result<Option<ArrivedFrame>>,
        answer: &mut dyn FnMut(LiveAnswer) -> Result<()>,
    ) -> Result<()>;
}

/// A reconstruction method.
pub trait Reconstruct: Send + Sync {
    /// The header of its file, which every kind has.
    fn header(&self) -> &MethodHeader;

    /// Its id in tables and folders.
    fn id(&self) -> &str {
        &self.header().id
    }

    /// When it is run.
    fn listing(&self) -> Listing {
        self.header().listing
    }

    /// What it asks for.
    fn access(&self) -> Access;

    /// Whether its answers depend on [`Observation::seed`], or it is told poses that do: then one seed says little. By
    /// default rough poses alone are drawn.
    fn draws(&self) -> bool {
        self.access().poses == PoseAccuracy::Rough
    }

    /// The method as one that answers while the film goes on, where it can.
    fn live(&self) -> Option<&dyn FollowFrames> {
        None
    }

    /// Fits all frames in order, passing each answer to `emit`.
    fn run(
        &self,
        observation: &Observation,
        emit: &mut dyn FnMut(FramePrediction) -> Result<()>,
        progress: &dyn Progress,
    ) -> Result<Reconstruction>;
}
