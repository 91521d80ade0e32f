//! Forward-mode derivative of the colour image along directions in the space of parameters (JVP): a motion of every
//! Gaussian (breathing phase), the six motions of the camera, exposure. For Gauss-Newton on few unknowns: one pass per
//! direction and no backward pass.
//!
//! The decisions (which splats, in which order, what is left out, where a pixel stops) are those of the plain render,
//! and so is the clamp of the pinhole's Jacobian: the derivative is exactly that of the rendered function. The
//! vectorised kernels composite values and up to four velocities in one pass; the plain twin, for every number type,
//! runs projection (`plain/moving.rs`) and compositing in dual numbers, and so do exact discs, whole passes of them.

use rayon::prelude::*;

use crate::base::Result;
use crate::ffi::splat::rasterize::Aligned;
use crate::splat::kernels::{DevelopedDirection, KernelScene, SplatKernels, VelocityKernels};
use crate::splat::number::{Dual, Real};
use crate::splat::plain::moving::{moving_discs, moving_row};
use crate::splat::plain::projector::Projector;
use crate::splat::plain::tile::{self, ForwardTile, Parts};
use crate::splat::types::table::{DIRECTIONS_PER_PASS, PLANES, VELOCITY_PLANES};
use crate::splat::types::{
    DepthOutput, Direction, Footprint, GaussianSlices, PIXELS, Settings, Skips, TILE_SIDE, View,
};

use super::forward::{MovingSplats, image_formation};
use super::options::RenderRequest;
use super::pool::{CHUNK, PIECE, in_pool};
use super::rasterizer::Rasterizer;

impl<T: SplatKernels> Rasterizer<T> {
    /// Renders, and differentiates the colour image along each of `directions`: one image of `height * width * 3`
    /// values per direction, d(colour)/d(unknown), with gain and background as in the render. The plain images are in
    /// [`Rasterizer::rendered`] afterwards, and [`Rasterizer::backward`] may follow.
    ///
    /// Errors: as [`Rasterizer::render`]; a motion with other lengths than the Gaussians.
    pub fn render_tangent<'g>(
        &mut self,
        gaussians: impl Into<GaussianSlices<'g, T>>,
        view: &View,
        settings: &Settings,
        active: Option<&[u32]>,
        directions: &[Direction<'_, T>],
    ) -> Result<&[Vec<T>]>
    where
        T: 'g,
    {
        let gaussians = gaussians.into();
        directions.iter().try_for_each(|direction| direction.check(&gaussians))?;
        let mut images = std::mem::take(&mut self.tangents.images);
        images.resize_with(directions.len(), Vec::new);
        let request = RenderRequest { gaussians, view, settings, active };
        let done = in_pool(|| self.render_moving(request, directions, &mut images))?;
        if !done {
            self.render(gaussians, view, settings, active)?;
        }
        for (image, direction) in images.iter_mut().zip(directions) {
            image.resize(self.images.rendered.color.len(), T::zero());
            match direction {
                Direction::Gain(gain) => self.gain_tangent(settings, gain.map(T::of), image),
                _ if done => {}
                _ if settings.footprint == Footprint::Disc => self.disc_tangent(request, direction, image)?,
                _ => self.splat_tangent(request, direction, image)?,
            }
        }
        self.tangents.images = images;
        Ok(&self.tangents.images)
    }

    /// Renders and differentiates along all directions but the gain with the vectorised kernels, up to four at once;
    /// `false` if there are no such kernels or directions.
    fn render_moving(
        &mut self,
        request: RenderRequest<'_, T>,
        directions: &[Direction<'_, T>],
        images: &mut [Vec<T>],
    ) -> Result<bool> {
        let RenderRequest { gaussians, view, settings, .. } = request;
        let is_motion = |d: &Direction<'_, T>| !matches!(d, Direction::Gain(_));
        let moving: Vec<usize> = (0..directions.len()).filter(|&d| is_motion(&directions[d])).collect();
        let projector = Projector::new(view, settings)?;
        let Some(kernels) = T::velocity_kernels(&KernelScene::new(self.options.isa, gaussians, &projector, None))
        else {
            return Ok(false);
        };
        if moving.is_empty() || matches!(settings.depth, DepthOutput::Surface | DepthOutput::Median) {
            return Ok(false);
        }
        let mut known = usize::from(self.prepare(request, Some(&directions[moving[0]]))?);
        for group in moving.chunks(DIRECTIONS_PER_PASS) {
            let mut velocities = std::mem::take(&mut self.tangents.velocities);
            let scene = KernelScene::new(self.options.isa, gaussians, &projector, self.active.as_deref());
            let along = group.iter().map(|&d| &directions[d]);
            self.velocities_of(&kernels, &scene, along, &mut velocities, std::mem::take(&mut known));
            let of = MovingSplats { kernels: &kernels, velocities: &velocities, directions: group.len() };
            self.composite_moving(view, settings, &of);
            self.tangents.velocities = velocities;
            for (k, &d) in group.iter().enumerate() {
                let [width, height] = view.size();
                images[d].resize(width * height * 3, T::zero());
                let direction = DevelopedDirection { number: k, of: group.len(), width };
                self.develop_moving(&kernels, settings, direction, &mut images[d]);
            }
        }
        if settings.depth == DepthOutput::Expected {
            self.composite(view, settings);
        }
        self.develop(view, settings);
        Ok(true)
    }

    /// Velocities of all visible splats, direction by direction; those along the first `known` are already computed.
    fn velocities_of<'d>(
        &self,
        kernels: &VelocityKernels<T>,
        scene: &KernelScene<'_, T>,
        directions: impl ExactSizeIterator<Item = &'d Direction<'d, T>>,
        velocities: &mut Vec<[T; 8]>,
        known: usize,
    ) {
        let (n, visible) = (self.splats.rows.len(), &self.images.rendered.visible);
        velocities.resize(n * directions.len(), [T::zero(); 8]);
        for (rows, direction) in velocities.chunks_mut(n).zip(directions).skip(known) {
            let chunks = rows.par_chunks_mut(CHUNK).zip(visible.par_chunks(CHUNK)).enumerate().with_max_len(PIECE);
            chunks.for_each(|(c, (rows, visible))| {
                (kernels.velocities)(scene, c * CHUNK, visible, direction, &mut rows[..visible.len()]);
            });
        }
    }

