//! What each pixel's central ray hits: face, place on it, depth and colour, without any light transport.

use glam::{DAffine3, DVec2, DVec3};
use rayon::prelude::*;

use super::frame::frame_settings;
use super::scene::Scene;
use super::settings::{Light, RenderSettings};
use crate::base::{Camera, Image, Result};
use crate::ffi::trace::tracer::{NO_FACE, ProbedPoint};

/// The point of the wall that one pixel's central ray hits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    /// Face of the mesh.
    pub face: u32,
    /// Barycentric weights of the face's three corners.
    pub weights: [f64; 3],
    /// Albedo of the base there, vessels and all.
    pub albedo: [f32; 3],
}

/// Casts the central ray of every pixel: one entry per pixel, row-major, `None` where nothing is hit.
///
/// Errors: an impossible camera.
pub fn probe(scene: &Scene, camera: &Camera, world_from_camera: &DAffine3) -> Result<Vec<Option<SurfacePoint>>> {
    camera.validate()?;
    let light = Light::at_camera([0.0; 3]);
    let frame = frame_settings(scene, camera, world_from_camera, &light, &RenderSettings::default());
    let width = camera.width as usize;
    let rows: Vec<Vec<Option<SurfacePoint>>> = (0..camera.height)
        .into_par_iter()
        .map(|y| {
            let centre = |x: usize| camera.direction(DVec2::new(x as f64 + 0.5, y as f64 + 0.5)).normalize();
            let directions: Vec<f32> = (0..width).flat_map(|x| centre(x).to_array()).map(|v| v as f32).collect();
            let point = |p: ProbedPoint| {
                let (u, v) = (p.place.u as f64, p.place.v as f64);
                let point = SurfacePoint { face: p.place.face, weights: [1.0 - u - v, u, v], albedo: p.albedo };
                (p.place.face != NO_FACE).then_some(point)
            };
            Ok(scene.tracer.probe(&frame, &directions)?.into_iter().map(point).collect())
        })
        .collect::<Result<_>>()?;
    Ok(rows.concat())
}

/// Rays of [`WallInView`], at most: an even share of the pixels says as much as all of them.
const VIEW_RAYS: f64 = 65_536.0;

/// How much of the wall a camera sees, by rays through even parts of its picture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct WallInView {
    /// Rays that meet the wall.
    pub hit: usize,
    /// Those of them that meet it from behind: its normals, as the faces are wound, point away from the camera.
    pub from_behind: usize,
}

impl WallInView {
    /// Looks through `camera` at `world_from_camera`.
    ///
    /// Errors: an impossible camera.
    pub fn new(scene: &Scene, camera: &Camera, world_from_camera: &DAffine3) -> Result<Self> {
        camera.validate()?;
        let pixels = f64::from(camera.width) * f64::from(camera.height);
        let camera = camera.scaled((VIEW_RAYS / pixels).sqrt().min(1.0));
        let camera = Camera { width: camera.width.max(1), height: camera.height.max(1), ..camera };
        let points = probe(scene, &camera, world_from_camera)?;
        let mut view = WallInView::default();
        for (pixel, point) in points.iter().enumerate().filter_map(|(pixel, point)| Some((pixel, point.as_ref()?))) {
            let (x, y) = (pixel % camera.width as usize, pixel / camera.width as usize);
            let direction = camera.direction(DVec2::new(x as f64 + 0.5, y as f64 + 0.5));
            let normal = scene.tissue.face_normal(scene.topology.faces[point.face as usize], scene.progress);
            view.hit += 1;
            view.from_behind +=
                usize::from(world_from_camera.transform_vector3(direction).dot(normal.as_dvec3()) > 0.0);
        }
        Ok(view)
    }
}

impl SurfacePoint {
    /// The point on a mesh of the probed one's faces, whatever its vertices.
    pub fn on(&self, vertices: &[DVec3], faces: &[[u32; 3]]) -> DVec3 {
        let corners = faces[self.face as usize].map(|v| vertices[v as usize]);
        corners[0] * self.weights[0] + corners[1] * self.weights[1] + corners[2] * self.weights[2]
    }
}

/// An image of `channels` values per pixel, zero where nothing is hit.
pub fn image_of(
    points: &[Option<SurfacePoint>],
    width: usize,
    channels: usize,
    mut values: impl FnMut(&SurfacePoint, &mut [f32]),
) -> Image<f32> {
    let mut image = Image::filled(width, points.len() / width.max(1), channels, 0.0f32);
    for (pixel, point) in image.data.chunks_exact_mut(channels).zip(points) {
        if let Some(point) = point {
            values(point, pixel);
        }
    }
    image
}
