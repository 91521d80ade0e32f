//! Which code does the work of a stage: [`SplatKernels`] has the stages of a pass on a chunk of Gaussians, on a tile, on a
//! row of tiles. Its default bodies are the plain ones (`plain/`), which `f64` and [`Dual`] keep; `f32` calls the
//! vectorised C++ (`cpp/splat/`) where the instruction set and the footprint allow. Nothing else in the core knows
//! which of them runs.

use crate::ffi::isa::Isa;
use crate::ffi::splat::image::{self as native_image, ImageBand, Light};
use crate::ffi::splat::rasterize::{self as native, Aligned, ChainOutput, Slots, SplatDiscs, SplatMotion, SplatScene};

use super::number::{Dual, Real};
use super::plain::disc_tile::DiscTile;
use super::plain::fault::Faults;
use super::plain::gradient_chunk::{CameraGradient, ChunkMoments, GradientChunk};
use super::plain::image;
use super::plain::project::{ProjectionChunk, recolor};
use super::plain::projector::Projector;
use super::plain::tile::{self, BackwardTile, ForwardTile, Parts};
use super::types::table::{ALL_BLOCKS, DiscSums};
use super::types::{Direction, Filter, Footprint, Gaussians, ImageGradient, Shape, Skips, TILE_SIDE, Tiling, Wanted};

/// A scene seen by a camera, as the kernels take it.
pub struct KernelScene<'a, T> {
    pub gaussians: &'a Gaussians<T>,
    pub projector: &'a Projector<T>,
    /// Which Gaussians take part; `None` for all.
    pub active: Option<&'a [u32]>,
    isa: Isa,
    /// Where C++ does the work: the camera as it takes it.
    camera: Option<CameraNumbers>,
}

impl<'a, T: SplatKernels> KernelScene<'a, T> {
    /// `gaussians`, or those of them in `active`, to be worked on by the kernels of `isa`.
    pub fn new(isa: Isa, gaussians: &'a Gaussians<T>, projector: &'a Projector<T>, active: Option<&'a [u32]>) -> Self {
        let vectorised = T::VECTORISED && isa != Isa::Scalar && projector.footprint == Footprint::Ewa;
        KernelScene { gaussians, projector, active, isa, camera: vectorised.then(|| CameraNumbers::of(projector)) }
    }

    /// How many Gaussians take part.
    pub fn count(&self) -> usize {
        self.active.map_or(self.gaussians.len(), <[u32]>::len)
    }
}

/// The velocities of splats along a direction, eight numbers each (`Velocity` of `cpp/splat/kernel.h`).
pub type Velocities<T> = [[T; 8]];

/// Velocities of the splats number `first..` where visible: scene, `first`, flags, direction, velocities.
type SplatVelocities<T> = fn(&KernelScene<'_, T>, usize, &[bool], &Direction<'_, T>, &mut Velocities<T>);

/// The vectorised kernels that carry velocities along with the image.
pub struct VelocityKernels<T> {
    pub velocities: SplatVelocities<T>,
    /// Composites one tile together with the velocities of its pixels along up to four directions; velocities have
    /// one row per splat, direction by direction, pixels red, green, blue and transmittance of each direction.
    pub forward: fn(Isa, &mut ForwardTile<'_, T>, &Velocities<T>, &mut [T]),
    /// Velocities of a row of tiles, to lines of the velocity of the colour along one direction.
    pub develop: fn(&[T], DevelopedDirection, &Light, &mut [T]),
}

/// Which of the directions of a row of tiles is developed, and the width of the image in pixels.
#[derive(Clone, Copy)]
pub struct DevelopedDirection {
    pub number: usize,
    pub of: usize,
    pub width: usize,
}

/// A number type with the stages of a pass.
pub trait SplatKernels: Real {
    /// Whether there is C++ for this type.
    const VECTORISED: bool = false;

    /// True when every value is finite.
    fn all_finite(values: &[Self]) -> bool {
        values.iter().all(|v| v.is_finite())
    }

