//! Counter-based randomness: every number is a pure function of (seed, stage, keys, counter), so that the same seed
//! gives the same bytes on any number of threads, in one go or resumed.
//!
//! Mixing: the finaliser of SplitMix64 (Steele et al., OOPSLA 2014), applied once per key. It can be inverted: whoever knows
//! a number to its last bits, such as a second camera's place, can go back to what the mixing began with. That is a hash of
//! seed and stage that cannot be inverted (BLAKE3), wherever the seed is too long to be found by trying.

/// What the random numbers are for; two stages never share a stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u64)]
pub enum Stage {
    /// Growing a bronchial tree.
    Tree = 1,
    /// Surfacing and mucosal relief.
    Surface = 2,
    /// Breathing waveform irregularity.
    Waveform = 3,
    /// End point and route of the scope.
    Trajectory = 4,
    /// Exposure, white balance, sensor.
    Exposure = 5,
    /// Mucosal colour and vessels.
    Texture = 6,
    /// Light transport.
    Render = 7,
    /// Initial state of a method.
    Method = 8,
    /// Choice of the target vertex, bootstrap.
    Score = 9,
    /// Sensor noise.
    Sensor = 10,
    /// Error of a registration.
    Registration = 11,
    /// The hand that steers the scope.
    Steering = 12,
    /// Second cameras, whose views no method fits.
    NovelView = 13,
    /// Simulated CT: texture, vessels, noise of the scanner.
    Scan = 20,
    /// Conditions of the clinical track.
    Clinical = 21,
    /// Tests.
    Test = 99,
}

/// Shorter seeds are found by trying all of them, so that no hash could hide them: their streams stay what they were.
const FOUND_BY_TRYING: u32 = 32;

/// What the streams of a stage begin with.
fn stage_key(seed: u64, stage: Stage) -> u64 {
    if seed >> FOUND_BY_TRYING == 0 {
        return mix(mix(seed ^ 0x9e37_79b9_7f4a_7c15) ^ (stage as u64).wrapping_mul(0xd1b5_4a32_d192_ed03));
    }
    let mut hasher = blake3::Hasher::new_derive_key("respire-bench 2026-11-29 random numbers of a stage");
    hasher.update(&seed.to_le_bytes()).update(&(stage as u64).to_le_bytes());
    let hash = hasher.finalize();
    u64::from_le_bytes(std::array::from_fn(|k| hash.as_bytes()[k]))
}

fn mix(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// A stream of numbers for one (seed, stage, keys).
#[derive(Clone, Debug)]
pub struct CounterRng {
    key: u64,
    counter: u64,
}

impl CounterRng {
    /// The stream of `seed` at `stage` for `keys` (frame, pixel, sample, ...).
    pub fn new(seed: u64, stage: Stage, keys: &[u64]) -> Self {
        let mut key = stage_key(seed, stage);
        for &k in keys {
            key = mix(key.wrapping_add(0x9e37_79b9_7f4a_7c15) ^ k.wrapping_mul(0xa24b_aed4_963e_e407));
        }
        CounterRng { key, counter: 0 }
    }

    /// This stream after `draws` more of its numbers (a normal one takes two).
    pub fn after(&self, draws: u64) -> Self {
        CounterRng { counter: self.counter + draws, ..*self }
    }

    /// Next 64 uniform bits.
    pub fn next_u64(&mut self) -> u64 {
        self.counter += 1;
        mix(self.key.wrapping_add(self.counter.wrapping_mul(0x9e37_79b9_7f4a_7c15)))
    }

    /// Next 32 uniform bits.
    pub fn next_u32(&mut self) -> u32 {
        (self.next_u64() >> 32) as u32
    }

    /// Uniform in [0, 1).
    pub fn uniform(&mut self) -> f64 {
        (self.next_u64() >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
    }

    /// Uniform in [low, high).
    pub fn range(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    /// Uniform index below `n` (`n` > 0).
    pub fn index(&mut self, n: usize) -> usize {
        ((self.next_u64() as u128 * n as u128) >> 64) as usize
    }

    /// Standard normal (Box and Muller).
    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform()).cos()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// [`mix`] backwards.
    fn unmix(z: u64) -> u64 {
        let unshift = |z: u64, by: u32| (0..64 / by).fold(z, |found, _| z ^ (found >> by));
        let inverse = |odd: u64| (0..6).fold(odd, |x, _| x.wrapping_mul(2u64.wrapping_sub(odd.wrapping_mul(x))));
        let z = unshift(z, 31).wrapping_mul(inverse(0x94d0_49bb_1331_11eb));
        unshift(unshift(z, 27).wrapping_mul(inverse(0xbf58_476d_1ce4_e5b9)), 30)
    }

    /// Whoever is told the numbers of one stage cannot compute those of another: what a participant sees of a film, to the
    /// last bit, would otherwise be the whole film.
    #[test]
    fn a_long_seed_cannot_be_computed_from_its_numbers() {
        let found = |seed: u64| {
            let seen = CounterRng::new(seed, Stage::NovelView, &[7, 3]).next_u64();
            let mut key = unmix(seen).wrapping_sub(0x9e37_79b9_7f4a_7c15);
            for k in [3u64, 7] {
                key = (unmix(key) ^ k.wrapping_mul(0xa24b_aed4_963e_e407)).wrapping_sub(0x9e37_79b9_7f4a_7c15);
            }
            unmix(unmix(key) ^ (Stage::NovelView as u64).wrapping_mul(0xd1b5_4a32_d192_ed03)) ^ 0x9e37_79b9_7f4a_7c15
        };
        for seed in [0, 1, 17, u64::from(u32::MAX)] {
            assert_eq!(found(seed), seed, "the way back is wrong, and this test could not fail");
        }
        for seed in [1 << 32, 123_456_789_012_345_678, u64::MAX] {
            assert_ne!(found(seed), seed);
        }
    }

    #[test]
    fn streams_differ_and_moments_are_right() {
        let mut a = CounterRng::new(1, Stage::Test, &[0, 1]);
        let mut b = CounterRng::new(1, Stage::Test, &[1, 0]);
        assert_ne!(a.next_u64(), b.next_u64());
        let mut later = a.after(5);
        (0..2).for_each(|_| _ = a.normal());
        a.next_u64();
        assert_eq!(a.next_u64(), later.next_u64());
        let n = 100_000;
        let (mut sum, mut square) = (0.0, 0.0);
        for _ in 0..n {
            let v = a.normal();
            sum += v;
            square += v * v;
        }
        assert!((sum / n as f64).abs() < 0.015);
        assert!((square / n as f64 - 1.0).abs() < 0.02);
    }
}
