//! The tiles that a splat meets, and the plain twin of the lists of the tiles (`cpp/splat/bin.cpp`).

use crate::ffi::splat::bin::Boxes;
use crate::splat::number::Real;
use crate::splat::types::table::{SplatRow, at};
use crate::splat::types::{TILE_SIDE, Tiling};

/// Range of tiles whose lists contain a splat, inclusive; packed: `x0 | y0 << 16`, `x1 | y1 << 16`.
#[derive(Clone, Copy, Debug, Default)]
pub struct TileBox {
    pub x0: usize,
    pub y0: usize,
    pub x1: usize,
    pub y1: usize,
}

impl TileBox {
    /// Tiles of the pixel centres within the splat's half width and height plus a slack against rounding (that of the
    /// block masks, `tile.rs`). If there are none, the tile of its left or upper end.
    pub fn of<T: Real>(row: &SplatRow<T>, tiling: &Tiling) -> Self {
        let slack = T::of(1e-3) + T::of(1e-5) * (row[at::HALF_WIDTH] + row[at::HALF_HEIGHT]);
        Self::around(row, tiling, T::of(0.5) - slack)
    }

    /// Tiles that the splat's bounding box meets after shrinking it by `less` pixels on every side.
    pub fn around<T: Real>(row: &SplatRow<T>, tiling: &Tiling, less: T) -> Self {
        let per_px = 1.0 / TILE_SIDE as f64;
        let ends = |axis: usize, n: usize| {
            let (center, half) = (row[at::X + axis], row[at::HALF_WIDTH + axis]);
            let (from, to) = (center - half + less, center + half - less);
            [from, from.maximum(to)].map(|v| (v.to_f64() * per_px).clamp(0.0, n as f64 - 1.0) as usize)
        };
        let ([x0, x1], [y0, y1]) = (ends(0, tiling.columns), ends(1, tiling.rows));
        TileBox { x0, y0, x1, y1 }
    }

    #[inline(always)]
    pub fn unpack([low, high]: [u32; 2]) -> Self {
        let part = |v: u32| (v & 0xffff) as usize;
        TileBox { x0: part(low), y0: part(low >> 16), x1: part(high), y1: part(high >> 16) }
    }

    pub fn pack(&self) -> [u32; 2] {
        [self.x0 as u32 | (self.y0 as u32) << 16, self.x1 as u32 | (self.y1 as u32) << 16]
    }

    /// Number of tiles.
    pub fn count(&self) -> usize {
        (self.x1 - self.x0 + 1) * (self.y1 - self.y0 + 1)
    }
}

/// The lists of all tiles, in the order of the tiles; the same tables as in `pass/bins.rs`.
pub struct TileLists {
    pub starts: Vec<u32>,
    pub offsets: Vec<u32>,
    pub entries: Vec<u32>,
    pub targets: Vec<u32>,
}

impl TileLists {
    /// Sorts all visible splats by depth and appends each to the lists of its tiles.
    pub fn of(tiling: &Tiling, all: &Boxes<'_>) -> TileLists {
        let n = all.boxes.len();
        let boxes: Vec<TileBox> = all.boxes.iter().map(|&b| TileBox::unpack(b)).collect();
        let mut order: Vec<u32> = (0..n as u32).filter(|&j| all.visible[j as usize]).collect();
        order.sort_by_key(|&j| (all.keys[j as usize], j));
        let (mut starts, mut sum) = (vec![0], 0);
        for (b, &visible) in boxes.iter().zip(all.visible) {
            sum += if visible { b.count() as u32 } else { 0 };
            starts.push(sum);
        }
        let mut lists = vec![Vec::new(); tiling.count()];
        for &j in &order {
            let b = boxes[j as usize];
            let cells = (b.y0..=b.y1).flat_map(|y| (b.x0..=b.x1).map(move |x| y * tiling.columns + x));
            for (cell, slot) in cells.zip(starts[j as usize]..) {
                lists[cell].push((j, slot));
            }
        }
        let mut offsets = vec![0];
        offsets.extend(lists.iter().scan(0, |end, list| {
            *end += list.len() as u32;
            Some(*end)
        }));
        let (entries, targets) = lists.into_iter().flatten().unzip();
        TileLists { starts, offsets, entries, targets }
    }
}
