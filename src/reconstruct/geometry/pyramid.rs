//! One resolution of a frame: a level of its image pyramid.

use crate::base::Image;
use crate::splat::View;

/// An image at one resolution, with its camera, pose and pixel weights.
pub struct PyramidLevel {
    /// Its pose and camera.
    pub view: View,
    /// The image.
    pub image: Image<f32>,
    /// How much each pixel counts; empty where all count alike.
    pub weights: Vec<f32>,
}

impl PyramidLevel {
    /// How much pixel `index` (row-major) counts.
    pub fn weight(&self, index: usize) -> f32 {
        self.weights.get(index).copied().unwrap_or(1.0)
    }

    /// The level of half the width and height. A pixel counts if all four of its parts do.
    pub fn halved(&self) -> PyramidLevel {
        let image = self.image.halved();
        let mut camera = self.view.camera.scaled(0.5);
        (camera.width, camera.height) = (image.width as u32, image.height as u32);
        PyramidLevel { view: View { camera, ..self.view }, weights: self.halved_weights(), image }
    }

    /// Whether it is no wider than `width` pixels, or cannot be halved.
    pub fn is_within(&self, width: u32) -> bool {
        self.image.width <= width as usize || self.image.height <= 1
    }

    /// Halved until it `suits`.
    pub fn halved_until(mut self, suits: impl Fn(&PyramidLevel) -> bool) -> PyramidLevel {
        while !suits(&self) {
            self = self.halved();
        }
        self
    }

    fn halved_weights(&self) -> Vec<f32> {
        if self.weights.is_empty() {
            return Vec::new();
        }
        let (width, height) = (self.image.width, self.image.height);
        let weights = Image { width, height, channels: 1, data: self.weights.clone() };
        weights.halved().data.into_iter().map(f32::floor).collect()
    }
}
