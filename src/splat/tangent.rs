//! Forward-mode derivative of the colour image along directions in the space of parameters (JVP): a motion of every
//! Gaussian (breathing phase), the six motions of the camera, exposure. For Gauss-Newton on few unknowns: one pass per
//! direction, no gradient of anything.
//!
//! The decisions (which splats, in which order, what is left out, where a pixel stops) are those of the plain render,
//! and so is the clamp of the pinhole's Jacobian: the derivative is that of the very function that is rendered.
//! Here is the plain code for every number type: projection and compositing run in dual numbers.

use rayon::prelude::*;

use crate::base::{Error, Result};
use crate::ffi::splat::Aligned;

use super::bin::TILE;
use super::dual::Dual;
use super::kernel::{self, ForwardTile, PIXELS, PLANES, Parts, pixel_of};
use super::project::{Projector, Row, columns};
use super::rasterizer::Rasterizer;
use super::real::Real;
use super::types::{Gaussians, Settings, Shape, View};

/// Gaussians per task.
const CHUNK: usize = 512;

/// How every Gaussian moves per unit of the unknown. One entry per Gaussian (not per active one); an empty slice is
/// "not at all".
#[derive(Clone, Copy, Debug, Default)]
pub struct Motion<'a, T> {
    /// Velocity of the centres (mm).
    pub positions: &'a [[T; 3]],
    /// Velocity of the two axes of each disc (mm); discs only.
    pub axes: &'a [[[T; 3]; 2]],
    /// Velocity of the three columns `R_k s_k` of the square root of the covariance (mm); ellipsoids only. An affine
    /// motion with velocity gradient `F` has `F R_k s_k`.
    pub columns: &'a [[[T; 3]; 3]],
    /// Change of the colour beyond what the view direction does to it (before the clamp at 0).
    pub colors: &'a [[T; 3]],
}

/// A direction along which the image is differentiated.
#[derive(Clone, Copy, Debug)]
pub enum Direction<'a, T> {
    /// All Gaussians move.
    Motion(Motion<'a, T>),
    /// The camera moves, `camera_from_world <- exp(h xi) camera_from_world`, `xi` as in [`super::Gradients::pose`].
    Pose([f64; 6]),
    /// The gain changes, per channel.
    Gain([f64; 3]),
}

impl<T> Motion<'_, T> {
    fn check(&self, n: usize, discs: bool) -> Result<()> {
        let lengths = [self.positions.len(), self.axes.len(), self.columns.len(), self.colors.len()];
        if lengths.iter().any(|&length| length != 0 && length != n) {
            return Err(Error::input(format!("a motion needs one entry for each of the {n} Gaussians, or none")));
        }
        if (discs && !self.columns.is_empty()) || (!discs && !self.axes.is_empty()) {
            return Err(Error::input("a motion has axes for discs and columns for ellipsoids"));
        }
        Ok(())
    }
}

/// A vector and its velocity.
fn moving<T: Real>(value: [T; 3], velocity: [T; 3]) -> [Dual<T>; 3] {
    [0, 1, 2].map(|k| Dual::new(value[k], velocity[k]))
}

fn cross<T: Real>(a: [T; 3], b: [T; 3]) -> [T; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn add<T: Real>(a: [T; 3], b: [T; 3]) -> [T; 3] {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

/// The splat of Gaussian `i`, which is known to be visible, with its velocity along `direction`.
fn moving_row<T: Real>(
    plain: &Projector<T>,
    dual: &Projector<Dual<T>>,
    gaussians: &Gaussians<T>,
    i: usize,
    direction: &Direction<'_, T>,
) -> Option<Row<Dual<T>>> {
    let zero = [T::zero(); 3];
    let offset = [0, 1, 2].map(|k| gaussians.positions[i][k] - plain.eye[k]);
    let t = plain.turn(offset);
    let c = columns(&gaussians.shape, i).map(|m| plain.turn(m));
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
                [0, 1, 2].map(|k| moving(c[k], turned(k))),
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
                c.map(|column| moving(column, cross(omega, column))),
                zero,
            )
        }
        Direction::Gain(_) => return None,
    };
    let g = dual.geometry_of(t, c, offset)?;
    let stride = gaussians.sh_stride();
    let basis = super::sh::basis(g.direction, gaussians.sh_degree);
    let mut shown = [Dual::of(0.5); 3];
    for (weight, rgb) in basis.iter().zip(gaussians.sh[i * stride..(i + 1) * stride].as_chunks::<3>().0) {
        for k in 0..3 {
            shown[k] += *weight * Dual::constant(rgb[k]);
        }
    }
    for k in 0..3 {
        shown[k].derivative += recolored[k];
    }
    dual.row(&g, Dual::constant(gaussians.opacities[i].log2()), shown)
}

