//! From splats to the list of each 16x16 tile: one stable radix sort by depth, then a stable counting sort by tile.
//! Depth ties keep the order of the Gaussians. Bands of tile rows are filled in parallel; what is filled does not
//! depend on their number.

use std::sync::atomic::{AtomicU32, Ordering};

use rayon::prelude::*;

use super::project::{Row, at};
use super::real::Real;

/// Side of a tile in pixels.
pub(super) const TILE: usize = 16;

/// Tiles that a splat's bounding box meets, inclusive.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct TileBox {
    pub x0: u16,
    pub y0: u16,
    pub x1: u16,
    pub y1: u16,
}

impl TileBox {
    pub fn of<T: Real>(row: &Row<T>, tiles_x: usize, tiles_y: usize) -> Self {
        let cell = |v: T, n: usize| (v.to_f64() * (1.0 / TILE as f64)).floor().clamp(0.0, n as f64 - 1.0) as u16;
        TileBox {
            x0: cell(row[at::X] - row[at::HALF_WIDTH], tiles_x),
            y0: cell(row[at::Y] - row[at::HALF_HEIGHT], tiles_y),
            x1: cell(row[at::X] + row[at::HALF_WIDTH], tiles_x),
            y1: cell(row[at::Y] + row[at::HALF_HEIGHT], tiles_y),
        }
    }

    pub fn count(&self) -> u32 {
        (self.x1 - self.x0 + 1) as u32 * (self.y1 - self.y0 + 1) as u32
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
    /// Entries of splat `j`, row by row of its box: `places[first[j]..first[j] + boxes[j].count()]`.
    pub first: Vec<u32>,
    pub places: Vec<AtomicU32>,
    order: Vec<Keyed>,
    spare: Vec<Keyed>,
    boxes: Vec<TileBox>,
    cursors: Vec<u32>,
}

#[derive(Clone, Copy, Debug, Default)]
struct Keyed {
    depth: u32,
    splat: u32,
}

/// Stable ascending sort by `depth`: three passes of 11 bits.
fn radix_sort(items: &mut Vec<Keyed>, spare: &mut Vec<Keyed>) {
    let mut counts = vec![0u32; 3 * 2048];
    for item in items.iter() {
        for pass in 0..3 {
            counts[pass * 2048 + ((item.depth >> (11 * pass)) & 2047) as usize] += 1;
        }
    }
    spare.resize(items.len(), Keyed::default());
    for pass in 0..3 {
        let counts = &mut counts[pass * 2048..(pass + 1) * 2048];
        let mut sum = 0;
        for count in counts.iter_mut() {
            sum += std::mem::replace(count, sum);
        }
        for item in items.iter() {
            let slot = &mut counts[((item.depth >> (11 * pass)) & 2047) as usize];
            spare[*slot as usize] = *item;
            *slot += 1;
        }
        std::mem::swap(items, spare);
    }
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

impl Bins {
    /// Fills the lists from `rows` (of which those with `boxes[j]` set are visible).
    pub fn fill<T: Real, R: AsRef<Row<T>>>(&mut self, tiles: [usize; 2], rows: &[R], boxes: &[Option<TileBox>]) {
        let [tiles_x, tiles_y] = tiles;
        (self.tiles_x, self.tiles_y) = (tiles_x, tiles_y);
        self.order.clear();
        self.boxes.clear();
        self.first.clear();
        let mut total = 0;
        for (j, found) in boxes.iter().enumerate() {
            self.first.push(total);
            self.boxes.push(found.unwrap_or_default());
            if let Some(found) = found {
                // Positive floats sort like their bits; every number type sorts by depth rounded to f32.
                let depth = (rows[j].as_ref()[at::DEPTH].to_f64() as f32).to_bits();
                self.order.push(Keyed { depth, splat: j as u32 });
                total += found.count();
            }
        }
        radix_sort(&mut self.order, &mut self.spare);
        if self.places.len() < total as usize {
            self.places.resize_with(total as usize, AtomicU32::default);
        }
        self.entries.resize(total as usize, 0);
        self.masks.resize(total as usize, 0);
        self.count();
        self.place();
    }

    fn bands(&self) -> Vec<(usize, usize)> {
        let bands = rayon::current_num_threads().clamp(1, self.tiles_y);
        (0..bands).map(|b| (self.tiles_y * b / bands, self.tiles_y * (b + 1) / bands)).collect()
    }

    fn count(&mut self) {
        let (tiles_x, tiles_y) = (self.tiles_x, self.tiles_y);
        self.cursors.clear();
        self.cursors.resize(tiles_x * tiles_y, 0);
        let bands = self.bands();
        let pieces = cut(&mut self.cursors, bands.iter().map(|(lo, hi)| (hi - lo) * tiles_x));
        let (order, boxes) = (&self.order, &self.boxes);
        bands.par_iter().zip(pieces).for_each(|(&(lo, hi), counts)| {
            for item in order {
                let b = boxes[item.splat as usize];
                for y in (b.y0 as usize).max(lo)..(b.y1 as usize + 1).min(hi) {
                    let row = (y - lo) * tiles_x;
                    for count in &mut counts[row + b.x0 as usize..=row + b.x1 as usize] {
                        *count += 1;
                    }
                }
            }
        });
        self.offsets.clear();
        let mut sum = 0;
        for cursor in &mut self.cursors {
            self.offsets.push(sum);
            sum += std::mem::replace(cursor, sum);
        }
        self.offsets.push(sum);
    }

    fn place(&mut self) {
        let tiles_x = self.tiles_x;
        let bands = self.bands();
        let cursors = cut(&mut self.cursors, bands.iter().map(|(lo, hi)| (hi - lo) * tiles_x));
        let offsets = &self.offsets;
        let size = |&(lo, hi): &(usize, usize)| (offsets[hi * tiles_x] - offsets[lo * tiles_x]) as usize;
        let entries = cut(&mut self.entries, bands.iter().map(size));
        let (order, boxes, first, places) = (&self.order, &self.boxes, &self.first, &self.places);
        bands.par_iter().zip(cursors).zip(entries).for_each(|((&(lo, hi), cursors), entries)| {
            let start = offsets[lo * tiles_x];
            for item in order {
                let j = item.splat as usize;
                let b = boxes[j];
                let width = (b.x1 - b.x0 + 1) as u32;
                for y in (b.y0 as usize).max(lo)..(b.y1 as usize + 1).min(hi) {
                    let place = first[j] + (y as u32 - b.y0 as u32) * width;
                    let row = (y - lo) * tiles_x;
                    let cells = &mut cursors[row + b.x0 as usize..=row + b.x1 as usize];
                    for (cursor, place) in cells.iter_mut().zip(place..) {
                        entries[(*cursor - start) as usize] = item.splat;
                        places[place as usize].store(*cursor, Ordering::Relaxed);
                        *cursor += 1;
                    }
                }
            }
        });
    }

    /// Entries of splat `j` in a fixed order.
    pub fn entries_of(&self, j: usize) -> impl Iterator<Item = usize> {
        let start = self.first[j] as usize;
        let places = &self.places[start..start + self.boxes[j].count() as usize];
        places.iter().map(|place| place.load(Ordering::Relaxed) as usize)
    }
}
