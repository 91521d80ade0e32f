//! The local contrast of an image, `(I - B) / (B + floor)` with `B` the mean over a neighbourhood. Large-scale
//! changes of light do not affect it.

use rayon::prelude::*;

use crate::base::Image;

/// Added to the local mean (image values, 0..1), so that darker areas have little contrast.
const CONTRAST_FLOOR: f32 = 0.05;

/// Added to the local mean of a plane, as a share of the plane's mean, for the same reason.
const PLANE_FLOOR: f32 = 0.15;

/// The local contrast of an image.
pub struct ContrastImage {
    /// Three channels.
    pub contrast: Image<f32>,
    /// Whether a pixel shows anything.
    pub counts: Vec<bool>,
}

/// Local contrast `(I - B) / (B + floor)` of `image`, `B` its mean over a square of half width `radius_share` of the
/// image's width (averaged twice), per channel.
pub fn contrast_image(image: &Image<f32>, weights: &[f32], radius_share: f64) -> ContrastImage {
    let (width, pixels) = (image.width, image.width * image.height);
    let counts: Vec<bool> = (0..pixels).map(|i| weights.get(i).is_none_or(|&w| w > 0.0)).collect();
    let radius = ((width as f64 * radius_share).round() as usize).max(1);
    // The fourth plane counts the valid pixels in the neighbourhood.
    let value = |i: usize, c: usize| if c < 3 { image.data[3 * i + c] } else { 1.0 };
    let averaged = |c: usize| {
        summed_around((0..pixels).map(|i| if counts[i] { value(i, c) } else { 0.0 }).collect(), width, radius)
    };
    let planes: Vec<Vec<f32>> = (0..4).into_par_iter().map(averaged).collect();
    let mut contrast = Image::filled(width, image.height, 3, 0.0f32);
    for i in (0..pixels).filter(|&i| counts[i]) {
        for (c, plane) in planes[..3].iter().enumerate() {
            let mean = plane[i] / planes[3][i];
            contrast.data[3 * i + c] = (value(i, c) - mean) / (mean + CONTRAST_FLOOR);
        }
    }
    ContrastImage { contrast, counts }
}

/// The surroundings of each pixel of a plane: a square, averaged over twice, of the pixels that count.
pub struct Surroundings {
    width: usize,
    radius: usize,
    weights: Vec<f32>,
    /// Sum of the weights around each pixel.
    counted: Vec<f32>,
    total: f32,
}

impl Surroundings {
    /// Of planes with rows of `width`; `weights` says how much a pixel counts, the square's half width is
    /// `radius_share` of the row, and at least one pixel.
    pub fn new(weights: Vec<f32>, width: usize, radius_share: f64) -> Surroundings {
        let radius = ((width as f64 * radius_share).round() as usize).max(1);
        let counted = summed_around(weights.clone(), width, radius);
        Surroundings { width, radius, total: weights.iter().sum(), counted, weights }
    }

    /// How much each pixel counts.
    pub fn weights(&self) -> &[f32] {
        &self.weights
    }

    /// Sum of the weights.
    pub fn total(&self) -> f32 {
        self.total
    }

    /// The weighted mean of `plane` around each pixel.
    pub fn mean(&self, plane: &[f32]) -> Vec<f32> {
        let weighted = plane.iter().zip(&self.weights).map(|(v, w)| v * w).collect();
        let sums = summed_around(weighted, self.width, self.radius);
        sums.iter().zip(&self.counted).map(|(s, c)| if *c > 0.0 { s / c } else { 0.0 }).collect()
    }

    /// The local contrast of `plane`, whose unit need not be known, and the divisor `B + floor` of each pixel.
    pub fn contrast(&self, plane: &[f32]) -> (Vec<f32>, Vec<f32>) {
        let around = self.mean(plane);
        let mean = plane.iter().zip(&self.weights).map(|(v, w)| v * w).sum::<f32>() / self.total.max(1e-6);
        let divisor: Vec<f32> = around.iter().map(|b| b + PLANE_FLOOR * mean + 1e-9).collect();
        (plane.iter().zip(&around).zip(&divisor).map(|((v, b), d)| (v - b) / d).collect(), divisor)
    }
}

/// How the contrasts of two planes agree; both are 0 where one plane is even.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Agreement {
    /// `sum w a b / sum w b^2`: the factor on the second that fits best.
    pub gain: f64,
    /// `sum w a b / sqrt(sum w a^2 sum w b^2)`.
    pub correlation: f64,
}

/// How `a` and `b` agree under `weights`.
pub fn agreement(a: &[f32], b: &[f32], weights: &[f32]) -> Agreement {
    let (mut both, mut own, mut other) = (0.0f64, 0.0f64, 0.0f64);
    for ((a, b), w) in a.iter().zip(b).zip(weights) {
        let (a, b, w) = (f64::from(*a), f64::from(*b), f64::from(*w));
        (both, own, other) = (both + w * a * b, own + w * a * a, other + w * b * b);
    }
    if own > 0.0 && other > 0.0 {
        Agreement { gain: both / other, correlation: both / (own * other).sqrt() }
    } else {
        Agreement::default()
    }
}

/// Sums of `plane`, whose rows have `width` pixels, over squares of `2 radius + 1` pixels a side, twice; zero outside.
fn summed_around(mut plane: Vec<f32>, width: usize, radius: usize) -> Vec<f32> {
    let height = plane.len() / width;
    for _ in 0..2 {
        sum_rows(&mut plane, width, radius);
        plane = transposed(&plane, width);
        sum_rows(&mut plane, height, radius);
        plane = transposed(&plane, height);
    }
    plane
}

/// Sums over `2 radius + 1` pixels along rows of `width`, zero outside.
fn sum_rows(plane: &mut [f32], width: usize, radius: usize) {
    let mut row = vec![0.0f32; width];
    for values in plane.chunks_exact_mut(width) {
        row.copy_from_slice(values);
        let mut sum: f32 = row.iter().take(radius).sum();
        for (i, value) in values.iter_mut().enumerate() {
            sum += row.get(i + radius).unwrap_or(&0.0);
            if i > radius {
                sum -= row[i - radius - 1];
            }
            *value = sum;
        }
    }
}

/// The transpose of a plane with rows of `width`.
fn transposed(plane: &[f32], width: usize) -> Vec<f32> {
    let height = plane.len() / width;
    (0..plane.len()).map(|i| plane[(i % height) * width + i / height]).collect()
}
