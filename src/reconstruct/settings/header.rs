//! What every method file says, whatever its kind.

use serde::{Deserialize, Serialize};

/// Which program runs a method.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MethodKind {
    /// Discs on the CT mesh, one breathing phase per frame: the paper's method.
    Ours,
    /// The same on the inspiration mesh, which does not move.
    StaticCt,
    /// The same on the expiration mesh, which does not move.
    StaticExpiration,
    /// The same with the true phase given.
    OraclePhase,
    /// Free Gaussians, one breathing phase per frame.
    OursNomesh,
    /// Discs on the CT mesh, the phase by Gauss-Newton.
    OursGn,
    /// The CT's surface under the scope's lamp; pose, phase and what else is not told, in one state.
    OursNav,
    /// BridgeSplat with its mesh.
    Bridgesplat,
    /// BridgeSplat without its mesh.
    BridgesplatNomesh,
    /// The CT's surface at the phase whose lumen is best centred on the given pose; no picture.
    PoseOnly,
    /// The CT's surface at the phase of a mean breath.
    MeanBreath,
    /// The CT's surface at the phase whose view correlates best with the frame.
    VirtualBronchoscopy,
}

/// When a method is run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Listing {
    /// Unless others are named.
    #[default]
    Always,
    /// On the clinical track unless others are named, on the ideal one only where it is named: a row that estimates what
    /// is exact there.
    Clinical,
    /// Only where it is named: a variant of a row of the table.
    OnRequest,
}

/// The keys that every method file has. A file does not inherit them from its base.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MethodHeader {
    /// Id in tables and folders; the file's name.
    pub id: String,
    /// Which program runs it.
    pub kind: MethodKind,
    /// One line for people.
    pub description: String,
    /// When it is run; `always` where the file does not say.
    #[serde(default)]
    pub listing: Listing,
    /// Id of the method whose numbers hold where this file gives none.
    #[serde(default)]
    pub base: Option<String>,
}

impl MethodHeader {
    /// The keys of a header.
    pub const KEYS: [&str; 5] = ["id", "kind", "description", "listing", "base"];
}
