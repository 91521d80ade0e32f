//! The part of a set of grid nodes that is a ball: no handles, no cavities, one piece, and no two parts that touch at an
//! edge or a corner.
//!
//! Masks of airways have handles, where a network joined two branches, and loose bits. The ball is grown from the
//! deepest node outwards, deepest nodes first, and takes a node only where that changes no topology (a *simple* node;
//! Bertrand and Malandain, Pattern Recognition Letters 15:169, 1994). So a handle is cut where it is thinnest. It also
//! takes no node that would meet a taken one at an edge or a corner alone: the set stays *well-composed* (Latecki, CVGIP
//! 59:477, 1997), and surface nets, which put one vertex into a cube of eight nodes, draw a sphere. So that a thin branch
//! of which two voxels meet at an edge is not lost, such places are bridged by a node first.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// The nodes of a block of 3 x 3 x 3 around node 13, a bit each.
const MIDDLE: usize = 13;

/// Which blocks of 3 x 3 x 3 nodes let their middle be taken.
struct Block {
    /// The nodes that share a face with each node, within the block.
    face: [u32; 27],
    /// Those that share a face, an edge or a corner.
    any: [u32; 27],
    /// The nodes that share a face or an edge with the middle.
    near: u32,
    /// The eight cubes of eight nodes around the middle: their nodes, in the order of their corners.
    cubes: [[usize; 8]; 8],
    /// For each set of a cube's corners: whether no two of its parts meet at an edge or a corner alone.
    is_well_composed: [bool; 256],
}

impl Block {
    fn new() -> Block {
        let cell = |k: usize| [k % 3, k / 3 % 3, k / 9].map(|c| c as i32);
        // How many of the three coordinates differ; more than 3 where one differs by more than a step.
        let apart = |a: [i32; 3], b: [i32; 3]| {
            let steps = [0, 1, 2].map(|axis| (a[axis] - b[axis]).unsigned_abs());
            if steps.iter().any(|s| *s > 1) { 4 } else { steps.iter().sum::<u32>() }
        };
        let within = |most: u32| -> [u32; 27] {
            std::array::from_fn(|a| {
                (0..27).filter(|&b| (1..=most).contains(&apart(cell(a), cell(b)))).fold(0, |set, b| set | 1 << b)
            })
        };
        let corner = |c: usize| [c & 1, c >> 1 & 1, c >> 2];
        let cubes = std::array::from_fn(|cube| {
            let low = corner(cube);
            std::array::from_fn(|c| {
                let at = corner(c);
                (low[0] + at[0]) + 3 * (low[1] + at[1]) + 9 * (low[2] + at[2])
            })
        });
        // Two parts of one kind within the smallest box around two of its nodes: every path between them leaves it.
        let is_well_composed = std::array::from_fn(|set: usize| {
            let meets_badly = |a: usize, b: usize| {
                let kind = set >> a & 1;
                let differs = a ^ b;
                let between = (0..8).filter(|&c| c != a && c != b && (c ^ a) & !differs == 0);
                kind == set >> b & 1 && differs.count_ones() > 1 && between.into_iter().all(|c| set >> c & 1 != kind)
            };
            !(0..8).any(|a| (a + 1..8).any(|b| meets_badly(a, b)))
        });
        Block { face: within(1), any: within(3), near: within(2)[MIDDLE], cubes, is_well_composed }
    }

    /// Whether the middle, taken beside the taken nodes `set`, changes no topology.
    fn is_simple(&self, set: u32) -> bool {
        let free = !set & 0x7ff_ffff & !(1 << MIDDLE);
        let touching = set & self.face[MIDDLE];
        touching != 0
            && grown(touching & touching.wrapping_neg(), set & self.near, &self.face) & touching == touching
            && free != 0
            && grown(free & free.wrapping_neg(), free, &self.any) == free
    }

    /// Whether `set` with the middle is well-composed in the cubes around the middle.
    fn fits(&self, set: u32) -> bool {
        let set = set | 1 << MIDDLE;
        self.cubes.iter().all(|cube| {
            let corners =
                cube.iter().enumerate().fold(0usize, |corners, (c, &node)| corners | ((set >> node & 1) as usize) << c);
            self.is_well_composed[corners]
        })
    }
}

