//! JPEG: small pictures for people to look at, and what a lossy recorder leaves of a frame. Baseline, colour at half the
//! resolution, Huffman tables made for the picture. No SIMD: equal images are equal bytes on every machine.

use jpeg_encoder::{ChromaSubsamplingMethod, ColorType, Encoder, SamplingFactor};

pub use super::jpeg_decode::decode_rgb;
use crate::base::{Error, Image, Result};

/// An RGB image of 8-bit sRGB as JPEG of `quality` 1 to 100. Errors: another number of channels, a side of 0 or above
/// 65535 pixels.
pub fn encode_rgb(image: &Image<u8>, quality: u8) -> Result<Vec<u8>> {
    encode(image, quality, ChromaSubsamplingMethod::Nearest)
}

/// [`encode_rgb`] with the colours of four pixels averaged, as cameras do it, in place of every second pixel's own.
pub fn encode_recording(image: &Image<u8>, quality: u8) -> Result<Vec<u8>> {
    encode(image, quality, ChromaSubsamplingMethod::Average)
}

fn encode(image: &Image<u8>, quality: u8, method: ChromaSubsamplingMethod) -> Result<Vec<u8>> {
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
    encoder.set_chroma_subsampling_method(method);
    encoder
        .encode(&image.data, width, height, ColorType::Rgb)
        .map_err(|e| Error::input(format!("encoding as JPEG failed: {e}")))?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Against what the codec cannot lose: a smooth picture comes back within a few codes, at any size and quality, and
    /// the coarser the quality the worse.
    #[test]
    fn what_is_written_is_read_back() {
        for (width, height) in [(64, 48), (33, 17), (1, 1), (16, 100)] {
            let mut image = Image::filled(width, height, 3, 0u8);
            for y in 0..height {
                for x in 0..width {
                    let wave = 40.0 * (x as f64 * 0.2).sin() + 30.0 * (y as f64 * 0.15).cos();
                    image.pixel_mut(x, y).copy_from_slice(&[150.0 + wave, 90.0 + 0.7 * wave, 80.0].map(|v| v as u8));
                }
            }
            let off = |quality: u8| {
                let seen = decode_rgb(&encode_recording(&image, quality).unwrap()).unwrap();
                assert!(seen.same_shape(&image));
                let square = |(a, b): (&u8, &u8)| (f64::from(*a) - f64::from(*b)).powi(2);
                (seen.data.iter().zip(&image.data).map(square).sum::<f64>() / image.data.len() as f64).sqrt()
            };
            assert!(off(98) < 2.0, "{width}x{height}: {}", off(98));
            assert!(off(60) < 4.0 && off(5) > off(98) - 1e-9);
        }
    }

    #[test]
    fn damage_is_refused_in_a_sentence() {
        let image = Image::filled(40, 24, 3, 77u8);
        let bytes = encode_rgb(&image, 80).unwrap();
        for cut in [0, 1, 20, bytes.len() / 2, bytes.len() - 8] {
            assert!(decode_rgb(&bytes[..cut]).unwrap_err().to_string().contains("JPEG"), "cut at {cut}");
        }
        for place in (0..bytes.len()).step_by(3) {
            let mut damaged = bytes.clone();
            damaged[place] ^= 0x5a;
            let _ = decode_rgb(&damaged);
        }
    }

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
