//! Lenses: the image of a point in camera axes, the Jacobian there, and the backward pass. Pinhole, with the
//! Jacobian taken at a clamped point as in 3DGS, and OpenCV's fisheye model. The symbols are those of `project.rs`.

use crate::base::Camera;
use crate::splat::number::{Dual, Each, Real, dot};

use super::fault::{Fault, Faults};

/// The image of a point in camera axes (pixels), and the rows of the Jacobian there.
pub struct LensPoint<T> {
    pub point: [T; 2],
    pub jacobian: [[T; 3]; 2],
}

/// The intrinsics of a camera.
#[derive(Clone, Copy, Debug)]
pub struct Lens<T> {
    /// Focal lengths in pixels.
    pub focal: [T; 2],
    /// Principal point in pixels.
    pub center: [T; 2],
    /// Least `x / z` and `y / z` in the Jacobian of a pinhole: .15 of the image beyond its edge, as in gsplat (with the
    /// principal point in the middle, 1.3 times the half field of view, as in 3DGS).
    pub low: [T; 2],
    /// Largest ones.
    pub high: [T; 2],
    /// Coefficients `k1..k4` of a fisheye; `None` for a pinhole.
    pub fisheye: Option<[T; 4]>,
    /// [`largest_stretch`] of a fisheye.
    stretch: Option<T>,
}

impl<T: Real> Lens<T> {
    /// The lens of a camera.
    pub fn new(camera: &Camera) -> Self {
        let size = [camera.width as f64, camera.height as f64];
        let (focal, center) = ([camera.fl_x, camera.fl_y], [camera.cx, camera.cy]);
        // Exactly 1.3 half fields of view to both sides of a middle.
        let beyond = |k: usize, sign: f64| {
            let off = 0.5 * size[k] - center[k];
            T::of((sign * 1.3 * 0.5 * size[k] + off) / focal[k])
        };
        Lens {
            focal: [T::of(camera.fl_x), T::of(camera.fl_y)],
            center: [T::of(camera.cx), T::of(camera.cy)],
            low: [0, 1].each(|k| beyond(k, -1.0)),
            high: [0, 1].each(|k| beyond(k, 1.0)),
            fisheye: camera.fisheye.map(|k| k.each(T::of)),
            stretch: camera.fisheye.map(|k| T::of(largest_stretch(k))),
        }
    }

    /// The image of `t`, a point in camera axes.
    #[inline(always)]
    pub fn image_of(&self, t: [T; 3]) -> LensPoint<T> {
        match self.fisheye {
            None => self.pinhole(t),
            Some(k) => fisheye(t, self.focal, self.center, k),
        }
    }

    /// Largest number of pixels per radian of a fisheye in front of the camera, along both axes; `None` for a pinhole.
    pub fn fisheye_stretch(&self) -> Option<[T; 2]> {
        self.stretch.map(|s| self.focal.each(|f| f * s))
    }

    #[inline(always)]
    fn clamped(&self, t: [T; 3], rz: T) -> [T; 2] {
        [0, 1].each(|k| (t[k] * rz).maximum(self.low[k]).minimum(self.high[k]))
    }

    #[inline(always)]
    fn pinhole(&self, t: [T; 3]) -> LensPoint<T> {
        let [fx, fy] = self.focal;
        let rz = T::one() / t[2];
        let [ux, uy] = self.clamped(t, rz);
        LensPoint {
            point: [fx * t[0] * rz + self.center[0], fy * t[1] * rz + self.center[1]],
            jacobian: [[fx * rz, T::zero(), -fx * ux * rz], [T::zero(), fy * rz, -fy * uy * rz]],
        }
    }

    /// Gradient with respect to `t` of a loss with gradients `point` and `jacobian`.
    #[inline(always)]
    pub fn pullback(&self, t: [T; 3], point: [T; 2], jacobian: [[T; 3]; 2], faults: impl Faults) -> [T; 3] {
        match self.fisheye {
            None => self.pinhole_pullback(t, point, jacobian, faults),
            Some(k) => {
                // Second derivatives of the lens come from its Jacobian evaluated in dual numbers.
                let focal = self.focal.each(Dual::constant);
                let center = self.center.each(Dual::constant);
                [0, 1, 2].each(|axis| {
                    let moved = [0, 1, 2].each(|k| Dual::new(t[k], if k == axis { T::one() } else { T::zero() }));
                    let lens = fisheye(moved, focal, center, k.each(Dual::constant));
                    let mut sum = lens.point[0].derivative * point[0] + lens.point[1].derivative * point[1];
                    for (row, weights) in lens.jacobian.iter().zip(jacobian) {
                        for (entry, weight) in row.iter().zip(weights) {
                            sum += entry.derivative * weight;
                        }
                    }
                    sum
                })
            }
        }
    }

