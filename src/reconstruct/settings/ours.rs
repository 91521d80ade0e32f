//! Settings of `ours`, of `ours-nomesh`, and of the sanity rows `static-ct` and `oracle-phase`.

use serde::{Deserialize, Serialize};

use super::gaussians::{AnchoredAppearance, FreeAppearance, Inherits, Visibility};
use super::header::MethodHeader;
use super::keys::{Keys, MethodSettings};
use super::sourced::Sourced;
use crate::base::Result;
use crate::reconstruct::activation::Activation;

/// How the appearance of a frame is fitted, wherever its phase comes from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FrameFitSettings {
    /// Iterations of stage (i), theta alone; (ii), appearance alone; (iii), both. Where the phase is given, (i) is
    /// left out and (iii) is appearance alone.
    pub iterations: Sourced<[u32; 3]>,
    /// A stage ends early when its last five iterations lowered the loss by less than this share of it (0 = never).
    pub settled: Sourced<f64>,
    /// Factor on the appearance iterations in the first frame.
    pub first_frame_factor: Sourced<f64>,
    /// w_s of Eq. 4, the weight of SSIM.
    pub ssim_weight: Sourced<f64>,
    /// Largest relative change of the exposure, which is fitted in closed form per frame: with a fall-off, since the
    /// frame before, and kept; without one, per channel, of this frame alone. 0 = no change.
    pub exposure_limit: Sourced<f64>,
    /// Encoded brightness falls with distance to this power (0 = appearance is carried over as is).
    pub falloff_exponent: Sourced<f64>,
    /// Light that does not depend on the incidence, as a share of that which does.
    pub indirect_share: Sourced<f64>,
    /// Whether colours are kept within what a wall can show, and those of Gaussians behind the rendered surface as they
    /// were: not in the paper.
    pub guarded_colors: Sourced<bool>,
    /// Whether Gaussians that no frame has shown get the colour of the wall beside them in a second camera's view: not in
    /// the paper.
    pub lent_colors: Sourced<bool>,
    /// What is left out.
    pub visibility: Visibility,
}

/// How the phase of a frame is estimated.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PhaseEstimation {
    /// w_c of Eq. 4, the weight of the photometric loss against the temporal term. The fit of appearance alone does
    /// not depend on it.
    pub color_weight: Sourced<f64>,
    /// w_s of Eq. 4 where theta alone is optimised.
    pub phase_ssim_weight: Sourced<f64>,
    /// w_t of Eq. 4, the weight of the change of phase since the last frame.
    pub temporal_weight: Sourced<f64>,
    /// How theta becomes a phase: `cosine-leak` (Eq. 3), or the ablations `sigmoid` and `clamp`.
    pub activation: Sourced<Activation>,
    /// eps of Eq. 3.
    pub phase_leak: Sourced<f64>,
    /// Adam rate of theta in stage (i): first and last iteration, geometric between.
    pub theta_rate: Sourced<[f64; 2]>,
    /// Adam rate of theta in stage (iii): first and last iteration, geometric between.
    pub theta_rate_joint: Sourced<[f64; 2]>,
    /// Phases tried before stage (i), relative to the guess; stage (i) starts from the one with the least loss.
    pub candidates: Sourced<Vec<f64>>,
    /// Share of the last change of phase that the guess repeats.
    pub velocity: Sourced<f64>,
    /// Steps of the first frame's grid search over phase.
    pub grid_steps: Sourced<u32>,
    /// Whether Gaussians that no frame has shown get the colours of a frame before its stage (i) as well, not after it alone.
    pub colored_before_phase: Sourced<bool>,
    /// Frames whose mean colour the phase is measured on (0 = the colours of the last frame, as the paper has it).
    pub memory_frames: Sourced<f64>,
}

/// Keyframes against whose images the phase of each frame is measured, independently of the map.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct KeyframeSettings {
    /// Number of keyframes; 0 = the map alone.
    pub keyframes: Sourced<u32>,
    /// Share of the accumulated information that is kept when a keyframe is added.
    pub memory: Sourced<f64>,
    /// Standard deviation of the map's phase, as the prior of the measurement.
    pub prior_deviation: Sourced<f64>,
}

