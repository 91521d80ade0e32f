//! From splats to the list of each tile: splats are distributed to bands of tile rows, each band is sorted by depth
//! (stable radix sort) and then distributed to its tiles by counting. Depth ties keep the order of the Gaussians.
//! Bands are independent tasks, and their number depends on the image alone, so the result does not depend on the
//! threads. C++ does the work on a chunk or a band (`cpp/splat/bin.cpp`); the plain twin is [`TileLists`].
//!
//! Every entry has a slot for its moments. Slots are ordered splat by splat, so that the chain reads them in sequence.
//! Tiles write them out of order, which costs less, since nothing waits for a write.

use rayon::prelude::*;

use crate::base::estimate::demand_memory;
use crate::base::{Error, Result};
use crate::ffi::isa::Isa;
use crate::ffi::splat::bin::{self as native, BANDS, Band, BinItems, Boxes, Counts, Distribution, ItemRange};
use crate::ffi::system::grow;
use crate::splat::plain::bins::{TileBox, TileLists};
use crate::splat::types::Tiling;

use super::pool::{CHUNK, PIECE, cut, piece_of};

/// Most entries of the lists together: a hundred times those of a large scene. Their places are 32-bit numbers, and a
/// backward pass has 64 bytes for each.
const MOST_ENTRIES: usize = 1 << 30;
const _: () = assert!(MOST_ENTRIES <= u32::MAX as usize, "entries are numbered in 32 bits");
/// Bytes of an entry (its splat, slot and mask), and of a splat in a band (its item and the scratch of the sort).
const ENTRY_BYTES: f64 = 10.0;
const ITEM_BYTES: f64 = 40.0;

/// Splats in each band and tile entries in each band, summed over the chunks.
struct BandTotals {
    splats: [usize; BANDS],
    entries: [usize; BANDS],
}

/// The lists of all tiles.
#[derive(Debug, Default)]
pub struct Bins {
    pub tiling: Tiling,
    /// Entries of tile `t` are `offsets[t]..offsets[t + 1]`.
    pub offsets: Vec<u32>,
    /// Splat of each entry, front to back within a tile.
    pub entries: Vec<u32>,
    /// Slot of each entry; all are different.
    pub targets: Vec<u32>,
    /// 4x4 blocks of its tile that each entry may touch, written by the forward pass.
    pub masks: Vec<u16>,
    /// Whether a forward pass of the current splats has written the masks.
    pub masks_known: bool,
    /// Slots of splat `j`, row by row of its box: `starts[j]..starts[j + 1]`; none if it is not visible. In a chunk
    /// without visible splats only the last number is defined.
    pub starts: Vec<u32>,
    items: Vec<u64>,
    scratch: Vec<u64>,
    counts: Vec<Counts>,
}

/// Output of counting the chunks of splats (`native::count`).
pub struct Counting<'a> {
    /// Tile rows of a band, as a power of 2.
    pub shift: u32,
    /// Running total of tiles over the splats of the chunk.
    pub starts: &'a mut [u32],
    /// One per chunk.
    pub counts: &'a mut [Counts],
}

/// Logarithm to base 2 of the tile rows per band: the smallest that gives at most [`BANDS`] bands, as many as the
/// threads of a large machine can use.
fn shift_of(tiling: &Tiling) -> u32 {
    (1..).find(|s| tiling.rows.div_ceil(1 << s) <= BANDS).expect("an image has a finite number of tile rows")
}

/// Orders the bands so that each half ends with small ones: threads take halves, and the last bands decide how long
/// they wait for each other.
fn longest_first(mut bands: Vec<Band<'_>>) -> Vec<Band<'_>> {
    bands.sort_by_key(|band| std::cmp::Reverse(band.entries.len()));
    let (mut halves, last) = ([Vec::new(), Vec::new()], bands.len());
    for (k, band) in bands.into_iter().enumerate() {
        // 0 1 1 0 0 1 1 0 ..
        let full = halves[0].len() == last.div_ceil(2);
        halves[usize::from(k.div_ceil(2) % 2 == 1 || full)].push(band);
    }
    let [mut all, second] = halves;
    all.extend(second);
    all
}

fn chunk_of<'a>(all: &Boxes<'a>, chunk: usize) -> Boxes<'a> {
    let range = chunk * CHUNK..all.boxes.len().min((chunk + 1) * CHUNK);
    Boxes { boxes: &all.boxes[range.clone()], visible: &all.visible[range.clone()], keys: &all.keys[range] }
}

