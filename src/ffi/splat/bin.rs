//! The lists of the tiles: C++ (`cpp/splat/bin.cpp`) through cxx.

#[cxx::bridge(namespace = "respire")]
#[allow(missing_docs, unused_qualifications)]
mod bridge {
    unsafe extern "C++" {
        include!("cpp/splat/bin.h");

        fn bin_count(
            boxes: &[u32],
            visible: &[bool],
            shift: u32,
            starts: &mut [u32],
            counts: &mut [u32],
        ) -> Result<u32>;
        fn bin_deal(
            first: u32,
            boxes: &[u32],
            visible: &[bool],
            keys: &[u32],
            shift: u32,
            base: u32,
            starts: &mut [u32],
            counts: &[u32],
            items: &mut [u64],
        ) -> Result<()>;
        fn bin_fill(
            items: &[u64],
            pieces: &[u32],
            boxes: &[u32],
            starts: &[u32],
            tiles_x: u32,
            low: u32,
            high: u32,
            first: u32,
            scratch: &mut [u64],
            offsets: &mut [u32],
            entries: &mut [u32],
            targets: &mut [u32],
        ) -> Result<()>;
    }
}

/// Bands of tile rows that an image has at most.
pub const BANDS: usize = 16;

/// What the caller never breaks: it is a defect of this crate, never of the input.
const AGREE: &str = "the rasteriser hands over tables that belong together";

/// Splats of a chunk as the bins see them: boxes of tiles (`x0 | y0 << 16`, `x1 | y1 << 16`), whether they are seen, and
/// the sort keys of their depths.
#[derive(Clone, Copy)]
pub struct Boxes<'a> {
    /// Two words each.
    pub boxes: &'a [[u32; 2]],
    /// Whether the box means anything.
    pub visible: &'a [bool],
    /// Smaller is nearer.
    pub keys: &'a [u32],
}

/// What a chunk has.
#[derive(Clone, Copy, Debug, Default)]
pub struct Counts {
    /// Splats, then tiles, in each band.
    pub bands: [[u32; BANDS]; 2],
    /// Visible splats.
    pub seen: u32,
}

/// Counts the splats and the tiles of a chunk in bands of `2^shift` tile rows, and, where it has visible ones, the tiles of
/// the splats up to and with each. Panics (as all of these) when the tables do not belong together.
pub fn count(chunk: &Boxes<'_>, shift: u32, starts: &mut [u32], counts: &mut Counts) {
    let bands = counts.bands.as_flattened_mut();
    counts.seen = bridge::bin_count(chunk.boxes.as_flattened(), chunk.visible, shift, starts, bands).expect(AGREE);
}

/// Puts the visible splats of a chunk that begins at number `first` into `items`, band after band; adds `base` to
/// `starts`.
pub fn deal(
    chunk: &Boxes<'_>,
    first: usize,
    shift: u32,
    base: u32,
    starts: &mut [u32],
    counts: &Counts,
    items: &mut [u64],
) {
    bridge::bin_deal(
        first as u32,
        chunk.boxes.as_flattened(),
        chunk.visible,
        chunk.keys,
        shift,
        base,
        starts,
        counts.bands.as_flattened(),
        items,
    )
    .expect(AGREE);
}

/// One band of tile rows and where its lists go.
pub struct Band<'a> {
    /// Ranges of the items that belong to it, in the order of the splats.
    pub pieces: Vec<[u32; 2]>,
    /// Tile rows.
    pub rows: std::ops::Range<usize>,
    /// Number of its first entry.
    pub first: u32,
    /// Four times as many as items.
    pub scratch: &'a mut [u64],
    /// Out: where each tile's entries begin.
    pub offsets: &'a mut [u32],
    /// Out: splats, front to back within a tile.
    pub entries: &'a mut [u32],
    /// Out: the slot of each entry; no two entries have the same.
    pub targets: &'a mut [u32],
}

/// Fills the lists of one band.
pub fn fill(band: Band<'_>, items: &[u64], boxes: &[[u32; 2]], starts: &[u32], tiles_x: usize) {
    bridge::bin_fill(
        items,
        band.pieces.as_flattened(),
        boxes.as_flattened(),
        starts,
        tiles_x as u32,
        band.rows.start as u32,
        band.rows.end as u32,
        band.first,
        band.scratch,
        band.offsets,
        band.entries,
        band.targets,
    )
    .expect(AGREE);
}
