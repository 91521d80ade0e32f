//! One view, ready to project Gaussians.

use crate::base::{Error, Result};
use crate::splat::number::{Each, Real, dot};
use crate::splat::types::table::LOG2_255;
use crate::splat::types::{Filter, Footprint, Settings, Skips, View};

use super::exact_camera::ExactCamera;
use super::lens::Lens;

/// A camera with its pose and the settings that projection depends on.
pub struct Projector<T> {
    /// Rows of the rotation into camera axes.
    pub rotation: [[T; 3]; 3],
    /// Position of the camera in mm.
    pub eye: [T; 3],
    pub lens: Lens<T>,
    /// Width and height of the image in pixels.
    pub size: [T; 2],
    /// Smallest z-depth of a centre in mm.
    pub near: T,
    /// Variance of the screen-space filter in px^2.
    pub dilation: T,
    pub filter: Filter,
    pub footprint: Footprint,
    pub skips: Skips,
    pub exact: ExactCamera,
}

impl<T: Real> Projector<T> {
    /// Errors: an invalid camera or invalid settings, an image larger than 16384 pixels.
    pub fn new(view: &View, settings: &Settings) -> Result<Self> {
        let camera = &view.camera;
        camera.validate()?;
        if camera.width > 16384 || camera.height > 16384 {
            return Err(Error::input(format!(
                "image of {}x{} pixels is larger than 16384",
                camera.width, camera.height
            )));
        }
        let transform = view.camera_from_world;
        if !transform.is_finite() {
            return Err(Error::input("camera pose is not finite"));
        }
        let scalars = [settings.near_mm, settings.dilation_px2];
        let colors = settings.gain.iter().chain(&settings.background);
        let finite = scalars.iter().chain(colors).all(|v| v.is_finite());
        if !finite || settings.near_mm <= 0.0 || settings.dilation_px2 < 0.0 {
            return Err(Error::input("near must be positive, dilation not negative, gain and background finite"));
        }
        let exact = ExactCamera::new(camera, &transform);
        Ok(Projector {
            rotation: exact.rotation.each(|row| row.each(T::of)),
            eye: exact.eye.each(T::of),
            lens: Lens::new(camera),
            size: [T::of(camera.width as f64), T::of(camera.height as f64)],
            near: T::of(settings.near_mm),
            dilation: T::of(settings.dilation_px2),
            filter: settings.filter,
            footprint: settings.footprint,
            skips: Skips::ALL,
            exact,
        })
    }

    /// The same with the shortcuts in `skips`.
    pub fn with_skips(self, skips: Skips) -> Self {
        Projector { skips, ..self }
    }

    /// How far below its peak, in powers of 2, a splat of that opacity ends.
    #[inline(always)]
    pub fn extent(&self, log2_opacity: T) -> T {
        let by_opacity = if self.skips.any(Skips::EXTENTS) { log2_opacity } else { T::zero() };
        by_opacity + T::of(LOG2_255)
    }

    /// Sort key of a splat: z-depth of the centre, computed in double for every number type and rounded once, so that
    /// the order depends on the scene and not on rounding. Positive floats sort like their bits.
    #[inline(always)]
    pub fn key(&self, position: [T; 3]) -> u32 {
        (self.exact.in_camera_axes(position.each(T::to_f64))[2] as f32).to_bits()
    }

    /// A vector in camera axes.
    #[inline(always)]
    pub fn turn(&self, v: [T; 3]) -> [T; 3] {
        self.rotation.each(|row| dot(row, v))
    }

    /// A vector in world axes.
    #[inline(always)]
    pub fn turn_back(&self, v: [T; 3]) -> [T; 3] {
        let r = &self.rotation;
        [0, 1, 2].each(|k| r[0][k] * v[0] + r[1][k] * v[1] + r[2][k] * v[2])
    }
}
