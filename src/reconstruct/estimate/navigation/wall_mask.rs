//! What in a picture is not wall: glare and clipped pixels, and pale patches (secretions, bubbles, foam), by their colour.
//! Mucosa is red: the ratio of green to red, in encoded values, varies little over a frame, and what is pale has a higher
//! one. The median of a frame stands for its tissue, whatever lamp and white balance are.

use crate::base::statistics::{robust_deviation, upper_median};
use crate::base::{Image, Mask};

/// Code from which a channel counts as clipped: green, and all three.
const CLIPPED: [u8; 2] = [246, 232];
/// Codes of red below which a pixel is too dark to have a colour.
const DARK: u8 = 24;
/// A pixel is pale if its ratio of green to red is above the median by this factor plus so many robust deviations.
const PALE_FACTOR: f32 = 1.12;
const PALE_DEVIATIONS: f32 = 3.0;

/// How much each pixel of `image` shows of the wall, 0 or 1; `mask` is what the lens shows at all.
pub fn wall_shares(image: &Image<u8>, mask: Option<&Mask>) -> Vec<f32> {
    let ratio = |pixel: &[u8]| f32::from(pixel[1]) / f32::from(pixel[0]);
    let ratios: Vec<f32> = image.data.chunks_exact(3).filter(|p| p[0] >= DARK).map(ratio).collect();
    let mut limit = f32::INFINITY;
    if let Some(median) = upper_median(ratios.iter().copied())
        && let Some(deviation) = robust_deviation(ratios.iter().map(|ratio| (ratio - median).abs()))
    {
        limit = PALE_FACTOR * median + PALE_DEVIATIONS * deviation;
    }
    let shows = |(index, pixel): (usize, &[u8])| {
        let [r, g, b] = [pixel[0], pixel[1], pixel[2]];
        let is_clipped = g >= CLIPPED[0] || r.min(g).min(b) >= CLIPPED[1];
        let is_pale = r >= DARK && ratio(pixel) > limit;
        let is_hidden = mask.is_some_and(|mask| !mask.shows(index));
        if is_clipped || is_pale || is_hidden { 0.0 } else { 1.0 }
    };
    image.data.chunks_exact(3).enumerate().map(shows).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pale_drops_and_glare_are_left_out_and_a_dark_lumen_is_not() {
        let mut image = Image::filled(32, 32, 3, 0u8);
        for y in 0..32 {
            for x in 0..32 {
                let light = 60 + 3 * x as i32;
                let wall = [light, light / 2 + (x as i32 * 7 + y as i32 * 3) % 5, light / 2].map(|v| v as u8);
                image.pixel_mut(x, y).copy_from_slice(&wall);
            }
        }
        image.pixel_mut(5, 5).copy_from_slice(&[8, 4, 4]);
        image.pixel_mut(9, 9).copy_from_slice(&[150, 145, 120]);
        image.pixel_mut(20, 9).copy_from_slice(&[255, 252, 250]);
        let shares = wall_shares(&image, None);
        let masked: Vec<usize> = (0..1024).filter(|&i| shares[i] == 0.0).collect();
        assert_eq!(masked, [9 * 32 + 9, 9 * 32 + 20]);
    }
}
