//! Settings of `bridgesplat` and `bridgesplat-nomesh`. Weights and rates are in released units, 1 unit = 100 mm.

use serde::{Deserialize, Serialize};

use super::gaussians::{AnchoredAppearance, FreeAppearance, Visibility};
use super::header::MethodHeader;
use super::keys::{Keys, MethodSettings};
use super::sourced::Sourced;
use crate::base::Result;

/// Which objective of BridgeSplat is minimised.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum BridgeObjective {
    /// With rigidity and isometry as the paper names them; the row of the table.
    Full,
    /// What the released code computes: colour, ARAP, visibility.
    Release,
}

/// What a change of length is counted in by isometry.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum IsometryLength {
    /// Units, as in the code that BridgeSplat was built on (OET), with the same weight.
    Unit,
    /// The mean distance of neighbours at rest, as in a line of the released code that is commented out.
    MeanDistance,
}

/// Keys of both kinds of BridgeSplat.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BridgeCommon {
    /// Iterations of the first frame and of the others.
    pub iterations: Sourced<[u32; 2]>,
    /// Iteration of the first frame after which linear SH coefficients are learned.
    pub sh_from_iteration: Sourced<u32>,
    /// Millimetres per unit.
    pub unit_mm: Sourced<f64>,
    /// Weight of the masked L1.
    pub color_weight: Sourced<f64>,
    /// Weight of the displacement of what is out of view: vertices, or anchors without a mesh.
    pub visibility_weight: Sourced<f64>,
    /// Weight of rigidity.
    pub rigid_weight: Sourced<f64>,
    /// Weight of isometry.
    pub isometry_weight: Sourced<f64>,
    /// One control point per this many visible vertices (mesh) or Gaussians (no mesh).
    pub control_subsample: Sourced<u32>,
    /// Number of control points that move a vertex.
    pub control_neighbours: Sourced<u32>,
    /// Decay of their weight per unit: `exp(-decay distance)`.
    pub control_decay: Sourced<f64>,
    /// Adam rate of control displacements (units), and without mesh of quaternion offsets.
    pub displacement_rate: Sourced<f64>,
    /// What is left out.
    pub visibility: Visibility,
}

/// Settings of `bridgesplat`.
#[derive(Clone, Debug, PartialEq)]
pub struct BridgesplatSettings {
    /// What every method file says.
    pub header: MethodHeader,
    /// What both kinds read.
    pub common: BridgeCommon,
    /// `full` (working rigidity and isometry; the row of the table) or `release` (what the released code computes).
    pub variant: BridgeObjective,
    /// What a change of length is counted in by isometry.
    pub isometry_length: Sourced<IsometryLength>,
    /// Weight of the ARAP sum.
    pub arap_weight: Sourced<f64>,
    /// Discs.
    pub appearance: AnchoredAppearance,
}

impl MethodSettings for BridgesplatSettings {
    fn read(keys: &mut Keys) -> Result<Self> {
        Ok(BridgesplatSettings {
            header: keys.part()?,
            common: keys.part()?,
            variant: keys.key("variant")?,
            isometry_length: keys.key("isometry_length")?,
            arap_weight: keys.key("arap_weight")?,
            appearance: keys.table("appearance", AnchoredAppearance::read)?,
        })
    }
}

/// Settings of `bridgesplat-nomesh`.
#[derive(Clone, Debug, PartialEq)]
pub struct BridgesplatNomeshSettings {
    /// What every method file says.
    pub header: MethodHeader,
    /// What both kinds read.
    pub common: BridgeCommon,
    /// Weight of rotation similarity (the mesh kind has no rotations).
    pub rotation_weight: Sourced<f64>,
    /// Gaussians. Their scales stay as they are.
    pub appearance: FreeAppearance,
}

impl MethodSettings for BridgesplatNomeshSettings {
    fn read(keys: &mut Keys) -> Result<Self> {
        Ok(BridgesplatNomeshSettings {
            header: keys.part()?,
            common: keys.part()?,
            rotation_weight: keys.key("rotation_weight")?,
            appearance: keys.table("appearance", FreeAppearance::read)?,
        })
    }
}
