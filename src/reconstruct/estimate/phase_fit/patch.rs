//! What a method with one phase per frame must provide: Gaussians that the phase moves.

use crate::base::{Image, Result};
use crate::reconstruct::fitting::memory::Memory;
use crate::reconstruct::geometry::pyramid::PyramidLevel;
use crate::splat::{Gaussians, Gradients, View, Wanted};

/// Gaussians that a phase moves.
pub trait BreathingGaussians: Send {
    /// Starts a frame: makes the compact copy of what is visible from `view` while the phase stays within `phases`.
    fn enter<'a>(&'a mut self, view: &View, phases: [f64; 2]) -> Result<Box<dyn VisiblePatch + 'a>>;
    /// The same for a view that is only rendered: nothing is refined, and nothing must be written back.
    fn look<'a>(&'a mut self, view: &View, phase: f64) -> Result<Box<dyn VisiblePatch + 'a>>;
    /// Depth of the surface itself from `view` at `phase`: z-depth in mm, 0 where there is none. `None` if the rendered
    /// depth of the Gaussians is the method's.
    fn surface_depth_mm(&self, _view: &View, _phase: f64) -> Option<Image<f32>> {
        None
    }
}

/// The compact copy of the Gaussians visible in one frame, on which all work of the frame is done.
pub trait VisiblePatch {
    /// Moves the Gaussians to `phase` (Eq. 2).
    fn place(&mut self, phase: f64) -> Result<()>;
    /// The Gaussians, as placed.
    fn gaussians(&self) -> &Gaussians<f32>;
    /// Their spherical harmonics, and the memory of their colours.
    fn colors(&mut self) -> (&mut [f32], &mut Memory);
    /// Velocity of each centre, mm per unit of phase.
    fn velocities(&self, out: &mut Vec<[f32; 3]>) -> Result<()>;
    /// dL/dphase from the gradients of centres and spread.
    fn phase_derivative(&self, gradients: &Gradients<f32>) -> Result<f64>;
    /// Zeroes the optimiser's moments.
    fn begin_appearance(&mut self);
    /// Groups of gradients that [`VisiblePatch::step_appearance`] needs.
    fn appearance_groups(&self) -> Wanted;
    /// One optimiser step on the appearance of the Gaussians that have had a gradient in the frame.
    fn step_appearance(&mut self, gradients: &Gradients<f32>) -> Result<()>;
    /// The phase near `expected` by alignment with past frames; `expected` itself if there is no surface to align on.
    fn place_among_keyframes(&mut self, _frame: PyramidLevel, expected: f64) -> f64 {
        expected
    }
    /// Ends the frame: writes back what was learned.
    fn leave(self: Box<Self>);
}
