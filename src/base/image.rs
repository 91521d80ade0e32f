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
    /// Half as wide and high: means of 2x2 pixels. An odd last row or column is left out.
    pub fn halved(&self) -> Image<f32> {
        let (width, height) = (self.width / 2, self.height / 2);
        let mut data = Vec::with_capacity(width * height * self.channels);
        for y in 0..height {
            let (top, bottom) = (&self.data[2 * y * self.width * self.channels..], (2 * y + 1) * self.width);
            let bottom = &self.data[bottom * self.channels..];
            for x in 0..width {
                let left = 2 * x * self.channels;
                for c in left..left + self.channels {
                    data.push(0.25 * (top[c] + top[c + self.channels] + bottom[c] + bottom[c + self.channels]));
                }
            }
        }
        Image { width, height, channels: self.channels, data }
    }

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halving_takes_means_and_drops_what_is_odd() {
        let image = Image { width: 3, height: 2, channels: 2, data: (0..12).map(|v| v as f32).collect() };
        let half = image.halved();
        assert_eq!((half.width, half.height, half.channels), (1, 1, 2));
        assert_eq!(half.data, [(0.0 + 2.0 + 6.0 + 8.0) / 4.0, (1.0 + 3.0 + 7.0 + 9.0) / 4.0]);
    }
}
