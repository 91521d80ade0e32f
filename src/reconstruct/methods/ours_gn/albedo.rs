//! The albedo of `ours-gn`: sweeps of SIRT (Gilbert 1972) over the discs in view. Each sweep moves a disc by the
//! weighted mean residual of its pixels, against the weight of what past frames have shown of it. The rendering of
//! the frame is then touched up by a few more sweeps without that weight, with Nesterov's (1983) momentum; their
//! result is discarded after the frame.

use rayon::prelude::*;

use super::map::{ActiveFrame, DISCS};
use super::renderer::{DiscRenderer, of_size};
use crate::base::Result;
use crate::reconstruct::fitting::anchored::SH_C0;
use crate::reconstruct::fitting::schedule::scaled_iterations;
use crate::reconstruct::geometry::pyramid::PyramidLevel;
use crate::reconstruct::geometry::visible::pixels;
use crate::splat::{DepthOutput, ImageGradient, Reuse, Settings, Wanted};

/// Darkest shown colour (0..1): a colour of zero has no gradient.
const DARKEST: f32 = 0.005;
/// Discs that contribute fewer pixels are not in view.
const FEWEST_PIXELS: f32 = 1e-4;

/// Pixels per task.
const PIXELS: usize = 4096;

/// What holds a disc at its former albedo.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Hold {
    /// The weight of past frames.
    Memory,
    /// No past frames; sweeps have momentum.
    Nothing,
}

