//! The numbers of a method: one TOML per method in `bench-cases/methods/`, every number with its source beside it:
//! `sh_rate = { value = 0.0025, source = "released code", why = "configs/ATLAS/atlas_base.yaml" }`.

use std::ops::Deref;

use serde::{Deserialize, Serialize};

use super::Listing;
use super::loss::norm::Norm;
use super::phase::Activation;
use crate::splat::DiscFrame;

/// Where a number comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Source {
    /// The RESPIRE paper says so.
    #[serde(rename = "paper")]
    Paper,
    /// The released code of BridgeSplat, or of the code it was built on.
    #[serde(rename = "released code")]
    ReleasedCode,
    /// Our choice, because nobody published one.
    #[serde(rename = "ours")]
    Ours,
}

/// A value with its source.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sourced<T> {
    /// The value.
    pub value: T,
    /// Where it comes from.
    pub source: Source,
    /// Place in the source, or the reason of the choice; for people.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub why: String,
}

impl<T> Deref for Sourced<T> {
    type Target = T;
    fn deref(&self) -> &T {
        &self.value
    }
}

/// How many Gaussians a mesh gets.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged, expecting = "expected a whole number or \"auto\"")]
pub enum PerFace {
    /// So many on every face.
    Count(u32),
    /// As many as `gaussian_budget` allows, at least one.
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

/// Gaussians, what is learned of them, and how fast (Adam rates per iteration).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Appearance {
    /// Gaussians per face (mesh methods), or 1 per face centroid.
    pub gaussians_per_face: Sourced<PerFace>,
    /// How many in all when `gaussians_per_face` is `auto`.
    pub gaussian_budget: Sourced<u32>,
    /// Opacity, frozen.
    pub opacity: Sourced<f64>,
    /// Factor on the initial spread (1 = root mean square distance to the three nearest centres).
    pub initial_scale: Sourced<f64>,
    /// Most that a scale may grow over its initial value; 0 for no limit.
    pub scale_cap: Sourced<f64>,
    /// Rate of the centres: barycentric logits, or mm for free Gaussians.
    pub position_rate: Sourced<f64>,
    /// Rate of log scales.
    pub scale_rate: Sourced<f64>,
    /// Rate of quaternions (free Gaussians only).
    #[serde(default)]
    pub rotation_rate: Option<Sourced<f64>>,
    /// Adam's epsilon, as the gradient of so many image values (pixel x channel) of L1; 0 is the published 1e-15.
    #[serde(default)]
    pub quiet_values: Option<Sourced<f64>>,
    /// Rate of the constant SH coefficients.
    pub sh_dc_rate: Sourced<f64>,
    /// Rate of the linear SH coefficients.
    pub sh_rest_rate: Sourced<f64>,
}

/// Discs whose places and sizes stay as they are made.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FixedDiscs {
    /// Discs per face.
    pub gaussians_per_face: Sourced<PerFace>,
    /// How many in all when `gaussians_per_face` is `auto`.
    pub gaussian_budget: Sourced<u32>,
    /// Opacity, frozen.
    pub opacity: Sourced<f64>,
    /// Factor on the spread (1 = root mean square distance to the three nearest centres).
    pub initial_scale: Sourced<f64>,
}

/// How the discs of a mesh are made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Layout {
    /// Discs per face.
    pub per_face: PerFace,
    /// How many in all when that is `auto`.
    pub budget: u32,
    /// Opacity of all.
    pub opacity: f64,
    /// Factor on the spread.
    pub initial_scale: f64,
    /// Most that a scale may grow over its initial value; 0 for no limit.
    pub scale_cap: f64,
}

impl From<&Appearance> for Layout {
    fn from(a: &Appearance) -> Self {
        Layout {
            per_face: *a.gaussians_per_face,
            budget: *a.gaussian_budget,
            opacity: *a.opacity,
            initial_scale: *a.initial_scale,
            scale_cap: *a.scale_cap,
        }
    }
}

impl From<&FixedDiscs> for Layout {
    fn from(d: &FixedDiscs) -> Self {
        Layout {
            per_face: *d.gaussians_per_face,
            budget: *d.gaussian_budget,
            opacity: *d.opacity,
            initial_scale: *d.initial_scale,
            scale_cap: 0.0,
        }
    }
}

/// Which part of the airway is computed at all.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Visibility {
    /// Faces whose centre lies this far outside the image still count (share of the image width).
    pub margin: Sourced<f64>,
    /// Faces farther away than this (mm) do not.
    pub range_mm: Sourced<f64>,
}

