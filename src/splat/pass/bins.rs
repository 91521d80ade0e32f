//! From splats to the list of each tile: splats are dealt to bands of tile rows, each band is sorted by depth
//! (stable radix sort) and counted out to its tiles. Depth ties keep the order of the Gaussians. Bands are independent
//! tasks; how many there are depends on the image alone, so what is filled does not depend on the threads.
//! The work on a chunk or a band is C++ (`cpp/splat/bin.cpp`); the plain twin is [`Bins::fill_plainly`].
//!
//! Every entry has a slot for its moments. Slots lie splat by splat, so that the chain reads them one after the other;
//! it is the tiles that write them here and there, for which nobody waits.

use rayon::prelude::*;

use crate::ffi::splat::bin::{self as native, BANDS, Band, Boxes, Counts};
use crate::ffi::system::grow;

use crate::splat::number::real::Real;
use crate::splat::pass::pool::{PIECE, piece_of};
use crate::splat::pass::rasterizer::CHUNK;
use crate::splat::plain::project::{Row, at};
use crate::splat::types::tiling::{TILE_SIDE, Tiling};

/// Tiles in whose lists a splat is, inclusive; packed: `x0 | y0 << 16`, `x1 | y1 << 16`.
#[derive(Clone, Copy, Debug, Default)]
pub(in crate::splat) struct TileBox {
    pub x0: usize,
    pub y0: usize,
    pub x1: usize,
    pub y1: usize,
}

impl TileBox {
    /// Tiles of the pixel centres within the splat's half width and height, and a slack against rounding (that of the masks
    /// of blocks, `kernel.rs`). Where there are none, the tile of its left or upper end.
    pub fn of<T: Real>(row: &Row<T>, tiling: &Tiling) -> Self {
        let slack = T::of(1e-3) + T::of(1e-5) * (row[at::HALF_WIDTH] + row[at::HALF_HEIGHT]);
        Self::around(row, tiling, T::of(0.5) - slack)
    }

    /// Tiles that the splat's bounding box meets when it is made smaller by `less` pixels on every side.
    pub fn around<T: Real>(row: &Row<T>, tiling: &Tiling, less: T) -> Self {
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

    /// How many.
    pub fn count(&self) -> usize {
        (self.x1 - self.x0 + 1) * (self.y1 - self.y0 + 1)
    }
}

/// The lists of all tiles.
#[derive(Debug, Default)]
pub(in crate::splat) struct Bins {
    pub tiling: Tiling,
    /// Entries of tile `t` are `offsets[t]..offsets[t + 1]`.
    pub offsets: Vec<u32>,
    /// Splat of each entry, front to back within a tile.
    pub entries: Vec<u32>,
    /// Slot of each entry: a number of its own.
    pub targets: Vec<u32>,
    /// Sub-blocks of each entry that the forward pass looked at.
    pub masks: Vec<u16>,
    /// Whether a forward pass of the present splats has written them.
    pub masks_known: bool,
    /// Slots of splat `j`, row by row of its box: `starts[j]..starts[j + 1]`; none when it is not visible. In a chunk that
    /// nobody sees only the last number means anything.
    pub starts: Vec<u32>,
    items: Vec<u64>,
    scratch: Vec<u64>,
    counts: Vec<Counts>,
}

/// Where chunks of splats are counted.
pub(in crate::splat) struct Counting<'a> {
    /// Tile rows of a band, as a power of 2.
    pub shift: u32,
    /// Tiles of the splats of the chunk up to and with each.
    pub starts: &'a mut [u32],
    /// One per chunk.
    pub counts: &'a mut [Counts],
}

/// Cuts `slice` into pieces of the given lengths.
pub(in crate::splat) fn cut<V>(mut slice: &mut [V], lengths: impl Iterator<Item = usize>) -> Vec<&mut [V]> {
    lengths
        .map(|length| {
            let (head, tail) = std::mem::take(&mut slice).split_at_mut(length);
            slice = tail;
            head
        })
        .collect()
}

/// As few bands as the threads of a large machine can use: 2 to this power tile rows each.
fn shift_of(tiling: &Tiling) -> u32 {
    (1..).find(|s| tiling.rows.div_ceil(1 << s) <= BANDS).expect("an image has a finite number of tile rows")
}

