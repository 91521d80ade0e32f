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

/// How a picture is compared with the wall while the pose is looked for, too.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PictureMatching {
    /// Pictures are halved until they are no wider than this many pixels.
    pub largest_width: Sourced<u32>,
    /// Gauss-Newton steps at a quarter of that width, half of it and at it.
    pub steps: Sourced<[u32; 3]>,
    /// Half width of the neighbourhood of local contrast, as a share of the image's width.
    pub contrast_radius: Sourced<f64>,
    /// Residual beyond which the cost is linear, in robust standard deviations.
    pub huber: Sourced<f64>,
}

/// Where the pose is looked for, where it is measured and not known.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PoseSearch {
    /// Farthest from the measured pose, rad and mm.
    pub reach: Sourced<[f64; 2]>,
    /// Correlation below which a picture does not show the wall, so that the measured pose stays.
    pub least_correlation: Sourced<f64>,
    /// The comparison.
    #[serde(flatten)]
    pub picture: PictureMatching,
}

/// Settings of `virtual-bronchoscopy`.
#[derive(Clone, Debug, PartialEq)]
pub struct VirtualBronchoscopySettings {
    /// What every method file says.
    pub header: MethodHeader,
    /// The comparison.
    pub matching: ContrastMatching,
    /// The pose, where it is measured.
    pub pose: PoseSearch,
    /// What is left out.
    pub visibility: Visibility,
}

impl MethodSettings for VirtualBronchoscopySettings {
    fn read(keys: &mut Keys) -> Result<Self> {
        Ok(VirtualBronchoscopySettings {
            header: keys.part()?,
            matching: keys.part()?,
            pose: keys.key("pose")?,
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
