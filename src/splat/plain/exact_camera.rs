//! The camera in double precision.

use crate::base::Camera;
use crate::splat::number::Each;
use glam::DAffine3;

use super::lens::{distorted_angle, fisheye, largest_stretch};

/// The camera in double precision: positions of splats are computed with it and then rounded. Rounded cameras and
/// centres were the largest part of the error of single precision: all splats shift together, and alphas cross 1/255.
#[derive(Clone, Copy, Debug)]
pub struct ExactCamera {
    pub rotation: [[f64; 3]; 3],
    pub eye: [f64; 3],
    pub focal: [f64; 2],
    pub center: [f64; 2],
    pub fisheye: Option<[f64; 4]>,
}

impl ExactCamera {
    /// The camera with these intrinsics and this pose.
    pub fn new(camera: &Camera, camera_from_world: &DAffine3) -> Self {
        let m = camera_from_world.matrix3;
        ExactCamera {
            rotation: [0, 1, 2].each(|i| [m.x_axis[i], m.y_axis[i], m.z_axis[i]]),
            eye: camera_from_world.inverse().translation.to_array(),
            focal: [camera.fl_x, camera.fl_y],
            center: [camera.cx, camera.cy],
            fisheye: camera.fisheye,
        }
    }

    /// A position in camera axes.
    #[inline(always)]
    pub fn in_camera_axes(&self, position: [f64; 3]) -> [f64; 3] {
        let d = [0, 1, 2].each(|k| position[k] - self.eye[k]);
        self.rotation.each(|row| row[0] * d[0] + row[1] * d[1] + row[2] * d[2])
    }

    /// Its image.
    #[inline(always)]
    pub fn point(&self, t: [f64; 3]) -> [f64; 2] {
        match self.fisheye {
            None => [0, 1].each(|k| self.focal[k] * (t[k] / t[2]) + self.center[k]),
            Some(k) => fisheye(t, self.focal, self.center, k).point,
        }
    }

    /// The cone outside of which a splat is certain to lie beside the image: cosine and sine of its half angle, and
    /// `reach`. With `r` the distance from the axis and `s` the largest standard deviation of the Gaussian (mm), the
    /// splat lies beside the image if `cosine r - sine z >= 3.34 reach s`. All are 0, so that this never holds, if no
    /// such cone exists in front of the camera.
    ///
    /// A splat reaches 3.34 standard deviations on the image along each axis, which are no more than `stretch s /
    /// distance` and the dilation (in units of the focal length). It misses the image if its centre is farther from
    /// every pixel than sqrt(2) times that. Beyond the cone the image point moves outwards with the angle by at least
    /// `slope`.
    pub fn cone(&self, lens: [f64; 4], size: [f64; 2], dilation: f64) -> [f64; 3] {
        const STEPS: usize = 1000;
        let corner = [0, 1].each(|k| self.center[k].abs().max((size[k] - self.center[k]).abs()) / self.focal[k]);
        let filter = 3.34 * dilation.sqrt() + 0.01;
        let edge = corner[0].hypot(corner[1]) + std::f64::consts::SQRT_2 * filter / self.focal[0].min(self.focal[1]);
        let angle = |step: usize| step as f64 / STEPS as f64 * std::f64::consts::FRAC_PI_2;
        // The largest angle whose image is not beyond the edge.
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
}
