//! Moves traced paths to the middle of the lumen: where the distance to the wall is greatest in the plane across the
//! tube, all but a little, which the line takes to be smooth.
//!
//! The exact middle of a lumen with a rough wall wiggles by some hundredths of a millimetre from point to point, and a
//! line smoothed freely cuts the bends, where its spheres are several per cent too small. So smoothing and centring
//! take turns until the line is nearly there; then every node gets its own middle, and the last smoothing goes only as
//! far as the node's sphere stays within [`SLACK`] of the one there.

use glam::DVec3;
use rayon::prelude::*;

use super::centerline_distance::SurfaceDistance;
use super::centerline_trace::{TraceNode, Traces};
use super::centerline_voxels::Voxels;
use crate::base::{Progress, Result};

/// Rounds of smoothing and centring.
const ROUNDS: usize = 3;
/// Passes of smoothing in each round, and of the last one.
const PASSES: usize = 6;
const LAST_PASSES: usize = 40;
/// Share of the greatest distance to the wall that a node may give up for a smoother line. With 1 % the line turns as
/// much from point to point as the one that VMTK takes from the Voronoi diagram.
const SLACK: f64 = 0.01;
/// Farthest that the last centring moves a node, in its radii: what lies farther away is another branch.
const LAST_REACH: f64 = 0.25;
/// Shortest step of the search for the middle, in radii, in each round and at last.
const STEP: f64 = 0.02;
const LAST_STEP: f64 = 0.005;
/// Halvings of the way from a smoothed place to the middle.
const HALVINGS: usize = 6;

/// Moves every node to the middle of its cross-section, path by path, and smooths the paths. No node leaves the lumen.
///
/// Errors: `progress` stops the work.
pub fn centre(traces: &mut Traces, voxels: &Voxels, surface: &SurfaceDistance, progress: &dyn Progress) -> Result<()> {
    let paths = traces.starts.len() - 1;
    for path in 0..paths {
        progress.proceed()?;
        progress.advance(path, paths);
        let (start, end) = (traces.starts[path] as usize, traces.starts[path + 1] as usize);
        let join = traces.nodes.get(traces.nodes[start].parent as usize).copied();
        let points = traces.nodes[start..end].iter().map(|n| n.position_mm).collect();
        let mut path = Path { points, join, voxels, surface };
        for _ in 0..ROUNDS {
            path.smooth();
            path.centre();
        }
        path.smooth();
        path.settle();
        for (node, point) in traces.nodes[start..end].iter_mut().zip(&path.points) {
            node.position_mm = *point;
            node.radius_mm = surface.distance(*point);
        }
    }
    Ok(())
}

/// The nodes between a tip and where the path meets another, and what they lie in.
struct Path<'a> {
    points: Vec<DVec3>,
    join: Option<TraceNode>,
    voxels: &'a Voxels,
    surface: &'a SurfaceDistance,
}

/// The middle of the lumen in the plane across the path at a node.
struct Middle {
    position_mm: DVec3,
    radius_mm: f64,
    tangent: DVec3,
}

impl Path<'_> {
    /// Laplacian smoothing; the last point stays, the first one too unless it is attached to the node of another path.
    fn smooth(&mut self) {
        for _ in 0..PASSES {
            for (k, moved) in self.smoothed().into_iter().enumerate() {
                if self.voxels.contains(moved) {
                    self.points[k] = moved;
                }
            }
        }
    }

    /// Where one pass of smoothing would have the points.
    fn smoothed(&self) -> Vec<DVec3> {
        let points = &self.points;
        let place = |k: usize| {
            let before = if k > 0 { Some(points[k - 1]) } else { self.join.map(|j| j.position_mm) };
            match (before, points.get(k + 1)) {
                (Some(before), Some(after)) => 0.5 * points[k] + 0.25 * (before + *after),
                _ => points[k],
            }
        };
        (0..points.len()).map(place).collect()
    }

    /// Moves the points to the middle one after the other.
    fn centre(&mut self) {
        for k in 0..self.points.len() {
            if !self.is_inside_parent(k) {
                let reach_mm = 2.0 * self.voxels.spacing_mm + 0.5 * self.surface.distance(self.points[k]);
                self.points[k] = self.middle(k, reach_mm, STEP).position_mm;
            }
        }
    }

    /// Smooths the points as far as they stay near the middle.
    fn settle(&mut self) {
        let middle = |k: usize| {
            let reach_mm = LAST_REACH * self.surface.distance(self.points[k]);
            (!self.is_inside_parent(k)).then(|| self.middle(k, reach_mm, LAST_STEP))
        };
        let middles: Vec<Option<Middle>> = (0..self.points.len()).into_par_iter().map(middle).collect();
        for _ in 0..LAST_PASSES {
            for (k, moved) in self.smoothed().into_iter().enumerate() {
                match &middles[k] {
                    Some(middle) => self.points[k] = self.towards(moved, middle),
                    None if self.voxels.contains(moved) => self.points[k] = moved,
                    None => {}
                }
            }
        }
    }

    /// The place nearest to `from` on the way to the middle that is near enough to it.
    fn towards(&self, from: DVec3, middle: &Middle) -> DVec3 {
        let from = from - middle.tangent * (from - middle.position_mm).dot(middle.tangent);
        let least = (1.0 - SLACK) * middle.radius_mm;
        let suffices = |share: f64| self.surface.is_farther(from.lerp(middle.position_mm, share), least);
        if suffices(0.0) && self.voxels.contains(from) {
            return from;
        }
        let (mut low, mut high) = (0.0, 1.0);
        for _ in 0..HALVINGS {
            let share = 0.5 * (low + high);
            if suffices(share) { high = share } else { low = share }
        }
        from.lerp(middle.position_mm, high)
    }

    /// Whether a point lies in the sphere of the node that the path is attached to: there the middle is the parent's.
    fn is_inside_parent(&self, k: usize) -> bool {
        self.join.is_some_and(|j| j.position_mm.distance(self.points[k]) < j.radius_mm)
    }

    fn tangent(&self, k: usize) -> DVec3 {
        let points = &self.points;
        (points[(k + 4).min(points.len() - 1)] - points[k.saturating_sub(4)]).normalize_or(DVec3::Z)
    }

    /// Pattern search for the largest distance to the wall in the plane across the path, in steps down to `finest` radii.
    /// Diagonal steps climb the ridges between two walls, on which a search along two axes stops.
    fn middle(&self, k: usize, reach_mm: f64, finest: f64) -> Middle {
        let (point, tangent) = (self.points[k], self.tangent(k));
        let (u, v) = tangent.any_orthonormal_pair();
        let (p, q) = ((u + v) * std::f64::consts::FRAC_1_SQRT_2, (u - v) * std::f64::consts::FRAC_1_SQRT_2);
        let (mut best, mut radius) = (point, self.surface.distance(point));
        let finest = finest * radius;
        let mut step = 0.25 * radius;
        while step > finest {
            // A step shorter than the radius cannot cross the wall.
            let better = [u, -u, v, -v, p, -p, q, -q].iter().find_map(|&direction| {
                let trial = best + direction * step;
                if trial.distance(point) > reach_mm {
                    return None;
                }
                let distance = self.surface.distance_between(trial, radius, (radius + step) * 1.000_001)?;
                Some((trial, distance))
            });
            match better {
                Some(found) => (best, radius) = found,
                None => step *= 0.5,
            }
        }
        if !self.voxels.contains(best) {
            (best, radius) = (point, self.surface.distance(point));
        }
        Middle { position_mm: best, radius_mm: radius, tangent }
    }
}
