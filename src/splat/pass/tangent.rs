//! Forward-mode derivative of the colour image along directions in the space of parameters (JVP): a motion of every
//! Gaussian (breathing phase), the six motions of the camera, exposure. For Gauss-Newton on few unknowns: one pass per
//! direction, no gradient of anything.
//!
//! The decisions (which splats, in which order, what is left out, where a pixel stops) are those of the plain render,
//! and so is the clamp of the pinhole's Jacobian: the derivative is that of the very function that is rendered.
//! The vectorised kernels composite values and up to four velocities in one pass; the plain twin, for every number type,
//! runs projection and compositing in dual numbers. Exact discs: `disc_tangent.rs`.

use rayon::prelude::*;

use crate::base::{Error, Result};
use crate::ffi::splat::rasterize::Aligned;

use crate::splat::kernels::Numbers;
use crate::splat::number::dual::Dual;
use crate::splat::number::real::Real;
use crate::splat::pass::pool::{PIECE, in_pool};
use crate::splat::pass::rasterizer::{CHUNK, Rasterizer};
use crate::splat::plain::project::{Projector, Row, columns};
use crate::splat::plain::tile::{self as kernel, ForwardTile, MOVING, PIXELS, PLANES, Parts, TOGETHER};
use crate::splat::types::scene::{DepthOutput, Filter, Footprint, Gaussians, Settings, Shape, View};
use crate::splat::types::skips::Skips;
use crate::splat::types::tiling::TILE_SIDE;

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
    /// The camera moves, `camera_from_world <- exp(h xi) camera_from_world`, `xi` as in [`crate::splat::Gradients::pose`].
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

