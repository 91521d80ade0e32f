//! From the sums of one exact disc to the gradients of its Gaussian and of the camera; symbols as in `disc.rs`.

use crate::splat::number::{Each, Real, add, cross, dot};
use crate::splat::types::table::{DiscSums, disc_sum as sum};
use crate::splat::types::{GaussianSlices, Wanted};

use super::chain::{GaussianGradient, by_view_direction, color_gradient, pose_gradient};
use super::disc::DiscInCamera;
use super::fault::{Fault, Faults};
use super::projector::Projector;

/// Gradients of Gaussian `i` from its sums `m`, those of the SH into `by_sh` (empty if not wanted); `None` where a
/// number is not finite.
pub fn gradients_of_disc<T: Real>(
    projector: &Projector<T>,
    gaussians: &GaussianSlices<'_, T>,
    i: usize,
    m: &DiscSums<T>,
    wanted: Wanted,
    by_sh: &mut [T],
    faults: impl Faults,
) -> Option<GaussianGradient<T>> {
    let placed = DiscInCamera::of(projector, gaussians, i);
    let (t, a, b) = (placed.t, placed.a, placed.b);
    let disc = placed.disc();
    let mut one = GaussianGradient::zero();
    let opacity = gaussians.opacities[i];
    one.opacity = if faults.has(Fault::OpacityFactorMissing) { m[sum::S] } else { m[sum::S] / opacity };
    let through_position = wanted.any(Wanted::POSITIONS | Wanted::POSE | Wanted::LENS);
    let mut by_direction = [T::zero(); 3];
    if wanted.any(Wanted::SH) || (through_position && gaussians.sh_degree > 0) {
        let distance = dot(placed.offset, placed.offset).sqrt();
        let direction = placed.offset.each(|v| v / distance);
        let rgb = [m[sum::RED], m[sum::RED + 1], m[sum::RED + 2]];
        let free = color_gradient(gaussians, i, direction, rgb, by_sh, faults);
        by_direction = by_view_direction(free, direction, distance);
    }
    let three = |at: usize| [m[at], m[at + 1], m[at + 2]];
    let (by_p, by_q) = (three(sum::P), three(sum::Q));
    // The three normals of the intersection; N.t is the height.
    let by_n = add(three(sum::N), t.each(|v| v * m[sum::HEIGHT]));
    // The axes: P = b x t, Q = t x a, N = a x b.
    let by_a = add(cross(by_q, t), cross(b, by_n));
    let by_b = add(cross(t, by_p), cross(by_n, a));
    let [first, second] = gaussians.shape.disc_columns(i);
    let mut by_columns = [[T::zero(); 3]; 3];
    (by_columns[first], by_columns[second]) = (by_a, by_b);
    if wanted.any(Wanted::SHAPES) {
        one.columns = by_columns.each(|v| projector.turn_back(v));
    }
    if through_position {
        // The centre: through P and Q, the height, the depth, and the centre of the screen filter.
        let over = T::one() / t[2];
        let mut by_t = add(cross(by_p, b), cross(a, by_q));
        for k in 0..3 {
            // The centre's ray, relative to which the other rays are given, moves with it.
            by_t[k] -= (disc.p[k] * m[sum::P_ALONG] + disc.q[k] * m[sum::Q_ALONG]) * over;
            by_t[k] += disc.n[k] * m[sum::HEIGHT];
        }
        by_t[2] += m[sum::DEPTH];
        let filtered = projector.dilation > T::zero() && !faults.has(Fault::FilterCenterHeldFixed);
        let over_variance = if filtered { T::one() / projector.dilation } else { T::zero() };
        let by_point = [m[sum::FILTER] * over_variance, m[sum::FILTER + 1] * over_variance];
        let through_filter = projector.lens.pullback(t, by_point, [[T::zero(); 3]; 2], faults);
        by_t = add(by_t, through_filter);
        one.position = add(projector.turn_back(by_t), by_direction);
        if wanted.any(Wanted::POSE) {
            let mut columns = [[T::zero(); 3]; 3];
            (columns[first], columns[second]) = (a, b);
            one.pose = pose_gradient(projector, t, &columns, by_t, &by_columns, by_direction, faults);
        }
        if wanted.any(Wanted::LENS) {
            one.lens = lens(projector, &placed, m, by_point);
        }
    }
    let colors = m[sum::RED] + m[sum::RED + 1] + m[sum::RED + 2];
    (one.is_finite() && colors.is_finite()).then_some(one)
}

/// Gradients of the intrinsics of a pinhole: the rays of the pixels turn, and the centre on screen moves.
fn lens<T: Real>(projector: &Projector<T>, placed: &DiscInCamera<T>, m: &DiscSums<T>, by_point: [T; 2]) -> [T; 4] {
    let (t, disc) = (placed.t, placed.disc());
    let point = projector.lens.image_of(t).point;
    let mut out = [T::zero(); 4];
    for k in 0..2 {
        let focal = projector.lens.focal[k];
        // Sums over the pixels of the gradients of P.d, Q.d, N.d with d_x (or d_y), and with d_z = 1.
        let p = m[sum::P + k] + disc.slope[k] * m[sum::P_ALONG];
        let q = m[sum::Q + k] + disc.slope[k] * m[sum::Q_ALONG];
        let spread = disc.p[k] * p + disc.q[k] * q + disc.n[k] * m[sum::N + k];
        let along = disc.p[k] * m[sum::P_ALONG] + disc.q[k] * m[sum::Q_ALONG] + disc.n[k] * m[sum::N + 2];
        let center = projector.lens.center[k];
        out[k] = ((point[k] - center) * by_point[k] - spread) / focal;
        out[2 + k] = by_point[k] - along / focal;
    }
    out
}
