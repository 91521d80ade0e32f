//! The running estimate, and the steps that all stages of a frame share: place, render, evaluate, differentiate.

use super::patch::VisiblePatch;
use crate::base::{Image, Result};
use crate::reconstruct::activation::PhaseActivation;
use crate::reconstruct::contract::Observation;
use crate::reconstruct::fitting::anchored::{SH_C0, SH_VALUES};
use crate::reconstruct::fitting::loss::photometric::Photometric;
use crate::reconstruct::fitting::memory::{ShownColors, shift};
use crate::reconstruct::fitting::schedule::scaled_iterations;
use crate::reconstruct::fitting::scope_light::{CLIPPED, ScopeLight, Shade};
use crate::reconstruct::fitting::unseen::{Shown, lent_colors};
use crate::reconstruct::geometry::targets::CarriedTargets;
use crate::reconstruct::geometry::visible::{depths_mm, pixels};
use crate::reconstruct::settings::{FrameFitSettings, PhaseEstimation};
use crate::splat::{DepthOutput, ImageGradient, Rasterizer, Rendered, Settings, View, Wanted};

/// Darkest colour (encoded, 0..1) that a Gaussian keeps after a frame: a colour below zero is rendered as zero, has no
/// gradient, and would stay black.
const DARKEST: f32 = 0.01;
/// Largest change of colour with direction that a Gaussian keeps, as a share of its colour, per axis. Linear terms
/// learned at grazing incidence have little effect there and a wild one from other directions.
const LARGEST_CHANGE: f32 = 0.3;
/// Mean product of the values of picture and rendering up to which one of them is black and says nothing of it either.
const DARK: f64 = 1e-4;
/// Largest factor of encoded values between the exposures of a film. An automatic one stays within 8 of linear ones.
const WIDEST_EXPOSURE: f64 = 16.0;
/// Factor of the linear spherical harmonics of a unit direction.
const SH_C1: f32 = 0.488_602_5;

/// The running estimate.
pub struct Fitter<'a> {
    /// The method's numbers.
    pub settings: &'a FrameFitSettings,
    /// How the phase is estimated; `None` if it is given.
    pub estimation: Option<&'a PhaseEstimation>,
    /// What the method may see.
    pub observation: &'a Observation,
    /// The planned targets, tied to the wall.
    pub targets: CarriedTargets,
    scale: f64,
    /// Holds the last rendering.
    pub rasterizer: Rasterizer<f32>,
    gradient: Vec<f32>,
    gain: [f64; 3],
    exposure: f64,
    /// Phases of the frames so far.
    pub phases: Vec<f64>,
    mean_color: [f32; 3],
    velocities: Vec<[f32; 3]>,
    shades: Vec<Shade>,
}

/// The frame being fitted, once its image may be used.
pub struct FrameTarget {
    /// Its number.
    pub frame: usize,
    /// Its pose and camera.
    pub view: View,
    /// Its image, encoded, 0..1.
    pub image: Image<f32>,
    /// The photometric part of Eq. 4.
    pub loss: Photometric<f32>,
}

impl FrameTarget {
    /// Frame number `frame`, with SSIM prepared if `largest_ssim_weight` is not 0.
    pub fn new(frame: usize, view: View, observation: &Observation, largest_ssim_weight: f64) -> Self {
        let image = observation.images[frame].to_unit();
        let weights = observation.pixel_weights();
        let loss = Photometric::new(&image.data, image.width, image.height, largest_ssim_weight, weights.as_deref());
        FrameTarget { frame, view, image, loss }
    }
}

impl<'a> Fitter<'a> {
    /// Before the first frame.
    pub fn new(
        settings: &'a FrameFitSettings,
        estimation: Option<&'a PhaseEstimation>,
        iteration_scale: f64,
        observation: &'a Observation,
    ) -> Self {
        Fitter {
            settings,
            estimation,
            observation,
            targets: CarriedTargets::new(&observation.targets_mm, &observation.inspiration),
            scale: iteration_scale,
            rasterizer: Rasterizer::new(),
            gradient: Vec::new(),
            gain: [1.0; 3],
            exposure: 1.0,
            phases: Vec::new(),
            mean_color: [0.0; 3],
            velocities: Vec::new(),
            shades: Vec::new(),
        }
    }

