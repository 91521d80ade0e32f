//! Change of calibre with breathing: every airway shrinks around its own centreline, the trachea's back wall bulges in.
//!
//! A point x belongs to a soft mean of the centreline: weights w_k = l_k exp(-K (|x - p_k| / r_k)^2) over centreline
//! points p_k with radius r_k and arc length l_k give the axis point p(x), radius r(x), generation g(x) and tangent.
//! Then
//!
//!   s(x) = (rho(g) - 1) (x - p)  +  b(g) r * back(x) * forwards
//!
//! rho is the diameter at expiration over that at inspiration. Because w is Gaussian, dp/dx is (for equal radii) a
//! covariance, so positive semi-definite, and x + s(x) keeps its orientation for any rho in (0, 1], at branchings
//! too; [`super::field_check`] verifies it all the same. Ratios: from lumen areas of COPD subjects (PMC3938549) at
//! FRC over full inspiration. Left out: cartilage, dynamic collapse.

use glam::DVec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::centerline::Centerline;
use crate::base::range::{KeyRanges, NumberRange};
use crate::base::{Error, Result};

/// Ranges of `[breathing.calibre]`.
const RANGES: KeyRanges =
    KeyRanges(&[("diameter_ratio", NumberRange::new(0.3, 1.2)), ("tracheal_invagination", NumberRange::new(0.0, 0.6))]);

/// Sharpness K of the weights: at 4, the axis is averaged over +- 0.35 radii.
const SHARPNESS: f64 = 4.0;
/// Points whose exponent lies this far below the best are ignored (weight below 1e-7).
const EXPONENT_REACH: f64 = 16.0;
/// The trachea's muscular back wall spans this cosine around the backward direction (LPS: +y).
const BACK_COSINE: f64 = 0.35;

/// How calibre changes from inspiration to expiration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Calibre {
    /// Diameter at expiration over diameter at inspiration, for generation 0, 1, 2, ...; the last holds for all beyond.
    pub diameter_ratio: Vec<f64>,
    /// How far the trachea's back wall moves in, as a fraction of the radius; fades out in the main bronchi.
    pub tracheal_invagination: f64,
}

impl Default for Calibre {
    fn default() -> Self {
        Calibre { diameter_ratio: vec![1.0, 0.95, 0.90, 0.86, 0.80, 0.78], tracheal_invagination: 0.25 }
    }
}

impl Calibre {
    /// Rejects ratios that are no calibre; the element names the key.
    pub fn validate(&self) -> Result<()> {
        if self.diameter_ratio.is_empty() {
            return Err(Error::input("needs at least one ratio").element("breathing.calibre.diameter_ratio"));
        }
        RANGES.check("breathing.calibre", self)
    }

    /// Diameter ratio of a (fractional) generation.
    pub fn ratio(&self, generation: f64) -> f64 {
        let last = self.diameter_ratio.len() - 1;
        let below = (generation.max(0.0).floor() as usize).min(last);
        let part = (generation - below as f64).clamp(0.0, 1.0);
        self.diameter_ratio[below] * (1.0 - part) + self.diameter_ratio[(below + 1).min(last)] * part
    }

    /// Displacement of `x` by the change of calibre, given its foot on the centreline.
    pub fn displacement(&self, x: DVec3, axis: &AxisPoint) -> DVec3 {
        let outwards = x - axis.position_mm;
        // (rho(g) - 1) (x - p)
        let mut s = outwards * (self.ratio(axis.generation) - 1.0);
        // The back wall's bulge: full in the trachea, none from generation 2/3 on.
        let trachea = (1.0 - 1.5 * axis.generation).clamp(0.0, 1.0);
        if self.tracheal_invagination > 0.0 && trachea > 0.0 {
            let back = (DVec3::Y - axis.tangent * axis.tangent.y).normalize_or_zero();
            let radial = outwards.reject_from_normalized(axis.tangent);
            let distance = radial.length() / axis.radius_mm;
            let cosine = radial.normalize_or_zero().dot(back);
            let span = smooth_step((cosine - BACK_COSINE) / (1.0 - BACK_COSINE));
            // Zero on the axis, full at the wall, no more outside of it.
            let depth = smooth_step(distance) * smooth_step(trachea) * span;
            s -= back * (self.tracheal_invagination * axis.radius_mm * depth);
        }
        s
    }
}

