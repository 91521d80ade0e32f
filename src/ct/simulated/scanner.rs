//! What a scanner makes of a body: blurred by its point spread, averaged over the thickness of its slices, with noise
//! whose grains have a size, as whole Hounsfield units.
//!
//! Works slab by slab: a few computed slices are in memory beside the scan. The point spread is Gaussian. Noise is white
//! noise through the difference of two Gaussians, which has little power at low frequencies, a maximum, and none beyond
//! the kernel's resolution, as filtered back projection has it (Riederer et al., Phys Med Biol 23:446, 1978). Left out:
//! streaks, beam hardening, that noise is stronger along the shoulders.

use glam::DVec3;
use rayon::prelude::*;

use super::protocol::ScannerSettings;
use super::thorax::EDGE_DEVIATION_MM;
use crate::base::estimate::demand_memory;
use crate::base::{Progress, Result, Volume, VoxelGrid};

/// Standard deviation of a Gaussian over its full width at half maximum.
const DEVIATION_PER_WIDTH: f64 = 0.424_66;
/// Slices of the scan in a slab.
const SLAB: usize = 24;
/// Least and greatest value of a scan.
const LEAST_HU: f64 = -1024.0;
const GREATEST_HU: f64 = 3071.0;
/// Standard deviations of the two Gaussians of the noise, over that of the point spread.
const GRAIN: [f64; 2] = [0.75, 2.0];
/// Share of the second Gaussian: the rest is noise of low frequency.
const TROUGH: f64 = 0.85;
/// Share of each neighbouring slice in a slice's noise where slices overlap.
const ACROSS_SLICES: f64 = 0.3;

/// Which noise: of this seed, of this exposure.
#[derive(Clone, Copy, Debug)]
pub struct NoiseSeed {
    /// Seed of the case.
    pub seed: u64,
    /// Number of the exposure: breath hold and protocol.
    pub exposure: u64,
}

/// One pass of a blur: the share that a sample gives to each of its neighbours, and how many passes.
fn passes(deviation: f64) -> (f32, usize) {
    let variance = deviation * deviation;
    let count = (variance / 0.4).ceil().max(1.0);
    ((variance / (2.0 * count)) as f32, count as usize)
}

/// Gaussian blur of an image with `width` columns: passes of three taps whose variances add up to that wanted.
fn blur(image: &mut [f32], width: usize, deviation: f64) {
    let (share, count) = passes(deviation);
    let keep = 1.0 - 2.0 * share;
    let height = image.len() / width;
    for _ in 0..count {
        for row in image.chunks_exact_mut(width) {
            let mut before = row[0];
            for i in 0..width {
                let here = row[i];
                let after = row[(i + 1).min(width - 1)];
                row[i] = keep * here + share * (before + after);
                before = here;
            }
        }
        let mut before: Vec<f32> = image[..width].to_vec();
        for j in 0..height {
            for i in 0..width {
                let at = j * width + i;
                let here = image[at];
                let after = image[(j + 1).min(height - 1) * width + i];
                image[at] = keep * here + share * (before[i] + after);
                before[i] = here;
            }
        }
    }
}

/// Weights of the computed slices around a slice, symmetric about its middle: their number has the parity of `fine`.
fn slice_profile(deviation: f64, fine: usize) -> Vec<f64> {
    if deviation < 0.8 && fine % 2 == 1 {
        let share = deviation * deviation / 2.0;
        return vec![share, 1.0 - 2.0 * share, share];
    }
    let mut count = ((6.0 * deviation).ceil() as usize).max(fine);
    count += usize::from(count % 2 != fine % 2);
    let weight = |k: usize| (-0.5 * ((k as f64 - (count as f64 - 1.0) / 2.0) / deviation).powi(2)).exp();
    let all: Vec<f64> = (0..count).map(weight).collect();
    let total: f64 = all.iter().sum();
    all.into_iter().map(|w| w / total).collect()
}

/// What is left of a point spread when the shapes' own soft edges are taken off, in mm.
fn remaining(width_mm: f64) -> f64 {
    ((width_mm * DEVIATION_PER_WIDTH).powi(2) - EDGE_DEVIATION_MM.powi(2)).max(0.0).sqrt()
}

/// Nearly normal numbers, from four uniform ones of 16 bits: the same on every processor.
fn white(key: u64, at: u64) -> f32 {
    let mut z = key ^ at.wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^= z >> 31;
    let sum = (z & 0xffff) + (z >> 16 & 0xffff) + (z >> 32 & 0xffff) + (z >> 48);
    // Mean 2 and variance 4/12 of numbers in 0 to 1.
    (sum as f32 / 65_536.0 - 2.0) * 1.732_050_8
}

