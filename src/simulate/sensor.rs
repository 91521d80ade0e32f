//! From radiance to the 8-bit image: vignette, gain, shot and read noise, white balance, mask, sRGB, in this order.
//!
//! A sensor element of gain 1 and value v (linear, white = 1) holds v / s^2 electrons, s = `shot_noise`, Poisson
//! distributed; the amplifier adds a Gaussian of deviation `read_noise`. A frame whose gain is k times the film's
//! middle one has 1/k of the electrons and k times the read noise: variance k s^2 v + (k r)^2. White balance multiplies
//! after the noise. Poisson numbers: inversion below 10, PTRS above (Hörmann, Insurance: Mathematics and Economics 12,
//! 1993). Left out: dark current, fixed pattern, colour filter array, quantisation before the 8 bits, compression.

use glam::DVec2;
use rayon::prelude::*;

use crate::airway::case::ScopeSettings;
use crate::base::random::{CounterRng, Stage};
use crate::base::{Camera, Image};

/// What one frame's sensor does beyond the scope's constant properties.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Exposed {
    /// Factor on linear radiance.
    pub gain: f64,
    /// Gain over the film's middle gain.
    pub amplification: f64,
    /// Factors on red, green and blue.
    pub white_balance: [f64; 3],
}

/// Lens and sensor of one film.
pub struct Sensor {
    scope: ScopeSettings,
    seed: u64,
    /// Per pixel: factor of the vignette, coverage by the mask's opening.
    vignette: Vec<f32>,
    opening: Option<Vec<f32>>,
}

impl Sensor {
    /// For images of `camera`; `seed` is the case's.
    pub fn new(camera: &Camera, scope: &ScopeSettings, seed: u64) -> Sensor {
        let (width, height) = (camera.width as usize, camera.height as usize);
        let centre = |p: usize| DVec2::new((p % width) as f64 + 0.5, (p / width) as f64 + 0.5);
        let pixels = 0..width * height;
        let vignette = pixels.clone().map(|p| vignette_at(camera, centre(p), scope.vignette) as f32).collect();
        let opening = mask_radius_px(camera, scope).map(|radius| {
            let middle = DVec2::new(width as f64, height as f64) / 2.0;
            pixels.map(|p| (radius - centre(p).distance(middle) + 0.5).clamp(0.0, 1.0) as f32).collect()
        });
        Sensor { scope: *scope, seed, vignette, opening }
    }

    /// The image of frame `frame` whose linear radiance is `radiance` (three channels).
    pub fn image(&self, radiance: &Image<f32>, exposed: &Exposed, frame: u64) -> Image<u8> {
        self.linear(radiance, exposed, frame).to_srgb8()
    }

    /// [`Sensor::image`] before clipping and sRGB.
    pub fn linear(&self, radiance: &Image<f32>, exposed: &Exposed, frame: u64) -> Image<f32> {
        let mut out = radiance.clone();
        let row = radiance.width * 3;
        out.data.par_chunks_exact_mut(row).enumerate().for_each(|(y, values)| {
            let mut random = CounterRng::new(self.seed, Stage::Sensor, &[frame, y as u64]);
            for (x, pixel) in values.chunks_exact_mut(3).enumerate() {
                let p = y * radiance.width + x;
                for (c, value) in pixel.iter_mut().enumerate() {
                    let clean = (*value * self.vignette[p]) as f64 * exposed.gain;
                    let seen = self.noisy(clean, exposed.amplification, &mut random) * exposed.white_balance[c];
                    *value = seen as f32 * self.opening.as_ref().map_or(1.0, |o| o[p]);
                }
            }
        });
        out
    }

    /// [`Sensor::image`] without noise, in encoded values: what dI/dalpha is about.
    pub fn clean_encoded(&self, radiance: &Image<f32>, exposed: &Exposed) -> Image<f32> {
        let quiet = Sensor {
            scope: ScopeSettings { shot_noise: 0.0, read_noise: 0.0, ..self.scope },
            seed: self.seed,
            vignette: self.vignette.clone(),
            opening: self.opening.clone(),
        };
        quiet.linear(radiance, exposed, 0).map(crate::base::color::srgb_from_linear)
    }

    /// 255 where the image shows something, 0 where the mask hides it; `None` without a mask.
    pub fn mask(&self, camera: &Camera) -> Option<Image<u8>> {
        let data = self.opening.as_ref()?.iter().map(|&o| if o > 0.5 { 255 } else { 0 }).collect();
        Some(Image { width: camera.width as usize, height: camera.height as usize, channels: 1, data })
    }

    fn noisy(&self, value: f64, amplification: f64, random: &mut CounterRng) -> f64 {
        let mut value = value;
        let electron = self.scope.shot_noise * self.scope.shot_noise * amplification;
        if electron > 0.0 {
            value = poisson(value.max(0.0) / electron, random) * electron;
        }
        if self.scope.read_noise > 0.0 {
            value += self.scope.read_noise * amplification * random.normal();
        }
        value
    }
}

