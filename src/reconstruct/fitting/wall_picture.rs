//! A picture against the wall: the normal equations of local contrasts.
//!
//! Both the picture `I` and the wall's expected picture `R` ([`lit_picture`]) are turned into local contrast,
//! `C = (I - B) / (B + floor)` with `B` the local mean, which exposure and slow changes of the light do not touch. A film on
//! the lens and light between walls take contrast away, so the gain `g` that fits best is eliminated:
//!
//!   r = C_I - g C_R,   g = sum m C_I C_R / sum m C_R^2,   J = g (dC_R - C_R sum w C_R dC_R / sum w C_R^2)
//!
//! `m` is the share of a pixel that is wall, and 0 where that is a half or less; weights `w` are `m` times Huber's (1964)
//! with a robust scale.

use nalgebra::{DMatrix, DVector};

use crate::base::color::{POWER_LAW, linear_from_srgb};
use crate::base::statistics::robust_deviation;
use crate::base::{Camera, Image};
use crate::reconstruct::fitting::contrast::{Surroundings, agreement};
use crate::reconstruct::geometry::lit_wall::{LitPicture, LitView, NearWall, PICTURE, lit_picture, smoothed};
use crate::reconstruct::geometry::pyramid::PyramidLevel;
use crate::reconstruct::settings::PictureMatching;
use crate::splat::View;

/// Pixels of which no more than this share is wall do not count.
const MOST_MASKED: f32 = 0.5;
/// Smallest robust scale of the residuals, in units of contrast.
const SMALLEST_SCALE: f32 = 0.01;
/// Share of the pixels whose wall may be so near that it says nothing.
const MOST_TOUCHING: f32 = 0.4;
/// Pictures are not halved below this many pixels a side.
const SMALLEST_PX: usize = 8;
/// Fewer pixels say nothing.
const FEWEST_PIXELS: f32 = 64.0;

/// Longest Gauss-Newton steps of an angle (rad), of a shift (mm) and of the phase: slopes say nothing beyond.
pub const LONGEST_STEPS: [f64; 3] = [0.12, 1.5, 0.15];

/// One resolution of a picture, as contrast.
pub struct PictureLevel {
    /// The told camera at this resolution.
    pub camera: Camera,
    /// Gauss-Newton steps at this resolution.
    pub steps: u32,
    contrast: Vec<f32>,
    /// A pixel that does not show the wall does not count.
    around: Surroundings,
}

/// What a picture says at one resolution.
pub struct PictureEquations {
    /// `sum w J^T J / scale^2`, in the order of [`PICTURE`]'s unknowns, with so many pixels as one observation as were asked for.
    pub hessian: DMatrix<f64>,
    /// `sum w J^T r / scale^2`, likewise.
    pub gradient: DVector<f64>,
    /// Weight `w` of each pixel, 0 to 1.
    pub weights: Vec<f32>,
}

/// Green of an 8-bit picture in the power law, one channel: the red of tissue clips first.
fn green(image: &Image<u8>) -> Image<f32> {
    let table: Vec<f32> = (0..256).map(|code| linear_from_srgb(code as f32 / 255.0).powf(1.0 / POWER_LAW)).collect();
    let data = image.data.chunks_exact(3).map(|pixel| table[pixel[1] as usize]).collect();
    Image { width: image.width, height: image.height, channels: 1, data }
}

/// The resolutions of `image`, coarse to fine; `wall` is how much each pixel shows of the wall, 0 to 1.
pub fn picture_levels(
    settings: &PictureMatching,
    camera: &Camera,
    image: &Image<u8>,
    wall: &[f32],
) -> Vec<PictureLevel> {
    let at = View::new(*camera, glam::DAffine3::IDENTITY);
    let full = |image: Image<f32>| PyramidLevel { view: at, image, weights: Vec::new() };
    let (mut level, mut shows) = (full(green(image)), full(Image { data: wall.to_vec(), ..green(image) }));
    while level.image.width > *settings.largest_width as usize && level.image.height > 1 {
        (level, shows) = (level.halved(), shows.halved());
    }
    let mut levels = Vec::new();
    for &steps in settings.steps.iter().rev() {
        if level.image.width.min(level.image.height) < SMALLEST_PX {
            break;
        }
        if steps > 0 {
            levels.insert(0, contrast_level(settings, &level, &shows.image.data, steps));
        }
        (level, shows) = (level.halved(), shows.halved());
    }
    levels
}