    /// How the phase is estimated. Panics if the phase is given.
    pub fn estimation(&self) -> &'a PhaseEstimation {
        self.estimation.expect("the phase is estimated, not given")
    }

    /// From theta to the phase (Eq. 3).
    pub fn activation(&self) -> PhaseActivation {
        let estimation = self.estimation();
        PhaseActivation { kind: *estimation.activation, leak: *estimation.phase_leak }
    }

    /// The larger of the SSIM weights in the stages of a frame.
    pub fn largest_ssim_weight(&self) -> f64 {
        self.estimation.map_or(0.0, |estimation| *estimation.phase_ssim_weight).max(*self.settings.ssim_weight)
    }

    /// Iterations of a stage (0 to 2) in `frame`.
    pub fn iterations(&self, stage: usize, frame: usize) -> usize {
        let factor = if frame == 0 && stage > 0 { *self.settings.first_frame_factor } else { 1.0 };
        scaled_iterations(self.settings.iterations[stage] as f64 * factor, self.scale)
    }

    /// Renders the Gaussians as placed, with the gain of the frame.
    pub fn render(&mut self, view: &View, patch: &dyn VisiblePatch, depth: DepthOutput) -> Result<&Rendered<f32>> {
        let settings = Settings { gain: self.gain, depth, ..Settings::default() };
        self.rasterizer.render(patch.gaussians(), view, &settings, None)
    }

    fn light(&self, view: &View) -> ScopeLight {
        ScopeLight::new(view, *self.settings.falloff_exponent, *self.settings.indirect_share).exposed(self.exposure)
    }

    /// Moves the Gaussians to `phase` and relights those that an earlier frame has shown for the scope's position.
    pub fn place(&mut self, view: &View, patch: &mut dyn VisiblePatch, phase: f64) -> Result<()> {
        patch.place(phase)?;
        if self.models_light() {
            self.relight(view, patch);
        }
        Ok(())
    }

    fn models_light(&self) -> bool {
        *self.settings.falloff_exponent != 0.0
    }

    /// Gives Gaussians that an earlier frame has shown the light of the scope at `view`, at the present exposure.
    fn relight(&mut self, view: &View, patch: &mut dyn VisiblePatch) {
        self.light(view).shades(patch.gaussians(), &[], &mut self.shades);
        let (sh, memory) = patch.colors();
        for ((sh, at), shade) in sh.chunks_exact_mut(SH_VALUES).zip(&mut memory.contained_shade).zip(&self.shades) {
            if *at > 0.0 {
                let ratio = shade.value / *at;
                for (i, value) in sh.iter_mut().enumerate() {
                    *value = (*value + shift(i)) * ratio - shift(i);
                }
                *at = shade.value;
            }
        }
    }

    /// dL/dphase of the photometric loss. Gaussians move, and the light on them changes:
    /// `dL/dalpha = sum_k (dL/dmu_k . D_k + dL/dspread_k . dspread_k/dalpha + dL/dc_k . c_k dln(shade_k)/dalpha)`,
    /// with `mu` the centres, `D` their displacements, `c` the colours.
    pub fn phase_derivative(&mut self, view: &View, patch: &mut dyn VisiblePatch) -> Result<f64> {
        // Centres and spread.
        let mut sum = patch.phase_derivative(self.rasterizer.gradients())?;
        if self.models_light() {
            // Colours: shade changes as the centres move.
            patch.velocities(&mut self.velocities)?;
            self.light(view).shades(patch.gaussians(), &self.velocities, &mut self.shades);
            let by_sh = &self.rasterizer.gradients().sh;
            let (sh, memory) = patch.colors();
            let discs = sh.chunks_exact(SH_VALUES).zip(by_sh.chunks_exact(SH_VALUES));
            for (((sh, by_sh), at), shade) in discs.zip(&memory.contained_shade).zip(&self.shades) {
                if *at > 0.0 {
                    let along: f32 = sh.iter().zip(by_sh).enumerate().map(|(i, (v, g))| (v + shift(i)) * g).sum();
                    sum += (along * shade.relative_slope) as f64;
                }
            }
        }
        Ok(sum)
    }

    /// The change of exposure since the frame before, in closed form and within the limit: the factor that brings the
    /// rendering `R` nearest to the image `I` in the least-squares sense, `g = sum R I / sum R^2`. With a model of the
    /// light it is part of that, so that what an earlier frame has shown keeps in step with what the scope sees now;
    /// without one it is a gain of this frame, per channel.
    pub fn fit_exposure(&mut self, view: &View, patch: &mut dyn VisiblePatch, image: &Image<f32>) -> Result<()> {
        let limit = *self.settings.exposure_limit;
        if limit <= 0.0 {
            return Ok(());
        }
        self.gain = [1.0; 3];
        let models_light = self.models_light();
        let settings = Settings { depth: DepthOutput::Skip, ..Settings::default() };
        let rendered = self.rasterizer.render(patch.gaussians(), view, &settings, None)?;
        let (mut cross, mut square) = ([0.0f64; 3], [1e-9f64; 3]);
        for (i, (&r, &v)) in rendered.color.iter().zip(&image.data).enumerate() {
            if self.observation.shows(i / 3) && !(models_light && v > CLIPPED) {
                cross[i % 3] += (r * v) as f64;
                square[i % 3] += (r * r) as f64;
            }
        }
        let within = |gain: f64| gain.clamp(1.0 - limit, 1.0 / (1.0 - limit));
        if !models_light {
            self.gain = [0, 1, 2].map(|c| within(cross[c] / square[c]));
        } else if cross.iter().sum::<f64>() > DARK * image.data.len() as f64 {
            let change = within(cross.iter().sum::<f64>() / square.iter().sum::<f64>());
            self.exposure = (self.exposure * change).clamp(1.0 / WIDEST_EXPOSURE, WIDEST_EXPOSURE);
            self.relight(view, patch);
        }
        Ok(())
    }

    /// Discs that no frame has shown yet start with the colour of the pixel they fall on, or the mean colour.
    pub fn color_the_unseen(&mut self, view: &View, patch: &mut dyn VisiblePatch, image: &Image<f32>) {
        let gain = self.gain;
        let pixels = self.pixels(view, patch);
        let mean = self.mean_color;
        let (sh, memory) = patch.colors();
        for ((sh, at), pixel) in sh.chunks_exact_mut(SH_VALUES).zip(&memory.contained_shade).zip(pixels) {
            if *at == 0.0 {
                for c in 0..3 {
                    let value = pixel.map_or(mean[c], |[x, y]| image.pixel(x, y)[c] / gain[c] as f32);
                    sh[c] = (value - 0.5) / SH_C0;
                }
            }
        }
    }

    /// Where there is no image to take a colour from, Gaussians that no frame has shown get the colour of the wall beside
    /// them, under the light at their own place.
    pub fn color_the_unseen_as_beside(&mut self, view: &View, patch: &mut dyn VisiblePatch) {
        self.light(view).shades(patch.gaussians(), &[], &mut self.shades);
        let positions = patch.gaussians().positions.clone();
        let (sh, memory) = patch.colors();
        let shown = |k: usize| {
            let shade = memory.contained_shade[k];
            (shade > 0.0).then(|| Shown { color: [0, 1, 2].map(|c| sh[k * SH_VALUES + c] * SH_C0 + 0.5), shade })
        };
        for (k, color) in lent_colors(&positions, shown) {
            (0..3).for_each(|c| sh[k * SH_VALUES + c] = (color[c] * self.shades[k].value - 0.5) / SH_C0);
        }
        if self.models_light() {
            sh.chunks_exact_mut(SH_VALUES).for_each(clip);
        }
    }

    /// Records the shade contained in the colour of each visible disc (one not behind the rendered surface). The
    /// others get back their colours of `before`: what the image shows of them through the wall is too little to learn
    /// from, and enough to diverge on.
    pub fn mark_fitted(&mut self, patch: &mut dyn VisiblePatch, target: &FrameTarget, before: &ShownColors) {
        let FrameTarget { view, image, .. } = target;
        let pixels = self.pixels(view, patch);
        self.light(view).shades(patch.gaussians(), &[], &mut self.shades);
        let depths = depths_mm(view, &patch.gaussians().positions);
        let rendered = self.rasterizer.rendered();
        let width = rendered.width;
        let (sh, memory) = patch.colors();
        let guarded = *self.settings.guarded_colors;
        if guarded {
            sh.chunks_exact_mut(SH_VALUES).for_each(bound);
        }
        let frames = self.estimation.map_or(0.0, |estimation| *estimation.memory_frames as f32);
        for (k, ((pixel, shade), depth)) in pixels.into_iter().zip(&self.shades).zip(depths).enumerate() {
            if let Some([x, y]) = pixel
                && depth < 1.1 * rendered.depth[y * width + x] + 1.0
            {
                memory.contained_shade[k] = shade.value;
                if frames > 0.0 {
                    memory.add(k, &sh[k * SH_VALUES..][..SH_VALUES], frames);
                }
            } else if guarded {
                memory.put_back(k, &mut sh[k * SH_VALUES..][..SH_VALUES], before);
            }
        }
        let shown: Vec<usize> = (0..image.width * image.height).filter(|&i| self.observation.shows(i)).collect();
        for c in 0..3 {
            let sum: f64 = shown.iter().map(|i| image.data[3 * i + c] as f64).sum();
            self.mean_color[c] = (sum / shown.len() as f64 / self.gain[c]) as f32;
        }
    }

    /// The pixel onto which each centre projects, if it is inside the image mask.
    fn pixels(&self, view: &View, patch: &dyn VisiblePatch) -> Vec<Option<[usize; 2]>> {
        let width = view.camera.width as usize;
        let shown = |pixel: &[usize; 2]| self.observation.shows(pixel[1] * width + pixel[0]);
        pixels(view, &patch.gaussians().positions).into_iter().map(|pixel| pixel.filter(shown)).collect()
    }

    /// Photometric loss and its image gradient at the current placement.
    pub fn evaluate(&mut self, patch: &dyn VisiblePatch, target: &mut FrameTarget) -> Result<f64> {
        self.render(&target.view, patch, DepthOutput::Skip)?;
        let color = &self.rasterizer.rendered().color;
        self.gradient.resize(color.len(), 0.0);
        Ok(target.loss.evaluate(color, &mut self.gradient))
    }

    pub fn backward(&mut self, patch: &dyn VisiblePatch, wanted: Wanted) -> Result<()> {
        let image = ImageGradient { color: &self.gradient, ..ImageGradient::default() };
        self.rasterizer.backward(patch.gaussians(), &image, wanted).map(|_| ())
    }

    /// Groups that [`Fitter::phase_derivative`] needs.
    pub fn phase_groups(&self) -> Wanted {
        let carried = Wanted::POSITIONS | Wanted::SHAPES;
        if self.models_light() { carried | Wanted::SH } else { carried }
    }
}

