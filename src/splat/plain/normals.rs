//! Normals of Gaussians as features of further channels, and the backward pass of their gradients.

use rayon::prelude::*;

use crate::base::{Error, Result};
use crate::splat::number::{Each, Real, cross, dot};
use crate::splat::types::{GaussianSlices, Gaussians, Gradients, Shape, View};

use super::chain::ellipsoid_gradient;
use super::exact_camera::ExactCamera;
use super::fault::Sound;

/// Unit normal of Gaussian `i` in world axes, facing the eye; the sign that was applied, and the length before
/// normalisation.
fn normal<T: Real>(gaussians: &GaussianSlices<'_, T>, i: usize, eye: [T; 3]) -> ([T; 3], T, T) {
    let columns = gaussians.shape.columns(i);
    let [a, b] = gaussians.shape.disc_columns(i).each(|k| columns[k]);
    let product = cross(a, b);
    let length = dot(product, product).sqrt();
    let offset = [0, 1, 2].each(|k| gaussians.positions[i][k] - eye[k]);
    let sign = if dot(product, offset) > T::zero() { -T::one() } else { T::one() };
    let unit = product.each(|v| sign * v / length);
    if unit.iter().all(|v| v.is_finite()) { (unit, sign, length) } else { ([T::zero(); 3], T::zero(), T::one()) }
}

/// Rotation into camera axes and position of the camera.
fn pose<T: Real>(view: &View) -> ([[T; 3]; 3], [T; 3]) {
    let exact = ExactCamera::new(&view.camera, &view.camera_from_world);
    (exact.rotation.each(|row| row.each(T::of)), exact.eye.each(T::of))
}

impl<T: Real> Gaussians<T> {
    /// Unit normals in camera axes, three values per Gaussian, turned towards the camera: features for
    /// `Rasterizer::render_channels`. Of a disc the normal of its axes, of an ellipsoid the direction of its shortest
    /// axis; 0 where there is none.
    pub fn normals(&self, view: &View) -> Vec<T> {
        let (slices, (m, eye)) = (GaussianSlices::from(self), pose::<T>(view));
        let of = |i: usize| {
            let unit = normal(&slices, i, eye).0;
            m.each(|row| dot(row, unit))
        };
        (0..self.len()).into_par_iter().flat_map_iter(of).collect()
    }

    /// Adds to `gradients` (of its groups: axes or rotations, and the pose) the gradient through
    /// [`Gaussians::normals`], given the gradient `by_normals`, three values per active Gaussian.
    ///
    /// Errors: another number of values than of gradients.
    pub fn normals_pullback(
        &self,
        view: &View,
        by_normals: &[T],
        active: Option<&[u32]>,
        gradients: &mut Gradients<T>,
    ) -> Result<()> {
        let n = active.map_or(self.len(), <[u32]>::len);
        let fits = |held: usize| held == 0 || held == n;
        if by_normals.len() != 3 * n || !fits(gradients.axes.len()) || !fits(gradients.rotations.len()) {
            return Err(Error::input("the gradient of the normals has another length than the other gradients"));
        }
        let (slices, (m, eye)) = (GaussianSlices::from(self), pose::<T>(view));
        for (j, by_normal) in by_normals.as_chunks::<3>().0.iter().enumerate() {
            let i = active.map_or(j, |list| list[j] as usize);
            let (unit, sign, length) = normal(&slices, i, eye);
            let turned = cross(m.each(|row| dot(row, unit)), *by_normal);
            (0..3).for_each(|k| gradients.pose[k] += turned[k].to_f64());
            let by_unit = [0, 1, 2].each(|k| m[0][k] * by_normal[0] + m[1][k] * by_normal[1] + m[2][k] * by_normal[2]);
            let along = dot(by_unit, unit);
            let by_product = [0, 1, 2].each(|k| sign * (by_unit[k] - along * unit[k]) / length);
            let [first, second] = slices.shape.disc_columns(i);
            let all = slices.shape.columns(i);
            let mut by_columns = [[T::zero(); 3]; 3];
            by_columns[first] = cross(all[second], by_product);
            by_columns[second] = cross(by_product, all[first]);
            if let Some(axes) = gradients.axes.get_mut(j) {
                (0..3).for_each(|k| axes[0][k] += by_columns[0][k]);
                (0..3).for_each(|k| axes[1][k] += by_columns[1][k]);
            }
            if let (Some(rotation), Shape::Ellipsoids { .. }) = (gradients.rotations.get_mut(j), &self.shape) {
                let (by_rotation, _) = ellipsoid_gradient(slices.shape, i, &by_columns, Sound);
                (0..4).for_each(|k| rotation[k] += by_rotation[k]);
            }
        }
        Ok(())
    }
}
