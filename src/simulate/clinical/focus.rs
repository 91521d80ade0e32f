//! Blur of the picture, from what is known of every pixel: how the tissue that it shows moves over the image while the
//! shutter is open, and how far from the lens it is. One rendering is enough, where a mean over renderings would cost
//! one for each moment; what comes into view within the exposure is missing (a fringe of the blur's width at edges).

use glam::DVec2;
use rayon::prelude::*;

use crate::base::{Camera, Image};

/// Samples along the way of a pixel are at most this far apart, in pixels, and at most so many.
const SAMPLE_PX: f64 = 0.7;
const MOST_SAMPLES: usize = 48;
/// Circles of confusion below this radius in pixels are points; above the other they are cut.
const LEAST_RADIUS_PX: f64 = 0.3;
const MOST_RADIUS_PX: f64 = 24.0;

/// `radiance` as an open shutter gathers it: `motion_px` is, per pixel, the way over the image of the tissue there
/// from opening to closing.
pub fn moved(radiance: &Image<f32>, motion_px: &[DVec2]) -> Image<f32> {
    let mut out = radiance.clone();
    let width = radiance.width;
    out.data.par_chunks_exact_mut(3 * width).enumerate().for_each(|(y, row)| {
        for (x, pixel) in row.chunks_exact_mut(3).enumerate() {
            let way = motion_px[y * width + x];
            let samples = ((way.length() / SAMPLE_PX).ceil() as usize + 1).min(MOST_SAMPLES);
            if samples < 2 {
                continue;
            }
            let mut sum = [0.0f64; 3];
            for k in 0..samples {
                let part = (k as f64 + 0.5) / samples as f64 - 0.5;
                let at = DVec2::new(x as f64, y as f64) + way * part;
                let seen = sampled(radiance, at);
                (0..3).for_each(|c| sum[c] += seen[c]);
            }
            (0..3).for_each(|c| pixel[c] = (sum[c] / samples as f64) as f32);
        }
    });
    out
}

/// The image between pixel centres, which are at whole numbers here.
fn sampled(image: &Image<f32>, at: DVec2) -> [f64; 3] {
    let x = at.x.clamp(0.0, (image.width - 1) as f64);
    let y = at.y.clamp(0.0, (image.height - 1) as f64);
    let (left, top) = (x.floor() as usize, y.floor() as usize);
    let (right, bottom) = ((left + 1).min(image.width - 1), (top + 1).min(image.height - 1));
    let (s, t) = (x - left as f64, y - top as f64);
    let value = |x: usize, y: usize, c: usize| f64::from(image.data[(y * image.width + x) * 3 + c]);
    [0, 1, 2].map(|c| {
        let upper = value(left, top, c) * (1.0 - s) + value(right, top, c) * s;
        let lower = value(left, bottom, c) * (1.0 - s) + value(right, bottom, c) * s;
        upper * (1.0 - t) + lower * t
    })
}

/// Radius in pixels of the circle that a point at `depth_mm` makes: a lens of the opening `aperture_mm`, focused so that
/// all is sharp from `sharp_from_mm` on, spreads a nearer point over `aperture (1 / depth - 1 / sharp)` in units of the
/// focal length.
pub fn circle_px(camera: &Camera, depth_mm: f64, aperture_mm: f64, sharp_from_mm: f64) -> f64 {
    if depth_mm <= 0.0 {
        return 0.0;
    }
    (0.5 * camera.fl_x * aperture_mm * (1.0 / depth_mm - 1.0 / sharp_from_mm)).clamp(0.0, MOST_RADIUS_PX)
}

