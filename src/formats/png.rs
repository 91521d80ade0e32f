//! PNG, 8-bit sRGB: the images that methods see. Fixed encoder settings, so that equal images are equal bytes.

use std::io::Cursor;
use std::path::Path;

use png::{BitDepth, ColorType, Compression, Filter, Limits, Transformations};

use crate::base::{Error, Image, Result, files};

/// No image of this program is wider or higher.
const MAX_SIDE_PX: u32 = 32_768;
/// Memory that decoding may ask for, in bytes.
const MAX_DECODED_BYTES: usize = 256 << 20;

/// Reads any PNG as 8-bit RGB: grey is spread, alpha dropped, 16 bits rounded to 8.
///
/// Errors name the file: unreadable, not a PNG, damaged, larger than 32768 pixels a side, or beyond
/// 256 MiB of pixels.
pub fn read_rgb(path: &Path) -> Result<Image<u8>> {
    decode(&files::read_bytes(path)?).map_err(|e| e.at(path))
}

/// Writes an RGB image (three channels) in one atomic step.
pub fn write_rgb(path: &Path, image: &Image<u8>) -> Result<()> {
    files::write_bytes(path, &encode(image).map_err(|e| e.at(path))?)
}

/// [`write_rgb`] in a tenth of the time, for the many pictures of a run: a rendering is as small, a drawing is not.
pub fn write_rgb_fast(path: &Path, image: &Image<u8>) -> Result<()> {
    let bytes = encode_as(image, 3, ColorType::Rgb, Compression::Fast);
    files::write_bytes(path, &bytes.map_err(|e| e.at(path))?)
}

/// Writes a grey image (one channel) in one atomic step.
pub fn write_grey(path: &Path, image: &Image<u8>) -> Result<()> {
    files::write_bytes(path, &encode_as(image, 1, ColorType::Grayscale, Compression::Balanced).map_err(|e| e.at(path))?)
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
    encoder.set_color(ColorType::Rgb);
    encoder.set_depth(BitDepth::Eight);
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
    let pixels = pixels(bytes)?;
    let eight_bits = if pixels.depth == BitDepth::Sixteen {
        // Codes of 65535 to the nearest of 255.
        let code = |&be: &[u8; 2]| ((u32::from(u16::from_be_bytes(be)) + 128) / 257) as u8;
        pixels.data.as_chunks::<2>().0.iter().map(code).collect()
    } else {
        pixels.data
    };
    let data = match pixels.color {
        ColorType::Rgb => eight_bits,
        ColorType::Rgba => eight_bits.as_chunks::<4>().0.iter().flat_map(|&[r, g, b, _]| [r, g, b]).collect(),
        ColorType::GrayscaleAlpha => eight_bits.as_chunks::<2>().0.iter().flat_map(|&[grey, _]| [grey; 3]).collect(),
        ColorType::Grayscale | ColorType::Indexed => eight_bits.into_iter().flat_map(|grey| [grey; 3]).collect(),
    };
    Ok(Image { width: pixels.width, height: pixels.height, channels: 3, data })
}

/// A decoded PNG: palettes resolved, fewer than 8 bits spread to 8; 16 bits big endian.
pub(super) struct Pixels {
    pub width: usize,
    pub height: usize,
    pub color: ColorType,
    pub depth: BitDepth,
    pub data: Vec<u8>,
}

/// Decodes the first image of a PNG. Errors: not a PNG, damaged, too large.
pub(super) fn pixels(bytes: &[u8]) -> Result<Pixels> {
    let damaged = |e: png::DecodingError| Error::input(format!("is not a readable PNG image: {e}"));
    let mut decoder = png::Decoder::new_with_limits(Cursor::new(bytes), Limits { bytes: MAX_DECODED_BYTES });
    decoder.set_transformations(Transformations::EXPAND);
    let header = decoder.read_header_info().map_err(damaged)?;
    let (width, height) = (header.width, header.height);
    let mut reader = decoder.read_info().map_err(damaged)?;
    let size = reader.output_buffer_size().filter(|size| *size <= MAX_DECODED_BYTES);
    let Some(size) = size.filter(|_| width.max(height) <= MAX_SIDE_PX) else {
        return Err(Error::input(format!("is not a readable PNG image: {width}x{height} pixels are too many")));
    };
    let (color, depth) = reader.output_color_type();
    let mut data = vec![0; size];
    reader.next_frame(&mut data).map_err(damaged)?;
    Ok(Pixels { width: width as usize, height: height as usize, color, depth, data })
}

