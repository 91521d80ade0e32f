//! A film on the lens: it grows, scatters light over the whole picture and is wiped away now and then.
//!
//!   out = (1 - a) in + a blurred(in),   a(pixel, t) = s(t) (1 + m(pixel)) / 2
//!
//! s grows as v (1 - exp(-u / r)) with the time u since the last wipe (r: half the mean time between wipes) and falls to
//! 0 within a fifth of a second at a wipe. m, in -1 to 1, is a smooth pattern that each wipe leaves anew.

use std::f64::consts::TAU;

use crate::airway::case::ClinicalSettings;
use crate::base::Image;
use crate::base::random::{CounterRng, Stage};

/// Time of a wipe in seconds.
const WIPE_S: f64 = 0.2;
/// Waves of the pattern, and their number over the picture's width.
const WAVES: usize = 10;
const WAVE_NUMBERS: [f64; 2] = [0.5, 4.0];
/// Width of the scattered light, as a part of the picture's width, and how often the box filter runs.
const SCATTER: f64 = 0.06;
const BOXES: usize = 3;

/// The film of one film.
#[derive(Clone, Debug)]
pub struct LensFilm {
    strength: f64,
    mean_s: f64,
    /// Times of the wipes, the first before the start.
    wipes_s: Vec<f64>,
    seed: u64,
}

impl LensFilm {
    /// For a film of `duration_s`; `settings` are the film's own, `seed` the case's.
    pub fn new(settings: &ClinicalSettings, duration_s: f64, seed: u64) -> LensFilm {
        let mean_s = settings.picture.wipe_every_s;
        let mut random = CounterRng::new(seed, Stage::Clinical, &[7]);
        let mut wipes_s = vec![-WIPE_S];
        let mut next_s = mean_s * random.range(0.6, 1.2);
        while next_s < duration_s {
            wipes_s.push(next_s);
            next_s += mean_s * random.range(0.7, 1.3);
        }
        LensFilm { strength: settings.picture.lens_film, mean_s, wipes_s, seed }
    }

    /// The wipe that came last before `time_s`, and the part of light that the film scatters in the mean.
    fn state(&self, time_s: f64) -> (usize, f64) {
        let last = self.wipes_s.iter().rposition(|&wipe_s| wipe_s <= time_s).unwrap_or(0);
        let grown = |since_s: f64| self.strength * (1.0 - (-2.0 * since_s.max(0.0) / self.mean_s).exp());
        let since_s = time_s - self.wipes_s[last];
        if last > 0 && since_s < WIPE_S {
            // Under the cloth: what was there goes.
            let before = grown(self.wipes_s[last] - self.wipes_s[last - 1] - WIPE_S);
            return (last - 1, before * (1.0 - since_s / WIPE_S));
        }
        (last, grown(since_s - WIPE_S))
    }

    /// Part of the light that is scattered at `time_s`, mean over the picture.
    pub fn scattered(&self, time_s: f64) -> f64 {
        0.5 * self.state(time_s).1
    }

    /// `radiance` through the film at `time_s`.
    pub fn seen_through(&self, radiance: Image<f32>, time_s: f64) -> Image<f32> {
        let (wipe, strength) = self.state(time_s);
        if strength <= 0.0 {
            return radiance;
        }
        let mut random = CounterRng::new(self.seed, Stage::Clinical, &[8, wipe as u64]);
        let waves: Vec<[f64; 4]> = (0..WAVES)
            .map(|_| {
                let (turn, number) = (random.range(0.0, TAU), TAU * random.range(WAVE_NUMBERS[0], WAVE_NUMBERS[1]));
                [number * turn.cos(), number * turn.sin(), random.range(0.0, TAU), random.range(0.3, 1.0)]
            })
            .collect();
        let most: f64 = waves.iter().map(|w| w[3]).sum::<f64>() * 0.5;
        let scattered = scattered_light(&radiance);
        let (width, height) = (radiance.width as f64, radiance.height as f64);
        let mut out = radiance;
        let row = out.width;
        for (p, pixel) in out.data.chunks_exact_mut(3).enumerate() {
            let (x, y) = ((p % row) as f64 / width, (p / row) as f64 / height);
            let sum: f64 = waves.iter().map(|[kx, ky, start, a]| a * (kx * x + ky * y + start).sin()).sum();
            let part = (0.5 * strength * (1.0 + (sum / most).clamp(-1.0, 1.0))) as f32;
            for (c, value) in pixel.iter_mut().enumerate() {
                *value += part * (scattered.data[3 * p + c] - *value);
            }
        }
        out
    }
}

/// The picture averaged over [`SCATTER`]: boxes one after another, across and down.
fn scattered_light(image: &Image<f32>) -> Image<f32> {
    let reach = ((SCATTER * image.width as f64).round() as usize).max(1);
    let mut out = image.clone();
    for _ in 0..BOXES {
        out = averaged(&averaged(&out, reach, 1), reach, image.width);
    }
    out
}

/// Means over 2 `reach` + 1 pixels along rows (`stride` 1) or columns (`stride` the width); at the rim over fewer.
fn averaged(image: &Image<f32>, reach: usize, stride: usize) -> Image<f32> {
    let (length, lines) = if stride == 1 { (image.width, image.height) } else { (image.height, image.width) };
    let mut out = image.clone();
    for line in 0..lines {
        let at = |k: usize| 3 * if stride == 1 { line * image.width + k } else { k * image.width + line };
        for c in 0..3 {
            let mut sums = vec![0.0f64; length + 1];
            for k in 0..length {
                sums[k + 1] = sums[k] + f64::from(image.data[at(k) + c]);
            }
            for k in 0..length {
                let (low, high) = (k.saturating_sub(reach), (k + reach + 1).min(length));
                out.data[at(k) + c] = ((sums[high] - sums[low]) / (high - low) as f64) as f32;
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_film_grows_is_wiped_and_keeps_the_light() {
        let film = LensFilm::new(&ClinicalSettings { spread: 0.0, ..Default::default() }.drawn(2), 60.0, 2);
        assert_eq!(film.scattered(0.0), 0.0);
        assert!(film.wipes_s.len() > 6 && film.scattered(3.5) > 0.05);
        for &wipe_s in &film.wipes_s[1..] {
            assert!(film.scattered(wipe_s - 0.01) > 0.08 && film.scattered(wipe_s + WIPE_S) < 1e-3);
            assert!((film.scattered(wipe_s + 1e-6) - film.scattered(wipe_s - 1e-6)).abs() < 0.02, "no jump");
        }
        let mut image = Image::filled(40, 30, 3, 0.5f32);
        assert!(film.seen_through(image.clone(), 3.5).data.iter().all(|v| (v - 0.5).abs() < 1e-6));
        image.pixel_mut(20, 15).copy_from_slice(&[50.0; 3]);
        let seen = film.seen_through(image.clone(), 3.5);
        assert!(seen.pixel(22, 15)[0] > 0.5 && seen.pixel(20, 15)[0] < 50.0);
        let off = ClinicalSettings { off: vec![crate::airway::case::Condition::LensFilm], ..Default::default() };
        assert_eq!(LensFilm::new(&off.drawn(2), 60.0, 2).seen_through(image.clone(), 3.5), image);
    }
}
