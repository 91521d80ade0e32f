//! PSNR and SSIM of one frame.
//!
//! SSIM after Wang, Bovik, Sheikh, Simoncelli, IEEE TIP 13 (2004): window `w` 11x11 Gaussian of sigma 1.5,
//! `SSIM = (2 mu_a mu_b + C1)(2 sigma_ab + C2) / ((mu_a^2 + mu_b^2 + C1)(sigma_a^2 + sigma_b^2 + C2))` with
//! `C1 = 0.01^2`, `C2 = 0.03^2` for values in [0, 1], per colour channel.
//!
//! The value of record averages only the windows that lie wholly in the image, as Wang's own program and scikit-image
//! do: a zero border is equal in both images and would lift every score (by 0.014 for noise of 6 %, more for small
//! images). The zero-padded mean, which the Gaussian-splatting code bases print, is kept beside it. With a mask,
//! hidden pixels count nowhere: PSNR leaves them out, SSIM takes the windows that hold none of them, and the
//! zero-padded mean goes over the visible pixels as if zeros were hidden. Everything is f64: variances are differences
//! of large numbers.

use crate::base::{Image, Mask, Result};
use crate::ffi::vision::{LocalMoments, local_moments};

/// Side of the window, pixels from its centre to its rim, its sigma, and the constants of SSIM (see above).
const WINDOW: usize = 11;
const MARGIN: usize = WINDOW / 2;
const SIGMA: f64 = 1.5;
const C1: f64 = 0.01 * 0.01;
const C2: f64 = 0.03 * 0.03;

/// PSNR of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Psnr {
    /// Decibels.
    Decibel(f64),
    /// All codes are equal.
    Identical,
}

/// SSIM of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ssim {
    /// Over the windows wholly inside the image and the mask; `None` when no window is.
    pub valid: Option<f64>,
    /// Over all pixels, zeros outside.
    pub padded: f64,
}

fn decibel(mean_square: f64) -> f64 {
    -10.0 * mean_square.log10()
}

/// PSNR of images of one shape, in dB, from 8-bit codes as fractions of 255.
pub fn psnr(predicted: &Image<u8>, truth: &Image<u8>) -> Psnr {
    psnr_within(predicted, truth, None)
}

/// [`psnr`] over the visible pixels.
pub fn psnr_within(predicted: &Image<u8>, truth: &Image<u8>, mask: Option<&Mask>) -> Psnr {
    let channels = truth.channels;
    let squares: u64 = predicted
        .data
        .iter()
        .zip(&truth.data)
        .enumerate()
        .filter(|(i, _)| mask.is_none_or(|mask| mask.shows(i / channels)))
        .map(|(_, (&p, &t))| u64::from(p.abs_diff(t)) * u64::from(p.abs_diff(t)))
        .sum();
    let values = mask.map_or(truth.data.len(), |mask| mask.count() * channels);
    match squares {
        0 => Psnr::Identical,
        // Codes are integers, so the sum is exact.
        _ => Psnr::Decibel(decibel(squares as f64 / (255.0 * 255.0 * values as f64))),
    }
}

/// The PSNR of the smallest error that 8 bits can show in an image of `values` values: what an identical frame
/// counts as in a mean.
pub fn psnr_ceiling(values: usize) -> f64 {
    decibel(1.0 / (255.0 * 255.0 * values.max(1) as f64))
}