/// Settings of `ours`, `ours-nomesh` and the two sanity rows.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PhaseMethod {
    /// Id in tables and folders.
    pub id: String,
    /// Which program runs it.
    pub kind: String,
    /// One line for `list`.
    pub description: String,
    /// When it is run; `always` where nothing is said.
    #[serde(default)]
    pub listing: Listing,
    /// Iterations on theta alone, appearance alone, both.
    pub iterations: Sourced<[u32; 3]>,
    /// A stage ends early when its last five iterations lowered the loss by less than this share of it (0 = never).
    pub settled: Sourced<f64>,
    /// Appearance iterations of the first frame are so many times those of the others.
    pub first_frame_factor: Sourced<f64>,
    /// w_c of Eq. 4.
    pub color_weight: Sourced<f64>,
    /// What a difference costs in the first part of Eq. 4; L1 as published where nothing is said.
    #[serde(default)]
    pub color_norm: Option<Sourced<Norm>>,
    /// w_s of Eq. 4.
    pub ssim_weight: Sourced<f64>,
    /// w_s where theta alone is optimised.
    pub phase_ssim_weight: Sourced<f64>,
    /// w_t of Eq. 4.
    pub temporal_weight: Sourced<f64>,
    /// How theta becomes a phase: `cosine-leak` (Eq. 3), or the ablations `sigmoid` and `clamp`.
    pub activation: Sourced<Activation>,
    /// eps of Eq. 3.
    pub phase_leak: Sourced<f64>,
    /// Adam rate of theta in stage (i): first and last iteration, geometric between.
    pub theta_rate: Sourced<[f64; 2]>,
    /// Adam rate of theta in stage (iii): first and last iteration.
    pub theta_rate_joint: Sourced<[f64; 2]>,
    /// Phases tried before stage (i), relative to the guess; the one of least loss starts.
    pub candidates: Sourced<Vec<f64>>,
    /// Share of the last change of phase that the guess expects again.
    pub velocity: Sourced<f64>,
    /// Steps of the first frame's grid search over phase.
    pub grid_steps: Sourced<u32>,
    /// Largest change of an exposure gain fitted in closed form per frame (0 = no gain).
    pub exposure_limit: Sourced<f64>,
    /// Encoded brightness falls with distance to this power (0 = appearance is carried over as is).
    pub falloff_exponent: Sourced<f64>,
    /// Light that does not depend on the incidence, as a share of that which does.
    pub indirect_share: Sourced<f64>,
    /// Frames whose mean colour the phase is measured on (0 = the colours of the last frame, as the paper has it).
    pub memory_frames: Sourced<f64>,
    /// A face in view gets more discs while each covers more pixels than this (0 = never; mesh only).
    pub pixels_per_disc: Sourced<f64>,
    /// Largest number of discs a face asks for.
    pub most_per_face: Sourced<u32>,
    /// What a disc takes over from its deformed face: `stretch` (direction and stretch) or `normal` (direction alone;
    /// mesh only).
    pub inherits: Sourced<Inherits>,
    /// Keyframes (mesh only).
    pub window: Window,
    /// Gaussians.
    pub appearance: Appearance,
    /// What is left out.
    pub visibility: Visibility,
}

impl PhaseMethod {
    /// The norm of the photometric loss.
    pub fn norm(&self) -> Norm {
        self.color_norm.as_ref().map_or(Norm::L1, |n| **n)
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

/// Keyframes against whose pictures each frame is placed, whatever the map says of its phase.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Window {
    /// How many; 0 = the map alone.
    pub keyframes: Sourced<u32>,
    /// Share of what the window knows that outlives a keyframe.
    pub memory: Sourced<f64>,
    /// Standard deviation of what the map says of the phase, as the window takes it.
    pub prior_deviation: Sourced<f64>,
}

/// What a white sheet shows of a scope.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ScopeLight {
    /// Angle from the axis at which the lamp is half as bright as on it; 0 = even.
    pub emission_half_angle_deg: Sourced<f64>,
    /// Darkening of the lens: `1 - vignette (1 - cos^4)` of the angle to the axis.
    pub vignette: Sourced<f64>,
}

