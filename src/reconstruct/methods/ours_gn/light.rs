//! The image formation of the scope as `ours-gn` models it. How brightly a disc shows its albedo is in
//! `fitting/scope_light.rs`.
//!
//! The scope's lamp is brightest ahead and its lens darkest at the rim, so a wall gets darker while it moves away
//! from the image centre. Both are properties of the scope, which a white sheet reveals: images are divided by them
//! ("flat-fielding") before anything else. They are then kept as `linear^(1/2.2)` instead of sRGB's curve with its
//! linear foot: under a pure power law a gain stays a gain, and the fall-off with distance stays a power of it, at
//! any brightness.

use glam::DVec2;
use rayon::prelude::*;

use crate::base::color::{POWER_LAW, linear_from_srgb, srgb_from_linear};
use crate::base::{Camera, Image};

use crate::reconstruct::fitting::scope_light::CLIPPED;
use crate::reconstruct::settings::ScopeCalibration;

/// Entries of the table from the power law to sRGB. The error of interpolating linearly is well below half a code.
const ENTRIES: usize = 1024;
/// Pixels per task, at least.
const PIXELS: usize = 4096;
/// Smallest share of the light that a pixel is assumed to receive: limits the division.
const DARKEST_SHARE: f64 = 0.02;

/// Lamp, lens and encoding of the scope.
pub struct Scope {
    /// Per pixel, `share of the light ^ (1 / POWER_LAW)`.
    shadow: Vec<f32>,
    decode: Vec<f32>,
    encode: Vec<f32>,
}

impl Scope {
    /// The scope of `camera`.
    pub fn new(camera: &Camera, light: &ScopeCalibration) -> Scope {
        let half = light.emission_half_angle_deg.to_radians();
        let exponent = if half > 0.0 { 0.5f64.ln() / half.cos().ln() } else { 0.0 };
        let mut shadow = Vec::with_capacity((camera.width * camera.height) as usize);
        for y in 0..camera.height {
            for x in 0..camera.width {
                let cosine = camera.direction(DVec2::new(x as f64 + 0.5, y as f64 + 0.5)).normalize().z.max(0.0);
                let share = cosine.powf(exponent) * (1.0 - *light.vignette * (1.0 - cosine.powi(4)));
                shadow.push(share.max(DARKEST_SHARE).powf(1.0 / POWER_LAW as f64) as f32);
            }
        }
        let decode = (0..256).map(|code| linear_from_srgb(code as f32 / 255.0).powf(1.0 / POWER_LAW)).collect();
        let last = (ENTRIES - 1) as f32;
        let encode = (0..ENTRIES).map(|i| srgb_from_linear((i as f32 / last).powf(POWER_LAW))).collect();
        Scope { shadow, decode, encode }
    }

    /// An image of the film, flat-fielded and in the power law.
    pub fn flat(&self, image: &Image<u8>) -> Image<f32> {
        let pixels = image.data.par_chunks_exact(3).zip(&self.shadow).with_min_len(PIXELS);
        let flat: Vec<[f32; 3]> =
            pixels.map(|(p, shadow)| [0, 1, 2].map(|c| self.decode[p[c] as usize] / shadow)).collect();
        Image { width: image.width, height: image.height, channels: 3, data: flat.into_flattened() }
    }

    /// The values of [`Scope::flat`] from which on a channel is clipped, at the picture's size and halved `times` times.
    pub fn clipped_from(&self, camera: &Camera, times: usize) -> Vec<Image<f32>> {
        let code = (CLIPPED * 255.0).ceil() as u8;
        let mut sizes = vec![self.flat(&Image::filled(camera.width as usize, camera.height as usize, 3, code))];
        while sizes.len() <= times && sizes[sizes.len() - 1].width.min(sizes[sizes.len() - 1].height) > 1 {
            sizes.push(sizes[sizes.len() - 1].halved());
        }
        sizes
    }

    /// The inverse of [`Scope::flat`]: a rendering as the film would show it, sRGB in 0..1.
    pub fn shown(&self, width: usize, height: usize, rendered: &[f32]) -> Image<f32> {
        let last = (ENTRIES - 1) as f32;
        let encoded = |value: f32| {
            let place = value.clamp(0.0, 1.0) * last;
            let below = (place as usize).min(ENTRIES - 2);
            let share = place - below as f32;
            self.encode[below] * (1.0 - share) + self.encode[below + 1] * share
        };
        let pixels = rendered.par_chunks_exact(3).zip(&self.shadow).with_min_len(PIXELS);
        let shown: Vec<[f32; 3]> = pixels.map(|(p, shadow)| [0, 1, 2].map(|c| encoded(p[c] * shadow))).collect();
        Image { width, height, channels: 3, data: shown.into_flattened() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reconstruct::settings::{NumberSource, Sourced};

    fn scope(camera: &Camera, half: f64, vignette: f64) -> Scope {
        let number = |value| Sourced { value, source: NumberSource::Ours, why: String::new() };
        Scope::new(camera, &ScopeCalibration { emission_half_angle_deg: number(half), vignette: number(vignette) })
    }

    #[test]
    fn what_is_made_flat_is_shown_again() {
        let camera = Camera::pinhole(24, 16, 1.7);
        let codes: Vec<u8> = (0..24 * 16 * 3).map(|i| (i * 7 % 256) as u8).collect();
        let image = Image { width: 24, height: 16, channels: 3, data: codes };
        let scope = scope(&camera, 60.0, 0.2);
        let shown = scope.shown(24, 16, &scope.flat(&image).data);
        for (shown, code) in shown.data.iter().zip(&image.data) {
            assert!((shown * 255.0 - *code as f32).abs() < 0.5, "{shown} {code}");
        }
    }

    #[test]
    fn an_even_wall_under_a_lambertian_lamp_becomes_flat() {
        let camera = Camera::pinhole(32, 32, 1.7);
        let light = |x: usize, y: usize| {
            let direction = camera.direction(DVec2::new(x as f64 + 0.5, y as f64 + 0.5)).normalize();
            // Half as bright at 60 degrees is the cosine.
            direction.z * (1.0 - 0.3 * (1.0 - direction.z.powi(4)))
        };
        let value = |i: usize| (0.6 * light(i / 3 % 32, i / 96)) as f32;
        let codes = (0..32 * 32 * 3).map(|i| crate::base::color::srgb8_from_linear(value(i))).collect();
        let flat = scope(&camera, 60.0, 0.3).flat(&Image { width: 32, height: 32, channels: 3, data: codes });
        let wanted = 0.6f32.powf(1.0 / POWER_LAW);
        assert!(flat.data.iter().all(|v| (v - wanted).abs() < 0.01));
    }
}
