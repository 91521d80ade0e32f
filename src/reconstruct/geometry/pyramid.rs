//! One resolution of a frame.

use crate::base::Image;
use crate::splat::View;

/// A picture, how it was taken, and what of it counts.
pub struct Level {
    /// Where it was taken from, and with which camera.
    pub view: View,
    /// The picture.
    pub image: Image<f32>,
    /// How much each pixel counts; empty where all count alike.
    pub weights: Vec<f32>,
}

impl Level {
    /// How much pixel `index` (row-major) counts.
    pub fn weight(&self, index: usize) -> f32 {
        self.weights.get(index).copied().unwrap_or(1.0)
    }

    /// Half as wide and high. A pixel counts whose four parts all do.
    pub fn halved(&self) -> Level {
        let image = self.image.halved();
        let mut camera = self.view.camera.scaled(0.5);
        (camera.width, camera.height) = (image.width as u32, image.height as u32);
        Level { view: View { camera, ..self.view }, weights: self.halved_weights(), image }
    }

    fn halved_weights(&self) -> Vec<f32> {
        if self.weights.is_empty() {
            return Vec::new();
        }
        let (width, height) = (self.image.width, self.image.height);
        let parts = Image { width, height, channels: 1, data: self.weights.clone() };
        parts.halved().data.into_iter().map(f32::floor).collect()
    }
}
