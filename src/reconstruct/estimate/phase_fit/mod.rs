//! The paper's online loop, shared by every method that has one breathing phase per frame: per frame (i) theta alone,
//! (ii) appearance alone, (iii) both, under `w_c [(1 - w_s) L1 + w_s (1 - SSIM)] + w_t (alpha_t - alpha_{t-1})^2`
//! (Eq. 3 and 4). What carries the Gaussians (a mesh, or nothing) is behind [`BreathingGaussians`].
//!
//! Ours where the paper is silent, each with its number in the TOML: the guess of a frame's phase continues
//! part of the last change; a few candidates around it are rendered before stage (i); after it the frame may be
//! placed among keyframes, since what is painted alone lets the phase drift; an exposure gain per channel and
//! frame in closed form; brightness carried from frame to frame by the law of the light at the scope.

mod fitter;
mod online_loop;
mod patch;
mod stages;

pub use online_loop::{PhaseSource, REACH, run};
pub use patch::{BreathingGaussians, VisiblePatch};
