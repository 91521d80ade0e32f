//! Renders the discs of a frame under the light of the scope and the exposure of the frame.

use super::map::ActiveFrame;
use crate::base::{Image, Result};
use crate::reconstruct::fitting::scope_light::ScopeLight;
use crate::reconstruct::geometry::pyramid::PyramidLevel;
use crate::reconstruct::settings::OursGnSettings;
use crate::splat::{DepthOutput, Rasterizer, Rendered, Settings, View};

/// The rasteriser, and the state that all discs of a frame share.
pub struct DiscRenderer<'a> {
    /// The method's numbers.
    pub settings: &'a OursGnSettings,
    /// The profile's factor on the number of albedo sweeps.
    pub iteration_scale: f64,
    /// Holds the last rendering.
    pub rasterizer: Rasterizer<f32>,
    /// Exposure per channel.
    pub gain: [f64; 3],
    /// Mean albedo of the discs last in view.
    pub mean_color: [f32; 3],
    /// Values from which on the pixels of a frame are clipped, at each resolution.
    pub clipped_from: Vec<Image<f32>>,
}

impl<'a> DiscRenderer<'a> {
    /// With an exposure of 1.
    pub fn new(settings: &'a OursGnSettings, iteration_scale: f64, clipped_from: Vec<Image<f32>>) -> Self {
        let (rasterizer, gain, mean_color) = (Rasterizer::new(), [1.0; 3], [0.5; 3]);
        DiscRenderer { settings, iteration_scale, rasterizer, gain, mean_color, clipped_from }
    }

    /// The light of the scope at `view`.
    pub fn light(&self, view: &View) -> ScopeLight {
        ScopeLight::new(view, *self.settings.falloff_exponent, *self.settings.indirect_share)
    }

    /// Renders the discs as placed.
    pub fn draw(&mut self, active: &ActiveFrame, view: &View) -> Result<&Rendered<f32>> {
        let settings = Settings { gain: self.gain, depth: DepthOutput::Skip, ..Settings::default() };
        self.rasterizer.render(active.gaussians(), view, &settings, None)
    }
}

/// Of the images in `sizes`, the values of the one of `level`'s size; none if no frame has it.
pub fn of_size<'s>(sizes: &'s [Image<f32>], level: &PyramidLevel) -> &'s [f32] {
    let same_size = |image: &&Image<f32>| image.data.len() == level.image.data.len();
    sizes.iter().find(same_size).map_or(&[], |image| &image.data)
}
