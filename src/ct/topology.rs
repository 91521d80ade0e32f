//! The part of a set of grid nodes that is a ball: no handles, no cavities, one piece.
//!
//! Masks of airways have handles, where a network joined two branches, and loose bits. The ball is grown from the
//! deepest node outwards, deepest nodes first, and takes a node only where that changes no topology (a *simple* node;
//! Kong and Rosenfeld, CVGIP 48:357, 1989). So a handle is cut where it is thinnest. Neighbours are those that share an
//! edge of Kuhn's tetrahedra, 14 of them, in which marching tetrahedra then draw the surface: a node is simple when the
//! taken and the free among its neighbours are one connected piece each, and the surface has genus 0 by construction.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// The 14 neighbours of a node: the edges of Kuhn's subdivision both ways.
const NEIGHBOURS: [[i32; 3]; 14] = [
    [1, 0, 0],
    [0, 1, 0],
    [0, 0, 1],
    [1, 1, 0],
    [1, 0, 1],
    [0, 1, 1],
    [1, 1, 1],
    [-1, 0, 0],
    [0, -1, 0],
    [0, 0, -1],
    [-1, -1, 0],
    [-1, 0, -1],
    [0, -1, -1],
    [-1, -1, -1],
];

/// For each set of taken neighbours (a bit each): whether a node between them is simple.
pub struct SimpleNodes(Vec<bool>);

impl SimpleNodes {
    /// Looks at all 16384 sets.
    pub fn new() -> Self {
        let is_edge = |a: [i32; 3], b: [i32; 3]| {
            let difference = [0, 1, 2].map(|k| a[k] - b[k]);
            NEIGHBOURS.contains(&difference)
        };
        let adjacent: Vec<u32> = NEIGHBOURS
            .iter()
            .map(|&a| (0..14).filter(|&k| is_edge(a, NEIGHBOURS[k])).fold(0, |mask, k| mask | 1 << k))
            .collect();
        let is_one_piece = |set: u32| {
            let mut reached = set & set.wrapping_neg();
            loop {
                let grown = (0..14).filter(|k| reached >> k & 1 == 1).fold(reached, |r, k| r | adjacent[k]) & set;
                if grown == reached {
                    return set != 0 && reached == set;
                }
                reached = grown;
            }
        };
        SimpleNodes((0..1u32 << 14).map(|set| is_one_piece(set) && is_one_piece(!set & 0x3fff)).collect())
    }
}

/// What growing the ball left out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BallReport {
    /// Nodes of the set.
    pub nodes: usize,
    /// Nodes that were taken.
    pub taken: usize,
    /// Nodes left out that touch taken ones: cuts through handles and walls of cavities.
    pub cut: usize,
}

/// Keeps of the nodes with a negative value those of the ball around the lowest; the others become `outside`. The grid
/// (x fastest) must have a rim of values that are not negative. Serial: the same values give the same ball.
pub fn keep_ball(values: &mut [f32], size: [usize; 3], outside: f32) -> BallReport {
    let simple = SimpleNodes::new();
    let step = NEIGHBOURS
        .map(|[x, y, z]| x as isize + y as isize * size[0] as isize + z as isize * (size[0] * size[1]) as isize);
    let nodes = values.iter().filter(|v| **v < 0.0).count();
    let mut taken = vec![false; values.len()];
    let Some(deepest) = (0..values.len()).min_by(|&a, &b| values[a].total_cmp(&values[b])).filter(|&n| values[n] < 0.0)
    else {
        return BallReport { nodes: 0, taken: 0, cut: 0 };
    };
    // Order of depth as an integer; ties go to the earlier node.
    let rank = |node: usize| Reverse(((values[node] * 1000.0).round() as i64, node));
    let mut open = BinaryHeap::from([rank(deepest)]);
    let mut count = 0;
    while let Some(Reverse((_, node))) = open.pop() {
        if taken[node] {
            continue;
        }
        let at = |k: usize| (node as isize + step[k]) as usize;
        let set = (0..14).filter(|&k| taken[at(k)]).fold(0usize, |set, k| set | 1 << k);
        if count > 0 && !simple.0[set] {
            continue;
        }
        taken[node] = true;
        count += 1;
        open.extend((0..14).map(at).filter(|&n| values[n] < 0.0 && !taken[n]).map(rank));
    }
    let mut cut = 0;
    for node in 0..values.len() {
        if values[node] < 0.0 && !taken[node] {
            cut += usize::from((0..14).any(|k| taken[(node as isize + step[k]) as usize]));
        }
    }
    for (value, _) in values.iter_mut().zip(&taken).filter(|(value, taken)| **value < 0.0 && !**taken) {
        *value = outside;
    }
    BallReport { nodes, taken: count, cut }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::airway::surface_field::LumenField;
    use crate::airway::surface_polygon::polygonise;

    const SIZE: usize = 24;

    fn field(inside: impl Fn(DVec3) -> f64) -> Vec<f32> {
        let node = |n: usize| DVec3::new((n % SIZE) as f64, (n / SIZE % SIZE) as f64, (n / SIZE / SIZE) as f64);
        let is_rim = |p: DVec3| p.min_element() < 1.0 || p.max_element() > SIZE as f64 - 2.0;
        (0..SIZE.pow(3)).map(node).map(|p| if is_rim(p) { 1.0 } else { inside(p - 11.5) as f32 }).collect()
    }

    /// Euler characteristic of the surface: 2 for a sphere, 0 for a torus, 4 for two spheres.
    fn euler(values: Vec<f32>) -> i64 {
        let mesh = polygonise(&LumenField::from_values(DVec3::ZERO, 1.0, [SIZE; 3], values));
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
