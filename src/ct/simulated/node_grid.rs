//! Several smooth quantities on one coarse grid of nodes, read in between.

use glam::DVec3;
use rayon::prelude::*;

/// `N` values per node of an upright grid; x runs fastest.
pub struct NodeGrid<const N: usize> {
    origin_mm: DVec3,
    spacing_mm: f64,
    size: [usize; 3],
    values: Vec<[f32; N]>,
}

impl<const N: usize> NodeGrid<N> {
    /// Samples `quantity` at nodes `spacing_mm` apart that cover the box from `low` to `high`.
    pub fn sampled(low: DVec3, high: DVec3, spacing_mm: f64, quantity: impl Fn(DVec3) -> [f64; N] + Sync) -> Self {
        let size = ((high - low) / spacing_mm).to_array().map(|n| n.max(0.0).ceil() as usize + 2);
        let place = |at: usize| {
            let node = [at % size[0], at / size[0] % size[1], at / size[0] / size[1]];
            low + DVec3::new(node[0] as f64, node[1] as f64, node[2] as f64) * spacing_mm
        };
        let count = size.iter().product();
        let values = (0..count).into_par_iter().map(|at: usize| quantity(place(at)).map(|v| v as f32)).collect();
        NodeGrid { origin_mm: low, spacing_mm, size, values }
    }

    /// Trilinear values at a place; those of the rim outside of the grid.
    pub fn at(&self, place_mm: DVec3) -> [f64; N] {
        let local = (place_mm - self.origin_mm) / self.spacing_mm;
        let (mut base, mut part) = ([0usize; 3], [0.0f64; 3]);
        for axis in 0..3 {
            let clamped = local[axis].clamp(0.0, (self.size[axis] - 1) as f64 - 1e-9);
            base[axis] = clamped as usize;
            part[axis] = clamped - base[axis] as f64;
        }
        let start = (base[2] * self.size[1] + base[1]) * self.size[0] + base[0];
        let (row, layer) = (self.size[0], self.size[0] * self.size[1]);
        let [x, y, z] = part;
        let corners = [
            (start, (1.0 - x) * (1.0 - y) * (1.0 - z)),
            (start + 1, x * (1.0 - y) * (1.0 - z)),
            (start + row, (1.0 - x) * y * (1.0 - z)),
            (start + row + 1, x * y * (1.0 - z)),
            (start + layer, (1.0 - x) * (1.0 - y) * z),
            (start + layer + 1, x * (1.0 - y) * z),
            (start + layer + row, (1.0 - x) * y * z),
            (start + layer + row + 1, x * y * z),
        ];
        let mut sum = [0.0; N];
        for (at, weight) in corners {
            for (total, value) in sum.iter_mut().zip(&self.values[at]) {
                *total += f64::from(*value) * weight;
            }
        }
        sum
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn linear_quantities_are_read_exactly_and_the_rim_goes_on() {
        let grid = NodeGrid::sampled(DVec3::new(-5.0, 0.0, 2.0), DVec3::new(9.0, 7.0, 11.0), 2.5, |p| [p.x, p.y + p.z]);
        for p in [DVec3::new(0.1, 3.3, 7.7), DVec3::new(9.0, 7.0, 11.0), DVec3::new(-5.0, 0.0, 2.0)] {
            let [a, b] = grid.at(p);
            assert!((a - p.x).abs() < 1e-5 && (b - p.y - p.z).abs() < 1e-5, "{p}");
        }
        assert!((grid.at(DVec3::new(-50.0, 3.0, 4.0))[0] + 5.0).abs() < 1e-5);
    }
}
