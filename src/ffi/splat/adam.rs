//! Adam's update (Kingma and Ba 2015, Algorithm 1) of many values, compiled for AVX2 as well and used where the
//! processor has it: Rust compiles for SSE2 otherwise, where the compiler does not vectorise it (seven times slower).
//! No operation is fused or reordered, so that the bytes are the same. There is no C++ behind this file.

/// The constants of step number `t`: with the gradient `g`,
///
/// ```text
/// m <- beta1 m + (1 - beta1) g,  v <- beta2 v + (1 - beta2) g^2
/// x <- x - rate (m / (1 - beta1^t)) / (sqrt(v / (1 - beta2^t)) + epsilon)
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AdamStep {
    /// `beta1` and `beta2`: the share of each moment that stays.
    pub decay: [f32; 2],
    /// `1 - beta1` and `1 - beta2`.
    pub share: [f32; 2],
    /// `1 / (1 - beta^t)`: removes the bias of moments that start at 0.
    pub bias_correction: [f32; 2],
    /// Added to the root of the second moment.
    pub epsilon: f32,
}

impl AdamStep {
    /// Updates one value. A gradient that is not finite changes nothing.
    #[inline(always)]
    pub fn apply(&self, rate: f32, parameter: &mut f32, g: f32, first: &mut f32, second: &mut f32) {
        let m = self.decay[0] * *first + self.share[0] * g;
        let v = self.decay[1] * *second + self.share[1] * g * g;
        let root = (v * self.bias_correction[1]).sqrt() + self.epsilon;
        // A zero gradient from the start leaves both moments zero: no step, rather than 0 / eps.
        let root = if root > f32::MIN_POSITIVE { root } else { f32::MIN_POSITIVE };
        let moved = *parameter - rate * (m * self.bias_correction[0]) / root;
        let finite = g.is_finite();
        *first = if finite { m } else { *first };
        *second = if finite { v } else { *second };
        *parameter = if finite { moved } else { *parameter };
    }

    /// Updates many values, as many as `parameters`; the other slices are at least as long, or it panics.
    pub fn apply_all(
        &self,
        rates: &[f32],
        parameters: &mut [f32],
        gradient: &[f32],
        first: &mut [f32],
        second: &mut [f32],
    ) {
        if is_x86_feature_detected!("avx2") {
            // SAFETY: `apply_avx2` is safe code; calling it needs AVX2, which the line above has found.
            return unsafe { self.apply_avx2(rates, parameters, gradient, first, second) };
        }
        self.apply_each(rates, parameters, gradient, first, second);
    }

    #[target_feature(enable = "avx2")]
    fn apply_avx2(
        &self,
        rates: &[f32],
        parameters: &mut [f32],
        gradient: &[f32],
        first: &mut [f32],
        second: &mut [f32],
    ) {
        self.apply_each(rates, parameters, gradient, first, second);
    }

    #[inline(always)]
    fn apply_each(
        &self,
        rates: &[f32],
        parameters: &mut [f32],
        gradient: &[f32],
        first: &mut [f32],
        second: &mut [f32],
    ) {
        let n = parameters.len();
        let (rates, gradient, first, second) = (&rates[..n], &gradient[..n], &mut first[..n], &mut second[..n]);
        for i in 0..n {
            self.apply(rates[i], &mut parameters[i], gradient[i], &mut first[i], &mut second[i]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wide_and_plain_are_the_same_bytes() {
        let n = 1003;
        let value = |i: usize, k: usize| ((i * 7919 + k * 104_729) % 1009) as f32 / 504.0 - 1.0;
        let table = |k: usize| (0..n).map(|i| value(i, k)).collect::<Vec<f32>>();
        let step = AdamStep { decay: [0.9, 0.999], share: [0.1, 0.001], bias_correction: [5.0, 300.0], epsilon: 1e-15 };
        let (rates, mut gradient, start) = (table(1), table(2), table(3));
        gradient[17] = f32::NAN;
        gradient[18] = f32::INFINITY;
        gradient[19] = 0.0;
        let run = |whole: bool| {
            let (mut x, mut m, mut v) = (start.clone(), vec![0.0; n], vec![0.0; n]);
            for _ in 0..5 {
                if whole {
                    step.apply_all(&rates, &mut x, &gradient, &mut m, &mut v);
                } else {
                    for i in 0..n {
                        step.apply(rates[i], &mut x[i], gradient[i], &mut m[i], &mut v[i]);
                    }
                }
            }
            [x, m, v].concat().iter().map(|f| f.to_bits()).collect::<Vec<u32>>()
        };
        assert!(run(true) == run(false));
    }
}
