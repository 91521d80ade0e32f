//! From centred paths to the centreline: evenly spaced, with branches and generations, without what is too narrow.

use glam::DVec3;

use super::centerline::{Centerline, CenterlinePoint, CenterlineSettings};
use super::centerline_distance::SurfaceDistance;
use super::centerline_trace::{PROTRUSION, TraceNode, Traces};
use super::centerline_voxels::{NONE, Voxels};

/// A piece between two junctions shorter than this many radii belongs to the junction: its daughters count as the
/// daughters of its parent.
const JUNCTION_RADII: f64 = 0.7;
/// A first side branch shorter than this many radii, and that leaves within so many of the inlet, leads into the rim of
/// the trachea's flat end, where the scan was cut, and is none.
const RIM_RADII: f64 = 1.6;
const NEAR_INLET_RADII: f64 = 3.0;
/// A branch of the trachea that is at most this share of its radius wide, and this share as long as all that follows on
/// the other side, is a diverticulum or a tracheal bronchus: the trachea goes on behind it.
const SIDE_WIDTH: f64 = 0.5;
const SIDE_LENGTH: f64 = 0.25;

/// A run of nodes between two junctions, as positions with radii; the junction itself is the parent's last node.
struct Piece {
    nodes: Vec<u32>,
    parent: Option<usize>,
    children: usize,
}

/// Builds the centreline of the centred traces.
pub fn assemble(
    traces: &Traces,
    settings: &CenterlineSettings,
    voxels: &Voxels,
    surface: &SurfaceDistance,
) -> Centerline {
    let mut kept = vec![true; traces.nodes.len()];
    let pieces = loop {
        let pieces = split(&traces.nodes, &kept);
        let narrow = drop_narrow(&pieces, &traces.nodes, settings.minimal_radius_mm, &mut kept);
        if !narrow && !drop_rim(&pieces, &traces.nodes, &mut kept) {
            break pieces;
        }
    };
    let mut centerline = Centerline::default();
    let trachea = trachea(&pieces, &traces.nodes);
    let mut generations: Vec<u32> = Vec::new();
    let mut last_points: Vec<u32> = Vec::new();
    for (index, piece) in pieces.iter().enumerate() {
        let generation = match piece.parent {
            _ if trachea.contains(&index) => 0,
            Some(p) if !trachea.contains(&p) && is_junction(&pieces[p], &traces.nodes) => generations[p],
            Some(p) => generations[p] + 1,
            None => 0,
        };
        generations.push(generation);
        let mut parent = piece.parent.map(|p| last_points[p]);
        for position_mm in resample(piece, &traces.nodes, settings.point_spacing_mm, voxels) {
            let radius_mm = surface.distance(position_mm);
            let own = centerline.points.len() as u32;
            centerline.points.push(CenterlinePoint {
                position_mm,
                radius_mm,
                branch: index as u32,
                generation,
                parent,
            });
            parent = Some(own);
        }
        last_points.push(parent.expect("the first piece holds the inlet, so every piece has a point before its end"));
    }
    centerline
}

/// Cuts the kept nodes at their junctions; parents come before their children.
fn split(nodes: &[TraceNode], kept: &[bool]) -> Vec<Piece> {
    let mut children: Vec<Vec<u32>> = vec![Vec::new(); nodes.len()];
    for (n, node) in nodes.iter().enumerate().filter(|(n, node)| kept[*n] && node.parent != NONE) {
        children[node.parent as usize].push(n as u32);
    }
    let mut pieces: Vec<Piece> = Vec::new();
    let mut open = std::collections::VecDeque::from([(0u32, None)]);
    while let Some((first, parent)) = open.pop_front() {
        let mut run = vec![first];
        let mut last = first;
        while let [only] = children[last as usize][..] {
            run.push(only);
            last = only;
        }
        let next = &children[last as usize];
        open.extend(next.iter().map(|&c| (c, Some(pieces.len()))));
        pieces.push(Piece { nodes: run, parent, children: next.len() });
    }
    pieces
}

/// The pieces of the trachea, inlet first: more than one where something small branches from it above the carina.
fn trachea(pieces: &[Piece], nodes: &[TraceNode]) -> Vec<usize> {
    let daughters = |parent: usize| (0..pieces.len()).filter(move |&p| pieces[p].parent == Some(parent));
    // Children come after their parents.
    let mut tree_mm: Vec<f64> = pieces.iter().map(|piece| length(piece, nodes)).collect();
    for p in (1..pieces.len()).rev() {
        let parent = pieces[p].parent.expect("all but the first piece have a parent");
        tree_mm[parent] += tree_mm[p];
    }
    let mut trachea = vec![0];
    loop {
        let last = trachea[trachea.len() - 1];
        let main = daughters(last).max_by(|&a, &b| tree_mm[a].total_cmp(&tree_mm[b]));
        let Some(main) = main.filter(|&main| pieces[main].children > 0) else { return trachea };
        let end = nodes[pieces[last].nodes[pieces[last].nodes.len() - 1] as usize];
        let is_side = |p: usize| {
            tree_mm[p] <= SIDE_LENGTH * tree_mm[main]
                && outer_radius_mm(&pieces[p], nodes) <= SIDE_WIDTH * end.radius_mm
        };
        if !daughters(last).all(|p| p == main || is_side(p)) {
            return trachea;
        }
        trachea.push(main);
    }
}

