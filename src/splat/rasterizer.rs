//! Forward and backward passes: project, sort, bin, composite; then moments, and the chain back to the parameters.
//!
//! The order of every sum is fixed by the data, never by the threads: a tile is one task, moments of a Gaussian are
//! added tile by tile in the order of its box, the sums over Gaussians (pose) and pixels (gain) go in fixed chunks.
//! All tables live in the [`Rasterizer`] and are used again by the next call.

use rayon::prelude::*;

use crate::base::{Error, Result};
use crate::ffi::splat::{Aligned, Isa};

use super::bin::{Bins, TILE, TileBox, cut};
use super::chain::{One, ellipsoid_gradient, gradients_of_one};
use super::kernel::{self, BackwardTile, ForwardTile, PIXELS, PLANES, Parts, moment, pixel_of};
use super::project::Projector;
use super::real::Real;
use super::surface_depth;
use super::types::{DepthOutput, Gaussians, Gradients, ImageGradient, Rendered, Settings, Shape, View, Wanted};

/// Gaussians per task; the pose is summed in these chunks.
const CHUNK: usize = 512;

/// The differentiable rasteriser. Owns all intermediate tables, so keep one per thread of control and use it again.
#[derive(Debug)]
pub struct Rasterizer<T> {
    isa: Isa,
    pub(super) active: Option<Vec<u32>>,
    pub(super) rows: Vec<Aligned<T>>,
    boxes: Vec<Option<TileBox>>,
    pub(super) bins: Bins,
    pub(super) state: Vec<T>,
    adjoint: Vec<T>,
    slots: Vec<Aligned<T>>,
    pub(super) rendered: Rendered<T>,
    pub(super) tangents: Vec<Vec<T>>,
    gradients: Gradients<T>,
    last: Option<(View, Settings, usize)>,
}

impl<T: Real> Default for Rasterizer<T> {
    fn default() -> Self {
        Self::new()
    }
}

impl<T: Real> Rasterizer<T> {
    /// A rasteriser with the widest kernels of this processor (for `f32`; other types have the plain twin only).
    pub fn new() -> Self {
        Self::of_isa(Isa::widest())
    }

    /// A rasteriser with the kernels of `isa`; an error of the environment when the processor lacks it.
    pub fn with_isa(isa: Isa) -> Result<Self> {
        Ok(Self::of_isa(isa.available()?))
    }

    fn of_isa(isa: Isa) -> Self {
        Rasterizer {
            isa,
            active: None,
            rows: Vec::new(),
            boxes: Vec::new(),
            bins: Bins::default(),
            state: Vec::new(),
            adjoint: Vec::new(),
            slots: Vec::new(),
            rendered: Rendered::default(),
            tangents: Vec::new(),
            gradients: Gradients::default(),
            last: None,
        }
    }

    /// Which kernels composite.
    pub fn isa(&self) -> Isa {
        self.isa
    }

    /// The images of the last [`Rasterizer::render`].
    pub fn rendered(&self) -> &Rendered<T> {
        &self.rendered
    }

    /// The gradients of the last [`Rasterizer::backward`].
    pub fn gradients(&self) -> &Gradients<T> {
        &self.gradients
    }

    /// Renders the Gaussians named in `active` (indices in strictly ascending order; `None` is all of them).
    ///
    /// Order is by z-depth of the centre (rounded to f32), ties by index. Gaussians with a number that is not finite,
    /// with no opacity, or before the near plane are left out; the images are finite whatever goes in.
    /// Errors: arrays that do not belong together, a camera or settings that make no sense, a bad `active`.
    pub fn render(
        &mut self,
        gaussians: &Gaussians<T>,
        view: &View,
        settings: &Settings,
        active: Option<&[u32]>,
    ) -> Result<&Rendered<T>> {
        gaussians.validate()?;
        let projector = Projector::new(view, settings)?;
        self.activate(active, gaussians.len())?;
        self.project(gaussians, &projector, view);
        let tiles = [view.camera.width, view.camera.height].map(|v| (v as usize).div_ceil(TILE));
        self.bins.fill(tiles, &self.rows, &self.boxes);
        self.composite(settings);
        self.develop(view, settings);
        if settings.depth == DepthOutput::Surface {
            let depth = &mut self.rendered.depth;
            surface_depth::fill(gaussians, self.active.as_deref(), view, &self.rows, &self.bins, depth)?;
        }
        self.last = Some((*view, *settings, gaussians.len()));
        Ok(&self.rendered)
    }

