//! The paper's online loop, shared by every method that has one breathing phase per frame: per frame (i) theta alone,
//! (ii) appearance alone, (iii) both, under `w_c [(1 - w_s) L1 + w_s (1 - SSIM)] + w_t (alpha_t - alpha_{t-1})^2`
//! (Eq. 3 and 4). What carries the Gaussians (a mesh, or nothing) is behind [`BreathingGaussians`].
//!
//! Where the paper does not say how, and every row needs something: Gaussians that no frame has shown get the colours of the
//! present one, also before stage (i) (`colored_before_phase`), and stage (i) hands on the phase of its least loss.
//!
//! Our additions where the paper is silent, each with its number in the TOML:
//!
//! - the initial guess of a frame's phase continues part of the last change;
//! - a few candidates around the guess are rendered before stage (i);
//! - after stage (i) the frame may be placed among keyframes, since a phase measured on the map alone drifts;
//! - an exposure gain per channel and frame is fitted in closed form;
//! - brightness is carried from frame to frame by the fall-off law of the scope's light.

mod fitter;
mod online_loop;
mod patch;
mod stages;

pub use fitter::Fitter;
pub use online_loop::{PhaseSource, REACH};
pub use patch::{BreathingGaussians, VisiblePatch};
