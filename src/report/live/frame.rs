//! The frame of a line as a picture, made when a page asks for it.

use std::sync::Arc;

use crate::base::Image;
use crate::formats::jpeg;

/// Quality of pictures, as of the report's whole films.
const QUALITY: u8 = 88;
/// Colour over what does not count as wall, RGB: nothing in an airway is blue.
const NO_WALL: [u8; 3] = [40, 150, 255];
/// Its share of a pixel that does not count at all.
const NO_WALL_SHARE: f64 = 0.6;

/// The frame of a line, as far as it may be asked for.
pub struct ShownFrame {
    /// Its picture, RGB.
    pub image: Arc<Image<u8>>,
    /// Draws how much each pixel counted as wall, 0 to 255 at the picture's size; `None` where the method does not say.
    pub wall: Box<dyn Fn() -> Option<Image<u8>> + Send + Sync>,
}

impl ShownFrame {
    /// As JPEG; with `walls`, what does not count as wall is tinted. `None` where it cannot be written as one.
    pub(super) fn jpeg(&self, walls: bool) -> Option<Vec<u8>> {
        let wall = if walls { (self.wall)() } else { None };
        match wall {
            Some(wall) => jpeg::encode_rgb(&tinted(&self.image, &wall), QUALITY).ok(),
            None => jpeg::encode_rgb(&self.image, QUALITY).ok(),
        }
    }
}

fn tinted(image: &Image<u8>, wall: &Image<u8>) -> Image<u8> {
    let mut tinted = image.clone();
    for (pixel, wall) in tinted.data.chunks_exact_mut(3).zip(&wall.data) {
        let share = NO_WALL_SHARE * (1.0 - f64::from(*wall) / 255.0);
        for (value, tint) in pixel.iter_mut().zip(NO_WALL) {
            *value = (f64::from(*value) * (1.0 - share) + f64::from(tint) * share).round() as u8;
        }
    }
    tinted
}
