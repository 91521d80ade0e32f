//! The albedo of `ours-gn`: sweeps of SIRT (Gilbert 1972) over the discs in view, each moved by the weighted mean residual
//! of its pixels, held by what past frames have seen of it.

use super::{DARKEST, Level, Tracker};
use crate::base::Result;
use crate::reconstruct::anchored::{SH_C0, SH_VALUES};
use crate::reconstruct::phase_fit::pixels;
use crate::splat::{DepthOutput, ImageGradient, Settings, Wanted};

impl Tracker<'_> {
    /// Sweeps over the albedo of what is in view, at the present placement.
    pub fn learn(&mut self, frame: usize, level: &Level) -> Result<()> {
        self.color_the_unseen(level);
        let sweeps = self.settings.appearance_steps[usize::from(frame > 0)] as f64;
        let gain = self.gain;
        let settings = Settings { gain, depth: DepthOutput::Skip, ..Settings::default() };
        let seen = self.seen.as_mut().expect("a frame is entered before it is worked on");
        let before = seen.albedo.clone();
        let hold_pixels = *self.settings.hold_pixels as f32;
        let mut pixels_of = Vec::new();
        for sweep in 0..crate::reconstruct::scaled_iterations(sweeps, self.iteration_scale).max(2) {
            let rendered = self.rasterizer.render(&seen.patch.gaussians, &level.view, &settings, None)?;
            let residual: Vec<f32> = level.image.data.iter().zip(&rendered.color).map(|(i, r)| i - r).collect();
            if sweep == 0 {
                // What each disc contributes, in pixels.
                let ones = vec![1.0; residual.len()];
                let image = ImageGradient { color: &ones, ..ImageGradient::default() };
                let by_color = self.rasterizer.backward(&seen.patch.gaussians, &image, Wanted::SH)?;
                let shares = by_color.sh.chunks_exact(SH_VALUES).map(|g| g[1] / (SH_C0 * gain[1] as f32));
                pixels_of = shares.collect();
            }
            let image = ImageGradient { color: &residual, ..ImageGradient::default() };
            let gradients = self.rasterizer.backward(&seen.patch.gaussians, &image, Wanted::SH)?;
            for (k, by_color) in gradients.sh.chunks_exact(SH_VALUES).enumerate() {
                let (pixels, memory, shade) = (pixels_of[k], seen.memory[k] + hold_pixels, seen.shade[k]);
                if pixels < 1e-4 || shade <= 0.0 {
                    continue;
                }
                for c in 0..3 {
                    let pull = by_color[c] / (SH_C0 * (gain[c] * gain[c]) as f32 * shade);
                    let hold = memory * (seen.albedo[k][c] - before[k][c]);
                    let next = seen.albedo[k][c] + (pull - hold) / (pixels + memory);
                    seen.albedo[k][c] = next.max(DARKEST / shade);
                }
            }
            seen.color();
        }
        let most = *self.settings.memory_frames as f32;
        for (memory, pixels) in seen.memory.iter_mut().zip(&pixels_of).filter(|(_, pixels)| **pixels >= 1e-4) {
            *memory = (*memory + pixels).min(most * pixels);
        }
        Ok(())
    }

    /// Discs that no frame has shown yet start with the colour of the pixel they fall on, or the mean albedo in view.
    fn color_the_unseen(&mut self, level: &Level) {
        let gain = self.gain;
        let mean = self.mean_color;
        let seen = self.seen.as_mut().expect("a frame is entered before it is worked on");
        let at = pixels(&level.view, &seen.patch.gaussians);
        let (mut sum, mut count) = ([0.0f64; 3], 0.0f64);
        for (k, pixel) in at.into_iter().enumerate() {
            let shade = seen.shade[k].max(1e-6);
            if seen.memory[k] == 0.0 {
                seen.albedo[k] = match pixel {
                    Some([x, y]) => [0, 1, 2].map(|c| level.image.pixel(x, y)[c] / gain[c] as f32 / shade),
                    None => mean,
                };
            }
            if pixel.is_some() {
                (0..3).for_each(|c| sum[c] += seen.albedo[k][c] as f64);
                count += 1.0;
            }
        }
        if count > 0.0 {
            self.mean_color = sum.map(|s| (s / count) as f32);
        }
        seen.color();
    }
}
