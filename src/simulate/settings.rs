//! How a case is filmed, and which files a sequence of it has.

use serde::{Deserialize, Serialize};

use super::sequence;
use super::truth::{TruthMap, TruthSet};
use crate::airway::case::Case;
use crate::base::range::{FRAME_RATE, FRAMES, IMAGE_SIDE_PX, NumberRange, SAMPLES_PER_PIXEL};
use crate::base::{Error, Estimate, Result};

/// Renderings whose mean is a blurred frame; odd, so that the middle one is the frame's own moment.
pub(super) const MOMENTS: u64 = 7;
/// The model behind [`SimulationSettings::estimate`], core seconds: of a rendering whatever its size (moving the wall,
/// light at its vertices), of a camera sample, of a pixel of the files, of a breath that a phase walks through.
const FRAME_S: f64 = 0.3;
const SAMPLE_S: f64 = 1e-6;
const PIXEL_S: f64 = 2e-6;
const BREATH_S: f64 = 1e-7;
/// A frame of the clinical track over a rendering: motion, shadows, drops, blur.
const CLINICAL_LOOKS: f64 = 1.8;
/// The same, bytes: of the airway with its light, of a pixel, of a frame's row in the tables.
const FILM_BYTES: f64 = 2.5e8;
const PIXEL_BYTES: f64 = 400.0;
const FRAME_BYTES: f64 = 1000.0;

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

/// How exactly light that walls send each other, and that scatters in them, is found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FilmLight {
    /// To half a per cent of a frame's mean.
    #[default]
    Full,
    /// In a third of the time, and off by tens of per cent here and there: for a look, and for tests.
    Draft,
}

impl FilmLight {
    /// Whether it is the default, which no key names.
    pub fn is_full(&self) -> bool {
        *self == FilmLight::Full
    }
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
    /// Light between and in the walls.
    #[serde(skip_serializing_if = "FilmLight::is_full")]
    pub light: FilmLight,
}

impl SimulationSettings {
    /// Refuses settings that no film can have; the error names the setting.
    pub fn check(&self) -> Result<()> {
        let check = |what: &str, range: NumberRange, value: f64| {
            range.check(value).map_err(|e| Error::usage(e.to_string()).element(what))
        };
        check("image width", IMAGE_SIDE_PX, self.width_px.into())?;
        check("image height", IMAGE_SIDE_PX, self.height_px.into())?;
        check("samples per pixel", SAMPLES_PER_PIXEL, self.samples_per_pixel.into())?;
        check("frames per second", FRAME_RATE, self.frames_per_second)?;
        check("frames", FRAMES, self.frames as f64)
    }

    /// What [`super::simulate`] would cost.
    pub fn estimate(&self, case: &Case) -> Estimate {
        let frames = self.frames as f64;
        let pixels = f64::from(self.width_px) * f64::from(self.height_px);
        let waveform = &case.waveform;
        // Irregular breaths are walked through one by one up to the time that is asked for.
        let breaths = if waveform.irregularity > 0.0 {
            (waveform.start_hold_s + frames / self.frames_per_second) / waveform.period_s()
        } else {
            0.0
        };
        let moments = if case.clinical.is_some() {
            CLINICAL_LOOKS
        } else if case.scope.shutter_s > 0.0 {
            MOMENTS as f64
        } else {
            1.0
        };
        let looks = moments + if self.truth.has(TruthMap::PhaseSensitivity) { 2.0 } else { 0.0 };
        let sample_s = pixels * f64::from(self.samples_per_pixel) * SAMPLE_S;
        let frame_s = looks * (FRAME_S + breaths * BREATH_S) + sample_s * looks.min(3.0) + pixels * PIXEL_S;
        Estimate {
            memory_bytes: FILM_BYTES + pixels * PIXEL_BYTES + frames * FRAME_BYTES,
            seconds: frames * frame_s / rayon::current_num_threads() as f64,
            resumable: true,
        }
    }

    /// All files of the folder but plan and manifest, in order.
    pub(super) fn content_names(&self, case: &Case) -> Vec<String> {
        let fixed = [
            sequence::INSPIRATION,
            sequence::EXPIRATION,
            sequence::CENTERLINE,
            sequence::TARGETS,
            sequence::TARGETS_EXPIRATION,
            sequence::TRANSFORMS,
            sequence::NOVEL_TRANSFORMS,
            sequence::FRAMES,
            sequence::FORMAT,
            sequence::CONTACT_SHEET,
            sequence::PREVIEW,
        ];
        let mut names: Vec<String> = fixed.iter().map(|n| n.to_string()).collect();
        if case.scope.mask_radius > 0.0 {
            names.push(sequence::MASK.to_string());
        }
        if case.registration_error_mm > 0.0 && case.clinical.is_none() {
            names.push(sequence::REGISTERED_EXPIRATION.to_string());
        }
        if case.clinical.is_some() {
            let told = [
                sequence::TOLD_TRANSFORMS,
                sequence::TOLD_NOVEL_TRANSFORMS,
                sequence::TOLD_INSPIRATION,
                sequence::TOLD_EXPIRATION,
                sequence::TOLD_CENTERLINE,
                sequence::LAST_SURFACE,
                sequence::CONDITIONS,
                sequence::SIZES,
                sequence::TARGETS_BY_FRAME,
            ];
            names.extend(told.map(str::to_owned));
            if case.given_surfaces().is_some() {
                names.push(sequence::TOLD_CORRESPONDENCE.to_owned());
            }
        }
        names.extend((0..self.frames).flat_map(|frame| self.frame_names(case, frame)));
        names
    }

    /// The files of one frame, the image last.
    pub(super) fn frame_names(&self, case: &Case, frame: usize) -> Vec<String> {
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
        if sequence::held_out(frame) {
            names.push(sequence::novel_depth_name(frame));
            names.push(sequence::novel_image_name(frame));
        }
        if case.clinical.is_some() {
            names.push(sequence::covered_name(frame));
        }
        names.push(sequence::image_name(frame));
        names
    }
}
