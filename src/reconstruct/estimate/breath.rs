//! Prediction of the next frame's phase from the phases so far, by two guesses: the last change continues
//! (constant velocity), or the breath repeats the change of one period ago. The period is estimated online by
//! YIN's difference function (de Cheveigne and Kawahara 2002): the lag after which the phases repeat, judged
//! relative to the mean over all shorter lags. Each guess is weighted by the inverse of its recent squared error, so
//! that the period loses its weight in a breath-hold or an irregular breath.

use crate::reconstruct::fitting::grid_search::top_of_parabola;

/// Share of the newest error in each guess's running mean square.
const NEWEST: f64 = 0.2;
/// YIN's absolute threshold: largest difference at the period, relative to the mean over the shorter lags.
const THRESHOLD: f64 = 0.15;
/// Frames required beyond one lag, as a share of the lag.
const OVERLAP: f64 = 0.3;
/// Largest number of past frames used to find the period.
const LONGEST: usize = 1000;
/// Mean squared difference of phase below which the airway is taken to be still.
const STILL: f64 = 1e-5;
/// Added to the mean squared errors, in phase squared: smaller differences between guesses are noise.
const FLOOR: f64 = 1e-6;

/// Whether the period is used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Repetition {
    /// Constant velocity alone.
    Ignored,
    /// The breath is expected to repeat itself.
    Expected,
}

/// The phases so far, equally spaced in time.
#[derive(Clone, Debug)]
pub struct BreathPredictor {
    velocity: f64,
    repetition: Repetition,
    phases: Vec<f64>,
    /// Frames per breath, as of the last frame.
    period: Option<f64>,
    /// Running mean squares of the errors of the two guesses.
    errors: [Option<f64>; 2],
}

impl BreathPredictor {
    /// No phase yet; `velocity` is the share of the last change that is expected to continue.
    pub fn new(velocity: f64, repetition: Repetition) -> Self {
        BreathPredictor { velocity, repetition, phases: Vec::new(), period: None, errors: [None; 2] }
    }

    /// The phases so far.
    pub fn phases(&self) -> &[f64] {
        &self.phases
    }

    /// The next phase, in 0..1.
    pub fn expected(&self) -> f64 {
        let [Some(steady), periodic] = self.guesses() else { return 0.5 };
        let expected = match (periodic, self.errors) {
            (Some(periodic), [Some(a), Some(b)]) => {
                let (a, b) = (1.0 / (a + FLOOR), 1.0 / (b + FLOOR));
                (a * steady + b * periodic) / (a + b)
            }
            _ => steady,
        };
        expected.clamp(0.0, 1.0)
    }

    /// Appends the next phase and updates the errors of the guesses and the period.
    pub fn add(&mut self, phase: f64) {
        for (guess, error) in self.guesses().into_iter().zip(&mut self.errors) {
            let Some(guess) = guess else { continue };
            let square = (guess.clamp(0.0, 1.0) - phase).powi(2);
            *error = Some(error.map_or(square, |e| e + NEWEST * (square - e)));
        }
        self.phases.push(phase);
        if self.repetition == Repetition::Expected {
            self.period = period(&self.phases[self.phases.len().saturating_sub(LONGEST)..]);
        }
    }

    /// The guesses by constant velocity and by the change of one period ago.
    fn guesses(&self) -> [Option<f64>; 2] {
        let steady = match *self.phases.as_slice() {
            [] => None,
            [only] => Some(only),
            [.., before, last] => Some(last + self.velocity * (last - before)),
        };
        let repeated = self.period.zip(self.phases.last()).and_then(|(period, last)| {
            let now = self.phases.len() as f64 - 1.0;
            Some(last + self.at(now + 1.0 - period)? - self.at(now - period)?)
        });
        [steady, repeated]
    }

    /// The phase at a fractional frame number, linearly interpolated.
    fn at(&self, frame: f64) -> Option<f64> {
        if frame < 0.0 {
            return None;
        }
        let (below, share) = (frame.floor() as usize, frame.fract());
        let low = *self.phases.get(below)?;
        let high = self.phases.get(below + 1).copied().unwrap_or(low);
        Some(low + share * (high - low))
    }
}