/// Mean radius of a piece outside of its parent's last sphere, in which any branch is as wide as its parent.
fn outer_radius_mm(piece: &Piece, nodes: &[TraceNode]) -> f64 {
    let node = |n: u32| nodes[n as usize];
    let parent = node(node(piece.nodes[0]).parent);
    let is_outside = |n: &&u32| node(**n).position_mm.distance(parent.position_mm) > parent.radius_mm;
    let outside: Vec<f64> = piece.nodes.iter().filter(is_outside).map(|&n| node(n).radius_mm).collect();
    outside.iter().sum::<f64>() / (outside.len().max(1) as f64)
}

/// Marks the nodes of end pieces from where they are narrower than allowed as dropped; whether there were any.
fn drop_narrow(pieces: &[Piece], nodes: &[TraceNode], minimal_radius_mm: f64, kept: &mut [bool]) -> bool {
    let mut dropped = false;
    for piece in pieces.iter().filter(|p| p.children == 0 && p.parent.is_some()) {
        let narrow = &piece.nodes[wide_beginning(piece, nodes, minimal_radius_mm)..];
        narrow.iter().for_each(|&n| kept[n as usize] = false);
        dropped |= !narrow.is_empty();
    }
    dropped
}

/// How many nodes of an end piece stay: all where their mean radius suffices; else the longest beginning whose mean
/// radius does outside of the parent, which alone would make any beginning wide; none where that is no branch.
fn wide_beginning(piece: &Piece, nodes: &[TraceNode], minimal_radius_mm: f64) -> usize {
    let node = |n: &u32| nodes[*n as usize];
    let mean = |part: &[u32]| part.iter().map(|n| node(n).radius_mm).sum::<f64>() / part.len() as f64;
    if mean(&piece.nodes) >= minimal_radius_mm {
        return piece.nodes.len();
    }
    let parent = nodes[node(&piece.nodes[0]).parent as usize];
    let is_outside = |n: &u32| node(n).position_mm.distance(parent.position_mm) > parent.radius_mm;
    let Some(start) = piece.nodes.iter().position(is_outside) else { return 0 };
    let outside = &piece.nodes[start..];
    let Some(count) = (1..=outside.len()).rev().find(|&k| mean(&outside[..k]) >= minimal_radius_mm) else { return 0 };
    let wide = &outside[..count];
    let length: f64 = wide.windows(2).map(|w| node(&w[0]).position_mm.distance(node(&w[1]).position_mm)).sum();
    if length > PROTRUSION * mean(wide) { start + count } else { 0 }
}

/// Marks the nodes of an end piece that leads into the rim of the trachea's end as dropped; whether there was one.
fn drop_rim(pieces: &[Piece], nodes: &[TraceNode], kept: &mut [bool]) -> bool {
    let junction_radius_mm = nodes[pieces[0].nodes[pieces[0].nodes.len() - 1] as usize].radius_mm;
    if length(&pieces[0], nodes) > NEAR_INLET_RADII * junction_radius_mm {
        return false;
    }
    let is_rim =
        |p: &&Piece| p.parent == Some(0) && p.children == 0 && length(p, nodes) < RIM_RADII * junction_radius_mm;
    // The other daughters are the trachea: one piece alone is never dropped.
    let Some(rim) = pieces.iter().find(is_rim).filter(|_| pieces[0].children > 1) else { return false };
    rim.nodes.iter().for_each(|&n| kept[n as usize] = false);
    true
}

fn length(piece: &Piece, nodes: &[TraceNode]) -> f64 {
    let at = |n: u32| nodes[n as usize].position_mm;
    let first = piece.nodes[0];
    let lead = match nodes[first as usize].parent {
        NONE => 0.0,
        parent => at(first).distance(at(parent)),
    };
    lead + piece.nodes.windows(2).map(|w| at(w[0]).distance(at(w[1]))).sum::<f64>()
}

/// Whether an inner piece is so short that its two ends are one junction.
fn is_junction(piece: &Piece, nodes: &[TraceNode]) -> bool {
    let start = nodes[nodes[piece.nodes[0] as usize].parent as usize];
    piece.children > 0 && length(piece, nodes) < JUNCTION_RADII * start.radius_mm
}

