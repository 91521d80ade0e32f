//! From splats to the list of each 16x16 tile: splats are dealt to bands of tile rows, each band is sorted by depth
//! (stable radix sort) and counted out to its tiles. Depth ties keep the order of the Gaussians. Bands are independent
//! tasks; how many there are depends on the image alone, so what is filled does not depend on the threads.

use std::sync::atomic::{AtomicU32, Ordering};

use rayon::prelude::*;

use crate::ffi::splat::{Aligned, words};

use super::project::{Row, at};
use super::real::Real;

/// Side of a tile in pixels.
pub(super) const TILE: usize = 16;

/// Splats per task of the dealing.
const CHUNK: usize = 2048;

/// Most bands of an image.
const BANDS: usize = 16;

/// Tiles that a splat's bounding box meets, inclusive: `x0 | y0 << 16`, `x1 | y1 << 16`.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct TileBox {
    pub x0: usize,
    pub y0: usize,
    pub x1: usize,
    pub y1: usize,
}

impl TileBox {
    pub fn of<T: Real>(row: &Row<T>, tiles: [usize; 2]) -> Self {
        let cell = |v: T, n: usize| (v.to_f64() * (1.0 / TILE as f64)).clamp(0.0, n as f64 - 1.0) as usize;
        TileBox {
            x0: cell(row[at::X] - row[at::HALF_WIDTH], tiles[0]),
            y0: cell(row[at::Y] - row[at::HALF_HEIGHT], tiles[1]),
            x1: cell(row[at::X] + row[at::HALF_WIDTH], tiles[0]),
            y1: cell(row[at::Y] + row[at::HALF_HEIGHT], tiles[1]),
        }
    }

    #[inline(always)]
    pub fn unpack([low, high]: [u32; 2]) -> Self {
        let part = |v: u32| (v & 0xffff) as usize;
        TileBox { x0: part(low), y0: part(low >> 16), x1: part(high), y1: part(high >> 16) }
    }

    pub fn pack(&self) -> [u32; 2] {
        [self.x0 as u32 | (self.y0 as u32) << 16, self.x1 as u32 | (self.y1 as u32) << 16]
    }

    #[inline(always)]
    fn width(&self) -> usize {
        self.x1 - self.x0 + 1
    }

    /// Tile rows from `low` to before `high` that the box meets.
    #[inline(always)]
    fn rows_within(&self, low: usize, high: usize) -> std::ops::Range<usize> {
        self.y0.max(low)..(self.y1 + 1).min(high)
    }
}

/// The lists of all tiles.
#[derive(Debug, Default)]
pub(super) struct Bins {
    pub tiles_x: usize,
    pub tiles_y: usize,
    /// Entries of tile `t` are `offsets[t]..offsets[t + 1]`.
    pub offsets: Vec<u32>,
    /// Splat of each entry, front to back within a tile.
    pub entries: Vec<u32>,
    /// Sub-blocks of each entry that the forward pass looked at.
    pub masks: Vec<u16>,
    /// Entries of splat `j`, row by row of its box: `places[starts[j]..starts[j + 1]]`; none when it is not visible.
    pub starts: Vec<u32>,
    places: Vec<AtomicU32>,
    items: Vec<Keyed>,
    spare: Vec<Keyed>,
    counts: Vec<Counts>,
}

#[derive(Clone, Copy, Debug, Default)]
struct Keyed {
    depth: u32,
    splat: u32,
}

/// What a chunk of splats has for each band: splats and entries.
#[derive(Clone, Debug, Default)]
struct Counts {
    splats: [u32; BANDS],
    entries: [u32; BANDS],
}