/// Lag in frames after which `phases` repeat; `None` if they do not, or not yet. YIN: the difference
/// `d(lag) = mean (alpha_t - alpha_{t+lag})^2` relative to its mean over all shorter lags,
/// `d'(lag) = d(lag) lag / sum_{k <= lag} d(k)`.
fn period(phases: &[f64]) -> Option<f64> {
    let difference = |lag: usize| {
        let pairs = phases.iter().zip(&phases[lag..]);
        pairs.map(|(a, b)| (a - b).powi(2)).sum::<f64>() / (phases.len() - lag) as f64
    };
    // d' at all lags that leave enough overlap.
    let longest = (phases.len() as f64 / (1.0 + OVERLAP)) as usize;
    let mut sum = 0.0;
    let mut relative = vec![1.0];
    for lag in 1..=longest {
        let d = difference(lag);
        sum += d;
        relative.push(if sum / lag as f64 > STILL { d * lag as f64 / sum } else { 1.0 });
    }
    // The first valley below the threshold.
    let lowest_from = |start: usize| {
        let mut lag = start;
        while lag + 1 < relative.len() && relative[lag + 1] <= relative[lag] {
            lag += 1;
        }
        lag
    };
    let start = (2..relative.len()).find(|&lag| relative[lag] < THRESHOLD)?;
    let lag = lowest_from(start);
    // Refine between frames by the minimum of a parabola. There is none where the difference still falls at the
    // longest lag.
    let (&left, &middle, &right) = (relative.get(lag - 1)?, relative.get(lag)?, relative.get(lag + 1)?);
    Some(lag as f64 + top_of_parabola([-left, -middle, -right]))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Slow expiration, pause, quicker inspiration: not a sine.
    fn breath(frame: f64, period: f64) -> f64 {
        let t = (frame / period).fract();
        let rise = (std::f64::consts::PI * (t / 0.55).min(1.0)).cos();
        let fall = (std::f64::consts::PI * ((t - 0.65) / 0.35).max(0.0)).cos();
        if t < 0.65 { 0.5 - 0.5 * rise } else { 0.5 + 0.5 * fall }
    }

    /// Root mean square of expected against actual after `from` frames.
    fn error(wave: impl Fn(usize) -> f64, frames: usize, from: usize, repetition: Repetition) -> f64 {
        let mut state = BreathPredictor::new(1.0, repetition);
        let mut sum = 0.0;
        for frame in 0..frames {
            if frame >= from {
                sum += (state.expected() - wave(frame)).powi(2);
            }
            state.add(wave(frame));
        }
        (sum / (frames - from) as f64).sqrt()
    }

    #[test]
    fn a_planted_period_is_found_between_frames() {
        for planted in [31.0, 40.0, 43.7] {
            let phases: Vec<f64> = (0..120).map(|f| breath(f as f64, planted)).collect();
            let found = period(&phases).unwrap();
            assert!((found - planted).abs() < 0.4, "{found} for {planted}");
        }
    }

    #[test]
    fn no_period_is_found_before_a_breath_is_over_or_where_nothing_moves() {
        let phases: Vec<f64> = (0..45).map(|f| breath(f as f64, 40.0)).collect();
        assert_eq!(period(&phases), None);
        assert_eq!(period(&[0.4; 200]), None);
        assert_eq!(period(&[]), None);
    }

    #[test]
    fn knowing_the_period_helps_where_the_breath_repeats() {
        let wave = |f: usize| breath(f as f64, 40.0);
        let [without, with] = [Repetition::Ignored, Repetition::Expected].map(|r| error(wave, 160, 80, r));
        assert!(with < 0.5 * without, "{with} {without}");
    }

    #[test]
    fn it_does_not_hurt_in_a_breath_hold_or_an_irregular_breath() {
        let hold = |f: usize| if f < 110 { breath(f as f64, 40.0) } else { breath(110.0, 40.0) };
        let irregular = |f: usize| {
            let turns = f as f64 / 40.0 + 0.25 * (f as f64 * 0.071).sin();
            breath(turns * 40.0, 40.0) * (0.7 + 0.3 * (f as f64 * 0.031).cos())
        };
        for wave in [&hold as &dyn Fn(usize) -> f64, &irregular] {
            let [without, with] = [Repetition::Ignored, Repetition::Expected].map(|r| error(wave, 200, 60, r));
            assert!(with < 1.1 * without, "{with} {without}");
        }
    }
}
