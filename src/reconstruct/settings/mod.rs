//! The numbers of a method: one TOML file per method in `bench-cases/methods/`, each number with its source beside it:
//! `sh_rest_rate = { value = 0.000125, source = "released code", why = "configs/ATLAS/atlas_base.yaml" }`.
//!
//! A method's `kind` says which program runs it. Each kind has a type here that is put together from what several kinds
//! share and what it alone needs. A key that the kind does not read has no place in its type and is refused
//! ([`Keys`]).

mod bridgesplat;
mod gaussians;
mod header;
mod keys;
mod ours;
mod ours_gn;
mod ours_nav;
mod ranges;
mod sourced;
mod virtual_view;

pub use bridgesplat::{BridgeCommon, BridgeObjective, BridgesplatNomeshSettings, BridgesplatSettings, IsometryLength};
pub use gaussians::{
    AnchoredAppearance, Auto, ColorRates, DiscLayout, FreeAppearance, GaussianSettings, Inherits, PerFace, Visibility,
};
pub use header::{Listing, MethodHeader, MethodKind};
pub use keys::{KeyPath, Keys, MethodSettings};
pub(super) use keys::{contains, overlay, remove, replace};
pub use ours::{
    AnchoredDiscs, FrameFitSettings, GivenPhaseSettings, KeyframeSettings, OnFace, OursNomeshSettings, OursSettings,
    PhaseEstimation,
};
pub use ours_gn::{OursGnSettings, ScopeCalibration, SurfaceMatching};
pub use ours_nav::{OpticsPrior, OursNavSettings, SensorNoise, TipMotion, TissuePrior, WallMatching};
pub(super) use ranges::METHOD_RANGES;
pub use sourced::{NumberSource, Sourced};
pub use virtual_view::{
    ContrastMatching, MeanBreathSettings, PictureMatching, PoseOnlySettings, PoseSearch, VirtualBronchoscopySettings,
};