/// Grainy noise of unit variance for one slice.
struct NoiseFilter {
    deviations: [f64; 2],
    scale: f32,
    across: f32,
    key: u64,
}

impl NoiseFilter {
    fn new(settings: &ScannerSettings, noise: NoiseSeed) -> NoiseFilter {
        let spread = settings.point_spread_mm * DEVIATION_PER_WIDTH / settings.pixel_mm;
        let deviations = GRAIN.map(|g| g * spread);
        let across = if settings.thickness_mm > settings.slice_mm { ACROSS_SLICES as f32 } else { 0.0 };
        let mut filter = NoiseFilter { deviations, scale: 1.0, across, key: 0 };
        // The variance of what comes out is the power of the answer to one point.
        let mut point = vec![0f32; 65 * 65];
        point[32 * 65 + 32] = 1.0;
        filter.shape(&mut point, 65);
        let power = point.iter().map(|v| v * v).sum::<f32>() * (1.0 + 2.0 * filter.across * filter.across);
        filter.scale = 1.0 / power.sqrt();
        filter.key =
            crate::base::random::CounterRng::new(noise.seed, crate::base::random::Stage::Scan, &[3, noise.exposure])
                .next_u64();
        filter
    }

    fn shape(&self, image: &mut [f32], width: usize) {
        let mut broad = image.to_vec();
        blur(image, width, self.deviations[0]);
        blur(&mut broad, width, self.deviations[1]);
        image.iter_mut().zip(broad).for_each(|(fine, broad)| *fine -= TROUGH as f32 * broad);
    }

    fn slice(&self, k: usize, width: usize, count: usize) -> Vec<f32> {
        // One more slice below the first: indices stay positive.
        let value = |k: usize, at: usize| white(self.key, ((k as u64) << 32) + at as u64);
        let mut image: Vec<f32> = (0..count)
            .map(|at| {
                let neighbours = if self.across > 0.0 { value(k, at) + value(k + 2, at) } else { 0.0 };
                value(k + 1, at) + self.across * neighbours
            })
            .collect();
        self.shape(&mut image, width);
        image.iter_mut().for_each(|v| *v *= self.scale);
        image
    }
}

/// Scans the body `hu` (Hounsfield units of a place, with edges as soft as [`super::thorax::coverage`]) on an upright
/// grid. The same bytes on any number of threads.
///
/// Errors: no memory for the scan; the user stopped the work.
pub fn scan(
    grid: VoxelGrid,
    settings: &ScannerSettings,
    noise: NoiseSeed,
    hu: impl Fn(DVec3) -> f64 + Sync,
    progress: &dyn Progress,
) -> Result<Volume<i16>> {
    let [nx, ny, nz] = grid.size;
    let fine = settings.fine_slices;
    let fine_mm = settings.slice_mm / fine as f64;
    let profile = slice_profile(remaining(settings.thickness_mm) / fine_mm, fine);
    let in_plane = remaining(settings.point_spread_mm) / settings.pixel_mm;
    let slab_slices = SLAB * fine + profile.len();
    demand_memory("the scan", grid.count() as f64 * 2.0 + (slab_slices * nx * ny) as f64 * 4.0)?;
    let filter = NoiseFilter::new(settings, noise);
    let mut data = vec![0i16; grid.count()];
    // The first computed slice that a slice takes, relative to its own first one.
    let before = (profile.len() - fine.min(profile.len())) / 2;
    for (slab, part) in data.chunks_mut(SLAB * nx * ny).enumerate() {
        progress.proceed()?;
        progress.advance(slab * SLAB, nz);
        let first = slab * SLAB;
        let slices = part.len() / (nx * ny);
        let needed = (slices - 1) * fine + profile.len();
        let computed: Vec<Vec<f32>> = (0..needed)
            .into_par_iter()
            .map(|m| {
                let index = (first * fine + m) as f64 - before as f64 - (fine as f64 - 1.0) / 2.0;
                let z = index * fine_mm / settings.slice_mm;
                let value = |at: usize| hu(grid.position(DVec3::new((at % nx) as f64, (at / nx) as f64, z))) as f32;
                let mut image: Vec<f32> = (0..nx * ny).map(value).collect();
                blur(&mut image, nx, in_plane);
                image
            })
            .collect();
        part.par_chunks_mut(nx * ny).enumerate().for_each(|(k, slice)| {
            let grains = filter.slice(first + k, nx, nx * ny);
            for (at, value) in slice.iter_mut().enumerate() {
                let stack = profile.iter().zip(&computed[k * fine..]);
                let mean: f64 = stack.map(|(weight, image)| weight * f64::from(image[at])).sum();
                let off = DVec3::new((at % nx) as f64 / nx as f64 - 0.5, (at / nx) as f64 / ny as f64 - 0.5, 0.0);
                // Rays through the middle of the body are the weakest.
                let strength = settings.noise_hu * (1.0 - 1.6 * off.length_squared()).max(0.3);
                let noisy = mean + strength * f64::from(grains[at]);
                *value = noisy.clamp(LEAST_HU, GREATEST_HU).round() as i16;
            }
        });
    }
    Ok(Volume { grid, data })
}