/// Stable ascending sort of `items` by depth, 11 bits at a time; passes over bits that are all the same are left out.
fn radix_sort<'a>(mut items: &'a mut [Keyed], mut spare: &'a mut [Keyed]) -> &'a [Keyed] {
    let mut counts = [[0u32; 2048]; 3];
    let digit = |item: &Keyed, pass: usize| ((item.depth >> (11 * pass)) & 2047) as usize;
    for item in items.iter() {
        for (pass, counts) in counts.iter_mut().enumerate() {
            counts[digit(item, pass)] += 1;
        }
    }
    let Some(first) = items.first().copied() else { return items };
    for (pass, counts) in counts.iter_mut().enumerate() {
        if counts[digit(&first, pass)] as usize == items.len() {
            continue;
        }
        let mut sum = 0;
        for count in counts.iter_mut() {
            sum += std::mem::replace(count, sum);
        }
        for item in items.iter() {
            let slot = &mut counts[digit(item, pass)];
            spare[*slot as usize] = *item;
            *slot += 1;
        }
        std::mem::swap(&mut items, &mut spare);
    }
    items
}

/// Cuts `slice` into pieces of the given lengths.
pub(super) fn cut<V>(mut slice: &mut [V], lengths: impl Iterator<Item = usize>) -> Vec<&mut [V]> {
    lengths
        .map(|length| {
            let (head, tail) = std::mem::take(&mut slice).split_at_mut(length);
            slice = tail;
            head
        })
        .collect()
}

/// One band: which tile rows, and where its part of the tables lies.
struct Band<'a> {
    rows: std::ops::Range<usize>,
    items: &'a mut [Keyed],
    spare: &'a mut [Keyed],
    offsets: &'a mut [u32],
    entries: &'a mut [u32],
    /// Number of the band's first entry.
    first: u32,
}

impl Bins {
    /// Fills the lists from `rows` and `boxes` of the splats that are `visible`.
    pub fn fill<T: Real>(&mut self, tiles: [usize; 2], rows: &[Aligned<T>], boxes: &[[u32; 2]], visible: &[bool]) {
        [self.tiles_x, self.tiles_y] = tiles;
        let height = tiles[1].div_ceil(BANDS).max(2);
        let bands = tiles[1].div_ceil(height);
        self.count(height, boxes, visible);
        let total = |of: fn(&Counts) -> &[u32; BANDS], b: usize| self.counts.iter().map(|c| of(c)[b] as usize).sum();
        let splats: Vec<usize> = (0..bands).map(|b| total(|c| &c.splats, b)).collect();
        let entries: Vec<usize> = (0..bands).map(|b| total(|c| &c.entries, b)).collect();
        let all_entries: usize = entries.iter().sum();
        self.items.resize(splats.iter().sum(), Keyed::default());
        self.spare.resize(self.items.len(), Keyed::default());
        self.entries.resize(all_entries, 0);
        self.masks.resize(all_entries, 0);
        if self.places.len() < all_entries {
            self.places.resize_with(all_entries, AtomicU32::default);
        }
        self.deal(height, bands, rows, boxes, visible);
        self.offsets.resize(tiles[0] * tiles[1] + 1, 0);
        self.offsets[tiles[0] * tiles[1]] = all_entries as u32;
        let (starts, places) = (&self.starts, &self.places);
        let mut first = 0;
        let tasks: Vec<Band<'_>> = cut(&mut self.items, splats.iter().copied())
            .into_iter()
            .zip(cut(&mut self.spare, splats.iter().copied()))
            .zip(cut(&mut self.entries, entries.iter().copied()))
            .zip(self.offsets[..tiles[0] * tiles[1]].chunks_mut(height * tiles[0]))
            .enumerate()
            .map(|(b, (((items, spare), entries), offsets))| {
                let rows = b * height..((b + 1) * height).min(tiles[1]);
                let band = Band { rows, items, spare, offsets, first, entries };
                first += band.entries.len() as u32;
                band
            })
            .collect();
        tasks.into_par_iter().for_each(|band| band.fill(tiles[0], boxes, starts, places));
    }

