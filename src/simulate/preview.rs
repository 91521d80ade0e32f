//! A film at a glance: a contact sheet of some frames and a small animated PNG. Made from the finished images, so they
//! cost nothing while filming and are the same bytes whenever they are made.

use std::path::Path;

use crate::base::{Image, Result};
use crate::formats::png;

use super::sequence;

/// Frames on the sheet: columns, rows at most.
const COLUMNS: usize = 6;
const ROWS: usize = 4;
/// Widest image on the sheet and in the animation, in pixels.
const SHEET_PX: usize = 128;
const ANIMATION_PX: usize = 96;
/// Most images of the animation, and its greatest rate per second.
const PICTURES: usize = 80;
const PICTURES_PER_SECOND: f64 = 10.0;
/// Width of the lines between images.
const GAP_PX: usize = 2;

/// Writes contact sheet and animation of the film of `frames` frames below `out`.
pub(super) fn write(out: &Path, frames: usize, frames_per_second: f64) -> Result<()> {
    let read =
        |index: usize, side_px: usize| Ok(shrunk(&png::read_rgb(&out.join(sequence::image_name(index)))?, side_px));
    let shown: Vec<Image<u8>> =
        spread(frames, COLUMNS * ROWS).into_iter().map(|i| read(i, SHEET_PX)).collect::<Result<_>>()?;
    png::write_rgb(&out.join(sequence::CONTACT_SHEET), &sheet(&shown, COLUMNS))?;
    let duration_s = frames as f64 / frames_per_second;
    let pictures = frames.min(PICTURES).min((duration_s * PICTURES_PER_SECOND).ceil() as usize).max(1);
    let moving: Vec<Image<u8>> =
        spread(frames, pictures).into_iter().map(|i| read(i, ANIMATION_PX)).collect::<Result<_>>()?;
    png::write_animation(&out.join(sequence::PREVIEW), &moving, duration_s / pictures as f64)
}

/// At most `wanted` indices below `count`, evenly spread, first and last among them.
fn spread(count: usize, wanted: usize) -> Vec<usize> {
    if count <= wanted || wanted < 2 {
        return (0..count.min(wanted)).collect();
    }
    (0..wanted).map(|i| (i * (count - 1) + (wanted - 1) / 2) / (wanted - 1)).collect()
}

/// The image with each side divided by the whole number that brings it down to `side_px`, averaged over blocks.
pub fn shrunk(image: &Image<u8>, side_px: usize) -> Image<u8> {
    let factor = image.width.max(image.height).div_ceil(side_px);
    if factor <= 1 {
        return image.clone();
    }
    let (width, height) = ((image.width / factor).max(1), (image.height / factor).max(1));
    let mut small = Image::filled(width, height, image.channels, 0u8);
    let area = (factor * factor) as u32;
    for y in 0..height {
        for x in 0..width {
            for c in 0..image.channels {
                let mut sum = area / 2;
                for dy in 0..factor {
                    for dx in 0..factor {
                        let (sx, sy) = (x * factor + dx, y * factor + dy);
                        sum += u32::from(image.pixel(sx.min(image.width - 1), sy.min(image.height - 1))[c]);
                    }
                }
                small.pixel_mut(x, y)[c] = (sum / area) as u8;
            }
        }
    }
    small
}

/// Images of one size in rows of `columns`, white lines between.
pub fn sheet(images: &[Image<u8>], columns: usize) -> Image<u8> {
    let Some(first) = images.first() else { return Image::filled(1, 1, 3, 255) };
    let columns = columns.min(images.len());
    let rows = images.len().div_ceil(columns);
    let (step_x, step_y) = (first.width + GAP_PX, first.height + GAP_PX);
    let mut sheet = Image::filled(columns * step_x - GAP_PX, rows * step_y - GAP_PX, 3, 255u8);
    for (i, image) in images.iter().enumerate() {
        let (left, top) = (i % columns * step_x, i / columns * step_y);
        for y in 0..image.height.min(first.height) {
            for x in 0..image.width.min(first.width) {
                sheet.pixel_mut(left + x, top + y).copy_from_slice(image.pixel(x, y));
            }
        }
    }
    sheet
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn indices_are_spread_from_first_to_last() {
        assert_eq!(spread(3, 24), [0, 1, 2]);
        assert_eq!(spread(401, 5), [0, 100, 200, 300, 400]);
        let many = spread(400, 24);
        assert_eq!((many.len(), many[0], many[23]), (24, 0, 399));
        assert!(many.windows(2).all(|w| w[1] > w[0]));
    }

    #[test]
    fn blocks_are_averaged_and_pictures_laid_out() {
        let mut image = Image::filled(4, 4, 3, 10u8);
        image.pixel_mut(0, 0).copy_from_slice(&[50, 10, 10]);
        assert_eq!(shrunk(&image, 2).pixel(0, 0), [20, 10, 10]);
        assert_eq!(shrunk(&image, 4), image);
        let whole = sheet(&[image.clone(), image.clone(), image.clone()], 2);
        assert_eq!((whole.width, whole.height), (10, 10));
        assert_eq!(whole.pixel(0, 6), [50, 10, 10]);
        assert_eq!(whole.pixel(7, 7), [255; 3]);
    }
}
