//! The vectorised kernels for `f32` behind the generic code: what C++ (`cpp/splat/`) takes over, if the
//! instruction set and the camera allow. Each kernel has its plain twin in Rust.

use crate::ffi::isa::Isa;
use crate::ffi::splat::rasterize::{self as native, Aligned, ChainOutput, SplatMotion, SplatScene};

use crate::splat::number::real::Real;
use crate::splat::pass::tangent::Direction;
use crate::splat::plain::project::Projector;
use crate::splat::types::scene::{Footprint, Gaussians, Shape, Wanted};
use crate::splat::types::tiling::{TILE_SIDE, Tiling};

/// What kernels do for numbers of type `T` in one scene seen by one camera.
pub trait Native<T: Real>: Sync {
    /// Projects the Gaussians number `first..` of the active; where visible, their rows, boxes and sort keys; with `moving`
    /// their velocities along that direction as well, as [`Native::velocities`] gives them.
    fn project(
        &self,
        first: usize,
        tiling: &Tiling,
        rows: &mut [Aligned<T>],
        boxes: &mut [[u32; 2]],
        keys: &mut [u32],
        visible: &mut [bool],
        moving: Option<(&Direction<'_, T>, &mut [[T; 8]])>,
    );
    /// Writes their colours into the rows, where visible; `false` when one is not finite.
    fn recolor(&self, first: usize, visible: &[bool], rows: &mut [Aligned<T>]) -> bool;
    /// Velocities of their splats along a direction other than the gain, where visible; not of `Filter::Compensate`, which
    /// lets opacities move.
    fn velocities(&self, first: usize, visible: &[bool], direction: &Direction<'_, T>, rows: &mut [[T; 8]]);
    /// Their gradients from the moments in `slots[starts[k]..starts[k + 1]]`.
    fn chain(&self, first: usize, starts: &[u32], slots: &[Aligned<T>], wanted: Wanted, out: ChainOutput<'_, T>);
}

/// A scene and a view as the kernels take them.
pub struct Work<'a> {
    isa: Isa,
    scene: SplatScene<'a>,
}

/// The numbers of the camera, as the kernels take them.
pub struct Numbers {
    /// `View` of `cpp/splat/kernel.h`.
    pub view: [f32; 33],
    /// `Scene::camera` there.
    pub exact: [f64; 20],
}

impl Default for Numbers {
    fn default() -> Self {
        Numbers { view: [0.0; 33], exact: [0.0; 20] }
    }
}

impl<'a> Work<'a> {
    /// `None` where the plain twin has to do it: asked for, or a footprint that the kernels do not know.
    pub fn new(
        isa: Isa,
        gaussians: &'a Gaussians<f32>,
        projector: &Projector<f32>,
        numbers: &'a mut Numbers,
        active: Option<&'a [u32]>,
    ) -> Option<Self> {
        if isa == Isa::Scalar || projector.footprint() != Footprint::Ewa {
            return None;
        }
        *numbers = Numbers { view: projector.numbers(), exact: projector.exact.numbers() };
        let (shape, scales): (&[f32], &[f32]) = match &gaussians.shape {
            Shape::Ellipsoids { rotations, scales } => (rotations.as_flattened(), scales.as_flattened()),
            Shape::Discs { axes } => (axes.as_flattened().as_flattened(), &[]),
        };
        let scene = SplatScene {
            view: &numbers.view,
            exact: &numbers.exact,
            positions: gaussians.positions.as_flattened(),
            shape,
            scales,
            opacities: &gaussians.opacities,
            sh: &gaussians.sh,
            sh_degree: gaussians.sh_degree as u32,
            active: active.unwrap_or_default(),
            all: active.is_none(),
        };
        Some(Work { isa, scene })
    }
}

/// A direction as the kernels take it; `pose` is room for that of the camera, which stands still for those that no splat
/// moves along.
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

impl Native<f32> for Work<'_> {
    fn project(
        &self,
        first: usize,
        tiling: &Tiling,
        rows: &mut [Aligned<f32>],
        boxes: &mut [[u32; 2]],
        keys: &mut [u32],
        visible: &mut [bool],
        moving: Option<(&Direction<'_, f32>, &mut [[f32; 8]])>,
    ) {
        let (tiles, side) = ([tiling.columns, tiling.rows], TILE_SIDE);
        let mut pose = [0.0; 6];
        let (motion, velocities): (_, &mut [_]) = match moving {
            Some((direction, velocities)) => (motion_of(direction, &mut pose), velocities),
            None => (motion_of(&Direction::Gain([0.0; 3]), &mut pose), &mut []),
        };
        native::project(self.isa, &self.scene, first, (tiles, side), rows, boxes, keys, visible, &motion, velocities);
    }

    fn recolor(&self, first: usize, visible: &[bool], rows: &mut [Aligned<f32>]) -> bool {
        native::recolor(self.isa, &self.scene, first, visible, rows)
    }

    fn velocities(&self, first: usize, visible: &[bool], direction: &Direction<'_, f32>, rows: &mut [[f32; 8]]) {
        let mut pose = [0.0; 6];
        native::velocities(self.isa, &self.scene, first, visible, &motion_of(direction, &mut pose), rows);
    }

    fn chain(&self, first: usize, starts: &[u32], slots: &[Aligned<f32>], wanted: Wanted, out: ChainOutput<'_, f32>) {
        native::chain(self.isa, &self.scene, first, starts, slots, wanted.bits(), out);
    }
}
