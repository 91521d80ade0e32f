//! Connected parts of a mask, holes in it, and growing and shrinking it.

use super::distance::signed_distance;
use crate::base::Volume;

/// Which voxels count as neighbours.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum VoxelContact {
    /// Those that share a face.
    Faces,
    /// Those that share a face, an edge or a corner.
    Corners,
}

impl VoxelContact {
    fn steps(self) -> Vec<[i32; 3]> {
        let all = (-1..=1).flat_map(|k| (-1..=1).flat_map(move |j| (-1..=1).map(move |i| [i, j, k])));
        let faces = |step: &[i32; 3]| step.iter().map(|s| s.abs()).sum::<i32>();
        all.filter(|step| match self {
            VoxelContact::Faces => faces(step) == 1,
            VoxelContact::Corners => faces(step) > 0,
        })
        .collect()
    }
}

/// The voxels that can be reached from `seeds` through voxels that `is_open` takes; it is asked about each at most a
/// few times.
pub fn reached<T: Copy>(
    volume: &Volume<T>,
    seeds: &[usize],
    neighbourhood: VoxelContact,
    is_open: impl Fn(T) -> bool,
) -> Volume<u8> {
    let mut found = Volume::filled(volume.grid, 0u8);
    spread(volume, &mut found, seeds.to_vec(), neighbourhood, is_open);
    found
}

/// Adds to `found` what can be reached from `open`; gives the number of new voxels and those at which it ended: reached
/// neighbours that are not open.
pub fn spread<T: Copy>(
    volume: &Volume<T>,
    found: &mut Volume<u8>,
    mut open: Vec<usize>,
    neighbourhood: VoxelContact,
    is_open: impl Fn(T) -> bool,
) -> (usize, Vec<usize>) {
    let steps = neighbourhood.steps();
    let size = volume.grid.size;
    let (mut count, mut rim) = (0, Vec::new());
    open.retain(|&at| {
        let takes = found.data[at] == 0 && is_open(volume.data[at]);
        if takes {
            found.data[at] = 1;
            count += 1;
        } else if found.data[at] == 0 {
            rim.push(at);
        }
        takes
    });
    while let Some(at) = open.pop() {
        let cell = volume.grid.cell(at);
        for step in &steps {
            let Some(next) = beside(cell, *step, size) else { continue };
            let next = volume.grid.at(next);
            if found.data[next] != 0 {
                continue;
            }
            if is_open(volume.data[next]) {
                found.data[next] = 1;
                count += 1;
                open.push(next);
            } else {
                rim.push(next);
            }
        }
    }
    rim.sort_unstable();
    rim.dedup();
    (count, rim)
}

fn beside(cell: [usize; 3], step: [i32; 3], size: [usize; 3]) -> Option<[usize; 3]> {
    let mut next = cell;
    for axis in 0..3 {
        let moved = cell[axis] as i64 + i64::from(step[axis]);
        if moved < 0 || moved >= size[axis] as i64 {
            return None;
        }
        next[axis] = moved as usize;
    }
    Some(next)
}

/// The connected parts of a mask, the largest first: their voxels in order.
pub fn parts(mask: &Volume<u8>, neighbourhood: VoxelContact) -> Vec<Vec<usize>> {
    let steps = neighbourhood.steps();
    let mut seen = vec![false; mask.data.len()];
    let mut parts: Vec<Vec<usize>> = Vec::new();
    for start in 0..mask.data.len() {
        if mask.data[start] == 0 || seen[start] {
            continue;
        }
        let (mut part, mut open) = (Vec::new(), vec![start]);
        seen[start] = true;
        while let Some(at) = open.pop() {
            part.push(at);
            let cell = mask.grid.cell(at);
            for next in steps.iter().filter_map(|step| beside(cell, *step, mask.grid.size)) {
                let next = mask.grid.at(next);
                if mask.data[next] > 0 && !seen[next] {
                    seen[next] = true;
                    open.push(next);
                }
            }
        }
        part.sort_unstable();
        parts.push(part);
    }
    // Stable: of equal parts the one that comes first.
    parts.sort_by_key(|part| std::cmp::Reverse(part.len()));
    parts
}

/// A mask of some voxels.
pub fn mask_of(grid: crate::base::VoxelGrid, voxels: &[usize]) -> Volume<u8> {
    let mut mask = Volume::filled(grid, 0u8);
    voxels.iter().for_each(|&at| mask.data[at] = 1);
    mask
}

