//! OpenEXR, 32-bit float: linear radiance (R, G, B) and one-channel truth such as z-depth (Y). Lossless, ZIP.

use std::io::Cursor;
use std::path::Path;

use exr::image::{AnyChannel, AnyChannels, Encoding, FlatSamples, Image as ExrImage, Layer};
use exr::meta::attribute::IntegerBounds;
use exr::meta::header::{Header, LayerAttributes};
use exr::prelude::{ReadChannels, ReadLayers, SmallVec, WritableImage};

use super::damage::guarded;
use crate::base::{Error, Image, Result, files};

/// Values (pixels times channels) that a file may declare.
const MAX_VALUES: usize = 1 << 28;
/// The channel of a depth image. OpenCV, and so nerfstudio, reads a single channel only under this name: one that is
/// called `Z` comes out as zeros without a word (OpenCV 4.10).
const DEPTH_CHANNEL: &str = "Y";
/// Most values per byte of a file, since ZIP cannot pack tighter: a header that declares more is damaged.
const MAX_VALUES_PER_BYTE: usize = 2048;

/// Reads the first layer: channels R, G, B as three channels, or the only channel there is as one, whatever its name.
///
/// Half floats and integers become f32. Errors name the file: unreadable, damaged, or with other channels.
pub fn read(path: &Path) -> Result<Image<f32>> {
    decode(&files::read_bytes(path)?).map_err(|e| e.at(path))
}

/// Writes three channels as R, G, B in one atomic step.
pub fn write_rgb(path: &Path, image: &Image<f32>) -> Result<()> {
    write(path, image, &["R", "G", "B"])
}

/// Writes a depth image in one atomic step.
pub fn write_depth(path: &Path, depth: &Image<f32>) -> Result<()> {
    write_channel(path, DEPTH_CHANNEL, depth)
}

/// Writes one channel under the name `channel` in one atomic step.
pub fn write_channel(path: &Path, channel: &str, image: &Image<f32>) -> Result<()> {
    write(path, image, &[channel])
}

/// Writes all channels under the names given in one atomic step.
pub fn write(path: &Path, image: &Image<f32>, names: &[&str]) -> Result<()> {
    files::write_bytes(path, &encode(image, names).map_err(|e| e.at(path))?)
}

fn encode(image: &Image<f32>, names: &[&str]) -> Result<Vec<u8>> {
    if image.channels != names.len() || image.width == 0 || image.height == 0 {
        return Err(Error::input(format!(
            "an image of {}x{} pixels and {} channels cannot be written as {}",
            image.width,
            image.height,
            image.channels,
            names.join(", ")
        )));
    }
    let plane = |c: usize| image.data.iter().skip(c).step_by(image.channels).copied().collect();
    let channels: SmallVec<[_; 4]> =
        names.iter().enumerate().map(|(c, name)| AnyChannel::new(*name, FlatSamples::F32(plane(c)))).collect();
    let layer = Layer::new(
        (image.width, image.height),
        LayerAttributes::default(),
        Encoding::SMALL_LOSSLESS,
        AnyChannels::sort(channels),
    );
    let mut bytes = Cursor::new(Vec::new());
    ExrImage::from_layer(layer)
        .write()
        .non_parallel()
        .to_buffered(&mut bytes)
        .map_err(|e| Error::input(format!("encoding as OpenEXR failed: {e}")))?;
    Ok(bytes.into_inner())
}

/// [`read`] for bytes in memory.
pub fn decode(bytes: &[u8]) -> Result<Image<f32>> {
    guarded("OpenEXR", || decode_unguarded(bytes))
}

/// Where the pixels of a part lie.
fn data_window(header: &Header) -> IntegerBounds {
    IntegerBounds::new(header.own_attributes.layer_position, header.layer_size)
}

