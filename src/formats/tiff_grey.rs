//! 16-bit grey as baseline TIFF 6.0: little-endian, one strip, uncompressed. What C3VD's depth images are, and what
//! OpenCV, Pillow and tifffile read.

use crate::base::{Error, Image, Result};

/// Types of a directory's entries.
const SHORT: u16 = 3;
const LONG: u16 = 4;
/// Bytes of the header, before the directory.
const HEADER_BYTES: u32 = 8;

/// Encodes one channel of codes. Errors: other than one channel, an image of no pixels or beyond 2 GiB.
pub fn encode(image: &Image<u16>) -> Result<Vec<u8>> {
    let bytes = u32::try_from(image.data.len() as u64 * 2).ok().filter(|&bytes| bytes > 0 && bytes < u32::MAX / 2);
    let (Some(bytes), 1) = (bytes, image.channels) else {
        let (w, h, c) = (image.width, image.height, image.channels);
        return Err(Error::input(format!("{w}x{h} pixels of {c} channels cannot be written as 16-bit grey TIFF")));
    };
    let (width, height) = (image.width as u32, image.height as u32);
    // Tag, type and value; ascending, as the format demands.
    let entries: [(u16, u16, u32); 10] = [
        (256, LONG, width),
        (257, LONG, height),
        (258, SHORT, 16), // bits per sample
        (259, SHORT, 1),  // no compression
        (262, SHORT, 1),  // 0 is black
        (273, LONG, 0),   // where the strip begins: set below
        (277, SHORT, 1),  // samples per pixel
        (278, LONG, height),
        (279, LONG, bytes),
        (339, SHORT, 1), // unsigned
    ];
    let start = HEADER_BYTES + 2 + 12 * entries.len() as u32 + 4;
    let mut out = b"II\x2a\0".to_vec();
    out.extend(HEADER_BYTES.to_le_bytes());
    out.extend((entries.len() as u16).to_le_bytes());
    for (tag, kind, value) in entries {
        out.extend(tag.to_le_bytes());
        out.extend(kind.to_le_bytes());
        out.extend(1u32.to_le_bytes());
        out.extend(if tag == 273 { start } else { value }.to_le_bytes());
    }
    out.extend(0u32.to_le_bytes());
    image.data.iter().for_each(|code| out.extend(code.to_le_bytes()));
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_strip_lies_where_the_directory_says() {
        let image = Image { width: 3, height: 2, channels: 1, data: vec![0u16, 1, 2, 3, 65_535, 5] };
        let bytes = encode(&image).unwrap();
        let start = 8 + 2 + 120 + 4;
        assert_eq!((bytes.len(), &bytes[..4]), (start + 12, &b"II\x2a\0"[..]));
        assert_eq!(bytes[start + 8..start + 10], [255, 255]);
        let strip = bytes.windows(12).find(|w| w[..2] == 273u16.to_le_bytes()).unwrap();
        assert_eq!(strip[8..], (start as u32).to_le_bytes());
        assert!(encode(&Image { channels: 3, width: 1, ..image }).is_err());
    }
}
