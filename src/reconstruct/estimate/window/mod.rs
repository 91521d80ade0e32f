//! The phases of a window of keyframes, by direct alignment of their images through the moving mesh. No map is
//! involved, so nothing that was painted in the wrong place can pull a phase along. Windowed photometric bundle
//! adjustment (Engel, Koltun and Cremers, "Direct sparse odometry", 2018) in which poses and shapes are given,
//! and one phase per frame is all that is unknown.
//!
//! A map alone drifts. Where the assumed wall is too wide its image grows too slowly while the scope advances,
//! and a phase that makes it wider still mends that: an error of the phase grows by a factor of e on a way as
//! long as the wall is distant. Two frames from different places see that the wall is elsewhere (parallax).
//! With the point that a pixel of frame `k` shows at `X_k(a_k) = o + t r`, in barycentric coordinates `b(a_k)`
//! of its face, frame `n` sees it at `X_n = sum b_i v_i(a_n)`; the derivatives of its place in that image by
//! `a_k` and by `a_n` differ ([`pair`]).
//!
//! Images are compared by their local contrast ([`contrast`]): what the light does to large areas says nothing.
//! Each frame is placed against all keyframes of the window; a frame that shows enough new wall becomes one,
//! and the oldest leaves, its knowledge marginalised ([`bounded`]). Of what is known a share is forgotten with
//! each keyframe, since systematic errors (glare, light inside the wall) do not average out. What two frames
//! from different places say about where the wall is, beyond any phase, may go into a correction of the
//! displacement field ([`correction`]): its coefficients are unknowns of the window, too, which no keyframe
//! takes along when it leaves. Where walls are near, the valley of the misfit is .01 of a phase wide: before
//! the first step the phases around the expected one are searched for the one at which the frame agrees best
//! with the last keyframe. Where that is elsewhere, steps are taken from both, and all keyframes choose: walls
//! that are very near can mislead one of them. Poses that are off may be unknowns, too: one correction and its
//! change per second for the whole window, under a [`drift`]. (Six unknowns per frame run away: along a tube,
//! way and phase are one.) Phases stay within 0..1 in every step: where images push one against an end of the
//! breath, it is the poses that must be wrong. Left out: levels of resolution.

pub mod bounded;
pub mod contrast;
pub mod correction;
pub mod drift;
mod keyframe_window;
pub mod pair;
#[cfg(test)]
mod tests;
mod unknowns;

pub use keyframe_window::{KeyframeWindow, WindowOptions};
