//! Forward and backward passes: project, sort, bin, composite; then moments, and the chain back to the parameters.
//!
//! The order of every sum is fixed by the data, never by the threads: a tile is one task, moments of a Gaussian are
//! added tile by tile in the order of its box, the sums over Gaussians (pose) and pixels (gain) go in fixed chunks.
//! All tables live in the [`Rasterizer`] and are used again by the next call.

use rayon::prelude::*;

use crate::base::{Error, Result};
use crate::ffi::isa::Isa;
use crate::ffi::splat::rasterize::Aligned;
use crate::ffi::system::grow;

use crate::ffi::splat::bin::{self as native_bin, Boxes};

use crate::splat::kernels::Numbers;
use crate::splat::number::real::Real;
use crate::splat::pass::bins::{Bins, Counting, TileBox, cut};
use crate::splat::pass::channels::Extra;
use crate::splat::pass::pool::{in_pool, piece_of};
use crate::splat::pass::reuse::{Kept, Reuse};
use crate::splat::pass::stages::{Clock, Stage, StageTimes};
use crate::splat::pass::tangent::Direction;
use crate::splat::plain::disc::{Rays, refuse_fisheye_lens};
use crate::splat::plain::disc_tile::Sums;
use crate::splat::plain::fault::{Fault, Faults, Sound};
use crate::splat::plain::project::Projector;
use crate::splat::plain::tile::Parts;
use crate::splat::types::scene::{
    DepthOutput, Footprint, Gaussians, Gradients, ImageGradient, Rendered, Settings, View, Wanted,
};
use crate::splat::types::skips::Skips;
use crate::splat::types::tiling::Tiling;

/// Gaussians per task; the pose is summed in these chunks.
pub(in crate::splat) const CHUNK: usize = 1024;

/// Which splats have been counted into the bins.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Counted {
    All,
    Not,
}

