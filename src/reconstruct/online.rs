//! The protocol that all methods share: frames in order, each timed alone; every eighth one is rendered before
//! its image may be used.

use crate::base::{Image, Progress, Result};
use crate::splat::{Rasterizer, Rendered};

use super::contract::{Access, FramePrediction, NovelPrediction, Observation};
use super::stopwatch::{Spent, Stopwatch};
pub use crate::simulate::sequence::held_out;

/// The run of a method over an observation that has been checked; its clock is running.
pub struct OnlineRun {
    clock: Stopwatch,
    frames: usize,
}

impl OnlineRun {
    /// Checks `observation` against what the method asks for, and starts the clock: what follows is preparation.
    ///
    /// Errors: those of [`Observation::validate`].
    pub fn begin(access: Access, observation: &Observation) -> Result<Self> {
        observation.validate(access)?;
        Ok(OnlineRun { clock: Stopwatch::start(), frames: observation.images.len() })
    }

    /// Fits all frames in order and hands out each answer. Returns what the preparation and all `fit`s took.
    pub fn fit_in_order(
        self,
        mut fit: impl FnMut(usize) -> Result<FramePrediction> + Send,
        emit: &mut dyn FnMut(FramePrediction) -> Result<()>,
        progress: &dyn Progress,
    ) -> Result<Spent> {
        let mut spent = self.clock.spent();
        for frame in 0..self.frames {
            progress.proceed()?;
            let clock = Stopwatch::start();
            // Inside the thread pool: entering it from outside costs more than many of the parallel loops.
            let prediction = rayon::scope(|_| fit(frame))?;
            spent = spent + clock.spent();
            emit(prediction)?;
            progress.advance(frame + 1, self.frames);
        }
        Ok(spent)
    }
}

/// The answer for `frame` from the last rendering, for a method that estimates neither phase nor pose.
pub fn rendered_prediction(frame: usize, rasterizer: &Rasterizer<f32>, ahead: Option<Image<f32>>) -> FramePrediction {
    let NovelPrediction { color, depth_mm } = shown(rasterizer);
    let (phase, phase_deviation, world_from_camera) = (None, None, None);
    let (targets_mm, target_covariance_mm2, novel) = (None, None, None);
    FramePrediction {
        frame,
        color,
        depth_mm,
        phase,
        phase_deviation,
        world_from_camera,
        ahead,
        targets_mm,
        target_covariance_mm2,
        novel,
    }
}

/// Colour and depth of the last rendering.
pub fn shown(rasterizer: &Rasterizer<f32>) -> NovelPrediction {
    let color = color_image(rasterizer);
    let depth_mm = depth_image(rasterizer.rendered(), color.width, color.height);
    NovelPrediction { color, depth_mm }
}

/// The rendered colour, clamped to the range of an image.
pub fn color_image(rasterizer: &Rasterizer<f32>) -> Image<f32> {
    let rendered = rasterizer.rendered();
    let data = rendered.color.iter().map(|v| v.clamp(0.0, 1.0)).collect();
    Image { width: rendered.width, height: rendered.height, channels: 3, data }
}

/// Rendered depth where something was rendered, 0 elsewhere.
pub fn depth_image(rendered: &Rendered<f32>, width: usize, height: usize) -> Image<f32> {
    let depth = rendered.depth.iter().zip(&rendered.alpha).map(|(&d, &a)| if a > 0.5 { d } else { 0.0 });
    Image { width, height, channels: 1, data: depth.collect() }
}
