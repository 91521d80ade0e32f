//! The vessels of the lung: arteries beside the airways, veins between them, and twigs that fill the space.
//!
//! Ends are spread evenly over the lungs; one after the other, in random order, each is joined to the nearest point of
//! the tree so far (a greedy form of constrained constructive optimisation; Karch et al., Comput Biol Med 29:19, 1999).
//! So trunks come first, and twigs hang on them. Radii follow Murray's law from the ends up, r^3 = sum of r_k^3; beside
//! an airway an artery has at least three quarters of its radius.

use std::collections::BTreeMap;

use glam::DVec3;

use crate::airway::centerline::Centerline;
use crate::base::random::{CounterRng, Stage};

/// Distance in mm of the ends from each other, of the points along a vessel, and of ends from the pleura.
const END_SPACING_MM: f64 = 6.5;
const STEP_MM: f64 = 3.5;
const FROM_PLEURA_MM: f64 = 3.5;
/// Radius of an end in mm, and the widest.
const END_RADIUS_MM: f64 = 0.28;
const WIDEST_MM: f64 = 7.0;
/// Radius of an artery over that of the airway beside it, and the gap between the two walls in mm.
const ARTERY_SHARE: f64 = 0.75;
const GAP_MM: f64 = 1.3;
/// How far a vessel wanders off the straight line, over its length.
const WANDER: f64 = 0.09;
/// Edge in mm of the cells in which the nearest vessels are looked for.
const CELL_MM: f64 = 5.0;
/// Distances are known up to here, mm.
const KNOWN_MM: f64 = 1.0;

/// A straight piece of a vessel, with a radius at each end.
#[derive(Clone, Copy, Debug)]
pub struct VesselPiece {
    /// Ends, the one nearer to the heart first, mm.
    pub ends_mm: [DVec3; 2],
    /// Radii in mm.
    pub radii_mm: [f64; 2],
}

/// All vessels, in the tissue's coordinates at full inspiration.
pub struct VesselTree {
    /// The pieces.
    pub pieces: Vec<VesselPiece>,
    /// Points at which vessels divide, mm.
    pub forks_mm: Vec<DVec3>,
    /// Pieces near each cell, cell by cell.
    of_cells: Vec<u32>,
    table: CellTable,
}

/// The cells as a dense table: where the list of a cell begins and ends.
struct CellTable {
    low: [i32; 3],
    size: [usize; 3],
    ranges: Vec<(u32, u32)>,
}

/// A tree that grows: points, each with the one before it and the least radius there.
struct GrowingTree {
    points: Vec<DVec3>,
    parents: Vec<Option<u32>>,
    least_mm: Vec<f64>,
    is_end: Vec<bool>,
    buckets: BTreeMap<[i32; 3], Vec<u32>>,
}

/// Edge in mm of the buckets of a growing tree.
const BUCKET_MM: f64 = 10.0;

fn cell_of(place: DVec3, edge_mm: f64) -> [i32; 3] {
    (place / edge_mm).floor().to_array().map(|v| v as i32)
}

impl GrowingTree {
    fn new() -> Self {
        GrowingTree { points: vec![], parents: vec![], least_mm: vec![], is_end: vec![], buckets: BTreeMap::new() }
    }

    fn push(&mut self, place: DVec3, parent: Option<u32>, least_mm: f64) -> u32 {
        let index = self.points.len() as u32;
        self.points.push(place);
        self.parents.push(parent);
        self.least_mm.push(least_mm);
        self.is_end.push(false);
        self.buckets.entry(cell_of(place, BUCKET_MM)).or_default().push(index);
        index
    }