impl<T: Real> Rasterizer<T> {
    /// Renders, and differentiates the colour image along each of `directions`: one image of `height * width * 3`
    /// values per direction, d(colour)/d(unknown), with gain and background as in the render. The plain images are in
    /// [`Rasterizer::rendered`] afterwards, and [`Rasterizer::backward`] may follow.
    ///
    /// Errors: as [`Rasterizer::render`]; a motion with other lengths than the Gaussians.
    pub fn render_tangent(
        &mut self,
        gaussians: &Gaussians<T>,
        view: &View,
        settings: &Settings,
        active: Option<&[u32]>,
        directions: &[Direction<'_, T>],
    ) -> Result<&[Vec<T>]> {
        let discs = matches!(gaussians.shape, Shape::Discs { .. });
        for direction in directions {
            match direction {
                Direction::Motion(motion) => motion.check(gaussians.len(), discs)?,
                Direction::Pose(xi) if xi.iter().any(|v| !v.is_finite()) => {
                    return Err(Error::input("a motion of the camera is not finite"));
                }
                Direction::Gain(gain) if gain.iter().any(|v| !v.is_finite()) => {
                    return Err(Error::input("a change of the gain is not finite"));
                }
                _ => {}
            }
        }
        self.render(gaussians, view, settings, active)?;
        let mut images = std::mem::take(&mut self.tangents);
        images.resize_with(directions.len(), Vec::new);
        for (image, direction) in images.iter_mut().zip(directions) {
            image.resize(self.rendered.color.len(), T::zero());
            match direction {
                Direction::Gain(gain) => self.gain_tangent(settings, gain.map(T::of), image),
                _ => self.splat_tangent(gaussians, view, settings, direction, image)?,
            }
        }
        self.tangents = images;
        Ok(&self.tangents)
    }

    /// The image before the gain, times the change of the gain.
    fn gain_tangent(&self, settings: &Settings, change: [T; 3], image: &mut [T]) {
        let (tiles_x, background) = (self.bins.tiles_x, settings.background.map(T::of));
        let (width, height) = (self.rendered.width, self.rendered.height);
        for y in 0..height {
            for x in 0..width {
                let tile = &self.state[(y / TILE * tiles_x + x / TILE) * PLANES * PIXELS..][..PLANES * PIXELS];
                let p = kernel::index_of(x % TILE, y % TILE);
                let left = tile[4 * PIXELS + p];
                for k in 0..3 {
                    image[3 * (y * width + x) + k] = change[k] * (tile[k * PIXELS + p] + left * background[k]);
                }
            }
        }
    }

    fn splat_tangent(
        &self,
        gaussians: &Gaussians<T>,
        view: &View,
        settings: &Settings,
        direction: &Direction<'_, T>,
        image: &mut [T],
    ) -> Result<()> {
        let (plain, dual) = (Projector::new(view, settings)?, Projector::<Dual<T>>::new(view, settings)?);
        let (visible, active) = (&self.rendered.visible, self.active.as_deref());
        let row_of = |j: usize| {
            let i = active.map_or(j, |list| list[j] as usize);
            visible[j].then(|| moving_row(&plain, &dual, gaussians, i, direction)).flatten()
        };
        // A velocity that overflows stands still: what is left is the plain splat.
        let still = |j: usize| self.rows[j].0.map(Dual::constant);
        let rows: Vec<Aligned<Dual<T>>> = (0..visible.len())
            .into_par_iter()
            .with_min_len(CHUNK)
            .map(|j| Aligned(row_of(j).unwrap_or_else(|| still(j))))
            .collect();
        let bins = &self.bins;
        let states: Vec<Vec<Dual<T>>> = (0..bins.tiles_x * bins.tiles_y)
            .into_par_iter()
            .map(|t| {
                let span = bins.offsets[t] as usize..bins.offsets[t + 1] as usize;
                let mut state = vec![Dual::zero(); PLANES * PIXELS];
                let mut masks = vec![0; span.len()];
                kernel::scalar_forward(&mut ForwardTile {
                    rows: &rows,
                    entries: &bins.entries[span],
                    masks: &mut masks,
                    corner: [t % bins.tiles_x * TILE, t / bins.tiles_x * TILE],
                    state: &mut state,
                    parts: Parts { geometry: false, color: true, depth: false },
                });
                state
            })
            .collect();
        let (gain, background) = (settings.gain.map(T::of), settings.background.map(T::of));
        let (width, height) = (self.rendered.width, self.rendered.height);
        for (t, state) in states.iter().enumerate() {
            for p in 0..PIXELS {
                let (column, line) = pixel_of(p);
                let (x, y) = (t % bins.tiles_x * TILE + column, t / bins.tiles_x * TILE + line);
                if x >= width || y >= height {
                    continue;
                }
                let left = state[4 * PIXELS + p].derivative;
                for k in 0..3 {
                    let sum = state[k * PIXELS + p].derivative + left * background[k];
                    image[3 * (y * width + x) + k] = if sum.is_finite() { gain[k] * sum } else { T::zero() };
                }
            }
        }
        Ok(())
    }
}