fn smooth_step(t: f64) -> f64 {
    let t = t.clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// The soft foot of a point on the centreline.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxisPoint {
    /// Mean position on the axis, mm.
    pub position_mm: DVec3,
    /// Mean inscribed radius, mm.
    pub radius_mm: f64,
    /// Mean generation, fractional at branchings.
    pub generation: f64,
    /// Direction of the axis, unit length, away from the inlet.
    pub tangent: DVec3,
}

/// A centreline sampled densely enough to be averaged.
pub struct Axis {
    samples: Vec<AxisSample>,
    /// Spheres around runs of [`RUN`] samples: a whole run is skipped when even its nearest sample could not matter.
    runs: Vec<SampleRun>,
    /// The same around [`RUN`] runs.
    stretches: Vec<SampleRun>,
}

/// Samples per run, and runs per stretch.
const RUN: usize = 16;

struct SampleRun {
    center: DVec3,
    reach: f64,
    sharpness_over_radius2: f64,
}

impl SampleRun {
    fn around(samples: &[AxisSample]) -> SampleRun {
        let center = samples.iter().map(|s| s.position).sum::<DVec3>() / samples.len() as f64;
        let reach = samples.iter().map(|s| s.position.distance(center)).fold(0.0, f64::max);
        let widest = samples.iter().map(|s| s.radius).fold(0.0, f64::max);
        SampleRun { center, reach, sharpness_over_radius2: SHARPNESS / (widest * widest) }
    }

    /// No sample of the run has a smaller exponent at `x`.
    fn least_exponent(&self, x: DVec3) -> f64 {
        let gap = (x.distance(self.center) - self.reach).max(0.0);
        gap * gap * self.sharpness_over_radius2
    }
}

struct AxisSample {
    position: DVec3,
    radius: f64,
    inverse_radius2: f64,
    length: f64,
    generation: f64,
    tangent: DVec3,
}

impl Axis {
    /// Resamples every segment of `centerline` to steps of at most 0.3 radii.
    pub fn new(centerline: &Centerline) -> Self {
        let mut samples = Vec::new();
        for point in &centerline.points {
            let Some(parent) = point.parent else { continue };
            let from = &centerline.points[parent as usize];
            let step = point.position_mm - from.position_mm;
            let length = step.length();
            if length <= 0.0 {
                continue;
            }
            // Mid-points only, so that no position counts twice at a branching.
            let pieces = (length / (0.3 * point.radius_mm.min(from.radius_mm).max(0.2))).ceil().clamp(1.0, 1e4);
            for piece in 0..pieces as usize {
                let t = (piece as f64 + 0.5) / pieces;
                let radius = (from.radius_mm + (point.radius_mm - from.radius_mm) * t).max(0.1);
                samples.push(AxisSample {
                    position: from.position_mm + step * t,
                    radius,
                    inverse_radius2: 1.0 / (radius * radius),
                    length: length / pieces,
                    generation: point.generation as f64,
                    tangent: step / length,
                });
            }
        }
        let around = |count: usize| samples.chunks(count).map(SampleRun::around).collect();
        let (runs, stretches) = (around(RUN), around(RUN * RUN));
        Axis { samples, runs, stretches }
    }

    /// The soft foot of `x`; `None` only for a centreline without length.
    pub fn foot(&self, x: DVec3) -> Option<AxisPoint> {
        let exponent = |s: &AxisSample| (x - s.position).length_squared() * s.inverse_radius2 * SHARPNESS;
        let runs = |stretch: usize| {
            let first = stretch * RUN;
            self.runs.iter().zip(self.samples.chunks(RUN)).skip(first).take(RUN)
        };
        // The least exponent: weights are taken relative to its own, and what is far is skipped.
        let mut best = f64::INFINITY;
        let least: Vec<f64> = self.stretches.iter().map(|stretch| stretch.least_exponent(x)).collect();
        let nearest = (0..least.len()).min_by(|&a, &b| least[a].total_cmp(&least[b]))?;
        for stretch in std::iter::once(nearest).chain(0..least.len()) {
            if least[stretch] < best {
                for (run, samples) in runs(stretch) {
                    if run.least_exponent(x) < best {
                        best = samples.iter().map(exponent).fold(best, f64::min);
                    }
                }
            }
        }
        if !best.is_finite() {
            return None;
        }
        // Weighted means over the samples near it.
        let mut total = 0.0;
        let mut foot = AxisPoint { position_mm: DVec3::ZERO, radius_mm: 0.0, generation: 0.0, tangent: DVec3::ZERO };
        let near = (0..least.len()).filter(|&stretch| least[stretch] < best + EXPONENT_REACH).flat_map(runs);
        let near = near.filter(|(run, _)| run.least_exponent(x) < best + EXPONENT_REACH);
        for sample in near.flat_map(|(_, samples)| samples) {
            let behind = exponent(sample) - best;
            if behind < EXPONENT_REACH {
                let weight = sample.length * (-behind).exp();
                total += weight;
                foot.position_mm += sample.position * weight;
                foot.radius_mm += sample.radius * weight;
                foot.generation += sample.generation * weight;
                foot.tangent += sample.tangent * weight;
            }
        }
        foot.position_mm /= total;
        foot.radius_mm /= total;
        foot.generation /= total;
        foot.tangent = foot.tangent.try_normalize().unwrap_or(DVec3::NEG_Z);
        Some(foot)
    }