    /// The nearest point; rings of buckets until none nearer can come.
    fn nearest(&self, place: DVec3) -> Option<u32> {
        let middle = cell_of(place, BUCKET_MM);
        let mut best: Option<(f64, u32)> = None;
        for ring in 0..60i32 {
            if best.is_some_and(|(d, _)| d.sqrt() < f64::from(ring - 1) * BUCKET_MM) {
                break;
            }
            for dk in -ring..=ring {
                for dj in -ring..=ring {
                    let is_face = dk.abs() == ring || dj.abs() == ring;
                    let step = if is_face || ring == 0 { 1 } else { 2 * ring };
                    for di in (-ring..=ring).step_by(step as usize) {
                        let bucket = self.buckets.get(&[middle[0] + di, middle[1] + dj, middle[2] + dk]);
                        for &point in bucket.into_iter().flatten() {
                            let d = self.points[point as usize].distance_squared(place);
                            if best.is_none_or(|b| (d, point) < b) {
                                best = Some((d, point));
                            }
                        }
                    }
                }
            }
        }
        best.map(|b| b.1)
    }

    /// A vessel from the nearest point to `end`, which wanders a little.
    fn join(&mut self, end: DVec3, rng: &mut CounterRng) {
        let Some(from) = self.nearest(end) else { return };
        let start = self.points[from as usize];
        self.draw(from, start, end, rng);
        if let Some(last) = self.is_end.last_mut() {
            *last = true;
        }
    }

    fn draw(&mut self, from: u32, start: DVec3, end: DVec3, rng: &mut CounterRng) -> u32 {
        let length = start.distance(end);
        let steps = (length / STEP_MM).ceil().max(1.0) as usize;
        let across = DVec3::new(rng.normal(), rng.normal(), rng.normal()) * (WANDER * length);
        let mut parent = from;
        for step in 1..=steps {
            let t = step as f64 / steps as f64;
            let place = start.lerp(end, t) + across * (4.0 * t * (1.0 - t));
            parent = self.push(place, Some(parent), 0.0);
        }
        parent
    }

    /// Radii by Murray's law, and the pieces; forks go to `forks`.
    fn pieces(&self, pieces: &mut Vec<VesselPiece>, forks: &mut Vec<DVec3>) {
        let count = self.points.len();
        let mut cubes = vec![0.0f64; count];
        let mut children = vec![0u32; count];
        for k in (0..count).rev() {
            if self.is_end[k] || cubes[k] == 0.0 {
                cubes[k] += END_RADIUS_MM.powi(3);
            }
            if let Some(parent) = self.parents[k] {
                cubes[parent as usize] += cubes[k];
                children[parent as usize] += 1;
            }
        }
        let radius = |k: usize| cubes[k].cbrt().max(self.least_mm[k]).min(WIDEST_MM);
        for k in 0..count {
            let Some(parent) = self.parents[k] else { continue };
            let from = parent as usize;
            // A twig leaves its trunk with its own width.
            let radii_mm = [radius(from).min(1.25 * radius(k)), radius(k)];
            pieces.push(VesselPiece { ends_mm: [self.points[from], self.points[k]], radii_mm });
            if children[k] > 1 && radius(k) > 0.6 {
                forks.push(self.points[k]);
            }
        }
    }
}

impl VesselTree {
    /// The vessels of lungs in the box from `low` to `high`, inside where `lung` (a signed distance) is negative, beside
    /// the airway of `line`.
    pub fn new(line: &Centerline, low: DVec3, high: DVec3, lung: impl Fn(DVec3) -> f64, seed: u64) -> VesselTree {
        let mut rng = CounterRng::new(seed, Stage::Scan, &[2]);
        let (mut arteries, mut veins) = (GrowingTree::new(), GrowingTree::new());
        beside_airway(&mut arteries, line);
        from_atrium(&mut veins, line, &mut rng);
        let mut ends = Vec::new();
        let steps = ((high - low) / END_SPACING_MM).to_array().map(|n| n.max(0.0) as usize);
        for k in 0..=steps[2] {
            for j in 0..=steps[1] {
                for i in 0..=steps[0] {
                    let jitter = DVec3::new(rng.uniform(), rng.uniform(), rng.uniform());
                    let place = low + (DVec3::new(i as f64, j as f64, k as f64) + jitter) * END_SPACING_MM;
                    if lung(place) < -FROM_PLEURA_MM {
                        ends.push((rng.next_u64(), place));
                    }
                }
            }
        }
        ends.sort_by_key(|end| end.0);
        for (turn, (_, end)) in ends.into_iter().enumerate() {
            if turn % 2 == 0 { &mut arteries } else { &mut veins }.join(end, &mut rng);
        }
        let (mut pieces, mut forks_mm) = (Vec::new(), Vec::new());
        arteries.pieces(&mut pieces, &mut forks_mm);
        veins.pieces(&mut pieces, &mut forks_mm);
        forks_mm.retain(|fork| lung(*fork) < -FROM_PLEURA_MM);
        VesselTree::of_pieces(pieces, forks_mm)
    }