/// Radius of the mask's opening in pixels; `None` without a mask.
pub fn mask_radius_px(camera: &Camera, scope: &ScopeSettings) -> Option<f64> {
    (scope.mask_radius > 0.0).then(|| scope.mask_radius * camera.width.min(camera.height) as f64 / 2.0)
}

/// Part of the light that passes the lens at an image point: 1 - strength (1 - cos^4 of the angle to the axis).
pub fn vignette_at(camera: &Camera, pixel: DVec2, strength: f64) -> f64 {
    let direction = camera.direction(pixel);
    let cosine = (direction.z / direction.length()).max(0.0);
    1.0 - strength * (1.0 - cosine.powi(4))
}

/// A Poisson number of mean `mean` (0 and above, finite).
fn poisson(mean: f64, random: &mut CounterRng) -> f64 {
    if mean < 10.0 {
        // Inversion: products of uniforms until they fall below exp(-mean).
        let stop = (-mean).exp();
        let (mut count, mut product) = (0.0, random.uniform());
        while product > stop {
            product *= random.uniform();
            count += 1.0;
        }
        return count;
    }
    // PTRS, transformed rejection, with the constants of the paper: draw from the hat ...
    let b = 0.931 + 2.53 * mean.sqrt();
    let a = -0.059 + 0.02483 * b;
    let inverse_alpha = 1.1239 + 1.1328 / (b - 3.4);
    let quick = 0.9277 - 3.6224 / (b - 2.0);
    loop {
        let u = random.uniform() - 0.5;
        let v = random.uniform();
        let us = 0.5 - u.abs();
        let count = ((2.0 * a / us + b) * u + mean + 0.43).floor();
        // ... accept most draws at once ...
        if us >= 0.07 && v <= quick {
            return count;
        }
        if count < 0.0 || (us < 0.013 && v > us) {
            continue;
        }
        // ... and test the others against the Poisson density.
        let logarithm = (v * inverse_alpha / (a / (us * us) + b)).ln();
        if logarithm <= count * mean.ln() - mean - log_factorial(count) {
            return count;
        }
    }
}

