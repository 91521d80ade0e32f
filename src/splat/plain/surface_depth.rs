//! Depth of the surface that the splats represent, instead of a mean of their centres.
//!
//! Along the ray of a pixel each splat has the depth of its largest density: at the plane of a disc, at the peak
//! `t = d . S c / d . S d` of an ellipsoid (S inverse covariance, d ray, c centre, both in camera axes). These
//! depths are averaged with the weights of the image. A centre can be millimetres off at a pixel that its disc covers:
//! on a wall seen at a grazing angle that is a bias of tens of percent.
//! Forward only (`pass/pixel_walk.rs`): it runs once per finished frame, not in an optimisation.

use crate::splat::number::{Each, Real, dot};
use crate::splat::types::{GaussianSlices, ShapeSlices, View};

/// Depths are clamped to between the inverse of this and this many times the centre's depth; only planes seen edge-on
/// exceed it.
const FARTHEST: f64 = 4.0;

/// One splat in camera axes.
pub struct SplatSurface {
    kind: SurfaceKind,
    /// z-depth of the centre in mm.
    center: f64,
}

enum SurfaceKind {
    /// Normal and its product with the centre.
    Plane([f64; 3], f64),
    /// The axes over their standard deviations (rows of `diag(1 / s) R^T`), and the centre in them.
    Ellipsoid([[f64; 3]; 3], [f64; 3]),
}

impl SplatSurface {
    pub fn of<T: Real>(gaussians: &GaussianSlices<'_, T>, i: usize, view: &View) -> SplatSurface {
        let turn = |v: glam::DVec3| view.camera_from_world.transform_vector3(v).to_array();
        let wide = |v: [T; 3]| glam::DVec3::from_array(v.each(|c| c.to_f64()));
        let center = view.camera_from_world.transform_point3(wide(gaussians.positions[i])).to_array();
        match gaussians.shape {
            ShapeSlices::Discs { axes } => {
                let [a, b] = axes[i].each(|axis| turn(wide(axis)));
                let normal =
                    glam::DVec3::from_array(a).cross(glam::DVec3::from_array(b)).normalize_or_zero().to_array();
                SplatSurface { kind: SurfaceKind::Plane(normal, dot(normal, center)), center: center[2] }
            }
            ShapeSlices::Ellipsoids { rotations, scales } => {
                let [w, x, y, z] = rotations[i].each(|c| c.to_f64());
                let turned = glam::DMat3::from_quat(glam::DQuat::from_xyzw(x, y, z, w).normalize());
                let size = scales[i].each(|s| s.to_f64().max(1e-9));
                let axes: [[f64; 3]; 3] = std::array::from_fn(|k| turn(turned.col(k) * size[k]));
                // R / s, from R s.
                let form: [[f64; 3]; 3] = std::array::from_fn(|k| axes[k].each(|v| v / (size[k] * size[k])));
                let local = std::array::from_fn(|k| dot(form[k], center));
                SplatSurface { kind: SurfaceKind::Ellipsoid(form, local), center: center[2] }
            }
        }
    }

    /// z-depth at the ray `d`.
    pub fn depth(&self, d: [f64; 3]) -> f64 {
        let along = match &self.kind {
            SurfaceKind::Plane(normal, height) => height / dot(*normal, d),
            SurfaceKind::Ellipsoid(form, local) => {
                let u: [f64; 3] = std::array::from_fn(|k| dot(form[k], d));
                dot(u, *local) / dot(u, u)
            }
        };
        let depth = along * d[2];
        // Planes seen edge-on meet the ray at any depth, or nowhere.
        if depth.is_finite() { depth.clamp(self.center / FARTHEST, self.center * FARTHEST) } else { self.center }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::Camera;
    use crate::splat::{DepthOutput, Gaussians, Rasterizer, Settings, Shape};
    use glam::{DAffine3, DVec2};

    /// A floor of discs 2 mm below the camera: the depth image must be the floor's, not a mean of centres.
    #[test]
    fn a_floor_has_the_depth_of_its_plane() {
        let mut gaussians = Gaussians::<f64>::discs(0, 0, 0.9);
        let mut axes = Vec::new();
        for (i, j) in (-60..=60).flat_map(|i| (0..120).map(move |j| (i, j))) {
            gaussians.positions.push([i as f64 * 0.3, 2.0, 1.0 + j as f64 * 0.3]);
            gaussians.opacities.push(0.9);
            gaussians.sh.extend([0.0; 3]);
            axes.push([[0.4, 0.0, 0.0], [0.1, 0.0, 0.4]]);
        }
        gaussians.shape = Shape::Discs { axes };
        let view = View::new(Camera::pinhole(64, 64, 1.5), DAffine3::IDENTITY);
        let worst_of = |gaussians: &Gaussians<f64>, output| {
            let settings = Settings { depth: output, ..Settings::default() };
            let mut rasterizer = Rasterizer::new();
            let rendered = rasterizer.render(gaussians, &view, &settings, None).unwrap();
            let mut worst = 0.0f64;
            for (x, y) in (40..62).flat_map(|y| [8, 32, 50].map(|x| (x, y))) {
                assert!(rendered.alpha[y * 64 + x] > 0.5);
                let truth = 2.0 / view.camera.direction(DVec2::new(x as f64 + 0.5, y as f64 + 0.5)).y;
                worst = worst.max((rendered.depth[y * 64 + x] / truth - 1.0).abs());
            }
            worst
        };
        let worst = worst_of(&gaussians, DepthOutput::Surface);
        // The remaining error comes from discs beside the camera, whose projection overshoots.
        assert!(worst < 0.01, "{worst}");
        assert!(worst_of(&gaussians, DepthOutput::Expected) > 0.05, "the mean of centres would do: the test is blind");
        // The same discs as very flat ellipsoids.
        let n = gaussians.len();
        let quarter = std::f64::consts::FRAC_1_SQRT_2;
        gaussians.shape =
            Shape::Ellipsoids { rotations: vec![[quarter, quarter, 0.0, 0.0]; n], scales: vec![[0.4, 0.4, 1e-4]; n] };
        let worst = worst_of(&gaussians, DepthOutput::Surface);
        assert!(worst < 0.01, "{worst}");
    }
}