/// The nodes of `set` that are reached from `reached` by way of neighbours in `set`.
fn grown(mut reached: u32, set: u32, neighbours: &[u32; 27]) -> u32 {
    let mut edge = reached;
    while edge != 0 {
        let node = edge.trailing_zeros() as usize;
        edge &= edge - 1;
        let new = neighbours[node] & set & !reached;
        reached |= new;
        edge |= new;
    }
    reached
}

/// What growing the ball left out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BallReport {
    /// Nodes of the set, bridges among them.
    pub nodes: usize,
    /// Nodes that were set where two parts of the set met at an edge or a corner alone.
    pub bridged: usize,
    /// Nodes that were taken.
    pub taken: usize,
    /// Nodes left out that touch taken ones: cuts through handles and walls of cavities.
    pub cut: usize,
}

/// Gives free nodes the value `inside` until no two parts meet at an edge or a corner alone: of the corners of a bad cube,
/// the one that lies nearest to the surface.
fn bridge(values: &mut [f32], size: [usize; 3], block: &Block, inside: f32) -> usize {
    let corner: [usize; 8] = std::array::from_fn(|c| (c & 1) + (c >> 1 & 1) * size[0] + (c >> 2) * size[0] * size[1]);
    let is_inner = |n: usize| {
        let [x, y, z] = [n % size[0], n / size[0] % size[1], n / size[0] / size[1]];
        x > 0 && y > 0 && z > 0 && x + 2 < size[0] && y + 2 < size[1] && z + 2 < size[2]
    };
    let set = |values: &[f32], low: usize| {
        corner.iter().enumerate().fold(0usize, |set, (c, step)| set | (usize::from(values[low + step] < 0.0) << c))
    };
    let mut waiting: Vec<usize> =
        (0..values.len()).filter(|&n| is_inner(n) && !block.is_well_composed[set(values, n)]).collect();
    let mut bridged = 0;
    while let Some(low) = waiting.pop() {
        if !is_inner(low) || block.is_well_composed[set(values, low)] {
            continue;
        }
        let free = corner.iter().map(|step| low + step).filter(|&n| values[n] >= 0.0);
        let Some(node) = free.min_by(|&a, &b| values[a].total_cmp(&values[b])) else { continue };
        values[node] = inside;
        bridged += 1;
        waiting.extend(corner.iter().filter_map(|step| node.checked_sub(*step)));
    }
    bridged
}

/// How far the growth has come with a node.
#[derive(Clone, Copy, PartialEq, Eq)]
enum State {
    Free,
    Waiting,
    Taken,
}