/// Settings of `ours-gn`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GaussNewtonMethod {
    /// Id in tables and folders.
    pub id: String,
    /// Which program runs it.
    pub kind: String,
    /// One line for `list`.
    pub description: String,
    /// Gauss-Newton steps at a quarter, half and full resolution.
    pub steps: Sourced<[u32; 3]>,
    /// Resolutions with fewer pixels a side are left out.
    pub smallest_width: Sourced<u32>,
    /// Robust standard deviations beyond which a residual counts linearly.
    pub huber: Sourced<f64>,
    /// Edge of the blocks whose residuals err together, as a share of the image width.
    pub block_share: Sourced<f64>,
    /// Longest step of phase.
    pub longest_step: Sourced<f64>,
    /// Share of the last change of phase that is expected again.
    pub velocity: Sourced<f64>,
    /// Standard deviation of the phase around what is expected.
    pub prior_deviation: Sourced<f64>,
    /// Growth of the random walk of the answer, in standard deviations of each frame's step.
    pub drift_factor: Sourced<f64>,
    /// Share of that random walk's variance that is left after a frame.
    pub drift_memory: Sourced<f64>,
    /// A cost so many times its running mean starts a search over all phases.
    pub lost_factor: Sourced<f64>,
    /// Steps of that search, and of the first frame's.
    pub grid_steps: Sourced<u32>,
    /// Largest change of the exposure gain per channel and frame.
    pub exposure_limit: Sourced<f64>,
    /// Whether a smooth unevenness of the brightness across the image says nothing about the unknowns.
    pub uneven_light: Sourced<bool>,
    /// Brightness^(1 / 2.2) falls with distance to this power.
    pub falloff_exponent: Sourced<f64>,
    /// Light that does not depend on the incidence, as a share of that which does.
    pub indirect_share: Sourced<f64>,
    /// Sweeps over the albedo in the first frame and in the others.
    pub appearance_steps: Sourced<[u32; 2]>,
    /// Further sweeps over the colours that are shown, forgotten after the frame.
    pub touch_up_steps: Sourced<u32>,
    /// Whether the breath is expected to repeat itself once its period is known.
    pub period_prior: Sourced<bool>,
    /// Whether the given poses are rough and to be refined.
    pub unknown_pose: Sourced<bool>,
    /// Standard deviation per axis of the error of the first given pose: rad, mm.
    pub pose_deviation: Sourced<[f64; 2]>,
    /// Standard deviation per axis of the change of that error per second: rad, mm.
    pub pose_drift: Sourced<[f64; 2]>,
    /// Seconds within which that change forgets itself.
    pub pose_steady_s: Sourced<f64>,
    /// Where poses are refined, errors of what an image tells count as so many times larger than its residuals say.
    pub pose_caution: Sourced<f64>,
    /// Centres of the correction of the displacement field that each frame estimates; 0 = no correction.
    pub correction_rank: Sourced<u32>,
    /// Width of the correction around a centre (standard deviation of a bell).
    pub correction_reach_mm: Sourced<f64>,
    /// Standard deviation per axis of the error of the registration.
    pub correction_deviation_mm: Sourced<f64>,
    /// Pixels by which a disc's albedo is held at what it was: several discs share a pixel where the wall is far or
    /// grazed, and the image cannot tell them apart.
    pub hold_pixels: Sourced<f64>,
    /// How many past looks weigh against the present one.
    pub memory_frames: Sourced<f64>,
    /// Standard deviation of the answer, in those that the window claims.
    pub window_deviation_factor: Sourced<f64>,
    /// Keyframes.
    pub window: Window,
    /// The scope.
    pub scope: ScopeLight,
    /// Discs.
    pub discs: FixedDiscs,
    /// What is left out.
    pub visibility: Visibility,
}

/// Settings of `bridgesplat` and `bridgesplat-nomesh`. Weights and rates are in released units, 1 unit = 100 mm.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BridgeMethod {
    /// Id in tables and folders.
    pub id: String,
    /// Which program runs it.
    pub kind: String,
    /// One line for `list`.
    pub description: String,
    /// When it is run; `always` where nothing is said.
    #[serde(default)]
    pub listing: Listing,
    /// `full` (working rigidity and isometry; the row of the table) or `release` (what the released code computes).
    pub variant: Variant,
    /// Iterations of the first frame and of the others.
    pub iterations: Sourced<[u32; 2]>,
    /// Iteration of the first frame after which linear SH coefficients are learned.
    pub sh_from_iteration: Sourced<u32>,
    /// Millimetres per unit.
    pub unit_mm: Sourced<f64>,
    /// Weight of the masked L1.
    pub color_weight: Sourced<f64>,
    /// What a difference costs in its place; L1 as published where nothing is said.
    #[serde(default)]
    pub color_norm: Option<Sourced<Norm>>,
    /// Weight of the ARAP sum (mesh only).
    pub arap_weight: Sourced<f64>,
    /// Weight of the displacement of what is not visible.
    pub visibility_weight: Sourced<f64>,
    /// Weight of rigidity.
    pub rigid_weight: Sourced<f64>,
    /// Weight of rotation similarity (no-mesh only: the mesh variant has no rotations).
    pub rotation_weight: Sourced<f64>,
    /// Weight of isometry.
    pub isometry_weight: Sourced<f64>,
    /// One control point per so many visible vertices (mesh) or Gaussians (no mesh).
    pub control_subsample: Sourced<u32>,
    /// Control points that move a vertex.
    pub control_neighbours: Sourced<u32>,
    /// Decay of their weight per unit.
    pub control_decay: Sourced<f64>,
    /// Adam rate of control displacements (units).
    pub displacement_rate: Sourced<f64>,
    /// Gaussians.
    pub appearance: Appearance,
    /// What is left out.
    pub visibility: Visibility,
}

impl BridgeMethod {
    /// The norm of the photometric loss.
    pub fn norm(&self) -> Norm {
        self.color_norm.as_ref().map_or(Norm::L1, |n| **n)
    }
}

/// Which objective of BridgeSplat.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Variant {
    /// Working rigidity, rotation and isometry.
    Full,
    /// The effective released objective: colour, ARAP, visibility.
    Release,
}
