//! Projection of one Gaussian to one splat, after EWA splatting (Zwicker et al., 2001) as 3DGS (Kerbl et al., 2023)
//! and gsplat do it.
//!
//! Symbols: `p` centre, `m_k` columns of the square root of the covariance (`R_k s_k` of an ellipsoid, the two axes of
//! a disc), `R`, `eye` camera, `t = R (p - eye)`, `c_k = R m_k`, `J` Jacobian of the projection at `t`, `u_k = J c_k`,
//! covariance on screen `sum u_k u_k^T + dilation I`, conic `(A, B, C)` its inverse.
//! The Jacobian of a pinhole is taken at `t` clamped to .15 of the image beyond its edge, as in gsplat.
//! A splat extends to where its alpha falls to 1/255. With `Filter::Compensate` the opacity is first multiplied by
//! `sqrt(det / det dilated)`; visible splats then have a determinant that is not tiny, so that the gradient needs no
//! floor.

use std::f64::consts::LOG2_E;

use crate::ffi::splat::rasterize::Aligned;
use crate::splat::number::{Each, Real, dot};
use crate::splat::types::table::{LOG2_255, SplatRow, at};
use crate::splat::types::{Filter, GaussianSlices, Tiling};

use super::bins::TileBox;
use super::lens::LensPoint;
use super::projector::Projector;

/// Intermediate values of the projection of one Gaussian, from which its backward pass starts.
pub struct Geometry<T> {
    /// Centre in camera axes.
    pub t: [T; 3],
    /// Columns in camera axes and on screen.
    pub c: [[T; 3]; 3],
    pub u: [[T; 2]; 3],
    pub jacobian: [[T; 3]; 2],
    /// Centre on screen, and its rounding error.
    pub point: [T; 2],
    pub rest: [T; 2],
    /// Covariance on screen and the inverse's `(A, B, C)`.
    pub covariance: [T; 3],
    pub conic: [T; 3],
    pub inverse_determinant: T,
    /// Determinant of the covariance before dilation.
    pub plain_determinant: T,
    /// Unit vector from the eye, and the distance.
    pub direction: [T; 3],
    pub distance: T,
}

impl<T: Real> Projector<T> {
    /// Everything up to the conic; `None` in front of the near plane or if a number is not finite.
    #[inline(always)]
    pub fn geometry(&self, position: [T; 3], columns: [[T; 3]; 3]) -> Option<Geometry<T>> {
        let offset = [0, 1, 2].each(|k| position[k] - self.eye[k]);
        let exact = self.exact.in_camera_axes(position.each(T::to_f64));
        let t = if T::PLAIN { exact.each(T::of) } else { self.turn(offset) };
        let in_front = t[2] >= self.near;
        if !in_front {
            return None;
        }
        let mut g = self.geometry_of(t, columns.each(|m| self.turn(m)), offset)?;
        if T::PLAIN {
            let point = self.exact.point(exact);
            g.point = point.each(T::of);
            g.rest = [0, 1].each(|k| T::of(point[k] - g.point[k].to_f64()));
        }
        Some(g)
    }

    /// The same from the centre and the columns in camera axes, and the vector from the eye in world axes.
    #[inline(always)]
    pub fn geometry_of(&self, t: [T; 3], c: [[T; 3]; 3], offset: [T; 3]) -> Option<Geometry<T>> {
        let LensPoint { point, jacobian } = self.lens.image_of(t);
        // Covariance on screen: sum u_k u_k^T + dilation I, u_k = J c_k.
        let u = c.each(|column| jacobian.each(|row| dot(row, column)));
        let sum = |a: usize, b: usize| u[0][a] * u[0][b] + u[1][a] * u[1][b] + u[2][a] * u[2][b];
        let plain = [sum(0, 0), sum(0, 1), sum(1, 1)];
        let d = self.dilation;
        // Cauchy and Binet: the determinant as a sum of squares, so that thin splats keep their digits.
        let cross = |a: usize, b: usize| u[a][0] * u[b][1] - u[a][1] * u[b][0];
        let (k01, k02, k12) = (cross(0, 1), cross(0, 2), cross(1, 2));
        let plain_determinant = k01 * k01 + k02 * k02 + k12 * k12;
        let determinant = plain_determinant + d * (plain[0] + plain[2]) + d * d;
        let covariance = [plain[0] + d, plain[1], plain[2] + d];
        // Its inverse, the conic.
        let inverse_determinant = T::one() / determinant;
        let conic = [
            covariance[2] * inverse_determinant,
            -covariance[1] * inverse_determinant,
            covariance[0] * inverse_determinant,
        ];
        // View direction.
        let distance = dot(offset, offset).sqrt();
        let direction = offset.each(|v| v / distance);
        // A sum is finite only if every term is (0 times infinity and infinities of both signs give NaN).
        let sum = conic[0] + conic[1] + conic[2] + point[0] + point[1] + covariance[0] + covariance[2];
        let finite = (sum + direction[0] + direction[1] + direction[2] + inverse_determinant).is_finite();
        if !finite || determinant <= T::zero() {
            return None;
        }
        Some(Geometry {
            t,
            c,
            u,
            jacobian,
            point,
            rest: [T::zero(); 2],
            covariance,
            conic,
            inverse_determinant,
            plain_determinant,
            direction,
            distance,
        })
    }

