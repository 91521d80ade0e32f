//! One rendering: rays through pixels, tiles over threads, film to images.
//!
//! Tiles are traced in parallel and put together by index; every sample is a function of (seed, frame, pixel, sample)
//! alone, so the image does not depend on the number of threads.

use glam::{DAffine3, DMat3, DVec2, DVec3};
use rayon::prelude::*;

use super::denoise::{Guides, denoised_indirect};
use super::scene::Scene;
use super::settings::{Denoise, Light, RenderSettings, Shading, Transport};
use super::vertex_light::vertex_light;
use crate::base::random::{CounterRng, Stage};
use crate::base::{Camera, Error, Image, NoProgress, Progress, Result};
use crate::ffi::tracer::{FILM_CHANNELS, FrameSettings, NO_FACE, Tile, TileCounters};

/// Side of a tile in pixels.
const TILE_PX: u32 = 16;
/// Most samples per pixel of one round: the film's f32 sums stay exact enough, and the user can stop between rounds.
const SAMPLES_PER_ROUND: u32 = 32;
/// Larger images would need more than 4 GiB for the film.
const MAX_PIXELS: u64 = 1 << 24;
/// Where `target_relmse` gives up.
const MAX_SAMPLES: u32 = 65_536;

/// A rendered frame.
#[derive(Clone, Debug)]
pub struct Frame {
    /// Linear RGB radiance, W / (sr mm^2), neither scaled nor clamped.
    pub radiance: Image<f32>,
    /// z-depth in mm through the pixel centres, 0 where nothing is hit.
    pub depth_mm: Image<f32>,
    /// What was done.
    pub statistics: Statistics,
}

/// Work done for a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Statistics {
    /// Camera samples.
    pub paths: u64,
    /// Rays of all kinds.
    pub rays: u64,
    /// Samples per pixel.
    pub samples_per_pixel: u32,
    /// Samples that were not finite or negative and were left out: a flaw if ever above 0.
    pub rejected_samples: u64,
}

/// Means over the samples of every pixel, `FILM_CHANNELS` values each.
struct Film {
    sums: Vec<f64>,
    samples: u32,
}

impl Film {
    fn mean(&self, pixel: usize, channel: usize) -> f64 {
        self.sums[pixel * FILM_CHANNELS + channel] / self.samples.max(1) as f64
    }

    fn radiance(&self, pixel: usize, c: usize) -> f64 {
        self.mean(pixel, c) + self.mean(pixel, 3 + c)
    }
}

/// [`render_watched`] with nobody watching.
pub fn render(
    scene: &Scene,
    camera: &Camera,
    world_from_camera: &DAffine3,
    light: &Light,
    settings: &RenderSettings,
) -> Result<Frame> {
    render_watched(scene, camera, world_from_camera, light, settings, &NoProgress)
}

/// Path-traces `scene` through `camera` at `world_from_camera`.
///
/// Errors: an impossible camera or pose, no samples, a light that is negative or not finite; stopped by the user.
pub fn render_watched(
    scene: &Scene,
    camera: &Camera,
    world_from_camera: &DAffine3,
    light: &Light,
    settings: &RenderSettings,
    progress: &dyn Progress,
) -> Result<Frame> {
    check(camera, world_from_camera, light, settings)?;
    let frame = frame_settings(scene, camera, world_from_camera, light, settings);
    let corners = corner_directions(camera);
    let mut statistics = Statistics::default();
    let (depth_mm, seen) = depth(scene, &frame, camera)?;
    let known = match settings.transport {
        Transport::Paths => Vec::new(),
        Transport::Vertices { rays_per_face } => {
            scene.check_vertex_light()?;
            let light = vertex_light(scene, &frame, &seen, rays_per_face)?;
            statistics.rays += light.rays;
            light.known
        }
    };
    let mut film = Film { sums: vec![0.0; pixel_count(camera) * FILM_CHANNELS], samples: 0 };
    let mut wanted = settings.samples_per_pixel;
    loop {
        let before = settings.target_relmse.map(|_| Film { sums: film.sums.clone(), samples: film.samples });
        while film.samples < wanted {
            let count = (wanted - film.samples).min(SAMPLES_PER_ROUND);
            add_samples(scene, &frame, [&corners, &known], count, &mut film, &mut statistics)?;
            progress.advance(film.samples as usize, wanted as usize);
            if progress.cancelled() {
                return Err(Error::interrupted());
            }
        }
        let (Some(target), Some(before)) = (settings.target_relmse, before) else { break };
        let good = before.samples > 0 && relative_error(&before, &film) <= target;
        if good || film.samples >= MAX_SAMPLES {
            break;
        }
        wanted = (wanted * 2).min(MAX_SAMPLES);
    }
    statistics.samples_per_pixel = film.samples;
    let radiance = match settings.denoise {
        Denoise::Off => develop(&film, camera),
        Denoise::On => develop_denoised(&film, camera, &depth_mm),
    };
    Ok(Frame { radiance, depth_mm, statistics })
}

