//! Directions along which an image is differentiated.

use crate::base::{Error, Result};
use crate::splat::number::Real;

use super::scene::{GaussianSlices, ShapeSlices};

/// How every Gaussian moves per unit of the unknown. One entry per Gaussian (not per active one); an empty slice is
/// "not at all".
#[derive(Clone, Copy, Debug, Default)]
pub struct Motion<'a, T> {
    /// Velocity of the centres (mm).
    pub positions: &'a [[T; 3]],
    /// Velocity of the two axes of each disc (mm); discs only.
    pub axes: &'a [[[T; 3]; 2]],
    /// Velocity of the three columns `R_k s_k` of the square root of the covariance (mm); ellipsoids only. An affine
    /// motion with velocity gradient `F` has `F R_k s_k`.
    pub columns: &'a [[[T; 3]; 3]],
    /// Change of the colour beyond what the view direction does to it (before the clamp at 0).
    pub colors: &'a [[T; 3]],
}

/// A direction along which the image is differentiated.
#[derive(Clone, Copy, Debug)]
pub enum Direction<'a, T> {
    /// All Gaussians move.
    Motion(Motion<'a, T>),
    /// The camera moves, `camera_from_world <- exp(h xi) camera_from_world`, `xi` as in
    /// [`crate::splat::Gradients::pose`].
    Pose([f64; 6]),
    /// The gain changes, per channel.
    Gain([f64; 3]),
}

impl<T> Motion<'_, T> {
    /// Errors when its arrays do not fit `n` Gaussians, discs or ellipsoids.
    fn check(&self, n: usize, discs: bool) -> Result<()> {
        let lengths = [self.positions.len(), self.axes.len(), self.columns.len(), self.colors.len()];
        if lengths.iter().any(|&length| length != 0 && length != n) {
            return Err(Error::input(format!("a motion needs one entry for each of the {n} Gaussians, or none")));
        }
        if (discs && !self.columns.is_empty()) || (!discs && !self.axes.is_empty()) {
            return Err(Error::input("a motion has axes for discs and columns for ellipsoids"));
        }
        Ok(())
    }
}

impl<T: Real> Direction<'_, T> {
    /// Errors when it does not fit the Gaussians or is not finite.
    pub(in crate::splat) fn check(&self, gaussians: &GaussianSlices<'_, T>) -> Result<()> {
        match self {
            Direction::Motion(motion) => {
                motion.check(gaussians.len(), matches!(gaussians.shape, ShapeSlices::Discs { .. }))
            }
            Direction::Pose(xi) if xi.iter().any(|v| !v.is_finite()) => {
                Err(Error::input("a motion of the camera is not finite"))
            }
            Direction::Gain(gain) if gain.iter().any(|v| !v.is_finite()) => {
                Err(Error::input("a change of the gain is not finite"))
            }
            _ => Ok(()),
        }
    }
}
