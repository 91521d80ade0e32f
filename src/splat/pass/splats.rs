//! The first stage of a pass: Gaussians to rows of splats, their tiles and sort keys.

use rayon::prelude::*;

use crate::ffi::isa::Isa;
use crate::ffi::splat::bin::{self as native_bin, Boxes};
use crate::ffi::splat::rasterize::Aligned;
use crate::ffi::system::grow;
use crate::splat::kernels::{KernelScene, SplatKernels};
use crate::splat::number::Each;
use crate::splat::plain::bins::TileBox;
use crate::splat::plain::disc::tiles_of;
use crate::splat::plain::project::ProjectionChunk;
use crate::splat::types::table::at;
use crate::splat::types::{Direction, Footprint, Tiling};

use super::bins::{Bins, Counting};
use super::pool::{CHUNK, PIECE, cut, piece_of};

/// The splats of the active Gaussians; only those flagged as visible are defined.
#[derive(Debug, Default)]
pub struct Splats<T> {
    /// Rows of the splats.
    pub rows: Vec<Aligned<T>>,
    /// With `Footprint::Disc`, the further numbers of each disc that rays need.
    pub discs: Vec<Aligned<T>>,
    boxes: Vec<[u32; 2]>,
    keys: Vec<u32>,
}

/// Where velocities of splats go while they are projected.
pub struct MovingOutput<'a, 'd, T> {
    pub direction: &'a Direction<'d, T>,
    pub velocities: &'a mut Vec<[T; 8]>,
}

impl<T: SplatKernels> Splats<T> {
    /// Projects all active Gaussians of `scene` and, unless `isa` selects the plain twin of the bins, counts the
    /// visible ones into `bins` while they are in the cache.
    pub fn project(
        &mut self,
        scene: &KernelScene<'_, T>,
        isa: Isa,
        tiling: &Tiling,
        visible: &mut Vec<bool>,
        bins: &mut Bins,
        moving: Option<MovingOutput<'_, '_, T>>,
    ) {
        let n = scene.count();
        let exact = scene.projector.footprint == Footprint::Disc;
        grow(&mut self.rows, n.max(1));
        grow(&mut self.boxes, n);
        grow(&mut self.keys, n);
        visible.resize(n, false);
        let disc_count = if exact { n } else { 0 };
        if exact {
            // As many as rows, also where no Gaussian takes part.
            self.discs.resize(n.max(1), Aligned::default());
        }
        let (direction, velocities): (_, &mut [[T; 8]]) = match moving {
            Some(MovingOutput { direction, velocities }) => {
                if velocities.len() < n {
                    grow(velocities, n);
                }
                (Some(direction), &mut velocities[..n])
            }
            None => (None, &mut []),
        };
        let lengths = |total: usize| (0..n).step_by(CHUNK).map(move |first| CHUNK.min(total.saturating_sub(first)));
        let velocities = cut(velocities, lengths(if direction.is_some() { n } else { 0 }));
        let discs = cut(&mut self.discs[..disc_count], lengths(disc_count));
        let Counting { shift, starts, counts } = bins.counting(tiling, n);
        let tables = self.rows[..n].par_chunks_mut(CHUNK).zip(self.boxes.par_chunks_mut(CHUNK));
        let tables = tables.zip(self.keys.par_chunks_mut(CHUNK)).zip(visible.par_chunks_mut(CHUNK));
        let bins = starts.par_chunks_mut(CHUNK).zip(counts);
        let piece = if exact { PIECE } else { piece_of(n.div_ceil(CHUNK)) };
        tables.zip(bins).zip(velocities).zip(discs).enumerate().with_max_len(piece).for_each(
            |(chunk, ((((((rows, boxes), keys), visible), (starts, counts)), velocities), discs))| {
                let mut chunk = ProjectionChunk { first: chunk * CHUNK, rows, boxes, keys, visible };
                if exact {
                    let (projector, gaussians) = (scene.projector, &scene.gaussians);
                    chunk.fill_with(projector, gaussians, scene.active, |k, i| {
                        let (row, disc) = projector.project_disc(gaussians, i)?;
                        discs[k] = disc.pack();
                        Some((row, tiles_of(&disc.bounds, tiling)))
                    });
                } else {
                    let moving = direction.map(|direction| (direction, velocities));
                    T::project(scene, tiling, &mut chunk, moving);
                }
                if isa != Isa::Scalar {
                    let ProjectionChunk { boxes, keys, visible, .. } = chunk;
                    native_bin::count(&Boxes { boxes, visible, keys }, shift, starts, counts);
                }
            },
        );
    }

    /// The inputs of the bins.
    pub fn boxes<'a>(&'a self, visible: &'a [bool]) -> Boxes<'a> {
        Boxes { boxes: &self.boxes, keys: &self.keys, visible }
    }

    /// Recomputes the colours of the visible splats from the SH and leaves the rest unchanged; `false` if one is not
    /// finite, so that this is no longer the same scene.
    pub fn recolor(&mut self, scene: &KernelScene<'_, T>, visible: &[bool]) -> bool {
        let rows = self.rows[..visible.len()].par_chunks_mut(CHUNK);
        let chunks = rows.zip(visible.par_chunks(CHUNK)).enumerate().with_max_len(PIECE);
        let finite: Vec<bool> =
            chunks.map(|(chunk, (rows, visible))| T::recolor(scene, chunk * CHUNK, visible, rows)).collect();
        finite.into_iter().all(|f| f)
    }

    /// The colours in the rows of the first `n` splats.
    pub fn colors(&self, n: usize) -> Vec<[T; 3]> {
        self.rows[..n].iter().map(|row| [0, 1, 2].each(|k| row.0[at::RED + k])).collect()
    }

    /// Writes colours into the rows.
    pub fn set_colors(&mut self, colors: impl Iterator<Item = [T; 3]>) {
        for (row, color) in self.rows.iter_mut().zip(colors) {
            row.0[at::RED..at::RED + 3].copy_from_slice(&color);
        }
    }

    /// Pairs of a tile and a visible splat whose bounding box meets it.
    pub fn box_intersections(&self, visible: &[bool], tiling: &Tiling) -> usize {
        let rows = self.rows.iter().zip(visible).filter(|(_, visible)| **visible);
        rows.map(|(row, _)| TileBox::around(&row.0, tiling, T::zero()).count()).sum()
    }
}
