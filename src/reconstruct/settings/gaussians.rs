//! Settings of the Gaussians themselves, shared by the kinds of methods.

use serde::{Deserialize, Serialize};

use super::keys::Keys;
use super::sourced::Sourced;
use crate::base::Result;
use crate::splat::DiscFrame;

/// How many Gaussians a mesh gets.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged, expecting = "expected a whole number or \"auto\"")]
pub enum PerFace {
    /// This many on every face.
    Count(u32),
    /// As many per face as `gaussian_budget` allows, 1 to 25.
    Auto(Auto),
}

/// The word `auto`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Auto {
    /// The word `auto`.
    Auto,
}

impl PerFace {
    /// Gaussians per face of a mesh with `faces` faces.
    pub fn resolve(self, faces: usize, budget: u32) -> usize {
        match self {
            PerFace::Count(n) => n.max(1) as usize,
            PerFace::Auto(_) => (budget as usize / faces.max(1)).clamp(1, 25),
        }
    }
}

/// How many Gaussians there are, and what they look like at first.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct GaussianSettings {
    /// Gaussians per face; free Gaussians with 1 start at the face centroids, otherwise at random points.
    pub gaussians_per_face: Sourced<PerFace>,
    /// How many in all when `gaussians_per_face` is `auto`.
    pub gaussian_budget: Sourced<u32>,
    /// Opacity of all Gaussians; it is not learned.
    pub opacity: Sourced<f64>,
    /// Factor on the initial spread (1 = root mean square distance to the three nearest centres).
    pub initial_scale: Sourced<f64>,
}

/// Adam rates per iteration of the parameters that every kind with an optimiser learns.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ColorRates {
    /// Rate of the centres: barycentric logits for discs on a mesh, mm for free Gaussians.
    pub position_rate: Sourced<f64>,
    /// Rate of the constant SH coefficients.
    pub sh_dc_rate: Sourced<f64>,
    /// Rate of the linear SH coefficients.
    pub sh_rest_rate: Sourced<f64>,
}

/// Discs on a mesh and what is learned of them.
#[derive(Clone, Debug, PartialEq)]
pub struct AnchoredAppearance {
    /// How many there are, and what they look like at first.
    pub gaussians: GaussianSettings,
    /// Rates of centres and colours.
    pub rates: ColorRates,
    /// Adam rate of log scales.
    pub scale_rate: Sourced<f64>,
    /// Largest scale, as a multiple of the initial one; 0 for no limit.
    pub scale_cap: Sourced<f64>,
}

impl AnchoredAppearance {
    /// Takes its keys.
    pub fn read(keys: &mut Keys) -> Result<Self> {
        let (gaussians, rates) = (keys.part()?, keys.part()?);
        Ok(AnchoredAppearance {
            gaussians,
            rates,
            scale_rate: keys.key("scale_rate")?,
            scale_cap: keys.key("scale_cap")?,
        })
    }
}

/// Free Gaussians and what is learned of them.
#[derive(Clone, Debug, PartialEq)]
pub struct FreeAppearance {
    /// How many there are, and what they look like at first.
    pub gaussians: GaussianSettings,
    /// Rates of centres and colours.
    pub rates: ColorRates,
    /// Adam rate of quaternions.
    pub rotation_rate: Sourced<f64>,
}

impl FreeAppearance {
    /// Takes its keys.
    pub fn read(keys: &mut Keys) -> Result<Self> {
        let (gaussians, rates) = (keys.part()?, keys.part()?);
        Ok(FreeAppearance { gaussians, rates, rotation_rate: keys.key("rotation_rate")? })
    }
}

/// How the discs of a mesh are made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DiscLayout {
    /// Discs per face.
    pub per_face: PerFace,
    /// How many in all when that is `auto`.
    pub budget: u32,
    /// Opacity of all.
    pub opacity: f64,
    /// Factor on the spread.
    pub initial_scale: f64,
    /// Largest scale, as a multiple of the initial one; 0 for no limit.
    pub scale_cap: f64,
}

impl From<&GaussianSettings> for DiscLayout {
    fn from(settings: &GaussianSettings) -> Self {
        DiscLayout {
            per_face: *settings.gaussians_per_face,
            budget: *settings.gaussian_budget,
            opacity: *settings.opacity,
            initial_scale: *settings.initial_scale,
            scale_cap: 0.0,
        }
    }
}

impl From<&AnchoredAppearance> for DiscLayout {
    fn from(settings: &AnchoredAppearance) -> Self {
        DiscLayout { scale_cap: *settings.scale_cap, ..DiscLayout::from(&settings.gaussians) }
    }
}

/// What a disc takes over from its face as the mesh deforms.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Inherits {
    /// Rotation and stretch of the face.
    Stretch,
    /// The direction of its normal, as BridgeSplat has it.
    Normal,
}

impl From<Inherits> for DiscFrame {
    fn from(inherits: Inherits) -> Self {
        match inherits {
            Inherits::Stretch => DiscFrame::InheritStretch,
            Inherits::Normal => DiscFrame::NormalOnly,
        }
    }
}

/// Which part of the airway is computed at all.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Visibility {
    /// Faces whose centre lies this far outside the image still count (share of the image width).
    pub margin: Sourced<f64>,
    /// Faces farther away than this (mm) do not.
    pub range_mm: Sourced<f64>,
}
