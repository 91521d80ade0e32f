//! PNG, 8-bit sRGB: the images that methods see. One fixed encoder setting, so that equal images are equal bytes.

use std::io::Cursor;
use std::path::Path;

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder, ImageFormat, ImageReader, Limits};

use crate::base::{Error, Image, Result, files};

/// No image of this program is wider or higher.
const MAX_SIDE_PX: u32 = 32_768;
/// Memory that decoding may ask for, in bytes.
const MAX_DECODED_BYTES: u64 = 256 << 20;

/// Reads any PNG as 8-bit RGB: grey is spread, alpha dropped, 16 bits rounded to 8.
///
/// Errors name the file: unreadable, not a PNG, damaged, or larger than 32768 pixels a side.
pub fn read_rgb(path: &Path) -> Result<Image<u8>> {
    decode(&files::read_bytes(path)?).map_err(|e| e.at(path))
}

/// Writes an RGB image (three channels) in one atomic step.
pub fn write_rgb(path: &Path, image: &Image<u8>) -> Result<()> {
    files::write_bytes(path, &encode(image).map_err(|e| e.at(path))?)
}

/// Writes a grey image (one channel) in one atomic step.
pub fn write_grey(path: &Path, image: &Image<u8>) -> Result<()> {
    files::write_bytes(path, &encode_as(image, 1, ExtendedColorType::L8).map_err(|e| e.at(path))?)
}

/// Writes RGB images of one size as an endless animated PNG, `seconds` each, in one atomic step. Readers without
/// animation show the first. Errors: no image, or images of several sizes.
pub fn write_animation(path: &Path, images: &[Image<u8>], seconds: f64) -> Result<()> {
    files::write_bytes(path, &animation(images, seconds).map_err(|e| e.at(path))?)
}

fn animation(images: &[Image<u8>], seconds: f64) -> Result<Vec<u8>> {
    let first = images.first().ok_or_else(|| Error::input("an animation needs an image"))?;
    if first.channels != 3 || images.iter().any(|i| !i.same_shape(first)) {
        return Err(Error::input("the images of an animation must be RGB and of one size"));
    }
    let failed = |e: png::EncodingError| Error::input(format!("encoding as animated PNG failed: {e}"));
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, first.width as u32, first.height as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_animated(images.len() as u32, 0).map_err(failed)?;
    encoder.set_frame_delay((seconds * 1000.0).round().clamp(1.0, 65_535.0) as u16, 1000).map_err(failed)?;
    let mut writer = encoder.write_header().map_err(failed)?;
    for image in images {
        writer.write_image_data(&image.data).map_err(failed)?;
    }
    writer.finish().map_err(failed)?;
    Ok(bytes)
}

/// [`read_rgb`] for bytes in memory.
pub fn decode(bytes: &[u8]) -> Result<Image<u8>> {
    let damaged = |e: image::ImageError| Error::input(format!("is not a readable PNG image: {e}"));
    let mut limits = Limits::default();
    limits.max_image_width = Some(MAX_SIDE_PX);
    limits.max_image_height = Some(MAX_SIDE_PX);
    limits.max_alloc = Some(MAX_DECODED_BYTES);
    let mut reader = ImageReader::with_format(Cursor::new(bytes), ImageFormat::Png);
    reader.limits(limits);
    let rgb = reader.decode().map_err(damaged)?.into_rgb8();
    Ok(Image { width: rgb.width() as usize, height: rgb.height() as usize, channels: 3, data: rgb.into_raw() })
}

/// The bytes of an RGB image as a PNG file. Errors: not three channels.
pub fn encode(image: &Image<u8>) -> Result<Vec<u8>> {
    encode_as(image, 3, ExtendedColorType::Rgb8)
}

fn encode_as(image: &Image<u8>, channels: usize, color: ExtendedColorType) -> Result<Vec<u8>> {
    if image.channels != channels || image.width == 0 || image.height == 0 {
        return Err(Error::input(format!(
            "an image of {}x{} pixels and {} channels cannot be written as PNG of {channels} channels",
            image.width, image.height, image.channels
        )));
    }
    let mut bytes = Vec::new();
    PngEncoder::new_with_quality(&mut bytes, CompressionType::Default, FilterType::Adaptive)
        .write_image(&image.data, image.width as u32, image.height as u32, color)
        .map_err(|e| Error::input(format!("encoding as PNG failed: {e}")))?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample() -> Image<u8> {
        let data = (0..9 * 7 * 3).map(|i| (i * 37 % 251) as u8).collect();
        Image { width: 9, height: 7, channels: 3, data }
    }

    #[test]
    fn what_is_written_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        write_rgb(&path, &sample()).unwrap();
        assert_eq!(read_rgb(&path).unwrap(), sample());
        assert_eq!(encode(&sample()).unwrap(), files::read_bytes(&path).unwrap());
    }

    #[test]
    fn damage_is_an_error_that_names_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("damaged.png");
        let whole = encode(&sample()).unwrap();
        for length in 0..whole.len() - 12 {
            files::write_bytes(&path, &whole[..length]).unwrap();
            let message = read_rgb(&path).unwrap_err().to_string();
            assert!(message.contains("damaged.png"), "{message}");
            if length > 200 {
                break;
            }
        }
        // Flipped bits: an error or an image, never a panic.
        for bit in 0..whole.len() * 8 {
            let mut bytes = whole.clone();
            bytes[bit / 8] ^= 1 << (bit % 8);
            let _ = decode(&bytes);
        }
    }

    #[test]
    fn an_animation_holds_its_images_and_the_first_is_seen_by_all() {
        let mut other = sample();
        other.data.reverse();
        let bytes = animation(&[sample(), other.clone()], 0.1).unwrap();
        assert_eq!(decode(&bytes).unwrap(), sample());
        let mut reader = png::Decoder::new(Cursor::new(&bytes)).read_info().unwrap();
        assert_eq!(reader.info().animation_control().unwrap().num_frames, 2);
        let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut pixels).unwrap();
        let control = reader.next_frame_info().unwrap();
        assert_eq!((control.delay_num, control.delay_den), (100, 1000));
        reader.next_frame(&mut pixels).unwrap();
        assert_eq!(pixels, other.data);
        let small = Image::filled(2, 2, 3, 0u8);
        assert!(animation(&[sample(), small], 0.1).is_err() && animation(&[], 0.1).is_err());
    }

    #[test]
    fn a_depth_image_is_refused() {
        assert!(encode(&Image::filled(4, 4, 1, 0u8)).is_err());
    }
}
