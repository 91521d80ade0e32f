//! `ours-gn`: the geometry of `ours` (discs on the CT mesh, one phase per frame), tracked by Gauss-Newton instead of
//! Adam. Beyond the paper.
//!
//! Appearance. Images are flat-fielded and kept in a power law ([`light::Scope`]). The light sits at the tip of
//! the scope, so a disc at distance `d` seen under the cosine `c` shows
//! `albedo * (d0 / d)^p * ((c + k) / (1 + k))^(p / 2)`, `k` the share of light that comes from all sides.
//! Approaching the wall is thus no change of appearance, and the albedo need not follow it ([`albedo`]). The
//! discs must be small compared with the vessels: vessels that the map cannot resolve bias the phase.
//!
//! Phase. At a quarter, half and full resolution: render with the derivative of the image by the phase and take
//! one robust Gauss-Newton step ([`track`]) under the prior of the predicted breath. If the cost jumps, all phases
//! are searched again. The keyframe window, if there is one, continues from there and provides the standard
//! deviation of the phase.
//!
//! Options, both unknowns of the window and errors without one: roughly known poses, the first of which is
//! registered to the mesh by depth ([`registration`]), and a correction of the registration of the two CTs. Depth
//! and occlusion are those of the mesh.
//!
//! Left out: learning of disc centres and sizes.

mod albedo;
mod light;
mod map;
mod method;
mod registration;
mod renderer;
mod track;

pub use method::OursGn;
