//! One frame of `ours-gn` against its image: robust Gauss-Newton on the phase, coarse to fine, on the forward-mode
//! derivative of the image.

use super::map::{ActiveFrame, MapVelocity};
use super::renderer::{DiscRenderer, of_size};
use crate::base::Result;
use crate::reconstruct::estimate::gauss_newton::{self, Evidence, ImageComparison, Prior, Robust};
use crate::reconstruct::fitting::grid_search::grid_search;
use crate::reconstruct::geometry::pyramid::PyramidLevel;
use crate::reconstruct::geometry::rigid::{POSE, moved};
use crate::splat::{DepthOutput, Direction, Motion, Settings};

/// A frame's phase, and the evidence of the last step.
pub struct Tracked {
    /// Breathing phase.
    pub phase: f64,
    /// Evidence at the last step.
    pub evidence: Evidence,
}

impl DiscRenderer<'_> {
    /// Gauss-Newton from `start`, coarse to fine, under the prior that the phase is near `expected`; `pose`
    /// corrects the given one. `None` if the image says nothing about the phase.
    pub fn track(
        &mut self,
        active: &mut ActiveFrame,
        levels: &[PyramidLevel],
        pose: [f64; POSE],
        start: f64,
        expected: f64,
    ) -> Result<Option<Tracked>> {
        let (mut phase, mut tracked) = (start, None);
        let (longest, deviation) = (*self.settings.longest_step, *self.settings.prior_deviation);
        // Levels that would be too small are left out.
        let left_out = self.settings.steps.len() - levels.len();
        for (k, level) in levels.iter().enumerate() {
            for _ in 0..self.settings.steps[left_out + k] {
                let Some(evidence) = self.evidence(active, level, pose, phase)? else { return Ok(tracked) };
                let prior = Prior { step: expected - phase, precision: 1.0 / (deviation * deviation) };
                let step = gauss_newton::posterior_step(&evidence, prior);
                phase = (phase + step.clamp(-longest, longest)).clamp(0.0, 1.0);
                tracked = Some(Tracked { phase, evidence });
            }
        }
        Ok(tracked)
    }

    /// The phase at which the image fits best, ignoring the prediction.
    pub fn search_by_image(
        &mut self,
        active: &mut ActiveFrame,
        level: &PyramidLevel,
        pose: [f64; POSE],
    ) -> Result<f64> {
        grid_search(*self.settings.grid_steps, |phase| {
            let found = self.evidence(active, level, pose, phase)?;
            Ok(found.map_or(f64::INFINITY, |found| found.cost))
        })
    }

    /// The evidence of `level` about the phase, linearised at `phase`.
    fn evidence(
        &mut self,
        active: &mut ActiveFrame,
        level: &PyramidLevel,
        pose: [f64; POSE],
        phase: f64,
    ) -> Result<Option<Evidence>> {
        // The discs at the phase, and the derivatives of discs and colours by it.
        let view = moved(&level.view, pose);
        let light = self.light(&view);
        active.place(phase, &light)?;
        let MapVelocity { positions, axes, colors } = &active.velocity(&light)?;
        let direction = Direction::Motion(Motion { positions, axes, colors, ..Motion::default() });

        // The image and its derivative by the phase.
        let settings = Settings { depth: DepthOutput::Skip, ..Settings::default() };
        let tangents = self.rasterizer.render_tangent(active.gaussians(), &view, &settings, None, &[direction])?;
        let tangent = tangents[0].clone();
        let comparison = ImageComparison {
            width: level.image.width,
            image: &level.image.data,
            rendered: &self.rasterizer.rendered().color,
            weights: &level.weights,
            clipped_from: of_size(&self.clipped_from, level),
            tangent: &tangent,
        };
        let block_px = (level.image.width as f64 * *self.settings.block_share).round() as usize;
        let robust = Robust {
            huber: *self.settings.huber,
            block_px: block_px.max(2),
            gain_limit: *self.settings.exposure_limit,
            last_gain: self.gain,
        };
        Ok(gauss_newton::evidence(&comparison, robust))
    }
}
