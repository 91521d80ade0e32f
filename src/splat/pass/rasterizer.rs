//! Forward and backward passes: project, sort, bin, composite; then moments, and the chain back to the parameters.
//!
//! The order of every sum is fixed by the data, never by the threads: a tile is one task, moments of a Gaussian are
//! added tile by tile in the order of its box, the sums over Gaussians (pose) and pixels (gain) go in fixed chunks.
//! All tables live in the [`Rasterizer`] and are used again by the next call; each is changed in the file of its type.

use crate::base::estimate::demand_memory;
use crate::base::{Error, Estimate, Result};
use crate::ffi::isa::Isa;
use crate::splat::kernels::{KernelScene, SplatKernels};
use crate::splat::plain::disc::DiscOptics;
use crate::splat::plain::fault::{Fault, Faults, Sound};
use crate::splat::plain::projector::Projector;
use crate::splat::plain::tile::Parts;
use crate::splat::types::table::PLANES;
use crate::splat::types::{
    DepthOutput, Direction, Footprint, GaussianSlices, Gradients, ImageGradient, PIXELS, Rendered, Settings, Skips,
    Tiling, View, Wanted,
};

use super::backward::{Moments, TileGradient};
use super::bins::Bins;
use super::channels::{Channels, ChannelsWanted};
use super::forward::{MovingSplats, TilePass};
use super::gradients::GradientTables;
use super::images::Images;
use super::options::{PassOptions, RenderRequest};
use super::pixel_walk::{PixelWalk, SurfaceSource, splat_surfaces};
use super::pool::in_pool;
use super::rays::ViewRays;
use super::reuse::{Reuse, ReuseState};
use super::splats::{MovingOutput, Splats};
use super::stages::{PassClock, PassStage, StageTimes};

/// The model behind [`Rasterizer::estimate`]: bytes of a tile entry in the lists, core seconds of a pixel and of a tile
/// entry in a forward pass. A backward pass takes three times as long.
const LIST_ENTRY_BYTES: f64 = 10.0;
const PIXEL_S: f64 = 2e-8;
const ENTRY_S: f64 = 2e-7;
const BACKWARD_FACTOR: f64 = 3.0;

/// The differentiable rasteriser. Owns all intermediate tables, so keep one per thread of control and reuse it.
#[derive(Debug)]
pub struct Rasterizer<T> {
    pub(super) options: PassOptions,
    /// Indices of the Gaussians that take part; `None` for all.
    pub(super) active: Option<Vec<u32>>,
    pub(super) splats: Splats<T>,
    pub(super) bins: Bins,
    rays: ViewRays<T>,
    /// Sums of all tiles: `PLANES` planes of `PIXELS` each.
    pub(super) state: Vec<T>,
    pub(super) images: Images<T>,
    moments: Moments<T>,
    gradients: GradientTables<T>,
    channels: Channels<T>,
    pub(super) tangents: Tangents<T>,
    reuse: ReuseState<T>,
    clock: PassClock,
    /// View, settings and number of Gaussians of the last render.
    last: Option<(View, Settings, usize)>,
}

/// Tables of `render_tangent`.
#[derive(Debug, Default)]
pub(super) struct Tangents<T> {
    /// Velocities of the splats, direction by direction.
    pub velocities: Vec<[T; 8]>,
    /// Velocities of the pixels of all tiles.
    pub moved: Vec<T>,
    /// One image per direction.
    pub images: Vec<Vec<T>>,
}

impl<T: SplatKernels> Default for Rasterizer<T> {
    fn default() -> Self {
        Self::new()
    }
}