pub(in crate::splat) fn finite_or_zero<T: Real>(v: T) -> T {
    if v.is_finite() { v } else { T::zero() }
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
    let basis = crate::splat::number::sh::basis(g.direction, gaussians.sh_degree);
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
        let mut images = std::mem::take(&mut self.tangents);
        images.resize_with(directions.len(), Vec::new);
        let done = in_pool(|| self.render_moving(gaussians, view, settings, active, directions, &mut images))?;
        if !done {
            self.render(gaussians, view, settings, active)?;
        }
        for (image, direction) in images.iter_mut().zip(directions) {
            image.resize(self.rendered.color.len(), T::zero());
            match direction {
                Direction::Gain(gain) => self.gain_tangent(settings, gain.map(T::of), image),
                _ if done => {}
                _ if settings.footprint == Footprint::Disc => {
                    self.disc_tangent(gaussians, view, settings, direction, image)?;
                }
                _ => self.splat_tangent(gaussians, view, settings, direction, image)?,
            }
        }
        self.tangents = images;
        Ok(&self.tangents)
    }

    /// Renders and differentiates along all directions but the gain with the vectorised kernels, up to four at once;
    /// `false` when there are none, or nothing for them to do.
    fn render_moving(
        &mut self,
        gaussians: &Gaussians<T>,
        view: &View,
        settings: &Settings,
        active: Option<&[u32]>,
        directions: &[Direction<'_, T>],
        images: &mut [Vec<T>],
    ) -> Result<bool> {
        let is_motion = |d: &Direction<'_, T>| !matches!(d, Direction::Gain(_));
        let moving: Vec<usize> = (0..directions.len()).filter(|&d| is_motion(&directions[d])).collect();
        let projector = Projector::new(view, settings)?;
        // The velocity of a splat has no place for that of its opacity.
        let usable = settings.filter == Filter::Dilate
            && T::native(self.isa, gaussians, &projector, &mut Numbers::default(), None).is_some();
        if moving.is_empty() || !usable || matches!(settings.depth, DepthOutput::Surface | DepthOutput::Median) {
            return Ok(false);
        }
        let mut known = usize::from(self.prepare(gaussians, view, settings, active, Some(&directions[moving[0]]))?);
        for group in moving.chunks(TOGETHER) {
            let mut velocities = std::mem::take(&mut self.velocities);
            let along = group.iter().map(|&d| &directions[d]);
            self.velocities_of(gaussians, &projector, along, &mut velocities, std::mem::take(&mut known));
            self.composite(DepthOutput::Skip, &velocities, group.len());
            self.velocities = velocities;
            for (k, &d) in group.iter().enumerate() {
                images[d].resize(view.camera.width as usize * view.camera.height as usize * 3, T::zero());
                self.develop_moving(view, settings, [k, group.len()], &mut images[d]);
            }
        }
        if settings.depth == DepthOutput::Expected {
            self.composite(DepthOutput::Expected, &[], 0);
        }
        self.develop(view, settings);
        Ok(true)
    }

    /// Velocities of all visible splats, direction by direction; those along the first `known` are there.
    fn velocities_of<'d>(
        &self,
        gaussians: &Gaussians<T>,
        projector: &Projector<T>,
        directions: impl ExactSizeIterator<Item = &'d Direction<'d, T>>,
        velocities: &mut Vec<[T; 8]>,
        known: usize,
    ) {
        let (n, visible) = (self.rows.len(), &self.rendered.visible);
        velocities.resize(n * directions.len(), [T::zero(); 8]);
        let mut numbers = Numbers::default();
        let native = T::native(self.isa, gaussians, projector, &mut numbers, self.active.as_deref());
        for (rows, direction) in velocities.chunks_mut(n).zip(directions).skip(known) {
            let chunks = rows.par_chunks_mut(CHUNK).zip(visible.par_chunks(CHUNK)).enumerate().with_max_len(PIECE);
            chunks.for_each(|(c, (rows, visible))| {
                if let Some(native) = &native {
                    native.velocities(c * CHUNK, visible, direction, &mut rows[..visible.len()]);
                }
            });
        }
    }

    /// Image of direction `k` of `directions` from the tiles' velocities.
    fn develop_moving(&self, view: &View, settings: &Settings, [k, directions]: [usize; 2], image: &mut [T]) {
        let width = view.camera.width as usize;
        let (gain, background) = (settings.gain.map(T::of), settings.background.map(T::of));
        let (tiles_x, size) = (self.bins.tiling.columns, MOVING * PIXELS);
        let side = TILE_SIDE;
        image.par_chunks_mut(3 * width * side).enumerate().with_max_len(PIECE).for_each(|(tile_y, band)| {
            let tiles = &self.moving[tile_y * tiles_x * directions * size..][..tiles_x * directions * size];
            if T::develop_moving(tiles, [k, directions], [width, side], settings, band) {
                return;
            }
            for (line, pixels) in band.chunks_mut(3 * width).enumerate() {
                for (piece, pixels) in pixels.chunks_mut(12).enumerate() {
                    let tile = (tile_y * tiles_x + 4 * piece / side) * directions + k;
                    let p = kernel::index_of(4 * piece % side, line);
                    let plane = |c: usize| &self.moving[tile * size + c * PIXELS + p..][..4];
                    let (sums, left) = ([plane(0), plane(1), plane(2)], plane(3));
                    for (i, pixel) in pixels.as_chunks_mut::<3>().0.iter_mut().enumerate() {
                        *pixel = [0, 1, 2].map(|c| finite_or_zero(gain[c] * (sums[c][i] + left[i] * background[c])));
                    }
                }
            }
        });
    }

    /// The image before the gain, times the change of the gain.
    fn gain_tangent(&self, settings: &Settings, change: [T; 3], image: &mut [T]) {
        let background = settings.background.map(T::of);
        let (width, height) = (self.rendered.width, self.rendered.height);
        for y in 0..height {
            for x in 0..width {
                let (t, p) = self.bins.tiling.place(x, y);
                let tile = &self.state[t * PLANES * PIXELS..][..PLANES * PIXELS];
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
        let states: Vec<Vec<Dual<T>>> = (0..bins.tiling.count())
            .into_par_iter()
            .map(|t| {
                let span = bins.offsets[t] as usize..bins.offsets[t + 1] as usize;
                let mut state = vec![Dual::zero(); PLANES * PIXELS];
                let mut masks = vec![0; span.len()];
                kernel::scalar_forward(&mut ForwardTile {
                    rows: &rows,
                    entries: &bins.entries[span],
                    masks: &mut masks,
                    corner: bins.tiling.corner(t),
                    state: &mut state,
                    parts: Parts {
                        geometry: false,
                        color: true,
                        depth: false,
                        known: false,
                        endless: !self.skips.any(Skips::STOP),
                    },
                });
                state
            })
            .collect();
        let (gain, background) = (settings.gain.map(T::of), settings.background.map(T::of));
        let size = [self.rendered.width, self.rendered.height];
        for (t, state) in states.iter().enumerate() {
            for p in 0..PIXELS {
                let Some([x, y]) = bins.tiling.pixel(t, p, size) else { continue };
                let left = state[4 * PIXELS + p].derivative;
                for k in 0..3 {
                    let sum = state[k * PIXELS + p].derivative + left * background[k];
                    image[3 * (y * size[0] + x) + k] = finite_or_zero(gain[k] * sum);
                }
            }
        }
        Ok(())
    }
}