    /// Projects a chunk; with `moving` its velocities along that direction too, which only a type with
    /// [`VelocityKernels`] is asked for.
    fn project(
        scene: &KernelScene<'_, Self>,
        tiling: &Tiling,
        chunk: &mut ProjectionChunk<'_, Self>,
        _moving: Option<(&Direction<'_, Self>, &mut Velocities<Self>)>,
    ) {
        chunk.fill(scene.projector, scene.gaussians, scene.active, tiling);
    }

    /// Writes the colours of the visible splats number `first..` into their rows; `false` when one is not finite.
    fn recolor(scene: &KernelScene<'_, Self>, first: usize, visible: &[bool], rows: &mut [Aligned<Self>]) -> bool {
        recolor(scene.projector, scene.gaussians, scene.active, first, visible, rows)
    }

    /// Gradients of a chunk from its moments; returns those of the camera.
    fn chain(
        scene: &KernelScene<'_, Self>,
        from: &ChunkMoments<'_, Self>,
        wanted: Wanted,
        chunk: &mut GradientChunk<'_, Self>,
        faults: impl Faults,
    ) -> CameraGradient {
        chunk.fill(scene.projector, scene.gaussians, scene.active, from, wanted, faults)
    }

    /// The kernels for velocities in this scene; `None` where dual numbers have to do it.
    fn velocity_kernels(_scene: &KernelScene<'_, Self>) -> Option<VelocityKernels<Self>> {
        None
    }

    /// Composites one tile: here the colour of its pixels is decided.
    fn forward_tile(_isa: Isa, tile: &mut ForwardTile<'_, Self>) {
        tile::forward(tile);
    }

    /// The slots as tiles can share them while they write; `None` where tiles return their moments.
    fn shared_slots(_isa: Isa, _slots: &mut [Aligned<Self>]) -> Option<Slots<'_>> {
        None
    }

    /// Carries the gradient of one tile to the moments of its entries: into `slots`, or returned without them.
    fn backward_tile(
        _isa: Isa,
        tile: &BackwardTile<'_, Self>,
        _slots: Option<&Slots<'_>>,
        faults: impl Faults,
    ) -> Vec<Aligned<Self>> {
        tile::backward(tile, faults)
    }

    /// Composites one tile of exact discs.
    fn disc_forward(_isa: Isa, tile: &DiscTile<'_, Self>, with_depth: bool, state: &mut [Self]) {
        tile.forward(state, with_depth);
    }

    /// Carries the gradient of one tile of exact discs to the sums of its entries.
    fn disc_backward(
        _isa: Isa,
        tile: &DiscTile<'_, Self>,
        adjoint: &[Self],
        parts: Parts,
        faults: impl Faults,
    ) -> Vec<DiscSums<Self>> {
        tile.backward(adjoint, parts, faults)
    }

    /// Sums of a row of tiles to the lines of images of `width` pixels.
    fn develop(tiles: &[Self], width: usize, light: &Light, band: ImageBand<'_, Self>) {
        image::develop(tiles, width, light, band);
    }

    /// Gradients of the sums of tile `place` of an image of `size`; returns its part of the gradient of the gain.
    fn adjoint(
        state: &[Self],
        place: (Tiling, usize),
        size: [usize; 2],
        light: &Light,
        image: &ImageGradient<'_, Self>,
        adjoint: &mut [Self],
        faults: impl Faults,
    ) -> [f64; 3] {
        image::adjoint(state, place, size, light, image, adjoint, faults)
    }
}

impl SplatKernels for f64 {}

impl<T: Real> SplatKernels for Dual<T> {}

impl SplatKernels for f32 {
    const VECTORISED: bool = true;

    fn all_finite(values: &[f32]) -> bool {
        native_image::all_finite(values)
    }