    /// Image of one direction from the tiles' velocities.
    fn develop_moving(
        &self,
        kernels: &VelocityKernels<T>,
        settings: &Settings,
        direction: DevelopedDirection,
        image: &mut [T],
    ) {
        let per_row = self.bins.tiling.columns * direction.of * VELOCITY_PLANES * PIXELS;
        let bands = image.par_chunks_mut(3 * direction.width * TILE_SIDE).enumerate().with_max_len(PIECE);
        bands.for_each(|(row, band)| {
            let tiles = &self.tangents.moved[row * per_row..][..per_row];
            (kernels.develop)(tiles, direction, &image_formation(settings, false), band);
        });
    }

    /// The image before the gain, times the change of the gain.
    fn gain_tangent(&self, settings: &Settings, change: [T; 3], image: &mut [T]) {
        let background = settings.background.map(T::of);
        let (width, height) = (self.images.rendered.width, self.images.rendered.height);
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

    /// Derivative of the colours of exact discs along `direction`, of the Gaussians that the last render took.
    fn disc_tangent(&self, request: RenderRequest<'_, T>, direction: &Direction<'_, T>, image: &mut [T]) -> Result<()> {
        let RenderRequest { gaussians, view, settings, .. } = request;
        let moving = moving_discs(&gaussians, &Projector::new(view, settings)?, direction);
        let settings = Settings { depth: DepthOutput::Skip, ..*settings };
        let mut rasterizer = Rasterizer::<Dual<T>>::new();
        let rendered = rasterizer.render(&moving, view, &settings, self.active.as_deref())?;
        for (out, moved) in image.iter_mut().zip(&rendered.color) {
            *out = moved.derivative.finite_or_zero();
        }
        Ok(())
    }

    /// Derivative of the colours of an affine projection along `direction`, in dual numbers.
    fn splat_tangent(
        &self,
        request: RenderRequest<'_, T>,
        direction: &Direction<'_, T>,
        image: &mut [T],
    ) -> Result<()> {
        let RenderRequest { gaussians, view, settings, .. } = request;
        let (plain, dual) = (Projector::new(view, settings)?, Projector::<Dual<T>>::new(view, settings)?);
        let (visible, active) = (&self.images.rendered.visible, self.active.as_deref());
        let row_of = |j: usize| {
            let i = active.map_or(j, |list| list[j] as usize);
            visible[j].then(|| moving_row(&plain, &dual, &gaussians, i, direction)).flatten()
        };
        // A velocity that overflows is set to 0, which leaves the plain splat.
        let still = |j: usize| self.splats.rows[j].0.map(Dual::constant);
        let rows: Vec<Aligned<Dual<T>>> = (0..visible.len())
            .into_par_iter()
            .with_min_len(CHUNK)
            .map(|j| Aligned(row_of(j).unwrap_or_else(|| still(j))))
            .collect();
        let bins = &self.bins;
        let states: Vec<Vec<Dual<T>>> = (0..bins.tiling.count())
            .into_par_iter()
            .map(|t| {
                let span = bins.span(t);
                let mut state = vec![Dual::zero(); PLANES * PIXELS];
                let mut masks = vec![0; span.len()];
                tile::forward(&mut ForwardTile {
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
                        endless: !self.options.skips.any(Skips::STOP),
                    },
                });
                state
            })
            .collect();
        let (gain, background) = (settings.gain.map(T::of), settings.background.map(T::of));
        let size = [self.images.rendered.width, self.images.rendered.height];
        for (t, state) in states.iter().enumerate() {
            for p in 0..PIXELS {
                let Some([x, y]) = bins.tiling.pixel(t, p, size) else { continue };
                let left = state[4 * PIXELS + p].derivative;
                for k in 0..3 {
                    let sum = state[k * PIXELS + p].derivative + left * background[k];
                    image[3 * (y * size[0] + x) + k] = (gain[k] * sum).finite_or_zero();
                }
            }
        }
        Ok(())
    }
}
