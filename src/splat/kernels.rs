//! Which code runs a stage: [`SplatKernels`] has the stages of a pass on a chunk of Gaussians, on a tile, on a row of
//! tiles. Its default bodies are the plain ones (`plain/`), which `f64` and [`Dual`] keep; `f32` calls the vectorised
//! C++ (`cpp/splat/`) where the instruction set and the footprint allow. No other code in the core depends on which
//! of them runs.

use crate::ffi::isa::Isa;
use crate::ffi::splat::image::{self as native_image, ImageBand, ImageFormation, PixelGradients, TilePlace};
use crate::ffi::splat::rasterize::{
    self as native, Aligned, ChainOutput, Slots, SplatBackward, SplatCamera, SplatCameraGradient, SplatChunk,
    SplatDiscs, SplatExactCamera, SplatForward, SplatMoments, SplatMotion, SplatScene,
};

use super::number::{Dual, Each, Real};
use super::plain::disc_tile::DiscTile;
use super::plain::fault::Faults;
use super::plain::gradient_chunk::{ChunkMoments, GradientChunk};
use super::plain::image;
use super::plain::project::{ProjectionChunk, recolor};
use super::plain::projector::Projector;
use super::plain::tile::{self, BackwardTile, ForwardTile, Parts};
use super::types::table::DiscSums;
use super::types::{Direction, Filter, Footprint, GaussianSlices, ImageGradient, ShapeSlices, Skips, Tiling, Wanted};

/// A scene and its camera, as the kernels take them.
pub struct KernelScene<'a, T> {
    pub gaussians: GaussianSlices<'a, T>,
    pub projector: &'a Projector<T>,
    /// Which Gaussians take part; `None` for all.
    pub active: Option<&'a [u32]>,
    isa: Isa,
    /// The camera in the form that C++ takes, in single and in double precision; `None` if the plain code runs.
    camera: Option<(SplatCamera, SplatExactCamera)>,
}

