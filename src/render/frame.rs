//! One rendering: rays through pixels, tiles over threads, film to images.
//!
//! Tiles are traced in parallel and put together by index; every sample is a function of (seed, frame, pixel, sample)
//! alone, so the image does not depend on the number of threads.

use glam::{DAffine3, DVec2, DVec3};
use rayon::prelude::*;

use super::denoise::{Guides, denoised_indirect};
use super::sampling::{MAX_SAMPLES, SampledImage, TracedView, sampled};
use super::scene::Scene;
use super::settings::{
    Denoise, EMISSION_EXPONENT, Light, RAYS_PER_FACE, RenderSettings, Shading, Transport, check_size,
};
use super::vertex_light::vertex_light;
use crate::base::pose::rotation_error;
use crate::base::random::{CounterRng, Stage};
use crate::base::range::SAMPLES_PER_PIXEL;
use crate::base::{Camera, Error, Estimate, Image, NoProgress, Progress, Result};
use crate::ffi::trace::tracer::{FrameSettings, NO_FACE, TileCounters};

/// The model behind [`estimate`]: bytes of the film and its images per pixel, core seconds per camera sample (with all
/// its bounces, or with light at vertices), bytes and core seconds per ray of a face.
const PIXEL_BYTES: f64 = 260.0;
const PATH_SAMPLE_S: f64 = 3e-6;
const KNOWN_SAMPLE_S: f64 = 1e-6;
const FACE_RAY_BYTES: f64 = 32.0;
const FACE_RAY_S: f64 = 1e-6;
/// Largest error of a view's rotation, as single precision rounds it.
const ROTATION_SLACK: f64 = 1e-4;

/// A rendered frame.
#[derive(Clone, Debug)]
pub struct RenderedFrame {
    /// Linear RGB radiance, W / (sr mm^2), neither scaled nor clamped.
    pub radiance: Image<f32>,
    /// z-depth in mm through the pixel centres; 0 where nothing is hit, and 90 degrees or more off the axis, for what a
    /// lens sees beside or behind itself.
    pub depth_mm: Image<f32>,
    /// What was done.
    pub statistics: Statistics,
}

/// Work done for a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Statistics {
    /// Camera samples.
    pub paths: u64,
    /// Rays of all kinds.
    pub rays: u64,
    /// Samples per pixel; the mean over the image's tiles where they differ.
    pub samples_per_pixel: u32,
    /// Samples that were not finite or negative and were left out: a flaw if ever above 0.
    pub rejected_samples: u64,
    /// Estimated mean squared relative error; `None` where no target was set, or none of its samples could be halved.
    pub estimated_relmse: Option<f64>,
}

/// [`render_watched`] without reports of progress.
pub fn render(
    scene: &Scene,
    camera: &Camera,
    world_from_camera: &DAffine3,
    light: &Light,
    settings: &RenderSettings,
) -> Result<RenderedFrame> {
    render_watched(scene, camera, world_from_camera, light, settings, &NoProgress)
}

/// What [`render_watched`] would cost. With a target, the samples are those that noise of the radiance's own size would
/// need.
pub fn estimate(scene: &Scene, camera: &Camera, settings: &RenderSettings) -> Estimate {
    let pixels = f64::from(camera.width) * f64::from(camera.height);
    let least = f64::from(settings.samples_per_pixel);
    let samples = settings.target_relmse.map_or(least, |target| (1.0 / target).clamp(least, f64::from(MAX_SAMPLES)));
    let (sample_s, rays_per_face) = match settings.transport {
        Transport::Paths => (PATH_SAMPLE_S, 0),
        Transport::Vertices { rays_per_face } => (KNOWN_SAMPLE_S, rays_per_face),
        Transport::Gather { rays_per_face } => (2.0 * KNOWN_SAMPLE_S, rays_per_face),
    };
    let rays = scene.triangles() as f64 * f64::from(rays_per_face);
    Estimate {
        memory_bytes: pixels * PIXEL_BYTES + rays * FACE_RAY_BYTES,
        seconds: (pixels * samples * sample_s + rays * FACE_RAY_S) / rayon::current_num_threads() as f64,
        resumable: false,
    }
}