/// [`ssim`] over what is visible.
pub fn ssim_within(predicted: &Image<u8>, truth: &Image<u8>, mask: Option<&Mask>) -> Result<Ssim> {
    let Some(mask) = mask else { return ssim(predicted, truth) };
    let hidden = |image: &Image<u8>| {
        let mut image = image.clone();
        mask.hide(&mut image, 0);
        image
    };
    let (predicted, truth) = (hidden(predicted), hidden(truth));
    let (width, height, channels) = (truth.width, truth.height, truth.channels);
    // A mask that leaves room for no window leaves no value.
    let windows = mask.eroded(MARGIN).ok();
    let inside = |p: usize| {
        let (x, y) = (p % width, p / width);
        x >= MARGIN && x + MARGIN < width && y >= MARGIN && y + MARGIN < height
    };
    let whole: Vec<usize> =
        (0..width * height).filter(|&p| inside(p) && windows.as_ref().is_some_and(|w| w.shows(p))).collect();
    let (mut valid, mut padded) = (0.0, 0.0);
    for channel in 0..channels {
        let moments = local_moments(&plane(&predicted, channel), &plane(&truth, channel), width, WINDOW, SIGMA)?;
        let map = similarity(&moments);
        valid += whole.iter().map(|&p| map[p]).sum::<f64>();
        padded += (0..map.len()).filter(|&p| mask.shows(p)).map(|p| map[p]).sum::<f64>();
    }
    Ok(Ssim {
        valid: (!whole.is_empty()).then(|| valid / (whole.len() * channels) as f64),
        padded: padded / (mask.count() * channels) as f64,
    })
}

/// SSIM of images of one shape. Errors come from OpenCV alone.
pub fn ssim(predicted: &Image<u8>, truth: &Image<u8>) -> Result<Ssim> {
    let (width, height, channels) = (truth.width, truth.height, truth.channels);
    let has_window = width >= WINDOW && height >= WINDOW;
    let (mut valid, mut padded) = (0.0, 0.0);
    for channel in 0..channels {
        let moments = local_moments(&plane(predicted, channel), &plane(truth, channel), width, WINDOW, SIGMA)?;
        let map = similarity(&moments);
        padded += map.iter().sum::<f64>();
        if has_window {
            for row in map.chunks_exact(width).skip(MARGIN).take(height - 2 * MARGIN) {
                valid += row[MARGIN..width - MARGIN].iter().sum::<f64>();
            }
        }
    }
    let windows = has_window.then(|| (width - 2 * MARGIN) * (height - 2 * MARGIN) * channels);
    Ok(Ssim { valid: windows.map(|n| valid / n as f64), padded: padded / (width * height * channels) as f64 })
}

fn plane(image: &Image<u8>, channel: usize) -> Vec<f64> {
    image.data.iter().skip(channel).step_by(image.channels).map(|&code| f64::from(code) / 255.0).collect()
}

