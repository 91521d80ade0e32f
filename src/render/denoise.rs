//! Edge-aware filter of the indirect light: the a-trous wavelet filter of Dammertz et al. (HPG 2010), guided by
//! geometry alone (normal, position).
//!
//! What is filtered is smooth over the wall: the light that arrives there from other walls, freed of the wall's own
//! colour and, roughly, of its falloff with the distance from the lamp. Direct light, albedo and vessels pass
//! untouched. Left out: an edge-stopping weight for differences of the filtered light itself; the result is linear in
//! its input.
//!
//! Measured on the reference tube (256x256, six scatterings): image mean 0.2 % too high; mean squared relative error
//! .0044 at 4 samples per pixel (unfiltered .170), .0030 at 16 (.035), where it is nearly all bias.

use glam::DVec3;
use rayon::prelude::*;

/// Passes; the kernel's taps lie 1, 2, 4, ... pixels apart.
const PASSES: u32 = 4;
/// The cubic B-spline's weights at distances 0, 1 and 2.
const KERNEL: [f32; 3] = [0.375, 0.25, 0.0625];
/// Two points belong together up to this distance, as a part of their distance from the camera.
const REACH: f32 = 0.15;
/// The same as a multiple of the distance between neighbouring pixels' points.
const SPACING_REACH: f32 = 3.0;
/// Like `REACH`, for the distance from the other's tangent plane.
const PLANE_REACH: f32 = 0.03;

/// Geometry of every pixel.
pub struct Guides {
    width: usize,
    height: usize,
    position: Vec<[f32; 3]>,
    normal: Vec<[f32; 3]>,
    /// 1 / squared reach along the surface, 1 / squared reach off the tangent plane; zeros where nothing is hit.
    stops: Vec<[f32; 2]>,
    /// Factor that takes the falloff off the light of a lamp at the camera: squared distance plus that of the nearest
    /// walls.
    falloff: Vec<f32>,
}

impl Guides {
    /// `directions` in camera axes through the pixel centres, z-depths (0 = nothing), mean normals (any length).
    pub fn new(width: usize, height: usize, directions: &[DVec3], depth_mm: &[f32], normals: &[[f32; 3]]) -> Self {
        let point = |(d, &z): (&DVec3, &f32)| (*d * (z as f64 / d.z)).to_array().map(|v| v as f32);
        let position: Vec<[f32; 3]> = directions.iter().zip(depth_mm).map(point).collect();
        let stops = (0..position.len()).map(|p| stops(&position, width, height, p)).collect();
        let falloff = falloff(&position);
        let unit = |n: &[f32; 3]| n.map(|v| v / dot(*n, *n).sqrt().max(1e-6));
        Guides { width, height, position, normal: normals.iter().map(unit).collect(), stops, falloff }
    }

    /// Weight in [0, 1] of pixel `q` in the mean of pixel `p`.
    /// `cos^8 / (1 + d^2 / along^2 + h^2 / off^2)^2`: cosine between the normals, distance d, height h above p's
    /// tangent plane, and the reaches of p (`stops`).
    fn affinity(&self, p: usize, q: usize) -> f32 {
        let [along, off] = self.stops[p];
        if along == 0.0 || self.stops[q][0] == 0.0 {
            return 0.0;
        }
        let alike = dot(self.normal[p], self.normal[q]).max(0.0);
        let (a, b) = (self.position[p], self.position[q]);
        let apart: [f32; 3] = std::array::from_fn(|c| b[c] - a[c]);
        let from_plane = dot(apart, self.normal[p]);
        let near_enough = 1.0 / (1.0 + dot(apart, apart) * along + from_plane * from_plane * off);
        alike.powi(8) * near_enough * near_enough
    }
}

/// Inverse squared reaches of a pixel, along the surface and off it.
fn stops(position: &[[f32; 3]], width: usize, height: usize, p: usize) -> [f32; 2] {
    let here = position[p];
    let square = dot(here, here);
    if square == 0.0 {
        return [0.0; 2];
    }
    // Far down a lumen neighbouring pixels are far apart: their distance (that of the nearest one, which lies on this
    // side of an edge) counts as near.
    let (x, y) = (p % width, p / width);
    let mut spacing = f32::INFINITY;
    for (dx, dy) in [(-1, 0), (1, 0), (0, -1), (0, 1)] {
        let (Some(qx), Some(qy)) = (x.checked_add_signed(dx), y.checked_add_signed(dy)) else { continue };
        if qx < width && qy < height {
            let there = position[qy * width + qx];
            let apart: [f32; 3] = std::array::from_fn(|c| there[c] - here[c]);
            spacing = spacing.min(dot(apart, apart));
        }
    }
    let spacing = if spacing.is_finite() { spacing } else { 0.0 };
    let along = REACH * REACH * square + SPACING_REACH * SPACING_REACH * spacing;
    let off = PLANE_REACH * PLANE_REACH * square + 0.1 * SPACING_REACH * SPACING_REACH * spacing;
    [1.0 / along, 1.0 / off]
}