/// The box around a mask's voxels: its lowest cell, and the first beyond its highest one. `None` for an empty mask.
pub fn bounding_box(mask: &Volume<u8>) -> Option<([usize; 3], [usize; 3])> {
    let (mut low, mut high) = ([usize::MAX; 3], [0usize; 3]);
    for (at, _) in mask.data.iter().enumerate().filter(|(_, value)| **value > 0) {
        let cell = mask.grid.cell(at);
        for axis in 0..3 {
            low[axis] = low[axis].min(cell[axis]);
            high[axis] = high[axis].max(cell[axis] + 1);
        }
    }
    (low[0] < usize::MAX).then_some((low, high))
}

/// Fills what the mask encloses on all sides.
pub fn fill_holes(mask: &mut Volume<u8>) {
    let Some((low, high)) = bounding_box(mask) else { return };
    // What lies outside of the box is enclosed by nothing; one voxel more on each side joins it around the mask.
    let low = low.map(|c| c.saturating_sub(1));
    let high = [0, 1, 2].map(|axis| (high[axis] + 1).min(mask.grid.size[axis]));
    let part = mask.cropped(low, high);
    let [nx, ny, nz] = part.grid.size;
    let mut rim = Vec::new();
    for k in 0..nz {
        for j in 0..ny {
            let is_whole = k == 0 || k + 1 == nz || j == 0 || j + 1 == ny;
            let step = if is_whole { 1 } else { (nx - 1).max(1) };
            rim.extend((0..nx).step_by(step).map(|i| part.grid.at([i, j, k])));
        }
    }
    let outside = reached(&part, &rim, VoxelContact::Faces, |value| value == 0);
    for (row, out) in outside.data.chunks_exact(nx).enumerate() {
        let start = mask.grid.at([low[0], low[1] + row % ny, low[2] + row / ny]);
        mask.data[start..start + nx].iter_mut().zip(out).for_each(|(value, out)| *value = u8::from(*out == 0));
    }
}

/// The mask and all within `radius_mm` of it.
pub fn grown(mask: &Volume<u8>, radius_mm: f64) -> Volume<u8> {
    signed_distance(mask, radius_mm + 1.0).map(|d| u8::from(f64::from(d) < radius_mm))
}

/// The mask closed by a ball: what a ball of `radius_mm` outside of it cannot reach is added.
pub fn closed(mask: &Volume<u8>, radius_mm: f64) -> Volume<u8> {
    signed_distance(&grown(mask, radius_mm), radius_mm + 1.0).map(|d| u8::from(f64::from(d) < -radius_mm))
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::base::VoxelGrid;

    #[test]
    fn parts_holes_and_balls() {
        let grid = VoxelGrid::upright([20, 20, 20], DVec3::ZERO, DVec3::ONE);
        let inside = |at: usize| {
            let p = grid.centre(at);
            let shell = (p - 8.0).length();
            u8::from((shell < 6.0 && shell > 3.0) || (p - 17.0).length() < 1.5)
        };
        let mut mask = Volume { grid, data: (0..grid.count()).map(inside).collect() };
        let found = parts(&mask, VoxelContact::Corners);
        assert_eq!(found.len(), 2);
        assert!(found[0].len() > 500 && found[1].len() < 30);
        mask = mask_of(grid, &found[0]);
        assert_eq!(mask.value([8, 8, 8]), 0);
        fill_holes(&mut mask);
        assert_eq!((mask.value([8, 8, 8]), mask.value([19, 19, 19])), (1, 0));
        fill_holes(&mut Volume::filled(grid, 0));
        let count = |m: &Volume<u8>| m.data.iter().filter(|v| **v > 0).count();
        let (before, wider) = (count(&mask), grown(&mask, 2.0));
        assert!(count(&wider) > before);
        let whole = closed(&mask, 2.0);
        assert!(mask.data.iter().zip(&whole.data).all(|(a, b)| a <= b) && count(&whole) < before * 11 / 10);
    }

    #[test]
    fn spreading_goes_on_from_the_rim() {
        let grid = VoxelGrid::upright([10, 1, 1], DVec3::ZERO, DVec3::ONE);
        let ramp = Volume { grid, data: (0..10).map(|v| v as i16).collect() };
        let mut found = Volume::filled(grid, 0u8);
        let (count, rim) = spread(&ramp, &mut found, vec![0], VoxelContact::Faces, |v| v < 4);
        assert_eq!((count, rim.as_slice()), (4, &[4][..]));
        assert_eq!(spread(&ramp, &mut found, rim, VoxelContact::Faces, |v| v < 8).0, 4);
    }
}