fn check(camera: &Camera, pose: &DAffine3, light: &Light, settings: &RenderSettings) -> Result<()> {
    camera.validate()?;
    if camera.width as u64 * camera.height as u64 > MAX_PIXELS {
        return Err(Error::input(format!("an image of {}x{} pixels is too large", camera.width, camera.height)));
    }
    let rotation = pose.matrix3;
    let off = (rotation * rotation.transpose() - DMat3::IDENTITY).to_cols_array();
    if !pose.is_finite() || off.iter().any(|v| v.abs() > 1e-4) || rotation.determinant() < 0.0 {
        return Err(Error::input("world_from_camera is not a rigid motion (rotation and translation)"));
    }
    if light.intensity.iter().any(|v| !v.is_finite() || *v < 0.0) || light.position_mm.is_some_and(|p| !p.is_finite()) {
        return Err(Error::input("the light needs finite, non-negative intensities and a finite position"));
    }
    if !(0.0..=1e3).contains(&light.emission_exponent) {
        return Err(Error::input("the light's emission exponent must lie in [0, 1000]"));
    }
    if settings.background.iter().any(|v| !v.is_finite() || *v < 0.0) {
        return Err(Error::input("the background must be finite and not negative"));
    }
    if matches!(settings.transport, Transport::Vertices { rays_per_face } if !(1..=4096).contains(&rays_per_face)) {
        return Err(Error::input("rays per face must lie in 1 to 4096"));
    }
    if settings.samples_per_pixel == 0 || settings.samples_per_pixel > MAX_SAMPLES {
        return Err(Error::input(format!("samples per pixel must lie in 1 to {MAX_SAMPLES}")));
    }
    Ok(())
}

pub(super) fn frame_settings(
    scene: &Scene,
    camera: &Camera,
    pose: &DAffine3,
    light: &Light,
    settings: &RenderSettings,
) -> FrameSettings {
    let origin = pose.translation - scene.shift;
    let lamp = light.position_mm.map_or(origin, |p| p - scene.shift);
    let single = |v: DVec3| v.to_array().map(|v| v as f32);
    FrameSettings {
        width: camera.width,
        height: camera.height,
        origin: single(origin),
        rotation: pose.matrix3.transpose().to_cols_array().map(|v| v as f32),
        light: single(lamp),
        light_at_camera: light.position_mm.is_none(),
        intensity: light.intensity.map(|v| v as f32),
        emission_exponent: light.emission_exponent as f32,
        background: settings.background.map(|v| v as f32),
        max_scatterings: settings.max_scatterings,
        smooth: settings.shading == Shading::Smooth,
        pixel_angle: (1.0 / camera.fl_x) as f32,
        key: CounterRng::new(settings.seed, Stage::Render, &[settings.frame]).next_u32(),
        pattern_key: CounterRng::new(settings.seed, Stage::Render, &[u64::MAX, 1]).next_u32(),
    }
}

fn pixel_count(camera: &Camera) -> usize {
    camera.width as usize * camera.height as usize
}

/// Directions (camera axes) through the corners of the pixels; inside a pixel the tracer interpolates, which is exact
/// for a pinhole.
fn corner_directions(camera: &Camera) -> Vec<f32> {
    (0..=camera.height)
        .into_par_iter()
        .flat_map_iter(|y| {
            (0..=camera.width).flat_map(move |x| camera.direction(DVec2::new(x as f64, y as f64)).to_array())
        })
        .map(|v| v as f32)
        .collect()
}

fn tiles(width: u32, height: u32) -> Vec<(u32, u32)> {
    (0..height)
        .step_by(TILE_PX as usize)
        .flat_map(|y| (0..width).step_by(TILE_PX as usize).map(move |x| (x, y)))
        .collect()
}

