//! What a bronchoscope would see of the CT's surface: the mesh under the light at the scope's tip, without texture.
//! This is the virtual bronchoscopy of navigation systems (Merritt et al., IEEE Trans Med Imaging 32:1434, 2013).
//!
//! The linear radiance of a wall of even colour is `cos / d^2` of the incidence and distance (a lamp at the camera), plus
//! a share for the light of the other walls; an automatic exposure brings the mean encoded brightness to a fixed value.

use glam::Vec3;
use rayon::prelude::*;

use super::breathing::BreathingMesh;
use super::mesh_depth::{PixelRays, faces_before, nearest_faces};
use super::visible::Reach;
use crate::base::color::{SRGB_LINEAR_BELOW, srgb_from_linear};
use crate::base::{Camera, Image};
use crate::splat::View;

/// Linear colour of the wall: mucosa.
const WALL: [f32; 3] = [1.0, 0.42, 0.36];
/// Light that does not depend on the incidence, as a share of that which does.
pub(super) const INDIRECT: f32 = 0.3;
/// Distance in mm below which a wall gets no brighter.
pub(super) const NEAREST_MM: f32 = 1.0;
/// Mean encoded brightness that the exposure aims for, and the doublings and halvings of the gain that look for it.
const BRIGHTNESS: f32 = 0.42;
const GAIN_STEPS: usize = 24;
/// Difference from it within which the mean is taken in full: twenty times what rounding does to a sum over 256 x 256 pixels.
const CLOSE: f32 = 1e-4;

/// Pixels that one thread lights or encodes at a time.
const PIECE: usize = 1024;

/// Linear light, without exposure, of a wall that a lamp `distance` mm away lights at this cosine of incidence `c`:
/// `(c + k) / (1 + k) / d^2`.
pub(super) fn light_of_wall(cosine: f32, distance: f32) -> f32 {
    (cosine + INDIRECT) / (1.0 + INDIRECT) / (distance * distance)
}

/// Colour (encoded, 0..1) and z-depth (mm, 0 where there is no wall) of a virtual view.
#[derive(Clone, Debug)]
pub struct VirtualView {
    /// Colour.
    pub color: Image<f32>,
    /// Depth.
    pub depth_mm: Image<f32>,
}

/// The faces that may be seen from one pose at any phase.
pub struct FacesInView {
    view: View,
    faces: Vec<u32>,
}

/// Renders virtual views of one size.
pub struct VirtualCamera {
    camera: Camera,
    rays: PixelRays,
    reach: Reach,
}

impl VirtualCamera {
    /// With the intrinsics of `camera`.
    pub fn new(camera: Camera, reach: Reach) -> Self {
        VirtualCamera { camera, rays: PixelRays::new(&camera), reach }
    }

    /// What may be seen from `view`, whose intrinsics are replaced by this camera's.
    pub fn aim(&self, view: &View, mesh: BreathingMesh<'_>) -> FacesInView {
        let view = View { camera: self.camera, ..*view };
        let states = [0.0, 0.5, 1.0].map(|phase| mesh.at(phase));
        let states = states.each_ref().map(|state| &state[..]);
        let faces = faces_before(&view, &states, mesh.faces, self.reach.range_mm as f32);
        FacesInView { view, faces }
    }

    /// The view of the airway at `phase`.
    pub fn render(&self, aimed: &FacesInView, mesh: BreathingMesh<'_>, phase: f64) -> VirtualView {
        let vertices = mesh.at(phase);
        let nearest = nearest_faces(&aimed.view, &self.rays, &vertices, mesh.faces, &aimed.faces);
        let camera_from_world = aimed.view.camera_from_world.as_affine3();
        let corner = |v: u32| camera_from_world.transform_point3(Vec3::from(vertices[v as usize]));
        let radiance = |(&(depth, face), ray): (&(f32, u32), &Vec3)| {
            if depth <= 0.0 {
                return 0.0;
            }
            let [a, b, c] = mesh.faces[face as usize].map(corner);
            let normal = (b - a).cross(c - a).normalize_or_zero();
            let distance = (depth * ray.length()).max(NEAREST_MM);
            let cosine = normal.dot(ray.normalize_or_zero()).abs();
            light_of_wall(cosine, distance)
        };
        let light: Vec<f32> = nearest.par_iter().zip(self.rays.rays()).with_min_len(PIECE).map(radiance).collect();
        let color = encoded_colors(&light, exposure(&light));
        let depth = nearest.into_iter().map(|(depth, _)| depth).collect();
        let (width, height) = (self.camera.width as usize, self.camera.height as usize);
        VirtualView {
            color: Image { width, height, channels: 3, data: color },
            depth_mm: Image { width, height, channels: 1, data: depth },
        }
    }
}