    fn activate(&mut self, active: Option<&[u32]>, n: usize) -> Result<()> {
        if let Some(list) = active {
            let ascending = list.windows(2).all(|w| w[0] < w[1]);
            if !ascending || list.last().is_some_and(|&last| last as usize >= n) {
                return Err(Error::input("active indices must ascend and name existing Gaussians"));
            }
            let mut own = self.active.take().unwrap_or_default();
            own.clear();
            own.extend_from_slice(list);
            self.active = Some(own);
        } else {
            self.active = None;
        }
        Ok(())
    }

    fn project(&mut self, gaussians: &Gaussians<T>, projector: &Projector<T>, view: &View) {
        let n = self.active.as_ref().map_or(gaussians.len(), Vec::len);
        let tiles_x = (view.camera.width as usize).div_ceil(TILE);
        let tiles_y = (view.camera.height as usize).div_ceil(TILE);
        self.rows.resize(n.max(1), Aligned::default());
        self.boxes.resize(n, None);
        self.rendered.visible.resize(n, false);
        let active = self.active.as_deref();
        self.rows[..n]
            .par_chunks_mut(CHUNK)
            .zip(self.boxes.par_chunks_mut(CHUNK))
            .zip(self.rendered.visible.par_chunks_mut(CHUNK))
            .enumerate()
            .for_each(|(chunk, ((rows, boxes), visible))| {
                for (k, row) in rows.iter_mut().enumerate() {
                    let j = chunk * CHUNK + k;
                    let found = projector.project(gaussians, active.map_or(j, |list| list[j] as usize));
                    visible[k] = found.is_some();
                    boxes[k] = found.as_ref().map(|row| TileBox::of(row, tiles_x, tiles_y));
                    if let Some(found) = found {
                        row.0 = found;
                    }
                }
            });
        self.rendered.visible_count = self.rendered.visible.iter().filter(|v| **v).count();
    }

    fn composite(&mut self, settings: &Settings) {
        let bins = &mut self.bins;
        let tiles = bins.tiles_x * bins.tiles_y;
        self.rendered.intersections = bins.entries.len();
        self.state.resize(tiles * PLANES * PIXELS, T::zero());
        let sizes = bins.offsets.windows(2).map(|w| (w[1] - w[0]) as usize);
        let masks = cut(&mut bins.masks, sizes);
        let (offsets, entries, tiles_x) = (&bins.offsets, &bins.entries, bins.tiles_x);
        let (rows, isa) = (&self.rows, self.isa);
        let parts = Parts { geometry: false, color: true, depth: settings.depth == DepthOutput::Expected };
        masks.into_par_iter().zip(self.state.par_chunks_mut(PLANES * PIXELS)).enumerate().for_each(
            |(t, (masks, state))| {
                let mut tile = ForwardTile {
                    rows,
                    entries: &entries[offsets[t] as usize..offsets[t + 1] as usize],
                    masks,
                    corner: [t % tiles_x * TILE, t / tiles_x * TILE],
                    state,
                    parts,
                };
                if !T::forward_tile(isa, &mut tile) {
                    kernel::scalar_forward(&mut tile);
                }
            },
        );
    }

    /// From the tiles' sums to images in rows: background, gain, depth by alpha.
    fn develop(&mut self, view: &View, settings: &Settings) {
        let (width, height) = (view.camera.width as usize, view.camera.height as usize);
        let out = &mut self.rendered;
        (out.width, out.height) = (width, height);
        out.color.resize(width * height * 3, T::zero());
        out.depth.resize(width * height, T::zero());
        out.alpha.resize(width * height, T::zero());
        let (state, tiles_x) = (&self.state, self.bins.tiles_x);
        let gain = settings.gain.map(T::of);
        let background = settings.background.map(T::of);
        let band = TILE * width;
        out.color
            .par_chunks_mut(3 * band)
            .zip(out.depth.par_chunks_mut(band))
            .zip(out.alpha.par_chunks_mut(band))
            .enumerate()
            .for_each(|(tile_y, ((color, depth), alpha))| {
                for (tile_x, state) in
                    state[tile_y * tiles_x * PLANES * PIXELS..].chunks_exact(PLANES * PIXELS).take(tiles_x).enumerate()
                {
                    for p in 0..PIXELS {
                        let (column, line) = pixel_of(p);
                        let x = tile_x * TILE + column;
                        let o = line * width + x;
                        if x >= width || o >= alpha.len() {
                            continue;
                        }
                        let left = state[4 * PIXELS + p];
                        for k in 0..3 {
                            color[3 * o + k] = gain[k] * (state[k * PIXELS + p] + left * background[k]);
                        }
                        let covered = T::one() - left;
                        alpha[o] = covered;
                        depth[o] = if covered > T::zero() { state[3 * PIXELS + p] / covered } else { T::zero() };
                    }
                }
            });
    }

