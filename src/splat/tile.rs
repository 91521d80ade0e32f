//! The tiles of an image.
//!
//! Kernels know one layout of the pixels of a tile: 16 blocks of 4x4, numbered down the columns, sixteen pixels each. A
//! smaller tile has some of these blocks, those of the upper left corner.

use super::kernel::{index_of, pixel_of};

/// Side of the tiles that splats are dealt to. Images are the same whatever it is; what it costs is in
/// `docs/performance.md` (`respire-bench pareto splat` measures it). A tile larger than 16 pixels would need more blocks
/// than a mask has bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TileSide {
    /// 4 pixels: a single block.
    Px4,
    /// 8 pixels: four blocks.
    Px8,
    /// 16 pixels: sixteen blocks. The default.
    #[default]
    Px16,
}

impl TileSide {
    /// In pixels.
    pub const fn px(self) -> usize {
        match self {
            TileSide::Px4 => 4,
            TileSide::Px8 => 8,
            TileSide::Px16 => 16,
        }
    }

    /// Which blocks such a tile has, a bit each.
    pub(super) const fn blocks(self) -> u16 {
        match self {
            TileSide::Px4 => 0x0001,
            TileSide::Px8 => 0x0033,
            TileSide::Px16 => 0xffff,
        }
    }

    /// Whether pixel `p` of the per-pixel tables belongs to such a tile.
    pub(super) fn has(self, p: usize) -> bool {
        self.blocks() >> (p / 16) & 1 == 1
    }
}

/// How an image is cut into tiles, row by row.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tiling {
    pub columns: usize,
    pub rows: usize,
    pub side: TileSide,
}

impl Tiling {
    /// Of an image of `size` pixels (width, height).
    pub fn of(size: [usize; 2], side: TileSide) -> Self {
        let [columns, rows] = size.map(|v| v.div_ceil(side.px()));
        Tiling { columns, rows, side }
    }

    /// Number of tiles.
    pub fn count(&self) -> usize {
        self.columns * self.rows
    }

    /// Upper left corner of tile `t` in pixels.
    pub fn corner(&self, t: usize) -> [usize; 2] {
        [t % self.columns, t / self.columns].map(|v| v * self.side.px())
    }

    /// Tile of the pixel (x, y), and its index in the per-pixel tables.
    pub fn place(&self, x: usize, y: usize) -> (usize, usize) {
        let side = self.side.px();
        (y / side * self.columns + x / side, index_of(x % side, y % side))
    }

    /// Where pixel `p` of the per-pixel tables of tile `t` lies in an image of `size` pixels; `None` outside.
    pub fn pixel(&self, t: usize, p: usize, size: [usize; 2]) -> Option<[usize; 2]> {
        let (corner, (column, line)) = (self.corner(t), pixel_of(p));
        let at = [corner[0] + column, corner[1] + line];
        (self.side.has(p) && at[0] < size[0] && at[1] < size[1]).then_some(at)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every pixel of an image has one place, and every place of a tile one pixel or none.
    #[test]
    fn places_and_pixels_are_inverse() {
        for side in [TileSide::Px4, TileSide::Px8, TileSide::Px16] {
            let size = [37, 21];
            let tiling = Tiling::of(size, side);
            assert_eq!(side.blocks().count_ones() as usize * 16, side.px() * side.px());
            let mut seen = 0;
            for t in 0..tiling.count() {
                for p in 0..256 {
                    let Some([x, y]) = tiling.pixel(t, p, size) else { continue };
                    assert_eq!(tiling.place(x, y), (t, p));
                    seen += 1;
                }
            }
            assert_eq!(seen, size[0] * size[1]);
        }
    }
}