fn decode_unguarded(bytes: &[u8]) -> Result<Image<f32>> {
    let damaged = |e: exr::error::Error| Error::input(format!("is not a readable OpenEXR file: {e}"));
    let chunks = exr::block::read(Cursor::new(bytes), false).map_err(damaged)?;
    for header in &chunks.meta_data().headers {
        let size = header.layer_size;
        let values = size.area().saturating_mul(header.channels.list.len());
        if values > MAX_VALUES || values / MAX_VALUES_PER_BYTE > bytes.len() {
            return Err(Error::input(format!(
                "declares {}x{} pixels, more than its {} bytes can hold",
                size.width(),
                size.height(),
                bytes.len()
            )));
        }
    }
    let chosen = chunks.meta_data().headers.first();
    if let Some(header) = chosen.filter(|header| header.shared_attributes.display_window != data_window(header)) {
        let (whole, part) = (header.shared_attributes.display_window.size, header.layer_size);
        return Err(Error::input(format!(
            "holds {}x{} pixels of a picture of {}x{} (data window and display window): the whole picture is wanted",
            part.width(),
            part.height(),
            whole.width(),
            whole.height()
        )));
    }
    let image = exr::image::read::read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .non_parallel()
        .from_chunks(chunks)
        .map_err(damaged)?;
    let layer = image.layer_data;
    let channels = layer.channel_data.list;
    let find = |name: &str| channels.iter().find(|c| c.name == *name);
    let planes: Vec<&FlatSamples> = match (find("R"), find("G"), find("B")) {
        (Some(r), Some(g), Some(b)) => vec![&r.sample_data, &g.sample_data, &b.sample_data],
        _ if channels.len() == 1 => vec![&channels[0].sample_data],
        _ => {
            let names: Vec<String> = channels.iter().map(|c| c.name.to_string()).collect();
            return Err(Error::input(format!("has channels {}; R, G, B or a single one is wanted", names.join(", "))));
        }
    };
    let (width, height) = (layer.size.width(), layer.size.height());
    if planes.iter().any(|p| p.len() != width * height) {
        return Err(Error::input("has subsampled channels, which are not supported"));
    }
    let mut data = vec![0.0; width * height * planes.len()];
    for (c, plane) in planes.iter().enumerate() {
        for (pixel, value) in plane.values_as_f32().enumerate() {
            data[pixel * planes.len() + c] = value;
        }
    }
    Ok(Image { width, height, channels: planes.len(), data })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(channels: usize) -> Image<f32> {
        let data = (0..6 * 5 * channels).map(|i| (i as f32 * 0.37).sin() * 1e3).collect();
        Image { width: 6, height: 5, channels, data }
    }

    #[test]
    fn what_is_written_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.exr");
        write_rgb(&path, &sample(3)).unwrap();
        assert_eq!(read(&path).unwrap(), sample(3));
        write_depth(&path, &sample(1)).unwrap();
        assert_eq!(read(&path).unwrap(), sample(1));
        // Films of older versions and of other programs.
        write_channel(&path, "Z", &sample(1)).unwrap();
        assert_eq!(read(&path).unwrap(), sample(1));
        assert!(write_rgb(&path, &sample(1)).is_err());
    }

    #[test]
    fn damage_is_an_error_that_names_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("damaged.exr");
        let whole = encode(&sample(3), &["R", "G", "B"]).unwrap();
        for length in (0..whole.len() - 1).step_by(7) {
            files::write_bytes(&path, &whole[..length]).unwrap();
            let message = read(&path).unwrap_err().to_string();
            assert!(message.contains("damaged.exr"), "{message}");
        }
        // Flipped bits: an error or an image, never a panic that leaves this file.
        for bit in (0..whole.len() * 8).step_by(3) {
            let mut bytes = whole.clone();
            bytes[bit / 8] ^= 1 << (bit % 8);
            let _ = decode(&bytes);
        }
    }

    #[test]
    fn a_part_of_a_picture_is_not_the_picture() {
        let mut bytes = encode(&sample(1), &["Y"]).unwrap();
        let name = b"displayWindow\0box2i\0";
        let at = bytes.windows(name.len()).position(|w| w == name).unwrap() + name.len() + 4;
        // The picture is 48 wide, of which six columns are there.
        bytes[at + 8..at + 12].copy_from_slice(&47i32.to_le_bytes());
        let said = decode(&bytes).unwrap_err().to_string();
        assert!(said.contains("holds 6x5 pixels of a picture of 48x5"), "{said}");
    }

    #[test]
    fn a_header_that_promises_too_much_is_refused_before_memory_is_asked_for() {
        let mut bytes = encode(&sample(1), &["Z"]).unwrap();
        let name = b"dataWindow\0box2i\0";
        let at = bytes.windows(name.len()).position(|w| w == name).unwrap() + name.len() + 4;
        bytes[at + 8..at + 12].copy_from_slice(&1_000_000i32.to_le_bytes());
        bytes[at + 12..at + 16].copy_from_slice(&1_000_000i32.to_le_bytes());
        assert!(decode(&bytes).is_err());
    }
}
