//! Forward mode for exact discs: the pass of `disc_mode.rs` and `disc_tile.rs` in dual numbers, one direction at a time.
//!
//! A motion of the camera, `t <- t + h (omega x t + tau)` in its axes, is that of all Gaussians, but for what they see of
//! it: turning leaves the eye where it is. The colours take that part back, through the constant coefficient of the SH.

use crate::base::Result;

use crate::splat::number::dual::Dual;
use crate::splat::number::real::Real;
use crate::splat::number::sh;
use crate::splat::pass::rasterizer::Rasterizer;
use crate::splat::pass::tangent::{Direction, Motion, finite_or_zero};
use crate::splat::plain::disc::{cross, plane_of};
use crate::splat::plain::project::{Projector, columns, sum_of_basis};
use crate::splat::types::scene::{DepthOutput, Gaussians, Settings, Shape, View};

/// The constant SH basis function.
const SH_C0: f64 = 0.28209479177387814;

/// Velocities of one Gaussian: centre, the two axes of its disc, colour.
struct Velocity<T> {
    position: [T; 3],
    axes: [[T; 3]; 2],
    color: [T; 3],
}

impl<T: Real> Velocity<T> {
    fn of_motion(motion: &Motion<'_, T>, i: usize, plane: [usize; 2]) -> Self {
        let zero = [T::zero(); 3];
        let axis = |k: usize| {
            let of_disc = motion.axes.get(i).map(|axes| axes[k]);
            of_disc.or_else(|| motion.columns.get(i).map(|columns| columns[plane[k]])).unwrap_or(zero)
        };
        Velocity {
            position: motion.positions.get(i).copied().unwrap_or(zero),
            axes: [axis(0), axis(1)],
            color: motion.colors.get(i).copied().unwrap_or(zero),
        }
    }

    fn of_pose(projector: &Projector<T>, gaussians: &Gaussians<T>, i: usize, axes: [[T; 3]; 2], xi: [T; 6]) -> Self {
        let (omega, tau) = ([xi[0], xi[1], xi[2]], [xi[3], xi[4], xi[5]]);
        let turning = |v: [T; 3]| projector.turn_back(cross(omega, projector.turn(v)));
        let offset = [0, 1, 2].map(|k| gaussians.positions[i][k] - projector.eye[k]);
        let (turned, shifted) = (turning(offset), projector.turn_back(tau));
        // What the colour would make of the turning, with the other sign.
        let seen = [0, 1, 2].map(|k| Dual::new(offset[k], -turned[k]));
        let distance = (seen[0] * seen[0] + seen[1] * seen[1] + seen[2] * seen[2]).sqrt();
        let basis = sh::basis(seen.map(|v| v / distance), gaussians.sh_degree);
        let stride = gaussians.sh_stride();
        let still: Vec<Dual<T>> =
            gaussians.sh[i * stride..(i + 1) * stride].iter().map(|&v| Dual::constant(v)).collect();
        Velocity {
            position: [0, 1, 2].map(|k| turned[k] + shifted[k]),
            axes: axes.map(turning),
            color: sum_of_basis(&basis, &still).map(|shown| shown.derivative),
        }
    }
}

/// `gaussians` as discs that move along `direction`; a velocity that is not finite is none.
fn moving_discs<T: Real>(
    gaussians: &Gaussians<T>,
    projector: &Projector<T>,
    direction: &Direction<'_, T>,
) -> Gaussians<Dual<T>> {
    let mut moving = gaussians.cast::<Dual<T>>();
    let mut axes = Vec::with_capacity(gaussians.len());
    let stride = gaussians.sh_stride();
    let pair = |value: [T; 3], velocity: [T; 3]| [0, 1, 2].map(|k| Dual::new(value[k], finite_or_zero(velocity[k])));
    for i in 0..gaussians.len() {
        let plane = plane_of(&gaussians.shape, i);
        let spread = columns(&gaussians.shape, i);
        let disc = plane.map(|k| spread[k]);
        let velocity = match direction {
            Direction::Motion(motion) => Velocity::of_motion(motion, i, plane),
            Direction::Pose(xi) => Velocity::of_pose(projector, gaussians, i, disc, xi.map(T::of)),
            Direction::Gain(_) => Velocity::of_motion(&Motion::default(), i, plane),
        };
        moving.positions[i] = pair(gaussians.positions[i], velocity.position);
        axes.push([0, 1].map(|k| pair(disc[k], velocity.axes[k])));
        for (value, change) in moving.sh[i * stride..].iter_mut().zip(velocity.color) {
            value.derivative = finite_or_zero(change / T::of(SH_C0));
        }
    }
    moving.shape = Shape::Discs { axes };
    moving
}

impl<T: Real> Rasterizer<T> {
    /// Derivative of the colours of exact discs along `direction`, of the Gaussians that the last render took.
    pub(in crate::splat) fn disc_tangent(
        &self,
        gaussians: &Gaussians<T>,
        view: &View,
        settings: &Settings,
        direction: &Direction<'_, T>,
        image: &mut [T],
    ) -> Result<()> {
        let moving = moving_discs(gaussians, &Projector::new(view, settings)?, direction);
        let settings = Settings { depth: DepthOutput::Skip, ..*settings };
        let mut rasterizer = Rasterizer::<Dual<T>>::new();
        let rendered = rasterizer.render(&moving, view, &settings, self.active.as_deref())?;
        for (out, moved) in image.iter_mut().zip(&rendered.color) {
            *out = finite_or_zero(moved.derivative);
        }
        Ok(())
    }
}
