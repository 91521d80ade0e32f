//! `ours-gn`: the geometry of `ours` (discs on the CT mesh, one phase per frame), tracked by Gauss-Newton instead of
//! Adam. Beyond the paper.
//!
//! Appearance. Images are flat-fielded and kept in a power law ([`light::Scope`]). The light sits at the tip of
//! the scope, so a disc at distance `d` seen under the cosine `c` shows
//! `albedo * (d0 / d)^p * ((c + k) / (1 + k))^(p / 2)`, `k` the share of light that comes from all sides.
//! Approaching the wall is thus no change of appearance, and the albedo needs no chasing ([`albedo`]). The
//! discs must be small against the vessels: a map that cannot show them lets them pull the phase along.
//!
//! Phase. At a quarter, half and full resolution: render with the derivative of the image by the phase, one
//! robust Gauss-Newton step ([`track`]), together with what is expected of the breath. A frame whose cost jumps
//! is searched over all phases again. From there the window of keyframes goes on, where there is one. The
//! standard deviation that comes with the answer is the window's; without a window there is none.
//!
//! Options, both unknowns of the window, and errors without one: poses that are only roughly known, of which
//! the first is registered to the mesh by depth ([`registration`]), and a correction of the registration of the
//! two CTs. Depth, and what is hidden, are those of the mesh.
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
