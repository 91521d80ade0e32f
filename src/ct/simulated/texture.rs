//! The texture of the parenchyma: lobules, and all vessels too thin to be drawn one by one.
//!
//! Value noise of several sizes (Perlin, SIGGRAPH 1985, with values instead of gradients) at coordinates of the tissue:
//! a function of the place at full inspiration alone, so that the field carries it.

use glam::{DMat3, DVec3};

use crate::base::random::{CounterRng, Stage};

/// Lattice values along each axis; the pattern repeats beyond, octaves at different lengths.
const SIDE: usize = 64;
/// Lattice spacing in mm and weight of each octave: lobules are 10 to 25 mm, their vessels down to 1 mm.
const OCTAVES: [(f64, f64); 4] = [(9.0, 0.35), (4.1, 0.5), (2.1, 0.6), (1.2, 0.5)];
/// Standard deviation of one octave: values uniform in -1 to 1 (1/3), interpolated along three axes (0.743 each).
const OCTAVE_DEVIATION: f64 = 0.3698;

/// A random field of zero mean and unit variance.
pub struct LungTexture {
    values: Vec<f32>,
    turns: [DMat3; OCTAVES.len()],
    scale: f64,
}

impl LungTexture {
    /// The field of `seed`.
    pub fn new(seed: u64) -> Self {
        let mut rng = CounterRng::new(seed, Stage::Scan, &[1]);
        let values = (0..SIDE.pow(3)).map(|_| rng.range(-1.0, 1.0) as f32).collect();
        // Octaves lie askew, so that no lattice is seen.
        let turns = std::array::from_fn(|octave| {
            let angle = 0.7 + octave as f64;
            DMat3::from_rotation_z(angle) * DMat3::from_rotation_x(0.5 * angle)
        });
        let power: f64 = OCTAVES.iter().map(|(_, weight)| weight * weight).sum();
        LungTexture { values, turns, scale: 1.0 / (OCTAVE_DEVIATION * power.sqrt()) }
    }

    /// The value at a place of tissue at full inspiration, mm.
    pub fn at(&self, tissue_mm: DVec3) -> f64 {
        let octaves = OCTAVES.iter().zip(&self.turns);
        let sum: f64 = octaves.map(|((size, weight), turn)| weight * self.octave(*turn * tissue_mm / *size)).sum();
        sum * self.scale
    }

    fn octave(&self, p: DVec3) -> f64 {
        let cell = p.floor();
        let t = p - cell;
        let s = t * t * (DVec3::splat(3.0) - 2.0 * t);
        let wrap = |v: f64| (v as i64).rem_euclid(SIDE as i64) as usize;
        let [i, j, k] = [wrap(cell.x), wrap(cell.y), wrap(cell.z)];
        let next = |v: usize| if v + 1 == SIDE { 0 } else { v + 1 };
        let [i1, j1, k1] = [next(i), next(j), next(k)];
        let value = |i: usize, j: usize, k: usize| f64::from(self.values[(k * SIDE + j) * SIDE + i]);
        let along_x = |j: usize, k: usize| {
            let a = value(i, j, k);
            a + (value(i1, j, k) - a) * s.x
        };
        let along_y = |k: usize| {
            let a = along_x(j, k);
            a + (along_x(j1, k) - a) * s.y
        };
        let a = along_y(k);
        a + (along_y(k1) - a) * s.z
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_texture_has_zero_mean_unit_variance_and_no_jumps() {
        let texture = LungTexture::new(3);
        let mut rng = CounterRng::new(1, Stage::Test, &[]);
        let places: Vec<DVec3> =
            (0..20_000).map(|_| DVec3::from_array(std::array::from_fn(|_| rng.range(-200.0, 200.0)))).collect();
        let values: Vec<f64> = places.iter().map(|p| texture.at(*p)).collect();
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / values.len() as f64;
        assert!(mean.abs() < 0.1 && (variance - 1.0).abs() < 0.15, "{mean} {variance}");
        for (p, v) in places.iter().zip(&values).take(500) {
            assert!((texture.at(*p + DVec3::splat(1e-6)) - v).abs() < 1e-4);
        }
    }
}