/// ln n! of a whole number; Stirling's series from 10 on (error below 1e-9).
fn log_factorial(n: f64) -> f64 {
    if n < 10.0 {
        return (2..=n as u32).map(|i| f64::from(i).ln()).sum();
    }
    let x = n + 1.0;
    (x - 0.5) * x.ln() - x + 0.5 * std::f64::consts::TAU.ln() + 1.0 / (12.0 * x) - 1.0 / (360.0 * x * x * x)
        + 1.0 / (1260.0 * x.powi(5))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn exposed(gain: f64, amplification: f64) -> Exposed {
        Exposed { gain, amplification, white_balance: [1.0; 3] }
    }

    fn moments(values: impl Iterator<Item = f64> + Clone) -> (f64, f64) {
        let n = values.clone().count() as f64;
        let mean = values.clone().sum::<f64>() / n;
        (mean, values.map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0))
    }

    #[test]
    fn factorials_are_those_of_the_definition() {
        for n in [0u32, 1, 5, 9, 10, 11, 40, 150] {
            let exact: f64 = (2..=n).map(|i| f64::from(i).ln()).sum();
            assert!((log_factorial(f64::from(n)) - exact).abs() < 1e-9 * exact.max(1.0), "{n}");
        }
    }

    #[test]
    fn poisson_numbers_have_the_poisson_distribution() {
        for mean in [0.3, 6.0, 9.99, 10.01, 37.0, 900.0] {
            let mut random = CounterRng::new(7, Stage::Test, &[(mean * 100.0) as u64]);
            let n = 200_000;
            let draws: Vec<f64> = (0..n).map(|_| poisson(mean, &mut random)).collect();
            // Chi-square over the counts that are expected at least 20 times; the two tails make one bin each.
            let deviation: f64 = mean.sqrt();
            let (low, high) = ((mean - 3.0 * deviation).max(0.0).floor(), (mean + 3.0 * deviation).ceil());
            let probability = |k: f64| (k * f64::ln(mean) - mean - log_factorial(k)).exp();
            let (mut chi, mut bins, mut inside, mut seen_inside) = (0.0, 0.0f64, 0.0, 0.0);
            let mut k = low;
            while k <= high {
                let seen = draws.iter().filter(|&&d| d == k).count() as f64;
                let expected = n as f64 * probability(k);
                if expected >= 20.0 {
                    chi += (seen - expected).powi(2) / expected;
                    bins += 1.0;
                    inside += expected;
                    seen_inside += seen;
                }
                k += 1.0;
            }
            let (out, seen_out) = (n as f64 - inside, n as f64 - seen_inside);
            if out >= 20.0 {
                chi += (seen_out - out).powi(2) / out;
            }
            // Mean `bins`, deviation sqrt(2 bins): four deviations.
            assert!(chi < bins + 4.0 * (2.0 * bins).sqrt() + 4.0, "mean {mean}: chi-square {chi} over {bins} bins");
        }
    }

    #[test]
    fn noise_has_the_variance_of_the_poisson_and_gaussian_model() {
        let camera = Camera::pinhole(200, 200, 1.5);
        let scope = ScopeSettings { vignette: 0.0, shot_noise: 0.02, read_noise: 0.004, ..ScopeSettings::default() };
        let sensor = Sensor::new(&camera, &scope, 5);
        for (level, amplification) in [(0.0, 1.0), (0.02, 1.0), (0.3, 1.0), (0.9, 1.0), (0.3, 4.0), (0.02, 0.25)] {
            let flat = Image::filled(200, 200, 3, level as f32 / 3.0);
            let seen = sensor.linear(&flat, &exposed(3.0, amplification), 11);
            let (mean, variance) = moments(seen.data.iter().map(|&v| v as f64));
            let expected = amplification * 0.02f64.powi(2) * level + (amplification * 0.004f64).powi(2);
            // 120,000 values: the variance is known to about .41 %, the mean to its own error.
            assert!((variance / expected - 1.0).abs() < 0.02, "{level} x{amplification}: {variance} for {expected}");
            assert!((mean - level).abs() < 5.0 * (expected / 120_000.0).sqrt(), "{level}: mean {mean}");
        }
        // White balance comes after the noise: it scales the deviation too.
        let flat = Image::filled(200, 200, 3, 0.5f32);
        let tinted = Exposed { white_balance: [2.0, 1.0, 1.0], ..exposed(1.0, 1.0) };
        let seen = sensor.linear(&flat, &tinted, 3);
        let (_, red) = moments(seen.data.iter().step_by(3).map(|&v| v as f64));
        assert!((red / (4.0 * (0.02f64.powi(2) * 0.5 + 0.004f64.powi(2))) - 1.0).abs() < 0.04);
    }

    #[test]
    fn noise_differs_between_frames_and_switches_off() {
        let camera = Camera::pinhole(32, 32, 1.5);
        let flat = Image::filled(32, 32, 3, 0.4f32);
        let sensor = Sensor::new(&camera, &ScopeSettings::default(), 5);
        let (a, b) = (sensor.image(&flat, &exposed(1.0, 1.0), 0), sensor.image(&flat, &exposed(1.0, 1.0), 1));
        assert_ne!(a, b);
        assert_eq!(a, sensor.image(&flat, &exposed(1.0, 1.0), 0));
        let off = ScopeSettings { shot_noise: 0.0, read_noise: 0.0, vignette: 0.0, ..ScopeSettings::default() };
        let clean = Sensor::new(&camera, &off, 5).linear(&flat, &exposed(0.5, 1.0), 0);
        assert!(clean.data.iter().all(|&v| v == 0.2));
    }

    #[test]
    fn the_vignette_is_the_stated_part_of_the_cosine_law() {
        let camera = Camera::pinhole(101, 101, 100f64.to_radians());
        let off = ScopeSettings { shot_noise: 0.0, read_noise: 0.0, ..ScopeSettings::default() };
        let flat = Image::filled(101, 101, 3, 1.0f32);
        for strength in [0.0, 0.2, 1.0] {
            let sensor = Sensor::new(&camera, &ScopeSettings { vignette: strength, ..off }, 1);
            let seen = sensor.linear(&flat, &exposed(1.0, 1.0), 0);
            for (x, y) in [(50usize, 50usize), (50, 0), (100, 50), (20, 80)] {
                let (dx, dy) = ((x as f64 - 50.0) / camera.fl_x, (y as f64 - 50.0) / camera.fl_x);
                // cos^4 of a pinhole: 1 / (1 + tan^2)^2.
                let law = 1.0 / (1.0 + dx * dx + dy * dy).powi(2);
                let expected = 1.0 - strength + strength * law;
                assert!((seen.pixel(x, y)[1] as f64 - expected).abs() < 1e-6, "{x} {y} at {strength}");
            }
        }
    }

    #[test]
    fn the_mask_is_a_circle_of_the_stated_radius() {
        let camera = Camera::pinhole(100, 80, 1.5);
        let scope = ScopeSettings { mask_radius: 0.9, ..ScopeSettings::default() };
        let sensor = Sensor::new(&camera, &scope, 1);
        assert_eq!(mask_radius_px(&camera, &scope), Some(36.0));
        let mask = sensor.mask(&camera).unwrap();
        let area = mask.data.iter().filter(|&&v| v == 255).count() as f64;
        assert!((area / (std::f64::consts::PI * 36.0 * 36.0) - 1.0).abs() < 0.01, "{area}");
        let image = sensor.image(&Image::filled(100, 80, 3, 0.5f32), &exposed(1.0, 1.0), 0);
        assert_eq!(image.pixel(1, 1), [0, 0, 0]);
        assert!(image.pixel(50, 40)[0] > 100);
        assert!(Sensor::new(&camera, &ScopeSettings::default(), 1).mask(&camera).is_none());
    }
}