    fn count(&mut self, height: usize, boxes: &[[u32; 2]], visible: &[bool]) {
        self.starts.resize(boxes.len() + 1, 0);
        self.counts.resize(boxes.len().div_ceil(CHUNK), Counts::default());
        let tasks = self.starts[1..].par_chunks_mut(CHUNK).zip(boxes.par_chunks(CHUNK)).zip(visible.par_chunks(CHUNK));
        tasks.zip(&mut self.counts).for_each(|(((starts, boxes), visible), counts)| {
            *counts = Counts::default();
            let mut sum = 0;
            for ((start, &packed), &seen) in starts.iter_mut().zip(boxes).zip(visible) {
                if seen {
                    let b = TileBox::unpack(packed);
                    let width = b.width() as u32;
                    for band in b.y0 / height..=b.y1 / height {
                        let rows = b.rows_within(band * height, (band + 1) * height).len() as u32;
                        counts.splats[band] += 1;
                        counts.entries[band] += rows * width;
                        sum += rows * width;
                    }
                }
                // Within the chunk; those before are added in `deal`.
                *start = sum;
            }
        });
    }

    /// Puts every visible splat into the lists of its bands, in the order of the splats.
    fn deal<T: Real>(
        &mut self,
        height: usize,
        bands: usize,
        rows: &[Aligned<T>],
        boxes: &[[u32; 2]],
        visible: &[bool],
    ) {
        let chunks = self.counts.len();
        let counts = &self.counts;
        let lengths = (0..bands).flat_map(|b| (0..chunks).map(move |c| counts[c].splats[b] as usize));
        let mut pieces: Vec<Vec<&mut [Keyed]>> = (0..chunks).map(|_| Vec::with_capacity(bands)).collect();
        for (k, piece) in cut(&mut self.items, lengths).into_iter().enumerate() {
            pieces[k % chunks].push(piece);
        }
        let mut before = 0;
        let bases: Vec<u32> = counts
            .iter()
            .map(|c| {
                let base = before;
                before += c.entries.iter().sum::<u32>();
                base
            })
            .collect();
        pieces.into_par_iter().zip(self.starts[1..].par_chunks_mut(CHUNK)).enumerate().for_each(
            |(c, (mut pieces, starts))| {
                let mut cursors = [0; BANDS];
                for (k, start) in starts.iter_mut().enumerate() {
                    let j = c * CHUNK + k;
                    *start += bases[c];
                    if !visible[j] {
                        continue;
                    }
                    let b = TileBox::unpack(boxes[j]);
                    // Positive floats sort like their bits; every number type sorts by depth rounded to f32.
                    let depth = (rows[j].0[at::DEPTH].to_f64() as f32).to_bits();
                    for band in b.y0 / height..=b.y1 / height {
                        pieces[band][cursors[band]] = Keyed { depth, splat: j as u32 };
                        cursors[band] += 1;
                    }
                }
            },
        );
    }

    /// Entry numbers of all splats; see `starts`.
    pub fn places(&mut self) -> (&[u32], &[u32]) {
        (&self.starts, words(&mut self.places))
    }
}

impl Band<'_> {
    fn fill(self, tiles_x: usize, boxes: &[[u32; 2]], starts: &[u32], places: &[AtomicU32]) {
        let (low, high) = (self.rows.start, self.rows.end);
        let mut cursors = vec![0u32; self.offsets.len()];
        for item in self.items.iter() {
            let b = TileBox::unpack(boxes[item.splat as usize]);
            for y in b.rows_within(low, high) {
                let row = (y - low) * tiles_x;
                for cursor in &mut cursors[row + b.x0..=row + b.x1] {
                    *cursor += 1;
                }
            }
        }
        let mut sum = 0;
        for (cursor, offset) in cursors.iter_mut().zip(self.offsets) {
            *offset = self.first + sum;
            sum += std::mem::replace(cursor, sum);
        }
        for item in radix_sort(self.items, self.spare) {
            let j = item.splat as usize;
            let b = TileBox::unpack(boxes[j]);
            for y in b.rows_within(low, high) {
                let row = (y - low) * tiles_x;
                let start = starts[j] as usize + (y - b.y0) * b.width();
                let cells = &mut cursors[row + b.x0..=row + b.x1];
                for (cursor, place) in cells.iter_mut().zip(&places[start..]) {
                    self.entries[*cursor as usize] = item.splat;
                    place.store(self.first + *cursor, Ordering::Relaxed);
                    *cursor += 1;
                }
            }
        }
    }
}
