//! Samples of the pixels of an image: a given number of each, or as many as a given error needs.
//!
//! Adaptive: tiles of 16 x 16 pixels. After every round a tile knows two halves of its samples, whose difference tells
//! the error of their mean; tiles above the target double their samples until the image's mean error is below it. (The
//! least samples for a given mean error would go as the square root of a tile's error; doubling comes near.) A half's
//! error is only an estimate: a tile whose rare bright paths neither half has met stops too early.

use rayon::prelude::*;

use super::scene::Scene;
use crate::base::{Progress, Result};
use crate::ffi::trace::tracer::{FilmPixel, FrameSettings, KnownLight, TileCounters, TileRequest};

/// Side of a tile in pixels.
const TILE_PX: u32 = 16;
/// Most samples per pixel of one round: the tracer's f32 sums stay exact enough, and the user can stop between rounds.
const SAMPLES_PER_ROUND: u32 = 32;
/// Most tiles between two reports of progress: a quarter of a million pixels.
const TILES_PER_REPORT: usize = 1024;
/// Most samples per pixel: adaptive sampling stops there.
pub(super) const MAX_SAMPLES: u32 = 65_536;
/// Share of the picture's mean radiance below which the error is no longer relative to the radiance itself.
const DARK: f64 = 0.01;

type RgbSum = [f64; 3];

/// Sums over a pixel's samples ([`FilmPixel`]), exact enough for any number of them.
#[derive(Clone, Copy, Default)]
pub(super) struct PixelSums {
    pub direct: RgbSum,
    pub indirect: RgbSum,
    pub indirect_base: RgbSum,
    pub indirect_coat: RgbSum,
    pub albedo: RgbSum,
    pub normal: RgbSum,
    pub hits: f64,
}

impl PixelSums {
    fn add(&mut self, more: &FilmPixel) {
        let add = |sum: &mut RgbSum, more: [f32; 3]| (0..3).for_each(|c| sum[c] += more[c] as f64);
        add(&mut self.direct, more.direct);
        add(&mut self.indirect, more.indirect);
        add(&mut self.indirect_base, more.indirect_base);
        add(&mut self.indirect_coat, more.indirect_coat);
        add(&mut self.albedo, more.albedo);
        add(&mut self.normal, more.normal);
        self.hits += more.hits as f64;
    }
}

/// The samples of all pixels.
pub(super) struct SampledImage {
    width: u32,
    sums: Vec<PixelSums>,
    /// Samples per pixel of every tile.
    samples: Vec<u32>,
    /// Mean squared relative error, as far as one was wanted and could be estimated.
    pub estimated_relmse: Option<f64>,
}

/// What the samples are taken of.
pub(super) struct TracedView<'a> {
    pub scene: &'a Scene,
    pub frame: &'a FrameSettings,
    /// Directions through the pixels' corners.
    pub corners: &'a [f32],
    /// Light at the vertices, or nothing.
    pub known: &'a [KnownLight],
}

impl SampledImage {
    /// An image without samples yet.
    pub(super) fn new(width: u32, height: u32) -> Self {
        let pixels = width as usize * height as usize;
        let tiles = width.div_ceil(TILE_PX) as usize * height.div_ceil(TILE_PX) as usize;
        SampledImage {
            width,
            sums: vec![PixelSums::default(); pixels],
            samples: vec![0; tiles],
            estimated_relmse: None,
        }
    }

    fn tile_of(&self, pixel: usize) -> usize {
        let (x, y) = (pixel as u32 % self.width, pixel as u32 / self.width);
        (y / TILE_PX * self.width.div_ceil(TILE_PX) + x / TILE_PX) as usize
    }

    /// Mean of one channel over a pixel's samples.
    pub(super) fn mean(&self, pixel: usize, channel: impl Fn(&PixelSums) -> f64) -> f64 {
        channel(&self.sums[pixel]) / self.samples[self.tile_of(pixel)].max(1) as f64
    }

    /// Means of three channels, as f32.
    pub(super) fn means(&self, channels: impl Fn(&PixelSums) -> RgbSum) -> Vec<[f32; 3]> {
        (0..self.sums.len()).map(|p| std::array::from_fn(|c| self.mean(p, |sums| channels(sums)[c]) as f32)).collect()
    }

    /// All light of a pixel.
    pub(super) fn radiance(&self, pixel: usize, c: usize) -> f64 {
        self.mean(pixel, |sums| sums.direct[c]) + self.mean(pixel, |sums| sums.indirect[c])
    }

    /// Samples per pixel: the mean over the tiles, rounded.
    pub(super) fn samples_per_pixel(&self) -> u32 {
        let sum: u64 = self.samples.iter().map(|&n| u64::from(n)).sum();
        (sum as f64 / self.samples.len() as f64).round() as u32
    }

    fn tile(&self, index: usize, height: u32, samples: u32) -> TileRequest {
        let columns = self.width.div_ceil(TILE_PX);
        let (x0, y0) = (index as u32 % columns * TILE_PX, index as u32 / columns * TILE_PX);
        let (x1, y1) = ((x0 + TILE_PX).min(self.width), (y0 + TILE_PX).min(height));
        TileRequest { x0, x1, y0, y1, first_sample: self.samples[index], samples }
    }

