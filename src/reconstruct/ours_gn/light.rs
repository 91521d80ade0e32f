//! Light as `ours-gn` knows it: what a disc shows of its albedo, and what the scope does to the picture.
//!
//! The scope's lamp is brightest ahead and its lens darkest at the rim, so that a wall gets darker while it moves out of
//! the middle. Both are properties of the scope that a white sheet shows, not of the tissue: pictures are divided by them
//! ("flat-fielding") before anything else. And they are kept as `linear^(1/2.2)` instead of sRGB's curve with its linear
//! foot: in a pure power law a gain stays a gain, and the fall-off with distance a power of it, however dark the place.

use glam::{DVec2, Vec3};

use crate::base::color::{linear_from_srgb, srgb_from_linear};
use crate::base::{Camera, Image};

use crate::reconstruct::settings::ScopeLight;

/// d0: distance at which albedo is what is shown.
const REFERENCE_MM: f32 = 10.0;
/// Exponent of the power law.
const GAMMA: f32 = 2.2;
/// Entries of the table from the power law to sRGB; linear between them, well below half a code.
const ENTRIES: usize = 1024;
/// Least share of the light that a pixel is taken to get.
const DARKEST_SHARE: f64 = 0.02;

/// How much of its albedo a disc shows, and how that changes while it moves.
pub struct Light {
    /// Where the light sits, in the world.
    pub eye: Vec3,
    /// Brightness in the power law falls with distance to this power.
    pub exponent: f32,
    /// Light that does not depend on the incidence, as a share of that which does.
    pub indirect: f32,
}

/// What a disc shows of its albedo, and the derivatives of that.
pub struct Shade {
    /// Factor on the albedo.
    pub value: f32,
    /// Its derivative by the unknown that moves the disc.
    pub by_phase: f32,
}

impl Light {
    /// Shade of a disc at `centre` (mm) with `axes`, and its change while the centre moves with `velocity`.
    pub fn shade(&self, centre: [f32; 3], axes: &[[f32; 3]; 2], velocity: [f32; 3]) -> Shade {
        let offset = Vec3::from(centre) - self.eye;
        let distance = offset.length().max(1e-3);
        let towards = offset / distance;
        let normal = Vec3::from(axes[0]).cross(Vec3::from(axes[1])).normalize_or_zero();
        let along = normal.dot(towards);
        let cosine = along.abs();
        let lit = (cosine + self.indirect) / (1.0 + self.indirect);
        let shown = REFERENCE_MM / distance * lit.max(1e-3).sqrt();
        // The shipped exponent is 1, and this is done for every disc of every step.
        let value = if self.exponent == 1.0 { shown } else { shown.powf(self.exponent) };
        let velocity = Vec3::from(velocity);
        let away = towards.dot(velocity);
        let turning = normal.dot(velocity - towards * away) / distance * along.signum();
        let relative = -away / distance + 0.5 * turning / (cosine + self.indirect).max(1e-3);
        Shade { value, by_phase: value * self.exponent * relative }
    }
}

/// What the scope does to the picture.
pub struct Scope {
    /// Per pixel, `share of the light ^ (1 / GAMMA)`.
    shadow: Vec<f32>,
    decode: Vec<f32>,
    encode: Vec<f32>,
}

impl Scope {
    /// The scope of `camera`.
    pub fn new(camera: &Camera, light: &ScopeLight) -> Scope {
        let half = light.emission_half_angle_deg.to_radians();
        let exponent = if half > 0.0 { 0.5f64.ln() / half.cos().ln() } else { 0.0 };
        let mut shadow = Vec::with_capacity((camera.width * camera.height) as usize);
        for y in 0..camera.height {
            for x in 0..camera.width {
                let cosine = camera.direction(DVec2::new(x as f64 + 0.5, y as f64 + 0.5)).normalize().z.max(0.0);
                let share = cosine.powf(exponent) * (1.0 - *light.vignette * (1.0 - cosine.powi(4)));
                shadow.push(share.max(DARKEST_SHARE).powf(1.0 / GAMMA as f64) as f32);
            }
        }
        let decode = (0..256).map(|code| linear_from_srgb(code as f32 / 255.0).powf(1.0 / GAMMA)).collect();
        let last = (ENTRIES - 1) as f32;
        let encode = (0..ENTRIES).map(|i| srgb_from_linear((i as f32 / last).powf(GAMMA))).collect();
        Scope { shadow, decode, encode }
    }

    /// An image of the film, flat and in the power law.
    pub fn flat(&self, image: &Image<u8>) -> Image<f32> {
        let pixels = image.data.chunks_exact(3).zip(&self.shadow);
        let data = pixels.flat_map(|(p, shadow)| [0, 1, 2].map(|c| self.decode[p[c] as usize] / shadow)).collect();
        Image { width: image.width, height: image.height, channels: 3, data }
    }

    /// The inverse of [`Scope::flat`]: as the film would show what was rendered, sRGB in 0..1.
    pub fn shown(&self, width: usize, height: usize, rendered: &[f32]) -> Image<f32> {
        let last = (ENTRIES - 1) as f32;
        let encoded = |value: f32| {
            let place = value.clamp(0.0, 1.0) * last;
            let below = (place as usize).min(ENTRIES - 2);
            let share = place - below as f32;
            self.encode[below] * (1.0 - share) + self.encode[below + 1] * share
        };
        let pixels = rendered.chunks_exact(3).zip(&self.shadow);
        let data = pixels.flat_map(|(p, shadow)| [0, 1, 2].map(|c| encoded(p[c] * shadow))).collect();
        Image { width, height, channels: 3, data }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reconstruct::settings::{Source, Sourced};

    fn scope(camera: &Camera, half: f64, vignette: f64) -> Scope {
        let number = |value| Sourced { value, source: Source::Ours, why: String::new() };
        Scope::new(camera, &ScopeLight { emission_half_angle_deg: number(half), vignette: number(vignette) })
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
        let wanted = 0.6f32.powf(1.0 / GAMMA);
        assert!(flat.data.iter().all(|v| (v - wanted).abs() < 0.01));
    }

    #[test]
    fn the_derivative_of_the_shade_is_that_of_the_shade() {
        let light = Light { eye: Vec3::new(0.3, -0.2, 0.1), exponent: 1.0, indirect: 0.7 };
        let (centre, velocity) = ([3.0, 1.0, 6.0], [0.5, -2.0, 1.0]);
        let axes = [[0.2, 0.9, 0.1], [0.8, -0.1, 0.4]];
        let at = |h: f32| light.shade([0, 1, 2].map(|k| centre[k] + h * velocity[k]), &axes, [0.0; 3]).value;
        let difference = (at(0.01) - at(-0.01)) / 0.02;
        let exact = light.shade(centre, &axes, velocity).by_phase;
        assert!((difference - exact).abs() < 1e-3 * exact.abs(), "{difference} {exact}");
    }
}
