//! The scope's route: from the trachea along the centreline to a seeded end, carried by the airway as it breathes.
//!
//! The centreline is a tree, so the shortest route is the chain of parents. A route ends where the lumen, at
//! inspiration or at expiration, gets narrower than the scope. The chain is resampled by arc length at inspiration;
//! positions are smoothed a little and the optical axis a lot (Gaussians over arc length), with the same weights in
//! both breath holds, so a pose at phase alpha is a pose on the centreline of the mesh at alpha. The image's up is
//! carried along without twist, starting from the patient's front. How the scope leaves the route: `steering.rs`. Left
//! out: the scope's own weight and bending.

use glam::{DAffine3, DVec3};
use rayon::prelude::*;

use crate::airway::Anatomy;
use crate::airway::case::{Region, TrajectorySettings};
use crate::airway::centerline::LungSide;
use crate::base::camera::world_from_camera_looking;
use crate::base::random::{CounterRng, Stage};
use crate::base::{Error, Result, mesh};

/// Spacing of the resampled route, and widths of the two smoothings, mm.
const SPACING_MM: f64 = 0.5;
const POSITION_SIGMA_MM: f64 = 2.0;
const AXIS_SIGMA_MM: f64 = 5.0;
/// The route stops this far before the closed end of the last branch.
const END_MARGIN_MM: f64 = 14.0;
/// The route starts this far below the trachea's cut top.
const START_MARGIN_MM: f64 = 6.0;
/// Among the ends in the wanted region, one is drawn from those whose route has at least this part of the longest
/// route's length.
const LONG_ENOUGH: f64 = 0.75;
/// Phases, evenly spaced, at which the clearance of the whole route is measured.
const CHECKED_PHASES: [f64; 5] = [0.0, 0.25, 0.5, 0.75, 1.0];

/// A smooth route through the lumen, known in both breath holds.
#[derive(Clone, Debug)]
pub struct Route {
    inspiration: Vec<DVec3>,
    expiration: Vec<DVec3>,
    axis_inspiration: Vec<DVec3>,
    axis_expiration: Vec<DVec3>,
    up: Vec<DVec3>,
    /// Distance in mm to the nearest vertex of the wall at each of [`CHECKED_PHASES`].
    clearance_mm: [Vec<f64>; CHECKED_PHASES.len()],
    /// Generation of the airway at each sample.
    generation: Vec<u32>,
}

impl Route {
    /// Plans the route of `settings` through `anatomy`.
    ///
    /// Errors: no branch of the wanted region is wide enough for the scope.
    pub fn plan(anatomy: &Anatomy, settings: &TrajectorySettings) -> Result<Route> {
        let (chain, passable_mm) = choose_chain(anatomy, settings)?;
        // Smoothed as far as the branch goes, so that the route's last axis still points ahead.
        let mut route = Route::along(anatomy, &chain);
        route.measure_clearance(anatomy);
        let good = route.wide_stretch(settings.scope_radius_mm, passable_mm);
        if good.len() < (10.0 / SPACING_MM) as usize {
            return Err(Error::input(format!(
                "a scope of radius {} mm has less than 10 mm of way in this airway",
                settings.scope_radius_mm
            ))
            .element("trajectory.scope_radius_mm"));
        }
        Ok(route.part(good))
    }

    /// Length in mm at inspiration.
    pub fn length_mm(&self) -> f64 {
        (self.inspiration.len() - 1) as f64 * SPACING_MM
    }

    /// Camera pose in the scanner's frame, `arc_mm` along the route, in the airway at `phase`.
    pub fn pose(&self, arc_mm: f64, phase: f64) -> DAffine3 {
        self.pose_carried(arc_mm, |rest, other| rest.lerp(other, phase))
    }