fn add_samples(
    scene: &Scene,
    frame: &FrameSettings,
    [corners, known]: [&[f32]; 2],
    samples: u32,
    film: &mut Film,
    statistics: &mut Statistics,
) -> Result<()> {
    let traced: Vec<(Tile, Vec<f32>, TileCounters)> = tiles(frame.width, frame.height)
        .into_par_iter()
        .map(|(x0, y0)| {
            let (x1, y1) = ((x0 + TILE_PX).min(frame.width), (y0 + TILE_PX).min(frame.height));
            let tile = Tile { x0, x1, y0, y1, first_sample: film.samples, samples };
            let mut sums = vec![0.0; ((x1 - x0) * (y1 - y0)) as usize * FILM_CHANNELS];
            let counters = scene.tracer.trace_tile(frame, &tile, corners, known, &mut sums)?;
            Ok((tile, sums, counters))
        })
        .collect::<Result<_>>()?;
    for (tile, sums, counters) in traced {
        let row = (tile.x1 - tile.x0) as usize * FILM_CHANNELS;
        for (y, values) in (tile.y0..tile.y1).zip(sums.chunks_exact(row)) {
            let start = (y as usize * frame.width as usize + tile.x0 as usize) * FILM_CHANNELS;
            film.sums[start..start + row].iter_mut().zip(values).for_each(|(sum, &v)| *sum += v as f64);
        }
        statistics.paths += counters.paths;
        statistics.rays += counters.rays;
        statistics.rejected_samples += counters.rejected;
    }
    film.samples += samples;
    Ok(())
}

/// Estimated mean of (error / radiance)^2 of `after`, from its first part `before` and the samples since: their
/// difference, halved, is as large as the error of their mean where both hold as many samples.
fn relative_error(before: &Film, after: &Film) -> f64 {
    let pixels = after.sums.len() / FILM_CHANNELS;
    let since = (after.samples - before.samples) as f64;
    let mut sum = 0.0;
    for pixel in 0..pixels {
        for c in 0..3 {
            let (first, all) = (before.radiance(pixel, c), after.radiance(pixel, c));
            let second = (all * after.samples as f64 - first * before.samples as f64) / since;
            sum += (0.5 * (first - second)).powi(2) / (all * all + 1e-4);
        }
    }
    sum / (pixels * 3) as f64
}

fn develop(film: &Film, camera: &Camera) -> Image<f32> {
    let mut image = Image::filled(camera.width as usize, camera.height as usize, 3, 0.0);
    for (pixel, values) in image.data.chunks_exact_mut(3).enumerate() {
        for c in 0..3 {
            values[c] = film.radiance(pixel, c) as f32;
        }
    }
    image
}

fn develop_denoised(film: &Film, camera: &Camera, depth_mm: &Image<f32>) -> Image<f32> {
    let (width, height) = (camera.width as usize, camera.height as usize);
    let planes = |first: usize| -> Vec<[f32; 3]> {
        (0..width * height).map(|p| std::array::from_fn(|c| film.mean(p, first + c) as f32)).collect()
    };
    let directions: Vec<DVec3> = (0..width * height)
        .map(|p| camera.direction(DVec2::new((p % width) as f64 + 0.5, (p / width) as f64 + 0.5)))
        .collect();
    let guides = Guides::new(width, height, &directions, &depth_mm.data, &planes(15));
    let base = denoised_indirect(&guides, planes(6));
    let coat = denoised_indirect(&guides, planes(9));
    let albedo = planes(12);
    let mut image = Image::filled(width, height, 3, 0.0);
    for (p, values) in image.data.chunks_exact_mut(3).enumerate() {
        for c in 0..3 {
            let hit = film.mean(p, 18).max(1e-6) as f32;
            values[c] = film.mean(p, c) as f32 + base[p][c] * albedo[p][c] / hit + coat[p][c];
        }
    }
    image
}

/// z-depth and faces (or [`NO_FACE`]) at the pixel centres.
fn depth(scene: &Scene, frame: &FrameSettings, camera: &Camera) -> Result<(Image<f32>, Vec<u32>)> {
    let width = camera.width as usize;
    let rows: Vec<(Vec<f32>, Vec<u32>)> = (0..camera.height)
        .into_par_iter()
        .map(|y| {
            let directions: Vec<DVec3> =
                (0..width).map(|x| camera.direction(DVec2::new(x as f64 + 0.5, y as f64 + 0.5)).normalize()).collect();
            let flat: Vec<f32> = directions.iter().flat_map(|d| d.to_array()).map(|v| v as f32).collect();
            let (mut distances, mut faces) = (vec![0.0; width], vec![NO_FACE; width]);
            scene.tracer.distances(frame, &flat, &mut distances, &mut faces)?;
            let z = |(&t, d): (&f32, &DVec3)| if t.is_finite() { (t as f64 * d.z) as f32 } else { 0.0 };
            Ok((distances.iter().zip(&directions).map(z).collect(), faces))
        })
        .collect::<Result<_>>()?;
    let data = rows.iter().flat_map(|r| r.0.iter().copied()).collect();
    let faces = rows.iter().flat_map(|r| r.1.iter().copied()).collect();
    Ok((Image { width, height: camera.height as usize, channels: 1, data }, faces))
}