/// Points about `spacing_mm` apart along a piece, its last node exactly; the parent's node only leads in.
fn resample(piece: &Piece, nodes: &[TraceNode], spacing_mm: f64, voxels: &Voxels) -> Vec<DVec3> {
    let lead = nodes[piece.nodes[0] as usize].parent;
    let line: Vec<DVec3> = (lead != NONE)
        .then_some(lead)
        .into_iter()
        .chain(piece.nodes.iter().copied())
        .map(|n| nodes[n as usize].position_mm)
        .collect();
    let total: f64 = line.windows(2).map(|w| w[0].distance(w[1])).sum();
    let count = (total / spacing_mm).round().max(1.0) as usize;
    let mut points = if lead == NONE { vec![line[0]] } else { Vec::new() };
    let (mut segment, mut passed) = (0, 0.0);
    for k in 1..count {
        let at = total * k as f64 / count as f64;
        while segment + 2 < line.len() && passed + line[segment].distance(line[segment + 1]) < at {
            passed += line[segment].distance(line[segment + 1]);
            segment += 1;
        }
        let (a, b) = (line[segment], line[segment + 1]);
        let share = ((at - passed) / a.distance(b).max(1e-12)).clamp(0.0, 1.0);
        let point = a.lerp(b, share);
        // a straight step past a carina may leave the lumen; the nearer end does not
        points.push(if voxels.contains(point) {
            point
        } else if share < 0.5 {
            a
        } else {
            b
        });
    }
    if lead != NONE || line.len() > 1 {
        points.push(line[line.len() - 1]);
    }
    points
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Adds a straight run of nodes 1 mm apart with these radii; its last node.
    fn run(nodes: &mut Vec<TraceNode>, parent: u32, direction: DVec3, radii_mm: &[f64]) -> u32 {
        let from = nodes.get(parent as usize).map_or(DVec3::ZERO, |n| n.position_mm);
        for (k, &radius_mm) in radii_mm.iter().enumerate() {
            let parent = if k == 0 { parent } else { nodes.len() as u32 - 1 };
            nodes.push(TraceNode { position_mm: from + direction * (k + 1) as f64, radius_mm, parent });
        }
        nodes.len() as u32 - 1
    }

    /// What is small beside the trachea leaves it before the carina, which is where two main bronchi part.
    #[test]
    fn the_trachea_goes_on_behind_a_diverticulum_and_behind_a_tracheal_bronchus() {
        let tree = |side_mm: f64, side_nodes: usize, end_mm: f64| {
            let mut nodes = Vec::new();
            let side = run(&mut nodes, NONE, DVec3::NEG_Z, &[8.0; 60]);
            run(&mut nodes, side, DVec3::X, &vec![side_mm; side_nodes]);
            let carina = run(&mut nodes, side, DVec3::NEG_Z, &[8.0; 40]);
            for towards in [DVec3::X, DVec3::NEG_X] {
                let hilum = run(&mut nodes, carina, towards, &[6.0; 40]);
                run(&mut nodes, hilum, towards, &[end_mm; 30]);
                run(&mut nodes, hilum, DVec3::NEG_Z, &[4.0; 30]);
            }
            let pieces = split(&nodes, &vec![true; nodes.len()]);
            let ends: Vec<f64> = trachea(&pieces, &nodes)
                .iter()
                .map(|&p| nodes[pieces[p].nodes[pieces[p].nodes.len() - 1] as usize].position_mm.z)
                .collect();
            ends
        };
        assert_eq!(tree(3.0, 20, 4.0), [-60.0, -100.0], "a diverticulum");
        assert_eq!(tree(4.0, 60, 4.0), [-60.0, -100.0], "a tracheal bronchus");
        assert_eq!(tree(5.5, 20, 4.0), [-60.0], "as wide as a main bronchus");
        assert_eq!(tree(3.0, 70, 4.0), [-60.0], "with as much behind it as a lung");
        assert_eq!(tree(3.0, 20, 2.0)[1], -100.0);
    }

    /// Of a wide branch with a long thin end a part is kept; of a thin one nothing, though its first nodes, inside of its
    /// wide parent, are wide.
    #[test]
    fn a_wide_branch_is_cut_where_it_becomes_thin_and_a_thin_one_goes() {
        let mut nodes = Vec::new();
        let carina = run(&mut nodes, NONE, DVec3::NEG_Z, &[4.0; 40]);
        run(&mut nodes, carina, DVec3::NEG_Z, &[2.0; 20]);
        let into = [3.5, 3.0, 2.0, 1.5];
        let wide = nodes.len() as u32;
        run(&mut nodes, carina, DVec3::X, &[&into[..], &[1.41; 12], &[0.6; 60]].concat());
        let thin = nodes.len() as u32;
        run(&mut nodes, carina, DVec3::NEG_X, &[&into[..], &[0.8; 40]].concat());
        let mut kept = vec![true; nodes.len()];
        assert!(drop_narrow(&split(&nodes, &kept), &nodes, 1.0, &mut kept));
        let count = |from: u32, to: usize| kept[from as usize..to].iter().filter(|kept| **kept).count();
        // 12 of 1.41 and 12 of 0.6 have a mean just above 1; the first four are inside of the parent.
        assert_eq!(count(wide, thin as usize), 28);
        assert!(kept[wide as usize..wide as usize + 28].iter().all(|kept| *kept));
        assert_eq!(count(thin, nodes.len()), 0);
        assert_eq!(count(0, wide as usize), 60);
        assert!(!drop_narrow(&split(&nodes, &kept), &nodes, 1.0, &mut kept), "what was cut stays");
    }
}