    /// [`Route::pose`] where `carried` says where a point is that lies here at inspiration and there at expiration.
    pub fn pose_carried(&self, arc_mm: f64, carried: impl Fn(DVec3, DVec3) -> DVec3) -> DAffine3 {
        let at = |points: &[DVec3], arc_mm: f64| {
            let t = (arc_mm / SPACING_MM).clamp(0.0, (points.len() - 1) as f64);
            let i = (t.floor() as usize).min(points.len() - 2);
            points[i].lerp(points[i + 1], t - i as f64)
        };
        let axis = |arc_mm: f64| carried(at(&self.axis_inspiration, arc_mm), at(&self.axis_expiration, arc_mm));
        let origin = carried(at(&self.inspiration, arc_mm), at(&self.expiration, arc_mm));
        let last = self.length_mm() - 1.0;
        let forward = axis(arc_mm.min(last) + 1.0) - axis(arc_mm.min(last).max(1.0) - 1.0);
        world_from_camera_looking(origin, forward, at(&self.up, arc_mm))
    }

    /// Distance in mm from the route to the nearest vertex of the wall, `arc_mm` along it, in the airway at `phase`.
    pub fn clearance_mm(&self, arc_mm: f64, phase: f64) -> f64 {
        let last = self.inspiration.len() - 1;
        let place = (arc_mm / SPACING_MM).clamp(0.0, last as f64);
        let sample = (place.floor() as usize).min(last - 1);
        let along = |at_phase: &[f64]| lerp(at_phase[sample], at_phase[sample + 1], place - sample as f64);
        let step = phase.clamp(0.0, 1.0) * (CHECKED_PHASES.len() - 1) as f64;
        let low = (step.floor() as usize).min(CHECKED_PHASES.len() - 2);
        lerp(along(&self.clearance_mm[low]), along(&self.clearance_mm[low + 1]), step - low as f64)
    }

    /// Points of the route at inspiration from `from_mm` to `to_mm` along it.
    pub fn points_between(&self, from_mm: f64, to_mm: f64) -> &[DVec3] {
        let sample = |arc_mm: f64| ((arc_mm / SPACING_MM).round().max(0.0) as usize).min(self.inspiration.len() - 1);
        &self.inspiration[sample(from_mm)..=sample(to_mm).max(sample(from_mm))]
    }

    /// Generation of the airway at `arc_mm`.
    pub fn generation(&self, arc_mm: f64) -> u32 {
        self.generation[((arc_mm / SPACING_MM).round().max(0.0) as usize).min(self.generation.len() - 1)]
    }

    /// How far the end of the route moves between the breath holds, mm.
    pub fn end_motion_mm(&self) -> f64 {
        let last = self.inspiration.len() - 1;
        self.inspiration[last].distance(self.expiration[last])
    }

    fn along(anatomy: &Anatomy, chain: &[usize]) -> Route {
        let rest: Vec<DVec3> = chain.iter().map(|&i| anatomy.centerline.points[i].position_mm).collect();
        let other: Vec<DVec3> = chain.iter().map(|&i| anatomy.centerline_expiration[i]).collect();
        let mut arc = vec![0.0];
        for w in rest.windows(2) {
            arc.push(arc[arc.len() - 1] + w[0].distance(w[1]));
        }
        let count = (arc[arc.len() - 1] / SPACING_MM).floor() as usize + 1;
        let (mut inspiration, mut expiration, mut generation) = (Vec::new(), Vec::new(), Vec::new());
        let mut segment = 0;
        for sample in 0..count {
            let s = sample as f64 * SPACING_MM;
            while segment + 2 < arc.len() && arc[segment + 1] < s {
                segment += 1;
            }
            let width = arc[segment + 1] - arc[segment];
            let t = if width > 0.0 { ((s - arc[segment]) / width).clamp(0.0, 1.0) } else { 0.0 };
            inspiration.push(rest[segment].lerp(rest[segment + 1], t));
            expiration.push(other[segment].lerp(other[segment + 1], t));
            generation.push(anatomy.centerline.points[chain[segment + 1]].generation);
        }
        let axis_inspiration = smoothed(&inspiration, AXIS_SIGMA_MM);
        Route {
            up: carried_up(&axis_inspiration),
            axis_expiration: smoothed(&expiration, AXIS_SIGMA_MM),
            axis_inspiration,
            inspiration: smoothed(&inspiration, POSITION_SIGMA_MM),
            expiration: smoothed(&expiration, POSITION_SIGMA_MM),
            clearance_mm: Default::default(),
            generation,
        }
    }