impl Bins {
    /// Where the tiles of `n` splats are counted, chunk by chunk, before [`Bins::fill`].
    pub fn counting(&mut self, tiling: &Tiling, n: usize) -> Counting<'_> {
        self.starts.resize(n + 1, 0);
        self.counts.resize(n.div_ceil(CHUNK), Counts::default());
        Counting { shift: shift_of(tiling), starts: &mut self.starts[1..], counts: &mut self.counts }
    }

    /// Where the entries of tile `t` lie.
    pub fn span(&self, t: usize) -> std::ops::Range<usize> {
        self.offsets[t] as usize..self.offsets[t + 1] as usize
    }

    /// Visible splats that were counted.
    pub fn visible_count(&self) -> usize {
        self.counts.iter().map(|c| c.visible as usize).sum()
    }

    /// Tiles of the visible splats together: how long the lists would be. The splats must have been counted unless
    /// `isa` is scalar.
    pub fn entries_of(&self, isa: Isa, all: &Boxes<'_>) -> usize {
        if isa == Isa::Scalar {
            let visible = all.boxes.iter().zip(all.visible).filter(|(_, visible)| **visible);
            visible.map(|(&packed, _)| TileBox::unpack(packed).count()).sum()
        } else {
            self.band_totals().entries.iter().sum()
        }
    }

    fn band_totals(&self) -> BandTotals {
        let mut totals = BandTotals { splats: [0; BANDS], entries: [0; BANDS] };
        for counts in self.counts.iter().filter(|c| c.visible > 0) {
            totals.splats.iter_mut().zip(counts.splats).for_each(|(total, count)| *total += count as usize);
            totals.entries.iter_mut().zip(counts.tiles).for_each(|(total, count)| *total += count as usize);
        }
        totals
    }

    /// Fills the lists of the tiles from the boxes and keys of the splats, which must have been counted unless `isa` is
    /// scalar.
    ///
    /// Errors: more than 2^30 entries, or more than this machine has memory left for.
    pub fn fill(&mut self, isa: Isa, tiling: Tiling, all: &Boxes<'_>) -> Result<()> {
        let entries = self.entries_of(isa, all);
        let items = if isa == Isa::Scalar { all.boxes.len() } else { self.band_totals().splats.iter().sum() };
        if entries.max(items) > MOST_ENTRIES {
            let sentence = format!("the Gaussians meet {entries} tiles together, and {MOST_ENTRIES} is the most");
            return Err(Error::input(sentence));
        }
        let more = |wanted: usize, there: usize, bytes: f64| wanted.saturating_sub(there) as f64 * bytes;
        let new_bytes =
            more(entries, self.entries.capacity(), ENTRY_BYTES) + more(items, self.items.capacity(), ITEM_BYTES);
        demand_memory(format_args!("the lists of the tiles with {entries} entries"), new_bytes)?;
        self.tiling = tiling;
        self.masks_known = false;
        if isa == Isa::Scalar {
            let TileLists { starts, offsets, entries, targets } = TileLists::of(&tiling, all);
            (self.starts, self.offsets, self.entries, self.targets) = (starts, offsets, entries, targets);
            grow(&mut self.masks, self.entries.len());
        } else {
            self.fill_bands(all);
        }
        Ok(())
    }

    fn fill_bands(&mut self, all: &Boxes<'_>) {
        let tiling = self.tiling;
        let (shift, columns) = (shift_of(&tiling), tiling.columns);
        let (height, bands) = (1 << shift, tiling.rows.div_ceil(1 << shift));
        let BandTotals { splats, entries } = self.band_totals();
        let (splats, entries) = (&splats[..bands], &entries[..bands]);
        let (all_splats, all_entries) = (splats.iter().sum(), entries.iter().sum());
        self.make_room(all_entries);
        grow(&mut self.items, all_splats);
        grow(&mut self.scratch, 4 * all_splats);
        let pieces = self.distribute(all, shift, bands);
        let all = BinItems { items: &self.items, boxes: all.boxes, starts: &self.starts, tiles_x: columns as u32 };
        let mut first = 0;
        let tasks: Vec<Band<'_>> = cut(&mut self.scratch, splats.iter().map(|s| 4 * s))
            .into_iter()
            .zip(cut(&mut self.entries, entries.iter().copied()))
            .zip(cut(&mut self.targets, entries.iter().copied()))
            .zip(self.offsets[..tiling.count()].chunks_mut(height * columns))
            .zip(pieces)
            .enumerate()
            .map(|(b, ((((scratch, entries), targets), offsets), pieces))| {
                let (row_begin, row_end) = ((b * height) as u32, ((b + 1) * height).min(tiling.rows) as u32);
                let band = Band { pieces, row_begin, row_end, first, scratch, offsets, entries, targets };
                first += band.entries.len() as u32;
                band
            })
            .collect();
        longest_first(tasks).into_par_iter().with_max_len(PIECE).for_each(|band| native::fill(&all, band));
    }

    fn make_room(&mut self, entries: usize) {
        let tiles = self.tiling.count();
        grow(&mut self.entries, entries);
        grow(&mut self.targets, entries);
        grow(&mut self.masks, entries);
        self.offsets.resize(tiles + 1, 0);
        self.offsets[tiles] = entries as u32;
    }

    /// Puts every visible splat into the list of its chunk for each of its bands, in the order of the splats; returns
    /// where the pieces of each band lie.
    fn distribute(&mut self, all: &Boxes<'_>, shift: u32, bands: usize) -> Vec<Vec<ItemRange>> {
        let sum = |counts: &[u32; BANDS]| counts.iter().map(|count| *count as usize).sum::<usize>();
        // `fill` has refused more entries or items than `MOST_ENTRIES`.
        let number = |at: usize| u32::try_from(at).expect("as many entries or items as `fill` allows");
        let mut pieces = vec![Vec::with_capacity(self.counts.len()); bands];
        let (mut place, mut base, mut bases) = (0, 0, Vec::with_capacity(self.counts.len()));
        for counts in &self.counts {
            bases.push(number(base));
            if counts.visible == 0 {
                continue;
            }
            base += sum(&counts.tiles);
            for (pieces, &count) in pieces.iter_mut().zip(&counts.splats) {
                let begin = place;
                place += count as usize;
                pieces.push(ItemRange { begin: number(begin), end: number(place) });
            }
        }
        let (counts, starts) = (&self.counts, &mut self.starts[1..]);
        let items = cut(&mut self.items, counts.iter().map(|c| sum(&c.splats)));
        let piece = piece_of(counts.len());
        let chunks = items.into_par_iter().zip(starts.par_chunks_mut(CHUNK)).enumerate().with_max_len(piece);
        chunks.for_each(|(c, (items, starts))| {
            let to = Distribution { first: (c * CHUNK) as u32, base: bases[c], starts, items };
            native::distribute(&chunk_of(all, c), shift, &counts[c], to);
        });
        pieces
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::{CounterRng, Stage};
    use crate::splat::plain::bins::TileBox;

    /// Random boxes, depths with many ties, chunks without visible splats: the same tables as the plain twin, every
    /// slot once.
    #[test]
    fn vectorised_and_plain_agree() {
        for (seed, n, tiles) in
            [(1, 0, [1, 1]), (2, 1, [3, 2]), (3, 5000, [16, 16]), (4, 9000, [25, 37]), (5, 700, [1, 40])]
        {
            let tiling = Tiling { columns: tiles[0], rows: tiles[1] };
            let mut rng = CounterRng::new(seed, Stage::Test, &[n as u64]);
            let mut below = |bound: usize| (rng.uniform() * bound as f64) as usize;
            let (mut boxes, mut visible, mut keys) = (Vec::new(), Vec::new(), Vec::new());
            for j in 0..n {
                let (x0, y0) = (below(tiles[0]), below(tiles[1]));
                let (x1, y1) = ((x0 + below(4)).min(tiles[0] - 1), (y0 + below(9)).min(tiles[1] - 1));
                boxes.push(TileBox { x0, y0, x1, y1 }.pack());
                visible.push(below(3) > 0 && !(2048..4096).contains(&j));
                keys.push((0.2 + 0.01 * below(700) as f32).to_bits());
            }
            let all = Boxes { boxes: &boxes, visible: &visible, keys: &keys };
            let (mut fast, mut plain) = (Bins::default(), Bins::default());
            for _ in 0..2 {
                let Counting { shift, starts, counts } = fast.counting(&tiling, n);
                for (c, (starts, counts)) in starts.chunks_mut(CHUNK).zip(counts).enumerate() {
                    native::count(&chunk_of(&all, c), shift, starts, counts);
                }
                fast.fill(Isa::Baseline, tiling, &all).unwrap();
            }
            plain.fill(Isa::Scalar, tiling, &all).unwrap();
            assert_eq!(fast.entries_of(Isa::Baseline, &all), fast.entries.len());
            assert_eq!(plain.entries_of(Isa::Scalar, &all), fast.entries.len());
            assert_eq!(fast.offsets, plain.offsets);
            assert_eq!(fast.entries, plain.entries);
            assert_eq!(fast.targets, plain.targets);
            // In a chunk without visible splats only the last number is defined.
            let chunks = fast.starts[1..].chunks(CHUNK).zip(plain.starts[1..].chunks(CHUNK)).zip(visible.chunks(CHUNK));
            for ((fast, plain), visible) in chunks {
                assert!(fast == plain || (!visible.contains(&true) && fast.last() == plain.last()));
            }
            assert_eq!(fast.starts[0], 0);
            assert_eq!(fast.visible_count(), visible.iter().filter(|visible| **visible).count());
            let mut slots = fast.targets.clone();
            slots.sort_unstable();
            assert!(slots.iter().copied().eq(0..slots.len() as u32));
        }
    }
}
