//! OpenCV: separable Gaussian filtering for SSIM, contour analysis. `Mat` never leaves this file.

use opencv::core::{self, Mat, MatTraitConstManual, Point, Point2f, Vector};
use opencv::imgproc;

use crate::base::{Error, ErrorKind, Result};

/// Version of the OpenCV library that is linked.
pub fn version() -> String {
    core::get_version_string().unwrap_or_else(|_| "unknown".into())
}

fn refused(error: opencv::Error) -> Error {
    Error::new(ErrorKind::Environment, format!("OpenCV refuses: {}", error.message))
}

/// Normalised one-dimensional Gaussian of odd `size`.
struct GaussianKernel(Mat);

impl GaussianKernel {
    fn new(size: usize, sigma: f64) -> Result<Self> {
        imgproc::get_gaussian_kernel(size as i32, sigma, core::CV_64F).map(GaussianKernel).map_err(refused)
    }

    /// `plane` (row-major, `width` values a row) filtered along rows and columns; zero outside the plane.
    fn filter(&self, plane: &[f64], width: usize) -> Result<Vec<f64>> {
        let height = plane.len() / width;
        let source = Mat::new_rows_cols_with_data(height as i32, width as i32, plane).map_err(refused)?;
        let mut filtered = Mat::default();
        imgproc::sep_filter_2d(
            &source,
            &mut filtered,
            core::CV_64F,
            &self.0,
            &self.0,
            Point::new(-1, -1),
            0.0,
            core::BORDER_CONSTANT,
        )
        .map_err(refused)?;
        filtered.data_typed::<f64>().map(<[f64]>::to_vec).map_err(refused)
    }
}

/// Gaussian-weighted local moments of two planes: means, variances and covariance at every pixel.
#[derive(Clone, Debug)]
pub struct LocalMoments {
    /// Mean of the first plane.
    pub mean_a: Vec<f64>,
    /// Mean of the second plane.
    pub mean_b: Vec<f64>,
    /// Population variance of the first plane.
    pub variance_a: Vec<f64>,
    /// Population variance of the second plane.
    pub variance_b: Vec<f64>,
    /// Population covariance.
    pub covariance: Vec<f64>,
}

/// [`LocalMoments`] of `a` and `b` (row-major, `width` values a row, f64 throughout) under a Gaussian window of
/// `size` x `size` pixels and standard deviation `sigma`. Five separable filters of OpenCV; outside the planes is 0.
///
/// Errors: planes that are empty or differ in size.
pub fn local_moments(a: &[f64], b: &[f64], width: usize, size: usize, sigma: f64) -> Result<LocalMoments> {
    if a.len() != b.len() || width == 0 || a.is_empty() || !a.len().is_multiple_of(width) {
        return Err(Error::input(format!("planes of {} and {} values in rows of {width}", a.len(), b.len())));
    }
    let kernel = GaussianKernel::new(size, sigma)?;
    let product = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(x, y)| x * y).collect::<Vec<f64>>();
    let mean_a = kernel.filter(a, width)?;
    let mean_b = kernel.filter(b, width)?;
    let central = |x: &[f64], y: &[f64], mean_x: &[f64], mean_y: &[f64]| -> Result<Vec<f64>> {
        let mut second = kernel.filter(&product(x, y), width)?;
        for (value, (mean_x, mean_y)) in second.iter_mut().zip(mean_x.iter().zip(mean_y)) {
            *value -= mean_x * mean_y;
        }
        Ok(second)
    };
    let variance_a = central(a, a, &mean_a, &mean_a)?;
    let variance_b = central(b, b, &mean_b, &mean_b)?;
    let covariance = central(a, b, &mean_a, &mean_b)?;
    Ok(LocalMoments { mean_a, mean_b, variance_a, variance_b, covariance })
}

/// A closed contour in a plane, held for OpenCV's contour analysis (single precision, as OpenCV has it).
pub struct PlaneContour(Vector<Point2f>);

impl PlaneContour {
    /// The contour through `points`, the last joined to the first.
    pub fn new(points: &[[f64; 2]]) -> Self {
        PlaneContour(points.iter().map(|p| Point2f::new(p[0] as f32, p[1] as f32)).collect())
    }

    /// True when `point` lies inside or on the contour (`pointPolygonTest`).
    pub fn encloses(&self, point: [f64; 2]) -> Result<bool> {
        let point = Point2f::new(point[0] as f32, point[1] as f32);
        imgproc::point_polygon_test(&self.0, point, false).map(|side| side >= 0.0).map_err(refused)
    }

    /// Enclosed area (`contourArea`).
    pub fn area(&self) -> Result<f64> {
        imgproc::contour_area(&self.0, false).map_err(refused)
    }

    /// Length all the way round (`arcLength`).
    pub fn length(&self) -> Result<f64> {
        imgproc::arc_length(&self.0, true).map_err(refused)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn opencv_answers() {
        assert!(version().starts_with('4'), "{}", version());
    }

    #[test]
    fn moments_of_constants_are_exact_away_from_the_border() {
        let (a, b) = (vec![0.25; 20 * 16], vec![0.5; 20 * 16]);
        let m = local_moments(&a, &b, 20, 11, 1.5).unwrap();
        let centre = 8 * 20 + 10;
        assert!((m.mean_a[centre] - 0.25).abs() < 1e-15 && (m.mean_b[centre] - 0.5).abs() < 1e-15);
        assert!(m.variance_a[centre].abs() < 1e-15 && m.covariance[centre].abs() < 1e-15);
        // Outside is 0, so the window at a corner holds about a quarter of the plane.
        assert!(m.mean_a[0] < 0.12);
        assert!(local_moments(&a, &b[1..], 20, 11, 1.5).is_err());
    }

    #[test]
    fn a_square_is_analysed() {
        let square = PlaneContour::new(&[[0., 0.], [4., 0.], [4., 4.], [0., 4.]]);
        assert_eq!(square.area().unwrap(), 16.0);
        assert_eq!(square.length().unwrap(), 16.0);
        assert!(square.encloses([1.0, 1.0]).unwrap() && !square.encloses([5.0, 1.0]).unwrap());
    }
}