/// The bytes of an RGB image as a PNG file. Errors: not three channels.
pub fn encode(image: &Image<u8>) -> Result<Vec<u8>> {
    encode_as(image, 3, ColorType::Rgb, Compression::Balanced)
}

fn encode_as(image: &Image<u8>, channels: usize, color: ColorType, compression: Compression) -> Result<Vec<u8>> {
    if image.channels != channels || image.width == 0 || image.height == 0 {
        return Err(Error::input(format!(
            "an image of {}x{} pixels and {} channels cannot be written as PNG of {channels} channels",
            image.width, image.height, image.channels
        )));
    }
    let size = [image.width as u32, image.height as u32];
    encode_pixels(&image.data, size, color, BitDepth::Eight, compression)
}

/// A PNG of `data`, row by row, 16 bits big endian.
pub(super) fn encode_pixels(
    data: &[u8],
    [width, height]: [u32; 2],
    color: ColorType,
    depth: BitDepth,
    compression: Compression,
) -> Result<Vec<u8>> {
    let failed = |e: png::EncodingError| Error::input(format!("encoding as PNG failed: {e}"));
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width, height);
    encoder.set_color(color);
    encoder.set_depth(depth);
    encoder.set_compression(compression);
    encoder.set_filter(Filter::Adaptive);
    let mut writer = encoder.write_header().map_err(failed)?;
    writer.write_image_data(data).map_err(failed)?;
    writer.finish().map_err(failed)?;
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
        write_rgb_fast(&path, &sample()).unwrap();
        assert_eq!(read_rgb(&path).unwrap(), sample());
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

    /// The crate `image` turns every kind of pixel into this one on its own.
    #[cfg(feature = "program")]
    #[test]
    fn another_reader_and_writer_agree() {
        let bytes = encode(&sample()).unwrap();
        assert_eq!(image::load_from_memory(&bytes).unwrap().into_rgb8().into_raw(), sample().data);
        let codes: Vec<u16> = (0..9u32 * 7 * 4).map(|i| (i * 2657 % 65_536) as u16).collect();
        let rgba = image::DynamicImage::ImageRgba16(image::ImageBuffer::from_raw(9, 7, codes).unwrap());
        for kind in [
            rgba.clone(),
            rgba.to_rgb16().into(),
            rgba.to_luma16().into(),
            rgba.to_luma_alpha16().into(),
            rgba.to_rgba8().into(),
            rgba.to_rgb8().into(),
            rgba.to_luma8().into(),
            rgba.to_luma_alpha8().into(),
        ] {
            let mut bytes = Cursor::new(Vec::new());
            kind.write_to(&mut bytes, image::ImageFormat::Png).unwrap();
            assert_eq!(decode(bytes.get_ref()).unwrap().data, kind.to_rgb8().into_raw(), "{:?}", kind.color());
        }
    }

    #[test]
    fn palettes_and_few_bits_are_spread() {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, 2, 1);
        encoder.set_color(ColorType::Indexed);
        encoder.set_depth(BitDepth::One);
        encoder.set_palette(vec![10, 20, 30, 40, 50, 60]);
        encoder.write_header().unwrap().write_image_data(&[0b0100_0000]).unwrap();
        assert_eq!(decode(&bytes).unwrap().data, [10, 20, 30, 40, 50, 60]);
    }

    #[test]
    fn a_depth_image_is_refused() {
        assert!(encode(&Image::filled(4, 4, 1, 0u8)).is_err());
    }
}