impl DiscRenderer<'_> {
    /// Updates the albedo of the discs in view, at the current placement.
    pub fn learn(&mut self, active: &mut ActiveFrame, frame: usize, level: &PyramidLevel) -> Result<()> {
        // From here to the end of the frame nothing moves: only colours change between renderings.
        self.rasterizer.reuse(Reuse::Unchanged);
        self.color_the_unseen(active, level);
        let sweeps = self.settings.appearance_steps[usize::from(frame > 0)] as f64;
        self.count_pixels(active, level)?;
        self.sweep(active, level, scaled_iterations(sweeps, self.iteration_scale).max(2), Hold::Memory)?;
        let most = *self.settings.memory_frames as f32;
        for (memory, pixels) in active.memory.iter_mut().zip(&active.pixels).filter(|(_, p)| **p >= FEWEST_PIXELS) {
            *memory = (*memory + pixels).min(most * pixels);
        }
        Ok(())
    }

    /// Touches up the colours, not the albedo, after [`DiscRenderer::learn`].
    pub fn touch_up(&mut self, active: &mut ActiveFrame, level: &PyramidLevel) -> Result<()> {
        let kept = active.albedo.clone();
        self.sweep(active, level, *self.settings.touch_up_steps as usize, Hold::Nothing)?;
        active.albedo = kept;
        Ok(())
    }

    /// The contribution of each disc in pixels, `n_k = sum_i w_i dI_i / d(colour k)`, by one backward pass over the
    /// weights.
    fn count_pixels(&mut self, active: &mut ActiveFrame, level: &PyramidLevel) -> Result<()> {
        self.draw(active, &level.view)?;
        let counting: Vec<f32> = (0..level.image.data.len()).map(|i| level.weight(i / 3)).collect();
        let image = ImageGradient { color: &counting, ..ImageGradient::default() };
        let by_color = self.rasterizer.backward(active.gaussians(), &image, Wanted::SH)?;
        let scale = SH_C0 * self.gain[1] as f32;
        let pixels = by_color.sh.chunks_exact(3).map(|g| g[1] / scale);
        active.pixels.clear();
        active.pixels.extend(pixels);
        Ok(())
    }

    /// SIRT: let `n_k` be the pixels of disc `k`, `s_k` its shade and `m_k` the weight, in pixels, of its former
    /// albedo `b_k`. Each sweep moves its albedo `a_k` by `(g_k - m_k (a_k - b_k)) / (n_k + m_k)`, where
    /// `g_k = sum_i w_i dI_i/d(colour k) (I_i - R_i) / (gain^2 s_k)` is the residual of its pixels, in albedo; it is 0
    /// where the picture is clipped and the rendering brighter.
    fn sweep(&mut self, active: &mut ActiveFrame, level: &PyramidLevel, sweeps: usize, hold: Hold) -> Result<()> {
        let gain = self.gain;
        let settings = Settings { gain, depth: DepthOutput::Skip, ..Settings::default() };
        let hold_pixels = *self.settings.hold_pixels as f32;
        let before = active.albedo.clone();
        let mut last = active.albedo.clone();
        let clipped_from = of_size(&self.clipped_from, level);
        let mut residual = vec![0.0; level.image.data.len()];
        for sweep in 0..sweeps {
            // Weighted residuals.
            let rendered = self.rasterizer.render(active.gaussians(), &level.view, &settings, None)?;
            let images = level.image.data.par_chunks(3 * PIXELS).zip(rendered.color.par_chunks(3 * PIXELS));
            residual.par_chunks_mut(3 * PIXELS).zip(images).enumerate().for_each(
                |(piece, (out, (image, rendered)))| {
                    let pixels = image.as_chunks::<3>().0.iter().zip(rendered.as_chunks::<3>().0).enumerate();
                    for (out, (at, (image, rendered))) in out.as_chunks_mut::<3>().0.iter_mut().zip(pixels) {
                        let index = PIXELS * piece + at;
                        let weight = level.weight(index);
                        let is_clipped = |c: usize| clipped_from.get(3 * index + c).is_some_and(|v| image[c] >= *v);
                        // A clipped value is no reason to darken.
                        let off = |c: usize| image[c] - rendered[c];
                        *out =
                            [0, 1, 2].map(|c| if is_clipped(c) { weight * off(c).max(0.0) } else { weight * off(c) });
                    }
                },
            );
            // Their sum over the pixels of each disc, by a backward pass.
            let image = ImageGradient { color: &residual, ..ImageGradient::default() };
            let gradients = self.rasterizer.backward(active.gaussians(), &image, Wanted::SH)?;
            // The step of each disc, with Nesterov's extrapolation in the touch-up.
            let momentum = match hold {
                Hold::Nothing if sweep + 1 < sweeps => sweep as f32 / (sweep as f32 + 3.0),
                _ => 0.0,
            };
            let ActiveFrame { pixels, shade, memory, albedo, .. } = active;
            let step = |k: usize, by_color: &[f32], albedo: &mut [f32; 3], last: &mut [f32; 3]| {
                let (pixels, shade) = (pixels[k], shade[k]);
                if pixels < FEWEST_PIXELS || shade <= 0.0 {
                    return;
                }
                let memory = hold_pixels + if hold == Hold::Memory { memory[k] } else { 0.0 };
                for c in 0..3 {
                    let gradient = by_color[c] / (SH_C0 * (gain[c] * gain[c]) as f32 * shade);
                    let back = memory * (albedo[c] - before[k][c]);
                    let next = (albedo[c] + (gradient - back) / (pixels + memory)).max(DARKEST / shade);
                    let ahead = next + momentum * (next - last[c]);
                    last[c] = next;
                    albedo[c] = ahead.max(DARKEST / shade);
                }
            };
            let discs = albedo.par_iter_mut().zip(&mut last).zip(gradients.sh.par_chunks_exact(3)).enumerate();
            discs.with_min_len(DISCS).for_each(|(k, ((albedo, last), by_color))| step(k, by_color, albedo, last));
            active.color();
        }
        Ok(())
    }

    /// Discs that no frame has shown yet start with the colour of the pixel they fall on, or the mean albedo in view.
    fn color_the_unseen(&mut self, active: &mut ActiveFrame, level: &PyramidLevel) {
        let (gain, mean) = (self.gain, self.mean_color);
        let at = pixels(&level.view, &active.gaussians().positions);
        let (mut sum, mut count) = ([0.0f64; 3], 0.0f64);
        for (k, pixel) in at.into_iter().enumerate() {
            let pixel = pixel.filter(|[x, y]| level.weight(y * level.image.width + x) > 0.0);
            let shade = active.shade[k].max(1e-6);
            if active.memory[k] == 0.0 {
                active.albedo[k] = match pixel {
                    Some([x, y]) => [0, 1, 2].map(|c| level.image.pixel(x, y)[c] / gain[c] as f32 / shade),
                    None => mean,
                };
            }
            if pixel.is_some() {
                (0..3).for_each(|c| sum[c] += active.albedo[k][c] as f64);
                count += 1.0;
            }
        }
        if count > 0.0 {
            self.mean_color = sum.map(|s| (s / count) as f32);
        }
        active.color();
    }
}
