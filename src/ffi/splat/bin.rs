//! The lists of the tiles: C++ (`cpp/splat/bin.cpp`) through cxx. Panics if tables do not fit together: that is a
//! defect of this crate, never of the input.

#[cxx::bridge(namespace = "respire")]
#[allow(missing_docs, unused_qualifications)]
mod bridge {
    /// [`super::Boxes`] as C++ takes it.
    struct BinSplats<'a> {
        boxes: &'a [[u32; 2]],
        visible: &'a [bool],
        keys: &'a [u32],
    }

    /// Counts of a chunk of splats.
    #[derive(Clone, Debug, Default)]
    struct Counts {
        /// Splats in each band.
        splats: [u32; 16],
        /// Tiles of these splats in each band.
        tiles: [u32; 16],
        /// Visible splats.
        visible: u32,
    }

    /// Where the splats of a chunk are distributed to.
    struct Distribution<'a> {
        /// Number of the chunk's first splat.
        first: u32,
        /// Slots of all chunks before.
        base: u32,
        /// In: running total of tiles over the chunk's splats. Out: the same plus `base`.
        starts: &'a mut [u32],
        /// Out: `key << 32 | splat`, band after band.
        items: &'a mut [u64],
    }

    /// Items `begin..end`.
    #[derive(Clone, Copy, Debug)]
    struct ItemRange {
        begin: u32,
        end: u32,
    }

    /// All distributed splats.
    struct BinItems<'a> {
        /// `key << 32 | splat`.
        items: &'a [u64],
        /// Packed boxes of the splats.
        boxes: &'a [[u32; 2]],
        /// Slots of splat `j` begin at `starts[j]`.
        starts: &'a [u32],
        /// Tiles in a row of the image.
        tiles_x: u32,
    }

    /// One band of tile rows and where its lists go.
    struct Band<'a> {
        /// The items that belong to it, in the order of the splats.
        pieces: Vec<ItemRange>,
        /// Tile rows `row_begin..row_end`.
        row_begin: u32,
        row_end: u32,
        /// Number of its first entry.
        first: u32,
        /// Four times as many as items.
        scratch: &'a mut [u64],
        /// Out: where each tile's entries begin.
        offsets: &'a mut [u32],
        /// Out: splats, front to back within a tile.
        entries: &'a mut [u32],
        /// Out: the slot of each entry; no two entries have the same.
        targets: &'a mut [u32],
    }

    // SAFETY: the functions check all indices and lengths before they read or write (`cpp/splat/bin.cpp`) and throw
    // where they do not fit, which becomes an `Err`; none keeps a pointer, calls back into Rust, or writes what it was
    // not given as `&mut`. They count in 64 bits and refuse what 32 cannot number, so that no place wraps round.
    unsafe extern "C++" {
        include!("cpp/splat/bin.h");

        fn bin_count(splats: &BinSplats, shift: u32, starts: &mut [u32], counts: &mut Counts) -> Result<()>;
        fn bin_distribute(splats: &BinSplats, shift: u32, counts: &Counts, to: Distribution) -> Result<()>;
        fn bin_fill(all: &BinItems, band: Band) -> Result<()>;
    }
}

pub use bridge::{Band, BinItems, Counts, Distribution, ItemRange};

/// Largest number of bands of tile rows in an image.
pub const BANDS: usize = 16;

/// The caller's invariant: breaking it is a defect of this crate, never of the input.
const AGREE: &str = "the rasteriser hands over tables that belong together";

/// Splats of a chunk as the bins take them: boxes of tiles (`x0 | y0 << 16`, `x1 | y1 << 16`, inclusive), whether they
/// are visible, and the sort keys of their depths.
#[derive(Clone, Copy)]
pub struct Boxes<'a> {
    /// Two words each.
    pub boxes: &'a [[u32; 2]],
    /// Whether the splat is visible, i.e. its box is defined.
    pub visible: &'a [bool],
    /// Sort keys; smaller is nearer.
    pub keys: &'a [u32],
}

impl<'a> Boxes<'a> {
    fn bridged(&self) -> bridge::BinSplats<'a> {
        let &Boxes { boxes, visible, keys } = self;
        bridge::BinSplats { boxes, visible, keys }
    }
}

/// Counts the splats and the tiles of a chunk in bands of `2^shift` tile rows and, if any splat is visible, the running
/// total of tiles over the splats.
pub fn count(chunk: &Boxes<'_>, shift: u32, starts: &mut [u32], counts: &mut Counts) {
    bridge::bin_count(&chunk.bridged(), shift, starts, counts).expect(AGREE);
}

/// Puts the visible splats of a chunk into items, band after band, in their order.
pub fn distribute(chunk: &Boxes<'_>, shift: u32, counts: &Counts, to: Distribution<'_>) {
    bridge::bin_distribute(&chunk.bridged(), shift, counts, to).expect(AGREE);
}

/// Fills the lists of one band.
pub fn fill(all: &BinItems<'_>, band: Band<'_>) {
    bridge::bin_fill(all, band).expect(AGREE);
}
