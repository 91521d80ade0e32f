//! JPEG, written only: small pictures for people to look at, never for metrics. Baseline, colour at half the resolution,
//! Huffman tables made for the picture. No SIMD: equal images are equal bytes on every machine.

use jpeg_encoder::{ColorType, Encoder, SamplingFactor};

use crate::base::{Error, Image, Result};

/// An RGB image of 8-bit sRGB as JPEG of `quality` 1 to 100. Errors: another number of channels, a side of 0 or above
/// 65535 pixels.
pub fn encode_rgb(image: &Image<u8>, quality: u8) -> Result<Vec<u8>> {
    let sides = u16::try_from(image.width).ok().zip(u16::try_from(image.height).ok());
    let Some((width, height)) = sides.filter(|&(w, h)| image.channels == 3 && w > 0 && h > 0) else {
        return Err(Error::input(format!(
            "an image of {}x{} pixels and {} channels cannot be written as JPEG",
            image.width, image.height, image.channels
        )));
    };
    let mut bytes = Vec::new();
    let mut encoder = Encoder::new(&mut bytes, quality.clamp(1, 100));
    encoder.set_sampling_factor(SamplingFactor::F_2_2);
    encoder.set_optimized_huffman_tables(true);
    encoder
        .encode(&image.data, width, height, ColorType::Rgb)
        .map_err(|e| Error::input(format!("encoding as JPEG failed: {e}")))?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_is_small_whole_and_always_the_same() {
        let mut image = Image::filled(64, 48, 3, 0u8);
        for y in 0..48 {
            for x in 0..64 {
                image.pixel_mut(x, y).copy_from_slice(&[(4 * x) as u8, (5 * y) as u8, 90]);
            }
        }
        let bytes = encode_rgb(&image, 80).unwrap();
        assert!(bytes.starts_with(&[0xff, 0xd8, 0xff]) && bytes.ends_with(&[0xff, 0xd9]));
        assert!(bytes.len() < image.data.len() / 4, "{} bytes", bytes.len());
        assert_eq!(encode_rgb(&image, 80).unwrap(), bytes);
        assert!(encode_rgb(&image, 95).unwrap().len() > bytes.len());
        let grey = Image::filled(8, 8, 1, 0u8);
        assert!(encode_rgb(&grey, 80).unwrap_err().to_string().contains("1 channels"));
    }
}