/// Limits the colours of one Gaussian to what a wall can show.
fn bound(sh: &mut [f32]) {
    let (constant, linear) = sh.split_at_mut(3);
    for (c, value) in constant.iter_mut().enumerate() {
        *value = value.max((DARKEST - 0.5) / SH_C0);
        let most = LARGEST_CHANGE * (*value * SH_C0 + 0.5) / SH_C1;
        linear.iter_mut().skip(c).step_by(3).for_each(|v| *v = v.clamp(-most, most));
    }
}

/// Clips the colour of one Gaussian at white, as a sensor does: what the second camera has right before it may be many
/// times too bright by the law of the light, and would shine through the rim of its disc.
fn clip(sh: &mut [f32]) {
    let (constant, linear) = sh.split_at_mut(3);
    for (c, value) in constant.iter_mut().enumerate() {
        let color = *value * SH_C0 + 0.5;
        if color > 1.0 {
            *value = 0.5 / SH_C0;
            linear.iter_mut().skip(c).step_by(3).for_each(|v| *v /= color);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_brighter_than_white_is_white() {
        let mut sh = vec![0.2f32; SH_VALUES];
        sh[1] = (4.0 - 0.5) / SH_C0;
        clip(&mut sh);
        let colors = [0, 1, 2].map(|c| sh[c] * SH_C0 + 0.5);
        assert!((colors[1] - 1.0).abs() < 1e-6 && colors[0] == colors[2] && colors[0] < 0.6, "{colors:?}");
        assert_eq!([sh[3], sh[4], sh[5]], [0.2, 0.05, 0.2]);
    }

    #[test]
    fn a_colour_changes_with_the_direction_by_a_share_of_itself() {
        let mut sh = vec![0.0f32; SH_VALUES];
        sh[..3].copy_from_slice(&[(0.4 - 0.5) / SH_C0, (-0.2 - 0.5) / SH_C0, (0.8 - 0.5) / SH_C0]);
        sh[3..].copy_from_slice(&[5.0, 5.0, 0.1, -5.0, -5.0, -0.1, 0.01, 0.001, 0.0]);
        bound(&mut sh);
        let colors = [0, 1, 2].map(|c| sh[c] * SH_C0 + 0.5);
        for (color, expected) in colors.into_iter().zip([0.4, DARKEST, 0.8]) {
            assert!((color - expected).abs() < 1e-6, "{colors:?}");
        }
        for (i, value) in sh[3..].iter().enumerate() {
            assert!((value * SH_C1).abs() <= LARGEST_CHANGE * colors[i % 3] * 1.0001, "{sh:?}");
        }
        assert_eq!([sh[5], sh[8], sh[9]], [0.1, -0.1, 0.01], "what is small stays");
    }
}