impl<T: SplatKernels> Rasterizer<T> {
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
            options: PassOptions { isa, skips: Skips::ALL },
            active: None,
            splats: Splats::default(),
            bins: Bins::default(),
            rays: ViewRays::default(),
            state: Vec::new(),
            images: Images::default(),
            moments: Moments::default(),
            gradients: GradientTables::default(),
            channels: Channels::default(),
            tangents: Tangents::default(),
            reuse: ReuseState::default(),
            clock: PassClock::default(),
            last: None,
        }
    }

    /// Sets which work later passes skip; [`Skips::ALL`] by default.
    pub fn skips(&mut self, skips: Skips) {
        self.options.skips = skips;
        self.reuse.forget();
        self.last = None;
    }

    /// Sets what later renders may reuse from the one before; [`Reuse::Never`] by default.
    pub fn reuse(&mut self, reuse: Reuse) {
        self.reuse = ReuseState::new(reuse);
    }

    /// Which kernels composite.
    pub fn isa(&self) -> Isa {
        self.options.isa
    }

    /// Time of each stage of the last passes.
    pub fn stage_times(&self) -> StageTimes {
        self.clock.times()
    }

    /// From now on measures CPU time too (about a microsecond per stage).
    pub fn measure_cpu(&mut self) {
        self.clock.measure_cpu();
    }

    /// The images of the last [`Rasterizer::render`].
    pub fn rendered(&self) -> &Rendered<T> {
        &self.images.rendered
    }

    /// The gradients of the last [`Rasterizer::backward`].
    pub fn gradients(&self) -> &Gradients<T> {
        &self.gradients.gradients
    }

    /// The colour image of the last [`Rasterizer::render`], handed over instead of copied: it is then empty here, and
    /// the next render makes a new one.
    pub fn take_color(&mut self) -> Vec<T> {
        std::mem::take(&mut self.images.rendered.color)
    }

    /// The gradients of the last [`Rasterizer::backward`], handed over instead of copied: they are then empty here, and
    /// the next backward pass makes new ones.
    pub fn take_gradients(&mut self) -> Gradients<T> {
        self.gradients.take()
    }

    /// Tables for the gradients of the next [`Rasterizer::backward`], of any length and with any numbers: those that
    /// [`Rasterizer::take_gradients`] handed out, once they are done with. New ones cost a pass the zeros that they begin
    /// with.
    pub fn give_tables(&mut self, tables: Gradients<T>) {
        self.gradients.give_back(tables);
    }

    /// Pairs of a tile and a visible splat of the last render whose bounding box meets it, which is what other
    /// renderers count; the lists have fewer ([`Rendered::intersections`]). Not for exact discs, whose boxes are not
    /// kept.
    pub fn box_intersections(&self) -> usize {
        self.splats.box_intersections(&self.images.rendered.visible, &self.bins.tiling)
    }

    /// Renders the Gaussians named in `active` (indices in strictly ascending order; `None` is all of them).
    ///
    /// Order is by z-depth of the centre (computed in f64, rounded to f32), ties by index. Gaussians with a number
    /// that is not finite, with no opacity, or in front of the near plane are left out; the images are finite for any
    /// input. Errors: arrays of different lengths, an invalid camera or settings, a bad `active`, an image or lists of
    /// tiles that this machine has no memory left for.
    pub fn render<'g>(
        &mut self,
        gaussians: impl Into<GaussianSlices<'g, T>>,
        view: &View,
        settings: &Settings,
        active: Option<&[u32]>,
    ) -> Result<&Rendered<T>>
    where
        T: 'g,
    {
        let gaussians = gaussians.into();
        in_pool(|| self.render_in_pool(RenderRequest { gaussians, view, settings, active }))?;
        Ok(&self.images.rendered)
    }

    /// What a [`Rasterizer::render`] of all Gaussians would cost, with a [`Rasterizer::backward`] where
    /// `with_backward`: projects them and counts the tiles that they meet, without making the lists.
    ///
    /// Errors: those of a render before its lists.
    pub fn estimate<'g>(
        &mut self,
        gaussians: impl Into<GaussianSlices<'g, T>>,
        view: &View,
        settings: &Settings,
        with_backward: bool,
    ) -> Result<Estimate>
    where
        T: 'g,
    {
        let gaussians = gaussians.into();
        self.last = None;
        self.reuse.forget();
        gaussians.validate()?;
        let projector = Projector::new(view, settings)?.with_skips(self.options.skips);
        self.active = None;
        let tiling = Tiling::of(view.size());
        in_pool(|| self.project(gaussians, &projector, &tiling, None));
        let boxes = self.splats.boxes(&self.images.rendered.visible);
        let entries = self.bins.entries_of(self.options.isa, &boxes) as f64;
        let (pixel_bytes, pixels) = (table_bytes::<T>(view, settings), (tiling.count() * PIXELS) as f64);
        let moments_bytes = if with_backward { size_of::<[T; 16]>() as f64 } else { 0.0 };
        let factor = if with_backward { 1.0 + BACKWARD_FACTOR } else { 1.0 };
        Ok(Estimate {
            memory_bytes: pixel_bytes + entries * (LIST_ENTRY_BYTES + moments_bytes),
            seconds: factor * (pixels * PIXEL_S + entries * ENTRY_S) / rayon::current_num_threads() as f64,
            resumable: false,
        })
    }

    fn render_in_pool(&mut self, request: RenderRequest<'_, T>) -> Result<()> {
        let RenderRequest { gaussians, view, settings, .. } = request;
        self.prepare(request, None)?;
        self.composite(view, settings);
        self.clock.end(PassStage::Composite);
        self.develop(view, settings);
        self.clock.end(PassStage::Develop);
        self.fill_depth(gaussians, view, settings);
        Ok(())
    }

    /// All of a render before compositing. If splats are projected anew and the kernels can compute velocities, those
    /// along `moving` too; returns whether they have been computed.
    pub(super) fn prepare(&mut self, request: RenderRequest<'_, T>, moving: Option<&Direction<'_, T>>) -> Result<bool> {
        let RenderRequest { gaussians, view, settings, active } = request;
        self.clock.start();
        self.last = None;
        self.channels.count = 0;
        gaussians.validate()?;
        let projector = Projector::new(view, settings)?.with_skips(self.options.skips);
        let there = (self.state.capacity() * size_of::<T>()) as f64;
        let wanted = table_bytes::<T>(view, settings);
        // The sums of the tiles are a good third of it: larger tables than the last pass had.
        if wanted > 3.0 * there {
            let [width, height] = view.size();
            demand_memory(format_args!("an image of {width}x{height} pixels"), wanted - there)?;
        }
        let same = self.reuse.holds_for(request) && {
            let scene = KernelScene::new(self.options.isa, gaussians, &projector, self.active.as_deref());
            self.splats.recolor(&scene, &self.images.rendered.visible)
        };
        let mut moved = false;
        if same {
            self.clock.end(PassStage::Project);
            self.clock.end(PassStage::Bin);
        } else {
            self.reuse.forget();
            self.activate(active, gaussians.len())?;
            moved = self.make_splats(gaussians, &projector, view, moving)?;
            self.reuse.keep(request);
        }
        self.last = Some((*view, *settings, gaussians.len()));
        Ok(moved)
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

    /// Projects all active Gaussians and distributes their splats to the tiles. With `moving` also the velocities
    /// along it; `false` if these have not been computed.
    fn make_splats(
        &mut self,
        gaussians: GaussianSlices<'_, T>,
        projector: &Projector<T>,
        view: &View,
        moving: Option<&Direction<'_, T>>,
    ) -> Result<bool> {
        let (isa, tiling) = (self.options.isa, Tiling::of(view.size()));
        if projector.footprint == Footprint::Disc {
            self.rays.update(&view.camera);
        }
        let moved = self.project(gaussians, projector, &tiling, moving);
        self.clock.end(PassStage::Project);
        let rendered = &mut self.images.rendered;
        self.bins.fill(isa, tiling, &self.splats.boxes(&rendered.visible))?;
        rendered.intersections = self.bins.entries.len();
        self.clock.end(PassStage::Bin);
        Ok(moved)
    }

    /// The first half of [`Rasterizer::make_splats`]: rows, boxes and counts of all active Gaussians.
    fn project(
        &mut self,
        gaussians: GaussianSlices<'_, T>,
        projector: &Projector<T>,
        tiling: &Tiling,
        moving: Option<&Direction<'_, T>>,
    ) -> bool {
        let isa = self.options.isa;
        let scene = KernelScene::new(isa, gaussians, projector, self.active.as_deref());
        let moving = moving.filter(|_| T::velocity_kernels(&scene).is_some());
        let velocities = &mut self.tangents.velocities;
        let output = moving.map(|direction| MovingOutput { direction, velocities });
        let rendered = &mut self.images.rendered;
        self.splats.project(&scene, isa, tiling, &mut rendered.visible, &mut self.bins, output);
        rendered.visible_count = match isa {
            Isa::Scalar => rendered.visible.iter().filter(|v| **v).count(),
            _ => self.bins.visible_count(),
        };
        moving.is_some()
    }

    /// Sums of all tiles from their lists.
    pub(super) fn composite(&mut self, view: &View, settings: &Settings) {
        let pass = tile_pass(self.options, &self.rays, view, settings);
        pass.forward(&self.splats, &mut self.bins, settings.composites_depth(), &mut self.state);
    }

    /// The same without depth, and with the velocities of the pixels.
    pub(super) fn composite_moving(&mut self, view: &View, settings: &Settings, moving: &MovingSplats<'_, T>) {
        let pass = tile_pass(self.options, &self.rays, view, settings);
        pass.forward_moving(&self.splats, &mut self.bins, moving, &mut self.state, &mut self.tangents.moved);
    }

    /// Images from the sums of the tiles.
    pub(super) fn develop(&mut self, view: &View, settings: &Settings) {
        let pass = tile_pass(self.options, &self.rays, view, settings);
        self.images.develop(&pass, &self.bins, &self.state);
    }

    /// Fills the depth image, where it is not composited with the colours.
    fn fill_depth(&mut self, gaussians: GaussianSlices<'_, T>, view: &View, settings: &Settings) {
        let median = settings.depth == DepthOutput::Median;
        if !median && (settings.footprint == Footprint::Disc || settings.depth != DepthOutput::Surface) {
            return;
        }
        let (bins, n) = (&self.bins, self.images.rendered.visible.len());
        let surfaces = match settings.footprint {
            Footprint::Disc => SurfaceSource::Discs(DiscOptics::new(view, settings, &self.rays.directions)),
            Footprint::Ewa => SurfaceSource::Splats(splat_surfaces(&gaussians, view, self.active.as_deref(), bins, n)),
        };
        let walk = PixelWalk { splats: &self.splats, bins, view: *view, surfaces };
        let depth = walk.image(|pixel| T::of(if median { walk.median(pixel) } else { walk.surface(pixel) }));
        self.images.set_depth(depth);
    }

    /// How many Gaussians each pixel of the last [`Rasterizer::render`] blends, row by row (`height * width`).
    ///
    /// Errors: no render before.
    pub fn contributors(&self) -> Result<Vec<u32>> {
        let (view, settings, _) = self.last.ok_or_else(|| Error::input("contributors need a render before them"))?;
        let surfaces = match settings.footprint {
            Footprint::Disc => SurfaceSource::Discs(DiscOptics::new(&view, &settings, &self.rays.directions)),
            Footprint::Ewa => SurfaceSource::None,
        };
        let walk = PixelWalk { splats: &self.splats, bins: &self.bins, view, surfaces };
        Ok(walk.image(|pixel| walk.count(pixel)))
    }

    /// Bytes that [`Rasterizer::render_channels`] keeps for `count` channels of an image of `size` (width, height).
    pub fn channels_bytes(size: [usize; 2], count: usize) -> f64 {
        Channels::<T>::bytes(size, count)
    }

    /// Composites `count` further channels in the view of the last [`Rasterizer::render`]: `features` has `count`
    /// values per Gaussian (of all, not of the active alone), the image `count` per pixel, row by row: sums of the
    /// features weighted like the colours, 0 where nothing is, not divided by alpha. [`Rasterizer::backward`] then
    /// takes their gradient in `ImageGradient::channels`.
    ///
    /// Errors: no render before; another number of features; a feature that is not finite; more channels than this
    /// machine has memory left for.
    pub fn render_channels(&mut self, features: &[T], count: usize) -> Result<&[T]> {
        let (view, settings, n) = self.last.ok_or_else(|| Error::input("channels need a render before them"))?;
        self.channels.set_features(features, (count, n), self.active.as_deref(), view.size())?;
        let pass = tile_pass(self.options, &self.rays, &view, &settings);
        self.channels.render(&pass, &mut self.splats, &mut self.bins);
        Ok(&self.channels.image)
    }

    /// Gradients of a loss, given its derivatives with respect to the images of the last [`Rasterizer::render`], whose
    /// Gaussians must be handed in again unchanged. Only the groups in `wanted` are computed; entry `k` of a group
    /// belongs to the `k`-th active Gaussian.
    ///
    /// Errors: no render before, other Gaussians, an image gradient of the wrong size or with a number that is not
    /// finite, a depth gradient after a render without depth.
    pub fn backward<'g>(
        &mut self,
        gaussians: impl Into<GaussianSlices<'g, T>>,
        image: &ImageGradient<'_, T>,
        wanted: Wanted,
    ) -> Result<&Gradients<T>>
    where
        T: 'g,
    {
        let gaussians = gaussians.into();
        in_pool(|| self.backward_in_pool(gaussians, image, wanted, Sound))?;
        Ok(&self.gradients.gradients)
    }

    /// [`Rasterizer::backward`] of the plain twin with a seeded mistake, to verify that a gradient check can fail.
    pub fn backward_with_fault<'g>(
        &mut self,
        gaussians: impl Into<GaussianSlices<'g, T>>,
        image: &ImageGradient<'_, T>,
        wanted: Wanted,
        fault: Fault,
    ) -> Result<&Gradients<T>>
    where
        T: 'g,
    {
        let gaussians = gaussians.into();
        in_pool(|| self.backward_in_pool(gaussians, image, wanted, fault))?;
        Ok(&self.gradients.gradients)
    }

    fn backward_in_pool(
        &mut self,
        gaussians: GaussianSlices<'_, T>,
        image: &ImageGradient<'_, T>,
        wanted: Wanted,
        faults: impl Faults,
    ) -> Result<()> {
        let (view, settings, n) = self.last.ok_or_else(|| Error::input("backward needs a render before it"))?;
        gaussians.validate()?;
        if gaussians.len() != n {
            return Err(Error::input("backward needs the Gaussians of the last render"));
        }
        self.clock.start();
        self.check_image(image, &settings)?;
        let projector = Projector::new(&view, &settings)?;
        if wanted.any(Wanted::LENS) && settings.footprint == Footprint::Disc && view.camera.fisheye.is_some() {
            return Err(Error::input("the intrinsics of a fisheye have no gradient with exact discs"));
        }

        self.moments.demand(self.bins.entries.len(), settings.footprint == Footprint::Disc)?;

        // Image gradients through the tiles to the moments of every splat.
        let through_position = wanted.any(Wanted::POSITIONS | Wanted::POSE | Wanted::LENS);
        let geometry = through_position || wanted.any(Wanted::SHAPES | Wanted::OPACITIES);
        let parts = Parts {
            geometry,
            color: wanted.any(Wanted::SH) || (through_position && gaussians.sh_degree > 0),
            depth: geometry && !image.depth.is_empty(),
            known: false,
            endless: !self.options.skips.any(Skips::STOP),
        };
        let gradient = TileGradient { image, parts: (parts.geometry || parts.color).then_some(parts) };
        let pass = tile_pass(self.options, &self.rays, &view, &settings);
        let gain = pass.backward(&self.splats, &self.bins, &self.state, &gradient, &mut self.moments, faults);
        // The sums of what a pixel shows times its gradient are finite only if all gradients are.
        if gain.iter().any(|v| !v.is_finite()) {
            self.check_finite("colour", image.color, 3)?;
        }
        let out = &mut self.gradients.gradients;
        out.gain = if wanted.any(Wanted::GAIN) { gain } else { [0.0; 3] };

        // The same for the further channels, whose geometry is added.
        let (splats, on_screen) = (&mut self.splats, (&self.bins, &self.images.rendered.visible[..]));
        let asked = ChannelsWanted { features: wanted.any(Wanted::CHANNELS), geometry };
        out.channels =
            self.channels.backward(image.channels, &pass, splats, on_screen, &mut self.moments, (asked, faults));
        self.clock.end(PassStage::CompositeBackward);

        // Moments to the gradients of Gaussians and camera.
        let scene = KernelScene::new(self.options.isa, gaussians, &projector, self.active.as_deref());
        self.gradients.chain(&scene, &self.bins.starts, &self.moments, wanted, faults);
        self.clock.end(PassStage::Chain);
        Ok(())
    }

    fn check_image(&self, image: &ImageGradient<'_, T>, settings: &Settings) -> Result<()> {
        let pixels = self.images.rendered.width * self.images.rendered.height;
        for (name, plane, per_pixel) in [
            ("colour", image.color, 3),
            ("depth", image.depth, 1),
            ("alpha", image.alpha, 1),
            ("channel", image.channels, self.channels.count),
        ] {
            if !plane.is_empty() && plane.len() != pixels * per_pixel {
                return Err(Error::input(format!("the {name} gradient has {} values", plane.len())));
            }
            // The tiles check the colours themselves.
            if name != "colour" {
                self.check_finite(name, plane, per_pixel)?;
            }
        }
        let met = settings.footprint == Footprint::Disc && settings.depth == DepthOutput::Surface;
        if !image.depth.is_empty() && settings.depth != DepthOutput::Expected && !met {
            return Err(Error::input("a depth gradient needs a render with expected depth"));
        }
        Ok(())
    }

    /// An error that names the first pixel of `plane` that is not finite.
    fn check_finite(&self, name: &str, plane: &[T], per_pixel: usize) -> Result<()> {
        if T::all_finite(plane) {
            return Ok(());
        }
        let Some(bad) = plane.iter().position(|v| !v.is_finite()) else { return Ok(()) };
        let (pixel, width) = (bad / per_pixel, self.images.rendered.width);
        let at = format!("pixel ({}, {})", pixel % width, pixel / width);
        Err(Error::input(format!("the {name} gradient is not finite")).element(at))
    }
}

/// Bytes of the tables and images whose size is that of the image: sums of the tiles, colour, depth and alpha, and the
/// rays of exact discs.
fn table_bytes<T>(view: &View, settings: &Settings) -> f64 {
    let [width, height] = view.size().map(|v| v as f64);
    let of_rays = if settings.footprint == Footprint::Disc { 3.0 } else { 0.0 };
    let in_tiles = Tiling::of(view.size()).count() as f64 * (PLANES * PIXELS) as f64;
    (in_tiles + width * height * (5.0 + of_rays)) * size_of::<T>() as f64
}

/// The inputs that all tiles of a pass over the last splats share.
fn tile_pass<'a, T: SplatKernels>(
    options: PassOptions,
    rays: &'a ViewRays<T>,
    view: &View,
    settings: &Settings,
) -> TilePass<'a, T> {
    let exact = settings.footprint == Footprint::Disc;
    let optics = exact.then(|| DiscOptics::new(view, settings, &rays.directions));
    TilePass { options, settings: *settings, size: view.size(), optics }
}
