//! How a case is filmed, and which files a sequence of it has.

use serde::Serialize;

use super::sequence;
use super::truth::{TruthMap, TruthSet};
use crate::airway::case::Case;
use crate::base::{Error, Result};

/// Which meshes a sequence folder holds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum MeshOutput {
    /// Inspiration and expiration: any other follows from the phase.
    #[default]
    EndStates,
    /// The deformed mesh of every frame as well.
    EveryFrame,
}

/// Whether linear images are kept beside the 8-bit ones.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum RadianceOutput {
    /// 8-bit sRGB only.
    #[default]
    None,
    /// Linear radiance before gain and white balance, as OpenEXR.
    Exr,
}

/// How a case is filmed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SimulationSettings {
    /// Image width in pixels.
    pub width_px: u32,
    /// Image height in pixels.
    pub height_px: u32,
    /// Frame rate of the video.
    pub frames_per_second: f64,
    /// Number of frames.
    pub frames: usize,
    /// Paths traced per pixel.
    pub samples_per_pixel: u32,
    /// Meshes to write.
    pub meshes: MeshOutput,
    /// Linear images to write.
    pub radiance: RadianceOutput,
    /// Ground-truth images to write.
    pub truth: TruthSet,
}

impl SimulationSettings {
    /// Refuses settings that no film can have.
    pub(super) fn check(&self) -> Result<()> {
        let size = |v: u32| (1..=8192).contains(&v);
        if !size(self.width_px) || !size(self.height_px) || self.samples_per_pixel == 0 {
            return Err(Error::usage(
                "a film needs images of 1 to 8192 pixels a side and at least one sample per pixel",
            ));
        }
        if self.frames < 2 || !(self.frames_per_second.is_finite() && self.frames_per_second > 0.0) {
            return Err(Error::usage("a film needs at least two frames and a positive frame rate"));
        }
        Ok(())
    }

    /// All files of the folder but plan and manifest, in order.
    pub(super) fn content_names(&self, case: &Case) -> Vec<String> {
        let fixed = [
            sequence::INSPIRATION,
            sequence::EXPIRATION,
            sequence::CENTERLINE,
            sequence::TRANSFORMS,
            sequence::FRAMES,
            sequence::FORMAT,
            sequence::CONTACT_SHEET,
            sequence::PREVIEW,
        ];
        let mut names: Vec<String> = fixed.iter().map(|n| n.to_string()).collect();
        if case.scope.mask_radius > 0.0 {
            names.push(sequence::MASK.to_string());
        }
        if case.registration_error_mm > 0.0 {
            names.push(sequence::REGISTERED_EXPIRATION.to_string());
        }
        names.extend((0..self.frames).flat_map(|frame| self.frame_names(frame)));
        names
    }

    /// The files of one frame, the image last.
    pub(super) fn frame_names(&self, frame: usize) -> Vec<String> {
        let truth = [
            (TruthMap::Normals, true, sequence::normal_name(frame)),
            (TruthMap::Albedo, true, sequence::albedo_name(frame)),
            (TruthMap::Motion, frame + 1 < self.frames, sequence::forward_motion_name(frame)),
            (TruthMap::Motion, frame > 0, sequence::backward_motion_name(frame)),
            (TruthMap::PhaseSensitivity, true, sequence::sensitivity_name(frame)),
        ];
        let mut names = vec![sequence::depth_name(frame)];
        names.extend(truth.into_iter().filter(|(map, exists, _)| *exists && self.truth.has(*map)).map(|t| t.2));
        if self.meshes == MeshOutput::EveryFrame {
            names.push(sequence::frame_mesh_name(frame));
        }
        if self.radiance == RadianceOutput::Exr {
            names.push(sequence::radiance_name(frame));
        }
        names.push(sequence::image_name(frame));
        names
    }
}