    /// The splat of Gaussian `i`; `None` if it is invisible or not finite.
    pub fn project(&self, gaussians: &GaussianSlices<'_, T>, i: usize) -> Option<SplatRow<T>> {
        let opacity = gaussians.opacities[i];
        let log2_opacity = opacity.log2();
        let reach = log2_opacity + T::of(LOG2_255);
        if !reach.is_finite() || reach <= T::zero() {
            return None;
        }
        let g = self.geometry(gaussians.positions[i], gaussians.shape.columns(i))?;
        let row = self.row(&g, log2_opacity, gaussians.color(i, g.direction))?;
        for axis in 0..2 {
            let (center, half) = (row[at::X + axis], row[at::HALF_WIDTH + axis]);
            if !(center + half > T::zero() && center - half < self.size[axis]) {
                return None;
            }
        }
        Some(row)
    }

    /// The row of a splat of that colour (before the clamp at 0); `None` for a colour that is not finite.
    #[inline(always)]
    pub fn row(&self, g: &Geometry<T>, log2_opacity: T, color: [T; 3]) -> Option<SplatRow<T>> {
        if !(color[0] + color[1] + color[2]).is_finite() {
            return None;
        }
        let log2_opacity = match self.filter {
            Filter::Dilate => log2_opacity,
            Filter::Compensate => log2_opacity + T::of(0.5) * (g.plain_determinant * g.inverse_determinant).log2(),
        };
        // Half axes of the box around `exponent >= -log2(255)`.
        let reach = log2_opacity + T::of(LOG2_255);
        if self.filter == Filter::Compensate && !(reach.is_finite() && reach > T::zero()) {
            return None;
        }
        let reach = self.extent(log2_opacity);
        let k = T::of(2.0 / LOG2_E) * reach;
        let mut row = [T::zero(); 16];
        row[at::X] = g.point[0];
        row[at::Y] = g.point[1];
        row[at::A] = T::of(0.5 * LOG2_E) * g.conic[0];
        row[at::B] = T::of(LOG2_E) * g.conic[1];
        row[at::C] = T::of(0.5 * LOG2_E) * g.conic[2];
        row[at::LOG2_OPACITY] = log2_opacity;
        for k in 0..3 {
            row[at::RED + k] = color[k].maximum(T::zero());
        }
        row[at::DEPTH] = g.t[2];
        row[at::HALF_WIDTH] = (k * g.covariance[0]).sqrt();
        row[at::HALF_HEIGHT] = (k * g.covariance[2]).sqrt();
        row[at::DISCRIMINANT] = T::of(-LOG2_E * LOG2_E) * g.inverse_determinant;
        row[at::WIDEST] = -T::of(0.5) * row[at::B] * row[at::HALF_WIDTH] / row[at::C];
        row[at::X_REST] = g.rest[0];
        row[at::Y_REST] = g.rest[1];
        Some(row)
    }
}

/// A chunk of the tables that projection fills: the splats of the active Gaussians number `first..`.
pub struct ProjectionChunk<'a, T> {
    pub first: usize,
    pub rows: &'a mut [Aligned<T>],
    /// Tiles that each visible splat meets, packed (`TileBox`).
    pub boxes: &'a mut [[u32; 2]],
    /// Sort keys of the visible splats.
    pub keys: &'a mut [u32],
    pub visible: &'a mut [bool],
}

impl<T: Real> ProjectionChunk<'_, T> {
    /// Projects the Gaussians of the chunk.
    pub fn fill(
        &mut self,
        projector: &Projector<T>,
        gaussians: &GaussianSlices<'_, T>,
        active: Option<&[u32]>,
        tiling: &Tiling,
    ) {
        self.fill_with(projector, gaussians, active, |_, i| {
            let row = projector.project(gaussians, i)?;
            Some((row, TileBox::of(&row, tiling)))
        });
    }

    /// Calls `splat` for each Gaussian (number within the chunk, number of the Gaussian) and writes the row and the
    /// tiles that it returns; `None` marks an invisible one.
    pub fn fill_with(
        &mut self,
        projector: &Projector<T>,
        gaussians: &GaussianSlices<'_, T>,
        active: Option<&[u32]>,
        mut splat: impl FnMut(usize, usize) -> Option<(SplatRow<T>, TileBox)>,
    ) {
        for k in 0..self.rows.len() {
            let i = active.map_or(self.first + k, |list| list[self.first + k] as usize);
            let visible = splat(k, i);
            self.visible[k] = visible.is_some();
            if let Some((row, tiles)) = visible {
                self.boxes[k] = tiles.pack();
                self.keys[k] = projector.key(gaussians.positions[i]);
                self.rows[k].0 = row;
            }
        }
    }
}

/// Writes the colours of the visible Gaussians number `first..` into their rows and leaves the rest unchanged; `false`
/// if one is not finite.
pub fn recolor<T: Real>(
    projector: &Projector<T>,
    gaussians: &GaussianSlices<'_, T>,
    active: Option<&[u32]>,
    first: usize,
    visible: &[bool],
    rows: &mut [Aligned<T>],
) -> bool {
    let mut finite = true;
    for (k, row) in rows.iter_mut().enumerate().filter(|(k, _)| visible[*k]) {
        let i = active.map_or(first + k, |list| list[first + k] as usize);
        let offset = [0, 1, 2].each(|c| gaussians.positions[i][c] - projector.eye[c]);
        let distance = dot(offset, offset).sqrt();
        let shown = gaussians.color(i, offset.each(|v| v / distance));
        finite &= (shown[0] + shown[1] + shown[2]).is_finite();
        for c in 0..3 {
            row.0[at::RED + c] = shown[c].maximum(T::zero());
        }
    }
    finite
}
