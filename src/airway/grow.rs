//! A bronchial tree grown from a seed by published rules, down to the bronchi a bronchoscope reaches.
//!
//! After Kitaoka, Takaki and Suki, J Appl Physiol 87:2207 (1999). Symbols: `d` diameter, `n` flow exponent, `r` the
//! smaller share of the parent's flow, `theta` angle between a child and its parent. Rule by rule:
//!
//! - Branching is dichotomous; parent and children lie in one plane; the next plane is turned by 90 degrees (Kitaoka 1,
//!   2, 8).
//! - The plane through the parent's axis across the branching plane parts the supplied region; flow is the part of its
//!   volume (Kitaoka 3, 4, 5; `GrowthRegion`).
//! - `Q ~ d^n`, n = 2.8: a child's diameter goes with the n-th root of its share (Kitaoka 3, 6).
//! - `cos theta = (1 + r^(4/n) - (1-r)^(4/n)) / (2 r^(2/n))`, and with r and 1-r exchanged; at most 62 degrees (Kitaoka
//!   6, from least volume; Kamiya and Togawa 1972).
//! - Mean diameter ratio and length over diameter of generations 0 to 6: Horsfield's tree at a lung volume of 3300 ml
//!   (replaces Kitaoka 7, `L = 3 d`, which is wrong for generations 2 to 4).
//! - Children turn towards the middle of what they supply and stay inside it (Kitaoka's complementary rules; the turn
//!   as in Tawhai et al., J Appl Physiol 97:2310, 2004).
//! - The right main bronchus is wider, steeper and shorter than the left (anatomy; diameters follow from the lungs'
//!   volumes).
//!
//! Own additions: seeded variation; a bifurcation that would bring a branch near another is tried again with another
//! plane and shorter children, and finally left out, so that the surface of the tree has no loop. Left out: acini,
//! curved lobar fissures, everything beyond the reach of a scope.

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::grow_region::GrowthRegion;
use super::grow_shape::{Shoot, keeps_clear, shoot_points};
use super::tree::{Branch, Tree};
use crate::base::Result;
use crate::base::random::{CounterRng, Stage};
use crate::base::range::{KeyRanges, NumberRange};

/// Ranges of `[anatomy.growth]`.
const RANGES: KeyRanges = KeyRanges(&[
    ("trachea_diameter_mm", NumberRange::new(6.0, 30.0)),
    ("trachea_length_mm", NumberRange::new(30.0, 200.0)),
    ("lung_size", NumberRange::new(0.5, 1.6)),
    ("flow_exponent", NumberRange::new(2.0, 4.0)),
    ("deepest_generation", NumberRange::new(1.0, 12.0)),
    ("minimal_radius_mm", NumberRange::new(0.5, 6.0)),
    ("variation", NumberRange::new(0.0, 0.2)),
]);

/// Mean child-over-parent diameter by the generation of the child (Horsfield-based tree, 3300 ml; beyond the table the
/// homothety 2^(-1/3)).
const DIAMETER_RATIO: [f64; 7] = [1.0, 0.73, 0.71, 0.72, 0.72, 0.82, 0.81];
/// Mean length over diameter by generation (same tree).
const LENGTH_OVER_DIAMETER: [f64; 7] = [5.5, 3.2, 1.8, 1.4, 2.1, 2.3, 2.3];
/// Length of the right and left main bronchus over the mean of the two, and their angles to the vertical in degrees.
const MAIN_LENGTH: [f64; 2] = [0.68, 1.28];
const MAIN_ANGLE_DEG: [f64; 2] = [29.0, 43.0];
/// Widest angle between a child and its parent, and narrowest between siblings, in degrees.
const WIDEST_DEG: f64 = 62.0;
const NARROWEST_DEG: f64 = 48.0;
/// Smallest share of the flow that makes a branch of its own.
const LEAST_SHARE: f64 = 0.12;
/// Attempts at a bifurcation before the branch is left undivided.
const ATTEMPTS: u64 = 32;

/// What to grow.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GrowthSettings {
    /// Diameter of the trachea in mm.
    pub trachea_diameter_mm: f64,
    /// Length of the trachea in mm.
    pub trachea_length_mm: f64,
    /// Size of the lungs over those of an average adult (a length).
    pub lung_size: f64,
    /// Exponent `n` of the law between flow and diameter.
    pub flow_exponent: f64,
    /// Last generation that is grown (0 is the trachea).
    pub deepest_generation: u32,
    /// Branches with a smaller radius than this, in mm, are not grown.
    pub minimal_radius_mm: f64,
    /// Relative standard deviation of lengths and diameters.
    pub variation: f64,
}

impl Default for GrowthSettings {
    fn default() -> Self {
        GrowthSettings {
            trachea_diameter_mm: 16.5,
            trachea_length_mm: 91.0,
            lung_size: 1.0,
            flow_exponent: 2.8,
            deepest_generation: 6,
            minimal_radius_mm: 1.2,
            variation: 0.08,
        }
    }
}

