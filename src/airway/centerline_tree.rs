//! From traced voxel paths to the centreline: centred, smooth, evenly spaced, with branches and generations.

use glam::DVec3;

use super::centerline::{Centerline, CenterlinePoint, CenterlineSettings};
use super::centerline_distance::SurfaceDistance;
use super::centerline_trace::{TraceNode, Traces};
use super::centerline_voxels::{NONE, Voxels};

/// A piece between two junctions shorter than this many radii belongs to the junction: its daughters count as the
/// daughters of its parent.
const JUNCTION_RADII: f64 = 0.7;
/// A first side branch shorter than this many radii, and that leaves within so many of the inlet, leads into the rim of
/// the trachea's flat end, where the scan was cut, and is none.
const RIM_RADII: f64 = 1.6;
const NEAR_INLET_RADII: f64 = 3.0;
/// Rounds of smoothing and centring.
const ROUNDS: usize = 3;

/// Moves every node to the middle of its cross-section, path by path, and smooths the paths. No node leaves the lumen.
pub fn centre(traces: &mut Traces, voxels: &Voxels, surface: &SurfaceDistance) {
    for path in 0..traces.starts.len() - 1 {
        let (start, end) = (traces.starts[path] as usize, traces.starts[path + 1] as usize);
        let mut points: Vec<DVec3> = traces.nodes[start..end].iter().map(|n| n.position_mm).collect();
        let join = traces.nodes.get(traces.nodes[start].parent as usize).copied();
        for _ in 0..ROUNDS {
            smooth(&mut points, join, 6, voxels);
            for k in 0..points.len() {
                let inside_parent = join.is_some_and(|j| j.position_mm.distance(points[k]) < j.radius_mm);
                if !inside_parent {
                    points[k] = climb(points[k], tangent(&points, k), voxels, surface);
                }
            }
        }
        smooth(&mut points, join, 6, voxels);
        for (node, point) in traces.nodes[start..end].iter_mut().zip(&points) {
            node.position_mm = *point;
            node.radius_mm = surface.distance(*point);
        }
    }
}

/// Laplacian smoothing; the last point stays, the first one too unless it is attached to `join`.
fn smooth(points: &mut [DVec3], join: Option<TraceNode>, passes: usize, voxels: &Voxels) {
    for _ in 0..passes {
        let old = points.to_vec();
        for k in 0..old.len().saturating_sub(1) {
            let before = if k > 0 { Some(old[k - 1]) } else { join.map(|j| j.position_mm) };
            let Some(before) = before else { continue };
            let moved = 0.5 * old[k] + 0.25 * (before + old[k + 1]);
            if voxels.contains(moved) {
                points[k] = moved;
            }
        }
    }
}

fn tangent(points: &[DVec3], k: usize) -> DVec3 {
    (points[(k + 4).min(points.len() - 1)] - points[k.saturating_sub(4)]).normalize_or(DVec3::Z)
}

/// Pattern search for the largest distance to the wall in the plane across `tangent`.
fn climb(point: DVec3, tangent: DVec3, voxels: &Voxels, surface: &SurfaceDistance) -> DVec3 {
    let (u, v) = tangent.any_orthonormal_pair();
    let (mut best, mut radius) = (point, surface.distance(point));
    let mut step = 0.25 * radius;
    let finest = 0.02 * radius;
    while step > finest {
        let mut found = false;
        for direction in [u, -u, v, -v] {
            let trial = best + direction * step;
            let distance = surface.distance_below(trial, (radius + step) * 1.000_001);
            // a step shorter than the radius cannot cross the wall
            if distance > radius && step < radius {
                (best, radius, found) = (trial, distance, true);
                break;
            }
        }
        if !found || best.distance(point) > 2.0 * voxels.spacing_mm + 0.5 * radius {
            step *= 0.5;
        }
    }
    if voxels.contains(best) { best } else { point }
}

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
    let mut generations: Vec<u32> = Vec::new();
    let mut last_points: Vec<u32> = Vec::new();
    for (index, piece) in pieces.iter().enumerate() {
        let generation = match piece.parent {
            None => 0,
            Some(p) if p > 0 && is_junction(&pieces[p], &traces.nodes) => generations[p],
            Some(p) => generations[p] + 1,
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

/// Marks the nodes of end pieces that are narrower than allowed as dropped; whether there were any.
fn drop_narrow(pieces: &[Piece], nodes: &[TraceNode], minimal_radius_mm: f64, kept: &mut [bool]) -> bool {
    let mut dropped = false;
    for piece in pieces.iter().filter(|p| p.children == 0 && p.parent.is_some()) {
        let mean = piece.nodes.iter().map(|&n| nodes[n as usize].radius_mm).sum::<f64>() / piece.nodes.len() as f64;
        if mean < minimal_radius_mm {
            piece.nodes.iter().for_each(|&n| kept[n as usize] = false);
            dropped = true;
        }
    }
    dropped
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
