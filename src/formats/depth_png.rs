//! Depth as 16-bit grey PNG, 0 where there is none (nerfstudio, KITTI and most endoscopy sets; the file
//! does not say its unit).

use std::io::Cursor;
use std::path::Path;

use image::{DynamicImage, ImageBuffer, ImageFormat, ImageReader, Limits, Luma};

use crate::base::{Error, Image, Result, files};

/// No depth image is wider or higher.
const MAX_SIDE_PX: u32 = 32_768;
/// Memory that decoding may ask for, in bytes.
const MAX_DECODED_BYTES: u64 = 256 << 20;

/// Reads a 16-bit grey PNG as one channel of `unit_mm` times its codes. Errors name the file; 8 bits are refused,
/// because they cannot hold a depth.
pub fn read(path: &Path, unit_mm: f64) -> Result<Image<f32>> {
    decode(&files::read_bytes(path)?, unit_mm).map_err(|e| e.at(path))
}

/// Writes codes as a 16-bit grey PNG in one atomic step. Errors: other than one channel; writing.
pub fn write(path: &Path, codes: &Image<u16>) -> Result<()> {
    files::write_bytes(path, &encode(codes).map_err(|e| e.at(path))?)
}

fn encode(codes: &Image<u16>) -> Result<Vec<u8>> {
    let refused = || Error::input("an image of depth has one channel and at least one pixel");
    let grey = Some(codes).filter(|codes| codes.channels == 1 && !codes.data.is_empty()).ok_or_else(refused)?;
    let (width, height) = (grey.width as u32, grey.height as u32);
    let grey = ImageBuffer::<Luma<u16>, _>::from_raw(width, height, grey.data.as_slice()).ok_or_else(refused)?;
    let mut bytes = Cursor::new(Vec::new());
    let failed = |e: image::ImageError| Error::input(format!("encoding as PNG failed: {e}"));
    grey.write_to(&mut bytes, ImageFormat::Png).map_err(failed)?;
    Ok(bytes.into_inner())
}

/// [`read`] for bytes in memory.
pub fn decode(bytes: &[u8], unit_mm: f64) -> Result<Image<f32>> {
    let damaged = |e: image::ImageError| Error::input(format!("is not a readable PNG image: {e}"));
    let mut limits = Limits::default();
    limits.max_image_width = Some(MAX_SIDE_PX);
    limits.max_image_height = Some(MAX_SIDE_PX);
    limits.max_alloc = Some(MAX_DECODED_BYTES);
    let mut reader = ImageReader::with_format(Cursor::new(bytes), ImageFormat::Png);
    reader.limits(limits);
    match reader.decode().map_err(damaged)? {
        DynamicImage::ImageLuma16(grey) => Ok(Image {
            width: grey.width() as usize,
            height: grey.height() as usize,
            channels: 1,
            data: grey.as_raw().iter().map(|&code| (f64::from(code) * unit_mm) as f32).collect(),
        }),
        other => Err(Error::input(format!("has pixels of type {:?}; a depth image has 16-bit grey", other.color()))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_times_the_unit() {
        let codes = Image { width: 3, height: 1, channels: 1, data: vec![0u16, 250, 40_000] };
        let bytes = encode(&codes).unwrap();
        assert_eq!(decode(&bytes, 0.01).unwrap().data, [0.0, 2.5, 400.0]);
        assert!(decode(&bytes[..bytes.len() / 2], 0.01).is_err());
        assert!(encode(&Image { channels: 3, width: 1, ..codes }).is_err());
    }

    #[test]
    fn eight_bits_are_refused() {
        let mut bytes = Cursor::new(Vec::new());
        image::GrayImage::new(2, 2).write_to(&mut bytes, ImageFormat::Png).unwrap();
        assert!(decode(&bytes.into_inner(), 1.0).unwrap_err().to_string().contains("16-bit"));
    }
}