impl GrowthSettings {
    /// Rejects what no lungs could be; the element names the key, `prefix` before it.
    pub fn validate(&self, prefix: &str) -> Result<()> {
        RANGES.check(prefix, self)
    }
}

/// `theta` in radians of the child with share `share` of the flow (rule 6).
fn branching_angle(share: f64, n: f64) -> f64 {
    let (own, other) = (share.powf(4.0 / n), (1.0 - share).powf(4.0 / n));
    ((1.0 + own - other) / (2.0 * share.powf(2.0 / n))).clamp(WIDEST_DEG.to_radians().cos(), 1.0).acos()
}

fn of_generation(table: &[f64; 7], beyond: f64, generation: u32) -> f64 {
    table.get(generation as usize).copied().unwrap_or(beyond)
}

/// The direction nearest to `wanted` that lies within `most` radians of the unit vector `axis`.
fn within_angle(wanted: DVec3, axis: DVec3, most: f64) -> DVec3 {
    let sideways = (wanted - axis * wanted.dot(axis)).normalize_or_zero();
    if wanted.angle_between(axis) <= most || sideways == DVec3::ZERO {
        return wanted.normalize();
    }
    axis * most.cos() + sideways * most.sin()
}

/// Turns two unit vectors apart in their plane until the angle between them is `least` radians.
fn spread(a: DVec3, b: DVec3, least: f64) -> [DVec3; 2] {
    let across = (a - b).normalize_or_zero();
    let along = (a + b).normalize_or_zero();
    if a.angle_between(b) >= least || across == DVec3::ZERO || along == DVec3::ZERO {
        return [a, b];
    }
    let (sin, cos) = (0.5 * least).sin_cos();
    [along * cos + across * sin, along * cos - across * sin]
}

/// A finished branch that may still divide.
struct Tip {
    /// Index of the branch.
    branch: usize,
    radius_mm: f64,
    direction: DVec3,
    /// Unit vector in the branching plane, across `direction`.
    across: DVec3,
    region: GrowthRegion,
}

/// A planned child, not yet known to keep clear of the other branches.
struct BranchPlan {
    shoot: Shoot,
    across: DVec3,
    region: GrowthRegion,
}

struct Grower<'a> {
    settings: &'a GrowthSettings,
    seed: u64,
    tree: Tree,
}

