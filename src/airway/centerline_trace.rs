//! Centred minimal paths: from every tip of the lumen back to the inlet.
//!
//! Dijkstra from the inlet over the 26-neighbourhood, once with plain lengths (its local maxima are the tips) and once
//! with `step / distance_to_wall^2` (its paths keep to the middle). The tips are followed from the farthest to the
//! nearest, each until it comes near a path already followed. After Antiga and Steinman's centrelines as minimal paths
//! (2003), on voxels instead of a Voronoi diagram.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use glam::DVec3;

use super::centerline_voxels::{NONE, Voxels};
use crate::base::statistics::upper_median;
use crate::base::{Progress, Result};

/// A path has met another when it enters this share of the inscribed ball of one of its nodes.
const MEETING: f64 = 0.7;
/// A side path counts from this many radii of the path it leaves.
const LEAVING: f64 = 1.2;
/// The same within a radius of the inlet, where the corners of the cap look like short branches.
const LEAVING_INLET: f64 = 2.5;
/// The part of a side path beyond the wall of its parent must be longer than this many of its own mean radii.
pub(super) const PROTRUSION: f64 = 1.5;
/// A path ends where the lumen has narrowed to this share of the path's usual radius.
const NARROWED: f64 = 0.6;
/// Voxels between two looks at whether the user has stopped the work.
const WATCHED_VOXELS: usize = 1 << 16;

/// One node of the traced tree.
#[derive(Clone, Copy, Debug)]
pub struct TraceNode {
    /// Position in mm.
    pub position_mm: DVec3,
    /// Distance in mm to the wall.
    pub radius_mm: f64,
    /// Next node towards the inlet, always a smaller index; [`NONE`] for node 0.
    pub parent: u32,
}

/// The traced tree: nodes, parents first, and the first node of every path.
pub struct Traces {
    /// All nodes; node 0 is the inlet.
    pub nodes: Vec<TraceNode>,
    /// Path `p` has the nodes `starts[p]..starts[p + 1]`; the last entry is the number of nodes.
    pub starts: Vec<u32>,
}

/// Follows all tips back to `inlet`; side paths with a mean radius below `minimal_radius_mm` are left out.
///
/// Errors: `progress` stops the work.
pub fn trace(voxels: &Voxels, inlet: u32, minimal_radius_mm: f64, progress: &dyn Progress) -> Result<Traces> {
    let neighbours = voxels.neighbours();
    let (lengths, _) = shortest_paths(voxels, &neighbours, inlet, |_| 1.0, progress)?;
    let centring = |v: u32| 1.0 / (voxels.distance_mm[v as usize].powi(2) + 1e-3);
    let (_, towards_inlet) = shortest_paths(voxels, &neighbours, inlet, centring, progress)?;
    let mut tracer = VoxelTracer::new(voxels, towards_inlet);
    let tips = tips(&neighbours, &lengths);
    for (done, &tip) in tips.iter().enumerate() {
        progress.proceed()?;
        progress.advance(done, tips.len());
        tracer.follow(tip, minimal_radius_mm);
    }
    Ok(Traces { nodes: tracer.nodes, starts: tracer.starts })
}

/// Cost of the cheapest path from `start` to each voxel and the voxel before it; infinite and [`NONE`] out of reach.
fn shortest_paths(
    voxels: &Voxels,
    neighbours: &[[u32; 26]],
    start: u32,
    weight: impl Fn(u32) -> f64,
    progress: &dyn Progress,
) -> Result<(Vec<f64>, Vec<u32>)> {
    let mut cost = vec![f64::INFINITY; voxels.len()];
    let mut before = vec![NONE; voxels.len()];
    cost[start as usize] = 0.0;
    // the bits of non-negative floats are ordered as the floats are
    let mut queue = BinaryHeap::from([Reverse((0u64, start))]);
    let mut looked = 0;
    while let Some(Reverse((bits, v))) = queue.pop() {
        looked += 1;
        if looked % WATCHED_VOXELS == 0 {
            progress.proceed()?;
        }
        let here = f64::from_bits(bits);
        if here > cost[v as usize] {
            continue;
        }
        let (center, weight_here) = (voxels.center(v), weight(v));
        for &n in neighbours[v as usize].iter().take_while(|n| **n != NONE) {
            let there = here + voxels.center(n).distance(center) * 0.5 * (weight_here + weight(n));
            if there < cost[n as usize] {
                cost[n as usize] = there;
                before[n as usize] = v;
                queue.push(Reverse((there.to_bits(), n)));
            }
        }
    }
    Ok((cost, before))
}

/// Local maxima of the reachable `lengths`, the farthest first.
fn tips(neighbours: &[[u32; 26]], lengths: &[f64]) -> Vec<u32> {
    let key = |v: u32| (lengths[v as usize].to_bits(), v);
    let mut tips: Vec<u32> = (0..lengths.len() as u32)
        .filter(|&v| lengths[v as usize].is_finite())
        .filter(|&v| neighbours[v as usize].iter().take_while(|n| **n != NONE).all(|&n| key(n) < key(v)))
        .collect();
    tips.sort_by_key(|&v| Reverse(key(v)));
    tips
}