    fn project(
        scene: &KernelScene<'_, f32>,
        tiling: &Tiling,
        chunk: &mut ProjectionChunk<'_, f32>,
        moving: Option<(&Direction<'_, f32>, &mut Velocities<f32>)>,
    ) {
        let Some(native_scene) = scene.native() else {
            return chunk.fill(scene.projector, scene.gaussians, scene.active, tiling);
        };
        let mut pose = [0.0; 6];
        let (motion, velocities): (_, &mut Velocities<f32>) = match moving {
            Some((direction, velocities)) => (motion_of(direction, &mut pose), velocities),
            None => (motion_of(&Direction::Gain([0.0; 3]), &mut pose), &mut []),
        };
        let ProjectionChunk { first, rows, boxes, keys, visible } = chunk;
        let tiles = ([tiling.columns, tiling.rows], TILE_SIDE);
        native::project(scene.isa, &native_scene, *first, tiles, rows, boxes, keys, visible, &motion, velocities);
    }

    fn recolor(scene: &KernelScene<'_, f32>, first: usize, visible: &[bool], rows: &mut [Aligned<f32>]) -> bool {
        match scene.native() {
            Some(native_scene) => native::recolor(scene.isa, &native_scene, first, visible, rows),
            None => recolor(scene.projector, scene.gaussians, scene.active, first, visible, rows),
        }
    }

    fn chain(
        scene: &KernelScene<'_, f32>,
        from: &ChunkMoments<'_, f32>,
        wanted: Wanted,
        chunk: &mut GradientChunk<'_, f32>,
        faults: impl Faults,
    ) -> CameraGradient {
        let Some(native_scene) = scene.native().filter(|_| faults.is_sound()) else {
            return chunk.fill(scene.projector, scene.gaussians, scene.active, from, wanted, faults);
        };
        let mut camera = [0.0; 10];
        let discs = chunk.axes.as_flattened_mut().as_flattened_mut();
        let out = ChainOutput {
            positions: chunk.positions.as_flattened_mut(),
            shape: if discs.is_empty() { chunk.rotations.as_flattened_mut() } else { discs },
            scales: chunk.scales.as_flattened_mut(),
            opacities: chunk.opacities,
            sh: chunk.sh,
            camera: &mut camera,
        };
        native::chain(scene.isa, &native_scene, chunk.first, from.starts, from.moments, wanted.bits(), out);
        camera
    }

    /// Not of `Filter::Compensate`, which lets opacities move: the velocity of a splat has no place for that.
    fn velocity_kernels(scene: &KernelScene<'_, f32>) -> Option<VelocityKernels<f32>> {
        (scene.camera.is_some() && scene.projector.filter == Filter::Dilate).then_some(VelocityKernels {
            velocities: vector_velocities,
            forward: vector_forward,
            develop: vector_develop,
        })
    }

    fn forward_tile(isa: Isa, tile: &mut ForwardTile<'_, f32>) {
        match isa {
            Isa::Scalar => tile::forward(tile),
            _ => vector_forward(isa, tile, &[], &mut []),
        }
    }

    fn shared_slots(isa: Isa, slots: &mut [Aligned<f32>]) -> Option<Slots<'_>> {
        (isa != Isa::Scalar).then(|| Slots::new(slots))
    }

    fn backward_tile(
        isa: Isa,
        tile: &BackwardTile<'_, f32>,
        slots: Option<&Slots<'_>>,
        faults: impl Faults,
    ) -> Vec<Aligned<f32>> {
        let Some(slots) = slots else { return tile::backward(tile, faults) };
        let (corner, parts) = (tile.corner.map(|v| v as f32), tile.parts.bits());
        let &BackwardTile { rows, entries, masks, targets, adjoint, .. } = tile;
        native::backward(isa, &native::Backward { rows, entries, masks, targets, corner, adjoint }, slots, parts);
        Vec::new()
    }

    fn disc_forward(isa: Isa, tile: &DiscTile<'_, f32>, with_depth: bool, state: &mut [f32]) {
        match isa {
            Isa::Scalar => tile.forward(state, with_depth),
            _ => native::disc_forward(isa, &native_discs(tile), with_depth, state),
        }
    }

    fn disc_backward(
        isa: Isa,
        tile: &DiscTile<'_, f32>,
        adjoint: &[f32],
        parts: Parts,
        faults: impl Faults,
    ) -> Vec<DiscSums<f32>> {
        if isa == Isa::Scalar || !faults.is_sound() {
            return tile.backward(adjoint, parts, faults);
        }
        let mut sums = vec![DiscSums::<f32>::default(); tile.entries.len()];
        native::disc_backward(isa, &native_discs(tile), adjoint, parts.bits(), sums.as_flattened_mut());
        sums
    }

    fn develop(tiles: &[f32], width: usize, light: &Light, band: ImageBand<'_, f32>) {
        native_image::develop(tiles, [width, TILE_SIDE], light, band);
    }