/// Squared distances plus their 5th percentile, which stands for the nearest walls.
fn falloff(position: &[[f32; 3]]) -> Vec<f32> {
    let squares: Vec<f32> = position.iter().map(|p| dot(*p, *p)).collect();
    let mut sorted: Vec<f32> = squares.iter().copied().filter(|&s| s > 0.0).collect();
    sorted.sort_by(f32::total_cmp);
    let near = sorted.get(sorted.len() / 20).copied().unwrap_or(1.0);
    squares.iter().map(|s| s + near).collect()
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// The filtered `light`, one RGB value per pixel.
pub fn denoised_indirect(guides: &Guides, mut light: Vec<[f32; 3]>) -> Vec<[f32; 3]> {
    let scale = |light: &mut [[f32; 3]], by: &dyn Fn(f32) -> f32| {
        light.iter_mut().zip(&guides.falloff).for_each(|(l, &f)| *l = l.map(|v| v * by(f)));
    };
    // Take the lamp's falloff off, filter with growing steps, and put it on again.
    scale(&mut light, &|f| f);
    for pass in 0..PASSES {
        let step = 1isize << pass;
        light = (0..guides.height)
            .into_par_iter()
            .flat_map_iter(|y| {
                let light = &light;
                (0..guides.width).map(move |x| filtered_pixel(guides, light, x, y, step))
            })
            .collect();
    }
    scale(&mut light, &|f| 1.0 / f);
    light
}

fn filtered_pixel(guides: &Guides, light: &[[f32; 3]], x: usize, y: usize, step: isize) -> [f32; 3] {
    let p = y * guides.width + x;
    let (mut sum, mut weights) = (light[p].map(|v| v * KERNEL[0] * KERNEL[0]), KERNEL[0] * KERNEL[0]);
    for dy in -2isize..=2 {
        let Some(qy) = y.checked_add_signed(dy * step).filter(|&v| v < guides.height) else { continue };
        for dx in -2isize..=2 {
            let Some(qx) = x.checked_add_signed(dx * step).filter(|&v| v < guides.width) else { continue };
            let q = qy * guides.width + qx;
            if q == p {
                continue;
            }
            let weight = KERNEL[dx.unsigned_abs()] * KERNEL[dy.unsigned_abs()] * guides.affinity(p, q);
            weights += weight;
            for c in 0..3 {
                sum[c] += weight * light[q][c];
            }
        }
    }
    sum.map(|v| v / weights)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::{CounterRng, Stage};

    /// A wall at z = 10 on the left, at z = 30 on the right.
    fn step_guides(side: usize) -> Guides {
        let pixel = |p: usize| DVec3::new((p % side) as f64 / side as f64 - 0.5, (p / side) as f64 / side as f64, 1.0);
        let directions: Vec<DVec3> = (0..side * side).map(pixel).collect();
        let depth: Vec<f32> = (0..side * side).map(|p| if p % side < side / 2 { 10.0 } else { 30.0 }).collect();
        Guides::new(side, side, &directions, &depth, &vec![[0.0, 0.0, -1.0]; side * side])
    }

    #[test]
    fn noise_goes_and_the_edge_stays() {
        let side = 48;
        let mut rng = CounterRng::new(5, Stage::Test, &[]);
        let truth = |p: usize| if p % side < side / 2 { 1.0 } else { 3.0 };
        let noisy: Vec<[f32; 3]> = (0..side * side).map(|p| [truth(p) + 0.5 * rng.normal() as f32; 3]).collect();
        let filtered = denoised_indirect(&step_guides(side), noisy);
        let error = |p: usize| (filtered[p][0] - truth(p)).powi(2);
        let rms = ((0..side * side).map(error).sum::<f32>() / (side * side) as f32).sqrt();
        assert!(rms < 0.08, "{rms} left of 0.5");
    }

    #[test]
    fn light_that_falls_off_with_distance_stays_as_it_is() {
        let guides = step_guides(16);
        let field: Vec<[f32; 3]> = guides.falloff.iter().map(|f| [40.0 / f, 20.0 / f, 0.0]).collect();
        let filtered = denoised_indirect(&guides, field.clone());
        for (a, b) in filtered.iter().zip(&field) {
            assert!((a[0] - b[0]).abs() < 1e-6 * b[0] && (a[1] - b[1]).abs() < 1e-6 * b[1] && a[2] == 0.0);
        }
    }
}