/// `radiance` with every pixel's light spread over its circle of `radius_px`: a pixel gathers from each neighbour in
/// whose circle it lies.
pub fn defocused(radiance: Image<f32>, radius_px: &[f64]) -> Image<f32> {
    let most = radius_px.iter().copied().fold(0.0, f64::max);
    if most <= LEAST_RADIUS_PX {
        return radiance;
    }
    let (width, height) = (radiance.width, radiance.height);
    // How far a pixel must look: the largest circle within the widest reach, by rows and then by columns.
    let reach = (most + 0.5).ceil() as usize;
    let near = widest(&widest(radius_px, width, height, reach, 1), width, height, reach, width);
    let mut out = radiance.clone();
    out.data.par_chunks_exact_mut(3 * width).enumerate().for_each(|(y, row)| {
        for (x, pixel) in row.chunks_exact_mut(3).enumerate() {
            let around = near[y * width + x];
            if around <= LEAST_RADIUS_PX {
                continue;
            }
            let reach = (around + 0.5).ceil() as usize;
            let (mut sum, mut total) = ([0.0f64; 3], 0.0f64);
            for v in y.saturating_sub(reach)..(y + reach + 1).min(height) {
                for u in x.saturating_sub(reach)..(x + reach + 1).min(width) {
                    let from = v * width + u;
                    let radius = radius_px[from].max(LEAST_RADIUS_PX);
                    let (dx, dy) = (u as f64 - x as f64, v as f64 - y as f64);
                    // The part of this pixel that the circle covers, and the circle's area.
                    let covered = (radius + 0.5 - (dx * dx + dy * dy).sqrt()).clamp(0.0, 1.0);
                    if covered > 0.0 {
                        let weight = covered / (radius * radius).max(0.25);
                        (0..3).for_each(|c| sum[c] += weight * f64::from(radiance.data[3 * from + c]));
                        total += weight;
                    }
                }
            }
            (0..3).for_each(|c| pixel[c] = (sum[c] / total) as f32);
        }
    });
    out
}

/// Largest of the values within `reach` along rows (`stride` 1) or columns.
fn widest(values: &[f64], width: usize, height: usize, reach: usize, stride: usize) -> Vec<f64> {
    let (length, is_row) = if stride == 1 { (width, true) } else { (height, false) };
    (0..width * height)
        .into_par_iter()
        .map(|p| {
            let place = if is_row { p % width } else { p / width };
            let (low, high) = (place.saturating_sub(reach), (place + reach).min(length - 1));
            (low..=high).map(|k| values[p + k * stride - place * stride]).fold(0.0, f64::max)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn edge() -> Image<f32> {
        let mut image = Image::filled(40, 20, 3, 0.1f32);
        for y in 0..20 {
            (20..40).for_each(|x| image.pixel_mut(x, y).copy_from_slice(&[0.9; 3]));
        }
        image
    }

    /// Columns of a row from the first that is off the dark side to the last that is off the bright one.
    fn spread(image: &Image<f32>) -> usize {
        (0..40).filter(|&x| (0.105..0.895).contains(&image.pixel(x, 10)[1])).count()
    }

    #[test]
    fn an_edge_is_spread_over_the_way_that_it_moves() {
        assert_eq!(moved(&edge(), &[DVec2::ZERO; 800]), edge());
        let across = moved(&edge(), &[DVec2::new(8.0, 0.0); 800]);
        assert!((7..=9).contains(&spread(&across)), "{}", spread(&across));
        assert_eq!(spread(&moved(&edge(), &[DVec2::new(0.0, 8.0); 800])), 0);
        let mean = |image: &Image<f32>| image.data.iter().map(|v| f64::from(*v)).sum::<f64>() / 2400.0;
        assert!((mean(&across) - mean(&edge())).abs() < 1e-6);
    }

    #[test]
    fn near_points_become_circles_of_the_lens_equation() {
        let camera = Camera::pinhole(256, 256, 100f64.to_radians());
        let at = |depth| circle_px(&camera, depth, 0.1, 3.0);
        assert_eq!((at(3.0), at(50.0), at(0.0)), (0.0, 0.0, 0.0));
        assert!((at(1.0) - 0.5 * camera.fl_x * 0.1 * (1.0 - 1.0 / 3.0)).abs() < 1e-12);
        assert_eq!(defocused(edge(), &[0.0; 800]), edge());
        let soft = defocused(edge(), &[3.0; 800]);
        assert!((5..=8).contains(&spread(&soft)), "{}", spread(&soft));
        let mut point = Image::filled(40, 20, 3, 0.0f32);
        point.pixel_mut(20, 10).copy_from_slice(&[1.0; 3]);
        let circle = defocused(point, &[3.0; 800]);
        let light: f32 = circle.data.iter().sum::<f32>() / 3.0;
        assert!((light - 1.0).abs() < 1e-4, "light is kept: {light}");
        assert!(circle.pixel(23, 10)[0] > 0.01 && circle.pixel(24, 10)[0] == 0.0);
        // Only the near half is soft, and its light reaches over the edge.
        let near: Vec<f64> = (0..800).map(|p| if p % 40 >= 20 { 3.0 } else { 0.0 }).collect();
        let half = defocused(edge(), &near);
        assert!(half.pixel(15, 10)[0] < 0.11 && half.pixel(19, 10)[0] > 0.1);
    }
}