    /// Gradients of a loss, given its derivatives with respect to the images of the last [`Rasterizer::render`], whose
    /// Gaussians must be handed in again unchanged. Only the groups in `wanted` are computed; entry `k` of a group
    /// belongs to the `k`-th active Gaussian.
    ///
    /// Errors: no render before, other Gaussians, an image gradient of the wrong size or with a number that is not
    /// finite, a depth gradient after a render without depth.
    pub fn backward(
        &mut self,
        gaussians: &Gaussians<T>,
        image: &ImageGradient<'_, T>,
        wanted: Wanted,
    ) -> Result<&Gradients<T>> {
        let (view, settings, n) = self.last.ok_or_else(|| Error::input("backward needs a render before it"))?;
        gaussians.validate()?;
        if gaussians.len() != n {
            return Err(Error::input("backward needs the Gaussians of the last render"));
        }
        self.check_image(image, &settings)?;
        let projector = Projector::new(&view, &settings)?;
        let through_position = wanted.any(Wanted::POSITIONS | Wanted::POSE);
        let geometry = through_position || wanted.any(Wanted::SHAPES | Wanted::OPACITIES);
        let parts = Parts {
            geometry,
            color: wanted.any(Wanted::SH) || (through_position && gaussians.sh_degree > 0),
            depth: geometry && !image.depth.is_empty(),
        };
        self.adjoint_of_tiles(image, &settings, wanted);
        if parts.geometry || parts.color {
            self.composite_backward(parts);
        }
        self.chain(gaussians, &projector, wanted);
        Ok(&self.gradients)
    }

    fn check_image(&self, image: &ImageGradient<'_, T>, settings: &Settings) -> Result<()> {
        let pixels = self.rendered.width * self.rendered.height;
        for (name, plane, per_pixel) in
            [("colour", image.color, 3), ("depth", image.depth, 1), ("alpha", image.alpha, 1)]
        {
            if !plane.is_empty() && plane.len() != pixels * per_pixel {
                return Err(Error::input(format!("the {name} gradient has {} values", plane.len())));
            }
            if let Some(bad) = plane.iter().position(|v| !v.is_finite()) {
                let pixel = bad / per_pixel;
                return Err(Error::input(format!("the {name} gradient is not finite")).element(format!(
                    "pixel ({}, {})",
                    pixel % self.rendered.width,
                    pixel / self.rendered.width
                )));
            }
        }
        if !image.depth.is_empty() && settings.depth != DepthOutput::Expected {
            return Err(Error::input("a depth gradient needs a render with expected depth"));
        }
        Ok(())
    }

