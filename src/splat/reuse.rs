//! What a render may take over from the one before: while positions, shapes and opacities stay as they were (and camera
//! and active list too), the splats, their order and the lists of the tiles are those of before, and only colours have to
//! be computed again. The images are the same bits as those of a render from scratch.

use rayon::prelude::*;

use super::pool::PIECE;
use super::project::{Projector, at, color, dot};
use super::rasterizer::{CHUNK, Rasterizer};
use super::real::Real;
use super::types::{Footprint, Gaussians, Settings, Shape, View};

/// What is kept from one render to the next.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Reuse {
    /// Nothing; nothing is compared or copied either.
    #[default]
    Never,
    /// Splats and lists while no number but SH, gain and background has changed: exact. Costs a comparison of the geometry
    /// (about a hundredth of a render), and a copy where it has changed.
    Unchanged,
    /// The same, and moreover the lists (which tiles, in which order) while no coordinate of centres and shapes is further
    /// than this (mm; quaternions: their numbers) from where the lists were made. Splats are then projected anew, but one
    /// that enters a tile is missed there, and two that change places in depth are not exchanged.
    Within {
        /// The bound in mm.
        mm: f64,
    },
}

impl Reuse {
    /// The bound that leaves images and gradients of the tube scene unchanged to 1e-6 (relative L2; measured in
    /// `tests/all/splat/reuse.rs`, which prints what larger ones do: order is what they change first).
    pub const LISTS: Reuse = Reuse::Within { mm: 1e-6 };
}

/// The geometry that the lists were made for.
#[derive(Debug)]
pub(super) struct Kept<T> {
    view: View,
    settings: Settings,
    active: Option<Vec<u32>>,
    positions: Vec<[T; 3]>,
    shape: Shape<T>,
    opacities: Vec<T>,
    sh_degree: u8,
}

/// How much of the last render still holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Same {
    Nothing,
    Lists,
    Everything,
}

/// True when no number is further than `bound` from its partner; false for NaN.
fn within<T: Real>(a: &[T], b: &[T], bound: T) -> bool {
    // Without a branch inside a piece, so that the compiler can use vectors.
    let near = |a: &[T], b: &[T]| {
        a.iter().zip(b).fold(true, |near, (&x, &y)| {
            let d = x - y;
            near & (d <= bound) & (-d <= bound)
        })
    };
    a.len() == b.len() && a.chunks(256).zip(b.chunks(256)).all(|(a, b)| near(a, b))
}

fn shapes_within<T: Real>(a: &Shape<T>, b: &Shape<T>, bound: T) -> bool {
    match (a, b) {
        (Shape::Ellipsoids { rotations: p, scales: s }, Shape::Ellipsoids { rotations: q, scales: t }) => {
            within(p.as_flattened(), q.as_flattened(), bound) && within(s.as_flattened(), t.as_flattened(), bound)
        }
        (Shape::Discs { axes: p }, Shape::Discs { axes: q }) => {
            within(p.as_flattened().as_flattened(), q.as_flattened().as_flattened(), bound)
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

    fn same(
        &self,
        gaussians: &Gaussians<T>,
        view: &View,
        settings: &Settings,
        active: Option<&[u32]>,
        reuse: Reuse,
    ) -> Same {
        let developed = Settings { gain: self.settings.gain, background: self.settings.background, ..*settings };
        let frame = self.view == *view
            && self.settings == developed
            && self.active.as_deref() == active
            && self.sh_degree == gaussians.sh_degree
            && within(&self.opacities, &gaussians.opacities, T::zero());
        // Exact discs have tables of their own: they are projected anew.
        if !frame || settings.footprint == Footprint::Disc {
            return Same::Nothing;
        }
        let near = |bound: T| {
            within(self.positions.as_flattened(), gaussians.positions.as_flattened(), bound)
                && shapes_within(&self.shape, &gaussians.shape, bound)
        };
        match reuse {
            Reuse::Never => Same::Nothing,
            _ if near(T::zero()) => Same::Everything,
            Reuse::Within { mm } if near(T::of(mm)) => Same::Lists,
            _ => Same::Nothing,
        }
    }
}

impl<T: Real> Rasterizer<T> {
    /// What later renders may take over from the one before; [`Reuse::Never`] unless told.
    pub fn reuse(&mut self, reuse: Reuse) {
        self.reuse = reuse;
        self.kept = None;
    }

    /// How much of the last render holds for this one.
    pub(super) fn same(
        &self,
        gaussians: &Gaussians<T>,
        view: &View,
        settings: &Settings,
        active: Option<&[u32]>,
    ) -> Same {
        self.kept.as_ref().map_or(Same::Nothing, |kept| kept.same(gaussians, view, settings, active, self.reuse))
    }

    /// Remembers what the lists were made for, if anybody will ask.
    pub(super) fn keep(&mut self, gaussians: &Gaussians<T>, view: &View, settings: &Settings) {
        if self.reuse != Reuse::Never {
            self.kept = Some(Kept::of(gaussians, view, settings, self.active.as_deref()));
        }
    }

    /// Colours of the visible splats from the SH, all else as it is; `false` when one is not finite, so that this is no
    /// longer the same scene.
    pub(super) fn recolor(&mut self, gaussians: &Gaussians<T>, projector: &Projector<T>) -> bool {
        let active = self.active.as_deref();
        let native = T::native(self.isa, gaussians, projector, active);
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
