//! From the moments of one splat to the gradients of its Gaussian and of the camera: the reverse of `project.rs`, with
//! its symbols. The projection is computed again rather than stored.

use crate::splat::number::{Each, Real, cross, dot, normalized, rotation_columns, sh};
use crate::splat::types::table::{SplatRow, moment};
use crate::splat::types::{Filter, GaussianSlices, ShapeSlices, Wanted};

use super::fault::{Fault, Faults};
use super::lens::LensPoint;
use super::project::Geometry;
use super::projector::Projector;

/// Gradients of one Gaussian.
pub struct GaussianGradient<T> {
    pub position: [T; 3],
    pub opacity: T,
    /// With respect to the columns of the square root of the covariance, world axes.
    pub columns: [[T; 3]; 3],
    pub pose: [T; 6],
    /// With respect to `fl_x`, `fl_y`, `cx`, `cy`.
    pub lens: [T; 4],
}

impl<T: Real> GaussianGradient<T> {
    pub fn zero() -> Self {
        let zero = [T::zero(); 3];
        GaussianGradient {
            position: zero,
            opacity: T::zero(),
            columns: [zero; 3],
            pose: [T::zero(); 6],
            lens: [T::zero(); 4],
        }
    }

    /// True when every number is finite: a sum is finite only if every term is.
    #[inline(always)]
    pub fn is_finite(&self) -> bool {
        let ones = [T::one(); 3];
        let [a, b, c] = self.columns.each(|column| dot(column, ones));
        let pose = self.pose.iter().chain(&self.lens).fold(T::zero(), |sum, &v| sum + v);
        (self.opacity + dot(self.position, ones) + a + b + c + pose).is_finite()
    }
}

/// Gradient of the covariance on screen `(va, vb; vb, vc)` from that of the conic: `-Q G Q`.
#[inline(always)]
fn covariance_gradient<T: Real>(g: &Geometry<T>, m: &SplatRow<T>, faults: impl Faults) -> [T; 3] {
    let half = T::of(if faults.has(Fault::CovarianceSignFlipped) { -0.5 } else { 0.5 });
    let [a, b, c] = g.conic;
    let mixed = if faults.has(Fault::MixedMomentHalved) { half * m[moment::XY] } else { m[moment::XY] };
    let (ga, gb, gc) = (-half * m[moment::XX], -half * mixed, -half * m[moment::YY]);
    let (e0, e1) = (a * ga + b * gb, a * gb + b * gc);
    let (e2, e3) = (b * ga + c * gb, b * gb + c * gc);
    [-(e0 * a + e1 * b), -(e0 * b + e1 * c), -(e2 * b + e3 * c)]
}

/// Adds to `by_u` the gradient through the factor `sqrt(det / det dilated)` of the opacity; `by_log` is the gradient
/// by the logarithm of that factor. `det` is the sum of the squares of the cross products of the `u`.
#[inline(always)]
fn compensation_pullback<T: Real>(g: &Geometry<T>, by_log: T, by_u: &mut [[T; 2]; 3]) {
    let [a, b, c] = g.conic;
    let over = T::one() / g.plain_determinant;
    for k in 0..3 {
        let [x, y] = g.u[k];
        let (mut dx, mut dy) = (-(a * x + b * y), -(b * x + c * y));
        for other in (0..3).filter(|&other| other != k) {
            let [ox, oy] = g.u[other];
            let cross = (x * oy - y * ox) * over;
            dx += cross * oy;
            dy -= cross * ox;
        }
        by_u[k][0] += by_log * dx;
        by_u[k][1] += by_log * dy;
    }
}