    /// Gradients of the tiles' sums, and the loss that lies behind each pixel's first splat; the gain on the way.
    fn adjoint_of_tiles(&mut self, image: &ImageGradient<'_, T>, settings: &Settings, wanted: Wanted) {
        let (width, height) = (self.rendered.width, self.rendered.height);
        self.adjoint.resize(self.state.len(), T::zero());
        let gain = settings.gain.map(T::of);
        let background = settings.background.map(T::of);
        let tiles_x = self.bins.tiles_x;
        let gains: Vec<[f64; 3]> = self
            .adjoint
            .par_chunks_mut(PLANES * PIXELS)
            .zip(self.state.par_chunks(PLANES * PIXELS))
            .enumerate()
            .map(|(t, (adjoint, state))| {
                let mut by_gain = [0.0; 3];
                for p in 0..PIXELS {
                    let (column, line) = pixel_of(p);
                    let (x, y) = (t % tiles_x * TILE + column, t / tiles_x * TILE + line);
                    if x >= width || y >= height {
                        (0..PLANES).for_each(|k| adjoint[k * PIXELS + p] = T::zero());
                        continue;
                    }
                    let o = y * width + x;
                    let left = state[4 * PIXELS + p];
                    let mut behind = T::zero();
                    // The background is what the light that is left falls on.
                    let mut by_left = -image.alpha.get(o).copied().unwrap_or_default();
                    for k in 0..3 {
                        let v = image.color.get(3 * o + k).copied().unwrap_or_default();
                        let plain = state[k * PIXELS + p];
                        by_gain[k] += (v * (plain + left * background[k])).to_f64();
                        adjoint[k * PIXELS + p] = v * gain[k];
                        behind += v * gain[k] * plain;
                        by_left += v * gain[k] * background[k];
                    }
                    let covered = T::one() - left;
                    let mut by_depth = T::zero();
                    if !image.depth.is_empty() && covered > T::zero() {
                        by_depth = image.depth[o] / covered;
                        behind += by_depth * state[3 * PIXELS + p];
                        by_left += by_depth * state[3 * PIXELS + p] / covered;
                    }
                    adjoint[3 * PIXELS + p] = by_depth;
                    adjoint[4 * PIXELS + p] = behind + left * by_left;
                }
                by_gain
            })
            .collect();
        self.gradients.gain = [0.0; 3];
        if wanted.any(Wanted::GAIN) {
            for tile in gains {
                for k in 0..3 {
                    self.gradients.gain[k] += tile[k];
                }
            }
        }
    }

    fn composite_backward(&mut self, parts: Parts) {
        let bins = &self.bins;
        if self.slots.len() < bins.entries.len() {
            self.slots.resize(bins.entries.len(), Aligned::default());
        }
        let sizes = bins.offsets.windows(2).map(|w| (w[1] - w[0]) as usize);
        let slots = cut(&mut self.slots, sizes);
        let (rows, isa) = (&self.rows, self.isa);
        slots.into_par_iter().zip(self.adjoint.par_chunks(PLANES * PIXELS)).enumerate().for_each(
            |(t, (slots, adjoint))| {
                let range = bins.offsets[t] as usize..bins.offsets[t + 1] as usize;
                let mut tile = BackwardTile {
                    rows,
                    entries: &bins.entries[range.clone()],
                    masks: &bins.masks[range],
                    corner: [t % bins.tiles_x * TILE, t / bins.tiles_x * TILE],
                    adjoint,
                    slots,
                    parts,
                };
                if !T::backward_tile(isa, &mut tile) {
                    kernel::scalar_backward(&mut tile);
                }
            },
        );
    }

