//! Camera models. Axes as OpenCV: x right, y down, z forward; pixel centres at integer + 0.5; depth is z-depth.

use glam::{DAffine3, DMat3, DVec2, DVec3};
use serde::{Deserialize, Serialize};

use super::error::{Error, Result};
use super::range::NumberRange;

/// Focal lengths in pixels: from a lens that sees everything to one that sees a hair.
pub const FOCAL_PX: NumberRange = NumberRange::new(1e-3, 1e7);
/// Principal points in pixels, which may lie outside of the image.
pub const PRINCIPAL_PX: NumberRange = NumberRange::new(-1e7, 1e7);
/// `k1..k4` of the fisheye model.
pub const DISTORTION: NumberRange = NumberRange::new(-100.0, 100.0);

/// Intrinsics of one camera. Lengths in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Camera {
    /// Image width in pixels.
    pub width: u32,
    /// Image height in pixels.
    pub height: u32,
    /// Horizontal focal length in pixels.
    pub fl_x: f64,
    /// Vertical focal length in pixels.
    pub fl_y: f64,
    /// Horizontal principal point in pixels (image centre is `width / 2`).
    pub cx: f64,
    /// Vertical principal point in pixels.
    pub cy: f64,
    /// `k1..k4` of OpenCV's fisheye model; `None` is a pinhole.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fisheye: Option<[f64; 4]>,
}

impl Camera {
    /// Pinhole with square pixels, centred principal point and horizontal field of view `fov_x_rad`.
    pub fn pinhole(width: u32, height: u32, fov_x_rad: f64) -> Self {
        let focal = width as f64 / 2.0 / (fov_x_rad / 2.0).tan();
        Camera {
            width,
            height,
            fl_x: focal,
            fl_y: focal,
            cx: width as f64 / 2.0,
            cy: height as f64 / 2.0,
            fisheye: None,
        }
    }

    /// Refuses numbers that no camera has; the error names the one.
    pub fn validate(&self) -> Result<()> {
        if self.width == 0 || self.height == 0 {
            return Err(Error::input("a camera needs a positive width and height"));
        }
        let lens = [
            ("fl_x", FOCAL_PX, self.fl_x),
            ("fl_y", FOCAL_PX, self.fl_y),
            ("cx", PRINCIPAL_PX, self.cx),
            ("cy", PRINCIPAL_PX, self.cy),
        ];
        let bends = ["k1", "k2", "k3", "k4"].into_iter().zip(self.fisheye.unwrap_or_default());
        let bends = bends.map(|(name, k)| (name, DISTORTION, k));
        // Not `element`: callers name theirs.
        let check = |(name, range, value): (&str, NumberRange, f64)| {
            range.check(value).map_err(|e| Error::input(format!("{name}: {e}")))
        };
        lens.into_iter().chain(bends).try_for_each(check)?;
        self.check_lens()
    }

    /// Refuses a fisheye whose law says nothing, or two things, of some point of the image: the distorted angle must rise
    /// up to that of the farthest corner, and reach it in front of straight back.
    fn check_lens(&self) -> Result<()> {
        let Some(k) = self.fisheye else { return Ok(()) };
        let x = self.cx.abs().max((self.cx - f64::from(self.width)).abs()) / self.fl_x;
        let y = self.cy.abs().max((self.cy - f64::from(self.height)).abs()) / self.fl_y;
        let corner = x.hypot(y);
        let mut why = "lies beyond 180 degrees off the axis";
        for step in 0..=LENS_STEPS {
            let (distorted, slope) = distort(std::f64::consts::PI * f64::from(step) / f64::from(LENS_STEPS), k);
            if slope > 0.0 && distorted >= corner {
                return Ok(());
            }
            if slope <= 0.0 {
                why = "lies beyond where the distorted angle stops rising";
                break;
            }
        }
        let (width, height) = (self.width, self.height);
        Err(Error::input(format!(
            "fl_x, fl_y, cx, cy and k1, k2, k3, k4 of a fisheye of width {width} and height {height} show nothing at its \
             farthest corner, which {why}"
        )))
    }

    /// Direction (camera axes, z = 1 for a pinhole; unit length for fisheye) through the image point `pixel`.
    /// The point `depth * direction / direction.z` has z-depth `depth`.
    pub fn direction(&self, pixel: DVec2) -> DVec3 {
        let x = (pixel.x - self.cx) / self.fl_x;
        let y = (pixel.y - self.cy) / self.fl_y;
        let Some(k) = self.fisheye else { return DVec3::new(x, y, 1.0) };
        let distorted = x.hypot(y);
        if distorted < 1e-12 {
            return DVec3::Z;
        }
        let theta = undistort(distorted, k);
        let s = theta.sin() / distorted;
        DVec3::new(x * s, y * s, theta.cos())
    }

