//! The phases of a window of keyframes, by direct alignment of their images through the moving mesh. No map is
//! involved, so nothing that was painted in the wrong place can pull a phase along. Windowed photometric bundle
//! adjustment (Engel, Koltun and Cremers, "Direct sparse odometry", 2018) in which poses and shapes are given,
//! and one phase per frame is all that is unknown.
//!
//! A map alone drifts. If the assumed wall is too wide, its image grows too slowly while the scope advances. A
//! phase that makes the wall even wider compensates, so the phase error grows by a factor of e each time the scope
//! advances by its distance from the wall. Two frames from different places reveal the error by parallax. A pixel
//! of frame `k` at phase `a_k` shows the point `X_k(a_k) = o + t r`, with barycentric coordinates `b(a_k)` on its
//! face. In frame `n` that point is at `X_n = sum b_i v_i(a_n)`. The derivatives of its pixel there by `a_k` and
//! by `a_n` differ ([`pair`]), so both phases can be estimated.
//!
//! - Images are compared by local contrast ([`contrast_image`](crate::reconstruct::fitting::contrast::contrast_image)), which large-scale changes of light do not affect.
//! - Each frame is placed against all keyframes. A frame that shows enough new wall becomes a keyframe; the oldest
//!   keyframe leaves and its information is marginalised ([`bounded`]). With each new keyframe a share of the
//!   information is forgotten, since systematic errors (glare, light inside the wall) do not average out.
//! - Near walls make the valley of the misfit only .01 of a phase wide. Before the first step, the phases around
//!   the expected one are therefore searched for the best agreement with the last keyframe. If that phase is not
//!   the expected one, the solver starts from both, and the misfit over all keyframes decides, since very near
//!   walls can mislead a single keyframe.
//! - Optionally, a correction of the displacement field ([`correction`]) absorbs what parallax says about the wall
//!   beyond any phase. Its coefficients are unknowns of the window and stay when a keyframe leaves.
//! - Optionally, one correction of the poses and its change per second are estimated for the whole window under a
//!   [`drift`] model. (Six unknowns per frame diverge: along a tube, advancing and breathing are indistinguishable.)
//! - Phases stay within 0..1 in every step: if images push one against an end of the breath, the poses must be wrong.
//!
//! Left out: levels of resolution.

pub mod bounded;
pub mod correction;
pub mod drift;
mod keyframe_window;
pub mod pair;
#[cfg(test)]
mod tests;
mod unknowns;

pub use keyframe_window::{KeyframeWindow, PhaseMeasurement, WindowOptions};