    fn chain(&mut self, gaussians: &Gaussians<T>, projector: &Projector<T>, wanted: Wanted) {
        let n = self.rendered.visible.len();
        let stride = gaussians.sh_stride();
        let discs = matches!(gaussians.shape, Shape::Discs { .. });
        let size = |group: Wanted| if wanted.any(group) { n } else { 0 };
        let out = &mut self.gradients;
        let zero = [T::zero(); 3];
        out.positions.resize(size(Wanted::POSITIONS), zero);
        out.rotations.resize(if discs { 0 } else { size(Wanted::SHAPES) }, [T::zero(); 4]);
        out.scales.resize(if discs { 0 } else { size(Wanted::SHAPES) }, zero);
        out.axes.resize(if discs { size(Wanted::SHAPES) } else { 0 }, [zero; 2]);
        out.opacities.resize(size(Wanted::OPACITIES), T::zero());
        out.sh.resize(size(Wanted::SH) * stride, T::zero());
        out.pose = [0.0; 6];
        if !wanted.any(Wanted::POSITIONS | Wanted::SHAPES | Wanted::OPACITIES | Wanted::SH | Wanted::POSE) {
            return;
        }
        let chunks = n.div_ceil(CHUNK);
        let lengths = |group: usize, per: usize| {
            (0..chunks).map(move |c| if group == 0 { 0 } else { per * (CHUNK.min(n - c * CHUNK)) })
        };
        let tasks: Vec<Task<'_, T>> = cut(&mut out.positions, lengths(size(Wanted::POSITIONS), 1))
            .into_iter()
            .zip(cut(&mut out.rotations, lengths(if discs { 0 } else { size(Wanted::SHAPES) }, 1)))
            .zip(cut(&mut out.scales, lengths(if discs { 0 } else { size(Wanted::SHAPES) }, 1)))
            .zip(cut(&mut out.axes, lengths(if discs { size(Wanted::SHAPES) } else { 0 }, 1)))
            .zip(cut(&mut out.opacities, lengths(size(Wanted::OPACITIES), 1)))
            .zip(cut(&mut out.sh, lengths(size(Wanted::SH), stride)))
            .enumerate()
            .map(|(chunk, (((((positions, rotations), scales), axes), opacities), sh))| Task {
                first: chunk * CHUNK,
                count: CHUNK.min(n - chunk * CHUNK),
                positions,
                rotations,
                scales,
                axes,
                opacities,
                sh,
            })
            .collect();
        let (bins, slots, visible) = (&self.bins, &self.slots, &self.rendered.visible);
        let active = self.active.as_deref();
        let with_pose = wanted.any(Wanted::POSE);
        let poses: Vec<[f64; 6]> = tasks
            .into_par_iter()
            .map(|mut task| {
                let mut pose = [0.0; 6];
                for k in 0..task.count {
                    let j = task.first + k;
                    let i = active.map_or(j, |list| list[j] as usize);
                    let by_sh = task.sh.get_mut(k * stride..(k + 1) * stride).unwrap_or_default();
                    let one = visible[j]
                        .then(|| moments_of(bins, slots, j))
                        .flatten()
                        .and_then(|m| gradients_of_one(projector, gaussians, i, &m, wanted, by_sh));
                    task.write(k, i, one.as_ref(), gaussians, stride, wanted);
                    if !with_pose {
                        continue;
                    }
                    for (sum, part) in pose.iter_mut().zip(one.map_or([T::zero(); 6], |one| one.pose)) {
                        *sum += part.to_f64();
                    }
                }
                pose
            })
            .collect();
        for pose in poses {
            for k in 0..6 {
                self.gradients.pose[k] += pose[k];
            }
        }
    }
}

/// A chunk of Gaussians and the places their gradients go to (empty where not wanted).
struct Task<'a, T> {
    first: usize,
    count: usize,
    positions: &'a mut [[T; 3]],
    rotations: &'a mut [[T; 4]],
    scales: &'a mut [[T; 3]],
    axes: &'a mut [[[T; 3]; 2]],
    opacities: &'a mut [T],
    sh: &'a mut [T],
}

impl<T: Real> Task<'_, T> {
    fn write(
        &mut self,
        k: usize,
        i: usize,
        one: Option<&One<T>>,
        gaussians: &Gaussians<T>,
        stride: usize,
        wanted: Wanted,
    ) {
        let zero = [T::zero(); 3];
        if let Some(place) = self.positions.get_mut(k) {
            *place = one.map_or(zero, |one| one.position);
        }
        if let Some(place) = self.axes.get_mut(k) {
            *place = one.map_or([zero; 2], |one| [one.columns[0], one.columns[1]]);
        }
        if let (Some(rotation), Some(scale)) = (self.rotations.get_mut(k), self.scales.get_mut(k)) {
            (*rotation, *scale) =
                one.map_or(([T::zero(); 4], zero), |one| ellipsoid_gradient(&gaussians.shape, i, &one.columns));
        }
        if let Some(place) = self.opacities.get_mut(k) {
            *place = one.map_or(T::zero(), |one| one.opacity);
        }
        // The coefficients of a splat that is seen were written in passing.
        if wanted.any(Wanted::SH) && one.is_none() {
            self.sh[k * stride..(k + 1) * stride].fill(T::zero());
        }
    }
}

/// Sum of the moments of splat `j` over its tiles; `None` when no tile looked at it.
fn moments_of<T: Real>(bins: &Bins, slots: &[Aligned<T>], j: usize) -> Option<[T; 16]> {
    let mut total: Option<[T; 16]> = None;
    for entry in bins.entries_of(j).filter(|&entry| bins.masks[entry] != 0) {
        let slot = &slots[entry].0;
        match &mut total {
            None => total = Some(*slot),
            Some(sum) => {
                for k in 0..moment::RED + 3 {
                    sum[k] += slot[k];
                }
            }
        }
    }
    total
}
