//! What each pixel of the last pass sees, splat after splat: the images that are asked for once, not in an optimisation
//! (depth of the surface, median depth, number of contributors). Plain code, forward only.

use glam::DVec2;
use rayon::prelude::*;

use crate::base::{Error, Result};
use crate::ffi::splat::rasterize::Aligned;

use crate::splat::number::real::Real;
use crate::splat::pass::bins::Bins;
use crate::splat::pass::rasterizer::Rasterizer;
use crate::splat::plain::disc::{Disc, Optics};
use crate::splat::plain::disc_tile;
use crate::splat::plain::surface_depth::Body;
use crate::splat::plain::tile::{PIXELS, alpha_at};
use crate::splat::types::scene::{DepthOutput, Footprint, Gaussians, Settings, View};

/// One splat that a pixel blends.
struct Glance {
    /// What it adds to the pixel: alpha times the light before it.
    weight: f64,
    /// z-depth in mm where the ray meets it.
    depth: f64,
    /// Light behind it.
    left: f64,
}

/// Where on the ray a splat stands.
enum Surfaces<'a, T> {
    /// Nobody asks.
    None,
    /// Bodies of the splats of an affine projection.
    Bodies(Vec<Option<Body>>),
    /// Exact discs.
    Discs(&'a [Aligned<T>], Optics<'a, T>),
}

struct Sight<'a, T> {
    rows: &'a [Aligned<T>],
    bins: &'a Bins,
    view: View,
    surfaces: Surfaces<'a, T>,
}

impl<T: Real> Sight<'_, T> {
    /// Calls `visit` for every splat that the pixel `(x, y)` blends, front to back, while it gives back `true`.
    fn walk(&self, tile: usize, p: usize, [x, y]: [usize; 2], mut visit: impl FnMut(Glance) -> bool) {
        let bins = self.bins;
        let corner = bins.tiling.corner(tile);
        let ray = self.view.camera.direction(DVec2::new(x as f64 + 0.5, y as f64 + 0.5)).to_array();
        let ray_of_type = ray.map(T::of);
        let mut left = 1.0;
        let block = 1u16 << (p / 16);
        for at in bins.offsets[tile] as usize..bins.offsets[tile + 1] as usize {
            // Of the pass before: splats that cannot touch this block of pixels, or that it met too late.
            if bins.masks_known && bins.masks[at] & block == 0 {
                continue;
            }
            let j = bins.entries[at] as usize;
            let row = &self.rows[j].0;
            let found = match &self.surfaces {
                Surfaces::None => alpha_at(row, corner, p).map(|alpha| (alpha.to_f64(), 0.0)),
                Surfaces::Bodies(bodies) => alpha_at(row, corner, p)
                    .zip(bodies[j].as_ref())
                    .map(|(alpha, body)| (alpha.to_f64(), body.depth(ray))),
                Surfaces::Discs(discs, optics) => {
                    disc_tile::sample(row, &Disc::unpack(&discs[j]), optics, [x, y], ray_of_type)
                        .map(|seen| (seen.alpha.to_f64(), seen.depth.to_f64()))
                }
            };
            let Some((alpha, depth)) = found else { continue };
            let next = left * (1.0 - alpha);
            if next <= 1e-4 {
                break;
            }
            let glance = Glance { weight: left * alpha, depth, left: next };
            left = next;
            if !visit(glance) {
                break;
            }
        }
    }

    /// One value per pixel, row by row.
    fn image<V: Send + Copy + Default>(&self, value: impl Fn(usize, usize, [usize; 2]) -> V + Sync) -> Vec<V> {
        let size = self.view.size();
        let tiling = self.bins.tiling;
        let tiles: Vec<Vec<([usize; 2], V)>> = (0..tiling.count())
            .into_par_iter()
            .map(|t| {
                let seen = |p: usize| tiling.pixel(t, p, size).map(|pixel| (pixel, value(t, p, pixel)));
                (0..PIXELS).filter_map(seen).collect()
            })
            .collect();
        let mut out = vec![V::default(); size[0] * size[1]];
        for ([x, y], value) in tiles.into_iter().flatten() {
            out[y * size[0] + x] = value;
        }
        out
    }

    /// Mean depth, weighted like the image; 0 where nothing is.
    fn surface(&self, tile: usize, p: usize, pixel: [usize; 2]) -> f64 {
        let (mut sum, mut weights) = (0.0, 0.0);
        self.walk(tile, p, pixel, |glance| {
            sum += glance.weight * glance.depth;
            weights += glance.weight;
            true
        });
        if weights > 0.0 { sum / weights } else { 0.0 }
    }

    /// Depth of the splat behind which no more than half of the light is left; 0 where there is none.
    fn median(&self, tile: usize, p: usize, pixel: [usize; 2]) -> f64 {
        let mut median = 0.0;
        self.walk(tile, p, pixel, |glance| {
            if glance.left <= 0.5 {
                median = glance.depth;
            }
            glance.left > 0.5
        });
        median
    }
}