fn contrast_level(settings: &PictureMatching, level: &PyramidLevel, shows: &[f32], steps: u32) -> PictureLevel {
    let width = level.image.width;
    let weights: Vec<f32> = shows.iter().map(|&w| if w > 1.0 - MOST_MASKED { w } else { 0.0 }).collect();
    let around = Surroundings::new(weights, width, *settings.contrast_radius);
    let (contrast, _) = around.contrast(&smoothed(&level.image.data, width));
    PictureLevel { camera: level.view.camera, steps, contrast, around }
}

impl PictureLevel {
    /// Correlation of this picture with the wall as seen from `lit`; 0 where one of them is even, and where most of the
    /// wall touches the lens.
    pub fn correlation(&self, wall: &NearWall, lit: &LitView) -> f64 {
        let picture = lit_picture(wall, lit, false);
        if picture.touching > MOST_TOUCHING {
            return 0.0;
        }
        let (expected, _) = self.around.contrast(&picture.brightness);
        agreement(&self.contrast, &expected, self.around.weights()).correlation
    }

    /// The normal equations at `lit`, with `together_px` pixels as one observation; `None` where too little of the wall is
    /// seen.
    pub fn equations(
        &self,
        settings: &PictureMatching,
        together_px: f64,
        wall: &NearWall,
        lit: &LitView,
    ) -> Option<PictureEquations> {
        let counts = self.around.weights();
        if self.around.total() < FEWEST_PIXELS {
            return None;
        }
        let LitPicture { brightness, slopes, .. } = lit_picture(wall, lit, true);
        let (expected, divisor) = self.around.contrast(&brightness);
        let gain = agreement(&self.contrast, &expected, counts).gain;
        if gain <= 0.0 {
            return None;
        }
        let gain = gain as f32;

        // Residuals and their robust weights.
        let residuals: Vec<f32> = self.contrast.iter().zip(&expected).map(|(i, r)| i - gain * r).collect();
        let sizes = residuals.iter().zip(counts).filter(|(_, w)| **w > 0.0).map(|(r, _)| r.abs());
        let scale = robust_deviation(sizes)?.max(SMALLEST_SCALE);
        let limit = *settings.huber as f32 * scale;
        let weights: Vec<f32> = residuals.iter().zip(counts).map(|(r, w)| w * limit / r.abs().max(limit)).collect();

        // The contrast's derivatives: dC = (dR - dB (1 + C)) / (B + floor), without what the gain explains.
        let square: f64 = expected.iter().zip(&weights).map(|(c, w)| f64::from(w * c * c)).sum();
        let column = |slope: &Vec<f32>| -> Vec<f32> {
            let mean = self.around.mean(slope);
            let own = slope.iter().zip(&mean).zip(&expected).zip(&divisor);
            let mut column: Vec<f32> = own.map(|(((d, b), c), v)| (d - b * (1.0 + c)) / v).collect();
            let along = column.iter().zip(&expected).zip(&weights).map(|((j, c), w)| f64::from(w * c * j)).sum::<f64>();
            let share = (along / square.max(1e-12)) as f32;
            column.iter_mut().zip(&expected).for_each(|(j, c)| *j = gain * (*j - share * c));
            column
        };
        let columns: Vec<Vec<f32>> = slopes.iter().map(column).collect();
        let per_pixel = 1.0 / (f64::from(scale * scale) * together_px);
        let mut hessian = DMatrix::zeros(PICTURE, PICTURE);
        let mut gradient = DVector::zeros(PICTURE);
        for a in 0..PICTURE {
            let weighted: Vec<f32> = columns[a].iter().zip(&weights).map(|(j, w)| j * w).collect();
            let sum =
                |other: &[f32]| per_pixel * weighted.iter().zip(other).map(|(j, v)| f64::from(j * v)).sum::<f64>();
            gradient[a] = sum(&residuals);
            for b in 0..=a {
                hessian[(a, b)] = sum(&columns[b]);
                hessian[(b, a)] = hessian[(a, b)];
            }
        }
        Some(PictureEquations { hessian, gradient, weights })
    }
}
