//! The tiles of an image: 16x16 pixels each.
//!
//! All kernels use one layout of the pixels of a tile: 16 blocks of 4x4, numbered down the columns, sixteen pixels
//! each, so that a block is one vector and the blocks of a tile are the bits of one 16-bit mask.

/// Side of a tile in pixels: sixteen blocks of sixteen pixels.
pub const TILE_SIDE: usize = 16;
/// Pixels of a tile.
pub const PIXELS: usize = TILE_SIDE * TILE_SIDE;

/// Pixel (column, row) within the tile of index `p` of the per-pixel tables.
pub fn pixel_of(p: usize) -> (usize, usize) {
    let (block, lane) = (p / 16, p % 16);
    (4 * (block / 4) + lane % 4, 4 * (block % 4) + lane / 4)
}

/// Index in the per-pixel tables of the pixel (column, row) of a tile: the inverse of [`pixel_of`].
pub fn index_of(column: usize, line: usize) -> usize {
    16 * (4 * (column / 4) + line / 4) + 4 * (line % 4) + column % 4
}

/// How an image is cut into tiles, row by row.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tiling {
    pub columns: usize,
    pub rows: usize,
}

impl Tiling {
    /// Of an image of `size` pixels (width, height).
    pub fn of(size: [usize; 2]) -> Self {
        let [columns, rows] = size.map(|v| v.div_ceil(TILE_SIDE));
        Tiling { columns, rows }
    }

    /// Number of tiles.
    pub fn count(&self) -> usize {
        self.columns * self.rows
    }

    /// Upper left corner of tile `t` in pixels.
    pub fn corner(&self, t: usize) -> [usize; 2] {
        [t % self.columns, t / self.columns].map(|v| v * TILE_SIDE)
    }

    /// Tile of the pixel (x, y), and its index in the per-pixel tables.
    pub fn place(&self, x: usize, y: usize) -> (usize, usize) {
        (y / TILE_SIDE * self.columns + x / TILE_SIDE, index_of(x % TILE_SIDE, y % TILE_SIDE))
    }

    /// Where pixel `p` of the per-pixel tables of tile `t` lies in an image of `size` pixels; `None` outside.
    pub fn pixel(&self, t: usize, p: usize, size: [usize; 2]) -> Option<[usize; 2]> {
        let (corner, (column, line)) = (self.corner(t), pixel_of(p));
        let at = [corner[0] + column, corner[1] + line];
        (at[0] < size[0] && at[1] < size[1]).then_some(at)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every pixel of an image has one place, and every place of a tile one pixel or none.
    #[test]
    fn places_and_pixels_are_inverse() {
        let size = [37, 21];
        let tiling = Tiling::of(size);
        let mut inside = 0;
        for t in 0..tiling.count() {
            for p in 0..PIXELS {
                let Some([x, y]) = tiling.pixel(t, p, size) else { continue };
                assert_eq!(tiling.place(x, y), (t, p));
                inside += 1;
            }
        }
        assert_eq!(inside, size[0] * size[1]);
    }
}