    /// Pieces, ready to be asked for distances.
    pub fn of_pieces(pieces: Vec<VesselPiece>, forks_mm: Vec<DVec3>) -> VesselTree {
        let mut lists: BTreeMap<[i32; 3], Vec<u32>> = BTreeMap::new();
        for (index, piece) in pieces.iter().enumerate() {
            let reach = piece.radii_mm[0].max(piece.radii_mm[1]) + KNOWN_MM;
            let [a, b] = piece.ends_mm;
            let low = cell_of(a.min(b) - reach, CELL_MM);
            let high = cell_of(a.max(b) + reach, CELL_MM);
            for k in low[2]..=high[2] {
                for j in low[1]..=high[1] {
                    for i in low[0]..=high[0] {
                        lists.entry([i, j, k]).or_default().push(index as u32);
                    }
                }
            }
        }
        let (mut of_cells, mut cells) = (Vec::new(), BTreeMap::new());
        for (cell, list) in lists {
            let start = of_cells.len() as u32;
            of_cells.extend(list);
            cells.insert(cell, (start, of_cells.len() as u32));
        }
        let table = CellTable::new(&cells);
        VesselTree { pieces, forks_mm, of_cells, table }
    }

    /// Signed distance in mm to the nearest vessel, at most 1 mm.
    pub fn distance(&self, tissue_mm: DVec3) -> f64 {
        let (start, end) = self.table.range(cell_of(tissue_mm, CELL_MM));
        let near = self.of_cells[start as usize..end as usize].iter();
        near.map(|&piece| self.pieces[piece as usize].distance(tissue_mm)).fold(KNOWN_MM, f64::min)
    }
}

impl CellTable {
    fn new(cells: &BTreeMap<[i32; 3], (u32, u32)>) -> CellTable {
        let (mut low, mut high) = ([0i32; 3], [0i32; 3]);
        if let Some(first) = cells.keys().next() {
            (low, high) = (*first, *first);
        }
        for cell in cells.keys() {
            for a in 0..3 {
                (low[a], high[a]) = (low[a].min(cell[a]), high[a].max(cell[a]));
            }
        }
        let size = [0, 1, 2].map(|a| (high[a] - low[a] + 1) as usize);
        let mut table = CellTable { low, size, ranges: vec![(0, 0); size.iter().product()] };
        for (cell, range) in cells {
            if let Some(at) = table.place(*cell) {
                table.ranges[at] = *range;
            }
        }
        table
    }

    fn place(&self, cell: [i32; 3]) -> Option<usize> {
        let mut at = 0;
        for a in (0..3).rev() {
            let offset = usize::try_from(cell[a] - self.low[a]).ok().filter(|&o| o < self.size[a])?;
            at = at * self.size[a] + offset;
        }
        Some(at)
    }

    fn range(&self, cell: [i32; 3]) -> (u32, u32) {
        self.place(cell).map_or((0, 0), |at| self.ranges[at])
    }
}

impl VesselPiece {
    fn distance(&self, p: DVec3) -> f64 {
        let [a, b] = self.ends_mm;
        let length2 = (b - a).length_squared();
        let t = if length2 > 0.0 { ((p - a).dot(b - a) / length2).clamp(0.0, 1.0) } else { 0.0 };
        p.distance(a.lerp(b, t)) - (self.radii_mm[0] + (self.radii_mm[1] - self.radii_mm[0]) * t)
    }
}

