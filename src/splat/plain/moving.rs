//! Splats and discs with their velocity along a direction: projection in dual numbers.
//!
//! A motion of the camera, `t <- t + h (omega x t + tau)` in its axes, equals a motion of all Gaussians, except for
//! the view direction: turning leaves the eye where it is.

use crate::splat::number::{Dual, Each, Real, add, cross, dot, sh};
use crate::splat::types::table::SplatRow;
use crate::splat::types::{Direction, GaussianSlices, Gaussians, Motion, Shape};

use super::projector::Projector;

/// A vector and its velocity.
fn moving<T: Real>(value: [T; 3], velocity: [T; 3]) -> [Dual<T>; 3] {
    [0, 1, 2].each(|k| Dual::new(value[k], velocity[k]))
}

/// Colour of Gaussian `i` seen along a direction that moves, before the clamp at 0.
fn moving_color<T: Real>(gaussians: &GaussianSlices<'_, T>, i: usize, direction: [Dual<T>; 3]) -> [Dual<T>; 3] {
    let basis = sh::basis(direction, gaussians.sh_degree);
    let mut color = [Dual::of(0.5); 3];
    for (weight, rgb) in basis.iter().zip(gaussians.coefficients(i).as_chunks::<3>().0) {
        for k in 0..3 {
            color[k] += *weight * Dual::constant(rgb[k]);
        }
    }
    color
}

/// The splat of Gaussian `i`, which is known to be visible, with its velocity along `direction`.
pub fn moving_row<T: Real>(
    plain: &Projector<T>,
    dual: &Projector<Dual<T>>,
    gaussians: &GaussianSlices<'_, T>,
    i: usize,
    direction: &Direction<'_, T>,
) -> Option<SplatRow<Dual<T>>> {
    let zero = [T::zero(); 3];
    let offset = [0, 1, 2].each(|k| gaussians.positions[i][k] - plain.eye[k]);
    let t = plain.turn(offset);
    let c = gaussians.shape.columns(i).each(|m| plain.turn(m));
    let (offset, t, c, recolored) = match direction {
        Direction::Motion(motion) => {
            let velocity = motion.positions.get(i).copied().unwrap_or(zero);
            let turned = |k: usize| {
                let axis = motion.axes.get(i).and_then(|axes| axes.get(k)).copied();
                plain.turn(axis.or_else(|| motion.columns.get(i).map(|columns| columns[k])).unwrap_or(zero))
            };
            (
                moving(offset, velocity),
                moving(t, plain.turn(velocity)),
                [0, 1, 2].each(|k| moving(c[k], turned(k))),
                motion.colors.get(i).copied().unwrap_or(zero),
            )
        }
        Direction::Pose(xi) => {
            let xi = xi.map(T::of);
            let (omega, tau) = ([xi[0], xi[1], xi[2]], [xi[3], xi[4], xi[5]]);
            (
                // Turning leaves the eye where it is.
                moving(offset, plain.turn_back(tau)),
                moving(t, add(cross(omega, t), tau)),
                c.each(|column| moving(column, cross(omega, column))),
                zero,
            )
        }
        Direction::Gain(_) => return None,
    };
    let g = dual.geometry_of(t, c, offset)?;
    let mut shown = moving_color(gaussians, i, g.direction);
    for k in 0..3 {
        shown[k].derivative += recolored[k];
    }
    dual.row(&g, Dual::constant(gaussians.opacities[i].log2()), shown)
}

/// Velocities of one Gaussian as a disc: centre, the two axes of its disc, colour.
struct DiscVelocity<T> {
    position: [T; 3],
    axes: [[T; 3]; 2],
    color: [T; 3],
}

impl<T: Real> DiscVelocity<T> {
    fn of_motion(motion: &Motion<'_, T>, i: usize, plane: [usize; 2]) -> Self {
        let zero = [T::zero(); 3];
        let axis = |k: usize| {
            let of_disc = motion.axes.get(i).map(|axes| axes[k]);
            of_disc.or_else(|| motion.columns.get(i).map(|columns| columns[plane[k]])).unwrap_or(zero)
        };
        DiscVelocity {
            position: motion.positions.get(i).copied().unwrap_or(zero),
            axes: [axis(0), axis(1)],
            color: motion.colors.get(i).copied().unwrap_or(zero),
        }
    }

    fn of_pose(
        projector: &Projector<T>,
        gaussians: &GaussianSlices<'_, T>,
        i: usize,
        axes: [[T; 3]; 2],
        xi: [T; 6],
    ) -> Self {
        let (omega, tau) = ([xi[0], xi[1], xi[2]], [xi[3], xi[4], xi[5]]);
        let turning = |v: [T; 3]| projector.turn_back(cross(omega, projector.turn(v)));
        let offset = [0, 1, 2].each(|k| gaussians.positions[i][k] - projector.eye[k]);
        let (turned, shifted) = (turning(offset), projector.turn_back(tau));
        // Cancels the change of colour by the turning, which does not move the eye.
        let moved = [0, 1, 2].each(|k| Dual::new(offset[k], -turned[k]));
        let distance = dot(moved, moved).sqrt();
        let color = moving_color(gaussians, i, moved.each(|v| v / distance));
        DiscVelocity {
            position: [0, 1, 2].each(|k| turned[k] + shifted[k]),
            axes: axes.each(turning),
            color: color.each(|shown| shown.derivative),
        }
    }
}

/// `gaussians` as discs that move along `direction`; a velocity that is not finite counts as 0.
pub fn moving_discs<T: Real>(
    gaussians: &GaussianSlices<'_, T>,
    projector: &Projector<T>,
    direction: &Direction<'_, T>,
) -> Gaussians<Dual<T>> {
    let mut moving = gaussians.cast::<Dual<T>>();
    let mut axes = Vec::with_capacity(gaussians.len());
    let stride = gaussians.sh_stride();
    let pair = |value: [T; 3], velocity: [T; 3]| [0, 1, 2].each(|k| Dual::new(value[k], velocity[k].finite_or_zero()));
    for i in 0..gaussians.len() {
        let plane = gaussians.shape.disc_columns(i);
        let spread = gaussians.shape.columns(i);
        let disc = plane.each(|k| spread[k]);
        let velocity = match direction {
            Direction::Motion(motion) => DiscVelocity::of_motion(motion, i, plane),
            Direction::Pose(xi) => DiscVelocity::of_pose(projector, gaussians, i, disc, xi.map(T::of)),
            Direction::Gain(_) => DiscVelocity::of_motion(&Motion::default(), i, plane),
        };
        moving.positions[i] = pair(gaussians.positions[i], velocity.position);
        axes.push([0, 1].each(|k| pair(disc[k], velocity.axes[k])));
        for (value, change) in moving.sh[i * stride..].iter_mut().zip(velocity.color) {
            value.derivative = (change / T::of(sh::C0)).finite_or_zero();
        }
    }
    moving.shape = Shape::Discs { axes };
    moving
}
