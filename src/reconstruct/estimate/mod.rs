//! The estimators. They do not know each other: a method combines them.

pub mod breath;
pub mod contrast_match;
pub mod gauss_newton;
pub mod navigation;
pub mod phase_fit;
pub mod pose_match;
pub mod surface_phase;
pub mod window;
