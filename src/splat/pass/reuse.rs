//! What a render may take over from the one before: while positions, shapes and opacities stay as they were (and camera
//! and active list too), the splats, their order and the lists of the tiles are those of before, and only colours have to
//! be computed again. The images are the same bits as those of a render from scratch.

use rayon::prelude::*;

use crate::splat::kernels::Numbers;
use crate::splat::number::real::Real;
use crate::splat::pass::pool::PIECE;
use crate::splat::pass::rasterizer::{CHUNK, Rasterizer};
use crate::splat::plain::project::{Projector, at, color, dot};
use crate::splat::types::scene::{Footprint, Gaussians, Settings, Shape, View};

/// What is kept from one render to the next.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Reuse {
    /// Nothing; nothing is compared or copied either.
    #[default]
    Never,
    /// Splats and lists while no number but SH, gain and background has changed: exact. Costs a comparison of the geometry
    /// (about a hundredth of a render), and a copy where it has changed.
    Unchanged,
}

/// The geometry that the lists were made for.
#[derive(Debug)]
pub(in crate::splat) struct Kept<T> {
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

fn equal_shapes<T: Real>(a: &Shape<T>, b: &Shape<T>) -> bool {
    match (a, b) {
        (Shape::Ellipsoids { rotations: p, scales: s }, Shape::Ellipsoids { rotations: q, scales: t }) => {
            equal(p.as_flattened(), q.as_flattened()) && equal(s.as_flattened(), t.as_flattened())
        }
        (Shape::Discs { axes: p }, Shape::Discs { axes: q }) => {
            equal(p.as_flattened().as_flattened(), q.as_flattened().as_flattened())
        }
        _ => false,
    }
}

impl<T: Real> Kept<T> {
    fn of(gaussians: &Gaussians<T>, view: &View, settings: &Settings, active: Option<&[u32]>) -> Self {
        Kept {
            view: *view,
            settings: *settings,
            active: active.map(<[u32]>::to_vec),
            positions: gaussians.positions.clone(),
            shape: gaussians.shape.clone(),
            opacities: gaussians.opacities.clone(),
            sh_degree: gaussians.sh_degree,
        }
    }

    fn same(&self, gaussians: &Gaussians<T>, view: &View, settings: &Settings, active: Option<&[u32]>) -> bool {
        let developed = Settings { gain: self.settings.gain, background: self.settings.background, ..*settings };
        // Exact discs have tables of their own: they are projected anew.
        settings.footprint != Footprint::Disc
            && self.view == *view
            && self.settings == developed
            && self.active.as_deref() == active
            && self.sh_degree == gaussians.sh_degree
            && equal(&self.opacities, &gaussians.opacities)
            && equal(self.positions.as_flattened(), gaussians.positions.as_flattened())
            && equal_shapes(&self.shape, &gaussians.shape)
    }
}

impl<T: Real> Rasterizer<T> {
    /// What later renders may take over from the one before; [`Reuse::Never`] unless told.
    pub fn reuse(&mut self, reuse: Reuse) {
        self.reuse = reuse;
        self.kept = None;
    }

    /// Whether the splats and lists of the last render hold for this one.
    pub(in crate::splat) fn same(
        &self,
        gaussians: &Gaussians<T>,
        view: &View,
        settings: &Settings,
        active: Option<&[u32]>,
    ) -> bool {
        self.kept.as_ref().is_some_and(|kept| kept.same(gaussians, view, settings, active))
    }

    /// Remembers what the lists were made for, if anybody will ask.
    pub(in crate::splat) fn keep(&mut self, gaussians: &Gaussians<T>, view: &View, settings: &Settings) {
        if self.reuse != Reuse::Never {
            self.kept = Some(Kept::of(gaussians, view, settings, self.active.as_deref()));
        }
    }

    /// Colours of the visible splats from the SH, all else as it is; `false` when one is not finite, so that this is no
    /// longer the same scene.
    pub(in crate::splat) fn recolor(&mut self, gaussians: &Gaussians<T>, projector: &Projector<T>) -> bool {
        let active = self.active.as_deref();
        let mut numbers = Numbers::default();
        let native = T::native(self.isa, gaussians, projector, &mut numbers, active);
        let visible = &self.rendered.visible;
        let chunks = self.rows[..visible.len()]
            .par_chunks_mut(CHUNK)
            .zip(visible.par_chunks(CHUNK))
            .enumerate()
            .with_max_len(PIECE);
        let finite: Vec<bool> = chunks
            .map(|(chunk, (rows, visible))| {
                let first = chunk * CHUNK;
                if let Some(native) = &native {
                    return native.recolor(first, visible, rows);
                }
                let mut finite = true;
                for (k, row) in rows.iter_mut().enumerate().filter(|(k, _)| visible[*k]) {
                    let i = active.map_or(first + k, |list| list[first + k] as usize);
                    let offset = [0, 1, 2].map(|c| gaussians.positions[i][c] - projector.eye[c]);
                    let distance = dot(offset, offset).sqrt();
                    let shown = color(gaussians, i, offset.map(|v| v / distance));
                    finite &= (shown[0] + shown[1] + shown[2]).is_finite();
                    for c in 0..3 {
                        row.0[at::RED + c] = shown[c].maximum(T::zero());
                    }
                }
                finite
            })
            .collect();
        finite.into_iter().all(|f| f)
    }
}