    /// [`Axis::foot`] of many points, in parallel, in order; empty for a centreline without length.
    pub fn feet(&self, points: &[DVec3]) -> Vec<AxisPoint> {
        points.par_iter().filter_map(|&x| self.foot(x)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::airway::centerline::CenterlinePoint;

    fn fork() -> Centerline {
        let mut points = Vec::new();
        for i in 0..60u32 {
            points.push(CenterlinePoint {
                position_mm: DVec3::new(0.0, 0.0, -(i as f64)),
                radius_mm: 8.0,
                branch: 0,
                generation: 0,
                parent: i.checked_sub(1),
            });
        }
        for (branch, side) in [(1u32, -1.0), (2, 1.0)] {
            for i in 1..=40u32 {
                let parent = if i == 1 { 59 } else { points.len() as u32 - 1 };
                points.push(CenterlinePoint {
                    position_mm: DVec3::new(side * 0.6 * i as f64, 0.0, -59.0 - 0.8 * i as f64),
                    radius_mm: 5.5,
                    branch,
                    generation: 1,
                    parent: Some(parent),
                });
            }
        }
        Centerline { points }
    }

    #[test]
    fn a_straight_wall_shrinks_by_the_ratio_and_keeps_its_place_along_the_axis() {
        let axis = Axis::new(&fork());
        let calibre = Calibre { diameter_ratio: vec![0.8], tracheal_invagination: 0.0 };
        let wall = DVec3::new(8.0, 0.0, -25.3);
        let s = calibre.displacement(wall, &axis.foot(wall).unwrap());
        assert!((s - DVec3::new(-1.6, 0.0, 0.0)).length() < 1e-3, "{s}");
    }

    #[test]
    fn only_the_back_of_the_trachea_bulges_in() {
        let axis = Axis::new(&fork());
        let calibre = Calibre { diameter_ratio: vec![1.0], tracheal_invagination: 0.25 };
        let at = |x: DVec3| calibre.displacement(x, &axis.foot(x).unwrap());
        assert!((at(DVec3::new(0.0, 8.0, -20.0)) - DVec3::new(0.0, -2.0, 0.0)).length() < 1e-6);
        assert!(at(DVec3::new(0.0, -8.0, -20.0)).length() < 1e-9);
        assert!(at(DVec3::new(0.0, 0.0, -20.0)).length() < 1e-9);
        let bronchus = DVec3::new(18.0, 5.5, -83.0);
        assert!(at(bronchus).length() < 1e-6);
    }

    #[test]
    fn orientation_is_kept_through_a_fork() {
        let axis = Axis::new(&fork());
        let calibre = Calibre::default();
        let map = |x: DVec3| x + calibre.displacement(x, &axis.foot(x).unwrap());
        let h = 1e-4;
        for i in -12..=12 {
            for j in 0..60 {
                let x = DVec3::new(i as f64, 3.1, -45.0 - 0.5 * j as f64);
                let column = |a: DVec3| (map(x + a * h) - map(x - a * h)) / (2.0 * h);
                let det = glam::DMat3::from_cols(column(DVec3::X), column(DVec3::Y), column(DVec3::Z)).determinant();
                assert!(det > 0.2, "{det} at {x}");
            }
        }
    }

    #[test]
    fn ratios_interpolate_and_end() {
        let c = Calibre::default();
        assert_eq!(c.ratio(0.0), 1.0);
        assert!((c.ratio(3.5) - 0.83).abs() < 1e-12);
        assert_eq!(c.ratio(99.0), 0.78);
        let bad = Calibre { diameter_ratio: vec![0.0], ..c };
        assert!(bad.validate().unwrap_err().to_string().contains("diameter_ratio"));
    }
}