struct VoxelTracer<'a> {
    voxels: &'a Voxels,
    towards_inlet: Vec<u32>,
    nodes: Vec<TraceNode>,
    starts: Vec<u32>,
    /// The nearest node whose ball takes in the voxel, and how far it is.
    owner: Vec<(u32, f64)>,
}

impl<'a> VoxelTracer<'a> {
    fn new(voxels: &'a Voxels, towards_inlet: Vec<u32>) -> Self {
        let owner = vec![(NONE, f64::INFINITY); voxels.len()];
        Self { voxels, towards_inlet, nodes: Vec::new(), starts: vec![0], owner }
    }

    /// Follows one tip back and keeps the path if it is a branch and no bump of the wall.
    fn follow(&mut self, tip: u32, minimal_radius_mm: f64) {
        let (mut path, join) = self.walk_back(tip);
        self.trim(&mut path);
        if path.is_empty() || join.is_some_and(|join| !self.is_branch(&path, join, minimal_radius_mm)) {
            return;
        }
        let mut parent = join.unwrap_or(NONE);
        for &v in path.iter().rev() {
            let (position_mm, radius_mm) = (self.voxels.center(v), self.voxels.distance_mm[v as usize]);
            let index = self.nodes.len() as u32;
            self.nodes.push(TraceNode { position_mm, radius_mm, parent });
            self.claim_ball(index);
            parent = index;
        }
        self.starts.push(self.nodes.len() as u32);
    }

    /// The voxels from `tip` to the last free one, and the node met (none: the inlet was reached).
    fn walk_back(&self, tip: u32) -> (Vec<u32>, Option<u32>) {
        let mut path = Vec::new();
        let mut v = tip;
        while v != NONE {
            let met = self.owner[v as usize].0;
            if met != NONE {
                return (path, Some(met));
            }
            path.push(v);
            v = self.towards_inlet[v as usize];
        }
        (path, None)
    }

    /// Takes the narrow end off a path that begins at its tip, against the wall.
    fn trim(&self, path: &mut Vec<u32>) {
        let radii = path.iter().take(30).map(|&v| self.voxels.distance_mm[v as usize]);
        let Some(usual) = upper_median(radii) else { return };
        let narrow = path.iter().take_while(|&&v| self.voxels.distance_mm[v as usize] < NARROWED * usual).count();
        path.drain(..narrow);
    }

    /// Long enough beside its parent, and wide enough. Voxel centres miss the axis by up to half a diagonal, so the
    /// width is judged leniently here and again on the centred points.
    fn is_branch(&self, path: &[u32], join: u32, minimal_radius_mm: f64) -> bool {
        let parent = self.nodes[join as usize];
        let points = || path.iter().map(|&v| self.voxels.center(v)).chain([parent.position_mm]);
        let length: f64 = points().zip(points().skip(1)).map(|(a, b)| a.distance(b)).sum();
        let radius = |v: &u32| self.voxels.distance_mm[*v as usize];
        let beyond =
            path.iter().take_while(|v| self.voxels.center(**v).distance(parent.position_mm) > parent.radius_mm);
        let radii: Vec<f64> = beyond.map(radius).collect();
        if radii.is_empty() {
            return false;
        }
        let mean = radii.iter().sum::<f64>() / radii.len() as f64;
        let at_inlet = parent.position_mm.distance(self.nodes[0].position_mm) < parent.radius_mm;
        let leaving = if at_inlet { LEAVING_INLET } else { LEAVING };
        let parent_radius = self.radius_before(join);
        let length = length + radius(&path[0]);
        length > leaving * parent_radius
            && length - parent_radius > PROTRUSION * mean
            && length - parent_radius > 0.5 * parent_radius.min(3.0 * mean)
            && mean > 0.6 * minimal_radius_mm
    }

    /// The largest radius along the last one and a half radii before `node`: at a path's end its own radius has
    /// shrunk against the wall, and the corners of a flat end would pass for branches.
    fn radius_before(&self, node: u32) -> f64 {
        let mut largest = self.nodes[node as usize].radius_mm;
        let (mut here, mut passed) = (self.nodes[node as usize], 0.0);
        while here.parent != NONE && passed < 1.5 * largest {
            let before = self.nodes[here.parent as usize];
            passed += before.position_mm.distance(here.position_mm);
            largest = largest.max(before.radius_mm);
            here = before;
        }
        largest
    }

    fn claim_ball(&mut self, index: u32) {
        let node = self.nodes[index as usize];
        let reach = MEETING * node.radius_mm.max(self.voxels.spacing_mm);
        for v in self.voxels.in_ball(node.position_mm, reach) {
            let distance = self.voxels.center(v).distance(node.position_mm);
            if distance < self.owner[v as usize].1 {
                self.owner[v as usize] = (index, distance);
            }
        }
    }
}
