//! Adam (Kingma and Ba 2015) for one group of parameters.
//!
//! A method fits one frame at a time on a compact copy of what that frame can see, so a group holds moments for those
//! rows only, and they start at zero with every frame, as the released BridgeSplat does ("moments zeroed, step counter
//! kept"). Whether the step counter is kept too is [`StepCounter`]: with a kept counter the bias correction is gone
//! and the first steps after zeroing are up to 3.2 times as long.

/// Constants of Adam.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AdamConstants {
    /// Decay of the first moment.
    pub beta1: f64,
    /// Decay of the second moment.
    pub beta2: f64,
    /// Added to the root of the second moment.
    pub epsilon: f64,
}

impl Default for AdamConstants {
    fn default() -> Self {
        AdamConstants { beta1: 0.9, beta2: 0.999, epsilon: 1e-15 }
    }
}

/// What becomes of the step counter when a new frame zeroes the moments.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StepCounter {
    /// It goes on counting (released BridgeSplat).
    Kept,
    /// It starts again, so that the bias correction is right for the zeroed moments.
    Restarted,
}

/// Adam's state for one group of parameters.
#[derive(Clone, Debug)]
pub struct Adam {
    constants: AdamConstants,
    steps: u64,
    first: Vec<f32>,
    second: Vec<f32>,
}

impl Adam {
    /// No parameters yet; [`Adam::begin`] makes room.
    pub fn new(constants: AdamConstants) -> Self {
        Adam { constants, steps: 0, first: Vec::new(), second: Vec::new() }
    }

    /// Zero moments for `len` values.
    pub fn begin(&mut self, len: usize, counter: StepCounter) {
        self.first.clear();
        self.first.resize(len, 0.0);
        self.second.clear();
        self.second.resize(len, 0.0);
        if counter == StepCounter::Restarted {
            self.steps = 0;
        }
    }

    /// One step against `gradient` at learning rate `rate`. Values whose gradient is not finite stay as they are.
    pub fn step(&mut self, rate: f64, parameters: &mut [f32], gradient: &[f32]) {
        self.step_by(parameters, gradient, |_| rate as f32);
    }

    /// [`Adam::step`] with a learning rate that depends on the index of the value.
    pub fn step_by(&mut self, parameters: &mut [f32], gradient: &[f32], rate: impl Fn(usize) -> f32) {
        assert!(parameters.len() == gradient.len() && gradient.len() == self.first.len(), "group sizes differ");
        self.steps += 1;
        let AdamConstants { beta1, beta2, epsilon } = self.constants;
        let steps = self.steps.min(i32::MAX as u64) as i32;
        let unbias1 = (1.0 / (1.0 - beta1.powi(steps))) as f32;
        let unbias2 = (1.0 / (1.0 - beta2.powi(steps))) as f32;
        let (b1, b2, eps) = (beta1 as f32, beta2 as f32, epsilon as f32);
        let (new1, new2) = ((1.0 - beta1) as f32, (1.0 - beta2) as f32);
        let moments = self.first.iter_mut().zip(self.second.iter_mut());
        for (i, ((p, &g), (m, v))) in parameters.iter_mut().zip(gradient).zip(moments).enumerate() {
            if !g.is_finite() {
                continue;
            }
            *m = b1 * *m + new1 * g;
            *v = b2 * *v + new2 * g * g;
            // A zero gradient from the start leaves both moments zero: no step, rather than 0 / eps.
            *p -= rate(i) * (*m * unbias1) / ((*v * unbias2).sqrt() + eps).max(f32::MIN_POSITIVE);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// f(x) = x^2 from 1 at rate 0.1: worked out by hand from the paper's Algorithm 1.
    #[test]
    fn three_steps_equal_a_table_made_by_hand() {
        let mut adam = Adam::new(AdamConstants { epsilon: 1e-8, ..AdamConstants::default() });
        adam.begin(1, StepCounter::Restarted);
        let mut x = [1.0f32];
        // step 1: m^ = g, v^ = g^2, so the step is exactly the rate: 0.9
        // step 2: g = 1.8, m = .2 .9 + .18 = .36, m^ = .36/.19; v = .004 .999 + .00324 = .007236, v^ = v/.001999
        // step 3: g = 2 x2; likewise
        let expected = [0.9, 0.800_412_2, 0.701_586_3];
        for want in expected {
            let gradient = [2.0 * x[0]];
            adam.step(0.1, &mut x, &gradient);
            assert!((x[0] - want).abs() < 1.5e-7, "{} instead of {want}", x[0]);
        }
    }

    #[test]
    fn a_kept_counter_takes_the_longer_first_step_of_the_released_code() {
        let mut adam = Adam::new(AdamConstants::default());
        adam.begin(1, StepCounter::Restarted);
        let mut x = [0.0f32];
        for _ in 0..100_000 {
            adam.step(0.0, &mut x, &[1.0]);
        }
        adam.begin(1, StepCounter::Kept);
        adam.step(1.0, &mut x, &[5.0]);
        assert!((x[0] + 0.1 / 0.001f32.sqrt()).abs() < 1e-3, "{}", x[0]);
    }

    #[test]
    fn silence_and_nan_move_nothing() {
        let mut adam = Adam::new(AdamConstants { epsilon: 0.0, ..AdamConstants::default() });
        adam.begin(2, StepCounter::Restarted);
        let mut x = [3.0f32, 4.0];
        adam.step(1.0, &mut x, &[0.0, f32::NAN]);
        assert_eq!(x, [3.0, 4.0]);
    }
}