    /// Image point of a point in camera axes, `None` behind a pinhole.
    pub fn project(&self, point: DVec3) -> Option<DVec2> {
        let (x, y) = match self.fisheye {
            None if point.z <= 0.0 => return None,
            None => (point.x / point.z, point.y / point.z),
            Some(k) => {
                let r = point.x.hypot(point.y);
                let (distorted, _) = distort(r.atan2(point.z), k);
                let s = if r > 1e-12 { distorted / r } else { 1.0 / point.z };
                (point.x * s, point.y * s)
            }
        };
        Some(DVec2::new(self.fl_x * x + self.cx, self.fl_y * y + self.cy))
    }

    /// The same camera for an image `factor` times as wide and high.
    pub fn scaled(&self, factor: f64) -> Self {
        Camera {
            width: (self.width as f64 * factor).round() as u32,
            height: (self.height as f64 * factor).round() as u32,
            fl_x: self.fl_x * factor,
            fl_y: self.fl_y * factor,
            cx: self.cx * factor,
            cy: self.cy * factor,
            fisheye: self.fisheye,
        }
    }
}

/// Angles between the axis and straight back at which a lens is looked at.
const LENS_STEPS: u32 = 1000;

/// OpenCV's fisheye: the distorted angle of `theta`, and its derivative.
fn distort(theta: f64, [k1, k2, k3, k4]: [f64; 4]) -> (f64, f64) {
    let t2 = theta * theta;
    let value = theta * (1.0 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))));
    let slope = 1.0 + t2 * (3.0 * k1 + t2 * (5.0 * k2 + t2 * (7.0 * k3 + t2 * 9.0 * k4)));
    (value, slope)
}

/// The angle whose distorted angle is `distorted`: the first one from the axis on, or where the distorted angle stops
/// rising before it.
fn undistort(distorted: f64, k: [f64; 4]) -> f64 {
    // Newton's method on theta (1 + k1 theta^2 + ...) = distorted.
    let mut theta = distorted.min(std::f64::consts::PI);
    for _ in 0..20 {
        let (value, slope) = distort(theta, k);
        let next = theta - (value - distorted) / slope;
        if next == theta {
            // Every further step ends here too: mostly the second to fifth, the first without distortion.
            break;
        }
        theta = next;
    }
    let is_near = (distort(theta, k).0 - distorted).abs() <= 1e-9 * (1.0 + distorted);
    // The slope falls at most by its negative terms, all of which are largest at the end.
    let surely_rises = distort(theta, k.map(|k| k.min(0.0))).1 > 1e-6;
    let rises =
        |steps: u32| surely_rises || (0..=steps).all(|n| distort(theta * f64::from(n) / f64::from(steps), k).1 > 0.0);
    // Of a lens that bends much it may have left the rising part, or found an angle beyond it.
    if is_near && (0.0..=std::f64::consts::PI).contains(&theta) && rises(32) {
        return theta;
    }
    let angle = |step: u32| std::f64::consts::PI * f64::from(step) / f64::from(LENS_STEPS);
    let ends = |step: &u32| {
        let (value, slope) = distort(angle(*step), k);
        slope <= 0.0 || value >= distorted
    };
    let step = (1..=LENS_STEPS).find(ends).unwrap_or(LENS_STEPS);
    let (mut low, mut high) = (angle(step - 1), angle(step));
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        let (value, slope) = distort(middle, k);
        if slope <= 0.0 || value >= distorted { high = middle } else { low = middle }
    }
    high
}

/// Whether the distorted angle of a fisheye of coefficients `k` rises all the way up to `theta` (radians).
pub fn fisheye_rises_to(theta: f64, k: [f64; 4]) -> bool {
    (0..=LENS_STEPS).all(|step| distort(theta * f64::from(step) / f64::from(LENS_STEPS), k).1 > 0.0)
}

