//! C3VD's folder: `NNNN_color.png`, `NNNN_depth.tiff`, `pose.txt`, and the intrinsics of an omnidirectional camera.
//!
//! What its readers assume, by the loader of DurrLab/C3VD and by EndoGSLAM's: depth is 16 bits, 65535 codes to 100 mm,
//! where 0 and 65535 are no depth; z-depth; a pose is a line of 16 numbers between commas, world from camera column by
//! column, camera axes OpenCV's; millimetres; pixel centres at integers. The camera is Scaramuzza's (2006): the ray of
//! a pixel at (u, v) from the centre, rho = |(u, v)|, is (u, v, a0 + a2 rho^2 + a3 rho^3 + a4 rho^4). A pinhole is one
//! exactly (a0 is its focal length); of a fisheye the polynomial is fitted, and the worst misfit in pixels is stated.

use std::fmt::Write as _;
use std::sync::atomic::{AtomicUsize, Ordering};

use glam::DVec2;
use nalgebra::{DMatrix, DVector};

use super::source::ExportSource;
use super::writer::{ExportWriter, LayoutText, filled};
use crate::base::{Camera, Error, Image, Result, files};
use crate::formats::{png, tiff_grey};

/// Depth in mm of the largest code.
const FURTHEST_MM: f64 = 100.0;
/// Radii at which the polynomial is fitted.
const FIT_RADII: usize = 400;

/// Scaramuzza's intrinsics.
#[derive(Clone, Copy, Debug)]
struct Omnidirectional {
    centre: DVec2,
    /// a0, a2, a3, a4.
    polynomial: [f64; 4],
    /// Stretch of the columns: `c` of the matrix whose rows are `c d` and `e 1`.
    stretch: f64,
    /// Largest distance in pixels between where the two cameras see a ray.
    misfit_px: f64,
}

impl Omnidirectional {
    /// Of `camera`: least squares over the radii of its image, in rows' pixels.
    fn of(camera: &Camera) -> Result<Omnidirectional> {
        let (stretch, focal) = (camera.fl_x / camera.fl_y, camera.fl_y);
        // C3VD's pixel centres are integers.
        let centre = DVec2::new(camera.cx - 0.5, camera.cy - 0.5);
        let mut intrinsics = Omnidirectional { centre, polynomial: [focal, 0.0, 0.0, 0.0], stretch, misfit_px: 0.0 };
        if camera.fisheye.is_none() {
            return Ok(intrinsics);
        }
        let corner = |x: f64, y: f64| DVec2::new((x - camera.cx) / stretch, y - camera.cy).length();
        let (w, h) = (f64::from(camera.width), f64::from(camera.height));
        let furthest =
            [(0.0, 0.0), (w, 0.0), (0.0, h), (w, h)].into_iter().map(|(x, y)| corner(x, y)).fold(0.0, f64::max);
        let radii: Vec<f64> = (1..=FIT_RADII).map(|k| furthest * k as f64 / FIT_RADII as f64).collect();
        // The angle to the axis at each radius, along a row of the image.
        let angle = |radius: f64| {
            let ray = camera.direction(DVec2::new(camera.cx + radius * stretch, camera.cy));
            ray.x.atan2(ray.z)
        };
        // Radii as parts of the furthest keep the powers alike.
        let power = |radius: f64, k: i32| (radius / furthest).powi(k);
        let rows = DMatrix::from_fn(FIT_RADII, 4, |row, column| power(radii[row], [0, 2, 3, 4][column]));
        let wanted = DVector::from_iterator(FIT_RADII, radii.iter().map(|&radius| radius / angle(radius).tan()));
        let failed = |e: &str| Error::input(format!("no omnidirectional camera fits the fisheye: {e}"));
        let fitted = rows.svd(true, true).solve(&wanted, 1e-12).map_err(failed)?;
        let unit = |k: usize| power(1.0, [0, 2, 3, 4][k]);
        intrinsics.polynomial = std::array::from_fn(|k| fitted[k] * unit(k));
        let misfit = |&radius: &f64| (radius.atan2(intrinsics.z(radius)) - angle(radius)).abs() * focal;
        intrinsics.misfit_px = radii.iter().map(misfit).fold(0.0, f64::max);
        Ok(intrinsics)
    }

