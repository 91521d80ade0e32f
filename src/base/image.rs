//! Images: row-major, interleaved channels, row 0 at the top.

use super::color;

/// `height` rows of `width` pixels of `channels` interleaved values.
#[derive(Clone, Debug, PartialEq)]
pub struct Image<T> {
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// Values per pixel (3 for RGB, 1 for depth).
    pub channels: usize,
    /// `height * width * channels` values.
    pub data: Vec<T>,
}

impl<T: Copy> Image<T> {
    /// An image of one value.
    pub fn filled(width: usize, height: usize, channels: usize, value: T) -> Self {
        Image { width, height, channels, data: vec![value; width * height * channels] }
    }

    /// The values of the pixel in column `x` and row `y`.
    pub fn pixel(&self, x: usize, y: usize) -> &[T] {
        let start = (y * self.width + x) * self.channels;
        &self.data[start..start + self.channels]
    }

    /// Mutable [`Image::pixel`].
    pub fn pixel_mut(&mut self, x: usize, y: usize) -> &mut [T] {
        let start = (y * self.width + x) * self.channels;
        &mut self.data[start..start + self.channels]
    }

    /// True when width, height and channels agree.
    pub fn same_shape<U>(&self, other: &Image<U>) -> bool {
        (self.width, self.height, self.channels) == (other.width, other.height, other.channels)
    }
}

impl Image<f32> {
    /// Linear RGB to 8-bit sRGB codes.
    pub fn to_srgb8(&self) -> Image<u8> {
        self.map(color::srgb8_from_linear)
    }

    /// Every value through `f`.
    pub fn map<U>(&self, f: impl Fn(f32) -> U) -> Image<U> {
        Image {
            width: self.width,
            height: self.height,
            channels: self.channels,
            data: self.data.iter().map(|&v| f(v)).collect(),
        }
    }
}

impl Image<u8> {
    /// 8-bit sRGB codes to *encoded* values in [0, 1] (what methods see and what image metrics compare).
    pub fn to_unit(&self) -> Image<f32> {
        Image {
            width: self.width,
            height: self.height,
            channels: self.channels,
            data: self.data.iter().map(|&v| v as f32 / 255.0).collect(),
        }
    }
}

/// Encoded values in [0, 1] to the nearest 8-bit codes; clamps, NaN becomes 0.
pub fn codes_from_unit(image: &Image<f32>) -> Image<u8> {
    image.map(|v| if v > 0.0 { (v.min(1.0) * 255.0 + 0.5) as u8 } else { 0 })
}
