//! Settings of the rows that render the CT's surface itself: `pose-only`, `mean-breath`, `virtual-bronchoscopy`.

use serde::{Deserialize, Serialize};

use super::gaussians::Visibility;
use super::header::MethodHeader;
use super::keys::{Keys, MethodSettings};
use super::sourced::Sourced;
use crate::base::Result;

/// Settings of `pose-only`.
#[derive(Clone, Debug, PartialEq)]
pub struct PoseOnlySettings {
    /// What every method file says.
    pub header: MethodHeader,
    /// Phases that are tried, evenly spaced.
    pub grid_steps: Sourced<u32>,
    /// What is left out.
    pub visibility: Visibility,
}

impl MethodSettings for PoseOnlySettings {
    fn read(keys: &mut Keys) -> Result<Self> {
        Ok(PoseOnlySettings {
            header: keys.part()?,
            grid_steps: keys.key("grid_steps")?,
            visibility: keys.key("visibility")?,
        })
    }
}

/// How a frame is compared with virtual views.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ContrastMatching {
    /// Phases that are tried, evenly spaced.
    pub grid_steps: Sourced<u32>,
    /// Images are halved until they are no wider than this many pixels.
    pub largest_width: Sourced<u32>,
    /// Half width of the neighbourhood of local contrast, as a share of the image's width.
    pub contrast_radius: Sourced<f64>,
}

/// Settings of `virtual-bronchoscopy`.
#[derive(Clone, Debug, PartialEq)]
pub struct VirtualBronchoscopySettings {
    /// What every method file says.
    pub header: MethodHeader,
    /// The comparison.
    pub matching: ContrastMatching,
    /// What is left out.
    pub visibility: Visibility,
}

impl MethodSettings for VirtualBronchoscopySettings {
    fn read(keys: &mut Keys) -> Result<Self> {
        Ok(VirtualBronchoscopySettings {
            header: keys.part()?,
            matching: keys.part()?,
            visibility: keys.key("visibility")?,
        })
    }
}

/// Settings of `mean-breath`.
#[derive(Clone, Debug, PartialEq)]
pub struct MeanBreathSettings {
    /// What every method file says.
    pub header: MethodHeader,
    /// The comparison, while the offset is looked for.
    pub matching: ContrastMatching,
    /// Seconds at the start of the film whose images are compared.
    pub calibration_s: Sourced<f64>,
    /// Offsets that are tried, evenly spaced over a breath.
    pub offsets: Sourced<u32>,
    /// What is left out.
    pub visibility: Visibility,
}

impl MethodSettings for MeanBreathSettings {
    fn read(keys: &mut Keys) -> Result<Self> {
        Ok(MeanBreathSettings {
            header: keys.part()?,
            matching: keys.part()?,
            calibration_s: keys.key("calibration_s")?,
            offsets: keys.key("offsets")?,
            visibility: keys.key("visibility")?,
        })
    }
}
