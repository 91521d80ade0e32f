//! Settings of `ours-nav`.

use serde::{Deserialize, Serialize};

use super::gaussians::Visibility;
use super::header::MethodHeader;
use super::keys::{Keys, MethodSettings};
use super::sourced::Sourced;
use super::virtual_view::PictureMatching;
use crate::base::Result;

/// What is known of the sensor that tells the poses. Standard deviations, each along or about one axis.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SensorNoise {
    /// White noise of each frame, rad and mm.
    pub noise: Sourced<[f64; 2]>,
    /// What the poses are off by at the start of the film, rad and mm.
    pub bias: Sourced<[f64; 2]>,
    /// How far that drifts within a second, rad and mm; it grows with the square root of the time.
    pub drift: Sourced<[f64; 2]>,
    /// How old a pose is, and how surely that is known, s.
    pub delay_s: Sourced<[f64; 2]>,
}

/// How the tip moves: standard deviations of its rates, each along or about one axis.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TipMotion {
    /// Rates, rad/s and mm/s.
    pub rate: Sourced<[f64; 2]>,
    /// Time after which a rate is forgotten, s.
    pub steady_s: Sourced<f64>,
}

/// How tissue moves.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TissuePrior {
    /// Standard deviations of phase and its rate (1/s) at the start, in the breath hold of the first CT.
    pub start: Sourced<[f64; 2]>,
    /// For how long the breath is still held, s.
    pub hold_s: Sourced<f64>,
    /// Standard deviation of the change of the phase's rate within a second beyond that of a regular breath, 1/s.
    pub unrest: Sourced<f64>,
    /// Standard deviation per axis of the registration's error at full expiration, mm.
    pub registration_mm: Sourced<f64>,
    /// Standard deviation per axis of the motion with the air flow (hysteresis and lag) at its peak, mm.
    pub loop_mm: Sourced<f64>,
    /// Way of the scope after which both are others, mm.
    pub reach_mm: Sourced<f64>,
    /// Standard deviation per axis of motion that nothing here describes (heartbeat), mm.
    pub rest_mm: Sourced<f64>,
}

/// What is not told of lens and lamp: standard deviations.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct OpticsPrior {
    /// Image centre, as a share of the image's width, per axis.
    pub centre: Sourced<f64>,
    /// Relative error of the focal length.
    pub focal: Sourced<f64>,
    /// Place of the lamp beside the lens, mm, per axis.
    pub lamp_mm: Sourced<f64>,
}

/// How a picture is compared with the wall.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct WallMatching {
    /// How local contrasts are compared.
    #[serde(flatten)]
    pub picture: PictureMatching,
    /// Number of pixels that count as one observation: errors of neighbours are alike.
    pub together_px: Sourced<f64>,
    /// Standard deviation per axis of what the model's shading makes of a pose, rad and mm.
    pub shade: Sourced<[f64; 2]>,
    /// Time after which that is another, s.
    pub shade_s: Sourced<f64>,
    /// Correlation below which a picture does not show the wall as expected.
    pub least_correlation: Sourced<f64>,
    /// Phases that are tried then.
    pub grid_steps: Sourced<u32>,
}

/// Settings of `ours-nav`.
#[derive(Clone, Debug, PartialEq)]
pub struct OursNavSettings {
    /// What every method file says.
    pub header: MethodHeader,
    /// The sensor.
    pub sensor: SensorNoise,
    /// The tip.
    pub tip: TipMotion,
    /// Tissue.
    pub tissue: TissuePrior,
    /// Lens and lamp.
    pub optics: OpticsPrior,
    /// Pictures.
    pub matching: WallMatching,
    /// Factor on the standard deviations of targets that the filter yields.
    pub deviation_factor: Sourced<f64>,
    /// What is left out.
    pub visibility: Visibility,
}

impl MethodSettings for OursNavSettings {
    fn read(keys: &mut Keys) -> Result<Self> {
        Ok(OursNavSettings {
            header: keys.part()?,
            sensor: keys.key("sensor")?,
            tip: keys.key("tip")?,
            tissue: keys.key("tissue")?,
            optics: keys.key("optics")?,
            matching: keys.key("matching")?,
            deviation_factor: keys.key("deviation_factor")?,
            visibility: keys.key("visibility")?,
        })
    }
}