/// Bands in an order that ends with small ones in either half: threads take halves, and what comes last decides how long
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

    /// Counts all chunks.
    pub fn count(&mut self, tiling: &Tiling, all: &Boxes<'_>) {
        let Counting { shift, starts, counts } = self.counting(tiling, all.boxes.len());
        let piece = piece_of(counts.len());
        let chunks = starts.par_chunks_mut(CHUNK).zip(counts).enumerate().with_max_len(piece);
        chunks.for_each(|(c, (starts, counts))| native::count(&chunk_of(all, c), shift, starts, counts));
    }

    /// Visible splats that were counted.
    pub fn seen(&self) -> usize {
        self.counts.iter().map(|c| c.seen as usize).sum()
    }

    /// Fills the lists of the tiles from the boxes and keys of the splats, which have been counted.
    pub fn fill(&mut self, tiling: Tiling, all: &Boxes<'_>) {
        self.tiling = tiling;
        let (shift, columns) = (shift_of(&tiling), tiling.columns);
        let (height, bands) = (1 << shift, tiling.rows.div_ceil(1 << shift));
        let mut totals = [[0usize; BANDS]; 2];
        for counts in self.counts.iter().filter(|c| c.seen > 0) {
            for (total, count) in totals.as_flattened_mut().iter_mut().zip(counts.bands.as_flattened()) {
                *total += *count as usize;
            }
        }
        let [splats, entries] = totals.each_ref().map(|kind| &kind[..bands]);
        let (all_splats, all_entries) = (splats.iter().sum(), entries.iter().sum());
        self.make_room(all_entries);
        grow(&mut self.items, all_splats);
        grow(&mut self.scratch, 4 * all_splats);
        let pieces = self.deal(all, shift, bands);
        let (items, starts) = (&self.items, &self.starts);
        let mut first = 0;
        let tasks: Vec<Band<'_>> = cut(&mut self.scratch, splats.iter().map(|s| 4 * s))
            .into_iter()
            .zip(cut(&mut self.entries, entries.iter().copied()))
            .zip(cut(&mut self.targets, entries.iter().copied()))
            .zip(self.offsets[..tiling.count()].chunks_mut(height * columns))
            .zip(pieces)
            .enumerate()
            .map(|(b, ((((scratch, entries), targets), offsets), pieces))| {
                let rows = b * height..((b + 1) * height).min(tiling.rows);
                let band = Band { pieces, rows, first, scratch, offsets, entries, targets };
                first += band.entries.len() as u32;
                band
            })
            .collect();
        longest_first(tasks)
            .into_par_iter()
            .with_max_len(PIECE)
            .for_each(|band| native::fill(band, items, all.boxes, starts, columns));
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
    fn deal(&mut self, all: &Boxes<'_>, shift: u32, bands: usize) -> Vec<Vec<[u32; 2]>> {
        let sum = |counts: &[u32; BANDS]| counts.iter().sum::<u32>();
        let mut pieces = vec![Vec::with_capacity(self.counts.len()); bands];
        let (mut place, mut base, mut bases) = (0, 0, Vec::with_capacity(self.counts.len()));
        for counts in &self.counts {
            bases.push(base);
            if counts.seen == 0 {
                continue;
            }
            base += sum(&counts.bands[1]);
            for (pieces, &count) in pieces.iter_mut().zip(&counts.bands[0]) {
                pieces.push([place, place + count]);
                place += count;
            }
        }
        let (counts, starts) = (&self.counts, &mut self.starts[1..]);
        let items = cut(&mut self.items, counts.iter().map(|c| sum(&c.bands[0]) as usize));
        let piece = piece_of(counts.len());
        let chunks = items.into_par_iter().zip(starts.par_chunks_mut(CHUNK)).enumerate().with_max_len(piece);
        chunks.for_each(|(c, (items, starts))| {
            native::deal(&chunk_of(all, c), c * CHUNK, shift, bases[c], starts, &counts[c], items);
        });
        pieces
    }

    /// The plain twin of [`Bins::fill`].
    pub fn fill_plainly(&mut self, tiling: Tiling, all: &Boxes<'_>) {
        self.tiling = tiling;
        let n = all.boxes.len();
        let boxes: Vec<TileBox> = all.boxes.iter().map(|&b| TileBox::unpack(b)).collect();
        let mut order: Vec<u32> = (0..n as u32).filter(|&j| all.visible[j as usize]).collect();
        order.sort_by_key(|&j| (all.keys[j as usize], j));
        self.starts.clear();
        self.starts.push(0);
        let mut sum = 0;
        for (b, &seen) in boxes.iter().zip(all.visible) {
            sum += if seen { b.count() as u32 } else { 0 };
            self.starts.push(sum);
        }
        self.make_room(sum as usize);
        let mut lists = vec![Vec::new(); tiling.count()];
        for &j in &order {
            let b = boxes[j as usize];
            let cells = (b.y0..=b.y1).flat_map(|y| (b.x0..=b.x1).map(move |x| y * tiling.columns + x));
            for (cell, slot) in cells.zip(self.starts[j as usize]..) {
                lists[cell].push((j, slot));
            }
        }
        let mut entry = 0;
        for (offset, list) in self.offsets.iter_mut().zip(lists) {
            *offset = entry as u32;
            for (splat, slot) in list {
                (self.entries[entry], self.targets[entry]) = (splat, slot);
                entry += 1;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::{CounterRng, Stage};

    /// Random boxes, depths with many ties, chunks that nobody sees: the same tables as the plain twin, every slot once.
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
                fast.count(&tiling, &all);
                fast.fill(tiling, &all);
            }
            plain.fill_plainly(tiling, &all);
            assert_eq!(fast.offsets, plain.offsets);
            assert_eq!(fast.entries, plain.entries);
            assert_eq!(fast.targets, plain.targets);
            // In a chunk that nobody sees only the last number means anything.
            let chunks = fast.starts[1..].chunks(CHUNK).zip(plain.starts[1..].chunks(CHUNK)).zip(visible.chunks(CHUNK));
            for ((fast, plain), visible) in chunks {
                assert!(fast == plain || (!visible.contains(&true) && fast.last() == plain.last()));
            }
            assert_eq!(fast.starts[0], 0);
            assert_eq!(fast.seen(), visible.iter().filter(|seen| **seen).count());
            let mut slots = fast.targets.clone();
            slots.sort_unstable();
            assert!(slots.iter().copied().eq(0..slots.len() as u32));
        }
    }
}
