//! Depth as 16-bit grey PNG, 0 where there is none (nerfstudio, KITTI and most endoscopy sets; the file
//! does not say its unit).

use std::path::Path;

use png::{BitDepth, ColorType, Compression};

use super::png::{encode_pixels, pixels};
use crate::base::{Error, Image, Result, files};

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
    let data: Vec<u8> = grey.data.iter().flat_map(|code| code.to_be_bytes()).collect();
    let size = [grey.width as u32, grey.height as u32];
    encode_pixels(&data, size, ColorType::Grayscale, BitDepth::Sixteen, Compression::Fast)
}

/// [`read`] for bytes in memory.
pub fn decode(bytes: &[u8], unit_mm: f64) -> Result<Image<f32>> {
    let grey = pixels(bytes)?;
    if (grey.color, grey.depth) != (ColorType::Grayscale, BitDepth::Sixteen) {
        let (color, depth) = (grey.color, grey.depth);
        return Err(Error::input(format!("has {color:?} pixels of {depth:?} bits; a depth image has 16-bit grey")));
    }
    let mm = |&be: &[u8; 2]| (f64::from(u16::from_be_bytes(be)) * unit_mm) as f32;
    let data = grey.data.as_chunks::<2>().0.iter().map(mm).collect();
    Ok(Image { width: grey.width, height: grey.height, channels: 1, data })
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
        let bytes = encode_pixels(&[0; 4], [2, 2], ColorType::Grayscale, BitDepth::Eight, Compression::Fast).unwrap();
        assert!(decode(&bytes, 1.0).unwrap_err().to_string().contains("16-bit"));
    }
}