/// The points of arteries beside the bronchi, on one side of each: above and outside.
fn beside_airway(tree: &mut GrowingTree, line: &Centerline) {
    let mut index_of: Vec<Option<u32>> = vec![None; line.points.len()];
    let mut travelled: Vec<f64> = vec![0.0; line.points.len()];
    let middle_x = line.carina_mm().unwrap_or_default().x;
    for (k, point) in line.points.iter().enumerate() {
        let Some(parent) = point.parent.map(|p| p as usize) else { continue };
        if point.generation == 0 {
            continue;
        }
        let before = index_of[parent];
        let step = point.position_mm - line.points[parent].position_mm;
        travelled[k] = travelled[parent] + step.length();
        if before.is_some() && travelled[k] < STEP_MM {
            index_of[k] = before;
            continue;
        }
        travelled[k] = 0.0;
        let tangent = step.try_normalize().unwrap_or(DVec3::NEG_Z);
        let outwards = DVec3::new((point.position_mm.x - middle_x).signum(), -0.7, 0.8);
        let beside = outwards.reject_from_normalized(tangent).try_normalize().unwrap_or(DVec3::NEG_Y);
        let radius = (ARTERY_SHARE * point.radius_mm).min(WIDEST_MM);
        let place = point.position_mm + beside * (point.radius_mm + radius + GAP_MM);
        index_of[k] = Some(tree.push(place, before, radius));
    }
}

/// The trunks of the veins: from the atrium, below and before the carina, to below the lobar bronchi.
fn from_atrium(tree: &mut GrowingTree, line: &Centerline, rng: &mut CounterRng) {
    let Some(carina) = line.carina_mm() else { return };
    let atrium = carina + DVec3::new(6.0, -8.0, -42.0);
    let root = tree.push(atrium, None, 5.0);
    let last_of_branch = |k: usize| line.points.get(k + 1).is_none_or(|next| next.branch != line.points[k].branch);
    for (k, point) in line.points.iter().enumerate() {
        if point.generation == 2 && last_of_branch(k) {
            let side = (point.position_mm.x - carina.x).signum();
            let end = point.position_mm + DVec3::new(4.0 * side, -9.0, -9.0);
            tree.draw(root, atrium, end, rng);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::airway::grow::{GrowthSettings, grow};

    #[test]
    fn vessels_fill_the_lung_and_follow_murrays_law() {
        let growth = GrowthSettings { deepest_generation: 4, ..GrowthSettings::default() };
        let line = grow(7, &growth).unwrap().to_centerline();
        let (low, high) = (DVec3::new(20.0, -60.0, -90.0), DVec3::new(90.0, 50.0, 40.0));
        let ball = |p: DVec3| ((p - (low + high) / 2.0) / ((high - low) / 2.0)).length() * 30.0 - 30.0;
        let tree = VesselTree::new(&line, low, high, ball, 5);
        assert!(tree.pieces.len() > 3000 && tree.forks_mm.len() > 100);
        let mut rng = CounterRng::new(2, Stage::Test, &[]);
        let mut far = 0;
        for _ in 0..400 {
            let p = low + (high - low) * DVec3::new(rng.uniform(), rng.uniform(), rng.uniform());
            let brute = tree.pieces.iter().map(|piece| piece.distance(p)).fold(KNOWN_MM, f64::min);
            assert_eq!(tree.distance(p), brute);
            let nearest = tree.pieces.iter().map(|piece| piece.distance(p)).fold(1e9, f64::min);
            far += usize::from(ball(p) < -4.0 && nearest > 7.0);
        }
        assert!(far < 8, "{far} of 400 places are far from all vessels");
        let radii = tree.pieces.iter().map(|p| p.radii_mm[1]);
        assert!(radii.clone().fold(0.0, f64::max) > 2.0);
        assert!((radii.fold(9.0, f64::min) - END_RADIUS_MM).abs() < 1e-12);
    }
}