impl<'a, T: SplatKernels> KernelScene<'a, T> {
    /// `gaussians`, or those in `active`, to be processed by the kernels of `isa`.
    pub fn new(
        isa: Isa,
        gaussians: GaussianSlices<'a, T>,
        projector: &'a Projector<T>,
        active: Option<&'a [u32]>,
    ) -> Self {
        let vectorised = T::VECTORISED && isa != Isa::Scalar && projector.footprint == Footprint::Ewa;
        KernelScene { gaussians, projector, active, isa, camera: vectorised.then(|| native_camera(projector)) }
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
    /// Composites one tile together with the velocities of its pixels along up to four directions. The input has one
    /// row per splat, direction by direction; the output red, green, blue and transmittance per pixel and direction.
    pub forward: fn(Isa, &mut ForwardTile<'_, T>, &Velocities<T>, &mut [T]),
    /// Velocities of a row of tiles, to lines of the velocity of the colour along one direction.
    pub develop: fn(&[T], DevelopedDirection, &ImageFormation, &mut [T]),
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

    /// Projects a chunk; with `moving` also computes its velocities along that direction, which is requested only of
    /// a type with `VelocityKernels`.
    fn project(
        scene: &KernelScene<'_, Self>,
        tiling: &Tiling,
        chunk: &mut ProjectionChunk<'_, Self>,
        _moving: Option<(&Direction<'_, Self>, &mut Velocities<Self>)>,
    ) {
        chunk.fill(scene.projector, &scene.gaussians, scene.active, tiling);
    }

    /// Writes the colours of the visible splats number `first..` into their rows; `false` when one is not finite.
    fn recolor(scene: &KernelScene<'_, Self>, first: usize, visible: &[bool], rows: &mut [Aligned<Self>]) -> bool {
        recolor(scene.projector, &scene.gaussians, scene.active, first, visible, rows)
    }

    /// Gradients of a chunk from its moments; returns those of the camera.
    fn chain(
        scene: &KernelScene<'_, Self>,
        from: &ChunkMoments<'_, Self>,
        wanted: Wanted,
        chunk: &mut GradientChunk<'_, Self>,
        faults: impl Faults,
    ) -> SplatCameraGradient {
        chunk.fill(scene.projector, &scene.gaussians, scene.active, from, wanted, faults)
    }

    /// The kernels for velocities in this scene; `None` if dual numbers are needed.
    fn velocity_kernels(_scene: &KernelScene<'_, Self>) -> Option<VelocityKernels<Self>> {
        None
    }

    /// Composites one tile: computes the colour of its pixels.
    fn forward_tile(_isa: Isa, tile: &mut ForwardTile<'_, Self>) {
        tile::forward(tile);
    }

    /// The slots and their flags as tiles can share them while they write; `None` where tiles return their moments.
    fn shared_slots<'s>(_isa: Isa, _slots: &'s mut [Aligned<Self>], _live: &'s mut [bool]) -> Option<Slots<'s>> {
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
    fn develop(tiles: &[Self], width: usize, formation: &ImageFormation, band: ImageBand<'_, Self>) {
        image::develop(tiles, width, formation, band);
    }

    /// Gradients of the sums of tile `place` of an image of `size`; returns its part of the gradient of the gain.
    fn adjoint(
        state: &[Self],
        place: (Tiling, usize),
        size: [usize; 2],
        formation: &ImageFormation,
        image: &ImageGradient<'_, Self>,
        adjoint: &mut [Self],
        faults: impl Faults,
    ) -> [f64; 3] {
        image::adjoint(state, place, size, formation, image, adjoint, faults)
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
            return chunk.fill(scene.projector, &scene.gaussians, scene.active, tiling);
        };
        let mut pose = [0.0; 6];
        let (motion, velocities): (_, &mut Velocities<f32>) = match moving {
            Some((direction, velocities)) => (motion_of(direction, &mut pose), velocities),
            None => (motion_of(&Direction::Gain([0.0; 3]), &mut pose), &mut []),
        };
        let ProjectionChunk { first, rows, boxes, keys, visible } = chunk;
        let chunk = SplatChunk { first: *first, rows, boxes, keys, visible, velocities };
        native::project(scene.isa, &native_scene, [tiling.columns, tiling.rows], chunk, &motion);
    }

    fn recolor(scene: &KernelScene<'_, f32>, first: usize, visible: &[bool], rows: &mut [Aligned<f32>]) -> bool {
        match scene.native() {
            Some(native_scene) => native::recolor(scene.isa, &native_scene, first, visible, rows),
            None => recolor(scene.projector, &scene.gaussians, scene.active, first, visible, rows),
        }
    }

    fn chain(
        scene: &KernelScene<'_, f32>,
        from: &ChunkMoments<'_, f32>,
        wanted: Wanted,
        chunk: &mut GradientChunk<'_, f32>,
        faults: impl Faults,
    ) -> SplatCameraGradient {
        let Some(native_scene) = scene.native().filter(|_| faults.is_sound()) else {
            return chunk.fill(scene.projector, &scene.gaussians, scene.active, from, wanted, faults);
        };
        let discs = chunk.axes.as_flattened_mut().as_flattened_mut();
        let out = ChainOutput {
            positions: chunk.positions.as_flattened_mut(),
            shape: if discs.is_empty() { chunk.rotations.as_flattened_mut() } else { discs },
            scales: chunk.scales.as_flattened_mut(),
            opacities: chunk.opacities,
            sh: chunk.sh,
            written: chunk.written,
            heard: chunk.heard,
        };
        let ChunkMoments { starts, moments, live, .. } = *from;
        let moments = SplatMoments { first: chunk.first, starts, slots: moments, live, wanted: wanted.bits() };
        native::chain(scene.isa, &native_scene, &moments, out)
    }

    /// Not for `Filter::Compensate`, under which opacities change: the velocity of a splat has no column for that. Only
    /// with the feature `methods` (`WITH_DIRECTIONS` in `cpp/splat/kernel.h`).
    fn velocity_kernels(scene: &KernelScene<'_, f32>) -> Option<VelocityKernels<f32>> {
        let serves = cfg!(feature = "methods") && scene.projector.filter == Filter::Dilate;
        (serves && scene.camera.is_some()).then_some(VelocityKernels {
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

    fn shared_slots<'s>(isa: Isa, slots: &'s mut [Aligned<f32>], live: &'s mut [bool]) -> Option<Slots<'s>> {
        (isa != Isa::Scalar).then(|| Slots::new(slots, live))
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
        native::backward(isa, &SplatBackward { rows, entries, masks, targets, corner, parts, adjoint }, slots);
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

    fn develop(tiles: &[f32], width: usize, formation: &ImageFormation, band: ImageBand<'_, f32>) {
        native_image::develop(tiles, width, formation, band);
    }

    fn adjoint(
        state: &[f32],
        (tiling, t): (Tiling, usize),
        size: [usize; 2],
        formation: &ImageFormation,
        image: &ImageGradient<'_, f32>,
        adjoint: &mut [f32],
        faults: impl Faults,
    ) -> [f64; 3] {
        if !faults.is_sound() {
            return image::adjoint(state, (tiling, t), size, formation, image, adjoint, faults);
        }
        let place = TilePlace { corner: tiling.corner(t), size };
        let &ImageGradient { color, depth, alpha, .. } = image;
        native_image::adjoint(state, &place, formation, &PixelGradients { color, depth, alpha }, adjoint)
    }
}

/// A camera as C++ takes it.
fn native_camera<T: Real>(projector: &Projector<T>) -> (SplatCamera, SplatExactCamera) {
    let (lens, exact) = (&projector.lens, &projector.exact);
    let single = |v: T| v.to_f64() as f32;
    let rows = |[a, b, c]: [[f64; 3]; 3]| [a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2]];
    let (size, dilation) = (projector.size.each(T::to_f64), projector.dilation.to_f64());
    let cone = exact.fisheye.map_or([0.0; 3], |distortion| exact.cone(distortion, size, dilation));
    let [cone_cosine, cone_sine, cone_reach] = cone.each(|v| v as f32);
    let camera = SplatCamera {
        rotation: rows(projector.rotation.each(|row| row.each(T::to_f64))).map(|v| v as f32),
        eye: projector.eye.each(single),
        focal: lens.focal.each(single),
        center: lens.center.each(single),
        low: lens.low.each(single),
        high: lens.high.each(single),
        size: projector.size.each(single),
        near: single(projector.near),
        dilation: single(projector.dilation),
        extent_by_opacity: projector.skips.any(Skips::EXTENTS),
        skip_beside: projector.skips.any(Skips::BESIDE),
        compensate: projector.filter == Filter::Compensate,
        fisheye: exact.fisheye.is_some(),
        distortion: exact.fisheye.unwrap_or_default().each(|v| v as f32),
        cone_cosine,
        cone_sine,
        cone_reach,
    };
    let exact_camera = SplatExactCamera {
        rotation: rows(exact.rotation),
        eye: exact.eye,
        focal: exact.focal,
        center: exact.center,
        distortion: exact.fisheye.unwrap_or_default(),
    };
    (camera, exact_camera)
}

impl KernelScene<'_, f32> {
    /// As C++ takes it; `None` if the plain twin runs.
    fn native(&self) -> Option<SplatScene<'_>> {
        let (camera, exact_camera) = self.camera.as_ref()?;
        let (shape, scales): (&[f32], &[f32]) = match self.gaussians.shape {
            ShapeSlices::Ellipsoids { rotations, scales } => (rotations.as_flattened(), scales.as_flattened()),
            ShapeSlices::Discs { axes } => (axes.as_flattened().as_flattened(), &[]),
        };
        Some(SplatScene {
            camera: camera.clone(),
            exact_camera: exact_camera.clone(),
            positions: self.gaussians.positions.as_flattened(),
            shape,
            scales,
            opacities: self.gaussians.opacities,
            sh: self.gaussians.sh,
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
        rows: tile.rows,
        discs: tile.discs,
        entries: tile.entries,
        x: x as u32,
        y: y as u32,
        width: width as u32,
        height: height as u32,
        rays: optics.rays,
        pinhole: optics.per_pixel.is_some(),
        per_px: optics.per_pixel.unwrap_or_default(),
        near: optics.near,
        filter: optics.filter.unwrap_or_default(),
    }
}

/// A direction as C++ takes it. `pose` is storage for the motion of the camera.
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
    let parts = parts.bits();
    native::forward(isa, SplatForward { rows, entries, masks, corner, parts, state, velocities, moving });
}

fn vector_develop(tiles: &[f32], direction: DevelopedDirection, formation: &ImageFormation, color: &mut [f32]) {
    let DevelopedDirection { number, of, width } = direction;
    native_image::develop_moving(tiles, [number, of], width, formation, color);
}