#[cfg(test)]
mod tests {
    use super::super::protocol::ScanProtocol;
    use super::super::thorax::coverage;
    use super::*;
    use crate::base::NoProgress;

    fn settings(noise_hu: f64) -> ScannerSettings {
        ScannerSettings { noise_hu, ..ScanProtocol::Thin.settings() }
    }

    #[test]
    fn an_edge_is_as_wide_as_the_point_spread_and_an_even_body_stays() {
        for protocol in ScanProtocol::ALL {
            let settings = ScannerSettings { noise_hu: 0.0, ..protocol.settings() };
            let spacing = DVec3::new(settings.pixel_mm, settings.pixel_mm, settings.slice_mm);
            let grid = VoxelGrid::upright([64, 9, 33], DVec3::new(-22.4, 0.0, -16.0 * settings.slice_mm), spacing);
            let noise = NoiseSeed { seed: 1, exposure: 0 };
            let even = scan(grid, &settings, noise, |_| -850.0, &NoProgress).unwrap();
            assert!(even.data.iter().all(|v| *v == -850));
            // The deviation of the line spread from the edge's own: mean and variance of its slope.
            for (axis, wanted) in [(0, settings.point_spread_mm), (2, settings.thickness_mm)] {
                let edge = scan(grid, &settings, noise, |p| 1000.0 * coverage(p[axis] - 0.1), &NoProgress).unwrap();
                let line: Vec<f64> = (0..grid.size[axis])
                    .map(|n| f64::from(edge.value(if axis == 0 { [n, 4, 16] } else { [30, 4, n] })))
                    .collect();
                let slope: Vec<f64> = line.windows(2).map(|w| w[0] - w[1]).collect();
                let total: f64 = slope.iter().sum();
                let mean = slope.iter().enumerate().map(|(k, s)| k as f64 * s).sum::<f64>() / total;
                let variance =
                    slope.iter().enumerate().map(|(k, s)| (k as f64 - mean).powi(2) * s).sum::<f64>() / total;
                let step = spacing[axis];
                // Differences of samples widen by a twelfth of a step squared.
                let deviation = ((variance - 1.0 / 12.0).max(0.0)).sqrt() * step;
                let truth = wanted * DEVIATION_PER_WIDTH;
                assert!((deviation - truth).abs() < 0.12 * truth.max(step), "{protocol:?} {axis}: {deviation} {truth}");
            }
        }
    }

    #[test]
    fn noise_has_its_strength_its_grain_and_one_pattern_for_all_threads() {
        let grid = VoxelGrid::upright([96, 96, 30], DVec3::ZERO, DVec3::splat(0.7));
        let noise = NoiseSeed { seed: 4, exposure: 1 };
        let shoot = || scan(grid, &settings(40.0), noise, |_| 0.0, &NoProgress).unwrap();
        let found = shoot();
        let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap().install(shoot);
        assert_eq!(one.data, found.data);
        let value = |i: usize, j: usize, k: usize| f64::from(found.value([i, j, k]));
        let (mut square, mut beside, mut across, mut count) = (0.0, 0.0, 0.0, 0.0);
        for (i, j, k) in (40..56).flat_map(|i| (40..56).flat_map(move |j| (0..29).map(move |k| (i, j, k)))) {
            square += value(i, j, k).powi(2);
            beside += value(i, j, k) * value(i + 1, j, k);
            across += value(i, j, k) * value(i, j, k + 1);
            count += 1.0;
        }
        let deviation = (square / count).sqrt();
        assert!((deviation - 40.0).abs() < 2.5, "{deviation}");
        // Filtered back projection leaves neighbours in a slice nearly independent; slices overlap.
        assert!(
            (-0.1..0.3).contains(&(beside / square)) && across / square > 0.3,
            "{} {}",
            beside / square,
            across / square
        );
    }
}