/// Writes the gradient of the SH coefficients (unless `by_sh` is empty) and returns that of the view direction (as
/// if its length were free).
#[inline(always)]
pub fn color_gradient<T: Real>(
    gaussians: &GaussianSlices<'_, T>,
    i: usize,
    direction: [T; 3],
    by_color: [T; 3],
    by_sh: &mut [T],
    faults: impl Faults,
) -> [T; 3] {
    let coefficients = gaussians.coefficients(i);
    let basis = sh::basis(direction, gaussians.sh_degree);
    let shown = sh::color(&basis, coefficients);
    let shows = |k: usize| shown[k] > T::zero() || faults.has(Fault::ColorCutIgnored);
    let v = [0, 1, 2].each(|k| if shows(k) { by_color[k] } else { T::zero() });
    for (place, b) in by_sh.as_chunks_mut::<3>().0.iter_mut().zip(&basis) {
        *place = v.each(|k| *b * k);
    }
    if gaussians.sh_degree == 0 || faults.has(Fault::ViewDirectionHeldFixed) {
        return [T::zero(); 3];
    }
    let mut weights = [T::zero(); 16];
    for (weight, rgb) in weights.iter_mut().zip(coefficients.as_chunks::<3>().0) {
        *weight = dot(*rgb, v);
    }
    sh::basis_pullback(direction, gaussians.sh_degree, &weights)
}

/// Gradient through the normalisation of the view direction.
#[inline(always)]
pub fn by_view_direction<T: Real>(free: [T; 3], direction: [T; 3], distance: T) -> [T; 3] {
    let along = dot(free, direction);
    [0, 1, 2].each(|k| (free[k] - along * direction[k]) / distance)
}

/// Gradients of Gaussian `i` from the moments `m` of its splat, those of the SH into `by_sh` (empty if not wanted);
/// `None` where a number is not finite.
#[inline(always)]
pub fn gradients_of_splat<T: Real>(
    projector: &Projector<T>,
    gaussians: &GaussianSlices<'_, T>,
    i: usize,
    m: &SplatRow<T>,
    wanted: Wanted,
    by_sh: &mut [T],
    faults: impl Faults,
) -> Option<GaussianGradient<T>> {
    let g = projector.geometry(gaussians.positions[i], gaussians.shape.columns(i))?;
    let mut one = GaussianGradient::zero();
    // Opacity: alpha is proportional to it, and S sums alpha d loss / d alpha.
    let opacity = gaussians.opacities[i];
    one.opacity = if faults.has(Fault::OpacityFactorMissing) { m[moment::S] } else { m[moment::S] / opacity };
    let through_position = wanted.any(Wanted::POSITIONS | Wanted::POSE | Wanted::LENS);
    // Colour: the SH coefficients, and the view direction through their basis.
    let mut by_direction = [T::zero(); 3];
    if wanted.any(Wanted::SH) || (through_position && gaussians.sh_degree > 0) {
        let by_color = [m[moment::RED], m[moment::RED + 1], m[moment::RED + 2]];
        let free = color_gradient(gaussians, i, g.direction, by_color, by_sh, faults);
        by_direction = by_view_direction(free, g.direction, g.distance);
    }
    if through_position || wanted.any(Wanted::SHAPES) {
        // Columns on screen, covariance = sum u_k u_k^T + dilation I: d loss / d u_k = 2 V u_k.
        let [va, vb, vc] = covariance_gradient(&g, m, faults);
        let two = T::of(if faults.has(Fault::ColumnFactorMissing) { 1.0 } else { 2.0 });
        let mut by_u = g.u.each(|[x, y]| [two * (va * x + vb * y), two * (vb * x + vc * y)]);
        if projector.filter == Filter::Compensate && !faults.has(Fault::CompensationHeldFixed) {
            compensation_pullback(&g, m[moment::S], &mut by_u);
        }
        // Columns in camera axes, u_k = J c_k.
        let j = &g.jacobian;
        let by_c = by_u.each(|v| [0, 1, 2].each(|k| j[0][k] * v[0] + j[1][k] * v[1]));
        if wanted.any(Wanted::SHAPES) {
            let transposed = faults.has(Fault::CameraTransposed);
            one.columns = by_c.each(|v| if transposed { projector.turn(v) } else { projector.turn_back(v) });
        }
        if through_position {
            // The Jacobian, through all u_k; then the centre, through its image point, the Jacobian and the depth.
            let mut by_jacobian = [[T::zero(); 3]; 2];
            for (v, c) in by_u.iter().zip(&g.c) {
                for (row, weight) in by_jacobian.iter_mut().zip(v) {
                    for (entry, part) in row.iter_mut().zip(c) {
                        *entry += *weight * *part;
                    }
                }
            }
            if faults.has(Fault::JacobianHeldFixed) {
                by_jacobian = [[T::zero(); 3]; 2];
            }
            let (sx, sy) = (m[moment::X], m[moment::Y]);
            let by_point = [g.conic[0] * sx + g.conic[1] * sy, g.conic[1] * sx + g.conic[2] * sy];
            let mut by_t = projector.lens.pullback(g.t, by_point, by_jacobian, faults);
            by_t[2] += m[moment::DEPTH];
            let back = projector.turn_back(by_t);
            one.position = [0, 1, 2].each(|k| back[k] + by_direction[k]);
            if wanted.any(Wanted::POSE) {
                one.pose = pose_gradient(projector, g.t, &g.c, by_t, &by_c, by_direction, faults);
            }
            if wanted.any(Wanted::LENS) {
                let image = LensPoint { point: g.point, jacobian: g.jacobian };
                one.lens = projector.lens.intrinsics_pullback(g.t, &image, by_point, by_jacobian);
            }
        }
    }
    let colors = m[moment::RED] + m[moment::RED + 1] + m[moment::RED + 2];
    (one.is_finite() && colors.is_finite()).then_some(one)
}