/// The colours of walls of this light at a gain, encoded, channels last.
fn encoded_colors(light: &[f32], gain: f32) -> Vec<f32> {
    let mut color = vec![0.0; 3 * light.len()];
    color.par_chunks_mut(3 * PIECE).zip(light.par_chunks(PIECE)).for_each(|(color, light)| {
        for (color, &v) in color.as_chunks_mut::<3>().0.iter_mut().zip(light) {
            *color = WALL.map(|wall| srgb_from_linear(wall * gain * v));
        }
    });
    color
}

/// The gain at which the mean encoded brightness is [`BRIGHTNESS`]; bisection in its logarithm.
fn exposure(light: &[f32]) -> f32 {
    let count = (3 * light.len()).max(1) as f32;
    let mean = |gain: f32| encoded_colors(light, gain).iter().sum::<f32>() / count;
    // A power of a product is the product of powers: with those of the light known, a gain costs one more. Far from the
    // wanted brightness, which most steps are, that is exact enough.
    let powers: Vec<(f32, f32)> = (light.par_iter().with_min_len(PIECE))
        .flat_map_iter(|&v| WALL.map(|wall| wall * v).map(|v| (v, 1.055 * v.powf(1.0 / 2.4))))
        .collect();
    let about = |gain: f32| {
        let factor = gain.powf(1.0 / 2.4);
        let encoded = |&(value, power): &(f32, f32)| match value * gain {
            dark if dark <= SRGB_LINEAR_BELOW => 12.92 * dark,
            v if v < 1.0 => power * factor - 0.055,
            _ => 1.0,
        };
        powers.iter().map(|value| f64::from(encoded(value))).sum::<f64>() as f32 / count
    };
    let (mut low, mut high) = (-5.0f32, 15.0f32);
    for _ in 0..GAIN_STEPS {
        let middle = 0.5 * (low + high);
        let gain = middle.exp();
        let nearly = about(gain);
        let brightness = if (nearly - BRIGHTNESS).abs() > CLOSE { nearly } else { mean(gain) };
        if brightness < BRIGHTNESS { low = middle } else { high = middle }
    }
    (0.5 * (low + high)).exp()
}

#[cfg(test)]
mod tests {
    use glam::{DAffine3, DVec3};

    use super::*;
    use crate::base::random::{CounterRng, Stage};

    #[test]
    fn the_gain_is_that_of_plain_bisection() {
        let mut random = CounterRng::new(1, Stage::Surface, &[]);
        for (count, dark) in [(1, 0.0), (200, 0.0), (4096, 0.3), (20_000, 0.9), (50, 1.0)] {
            let mut value = || if random.uniform() < dark { 0.0 } else { (6.0 * random.normal() - 4.0).exp() as f32 };
            let light: Vec<f32> = (0..count).map(|_| value()).collect();
            let mean = |gain: f32| {
                let sum: f32 = light.iter().flat_map(|&v| WALL.map(|wall| srgb_from_linear(wall * gain * v))).sum();
                sum / (3 * light.len()) as f32
            };
            let (mut low, mut high) = (-5.0f32, 15.0f32);
            for _ in 0..GAIN_STEPS {
                let middle = 0.5 * (low + high);
                if mean(middle.exp()) < BRIGHTNESS { low = middle } else { high = middle }
            }
            assert_eq!(exposure(&light), (0.5 * (low + high)).exp(), "{count} {dark}");
        }
    }

    #[test]
    fn a_flat_wall_is_as_bright_as_its_distance_and_incidence_say() {
        let rest = [[-40.0, -40.0, 10.0], [-40.0, 40.0, 10.0], [40.0, -40.0, 10.0], [40.0, 40.0, 10.0f32]];
        let displacement = [[0.0, 0.0, 10.0f32]; 4];
        let faces = [[0, 1, 2], [2, 1, 3]];
        let mesh = BreathingMesh { rest: &rest, displacement: &displacement, faces: &faces };
        let camera = Camera::pinhole(33, 33, 1.2);
        let virtual_camera = VirtualCamera::new(camera, Reach { margin: 2.0, range_mm: 100.0 });
        let view = View::new(camera, DAffine3::from_translation(DVec3::ZERO));
        let aimed = virtual_camera.aim(&view, mesh);
        for (phase, depth) in [(0.0, 10.0), (0.5, 15.0)] {
            let seen = virtual_camera.render(&aimed, mesh, phase);
            assert!(seen.depth_mm.data.iter().all(|d| (d - depth).abs() < 1e-4));
            let mean = seen.color.data.iter().sum::<f32>() / seen.color.data.len() as f32;
            assert!((mean - BRIGHTNESS).abs() < 1e-3, "{mean}");
            // Relative brightness of the corner against the middle, in linear light.
            let linear = |x: usize, y: usize| crate::base::color::linear_from_srgb(seen.color.pixel(x, y)[1]);
            let ray = camera.direction(glam::DVec2::new(0.5, 0.5));
            let cosine = (ray.z / ray.length()) as f32;
            let expected = (cosine + INDIRECT) / (1.0 + INDIRECT) * cosine * cosine;
            assert!((linear(0, 0) / linear(16, 16) / expected - 1.0).abs() < 1e-2);
        }
    }
}