/// Keeps of the nodes with a negative value those of the ball around the lowest; the others become `outside`, and bridges
/// between parts that met at an edge or a corner alone its opposite. The grid (x fastest) must have a rim of values that
/// are not negative, two nodes wide. Serial: the same values give the same ball.
pub fn keep_ball(values: &mut [f32], size: [usize; 3], outside: f32) -> BallReport {
    let step: [isize; 27] = std::array::from_fn(|k| {
        let [x, y, z] = [k % 3, k / 3 % 3, k / 9].map(|c| c as isize - 1);
        x + y * size[0] as isize + z * (size[0] * size[1]) as isize
    });
    let block = Block::new();
    let bridged = bridge(values, size, &block, -outside);
    let nodes = values.iter().filter(|v| **v < 0.0).count();
    let mut state = vec![State::Free; values.len()];
    let Some(deepest) = (0..values.len()).min_by(|&a, &b| values[a].total_cmp(&values[b])).filter(|&n| values[n] < 0.0)
    else {
        return BallReport { nodes: 0, bridged: 0, taken: 0, cut: 0 };
    };
    let around = |node: usize| step.iter().map(move |step| (node as isize + step) as usize);
    let beside = |state: &[State], node: usize| {
        let taken = around(node).enumerate().filter(|&(_, n)| state[n] == State::Taken);
        taken.fold(0u32, |set, (k, _)| set | 1 << k)
    };
    // Order of depth as an integer; ties go to the earlier node.
    let rank = |node: usize| Reverse(((values[node] * 1000.0).round() as i64, node));
    let mut open = BinaryHeap::from([rank(deepest)]);
    let mut count = 0;
    while let Some(Reverse((_, node))) = open.pop() {
        if state[node] == State::Taken {
            continue;
        }
        // A node that is asked in vain is asked again when one beside it is taken.
        state[node] = State::Free;
        let set = beside(&state, node);
        if count > 0 && !block.is_simple(set) {
            continue;
        }
        state[node] = State::Taken;
        let mut partner = None;
        if !block.fits(set) {
            // Two nodes may wait for each other: neither fits alone.
            partner = around(node).find(|&other| {
                if values[other] >= 0.0 || state[other] == State::Taken {
                    return false;
                }
                let set = beside(&state, other);
                let before = std::mem::replace(&mut state[other], State::Taken);
                let fits = block.is_simple(set) && block.fits(set) && block.fits(beside(&state, node));
                if !fits {
                    state[other] = before;
                }
                fits
            });
            if partner.is_none() {
                state[node] = State::Free;
                continue;
            }
        }
        for taken in [Some(node), partner].into_iter().flatten() {
            count += 1;
            for next in around(taken) {
                if values[next] < 0.0 && state[next] == State::Free {
                    state[next] = State::Waiting;
                    open.push(rank(next));
                }
            }
        }
    }
    let is_left = |node: usize| values[node] < 0.0 && state[node] != State::Taken;
    let cut = (0..values.len()).filter(|&n| is_left(n) && around(n).any(|m| state[m] == State::Taken)).count();
    for (value, _) in values.iter_mut().zip(&state).filter(|(value, state)| **value < 0.0 && **state != State::Taken) {
        *value = outside;
    }
    BallReport { nodes, bridged, taken: count, cut }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::ct::isosurface::isosurface;

    const SIZE: usize = 24;

    fn field(inside: impl Fn(DVec3) -> f64) -> Vec<f32> {
        let node = |n: usize| DVec3::new((n % SIZE) as f64, (n / SIZE % SIZE) as f64, (n / SIZE / SIZE) as f64);
        let is_rim = |p: DVec3| p.min_element() < 1.0 || p.max_element() > SIZE as f64 - 2.0;
        (0..SIZE.pow(3)).map(node).map(|p| if is_rim(p) { 1.0 } else { inside(p - 11.5) as f32 }).collect()
    }

    /// Euler characteristic of the surface: 2 for a sphere, 0 for a torus, 4 for two spheres.
    fn euler(values: Vec<f32>) -> i64 {
        let mesh = isosurface(&values, [SIZE; 3], DVec3::ZERO, 1.0);
        mesh.validate_closed().unwrap();
        mesh.vertices.len() as i64 - mesh.edges().len() as i64 + mesh.faces.len() as i64
    }

    #[test]
    fn handles_are_opened_cavities_too_and_loose_parts_go() {
        let torus = |p: DVec3| (p.truncate().length() - 7.0).hypot(p.z) - 2.4;
        let shell = |p: DVec3| (p.length() - 6.5).abs() - 2.0;
        let two = |p: DVec3| ((p - DVec3::X * 5.0).length() - 4.0).min((p + DVec3::X * 6.0).length() - 3.0);
        for (name, before, inside) in
            [("torus", 0, &torus as &dyn Fn(DVec3) -> f64), ("shell", 4, &shell), ("two balls", 4, &two)]
        {
            let mut values = field(inside);
            assert_eq!(euler(values.clone()), before, "{name}");
            let report = keep_ball(&mut values, [SIZE; 3], 0.1);
            assert_eq!(euler(values.clone()), 2, "{name}: {report:?}");
            let least = if name == "two balls" { 0.6 } else { 0.9 };
            assert!(report.taken as f64 > least * report.nodes as f64, "{name}: {report:?}");
            assert_eq!(values.iter().filter(|v| **v < 0.0).count(), report.taken);
        }
        // What is a ball already stays as it is.
        let mut ball = field(|p| p.length() - 7.3);
        let before = ball.clone();
        assert_eq!(keep_ball(&mut ball, [SIZE; 3], 0.1).cut, 0);
        assert_eq!(ball, before);
    }
}