    fn measure_clearance(&mut self, anatomy: &Anatomy) {
        self.clearance_mm = CHECKED_PHASES.map(|phase| {
            let wall = mesh::interpolate(&anatomy.inspiration.vertices, &anatomy.expiration.vertices, phase);
            let here = |sample: usize| self.inspiration[sample].lerp(self.expiration[sample], phase);
            (0..self.inspiration.len()).into_par_iter().map(|sample| nearest_mm(&wall, here(sample))).collect()
        });
    }

    /// The stretch, from the trachea on, in which the scope keeps clear of the wall at every checked phase.
    fn wide_stretch(&self, scope_radius_mm: f64, passable_mm: f64) -> std::ops::Range<usize> {
        let passable = (passable_mm / SPACING_MM).floor() as usize + 1;
        let mut wide = vec![true; passable.min(self.inspiration.len())];
        for clearance_mm in &self.clearance_mm {
            for (wide, clearance_mm) in wide.iter_mut().zip(clearance_mm) {
                *wide &= *clearance_mm >= scope_radius_mm;
            }
        }
        let start = (START_MARGIN_MM / SPACING_MM) as usize;
        let start = (start..wide.len()).find(|&i| wide[i]).unwrap_or(wide.len());
        let narrow = (start..wide.len()).find(|&i| !wide[i]).unwrap_or(wide.len());
        start..narrow
    }

    fn part(&self, range: std::ops::Range<usize>) -> Route {
        let cut = |points: &[DVec3]| points[range.clone()].to_vec();
        Route {
            inspiration: cut(&self.inspiration),
            expiration: cut(&self.expiration),
            axis_inspiration: cut(&self.axis_inspiration),
            axis_expiration: cut(&self.axis_expiration),
            up: cut(&self.up),
            clearance_mm: self.clearance_mm.each_ref().map(|at_phase| at_phase[range.clone()].to_vec()),
            generation: self.generation[range].to_vec(),
        }
    }
}

/// A reachable end.
struct RouteEnd {
    /// Centreline points from the inlet to the end of the branch.
    chain: Vec<usize>,
    /// The last of them that the scope can pass.
    last: usize,
    length_mm: f64,
}

/// Distance in mm from `point` to the nearest of the wall's vertices.
pub fn nearest_mm(wall: &[DVec3], point: DVec3) -> f64 {
    wall.iter().map(|v| v.distance_squared(point)).fold(f64::INFINITY, f64::min).sqrt()
}

/// Indices of centreline points from the inlet through the chosen end to the end of its branch, and the length in mm
/// that the scope can pass.
fn choose_chain(anatomy: &Anatomy, settings: &TrajectorySettings) -> Result<(Vec<usize>, f64)> {
    let points = &anatomy.centerline.points;
    let carina_mm = anatomy.centerline.carina_mm().unwrap_or_default();
    let mut ends: Vec<RouteEnd> = Vec::new();
    for leaf in anatomy.centerline.leaves() {
        let chain = chain_to(anatomy, leaf);
        let way = passable(anatomy, &chain, settings.scope_radius_mm);
        let Some(&last) = way.last() else { continue };
        let length_mm = way.windows(2).map(|w| points[w[0]].position_mm.distance(points[w[1]].position_mm)).sum();
        if way.len() > 1 && !ends.iter().any(|other| other.last == last) {
            ends.push(RouteEnd { chain, last, length_mm });
        }
    }
    let only_lung = anatomy.centerline.only_lung();
    let place = |end: &RouteEnd| points[end.last].position_mm - carina_mm;
    let deepest = ends.iter().map(|end| -place(end).z).fold(0.0, f64::max);
    ends.retain(|end| {
        let from_carina = place(end);
        let right = only_lung.map_or(from_carina.x < 0.0, |side| side == LungSide::Right);
        let lower = -from_carina.z > 0.5 * deepest;
        match settings.region {
            Region::Any => true,
            Region::RightUpper => right && !lower,
            Region::RightLower => right && lower,
            Region::LeftUpper => !right && !lower,
            Region::LeftLower => !right && lower,
        }
    });
    let longest = ends.iter().map(|end| end.length_mm).fold(0.0, f64::max);
    ends.retain(|end| end.length_mm >= LONG_ENOUGH * longest);
    let wanted_side = match settings.region {
        Region::Any => None,
        Region::RightUpper | Region::RightLower => Some(LungSide::Right),
        Region::LeftUpper | Region::LeftLower => Some(LungSide::Left),
    };
    if let (Some(only), Some(wanted)) = (only_lung, wanted_side)
        && only != wanted
    {
        let [there, absent] = if only == LungSide::Right { ["right", "left"] } else { ["left", "right"] };
        return Err(Error::input(format!("all branches lie in the {there} lung, and none in the {absent} one"))
            .element("trajectory.region"));
    }
    if ends.is_empty() {
        let (there, key) = match settings.region {
            Region::Any => ("no branch", "trajectory.scope_radius_mm"),
            _ => ("no branch there", "trajectory.region"),
        };
        let sentence = format!(
            "{there} is long and wide enough for a scope of {} mm radius, which ends {END_MARGIN_MM} mm before a branch does",
            settings.scope_radius_mm
        );
        return Err(Error::input(sentence).element(key));
    }
    let drawn = CounterRng::new(settings.seed, Stage::Trajectory, &[]).index(ends.len());
    let end = ends.swap_remove(drawn);
    Ok((end.chain, end.length_mm))
}

