//! Lenses: where a point in camera axes comes to lie, the Jacobian there, and the way back. Pinhole, with the Jacobian taken
//! at a clamped point as in 3DGS, and OpenCV's fisheye model. The symbols are those of `project.rs`.

use crate::splat::number::dual::Dual;
use crate::splat::number::real::Real;
use crate::splat::plain::fault::{Fault, Faults};
use crate::splat::plain::project::{Geometry, Projector, dot};

/// Image point, Jacobian rows, and whether x and y were clamped in the Jacobian.
pub(in crate::splat) struct Lens<T> {
    pub point: [T; 2],
    pub jacobian: [[T; 3]; 2],
}

/// The camera in double: where splats stand is computed with it and then rounded. Rounded cameras and centres were the
/// largest part of the error of single precision: all splats shift together, and alphas cross 1/255.
#[derive(Clone, Copy, Debug)]
pub(in crate::splat) struct Exact {
    pub rotation: [[f64; 3]; 3],
    pub eye: [f64; 3],
    pub focal: [f64; 2],
    pub center: [f64; 2],
    pub fisheye: Option<[f64; 4]>,
}

impl Exact {
    /// A position in camera axes.
    #[inline(always)]
    pub fn seen(&self, position: [f64; 3]) -> [f64; 3] {
        let d = [0, 1, 2].map(|k| position[k] - self.eye[k]);
        self.rotation.map(|row| row[0] * d[0] + row[1] * d[1] + row[2] * d[2])
    }

    /// Its image.
    #[inline(always)]
    pub fn point(&self, t: [f64; 3]) -> [f64; 2] {
        match self.fisheye {
            None => [0, 1].map(|k| self.focal[k] * (t[k] / t[2]) + self.center[k]),
            Some(k) => fisheye(t, self.focal, self.center, k).point,
        }
    }

    /// The cone outside of which a splat lies beside the image for sure: cosine and sine of its half angle, and `reach`,
    /// such that with `r` the distance from the axis and `s` the largest standard deviation of the Gaussian (mm),
    /// `cosine r - sine z >= 3.34 reach s` is beside. All 0, which is never true, where no such cone exists before the
    /// camera.
    ///
    /// A splat reaches 3.34 standard deviations on the image along each axis, which are no more than `stretch s / distance`
    /// and the dilation (in units of the focal length); it misses the image where its centre is farther from every pixel
    /// than sqrt(2) times that, and beyond the cone the image point moves out with the angle by at least `slope`.
    pub fn cone(&self, lens: [f64; 4], size: [f64; 2], dilation: f64) -> [f64; 3] {
        const STEPS: usize = 1000;
        let corner = [0, 1].map(|k| self.center[k].abs().max((size[k] - self.center[k]).abs()) / self.focal[k]);
        let filter = 3.34 * dilation.sqrt() + 0.01;
        let edge = corner[0].hypot(corner[1]) + std::f64::consts::SQRT_2 * filter / self.focal[0].min(self.focal[1]);
        let angle = |step: usize| step as f64 / STEPS as f64 * std::f64::consts::FRAC_PI_2;
        // The last angle whose image is not yet beyond the edge.
        let Some(last) = (0..=STEPS).rev().find(|&step| distorted_angle(angle(step), lens).0 <= edge) else {
            return [0.0; 3];
        };
        let slope = (last..=STEPS).map(|step| distorted_angle(angle(step), lens).1).fold(f64::INFINITY, f64::min);
        if last + 1 >= STEPS || slope < 0.05 {
            return [0.0; 3];
        }
        let (sine, cosine) = angle(last + 1).sin_cos();
        [cosine, sine, std::f64::consts::SQRT_2 * largest_stretch(lens) / (0.99 * slope)]
    }

    /// As the kernels take it (`Scene::camera` of `cpp/splat/kernel.h`).
    pub fn numbers(&self) -> [f64; 20] {
        let mut out = [0.0; 20];
        let lens = self.fisheye.unwrap_or_default();
        let all = self.rotation.as_flattened().iter().chain(&self.eye).chain(&self.focal).chain(&self.center);
        let all = all.chain(&lens);
        out.iter_mut().zip(all).for_each(|(place, v)| *place = *v);
        out
    }
}

impl<T: Real> Projector<T> {
    #[inline(always)]
    pub(in crate::splat) fn lens(&self, t: [T; 3]) -> Lens<T> {
        match self.fisheye {
            None => self.pinhole(t),
            Some(k) => fisheye(t, self.focal, self.center, k),
        }
    }