    #[inline(always)]
    fn pinhole_pullback(&self, t: [T; 3], point: [T; 2], jacobian: [[T; 3]; 2], faults: impl Faults) -> [T; 3] {
        let [fx, fy] = self.focal;
        let rz = T::one() / t[2];
        let u = self.clamped(t, rz);
        let mut out = [fx * rz * point[0], fy * rz * point[1], T::zero()];
        out[2] = -(fx * t[0] * point[0] + fy * t[1] * point[1]) * rz * rz;
        // J00 = fx / z, J02 = -fx ux / z with ux = clamp(x / z).
        out[2] -= rz * rz * (fx * jacobian[0][0] + fy * jacobian[1][1]);
        out[2] += rz * rz * (fx * u[0] * jacobian[0][2] + fy * u[1] * jacobian[1][2]);
        for (k, f) in [(0, fx), (1, fy)] {
            let ratio = t[k] * rz;
            if ratio == u[k] || faults.has(Fault::JacobianClampIgnored) {
                let slope = -f * rz * jacobian[k][2] * rz;
                out[k] += slope;
                out[2] -= slope * ratio;
            }
        }
        out
    }

    /// Gradients of `fl_x`, `fl_y`, `cx`, `cy` of a loss with gradients `by_point` and `by_jacobian` of `image`, the
    /// image of `t`. Both are proportional to the focal lengths; where the pinhole's Jacobian is clamped, its third
    /// column is not, but follows the principal point.
    #[inline(always)]
    pub fn intrinsics_pullback(
        &self,
        t: [T; 3],
        image: &LensPoint<T>,
        by_point: [T; 2],
        by_jacobian: [[T; 3]; 2],
    ) -> [T; 4] {
        let mut out = [T::zero(), T::zero(), by_point[0], by_point[1]];
        for k in 0..2 {
            let j = image.jacobian[k];
            let mut slope = (image.point[k] - self.center[k]) * by_point[k] + dot(j, by_jacobian[k]);
            let ratio = t[k] / t[2];
            if self.fisheye.is_none() && (ratio > self.high[k] || ratio < self.low[k]) {
                slope -= j[2] * by_jacobian[k][2];
                out[2 + k] += by_jacobian[k][2] / t[2];
            }
            out[k] = slope / self.focal[k];
        }
        out
    }
}

/// Largest factor between an angle in front of the camera (up to 90 degrees off its axis) and its image at focal
/// length 1, along the meridian or across it, with 5 % of slack.
pub fn largest_stretch(lens: [f64; 4]) -> f64 {
    let factors = (1..=90).map(|degrees| {
        let theta = f64::from(degrees).to_radians();
        let (distorted, slope) = distorted_angle(theta, lens);
        slope.abs().max((distorted / theta.sin()).abs())
    });
    1.05 * factors.fold(1.0, f64::max)
}

/// `theta_d` of an angle, and its derivative.
pub fn distorted_angle(theta: f64, [k1, k2, k3, k4]: [f64; 4]) -> (f64, f64) {
    let t2 = theta * theta;
    let slope = 1.0 + t2 * (3.0 * k1 + t2 * (5.0 * k2 + t2 * (7.0 * k3 + t2 * 9.0 * k4)));
    (theta * (1.0 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4)))), slope)
}

/// OpenCV's fisheye model: `theta_d = theta (1 + k1 theta^2 + ..)`, image point `f (x, y) theta_d / r + c`, and its
/// Jacobian. No clamp: the model itself bounds the angle.
pub fn fisheye<T: Real>([x, y, z]: [T; 3], focal: [T; 2], center: [T; 2], [k1, k2, k3, k4]: [T; 4]) -> LensPoint<T> {
    let (rr, one) = (x * x + y * y, T::one());
    let zz = z * z;
    let w_plain = one / (rr + zz);
    // s = theta_d / r; ds/dx = x q; ds/dz = -w.
    let (s, q, w) = if rr > T::of(1e-5) * zz {
        let r = rr.sqrt();
        let theta = r.atan2(z);
        let t2 = theta * theta;
        let distorted = theta * (one + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))));
        let slope =
            one + t2 * (T::of(3.0) * k1 + t2 * (T::of(5.0) * k2 + t2 * (T::of(7.0) * k3 + t2 * T::of(9.0) * k4)));
        let s = distorted / r;
        (s, (slope * z * w_plain - s) / rr, slope * w_plain)
    } else {
        // Series in r / z: the closed form divides 0 by 0 here.
        let rz = one / z;
        let a = k1 - T::of(1.0 / 3.0);
        let b = k2 - k1 + T::of(0.2);
        let ratio = rr * rz * rz;
        let cube = rz * rz * rz;
        let s = rz * (one + ratio * (a + ratio * b));
        let q = cube * (T::of(2.0) * a + T::of(4.0) * ratio * b);
        let w = rz * rz * (one + ratio * (T::of(3.0) * a + T::of(5.0) * ratio * b));
        (s, q, w)
    };
    let [fx, fy] = focal;
    LensPoint {
        point: [fx * x * s + center[0], fy * y * s + center[1]],
        jacobian: [
            [fx * (s + x * x * q), fx * x * y * q, -fx * x * w],
            [fy * x * y * q, fy * (s + y * y * q), -fy * y * w],
        ],
    }
}
