//! The rays of the pixels, for their intersections with exact discs.

use rayon::prelude::*;

use crate::base::Camera;
use crate::splat::number::Real;

/// The rays of a camera, kept from pass to pass.
#[derive(Clone, Debug, Default)]
pub struct ViewRays<T> {
    camera: Option<Camera>,
    pub directions: Vec<[T; 3]>,
}

impl<T: Real> ViewRays<T> {
    /// Computes the rays of `camera`, unless they are already stored.
    pub fn update(&mut self, camera: &Camera) {
        if self.camera.as_ref() == Some(camera) {
            return;
        }
        let width = camera.width as usize;
        self.directions.resize(width * camera.height as usize, [T::zero(); 3]);
        self.directions.par_chunks_mut(width).enumerate().for_each(|(y, line)| {
            for (x, ray) in line.iter_mut().enumerate() {
                let pixel = glam::DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
                *ray = camera.direction(pixel).to_array().map(T::of);
            }
        });
        self.camera = Some(*camera);
    }
}