    #[inline(always)]
    fn clamped(&self, t: [T; 3], rz: T) -> [T; 2] {
        [0, 1].map(|k| (t[k] * rz).maximum(-self.limit[k]).minimum(self.limit[k]))
    }

    #[inline(always)]
    fn pinhole(&self, t: [T; 3]) -> Lens<T> {
        let [fx, fy] = self.focal;
        let rz = T::one() / t[2];
        let [ux, uy] = self.clamped(t, rz);
        Lens {
            point: [fx * t[0] * rz + self.center[0], fy * t[1] * rz + self.center[1]],
            jacobian: [[fx * rz, T::zero(), -fx * ux * rz], [T::zero(), fy * rz, -fy * uy * rz]],
        }
    }

    /// Gradient with respect to `t` of a loss with gradients `point` and `jacobian`.
    #[inline(always)]
    pub(in crate::splat) fn lens_pullback(
        &self,
        t: [T; 3],
        point: [T; 2],
        jacobian: [[T; 3]; 2],
        faults: impl Faults,
    ) -> [T; 3] {
        match self.fisheye {
            None => self.pinhole_pullback(t, point, jacobian, faults),
            Some(k) => {
                // Second derivatives of the lens come from its Jacobian evaluated in dual numbers.
                let focal = self.focal.map(Dual::constant);
                let center = self.center.map(Dual::constant);
                [0, 1, 2].map(|axis| {
                    let moved = [0, 1, 2].map(|k| Dual::new(t[k], if k == axis { T::one() } else { T::zero() }));
                    let lens = fisheye(moved, focal, center, k.map(Dual::constant));
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

    /// Gradients of `fl_x`, `fl_y`, `cx`, `cy` of a loss with gradients `by_point` and `by_jacobian` at `t`. Both are
    /// proportional to the focal lengths; where the pinhole's Jacobian is clamped, its third column is not.
    #[inline(always)]
    pub fn intrinsics_pullback(&self, g: &Geometry<T>, by_point: [T; 2], by_jacobian: [[T; 3]; 2]) -> [T; 4] {
        let mut out = [T::zero(), T::zero(), by_point[0], by_point[1]];
        for k in 0..2 {
            let j = g.jacobian[k];
            let mut slope = (g.point[k] - self.center[k]) * by_point[k] + dot(j, by_jacobian[k]);
            let ratio = g.t[k] / g.t[2];
            if self.is_pinhole() && (ratio > self.limit[k] || ratio < -self.limit[k]) {
                slope -= j[2] * by_jacobian[k][2];
            }
            out[k] = slope / self.focal[k];
        }
        out
    }
}

/// Largest factor between an angle before the camera (up to 90 degrees off its axis) and its image at focal length 1,
/// along the meridian or across it, with 5 % of room.
pub(in crate::splat) fn largest_stretch(lens: [f64; 4]) -> f64 {
    let factors = (1..=90).map(|degrees| {
        let theta = f64::from(degrees).to_radians();
        let (distorted, slope) = distorted_angle(theta, lens);
        slope.abs().max((distorted / theta.sin()).abs())
    });
    1.05 * factors.fold(1.0, f64::max)
}

/// `theta_d` of an angle, and its derivative.
fn distorted_angle(theta: f64, [k1, k2, k3, k4]: [f64; 4]) -> (f64, f64) {
    let t2 = theta * theta;
    let slope = 1.0 + t2 * (3.0 * k1 + t2 * (5.0 * k2 + t2 * (7.0 * k3 + t2 * 9.0 * k4)));
    (theta * (1.0 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4)))), slope)
}

/// OpenCV's fisheye model: `theta_d = theta (1 + k1 theta^2 + ..)`, image point `f (x, y) theta_d / r + c`, and its
/// Jacobian. No clamp: the model itself bounds the angle.
fn fisheye<T: Real>([x, y, z]: [T; 3], focal: [T; 2], center: [T; 2], [k1, k2, k3, k4]: [T; 4]) -> Lens<T> {
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
    Lens {
        point: [fx * x * s + center[0], fy * y * s + center[1]],
        jacobian: [
            [fx * (s + x * x * q), fx * x * y * q, -fx * x * w],
            [fy * x * y * q, fy * (s + y * y * q), -fy * y * w],
        ],
    }
}
