//! The random functions that the look of the wall is made of: vectors against plain f64, one instruction set against another.

use respire_bench::base::random::{CounterRng, Stage};
use respire_bench::ffi::isa::Isa;
use respire_bench::ffi::trace::tracer::{GradientNoise, gradient_noise, noise_neighbours};

use crate::splat::forward::available;

fn hash_of_cell(cell: [i32; 3], seed: u32) -> u32 {
    let factors = [0x8da6_b343u32, 0xd816_3841, 0xcb1a_b31f];
    let mut x = (0..3).fold(seed, |h, i| h ^ (cell[i] as u32).wrapping_mul(factors[i]));
    x = (x ^ (x >> 16)).wrapping_mul(0x7feb_352d);
    x = (x ^ (x >> 15)).wrapping_mul(0x846c_a68b);
    x ^ (x >> 16)
}

fn ten_bits(hash: u32) -> [f64; 3] {
    [0, 10, 20].map(|shift| f64::from((hash >> shift) & 1023))
}

fn value_of_noise(point: [f64; 3], seed: u32) -> f64 {
    let mut value = 0.0;
    for corner in 0..8 {
        let offset = [corner & 1, (corner >> 1) & 1, corner >> 2];
        let cell = std::array::from_fn(|i| point[i].floor() as i32 + offset[i]);
        let direction = ten_bits(hash_of_cell(cell, seed)).map(|b| b * 2.0 / 1023.0 - 1.0);
        let (mut weight, mut slope) = (1.0, 0.0);
        for i in 0..3 {
            let t = point[i] - point[i].floor();
            let fade = t * t * t * (t * (t * 6.0 - 15.0) + 10.0);
            weight *= if offset[i] == 1 { fade } else { 1.0 - fade };
            slope += direction[i] * (t - f64::from(offset[i]));
        }
        value += weight * slope;
    }
    1.4 * value
}

fn points() -> Vec<[f32; 3]> {
    let mut rng = CounterRng::new(5, Stage::Test, &[]);
    let mut points: Vec<[f32; 3]> =
        (0..2000).map(|_| std::array::from_fn(|_| (rng.uniform() * 400.0 - 200.0) as f32)).collect();
    points.extend([[0.0; 3], [-1.0, 2.0, 3.0], [0.5; 3], [-0.0, 1e-30, -1e-30], [4e4, -4e4, 4e4]]);
    points
}

#[test]
fn gradient_noise_is_that_of_plain_double_precision() {
    for point in points() {
        let GradientNoise { value, gradient } = gradient_noise(Isa::widest(), point, 17);
        let exact = point.map(f64::from);
        let twin = value_of_noise(exact, 17);
        assert!((f64::from(value) - twin).abs() < 3e-6, "{point:?}: {value}, not {twin}");
        for i in 0..3 {
            const STEP: f64 = 1e-4;
            let moved = |by: f64| value_of_noise(std::array::from_fn(|k| exact[k] + if k == i { by } else { 0.0 }), 17);
            let difference = (moved(STEP) - moved(-STEP)) / (2.0 * STEP);
            assert!((f64::from(gradient[i]) - difference).abs() < 2e-5, "{point:?}: {}, not {difference}", gradient[i]);
        }
    }
    // Zero on the lattice, where the directions meet.
    assert_eq!(gradient_noise(Isa::widest(), [3.0, -7.0, 12.0], 3).value, 0.0);
}

#[test]
fn neighbours_are_the_nearest_two_of_the_27_cells_around() {
    for point in points() {
        let exact = point.map(f64::from);
        let mut all: Vec<(f64, [f64; 3], u32)> = Vec::new();
        for k in 0..27 {
            let offset = [k % 3 - 1, k / 3 % 3 - 1, k / 9 - 1];
            let hash = hash_of_cell(std::array::from_fn(|i| exact[i].floor() as i32 + offset[i]), 23);
            let bits = ten_bits(hash);
            let place: [f64; 3] = std::array::from_fn(|i| f64::from(offset[i]) + bits[i] / 1024.0);
            let away = (0..3).map(|i| (place[i] - (exact[i] - exact[i].floor())).powi(2)).sum();
            all.push((away, place, hash));
        }
        all.sort_by(|a, b| a.0.total_cmp(&b.0));
        for (k, found) in noise_neighbours(Isa::widest(), point, 23).into_iter().enumerate() {
            let (away, place, hash) = all[k];
            assert!((f64::from(found.distance2) - away).abs() < 1e-5, "{point:?}: {}, not {away}", found.distance2);
            // Two that are equally far to rounding may change places.
            if all[k + 1].0 - away > 1e-5 && (k == 0 || away - all[0].0 > 1e-5) {
                assert_eq!((found.cell, found.place.map(f64::from)), (hash, place), "{point:?}");
            }
        }
    }
}

#[test]
fn noise_is_the_same_bytes_on_every_processor() {
    let mut poisoned = points();
    poisoned.extend([[f32::NAN, 0.0, 1.0], [f32::NAN; 3]]);
    for point in poisoned {
        // The sign of what is not a number means nothing.
        let bits = |v: f32| if v.is_nan() { f32::NAN.to_bits() } else { v.to_bits() };
        let of = |isa| {
            let neighbours = noise_neighbours(isa, point, 9).map(|n| (n.place.map(bits), bits(n.distance2), n.cell));
            let noise = gradient_noise(isa, point, 9);
            (bits(noise.value), noise.gradient.map(bits), neighbours)
        };
        let plain = of(Isa::Baseline);
        for isa in available().filter(|&isa| isa > Isa::Baseline) {
            assert_eq!(of(isa), plain, "{isa} at {point:?}");
        }
    }
}
