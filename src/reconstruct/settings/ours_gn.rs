//! Settings of `ours-gn`.

use serde::{Deserialize, Serialize};

use super::gaussians::{GaussianSettings, Visibility};
use super::header::MethodHeader;
use super::keys::{Keys, MethodSettings};
use super::ours::KeyframeSettings;
use super::sourced::Sourced;
use crate::base::Result;

/// The scope's lamp and lens, as an image of a white sheet shows them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ScopeCalibration {
    /// Angle from the axis in degrees at which the lamp is half as bright as on it; 0 = even.
    pub emission_half_angle_deg: Sourced<f64>,
    /// Darkening `v` of the lens: brightness is multiplied by `1 - v (1 - cos^4)` of the angle to the axis.
    pub vignette: Sourced<f64>,
}

/// How a frame is compared with the CT's surface.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SurfaceMatching {
    /// Way of the wall over the image, as a share of its width, on which the phase comes nearer to the surface's by a factor
    /// of e, where the surface explains half of the picture's contrast; 0 = not compared.
    pub flow: Sourced<f64>,
    /// Images are halved until they are no wider than this many pixels.
    pub largest_width: Sourced<u32>,
    /// Half width of the neighbourhood of local contrast, as a share of the image's width.
    pub contrast_radius: Sourced<f64>,
    /// Distance of the phases that are tried.
    pub spacing: Sourced<f64>,
}

/// Settings of `ours-gn`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct OursGnSettings {
    /// What every method file says.
    #[serde(flatten)]
    pub header: MethodHeader,
    /// Gauss-Newton steps at a quarter, half and full resolution.
    pub steps: Sourced<[u32; 3]>,
    /// Pyramid levels with fewer pixels than this a side are left out.
    pub smallest_width: Sourced<u32>,
    /// Residual beyond which the cost is linear, in robust standard deviations.
    pub huber: Sourced<f64>,
    /// Edge of the square blocks within which residuals are correlated, as a share of the image width.
    pub block_share: Sourced<f64>,
    /// Longest Gauss-Newton step of the phase.
    pub longest_step: Sourced<f64>,
    /// Share of the last change of phase that the prediction repeats.
    pub velocity: Sourced<f64>,
    /// Standard deviation of the phase around its prediction.
    pub prior_deviation: Sourced<f64>,
    /// A cost of this many times its running mean starts a search over all phases.
    pub lost_factor: Sourced<f64>,
    /// Grid steps of that search, and of the first frame's.
    pub grid_steps: Sourced<u32>,
    /// Largest relative change of the exposure gain, which is fitted in closed form per channel and frame.
    pub exposure_limit: Sourced<f64>,
    /// Encoded brightness, `brightness^(1 / 2.2)`, falls with distance to this power.
    pub falloff_exponent: Sourced<f64>,
    /// Light that does not depend on the incidence, as a share of that which does.
    pub indirect_share: Sourced<f64>,
    /// Sweeps over the albedo in the first frame and in the others.
    pub appearance_steps: Sourced<[u32; 2]>,
    /// Further sweeps over the colours that the prediction shows; they are forgotten after the frame.
    pub touch_up_steps: Sourced<u32>,
    /// Whether the prediction repeats the last breath once the period is known.
    pub period_prior: Sourced<bool>,
    /// Whether the given poses are rough and to be refined.
    pub unknown_pose: Sourced<bool>,
    /// Standard deviation per axis of the error of the first given pose: rad, mm.
    pub pose_deviation: Sourced<[f64; 2]>,
    /// Standard deviation per axis of the change of that error per second: rad, mm.
    pub pose_drift: Sourced<[f64; 2]>,
    /// Correlation time of that change in seconds.
    pub pose_steady_s: Sourced<f64>,
    /// Where poses are refined, factor on the standard deviations that an image's residuals suggest.
    pub pose_caution: Sourced<f64>,
    /// Centres of the correction of the displacement field that each frame estimates; 0 = no correction.
    pub correction_rank: Sourced<u32>,
    /// Reach of the correction around a centre (standard deviation of a Gaussian).
    pub correction_reach_mm: Sourced<f64>,
    /// Standard deviation per axis of the registration error.
    pub correction_deviation_mm: Sourced<f64>,
    /// Weight of a disc's former albedo against the image, in pixels: where the wall is far or seen at a grazing angle,
    /// several discs share a pixel and the image cannot tell them apart.
    pub hold_pixels: Sourced<f64>,
    /// Frames whose weight the remembered albedo has against the present one.
    pub memory_frames: Sourced<f64>,
    /// Standard deviation of the estimated phase, as a multiple of the one that the keyframes yield.
    pub window_deviation_factor: Sourced<f64>,
    /// The least standard deviation, added in squares.
    pub window_deviation_floor: Sourced<f64>,
    /// Keyframes.
    pub window: KeyframeSettings,
    /// The CT's surface.
    pub surface: SurfaceMatching,
    /// The scope's lamp and lens.
    pub scope: ScopeCalibration,
    /// Discs.
    pub discs: GaussianSettings,
    /// What is left out.
    pub visibility: Visibility,
}

impl MethodSettings for OursGnSettings {
    fn read(keys: &mut Keys) -> Result<Self> {
        keys.part()
    }
}