impl<T: Real> Rasterizer<T> {
    fn sight<'a>(&'a self, view: &View, settings: &Settings, bodies: Option<Vec<Option<Body>>>) -> Sight<'a, T> {
        let surfaces = match (settings.footprint, bodies) {
            (Footprint::Disc, _) => Surfaces::Discs(&self.discs, self.optics(view, settings)),
            (Footprint::Ewa, Some(bodies)) => Surfaces::Bodies(bodies),
            (Footprint::Ewa, None) => Surfaces::None,
        };
        Sight { rows: &self.rows, bins: &self.bins, view: *view, surfaces }
    }

    /// Fills the depth image, where it is not composited with the colours.
    pub(in crate::splat) fn fill_depth(&mut self, gaussians: &Gaussians<T>, view: &View, settings: &Settings) {
        let exact = settings.footprint == Footprint::Disc;
        let median = settings.depth == DepthOutput::Median;
        if !median && (exact || settings.depth != DepthOutput::Surface) {
            return;
        }
        let bodies = (!exact).then(|| self.bodies(gaussians, view));
        let sight = self.sight(view, settings, bodies);
        let depth = sight
            .image(|t, p, pixel| T::of(if median { sight.median(t, p, pixel) } else { sight.surface(t, p, pixel) }));
        self.rendered.depth = depth;
        self.depth_is_zero = false;
    }

    fn bodies(&self, gaussians: &Gaussians<T>, view: &View) -> Vec<Option<Body>> {
        let active = self.active.as_deref();
        let mut needed = vec![false; self.rendered.visible.len()];
        self.bins.entries.iter().for_each(|&e| needed[e as usize] = true);
        let body = |(j, &seen): (usize, &bool)| {
            seen.then(|| Body::of(gaussians, active.map_or(j, |list| list[j] as usize), view))
        };
        needed.par_iter().enumerate().map(body).collect()
    }

    /// How many Gaussians each pixel of the last [`Rasterizer::render`] blends, row by row (`height * width`).
    ///
    /// Errors: no render before.
    pub fn contributors(&self) -> Result<Vec<u32>> {
        let (view, settings, _) = self.last.ok_or_else(|| Error::input("contributors need a render before them"))?;
        let sight = self.sight(&view, &settings, None);
        Ok(sight.image(|t, p, pixel| {
            let mut count = 0;
            sight.walk(t, p, pixel, |_| {
                count += 1;
                true
            });
            count
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::Camera;
    use crate::splat::types::scene::Shape;
    use glam::DAffine3;

    /// Three panes before the camera: a quarter, half, three quarters of what is left.
    #[test]
    fn median_and_count_of_three_panes() {
        let mut scene = Gaussians::<f64>::discs(3, 0, 0.0);
        scene.positions = vec![[0.0, 0.0, 2.0], [0.0, 0.0, 3.0], [0.0, 0.0, 5.0]];
        scene.opacities = vec![0.25, 0.5, 0.75];
        scene.shape = Shape::Discs { axes: vec![[[100.0, 0.0, 0.0], [0.0, 100.0, 0.0]]; 3] };
        let view = View::new(Camera::pinhole(20, 17, 1.0), DAffine3::IDENTITY);
        for footprint in [Footprint::Ewa, Footprint::Disc] {
            let settings = Settings { depth: DepthOutput::Median, footprint, ..Settings::default() };
            let mut rasterizer = Rasterizer::<f64>::new();
            assert!(rasterizer.contributors().is_err());
            let center = 8 * 20 + 10;
            let depth_at = |rasterizer: &mut Rasterizer<f64>, scene: &Gaussians<f64>| {
                rasterizer.render(scene, &view, &settings, None).unwrap().depth[center]
            };
            // 1, .75, .375: half of the light is gone behind the second pane.
            assert!((depth_at(&mut rasterizer, &scene) - 3.0).abs() < 1e-9);
            assert!(rasterizer.contributors().unwrap().iter().all(|&count| count == 3));
            let mut thin = scene.clone();
            thin.opacities = vec![0.25, 0.2, 0.1];
            assert_eq!(depth_at(&mut rasterizer, &thin), 0.0);
            thin.opacities[2] = 0.5;
            assert!((depth_at(&mut rasterizer, &thin) - 5.0).abs() < 1e-9);
            thin.opacities[1] = 1.0 / 300.0;
            depth_at(&mut rasterizer, &thin);
            assert_eq!(rasterizer.contributors().unwrap()[center], 2);
        }
    }
}