    /// Third coordinate of the ray at a radius in pixels.
    fn z(&self, radius: f64) -> f64 {
        let [a0, a2, a3, a4] = self.polynomial;
        a0 + radius * radius * (a2 + radius * (a3 + radius * a4))
    }
}

/// Writes the folder.
pub(super) fn write(source: &ExportSource, writer: &ExportWriter<'_>) -> Result<LayoutText> {
    let intrinsics = Omnidirectional::of(&source.camera)?;
    let too_far = AtomicUsize::new(0);
    writer.each_frame(source.frames.len(), |frame| {
        let mut image = source.image(frame)?;
        let mut codes = source
            .depth_mm(frame)?
            .map(|d| (f64::from(d) / FURTHEST_MM * 65_535.0).round().clamp(0.0, 65_535.0) as u16);
        let far = codes.data.iter().filter(|&&code| code == u16::MAX).count();
        too_far.fetch_add(far, Ordering::Relaxed);
        if let Some(mask) = &source.mask {
            mask.hide(&mut image, 0);
            mask.hide(&mut codes, 0);
        }
        png::write_rgb(&writer.path(format!("{frame:04}_color.png")), &image)?;
        let path = writer.path(format!("{frame:04}_depth.tiff"));
        files::write_bytes(&path, &encoded(&codes)?)
    })?;
    let mut poses = String::new();
    for frame in &source.frames {
        let columns = glam::DMat4::from(frame.world_from_camera).to_cols_array().map(|v| v.to_string());
        // Writing to a string cannot fail.
        let _ = writeln!(poses, "{}", columns.join(","));
    }
    writer.text("pose.txt", &poses)?;
    let Omnidirectional { centre, polynomial: [a0, a2, a3, a4], stretch, misfit_px } = intrinsics;
    let (width, height) = (source.camera.width, source.camera.height);
    writer.text(
        "camera_intrinsics.txt",
        &format!(
            "width height cx cy a0 a1 a2 a3 a4 c d e\n{width} {height} {} {} {a0} 0 {a2} {a3} {a4} {stretch} 0 0\n",
            centre.x, centre.y
        ),
    )?;
    let far = too_far.into_inner();
    let notes = (far > 0).then(|| format!("{far} pixels are beyond 100 mm, which is no depth in C3VD")).into_iter();
    let misfit = (misfit_px > 0.1).then(|| format!("the fisheye's polynomial is off by up to {misfit_px:.2} pixels"));
    let about = filled(include_str!("about/c3vd.md"), &[("misfit", format!("{misfit_px:.4}"))]);
    Ok(LayoutText { about, notes: notes.chain(misfit).collect() })
}

fn encoded(codes: &Image<u16>) -> Result<Vec<u8>> {
    tiff_grey::encode(codes)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rays by the formula at the top of the file, against the camera's own.
    fn furthest_px(camera: &Camera, fitted: &Omnidirectional) -> f64 {
        let mut worst: f64 = 0.0;
        for (x, y) in [(0.5, 0.5), (10.5, 40.5), (32.5, 24.5), (63.5, 47.5), (0.5, 47.5)] {
            let (u, v) = ((x - 0.5 - fitted.centre.x) / fitted.stretch, y - 0.5 - fitted.centre.y);
            let ray = glam::DVec3::new(u, v, fitted.z(u.hypot(v))).normalize();
            let own = camera.direction(DVec2::new(x, y)).normalize();
            worst = worst.max(ray.angle_between(own) * camera.fl_y);
        }
        worst
    }

    #[test]
    fn a_pinhole_is_exact_and_a_fisheye_is_near() {
        let pinhole = Camera { fl_y: 30.0, fl_x: 33.0, cx: 30.0, ..Camera::pinhole(64, 48, 1.8) };
        let exact = Omnidirectional::of(&pinhole).unwrap();
        assert_eq!((exact.polynomial, exact.misfit_px), ([30.0, 0.0, 0.0, 0.0], 0.0));
        assert!(furthest_px(&pinhole, &exact) < 1e-4);
        let fisheye = Camera { fisheye: Some([-0.02, 0.001, 0.0, 0.0]), ..pinhole };
        let fitted = Omnidirectional::of(&fisheye).unwrap();
        println!("{fitted:?}");
        assert!(fitted.misfit_px < 0.05 && furthest_px(&fisheye, &fitted) < 0.06);
    }
}
