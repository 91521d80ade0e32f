//! What a render may reuse from the one before: while positions, shapes, opacities, camera and active list stay
//! unchanged, so do the splats, their order and the lists of the tiles, and only colours have to be computed again.
//! The images are bit by bit those of a render from scratch.

use crate::splat::number::Real;
use crate::splat::types::{Footprint, Settings, Shape, ShapeSlices, View};

use super::options::RenderRequest;

/// What is reused from one render to the next.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Reuse {
    /// Nothing; no comparison or copy is made either.
    #[default]
    Never,
    /// Splats and lists while only SH, gain and background have changed: exact. Costs a comparison of the geometry
    /// (about a hundredth of a render), and a copy if it has changed.
    Unchanged,
}

/// The geometry that the lists were made for.
#[derive(Debug)]
struct KeptGeometry<T> {
    view: View,
    settings: Settings,
    active: Option<Vec<u32>>,
    positions: Vec<[T; 3]>,
    shape: Shape<T>,
    opacities: Vec<T>,
    sh_degree: u8,
}

/// True when all numbers are equal; false for NaN.
fn equal<T: Real>(a: &[T], b: &[T]) -> bool {
    // Without a branch inside a piece, so that the compiler can use vectors.
    let same = |a: &[T], b: &[T]| a.iter().zip(b).fold(true, |same, (x, y)| same & (x == y));
    a.len() == b.len() && a.chunks(256).zip(b.chunks(256)).all(|(a, b)| same(a, b))
}

fn equal_shapes<T: Real>(a: &Shape<T>, b: ShapeSlices<'_, T>) -> bool {
    match (a, b) {
        (Shape::Ellipsoids { rotations: p, scales: s }, ShapeSlices::Ellipsoids { rotations: q, scales: t }) => {
            equal(p.as_flattened(), q.as_flattened()) && equal(s.as_flattened(), t.as_flattened())
        }
        (Shape::Discs { axes: p }, ShapeSlices::Discs { axes: q }) => {
            equal(p.as_flattened().as_flattened(), q.as_flattened().as_flattened())
        }
        _ => false,
    }
}

impl<T: Real> KeptGeometry<T> {
    /// A copy of the geometry, with the rest that the lists depend on.
    fn of(request: RenderRequest<'_, T>) -> Self {
        let RenderRequest { gaussians, view, settings, active } = request;
        KeptGeometry {
            view: *view,
            settings: *settings,
            active: active.map(<[u32]>::to_vec),
            positions: gaussians.positions.to_vec(),
            shape: gaussians.shape.to_shape(),
            opacities: gaussians.opacities.to_vec(),
            sh_degree: gaussians.sh_degree,
        }
    }

    /// Whether splats and lists are valid for this render.
    fn holds_for(&self, request: RenderRequest<'_, T>) -> bool {
        let RenderRequest { gaussians, view, settings, active } = request;
        let developed = Settings { gain: self.settings.gain, background: self.settings.background, ..*settings };
        // Exact discs have tables of their own and are always projected anew.
        settings.footprint != Footprint::Disc
            && self.view == *view
            && self.settings == developed
            && self.active.as_deref() == active
            && self.sh_degree == gaussians.sh_degree
            && equal(&self.opacities, gaussians.opacities)
            && equal(self.positions.as_flattened(), gaussians.positions.as_flattened())
            && equal_shapes(&self.shape, gaussians.shape)
    }
}

/// The geometry of the last render, if reuse is on.
#[derive(Debug)]
pub struct ReuseState<T> {
    mode: Reuse,
    kept: Option<KeptGeometry<T>>,
}

impl<T> Default for ReuseState<T> {
    fn default() -> Self {
        Self::new(Reuse::Never)
    }
}

impl<T> ReuseState<T> {
    /// Nothing is kept yet.
    pub fn new(mode: Reuse) -> Self {
        ReuseState { mode, kept: None }
    }

    /// The next render starts from scratch.
    pub fn forget(&mut self) {
        self.kept = None;
    }
}

impl<T: Real> ReuseState<T> {
    /// Whether the splats and lists of the last render are valid for this one.
    pub fn holds_for(&self, request: RenderRequest<'_, T>) -> bool {
        self.kept.as_ref().is_some_and(|kept| kept.holds_for(request))
    }

    /// Stores the geometry that the lists were made for, if reuse is on.
    pub fn keep(&mut self, request: RenderRequest<'_, T>) {
        if self.mode == Reuse::Unchanged {
            self.kept = Some(KeptGeometry::of(request));
        }
    }
}