/// Discs on the breathing mesh.
#[derive(Clone, Debug, PartialEq)]
pub struct AnchoredDiscs {
    /// When a face in view is given more discs, and what the discs take over from it.
    pub on_face: OnFace,
    /// The discs and what is learned of them.
    pub appearance: AnchoredAppearance,
    /// How fast they are learned, beside the rates.
    pub pace: LearningPace,
}

/// What the steps of Adam depend on beside the rates.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LearningPace {
    /// Adam's epsilon, as the L1 gradient of a colour that fills this share of the picture; 0 is the published 1e-15.
    pub quiet_share: Sourced<f64>,
    /// Seconds between the frames of a film that is learned at the rates as they stand; another film's rates grow and
    /// shrink with its interval, and 0 leaves them.
    pub rate_interval_s: Sourced<f64>,
}

/// How the discs of a face follow it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct OnFace {
    /// A face in view gets more discs while each covers more pixels than this (0 = never).
    pub pixels_per_disc: Sourced<f64>,
    /// Largest number of discs that a face in view asks for.
    pub most_per_face: Sourced<u32>,
    /// Whether discs on faces that a wall hides, or that look away from the camera, are left out of a frame: not in the
    /// paper.
    pub hidden_left_out: Sourced<bool>,
    /// Whether the depth handed out is that of the mesh at the estimated phase, not that of the rendered discs: not in the
    /// paper.
    pub depth_of_surface: Sourced<bool>,
    /// What a disc takes over from its deformed face: `stretch` (direction and stretch) or `normal` (direction alone).
    pub inherits: Sourced<Inherits>,
}

impl AnchoredDiscs {
    fn read(keys: &mut Keys) -> Result<Self> {
        let on_face = keys.part()?;
        keys.table("appearance", |table| {
            let (appearance, pace) = (AnchoredAppearance::read(table)?, table.part()?);
            Ok(AnchoredDiscs { on_face, appearance, pace })
        })
    }
}

/// Settings of `ours`.
#[derive(Clone, Debug, PartialEq)]
pub struct OursSettings {
    /// What every method file says.
    pub header: MethodHeader,
    /// How the appearance is fitted.
    pub fit: FrameFitSettings,
    /// How the phase is estimated.
    pub estimation: PhaseEstimation,
    /// Keyframes.
    pub window: KeyframeSettings,
    /// Discs.
    pub discs: AnchoredDiscs,
}

impl MethodSettings for OursSettings {
    fn read(keys: &mut Keys) -> Result<Self> {
        Ok(OursSettings {
            header: keys.part()?,
            fit: keys.part()?,
            estimation: keys.part()?,
            window: keys.key("window")?,
            discs: AnchoredDiscs::read(keys)?,
        })
    }
}

/// Settings of `static-ct` and `oracle-phase`, which are given the phase.
#[derive(Clone, Debug, PartialEq)]
pub struct GivenPhaseSettings {
    /// What every method file says.
    pub header: MethodHeader,
    /// How the appearance is fitted.
    pub fit: FrameFitSettings,
    /// Discs.
    pub discs: AnchoredDiscs,
}

impl MethodSettings for GivenPhaseSettings {
    fn read(keys: &mut Keys) -> Result<Self> {
        let (header, fit) = (keys.part()?, keys.part()?);
        Ok(GivenPhaseSettings { header, fit, discs: AnchoredDiscs::read(keys)? })
    }
}

/// Settings of `ours-nomesh`.
#[derive(Clone, Debug, PartialEq)]
pub struct OursNomeshSettings {
    /// What every method file says.
    pub header: MethodHeader,
    /// How the appearance is fitted.
    pub fit: FrameFitSettings,
    /// How the phase is estimated.
    pub estimation: PhaseEstimation,
    /// Gaussians.
    pub appearance: FreeAppearance,
    /// Adam rate of log scales.
    pub scale_rate: Sourced<f64>,
    /// How fast they are learned, beside the rates.
    pub pace: LearningPace,
}

impl MethodSettings for OursNomeshSettings {
    fn read(keys: &mut Keys) -> Result<Self> {
        let (header, fit, estimation) = (keys.part()?, keys.part()?, keys.part()?);
        keys.table("appearance", |table| {
            let appearance = FreeAppearance::read(table)?;
            let (scale_rate, pace) = (table.key("scale_rate")?, table.part()?);
            Ok(OursNomeshSettings { header, fit, estimation, appearance, scale_rate, pace })
        })
    }
}