/// Camera at `origin` that looks along `forward`; `up` points to the top of the image as far as it can.
pub fn world_from_camera_looking(origin: DVec3, forward: DVec3, up: DVec3) -> DAffine3 {
    let z = forward.normalize();
    let x = z.cross(up).try_normalize().unwrap_or_else(|| z.any_orthonormal_vector());
    let y = z.cross(x);
    DAffine3::from_mat3_translation(DMat3::from_cols(x, y, z), origin)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fisheye_that_bends_back_before_its_corner_is_refused() {
        let lens = |fl: f64, k1: f64| Camera {
            fl_x: fl,
            fl_y: fl,
            fisheye: Some([k1, 0.0, 0.0, 0.0]),
            ..Camera::pinhole(64, 64, 1.0)
        };
        for (camera, is_lens) in [
            // theta (1 - .5 theta^2) rises to .544 at most.
            (lens(90.0, -0.5), true),
            (lens(80.0, -0.5), false),
            // An undistorted one must see less than 180 degrees off the axis at the corner.
            (lens(32.0 * 2f64.sqrt() / 3.1, 0.0), true),
            (lens(32.0 * 2f64.sqrt() / 3.2, 0.0), false),
        ] {
            assert_eq!(camera.validate().is_ok(), is_lens, "{camera:?}");
        }
    }

    /// Twenty steps of Newton's method from the distorted angle end far away from that of this lens' corners.
    #[test]
    fn a_lens_that_bends_much_is_inverted_on_its_rising_part() {
        let k = [0.7544, -0.2113, -0.0608, -0.0103];
        let fl = 32.0 * 2f64.sqrt() / 1.465;
        let camera = Camera { fl_x: fl, fl_y: fl, fisheye: Some(k), ..Camera::pinhole(64, 64, 1.0) };
        camera.validate().unwrap();
        for (x, y) in (0..64).flat_map(|y| (0..64).map(move |x| (x, y))) {
            let pixel = DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
            let direction = camera.direction(pixel);
            assert!((direction.length() - 1.0).abs() < 1e-12);
            let theta = direction.x.hypot(direction.y).atan2(direction.z);
            assert!(fisheye_rises_to(theta, k), "{pixel}: {theta}");
            assert!(camera.project(direction).unwrap().distance(pixel) < 1e-6, "{pixel}");
        }
    }

    #[test]
    fn projection_inverts_direction() {
        for fisheye in [None, Some([0.02, -0.004, 0.001, 0.0])] {
            let camera = Camera { fisheye, ..Camera::pinhole(200, 100, 1.9) };
            for (px, py) in [(0.5, 0.5), (100.0, 50.0), (199.5, 99.5), (30.2, 71.9)] {
                let p = camera.project(camera.direction(DVec2::new(px, py)) * 7.0).unwrap();
                assert!((p - DVec2::new(px, py)).length() < 1e-9, "{p} for {px} {py}");
            }
        }
    }

    #[test]
    fn the_fisheye_is_opencvs() {
        // cv2.fisheye.projectPoints of OpenCV 5.0.0; its pixel centres are integers, which shifts nothing here: the
        // principal point is given in the same frame as the result.
        let camera = Camera {
            width: 200,
            height: 100,
            fl_x: 80.5,
            fl_y: 79.25,
            cx: 100.25,
            cy: 51.5,
            fisheye: Some([-0.031, 0.012, -0.004, 0.0007]),
        };
        for (point, image) in [
            ([0.3, -0.2, 1.0], [123.346030513425, 36.341735667173]),
            ([2.0, 1.0, 1.5], [169.278370726978, 85.478250808155]),
            ([-3.0, 0.5, 1.0], [3.762495874706, 67.331541825941]),
            ([0.0, 4.0, 0.8], [100.25, 156.667321171427]),
            ([0.001, 0.002, 5.0], [100.266099998827, 51.531699997690]),
            ([-1.0, -1.0, 0.25], [23.525260092198, -24.033361958923]),
        ] {
            let ours = camera.project(DVec3::from_array(point)).unwrap();
            assert!((ours - DVec2::from_array(image)).length() < 1e-9, "{ours} for {point:?}");
            let back = camera.direction(ours).normalize();
            assert!((back - DVec3::from_array(point).normalize()).length() < 1e-9);
        }
    }

    #[test]
    fn what_no_camera_has_is_named() {
        let camera = Camera { fisheye: Some([0.02, -0.004, 0.001, 0.0]), ..Camera::pinhole(200, 100, 1.9) };
        assert_eq!(camera.validate(), Ok(()));
        let said = |camera: Camera| camera.validate().unwrap_err().to_string();
        assert_eq!(said(Camera { fl_x: 1e-300, ..camera }), "fl_x: 1e-300 must lie in 0.001 to 1e7");
        assert_eq!(said(Camera { cx: 1e300, ..camera }), "cx: 1e300 must lie in -1e7 to 1e7");
        assert!(said(Camera { cy: f64::NAN, ..camera }).starts_with("cy: NaN"));
        assert!(said(Camera { height: 0, ..camera }).contains("height"));
        for (k, wrong) in [f64::NAN, f64::INFINITY, 1e300, -1e6].into_iter().enumerate() {
            let mut fisheye = [0.0; 4];
            fisheye[k] = wrong;
            assert!(said(Camera { fisheye: Some(fisheye), ..camera }).starts_with(&format!("k{}: ", k + 1)));
        }
    }

    #[test]
    fn looking_is_right_handed_with_y_down() {
        let w = world_from_camera_looking(DVec3::ZERO, DVec3::Z, DVec3::Y);
        assert!((w.matrix3.determinant() - 1.0).abs() < 1e-12);
        assert!((w.transform_vector3(DVec3::Y) - DVec3::NEG_Y).length() < 1e-12);
    }
}