fn similarity(m: &LocalMoments) -> Vec<f64> {
    (0..m.mean_a.len())
        .map(|i| {
            let (a, b) = (m.mean_a[i], m.mean_b[i]);
            let luminance = (2.0 * a * b + C1) / (a * a + b * b + C1);
            let structure = (2.0 * m.covariance[i] + C2) / (m.variance_a[i] + m.variance_b[i] + C2);
            luminance * structure
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noisy(width: usize, height: usize, seed: u32) -> Image<u8> {
        pattern(width, height, |x, y, c| {
            let mut s = x
                .wrapping_mul(7919)
                .wrapping_add(y.wrapping_mul(104_729))
                .wrapping_add(c.wrapping_mul(1_299_709))
                .wrapping_add(seed.wrapping_mul(15_485_863));
            s ^= s >> 13;
            s = s.wrapping_mul(0x5bd1_e995);
            s ^= s >> 15;
            (((3 * x + 2 * y + 40 * c) % 256) * 3 + (s & 255)) / 4
        })
    }

    fn soft(width: usize, height: usize, seed: u32) -> Image<u8> {
        pattern(width, height, |x, y, c| (x * x / (c + 1) + y * (x / 3 + seed) + 17 * c) % 256)
    }

    fn pattern(width: usize, height: usize, value: impl Fn(u32, u32, u32) -> u32) -> Image<u8> {
        let mut image = Image::filled(width, height, 3, 0u8);
        for y in 0..height {
            for x in 0..width {
                for c in 0..3 {
                    image.pixel_mut(x, y)[c] = value(x as u32, y as u32, c as u32) as u8;
                }
            }
        }
        image
    }

    /// Values of scikit-image 0.26.0 (`structural_similarity` with `gaussian_weights`, `sigma=1.5`,
    /// `use_sample_covariance=False`, per channel; `peak_signal_noise_ratio`), and of SciPy's `correlate1d` with
    /// `mode="constant"` for the padded mean.
    #[test]
    fn values_equal_scikit_image() {
        let pairs = [
            (
                noisy(40, 32, 1),
                noisy(40, 32, 2),
                0.139_758_451_245_877_02,
                0.378_681_089_163_040_4,
                19.986_208_457_274_962,
            ),
            (
                noisy(40, 32, 1),
                soft(40, 32, 1),
                0.097_496_285_331_977_8,
                0.228_791_855_890_606_55,
                10.469_554_074_897_387,
            ),
            (soft(23, 57, 3), soft(23, 57, 4), 0.449_198_793_613_371, 0.557_800_055_823_461_9, 10.497_493_220_888_93),
            (
                noisy(11, 11, 5),
                noisy(11, 11, 6),
                0.185_454_990_918_944_16,
                0.639_663_892_461_818_4,
                19.679_515_572_810_23,
            ),
        ];
        for (a, b, valid, padded, decibels) in pairs {
            let found = ssim(&a, &b).unwrap();
            assert!((found.valid.unwrap() - valid).abs() < 1e-9, "{found:?} {valid}");
            assert!((found.padded - padded).abs() < 1e-9, "{found:?} {padded}");
            let Psnr::Decibel(found) = psnr(&a, &b) else { panic!("the images differ") };
            assert!((found - decibels).abs() < 1e-9, "{found} {decibels}");
        }
    }

    #[test]
    fn equal_images_are_perfect_even_when_black_or_white() {
        for image in [noisy(30, 20, 1), Image::filled(16, 16, 3, 0), Image::filled(16, 16, 3, 255)] {
            assert_eq!(psnr(&image, &image), Psnr::Identical);
            let found = ssim(&image, &image).unwrap();
            assert!((found.valid.unwrap() - 1.0).abs() < 1e-12 && (found.padded - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn a_mask_leaves_out_what_it_hides_to_the_bit() {
        let (width, height) = (40, 32);
        let (truth, predicted) = (noisy(width, height, 1), soft(width, height, 1));
        // Right half visible.
        let image = pattern(width, height, |x, _, _| if x >= 20 { 255 } else { 0 });
        let mask = Mask::from_image(&image).unwrap();
        let right = |image: &Image<u8>| {
            let rows = image.data.chunks_exact(width * 3).flat_map(|row| row[20 * 3..].iter().copied());
            Image { width: 20, height, channels: 3, data: rows.collect() }
        };
        let found = ssim_within(&predicted, &truth, Some(&mask)).unwrap();
        assert!(
            (found.valid.unwrap() - ssim(&right(&predicted), &right(&truth)).unwrap().valid.unwrap()).abs() < 1e-12
        );
        assert_eq!(psnr_within(&predicted, &truth, Some(&mask)), psnr(&right(&predicted), &right(&truth)));
        let mut painted = predicted.clone();
        for (p, pixel) in painted.data.chunks_exact_mut(3).enumerate().filter(|(p, _)| p % width < 20) {
            pixel.fill((p * 37 % 256) as u8);
        }
        assert_eq!(ssim_within(&painted, &truth, Some(&mask)).unwrap(), found);
        assert_eq!(psnr_within(&painted, &truth, Some(&mask)), psnr_within(&predicted, &truth, Some(&mask)));
        assert!((found.padded - ssim(&predicted, &truth).unwrap().padded).abs() > 1e-4);
    }

    #[test]
    fn a_constant_offset_has_a_closed_form() {
        let a = Image::filled(20, 20, 3, 100u8);
        let b = Image::filled(20, 20, 3, 151u8);
        assert_eq!(psnr(&a, &b), Psnr::Decibel(-20.0 * 0.2f64.log10()));
        assert!(psnr_ceiling(1200) > 78.0);
    }

    #[test]
    fn an_image_smaller_than_a_window_has_no_valid_value() {
        let found = ssim(&noisy(10, 40, 1), &noisy(10, 40, 2)).unwrap();
        assert_eq!(found.valid, None);
        assert!(found.padded.is_finite());
        assert!(ssim(&noisy(1, 1, 1), &noisy(1, 1, 2)).unwrap().padded.is_finite());
    }
}
