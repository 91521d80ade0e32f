//! Adam (Kingma and Ba 2015) for one group of parameters.
//!
//! A method fits one frame at a time on a compact copy of what is visible in it, so a group holds moments for those
//! rows only. They start at zero in every frame, as in the released BridgeSplat ("moments zeroed, step counter
//! kept"). [`StepCounter`] says whether the step counter is kept: if so, there is no bias correction, and the first
//! steps after zeroing are up to 3.2 times as long.
//!
//! [`RowAdam`] does the same for one row of values per Gaussian, and touches only rows that have had a gradient in
//! the frame: most discs of an airway are out of sight, or behind others. A row without a gradient so far has zero
//! moments and a step of exactly zero, so skipping it is exact. Moments, parameters and gradients (which the rasteriser overwrites, so they need no clearing) are
//! processed in one vectorised pass (`ffi/splat/adam.rs`). Values are independent of each other, so any number of
//! threads gives the same bytes.

use rayon::prelude::*;

use crate::ffi::splat::adam::AdamStep;
use crate::splat::is_unheard;

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

/// What happens to the step counter when a new frame zeroes the moments.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StepCounter {
    /// It continues (released BridgeSplat).
    Kept,
    /// It restarts, so that the bias correction is right for the zeroed moments.
    Restarted,
}

/// The coefficients of step number `steps`, counted from 1.
fn rule(constants: AdamConstants, steps: u64) -> AdamStep {
    let steps = steps.min(i32::MAX as u64) as i32;
    let betas = [constants.beta1, constants.beta2];
    AdamStep {
        decay: betas.map(|b| b as f32),
        share: betas.map(|b| (1.0 - b) as f32),
        bias_correction: betas.map(|b| (1.0 / (1.0 - b.powi(steps))) as f32),
        epsilon: constants.epsilon as f32,
    }
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
        assert!(parameters.len() == gradient.len() && gradient.len() == self.first.len(), "group sizes differ");
        self.steps += 1;
        let rule = rule(self.constants, self.steps);
        let moments = self.first.iter_mut().zip(self.second.iter_mut());
        for ((parameter, &g), (first, second)) in parameters.iter_mut().zip(gradient).zip(moments) {
            rule.apply(rate as f32, parameter, g, first, second);
        }
    }
}

/// Rows per task.
const ROWS: usize = 512;
/// Rows covered by one repeated table of rates.
const RUN: usize = 64;

/// Adam's state for rows of `K` values, one row per Gaussian.
#[derive(Clone, Debug)]
pub struct RowAdam<const K: usize> {
    constants: AdamConstants,
    steps: u64,
    first: Vec<f32>,
    second: Vec<f32>,
    /// Rows that a step has touched since [`RowAdam::begin`]; the moments of the others are undefined.
    touched: Vec<bool>,
}

impl<const K: usize> RowAdam<K> {
    /// No rows yet; [`RowAdam::begin`] makes room.
    pub fn new(constants: AdamConstants) -> Self {
        RowAdam { constants, steps: 0, first: Vec::new(), second: Vec::new(), touched: Vec::new() }
    }

    /// Zero moments for `rows` rows: they are written when a row first has a gradient.
    pub fn begin(&mut self, rows: usize, counter: StepCounter) {
        if self.first.len() < rows * K {
            // Zeroed pages, which the system maps only when they are first written.
            self.first = vec![0.0; rows * K];
            self.second = vec![0.0; rows * K];
        }
        self.touched.clear();
        self.touched.resize(rows, false);
        if counter == StepCounter::Restarted {
            self.steps = 0;
        }
    }

    /// Steps all rows from now on, as if each had had a gradient: what leaving them out saves can then be measured.
    pub fn touch_all(&mut self) {
        self.touched.fill(true);
        self.first.fill(0.0);
        self.second.fill(0.0);
    }

    /// Number of rows touched since [`RowAdam::begin`], and the allocated length of both moments, in values.
    pub fn touched_rows_and_room(&self) -> (usize, usize) {
        (self.touched.iter().filter(|t| **t).count(), self.first.len() + self.second.len())
    }