    fn adjoint(
        state: &[f32],
        (tiling, t): (Tiling, usize),
        size: [usize; 2],
        light: &Light,
        image: &ImageGradient<'_, f32>,
        adjoint: &mut [f32],
        faults: impl Faults,
    ) -> [f64; 3] {
        if !faults.is_sound() {
            return image::adjoint(state, (tiling, t), size, light, image, adjoint, faults);
        }
        let planes = [image.color, image.depth, image.alpha];
        native_image::adjoint(state, tiling.corner(t), TILE_SIDE, size, light, planes, adjoint)
    }
}

/// The numbers of a camera as C++ takes them.
struct CameraNumbers {
    /// `View` of `cpp/splat/kernel.h`.
    view: [f32; 33],
    /// `Scene::camera` there.
    exact: [f64; 20],
}

impl CameraNumbers {
    fn of<T: Real>(projector: &Projector<T>) -> Self {
        let mut view = [0.0; 33];
        let (lens, flag) = (&projector.lens, |on: bool| f64::from(u8::from(on)));
        view[32] = flag(projector.filter == Filter::Compensate) as f32;
        let vectors = [lens.focal, lens.center, lens.limit, projector.size];
        let skips = [Skips::EXTENTS, Skips::BESIDE].map(|skip| flag(projector.skips.any(skip)));
        let scalars = [projector.near.to_f64(), projector.dilation.to_f64(), skips[0], skips[1]];
        let camera = projector.rotation.as_flattened().iter().chain(&projector.eye).chain(vectors.as_flattened());
        let all = camera.map(|v| v.to_f64()).chain(scalars);
        view.iter_mut().zip(all).for_each(|(place, v)| *place = v as f32);
        if let Some(k) = projector.exact.fisheye {
            let size = projector.size.map(T::to_f64);
            let rest = k.into_iter().chain(projector.exact.cone(k, size, projector.dilation.to_f64())).chain([1.0]);
            view[24..].iter_mut().zip(rest).for_each(|(place, v)| *place = v as f32);
        }
        CameraNumbers { view, exact: projector.exact.numbers() }
    }
}

impl KernelScene<'_, f32> {
    /// As C++ takes it; `None` where the plain twin does the work.
    fn native(&self) -> Option<SplatScene<'_>> {
        let camera = self.camera.as_ref()?;
        let (shape, scales): (&[f32], &[f32]) = match &self.gaussians.shape {
            Shape::Ellipsoids { rotations, scales } => (rotations.as_flattened(), scales.as_flattened()),
            Shape::Discs { axes } => (axes.as_flattened().as_flattened(), &[]),
        };
        Some(SplatScene {
            view: &camera.view,
            exact: &camera.exact,
            positions: self.gaussians.positions.as_flattened(),
            shape,
            scales,
            opacities: &self.gaussians.opacities,
            sh: &self.gaussians.sh,
            sh_degree: self.gaussians.sh_degree as u32,
            active: self.active.unwrap_or_default(),
            all: self.active.is_none(),
        })
    }
}

/// The discs of a tile as C++ takes them.
fn native_discs<'a>(tile: &DiscTile<'a, f32>) -> SplatDiscs<'a> {
    let ((tiling, t), optics) = (tile.tile, &tile.optics);
    let ([x, y], [width, height]) = (tiling.corner(t), optics.size);
    SplatDiscs {
        rows: native::columns(tile.rows),
        discs: native::columns(tile.discs),
        entries: tile.entries,
        x: x as u32,
        y: y as u32,
        width: width as u32,
        height: height as u32,
        blocks: ALL_BLOCKS,
        rays: optics.rays.as_flattened(),
        pinhole: optics.per_pixel.is_some(),
        per_px: optics.per_pixel.unwrap_or_default(),
        near: optics.near,
        filter: optics.filter.unwrap_or_default(),
    }
}

/// A direction as C++ takes it; `pose` is room for that of the camera, which stands still where no splat moves.
fn motion_of<'m>(direction: &Direction<'m, f32>, pose: &'m mut [f32; 6]) -> SplatMotion<'m> {
    match direction {
        Direction::Motion(m) => {
            let axes = m.axes.as_flattened().as_flattened();
            let shape = if axes.is_empty() { m.columns.as_flattened().as_flattened() } else { axes };
            SplatMotion { positions: m.positions.as_flattened(), shape, colors: m.colors.as_flattened(), pose: &[] }
        }
        Direction::Pose(xi) => {
            *pose = xi.map(|v| v as f32);
            SplatMotion { positions: &[], shape: &[], colors: &[], pose }
        }
        Direction::Gain(_) => SplatMotion { positions: &[], shape: &[], colors: &[], pose },
    }
}

fn vector_velocities(
    scene: &KernelScene<'_, f32>,
    first: usize,
    visible: &[bool],
    direction: &Direction<'_, f32>,
    rows: &mut Velocities<f32>,
) {
    let native_scene = scene.native().expect("a scene with velocity kernels is one for C++");
    let mut pose = [0.0; 6];
    native::velocities(scene.isa, &native_scene, first, visible, &motion_of(direction, &mut pose), rows);
}

fn vector_forward(isa: Isa, t: &mut ForwardTile<'_, f32>, velocities: &Velocities<f32>, moving: &mut [f32]) {
    let corner = t.corner.map(|v| v as f32);
    let ForwardTile { rows, entries, masks, state, parts, .. } = t;
    native::forward(isa, rows, entries, masks, corner, ALL_BLOCKS, state, parts.bits(), velocities, moving);
}

fn vector_develop(tiles: &[f32], direction: DevelopedDirection, light: &Light, color: &mut [f32]) {
    let DevelopedDirection { number, of, width } = direction;
    native_image::develop_moving(tiles, [number, of], [width, TILE_SIDE], light.gain, light.background, color);
}