/// Path-traces `scene` through `camera` at `world_from_camera`.
///
/// Errors: an impossible camera or pose, no samples, a light that is negative or not finite; work that `progress` does
/// not accept; light at vertices that does not settle between walls so bright; stopped by the user.
pub fn render_watched(
    scene: &Scene,
    camera: &Camera,
    world_from_camera: &DAffine3,
    light: &Light,
    settings: &RenderSettings,
    progress: &dyn Progress,
) -> Result<RenderedFrame> {
    check(camera, world_from_camera, light, settings)?;
    progress.accepts(&estimate(scene, camera, settings))?;
    progress.advance(0, 1);
    let frame = frame_settings(scene, camera, world_from_camera, light, settings);
    let corners = corner_directions(camera);
    let mut statistics = Statistics::default();
    let (mut depth_mm, visible) = depth(scene, &frame, camera)?;
    let known = match settings.transport {
        Transport::Paths => Vec::new(),
        Transport::Vertices { rays_per_face } | Transport::Gather { rays_per_face } => {
            scene.check_vertex_light()?;
            let light = vertex_light(scene, &frame, &visible, rays_per_face)?;
            statistics.rays += light.rays;
            light.known
        }
    };
    let view = TracedView { scene, frame: &frame, corners: &corners, known: &known };
    let mut counters = TileCounters::default();
    let film = sampled(&view, settings.samples_per_pixel, settings.target_relmse, &mut counters, progress)?;
    statistics.paths += counters.paths;
    statistics.rays += counters.rays;
    statistics.rejected_samples += counters.rejected;
    statistics.samples_per_pixel = film.samples_per_pixel();
    statistics.estimated_relmse = film.estimated_relmse;
    let radiance = match settings.denoise {
        Denoise::Off => develop(&film, camera),
        Denoise::On => develop_denoised(&film, camera, &depth_mm),
    };
    // What a lens sees beside or behind itself has no z-depth.
    depth_mm.data.iter_mut().for_each(|z| *z = z.max(0.0));
    Ok(RenderedFrame { radiance, depth_mm, statistics })
}

fn check(camera: &Camera, pose: &DAffine3, light: &Light, settings: &RenderSettings) -> Result<()> {
    camera.validate()?;
    check_size(camera.width, camera.height)?;
    if !pose.is_finite() || rotation_error(pose) > ROTATION_SLACK {
        return Err(Error::input("world_from_camera is not a rigid motion (rotation and translation)"));
    }
    if light.intensity.iter().any(|v| !v.is_finite() || *v < 0.0) || light.position_mm.is_some_and(|p| !p.is_finite()) {
        return Err(Error::input("the light needs finite, non-negative intensities and a finite position"));
    }
    EMISSION_EXPONENT.check(light.emission_exponent).map_err(|e| e.element("the light's emission exponent"))?;
    if settings.background.iter().any(|v| !v.is_finite() || *v < 0.0) {
        return Err(Error::input("the background must be finite and not negative"));
    }
    if let Transport::Vertices { rays_per_face } | Transport::Gather { rays_per_face } = settings.transport {
        RAYS_PER_FACE.check(rays_per_face.into()).map_err(|e| e.element("rays per face"))?;
    }
    SAMPLES_PER_PIXEL.check(settings.samples_per_pixel.into()).map_err(|e| e.element("samples per pixel"))?;
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
        gathers: matches!(settings.transport, Transport::Gather { .. }),
        pixel_angle: (1.0 / camera.fl_x) as f32,
        key: CounterRng::new(settings.seed, Stage::Render, &[settings.frame]).next_u32(),
        pattern_key: CounterRng::new(settings.seed, Stage::Render, &[u64::MAX, 1]).next_u32(),
    }
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

fn develop(film: &SampledImage, camera: &Camera) -> Image<f32> {
    let mut image = Image::filled(camera.width as usize, camera.height as usize, 3, 0.0);
    for (pixel, values) in image.data.chunks_exact_mut(3).enumerate() {
        for c in 0..3 {
            values[c] = film.radiance(pixel, c) as f32;
        }
    }
    image
}

fn develop_denoised(film: &SampledImage, camera: &Camera, depth_mm: &Image<f32>) -> Image<f32> {
    let (width, height) = (camera.width as usize, camera.height as usize);
    let directions: Vec<DVec3> = (0..width * height)
        .map(|p| camera.direction(DVec2::new((p % width) as f64 + 0.5, (p / width) as f64 + 0.5)))
        .collect();
    let guides = Guides::new(width, height, &directions, &depth_mm.data, &film.means(|s| s.normal));
    let base = denoised_indirect(&guides, film.means(|s| s.indirect_base));
    let coat = denoised_indirect(&guides, film.means(|s| s.indirect_coat));
    let albedo = film.means(|s| s.albedo);
    let mut image = Image::filled(width, height, 3, 0.0);
    for (p, values) in image.data.chunks_exact_mut(3).enumerate() {
        for c in 0..3 {
            let hit = film.mean(p, |s| s.hits).max(1e-6) as f32;
            values[c] = film.mean(p, |s| s.direct[c]) as f32 + base[p][c] * albedo[p][c] / hit + coat[p][c];
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