    /// One step of every row that has a gradient now or had one in an earlier step, value `k` of a row at rate
    /// `rates[k]`. `parameters` and `gradient` hold `K` values a row; rows that `heard` rules out
    /// ([`crate::splat::Gradients::heard`]) have none. Values whose gradient is not finite stay as they are.
    pub fn step(&mut self, rates: [f64; K], parameters: &mut [f32], gradient: &[f32], heard: &[bool]) {
        let rows = self.touched.len();
        assert!([parameters.len(), gradient.len()] == [rows * K; 2], "group sizes differ");
        self.steps += 1;
        let rule = rule(self.constants, self.steps);
        let rates: Vec<f32> = rates.iter().map(|&r| r as f32).cycle().take(RUN * K).collect();
        let moments = self.first[..rows * K].par_chunks_mut(ROWS * K).zip(self.second.par_chunks_mut(ROWS * K));
        let values = parameters.par_chunks_mut(ROWS * K).zip(gradient.par_chunks(ROWS * K));
        let flags = self.touched.par_chunks_mut(ROWS);
        moments.zip(values).zip(flags).enumerate().for_each(
            |(task, (((first, second), (parameters, gradient)), touched))| {
                let speaks = |row: usize| {
                    !is_unheard(heard, task * ROWS + row) && gradient[row * K..(row + 1) * K].iter().any(|g| *g != 0.0)
                };
                let mut row = 0;
                while row < touched.len() {
                    let start = row;
                    while row < touched.len() && row - start < RUN && (touched[row] || speaks(row)) {
                        if !touched[row] {
                            touched[row] = true;
                            first[row * K..(row + 1) * K].fill(0.0);
                            second[row * K..(row + 1) * K].fill(0.0);
                        }
                        row += 1;
                    }
                    let run = start * K..row * K;
                    rule.apply_all(
                        &rates,
                        &mut parameters[run.clone()],
                        &gradient[run.clone()],
                        &mut first[run.clone()],
                        &mut second[run],
                    );
                    if row == start {
                        row += 1;
                    }
                }
            },
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::splat::GROUP;

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

    use crate::base::random::{CounterRng, Stage};

    /// Gradients of rows that come into view and leave it.
    fn frames(rows: usize) -> Vec<Vec<f32>> {
        let mut r = CounterRng::new(5, Stage::Test, &[]);
        (0..25)
            .map(|frame| {
                let visible: Vec<bool> = (0..rows).map(|k| k % 7 != 3 && (k / 90 + frame) % 5 != 0).collect();
                (0..rows * 12).map(|i| if visible[i / 12] { r.normal() as f32 } else { 0.0 }).collect()
            })
            .collect()
    }

    fn fit_rows(rows: usize, threads: usize) -> (Vec<f32>, RowAdam<12>) {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let mut adam = RowAdam::<12>::new(AdamConstants::default());
        let mut x: Vec<f32> = (0..rows * 12).map(|i| i as f32 * 1e-3).collect();
        adam.begin(rows, StepCounter::Restarted);
        // What is left of another frame must not matter.
        adam.first.fill(7.0);
        adam.second.fill(7.0);
        let rates = std::array::from_fn(|k| if k < 3 { 0.01 } else { 0.002 });
        pool.install(|| {
            for g in &frames(rows) {
                let heard: Vec<bool> = g.chunks(GROUP * 12).map(|group| group.iter().any(|g| *g != 0.0)).collect();
                assert!(heard.contains(&false));
                adam.step(rates, &mut x, g, &heard);
            }
        });
        (x, adam)
    }

    #[test]
    fn rows_step_as_the_whole_does_and_what_has_no_gradient_is_not_touched() {
        let rows = 1500;
        let (x, adam) = fit_rows(rows, 1);
        let mut whole = [Adam::new(AdamConstants::default()), Adam::new(AdamConstants::default())];
        whole.iter_mut().for_each(|adam| adam.begin(rows * 12, StepCounter::Restarted));
        let mut y: [Vec<f32>; 2] = std::array::from_fn(|_| (0..rows * 12).map(|i| i as f32 * 1e-3).collect());
        for g in &frames(rows) {
            whole.iter_mut().zip(&mut y).zip([0.01, 0.002]).for_each(|((adam, y), rate)| adam.step(rate, y, g));
        }
        for (i, value) in x.iter().enumerate() {
            assert_eq!(value.to_bits(), y[usize::from(i % 12 >= 3)][i].to_bits(), "value {i}");
        }
        let hidden = (0..rows).filter(|k| k % 7 == 3);
        assert_eq!(adam.touched_rows_and_room(), (rows - hidden.clone().count(), 2 * rows * 12));
        for k in hidden {
            assert!(adam.first[k * 12..][..12].iter().chain(&adam.second[k * 12..][..12]).all(|v| *v == 7.0));
        }
    }

    #[test]
    fn rows_are_the_same_bytes_for_any_number_of_threads() {
        let one = fit_rows(1500, 1).0;
        for threads in [2, 8] {
            assert!(fit_rows(1500, threads).0.iter().zip(&one).all(|(a, b)| a.to_bits() == b.to_bits()));
        }
    }

    #[test]
    fn rows_with_a_gradient_that_is_not_finite_stay() {
        let mut adam = RowAdam::<2>::new(AdamConstants { epsilon: 0.0, ..AdamConstants::default() });
        adam.begin(3, StepCounter::Restarted);
        let mut x = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0];
        adam.step([1.0; 2], &mut x, &[0.0, f32::NAN, f32::INFINITY, 1.0, f32::NEG_INFINITY, 0.0], &[]);
        assert_eq!(x, [1.0, 2.0, 3.0, 3.0, 5.0, 6.0]);
        // Nothing of the refused gradients is remembered.
        adam.step([1.0; 2], &mut x, &[0.0; 6], &[]);
        assert_eq!((x[1], x[2], x[4]), (2.0, 3.0, 5.0));
    }
}
