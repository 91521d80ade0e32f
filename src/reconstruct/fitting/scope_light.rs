//! The shade of a patch of wall, i.e. its brightness relative to its colour, under the light at the tip of the scope
//! (paper, Section 4: a co-located light), in the encoded (sRGB) values in which methods compare images:
//! `(d0 / d)^p ((c + k) / (1 + k))^(p / 2)` with `d` the distance to the scope, `c` the cosine of incidence,
//! `p` the exponent of the fall-off (2 / 2.2 for the inverse square through the sRGB curve, less where light
//! between walls adds to it) and `k` the share of light from the other walls. Left out: shadows (a light at the
//! camera casts none that it could see) and gloss.

use glam::Vec3;
use rayon::prelude::*;

use crate::splat::{Gaussians, Shape, View};

/// Distance in mm at which a surface facing the scope has shade 1.
const REFERENCE_MM: f32 = 10.0;
/// Smallest distance in mm; nearer surfaces are shaded as if they were there.
const NEAREST_MM: f32 = 0.5;
/// Gaussians per task, at least.
const PIECE: usize = 1024;
/// Encoded value from which on a channel counts as clipped: what it shows is at least so bright.
pub const CLIPPED: f32 = 0.98;

/// Light at the scope.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScopeLight {
    eye: Vec3,
    exponent: f32,
    indirect: f32,
    exposure: f32,
}

/// The shade of a Gaussian.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shade {
    /// Factor from its encoded colour to what is shown.
    pub value: f32,
    /// Relative change of that factor per unit of phase.
    pub relative_slope: f32,
}

impl ScopeLight {
    /// The light of the scope at `view`; with `exponent` 0 every shade is 1.
    pub fn new(view: &View, exponent: f64, indirect_share: f64) -> Self {
        ScopeLight {
            eye: view.camera_from_world.inverse().translation.as_vec3(),
            exponent: exponent as f32,
            indirect: indirect_share as f32,
            exposure: 1.0,
        }
    }

    /// The same light at an `exposure` that makes every shade this many times as bright.
    pub fn exposed(self, exposure: f64) -> Self {
        ScopeLight { exposure: exposure as f32, ..self }
    }

    /// One shade per Gaussian. `velocities` are mm per unit of phase (empty: slopes are 0); the slope leaves out the
    /// rotation of the normals. Ellipsoids have no normal: their incidence counts as perpendicular.
    pub fn shades(&self, gaussians: &Gaussians<f32>, velocities: &[[f32; 3]], out: &mut Vec<Shade>) {
        let velocity = |i: usize| velocities.get(i).map_or(Vec3::ZERO, |v| Vec3::from(*v));
        let centers = gaussians.positions.par_iter().with_min_len(PIECE).enumerate();
        match &gaussians.shape {
            Shape::Discs { axes } => {
                let shade = |((i, p), [a, b]): ((usize, &[f32; 3]), &[[f32; 3]; 2])| {
                    let normal = Vec3::from(*a).cross(Vec3::from(*b)).normalize_or_zero();
                    self.shade(Vec3::from(*p), Some(normal), velocity(i))
                };
                centers.zip(axes).map(shade).collect_into_vec(out);
            }
            Shape::Ellipsoids { .. } => {
                centers.map(|(i, p)| self.shade(Vec3::from(*p), None, velocity(i))).collect_into_vec(out);
            }
        }
    }

    /// The shade of one Gaussian at `centre` moving with `velocity`; without a `normal` it faces the scope.
    pub fn shade(&self, centre: Vec3, normal: Option<Vec3>, velocity: Vec3) -> Shade {
        let offset = centre - self.eye;
        let distance = offset.length().max(NEAREST_MM);
        let towards = offset / distance;
        let away = towards.dot(velocity);
        let mut shown = REFERENCE_MM / distance;
        let mut slope = -away / distance;
        if let Some(normal) = normal {
            let along = normal.dot(towards);
            let lit = (along.abs() + self.indirect).max(1e-3);
            shown *= (lit / (1.0 + self.indirect)).sqrt();
            slope += 0.5 * along.signum() * normal.dot(velocity - towards * away) / distance / lit;
        }
        // An exponent of 1 is common, and this runs for every disc in every step.
        let value = if self.exponent == 1.0 { shown } else { shown.powf(self.exponent) };
        Shade { value: value * self.exposure, relative_slope: self.exponent * slope }
    }
}

#[cfg(test)]
mod tests {
    use glam::{DAffine3, DVec3};

    use super::*;
    use crate::base::Camera;

    fn disc(at: Vec3) -> Gaussians<f32> {
        let mut g = Gaussians::discs(1, 1, 1.0);
        g.positions[0] = at.to_array();
        g.shape = Shape::Discs { axes: vec![[[1.0, 0.2, 0.1], [0.0, 1.0, 0.3]]] };
        g
    }

    #[test]
    fn twice_as_far_upright_is_a_quarter_in_linear_light() {
        let camera = Camera::pinhole(64, 64, 90f64.to_radians());
        let view = View::new(camera, DAffine3::from_translation(DVec3::new(1.0, 2.0, 3.0)));
        let light = ScopeLight::new(&view, 2.0, 0.0);
        let (mut near, mut far) = (Vec::new(), Vec::new());
        let mut g = disc(Vec3::new(1.0, 2.0, 13.0));
        g.shape = Shape::Discs { axes: vec![[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]] };
        light.shades(&g, &[], &mut near);
        g.positions[0][2] = 23.0;
        light.shades(&g, &[], &mut far);
        assert!((near[0].value - 1.0).abs() < 1e-6 && (far[0].value - 0.25).abs() < 1e-6);
    }

    #[test]
    fn the_slope_is_the_difference_quotient() {
        let camera = Camera::pinhole(64, 64, 90f64.to_radians());
        let light = ScopeLight::new(&View::new(camera, DAffine3::IDENTITY), 0.75, 0.5);
        let (at, velocity, h) = (Vec3::new(3.0, -1.0, 9.0), Vec3::new(-2.0, 1.5, 3.0), 1e-2);
        let mut shades = Vec::new();
        light.shades(&disc(at), &[velocity.to_array()], &mut shades);
        let value = |p: Vec3| {
            let mut out = Vec::new();
            light.shades(&disc(p), &[], &mut out);
            out[0].value
        };
        let quotient = (value(at + velocity * h) - value(at - velocity * h)) / (2.0 * h) / shades[0].value;
        assert!((quotient - shades[0].relative_slope).abs() < 1e-3, "{quotient} {}", shades[0].relative_slope);
    }
}
