//! Samples of the pixels of a picture: a stated number of each, or as many as a stated error needs.
//!
//! Adaptive: tiles of 16 x 16 pixels. After every round a tile knows two halves of its samples, whose difference tells
//! the error of their mean; tiles above the target double their samples until the picture's mean error is below it. (The
//! least samples for a given mean error would go as the square root of a tile's error; doubling comes near.) A half's
//! error is only an estimate: a tile whose rare bright paths neither half has met stops too early.

use rayon::prelude::*;

use super::scene::Scene;
use crate::base::{Error, Progress, Result};
use crate::ffi::trace::tracer::{FILM_CHANNELS, FrameSettings, Tile, TileCounters};

/// Side of a tile in pixels.
const TILE_PX: u32 = 16;
/// Most samples per pixel of one round: the tracer's f32 sums stay exact enough, and the user can stop between rounds.
const SAMPLES_PER_ROUND: u32 = 32;
/// Where adaptive sampling gives up.
pub(super) const MAX_SAMPLES: u32 = 65_536;

/// Sums over the samples of every pixel, `FILM_CHANNELS` values each.
pub(super) struct Film {
    width: u32,
    sums: Vec<f64>,
    /// Per tile.
    samples: Vec<u32>,
}

/// What the samples are taken of.
pub(super) struct View<'a> {
    pub scene: &'a Scene,
    pub frame: &'a FrameSettings,
    /// Directions through the pixels' corners.
    pub corners: &'a [f32],
    /// Light at the vertices, or nothing.
    pub known: &'a [f32],
}

impl Film {
    /// Without samples.
    pub(super) fn new(width: u32, height: u32) -> Self {
        let pixels = width as usize * height as usize;
        let tiles = width.div_ceil(TILE_PX) as usize * height.div_ceil(TILE_PX) as usize;
        Film { width, sums: vec![0.0; pixels * FILM_CHANNELS], samples: vec![0; tiles] }
    }

    fn pixels(&self) -> usize {
        self.sums.len() / FILM_CHANNELS
    }

    fn tile_of(&self, pixel: usize) -> usize {
        let (x, y) = (pixel as u32 % self.width, pixel as u32 / self.width);
        (y / TILE_PX * self.width.div_ceil(TILE_PX) + x / TILE_PX) as usize
    }

    /// Mean of one channel over a pixel's samples.
    pub(super) fn mean(&self, pixel: usize, channel: usize) -> f64 {
        self.sums[pixel * FILM_CHANNELS + channel] / self.samples[self.tile_of(pixel)].max(1) as f64
    }

    /// All light of a pixel.
    pub(super) fn radiance(&self, pixel: usize, c: usize) -> f64 {
        self.mean(pixel, c) + self.mean(pixel, 3 + c)
    }

    /// Samples per pixel: the mean over the tiles, rounded.
    pub(super) fn samples_per_pixel(&self) -> u32 {
        let sum: u64 = self.samples.iter().map(|&n| u64::from(n)).sum();
        (sum as f64 / self.samples.len() as f64).round() as u32
    }

    fn tile(&self, index: usize, height: u32, samples: u32) -> Tile {
        let columns = self.width.div_ceil(TILE_PX);
        let (x0, y0) = (index as u32 % columns * TILE_PX, index as u32 / columns * TILE_PX);
        let (x1, y1) = ((x0 + TILE_PX).min(self.width), (y0 + TILE_PX).min(height));
        Tile { x0, x1, y0, y1, first_sample: self.samples[index], samples }
    }

    /// `samples` more of every pixel of some tiles (pairs of tile and number).
    fn add(&mut self, view: &View, wanted: &[(usize, u32)], counters: &mut TileCounters) -> Result<()> {
        let height = view.frame.height;
        let traced: Vec<(Tile, Vec<f32>, TileCounters)> = wanted
            .par_iter()
            .map(|&(index, samples)| {
                let tile = self.tile(index, height, samples);
                let mut sums = vec![0.0; ((tile.x1 - tile.x0) * (tile.y1 - tile.y0)) as usize * FILM_CHANNELS];
                let counters = view.scene.tracer.trace_tile(view.frame, &tile, view.corners, view.known, &mut sums)?;
                Ok((tile, sums, counters))
            })
            .collect::<Result<_>>()?;
        for ((tile, sums, more), &(index, samples)) in traced.into_iter().zip(wanted) {
            let row = (tile.x1 - tile.x0) as usize * FILM_CHANNELS;
            for (y, values) in (tile.y0..tile.y1).zip(sums.chunks_exact(row)) {
                let start = (y as usize * self.width as usize + tile.x0 as usize) * FILM_CHANNELS;
                self.sums[start..start + row].iter_mut().zip(values).for_each(|(sum, &v)| *sum += v as f64);
            }
            self.samples[index] += samples;
            counters.paths += more.paths;
            counters.rays += more.rays;
            counters.rejected += more.rejected;
        }
        Ok(())
    }

    /// Radiance of all pixels.
    fn picture(&self) -> Vec<[f64; 3]> {
        (0..self.pixels()).map(|p| std::array::from_fn(|c| self.radiance(p, c))).collect()
    }

    /// Estimated mean of (error / radiance)^2 of every tile, from the picture `before` and the samples since, which are as
    /// many: their difference, halved, is as large as the error of their mean.
    fn errors(&self, before: &[[f64; 3]]) -> Vec<f64> {
        let mut sums = vec![(0.0, 0.0); self.samples.len()];
        for (pixel, first) in before.iter().enumerate() {
            let (sum, count) = &mut sums[self.tile_of(pixel)];
            for (c, first) in first.iter().enumerate() {
                // (first + second) / 2 = all
                let all = self.radiance(pixel, c);
                *sum += (first - all).powi(2) / (all * all + 1e-4);
                *count += 1.0;
            }
        }
        sums.into_iter().map(|(sum, count)| sum / count).collect()
    }

    /// The whole picture's mean of what every tile has.
    fn mean_error(&self, errors: &[f64]) -> f64 {
        (0..self.pixels()).map(|p| errors[self.tile_of(p)]).sum::<f64>() / self.pixels() as f64
    }

    /// Brings the tiles to numbers of samples, in rounds.
    fn sample(
        &mut self,
        view: &View,
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
            self.add(view, &wanted, counters)?;
            progress.advance(self.samples.iter().map(|&n| n as usize).sum(), total as usize);
            if progress.cancelled() {
                return Err(Error::interrupted());
            }
        }
    }
}

/// Samples every pixel `samples_per_pixel` times; with a target, goes on as the header says.
pub(super) fn sampled(
    view: &View,
    samples_per_pixel: u32,
    target_relmse: Option<f64>,
    counters: &mut TileCounters,
    progress: &dyn Progress,
) -> Result<Film> {
    let mut film = Film::new(view.frame.width, view.frame.height);
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
    Ok(film)
}
