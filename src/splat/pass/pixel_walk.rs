//! The splats that each pixel of the last pass blends, in order: for images that are needed once and not in an
//! optimisation (depth of the surface, median depth, number of contributors). Plain code, forward only.

use glam::DVec2;
use rayon::prelude::*;

use crate::splat::number::Real;
use crate::splat::plain::disc::{Disc, DiscOptics};
use crate::splat::plain::surface_depth::SplatSurface;
use crate::splat::plain::{disc_tile, tile};
use crate::splat::types::{GaussianSlices, PIXELS, View};

use super::bins::Bins;
use super::splats::Splats;

/// Pixels of a block of a tile.
const BLOCK: usize = 16;

/// One splat that a pixel blends.
struct BlendedSplat {
    /// Its weight in the pixel: alpha times the transmittance in front of it.
    weight: f64,
    /// z-depth in mm where the ray meets it.
    depth: f64,
    /// Transmittance behind it.
    left: f64,
}

/// A pixel of a tile, and the splats that may touch the block of pixels around it.
pub struct BlockPixel<'a> {
    /// Column and row in the image.
    at: [usize; 2],
    /// Upper left corner of the tile in pixels.
    corner: [usize; 2],
    /// Index in the per-pixel tables of the tile.
    in_tile: usize,
    /// Front to back.
    listed: &'a [u32],
}

/// Source of a splat's position along the ray.
pub enum SurfaceSource<'a, T> {
    /// Not needed.
    None,
    /// The surfaces of the splats of an affine projection.
    Splats(Vec<Option<SplatSurface>>),
    /// Exact discs.
    Discs(DiscOptics<'a, T>),
}

/// The splats of the last pass, to be visited pixel by pixel.
pub struct PixelWalk<'a, T> {
    pub splats: &'a Splats<T>,
    pub bins: &'a Bins,
    pub view: View,
    pub surfaces: SurfaceSource<'a, T>,
}

/// The surfaces of all splats that are in a list.
pub fn splat_surfaces<T: Real>(
    gaussians: &GaussianSlices<'_, T>,
    view: &View,
    active: Option<&[u32]>,
    bins: &Bins,
    n: usize,
) -> Vec<Option<SplatSurface>> {
    let mut needed = vec![false; n];
    bins.entries.iter().for_each(|&e| needed[e as usize] = true);
    let surface = |(j, &needed): (usize, &bool)| {
        needed.then(|| SplatSurface::of(gaussians, active.map_or(j, |list| list[j] as usize), view))
    };
    needed.par_iter().enumerate().map(surface).collect()
}

impl<T: Real> PixelWalk<'_, T> {
    /// Calls `visit` for every splat that `pixel` blends, front to back, while it returns `true`.
    fn blend(&self, pixel: &BlockPixel<'_>, mut visit: impl FnMut(BlendedSplat) -> bool) {
        let [x, y] = pixel.at;
        let ray = self.view.camera.direction(DVec2::new(x as f64 + 0.5, y as f64 + 0.5)).to_array();
        let ray_of_type = ray.map(T::of);
        let mut left = 1.0;
        for &j in pixel.listed {
            let j = j as usize;
            let row = &self.splats.rows[j].0;
            let alpha = || tile::alpha_at(row, pixel.corner, pixel.in_tile).map(T::to_f64);
            let found = match &self.surfaces {
                SurfaceSource::None => alpha().map(|alpha| (alpha, 0.0)),
                SurfaceSource::Splats(surfaces) => {
                    surfaces[j].as_ref().and_then(|surface| alpha().map(|alpha| (alpha, surface.depth(ray))))
                }
                SurfaceSource::Discs(optics) => {
                    disc_tile::evaluate_alpha(row, &Disc::unpack(&self.splats.discs[j]), optics, [x, y], ray_of_type)
                        .map(|sample| (sample.alpha.to_f64(), sample.depth.to_f64()))
                }
            };
            let Some((alpha, depth)) = found else { continue };
            let next = left * (1.0 - alpha);
            if next <= 1e-4 {
                break;
            }
            let blended = BlendedSplat { weight: left * alpha, depth, left: next };
            left = next;
            if !visit(blended) {
                break;
            }
        }
    }

    /// One value per pixel, row by row.
    pub fn image<V: Send + Copy + Default>(&self, value: impl Fn(&BlockPixel<'_>) -> V + Sync) -> Vec<V> {
        let size = self.view.size();
        let tiling = self.bins.tiling;
        let tiles: Vec<Vec<([usize; 2], V)>> = (0..tiling.count())
            .into_par_iter()
            .map(|t| {
                let (corner, mut values, mut listed) = (tiling.corner(t), Vec::with_capacity(PIXELS), Vec::new());
                for block in 0..PIXELS / BLOCK {
                    self.list(t, block, &mut listed);
                    for in_tile in block * BLOCK..(block + 1) * BLOCK {
                        let Some(at) = tiling.pixel(t, in_tile, size) else { continue };
                        values.push((at, value(&BlockPixel { at, corner, in_tile, listed: &listed })));
                    }
                }
                values
            })
            .collect();
        let mut out = vec![V::default(); size[0] * size[1]];
        for ([x, y], value) in tiles.into_iter().flatten() {
            out[y * size[0] + x] = value;
        }
        out
    }

    /// The splats that may touch a block of a tile, front to back: the masks of the forward pass exclude those that
    /// cannot, and those behind the point where it stopped.
    fn list(&self, tile: usize, block: usize, listed: &mut Vec<u32>) {
        let (bins, span, bit) = (self.bins, self.bins.span(tile), 1u16 << block);
        listed.clear();
        if bins.masks_known {
            let masks = bins.masks[span.clone()].iter().zip(&bins.entries[span]);
            listed.extend(masks.filter(|(mask, _)| **mask & bit != 0).map(|(_, entry)| *entry));
        } else {
            listed.extend_from_slice(&bins.entries[span]);
        }
    }

    /// Mean depth of the surfaces, weighted like the image; 0 if the pixel blends no splat.
    pub fn surface(&self, pixel: &BlockPixel<'_>) -> f64 {
        let (mut sum, mut weights) = (0.0, 0.0);
        self.blend(pixel, |splat| {
            sum += splat.weight * splat.depth;
            weights += splat.weight;
            true
        });
        if weights > 0.0 { sum / weights } else { 0.0 }
    }

    /// Depth of the first splat behind which the transmittance is at most one half; 0 if there is none.
    pub fn median(&self, pixel: &BlockPixel<'_>) -> f64 {
        let mut median = 0.0;
        self.blend(pixel, |splat| {
            if splat.left <= 0.5 {
                median = splat.depth;
            }
            splat.left > 0.5
        });
        median
    }

    /// How many splats the pixel blends.
    pub fn count(&self, pixel: &BlockPixel<'_>) -> u32 {
        let mut count = 0;
        self.blend(pixel, |_| {
            count += 1;
            true
        });
        count
    }
}

#[cfg(test)]
mod tests {
    use crate::base::Camera;
    use crate::splat::{DepthOutput, Footprint, Gaussians, Rasterizer, Settings, Shape, View};
    use glam::DAffine3;

    /// Three panes in front of the camera that absorb a quarter, half and three quarters of the remaining light.
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
            // Transmittance 1, .75, .375: below one half behind the second pane.
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