/// Gradient by a motion of the camera, which turns and shifts the centre and turns the columns in camera axes. A
/// rotation does not move the eye.
#[inline(always)]
pub fn pose_gradient<T: Real>(
    projector: &Projector<T>,
    t: [T; 3],
    columns: &[[T; 3]; 3],
    by_t: [T; 3],
    by_c: &[[T; 3]; 3],
    by_direction: [T; 3],
    faults: impl Faults,
) -> [T; 6] {
    let mut turn = cross(t, by_t);
    for (c, v) in columns.iter().zip(by_c) {
        let moment = cross(*c, *v);
        for k in 0..3 {
            turn[k] += moment[k];
        }
    }
    let eye = if faults.has(Fault::EyeHeldFixed) { [T::zero(); 3] } else { projector.turn(by_direction) };
    [turn[0], turn[1], turn[2], by_t[0] + eye[0], by_t[1] + eye[1], by_t[2] + eye[2]]
}

/// Gradients of quaternion and scales of ellipsoid `i` from that of its columns.
#[inline(always)]
pub fn ellipsoid_gradient<T: Real>(
    shape: ShapeSlices<'_, T>,
    i: usize,
    by_columns: &[[T; 3]; 3],
    faults: impl Faults,
) -> ([T; 4], [T; 3]) {
    let ShapeSlices::Ellipsoids { rotations, scales } = shape else { return ([T::zero(); 4], [T::zero(); 3]) };
    let (q, inverse_length) = normalized(rotations[i]);
    let axes = rotation_columns(q);
    let by_scale = [0, 1, 2].each(|k| dot(by_columns[k], axes[k]));
    // r[column][row] = dL/dR
    let mut r = [0, 1, 2].each(|k| by_columns[k].each(|v| v * scales[i][k]));
    if faults.has(Fault::EllipsoidTransposed) {
        r = [0, 1, 2].each(|column| [0, 1, 2].each(|row| r[row][column]));
    }
    let [w, x, y, z] = q;
    let two = T::of(2.0);
    let by_q = [
        two * (z * (r[0][1] - r[1][0]) + y * (r[2][0] - r[0][2]) + x * (r[1][2] - r[2][1])),
        two * (y * (r[1][0] + r[0][1]) + z * (r[2][0] + r[0][2]) - two * x * (r[1][1] + r[2][2])
            + w * (r[1][2] - r[2][1])),
        two * (x * (r[1][0] + r[0][1]) + z * (r[2][1] + r[1][2]) - two * y * (r[0][0] + r[2][2])
            + w * (r[2][0] - r[0][2])),
        two * (x * (r[2][0] + r[0][2]) + y * (r[2][1] + r[1][2]) - two * z * (r[0][0] + r[1][1])
            + w * (r[0][1] - r[1][0])),
    ];
    let mut along = by_q[0] * w + by_q[1] * x + by_q[2] * y + by_q[3] * z;
    if faults.has(Fault::QuaternionNotNormalized) {
        along = T::zero();
    }
    ([0, 1, 2, 3].each(|k| (by_q[k] - along * q[k]) * inverse_length), by_scale)
}