    /// Adds samples to every pixel of some tiles (pairs of tile and number of samples).
    fn add(&mut self, view: &TracedView, wanted: &[(usize, u32)], counters: &mut TileCounters) -> Result<()> {
        let height = view.frame.height;
        let traced: Vec<(TileRequest, Vec<FilmPixel>, TileCounters)> = wanted
            .par_iter()
            .map(|&(index, samples)| {
                let tile = self.tile(index, height, samples);
                let mut film = vec![FilmPixel::default(); ((tile.x1 - tile.x0) * (tile.y1 - tile.y0)) as usize];
                let counters = view.scene.tracer.trace_tile(view.frame, &tile, view.corners, view.known, &mut film)?;
                Ok((tile, film, counters))
            })
            .collect::<Result<_>>()?;
        for ((tile, film, more), &(index, samples)) in traced.into_iter().zip(wanted) {
            let row = (tile.x1 - tile.x0) as usize;
            for (y, pixels) in (tile.y0..tile.y1).zip(film.chunks_exact(row)) {
                let start = y as usize * self.width as usize + tile.x0 as usize;
                self.sums[start..start + row].iter_mut().zip(pixels).for_each(|(sums, pixel)| sums.add(pixel));
            }
            self.samples[index] += samples;
            counters.paths += more.paths;
            counters.rays += more.rays;
            counters.rejected += more.rejected;
        }
        Ok(())
    }

    /// Radiance of all pixels.
    fn picture(&self) -> Vec<RgbSum> {
        (0..self.sums.len()).map(|p| std::array::from_fn(|c| self.radiance(p, c))).collect()
    }

    /// Estimated mean of (error / radiance)^2 of every tile, from the image `before` and as many samples since: half
    /// their difference is as large as the error of their mean. Where it is darker than a hundredth of the picture's mean,
    /// the error is relative to that, whatever the unit of light.
    fn errors(&self, before: &[RgbSum]) -> Vec<f64> {
        let values = (0..self.sums.len()).flat_map(|p| (0..3).map(move |c| (p, c)));
        let mean = values.map(|(p, c)| self.radiance(p, c)).sum::<f64>() / (3 * self.sums.len()) as f64;
        let floor = (DARK * mean).powi(2).max(f64::MIN_POSITIVE);
        let mut sums = vec![(0.0, 0.0); self.samples.len()];
        for (pixel, first) in before.iter().enumerate() {
            let (sum, count) = &mut sums[self.tile_of(pixel)];
            for (c, first) in first.iter().enumerate() {
                // (first + second) / 2 = all
                let all = self.radiance(pixel, c);
                *sum += (first - all).powi(2) / (all * all + floor);
                *count += 1.0;
            }
        }
        sums.into_iter().map(|(sum, count)| sum / count).collect()
    }

    /// Mean over all pixels of their tiles' errors.
    fn mean_error(&self, errors: &[f64]) -> f64 {
        (0..self.sums.len()).map(|p| errors[self.tile_of(p)]).sum::<f64>() / self.sums.len() as f64
    }

    /// Takes samples in rounds until every tile has the number per pixel that `goals` states.
    fn sample(
        &mut self,
        view: &TracedView,
        goals: &[u32],
        counters: &mut TileCounters,
        progress: &dyn Progress,
    ) -> Result<()> {
        let total: u64 = goals.iter().map(|&n| u64::from(n)).sum();
        loop {
            let missing = |(tile, &goal): (usize, &u32)| (tile, (goal - self.samples[tile]).min(SAMPLES_PER_ROUND));
            let wanted: Vec<(usize, u32)> = goals.iter().enumerate().map(missing).filter(|w| w.1 > 0).collect();
            if wanted.is_empty() {
                return Ok(());
            }
            for tiles in wanted.chunks(TILES_PER_REPORT) {
                self.add(view, tiles, counters)?;
                progress.advance(self.samples.iter().map(|&n| n as usize).sum(), total as usize);
                progress.proceed()?;
            }
        }
    }
}

/// Samples every pixel `samples_per_pixel` times; with a target, goes on adaptively (see the head of this file).
pub(super) fn sampled(
    view: &TracedView,
    samples_per_pixel: u32,
    target_relmse: Option<f64>,
    counters: &mut TileCounters,
    progress: &dyn Progress,
) -> Result<SampledImage> {
    let mut film = SampledImage::new(view.frame.width, view.frame.height);
    let mut goals = vec![samples_per_pixel; film.samples.len()];
    film.sample(view, &goals, counters, progress)?;
    let Some(target) = target_relmse else { return Ok(film) };
    let mut errors = vec![f64::INFINITY; goals.len()];
    while film.mean_error(&errors) > target {
        let before = film.picture();
        let open: Vec<usize> =
            (0..goals.len()).filter(|&t| errors[t] > target && goals[t] <= MAX_SAMPLES / 2).collect();
        if open.is_empty() {
            break;
        }
        open.iter().for_each(|&tile| goals[tile] *= 2);
        film.sample(view, &goals, counters, progress)?;
        let found = film.errors(&before);
        open.into_iter().for_each(|tile| errors[tile] = found[tile]);
    }
    film.estimated_relmse = Some(film.mean_error(&errors)).filter(|error| error.is_finite());
    Ok(film)
}