impl Grower<'_> {
    fn vary(&self, rng: &mut CounterRng) -> f64 {
        (self.settings.variation * rng.normal().clamp(-2.0, 2.0)).exp()
    }

    fn child_radius(&self, parent_mm: f64, share: f64, generation: u32, rng: &mut CounterRng) -> f64 {
        let mean = of_generation(&DIAMETER_RATIO, 0.79, generation);
        let varied = mean * (2.0 * share).powf(1.0 / self.settings.flow_exponent) * self.vary(rng);
        parent_mm * varied.min(0.97)
    }

    fn child_length(&self, radius_mm: f64, generation: u32, rng: &mut CounterRng) -> f64 {
        2.0 * radius_mm * of_generation(&LENGTH_OVER_DIAMETER, 2.4, generation) * self.vary(rng)
    }

    /// The two main bronchi: one lung each, in the frontal plane.
    fn plan_main(&self, tip: &Tip, joint: DVec3, rng: &mut CounterRng) -> Option<Vec<BranchPlan>> {
        let [right, left] = tip.region.split(joint, DVec3::NEG_X)?;
        let whole = (right.share() + left.share()).max(1e-9);
        let plans = [right, left].into_iter().enumerate().map(|(side, region)| {
            let sign = if side == 0 { -1.0 } else { 1.0 };
            let angle = (MAIN_ANGLE_DEG[side] * self.vary(rng)).to_radians();
            let direction = DVec3::new(sign * angle.sin(), 0.12 + 0.05 * rng.normal(), -angle.cos()).normalize();
            let radius_mm = self.child_radius(tip.radius_mm, region.share() / whole, 1, rng);
            let length_mm = self.child_length(radius_mm, 1, rng) * MAIN_LENGTH[side];
            BranchPlan {
                shoot: Shoot { from: joint, parent_direction: tip.direction, direction, length_mm, radius_mm },
                across: DVec3::Y,
                region,
            }
        });
        Some(plans.collect())
    }

    /// Rules 2 to 8 for every generation below the main bronchi; `turn` turns the branching plane, `shorter` shortens.
    fn plan(&self, tip: &Tip, joint: DVec3, turn: f64, shorter: f64, rng: &mut CounterRng) -> Option<Vec<BranchPlan>> {
        let generation = self.tree.branches[tip.branch].generation + 1;
        let n = self.settings.flow_exponent;
        // The branching plane, and the two regions that it splits (rules 2 to 5).
        let upright = (tip.across - tip.direction * tip.across.dot(tip.direction)).normalize_or(DVec3::Y);
        let across = upright * turn.cos() + tip.direction.cross(upright) * turn.sin();
        let regions = tip.region.split(joint, across)?;
        let whole = regions[0].share() + regions[1].share();
        // Angles from the flow's shares (rule 6), turned towards the middle of each region.
        let directions = [0, 1].map(|side| {
            let share = regions[side].share() / whole;
            let sign = if side == 0 { 1.0 } else { -1.0 };
            let (sin, cos) = branching_angle(share, n).sin_cos();
            let by_rule = tip.direction * cos + across * (sign * sin);
            let to_middle = (regions[side].middle() - joint).normalize_or(by_rule);
            within_angle((by_rule + 0.45 * to_middle).normalize_or(by_rule), tip.direction, WIDEST_DEG.to_radians())
        });
        let directions = spread(directions[0], directions[1], NARROWEST_DEG.to_radians());
        // Diameters and lengths; every child must carry enough flow and end inside the lungs.
        let next_across = tip.direction.cross(across);
        let mut plans = Vec::new();
        for (region, direction) in regions.into_iter().zip(directions) {
            let share = region.share() / whole;
            if share < LEAST_SHARE {
                return None;
            }
            let radius_mm = self.child_radius(tip.radius_mm, share, generation, rng);
            if radius_mm < self.settings.minimal_radius_mm {
                continue;
            }
            let length_mm = (self.child_length(radius_mm, generation, rng) * shorter).max(2.2 * radius_mm);
            let shoot = Shoot { from: joint, parent_direction: tip.direction, direction, length_mm, radius_mm };
            if !region.lungs().contain(shoot.end()) {
                return None;
            }
            plans.push(BranchPlan { shoot, across: next_across, region });
        }
        // A lone child would be a kink, not a bifurcation.
        (plans.len() == 2).then_some(plans)
    }

    /// The children of `tip`, or none where no attempt keeps clear of the rest of the tree.
    fn divide(&mut self, tip: &Tip) -> Vec<Tip> {
        let parent = &self.tree.branches[tip.branch];
        let generation = parent.generation + 1;
        let joint = parent.position(parent.points_mm.len() - 1);
        for attempt in 0..ATTEMPTS {
            let mut rng = CounterRng::new(self.seed, Stage::Tree, &[tip.branch as u64 + 1, attempt]);
            let turn = rng.normal().clamp(-2.0, 2.0) * (0.15 + 0.06 * attempt as f64);
            let shorter = 1.0 - 0.4 * attempt as f64 / ATTEMPTS as f64;
            let plans = match generation {
                1 => self.plan_main(tip, joint, &mut rng),
                _ => self.plan(tip, joint, turn, shorter, &mut rng),
            };
            let Some(plans) = plans else { continue };
            let points: Vec<_> = plans.iter().map(|p| shoot_points(&p.shoot)).collect();
            if points.iter().any(|p| !keeps_clear(&self.tree, tip.branch, p)) {
                continue;
            }
            let mut tips = Vec::new();
            for (plan, points_mm) in plans.into_iter().zip(points) {
                tips.push(Tip {
                    branch: self.tree.branches.len(),
                    radius_mm: plan.shoot.radius_mm,
                    direction: plan.shoot.direction,
                    across: plan.across,
                    region: plan.region,
                });
                self.tree.branches.push(Branch { parent: Some(tip.branch as u32), generation, points_mm });
            }
            return tips;
        }
        Vec::new()
    }
}

/// Grows a tree: LPS axes, carina at the origin, trachea upwards. Same seed and settings, same tree.
///
/// # Errors
/// A setting outside of its sensible range; the error names it.
pub fn grow(seed: u64, settings: &GrowthSettings) -> Result<Tree> {
    settings.validate("anatomy.growth")?;
    let radius_mm = 0.5 * settings.trachea_diameter_mm;
    // The trachea leans back on its way down.
    let direction = DVec3::new(0.0, 0.22, -1.0).normalize();
    let from = -direction * settings.trachea_length_mm;
    let trachea =
        Shoot { from, parent_direction: direction, direction, length_mm: settings.trachea_length_mm, radius_mm };
    let source = format!(
        "grown, seed {seed}: rules of Kitaoka et al., J Appl Physiol 87:2207 (1999), diameters and lengths after \
         Horsfield's tree; LPS, mm, carina at the origin"
    );
    let branch = Branch { parent: None, generation: 0, points_mm: shoot_points(&trachea) };
    let mut grower = Grower { settings, seed, tree: Tree { source, branches: vec![branch] } };
    let region = GrowthRegion::both_lungs(seed, settings.lung_size);
    let mut tips = vec![Tip { branch: 0, radius_mm, direction, across: DVec3::X, region }];
    for _ in 0..settings.deepest_generation {
        tips = tips.iter().flat_map(|tip| grower.divide(tip)).collect();
    }
    Ok(grower.tree)
}

#[cfg(test)]
#[path = "grow_tests.rs"]
mod tests;