fn chain_to(anatomy: &Anatomy, leaf: usize) -> Vec<usize> {
    let mut chain = vec![leaf];
    while let Some(parent) = anatomy.centerline.points[chain[chain.len() - 1]].parent {
        chain.push(parent as usize);
    }
    chain.reverse();
    chain
}

/// The front part of `chain` that the scope can pass, the closed ends of the airway left alone.
fn passable(anatomy: &Anatomy, chain: &[usize], scope_radius_mm: f64) -> Vec<usize> {
    let points = &anatomy.centerline.points;
    let leaf = points[chain[chain.len() - 1]].position_mm;
    let narrow = |i: usize| points[i].radius_mm.min(anatomy.radius_expiration_mm[i]) < scope_radius_mm;
    // Near the trachea's cut top the inscribed sphere touches the cap: that is no narrowing.
    let first = chain.iter().position(|&i| !narrow(i)).unwrap_or(chain.len());
    let stop = (first..chain.len()).find(|&k| narrow(chain[k])).unwrap_or(chain.len());
    let mut way = chain[..stop].to_vec();
    while way.last().is_some_and(|&i| points[i].position_mm.distance(leaf) < END_MARGIN_MM) {
        way.pop();
    }
    way
}

fn lerp(from: f64, to: f64, part: f64) -> f64 {
    from + (to - from) * part
}

/// Gaussian average over arc length; at the ends the kernel is cut symmetrically, so that they stay in place.
fn smoothed(points: &[DVec3], sigma_mm: f64) -> Vec<DVec3> {
    let widest = (3.0 * sigma_mm / SPACING_MM).ceil() as usize;
    (0..points.len())
        .map(|i| {
            let reach = widest.min(i).min(points.len() - 1 - i);
            let (mut sum, mut total) = (DVec3::ZERO, 0.0);
            for j in i - reach..=i + reach {
                let d = (j as f64 - i as f64) * SPACING_MM / sigma_mm;
                let weight = (-0.5 * d * d).exp();
                sum += points[j] * weight;
                total += weight;
            }
            sum / total
        })
        .collect()
}

/// The image's up at each sample: the patient's front (LPS: -y) at the start, then carried without twist.
fn carried_up(axis: &[DVec3]) -> Vec<DVec3> {
    let mut up = DVec3::NEG_Y;
    (0..axis.len())
        .map(|i| {
            let tangent = (axis[(i + 1).min(axis.len() - 1)] - axis[i.saturating_sub(1)]).normalize_or_zero();
            up = up.reject_from(if tangent == DVec3::ZERO { DVec3::NEG_Z } else { tangent });
            up = up.try_normalize().unwrap_or_else(|| tangent.any_orthonormal_vector());
            up
        })
        .collect()
}