/// The differentiable rasteriser. Owns all intermediate tables, so keep one per thread of control and use it again.
#[derive(Debug)]
pub struct Rasterizer<T> {
    pub(in crate::splat) isa: Isa,
    pub(in crate::splat) active: Option<Vec<u32>>,
    pub(in crate::splat) rows: Vec<Aligned<T>>,
    pub(in crate::splat) boxes: Vec<[u32; 2]>,
    pub(in crate::splat) keys: Vec<u32>,
    pub(in crate::splat) bins: Bins,
    pub(in crate::splat) state: Vec<T>,
    pub(in crate::splat) moving: Vec<T>,
    pub(in crate::splat) velocities: Vec<[T; 8]>,
    pub(in crate::splat) slots: Vec<Aligned<T>>,
    pub(in crate::splat) discs: Vec<Aligned<T>>,
    pub(in crate::splat) disc_slots: Vec<Sums<T>>,
    pub(in crate::splat) rays: Rays<T>,
    pub(in crate::splat) extra: Extra<T>,
    pub(in crate::splat) rendered: Rendered<T>,
    /// Whether all of `rendered.depth` is known to be 0.
    pub(in crate::splat) depth_is_zero: bool,
    pub(in crate::splat) tangents: Vec<Vec<T>>,
    pub(in crate::splat) gradients: Gradients<T>,
    /// Chunks whose gradients are not all zero, and what the gradients are laid out for.
    pub(in crate::splat) written: Vec<bool>,
    pub(in crate::splat) written_layout: Option<(usize, usize, bool, Wanted)>,
    pub(in crate::splat) clock: Clock,
    pub(in crate::splat) reuse: Reuse,
    pub(in crate::splat) skips: Skips,
    pub(in crate::splat) kept: Option<Kept<T>>,
    pub(in crate::splat) last: Option<(View, Settings, usize)>,
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
            keys: Vec::new(),
            bins: Bins::default(),
            state: Vec::new(),
            moving: Vec::new(),
            velocities: Vec::new(),
            slots: Vec::new(),
            discs: Vec::new(),
            disc_slots: Vec::new(),
            rays: Rays::default(),
            extra: Extra::default(),
            rendered: Rendered::default(),
            depth_is_zero: false,
            tangents: Vec::new(),
            gradients: Gradients::default(),
            written: Vec::new(),
            written_layout: None,
            clock: Clock::default(),
            reuse: Reuse::Never,
            skips: Skips::ALL,
            kept: None,
            last: None,
        }
    }

    /// Which kernels composite.
    pub fn isa(&self) -> Isa {
        self.isa
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
        &self.rendered
    }

    /// The gradients of the last [`Rasterizer::backward`].
    pub fn gradients(&self) -> &Gradients<T> {
        &self.gradients
    }

    /// Renders the Gaussians named in `active` (indices in strictly ascending order; `None` is all of them).
    ///
    /// Order is by z-depth of the centre (computed in f64, rounded to f32), ties by index. Gaussians with a number that is not finite,
    /// with no opacity, or before the near plane are left out; the images are finite whatever goes in.
    /// Errors: arrays that do not belong together, a camera or settings that make no sense, a bad `active`.
    pub fn render(
        &mut self,
        gaussians: &Gaussians<T>,
        view: &View,
        settings: &Settings,
        active: Option<&[u32]>,
    ) -> Result<&Rendered<T>> {
        in_pool(|| self.render_in_pool(gaussians, view, settings, active))?;
        Ok(&self.rendered)
    }

    fn render_in_pool(
        &mut self,
        gaussians: &Gaussians<T>,
        view: &View,
        settings: &Settings,
        active: Option<&[u32]>,
    ) -> Result<()> {
        self.prepare(gaussians, view, settings, active, None)?;
        match settings.footprint {
            Footprint::Ewa => drop(self.composite(settings.depth, &[], 0)),
            Footprint::Disc => self.composite_discs(view, settings),
        }
        self.clock.end(Stage::Composite);
        self.develop(view, settings);
        self.clock.end(Stage::Develop);
        self.fill_depth(gaussians, view, settings);
        Ok(())
    }

    /// Everything of a render before compositing; where splats are projected anew by the vectorised kernels, their velocities
    /// along `moving`, too. `true` when these are there.
    pub(in crate::splat) fn prepare(
        &mut self,
        gaussians: &Gaussians<T>,
        view: &View,
        settings: &Settings,
        active: Option<&[u32]>,
        moving: Option<&Direction<'_, T>>,
    ) -> Result<bool> {
        self.clock.start();
        self.last = None;
        self.extra.count = 0;
        gaussians.validate()?;
        let projector = Projector::new(view, settings)?.with_skips(self.skips);
        let same = self.same(gaussians, view, settings, active) && self.recolor(gaussians, &projector);
        let moved = if same {
            self.clock.end(Stage::Project);
            self.clock.end(Stage::Bin);
            false
        } else {
            self.kept = None;
            self.activate(active, gaussians.len())?;
            let moved = self.splats(gaussians, &projector, view, moving);
            self.keep(gaussians, view, settings);
            moved
        };
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

    /// Projects all active Gaussians and distributes their splats to the tiles. With `moving` also the velocities along it; `false` when these are not there.
    fn splats(
        &mut self,
        gaussians: &Gaussians<T>,
        projector: &Projector<T>,
        view: &View,
        moving: Option<&Direction<'_, T>>,
    ) -> bool {
        let n = self.active.as_ref().map_or(gaussians.len(), Vec::len);
        let tiling = Tiling::of(view.size());
        grow(&mut self.rows, n.max(1));
        grow(&mut self.boxes, n);
        grow(&mut self.keys, n);
        self.rendered.visible.resize(n, false);
        if projector.footprint() == Footprint::Disc {
            self.project_discs(gaussians, projector, view);
            self.deal(tiling, Counted::Not);
            return false;
        }
        let active = self.active.as_deref();
        let mut numbers = Numbers::default();
        let native = T::native(self.isa, gaussians, projector, &mut numbers, active);
        // What is projected is counted while it is in the cache.
        let counted = if native.is_some() { Counted::All } else { Counted::Not };
        let moving = moving.filter(|_| native.is_some());
        if moving.is_some() && self.velocities.len() < n {
            grow(&mut self.velocities, n);
        }
        let chunks = (0..n).step_by(CHUNK).map(|first| if moving.is_some() { CHUNK.min(n - first) } else { 0 });
        let velocities = cut(&mut self.velocities, chunks);
        let Counting { shift, starts, counts } = self.bins.counting(&tiling, n);
        let tables = self.rows[..n].par_chunks_mut(CHUNK).zip(self.boxes.par_chunks_mut(CHUNK));
        let tables = tables.zip(self.keys.par_chunks_mut(CHUNK)).zip(self.rendered.visible.par_chunks_mut(CHUNK));
        let bins = starts.par_chunks_mut(CHUNK).zip(counts);
        tables.zip(bins).zip(velocities).enumerate().with_max_len(piece_of(n.div_ceil(CHUNK))).for_each(
            |(chunk, (((((rows, boxes), keys), visible), (starts, counts)), velocities))| {
                let first = chunk * CHUNK;
                if let Some(native) = &native {
                    let moving = moving.map(|direction| (direction, velocities));
                    native.project(first, &tiling, rows, boxes, keys, visible, moving);
                    if counted == Counted::All {
                        native_bin::count(&Boxes { boxes, visible, keys }, shift, starts, counts);
                    }
                    return;
                }
                for k in 0..rows.len() {
                    let i = active.map_or(first + k, |list| list[first + k] as usize);
                    let found = projector.project(gaussians, i);
                    visible[k] = found.is_some();
                    if let Some(found) = found {
                        boxes[k] = TileBox::of(&found, &tiling).pack();
                        keys[k] = projector.key(gaussians.positions[i]);
                        rows[k].0 = found;
                    }
                }
            },
        );
        drop(native);
        self.deal(tiling, counted);
        moving.is_some()
    }

    /// Visible splats to the lists of the tiles.
    fn deal(&mut self, tiling: Tiling, counted: Counted) {
        self.rendered.visible_count = match counted {
            Counted::All => self.bins.seen(),
            Counted::Not => self.rendered.visible.iter().filter(|v| **v).count(),
        };
        self.clock.end(Stage::Project);
        self.bins.masks_known = false;
        let all = Boxes { boxes: &self.boxes, keys: &self.keys, visible: &self.rendered.visible };
        if self.isa == Isa::Scalar {
            self.bins.fill_plainly(tiling, &all);
        } else {
            if counted == Counted::Not {
                self.bins.count(&tiling, &all);
            }
            self.bins.fill(tiling, &all);
        }
        self.rendered.intersections = self.bins.entries.len();
        self.clock.end(Stage::Bin);
    }

    /// Pairs of a tile and a visible splat of the last render whose bounding box meets it, which is what other renderers count; the
    /// lists have fewer ([`Rendered::intersections`]). Not for exact discs, whose boxes are not kept.
    pub fn box_intersections(&self) -> usize {
        let rows = self.rows.iter().zip(&self.rendered.visible).filter(|(_, seen)| **seen);
        rows.map(|(row, _)| TileBox::around(&row.0, &self.bins.tiling, T::zero()).count()).sum()
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
        self.backward_as(gaussians, image, wanted, Sound)?;
        Ok(&self.gradients)
    }

    /// [`Rasterizer::backward`] of the plain twin with a mistake in it: for those who check the gradients to see that
    /// their check can fail.
    pub fn backward_with_fault(
        &mut self,
        gaussians: &Gaussians<T>,
        image: &ImageGradient<'_, T>,
        wanted: Wanted,
        fault: Fault,
    ) -> Result<&Gradients<T>> {
        self.backward_as(gaussians, image, wanted, fault)?;
        Ok(&self.gradients)
    }

    fn backward_as(
        &mut self,
        gaussians: &Gaussians<T>,
        image: &ImageGradient<'_, T>,
        wanted: Wanted,
        faults: impl Faults,
    ) -> Result<()> {
        in_pool(|| self.backward_in_pool(gaussians, image, wanted, faults))
    }

    fn backward_in_pool(
        &mut self,
        gaussians: &Gaussians<T>,
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
        if wanted.any(Wanted::LENS) && settings.footprint == Footprint::Disc && !projector.is_pinhole() {
            return Err(refuse_fisheye_lens());
        }
        let through_position = wanted.any(Wanted::POSITIONS | Wanted::POSE | Wanted::LENS);
        let geometry = through_position || wanted.any(Wanted::SHAPES | Wanted::OPACITIES);
        let parts = Parts {
            geometry,
            color: wanted.any(Wanted::SH) || (through_position && gaussians.sh_degree > 0),
            depth: geometry && !image.depth.is_empty(),
            known: false,
            endless: !self.skips.any(Skips::STOP),
        };
        let parts = (parts.geometry || parts.color).then_some(parts);
        if !self.composite_backward(image, &view, &settings, parts, wanted.any(Wanted::GAIN), faults) {
            self.check_finite("colour", image.color, 3)?;
        }
        self.channels_backward(image.channels, &view, &settings, geometry, wanted, faults);
        self.clock.end(Stage::CompositeBackward);
        self.chain(gaussians, &projector, wanted, faults);
        self.clock.end(Stage::Chain);
        Ok(())
    }

    fn check_image(&self, image: &ImageGradient<'_, T>, settings: &Settings) -> Result<()> {
        let pixels = self.rendered.width * self.rendered.height;
        for (name, plane, per_pixel) in [
            ("colour", image.color, 3),
            ("depth", image.depth, 1),
            ("alpha", image.alpha, 1),
            ("channel", image.channels, self.extra.count),
        ] {
            if !plane.is_empty() && plane.len() != pixels * per_pixel {
                return Err(Error::input(format!("the {name} gradient has {} values", plane.len())));
            }
            // The tiles look at the colours in passing.
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
        let (pixel, width) = (bad / per_pixel, self.rendered.width);
        let at = format!("pixel ({}, {})", pixel % width, pixel / width);
        Err(Error::input(format!("the {name} gradient is not finite")).element(at))
    }
}
