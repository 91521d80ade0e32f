//! The breathing phase over time: a C1-continuous tidal waveform, 1.5 s in and 2.5 s out by default.
//!
//! A driving pressure P(t) in [0, 1] (0 end of expiration, 1 end of inspiration) is a raised cosine of warped time
//! within each half-breath; the lung follows it along the exponential pressure-volume curve of Salazar and Knowles (J
//! Appl Physiol 19:97, 1964), V(P) = (1 - exp(-k P)) / (1 - exp(-k)), with different stiffnesses k for breathing out
//! and in (hysteresis). The warp makes expiration fast first and slow later, like elastic recoil against a resistance.
//! The phase is 1 - V. At both turning points dP/dt = 0, so dV/dt = 0 whatever k: C1 across half-breaths.
//!
//! A film starts in the breath hold of the first CT: phase 0 for `start_hold_s`, then an exhalation. It ends at a phase
//! that is drawn for the case ([`Waveform::ending`]), so that no limit of the range decides what is left at the end. A
//! breath may be held at the end of each later inhalation, too (`hold_s`), where the lung is at rest anyway.
//!
//! Left out: sighs, coughs. The end points of the volume are those of the two CTs; real tidal breathing uses a
//! part of that range, which `amplitude` and `offset` express.

use serde::{Deserialize, Serialize};

use crate::base::random::{CounterRng, Stage};
use crate::base::range::{KeyRanges, NumberRange, SHARE};
use crate::base::{Error, Result};

/// Ranges of `[waveform]`. The shortest breath takes 20 ms, and a film starts within the first hour.
const RANGES: KeyRanges = KeyRanges(&[
    ("inhale_s", NumberRange::new(0.1, 60.0)),
    ("exhale_s", NumberRange::new(0.1, 60.0)),
    ("period_scale", NumberRange::new(0.1, 10.0)),
    ("amplitude", NumberRange::new(1e-3, 1.0)),
    ("offset", SHARE),
    ("start_hold_s", NumberRange::new(0.0, 60.0)),
    ("end_phase", SHARE),
    ("hold_s", NumberRange::new(0.0, 60.0)),
    ("irregularity", SHARE),
]);
/// Stiffness k of the pressure-volume curve while breathing in and while breathing out.
const STIFFNESS_IN: f64 = 1.2;
const STIFFNESS_OUT: f64 = 0.8;
/// How much faster than uniform the expiratory pressure falls at first (below 1, so that time never runs backwards).
const RECOIL: f64 = 0.35;
/// Irregular breathing: one standard deviation of log duration and of relative depth at `irregularity = 1`.
const DURATION_SPREAD: f64 = 0.25;
const DEPTH_SPREAD: f64 = 0.35;

/// Part of the range of a breath from which the phase at the end of a film is drawn.
const END_RANGE: [f64; 2] = [0.15, 0.85];
/// Largest factor on the period, either way, that brings the end of a film to its phase, and the step of the search in
/// its logarithm.
const MOST_CHANGE: f64 = 1.5;
const CHANGE_STEP: f64 = 0.005;

/// How a case breathes. All durations in seconds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Waveform {
    /// Duration of the inhalation before `period_scale`.
    pub inhale_s: f64,
    /// Duration of the exhalation before `period_scale`.
    pub exhale_s: f64,
    /// Factor on both durations: above 1 is slower breathing.
    pub period_scale: f64,
    /// Part of the range from inspiration CT to expiration CT that a breath covers, in (0, 1].
    pub amplitude: f64,
    /// Phase at the end of a full inhalation; `offset + amplitude` is at most 1.
    pub offset: f64,
    /// For how long a film stays in the breath hold at full inspiration (phase 0) in which it starts; not scaled.
    pub start_hold_s: f64,
    /// Phase at which a film ends, reached by breathing a little faster or slower than stated; drawn where absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub end_phase: Option<f64>,
    /// For how long each full inhalation is held; not scaled.
    #[serde(skip_serializing_if = "is_zero")]
    pub hold_s: f64,
    /// 0 is perfectly regular; 1 varies duration and depth from breath to breath like restless sleep.
    pub irregularity: f64,
}

/// A value of 0 is left out of the hash, so that cases without the key keep theirs.
pub(super) fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

impl Default for Waveform {
    fn default() -> Self {
        Waveform {
            inhale_s: 1.5,
            exhale_s: 2.5,
            period_scale: 1.0,
            amplitude: 1.0,
            offset: 0.0,
            start_hold_s: 0.5,
            end_phase: None,
            hold_s: 0.0,
            irregularity: 0.0,
        }
    }
}

impl Waveform {
    /// Rejects values that describe no breath; the element names the key.
    pub fn validate(&self) -> Result<()> {
        RANGES.check("waveform", self)?;
        if self.offset + self.amplitude > 1.0 + 1e-12 {
            return Err(Error::input(format!(
                "offset {} plus amplitude {} goes beyond the expiration CT (1)",
                self.offset, self.amplitude
            ))
            .element("waveform.amplitude"));
        }
        if self.end_phase.is_some_and(|phase| !(self.offset..=self.offset + self.amplitude).contains(&phase)) {
            return Err(Error::input("must lie within the range that breaths cover").element("waveform.end_phase"));
        }
        Ok(())
    }

    /// Mean duration of one breath in seconds.
    pub fn period_s(&self) -> f64 {
        (self.inhale_s + self.exhale_s) * self.period_scale + self.hold_s
    }

    /// Breathing phase in [0, 1] (0 full inspiration, 1 full expiration) `time_s` after the start of the film (not
    /// negative). `seed` decides the irregularities, nothing else.
    pub fn phase(&self, time_s: f64, seed: u64) -> f64 {
        self.unclamped_phase(time_s, seed).clamp(0.0, 1.0)
    }

    fn unclamped_phase(&self, time_s: f64, seed: u64) -> f64 {
        let mut left_s = time_s - self.start_hold_s;
        if left_s < 0.0 {
            return 0.0;
        }
        // Out of the first CT's breath hold, whatever the depth of the breaths that follow.
        let first = Breath { turn: 0.0, ..self.breath(0, seed) };
        if left_s < first.exhale_s {
            return self.exhaling(&first, left_s, self.breath(1, seed).start);
        }
        left_s -= first.exhale_s;
        let mut breath = 1;
        if self.irregularity == 0.0 {
            let whole = (left_s / self.period_s()).floor();
            left_s -= whole * self.period_s();
            breath += whole as u64;
        }
        loop {
            let now = self.breath(breath, seed);
            // Inhalation, hold, exhalation.
            if left_s < now.inhale_s {
                let pressure = 0.5 - 0.5 * (std::f64::consts::PI * left_s / now.inhale_s).cos();
                return now.start + (now.turn - now.start) * volume(pressure, STIFFNESS_IN);
            }
            left_s -= now.inhale_s;
            if left_s < self.hold_s {
                return now.turn;
            }
            left_s -= self.hold_s;
            if left_s < now.exhale_s {
                return self.exhaling(&now, left_s, self.breath(breath + 1, seed).start);
            }
            left_s -= now.exhale_s;
            breath += 1;
        }
    }

    /// Phase `time_s` into the exhalation of `breath`, which ends at the phase `end`.
    fn exhaling(&self, breath: &Breath, time_s: f64, end: f64) -> f64 {
        let uniform = time_s / breath.exhale_s;
        let warped = uniform + RECOIL * (std::f64::consts::PI * uniform).sin() / std::f64::consts::PI;
        let pressure = 0.5 + 0.5 * (std::f64::consts::PI * warped).cos();
        end + (breath.turn - end) * volume(pressure, STIFFNESS_OUT)
    }

    /// The phase at which a film should end: `end_phase`, or what `seed` draws from `END_RANGE` of the range of the breaths.
    pub fn wanted_end(&self, seed: u64) -> f64 {
        let drawn = CounterRng::new(seed, Stage::Waveform, &[u64::MAX]).range(END_RANGE[0], END_RANGE[1]);
        self.end_phase.unwrap_or(self.offset + self.amplitude * drawn)
    }

    /// The same breathing, a little faster or slower, so that the phase at `time_s` is [`Waveform::wanted_end`]. The smallest change of the period
    /// that does it is taken; where none up to `MOST_CHANGE` does, the one that comes nearest.
    pub fn ending(&self, time_s: f64, seed: u64) -> Waveform {
        let wanted = self.wanted_end(seed);
        let changed = |log: f64| Waveform { period_scale: self.period_scale * log.exp(), ..self.clone() };
        let off = |log: f64| changed(log).phase(time_s, seed) - wanted;
        let steps = (MOST_CHANGE.ln() / CHANGE_STEP).ceil() as i32;
        let mut nearest = (off(0.0).abs(), 0.0);
        for step in 0..steps {
            for side in [1.0, -1.0] {
                let (mut low, mut high) = (side * CHANGE_STEP * step as f64, side * CHANGE_STEP * (step + 1) as f64);
                let (from, to) = (off(low), off(high));
                if to.abs() < nearest.0 {
                    nearest = (to.abs(), high);
                }
                if from * to <= 0.0 {
                    for _ in 0..50 {
                        let middle = 0.5 * (low + high);
                        if off(middle) * from > 0.0 { low = middle } else { high = middle }
                    }
                    return changed(0.5 * (low + high));
                }
            }
        }
        changed(nearest.1)
    }

    /// The `index`-th breath of the sequence.
    fn breath(&self, index: u64, seed: u64) -> Breath {
        let (full, empty) = (self.offset, self.offset + self.amplitude);
        let mut breath = Breath {
            inhale_s: self.inhale_s * self.period_scale,
            exhale_s: self.exhale_s * self.period_scale,
            start: empty,
            turn: full,
        };
        if self.irregularity > 0.0 {
            let mut random = CounterRng::new(seed, Stage::Waveform, &[index]);
            let mut spread = |sd: f64| sd * self.irregularity * random.normal().clamp(-2.0, 2.0);
            breath.inhale_s *= spread(DURATION_SPREAD).exp();
            breath.exhale_s *= spread(DURATION_SPREAD).exp();
            breath.turn = full + self.amplitude * spread(DEPTH_SPREAD).abs().min(0.6);
            breath.start = empty - self.amplitude * (0.3 * spread(DEPTH_SPREAD)).abs().min(0.2);
        }
        breath
    }
}

/// One breath: phases at the start of the inhalation and at the turn to exhalation.
struct Breath {
    inhale_s: f64,
    exhale_s: f64,
    start: f64,
    turn: f64,
}

/// Salazar and Knowles' volume at `pressure`, both in [0, 1].
fn volume(pressure: f64, stiffness: f64) -> f64 {
    (-(-stiffness * pressure).exp_m1()) / (-(-stiffness).exp_m1())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn all() -> Vec<Waveform> {
        vec![
            Waveform::default(),
            Waveform { period_scale: 1.3, amplitude: 0.8, offset: 0.1, start_hold_s: 2.2, ..Waveform::default() },
            Waveform { irregularity: 1.0, ..Waveform::default() },
            Waveform { hold_s: 1.1, period_scale: 0.9, ..Waveform::default() },
        ]
    }

    #[test]
    fn phase_is_continuously_differentiable_and_in_range() {
        for waveform in all() {
            waveform.validate().unwrap();
            let (step, mut worst_jump) = (1e-4, 0.0f64);
            let values: Vec<f64> = (0..300_000).map(|i| waveform.phase(i as f64 * step, 3)).collect();
            for v in &values {
                assert!((0.0..=waveform.offset + waveform.amplitude + 1e-12).contains(v), "{v}");
            }
            for w in values.windows(3) {
                // A kink of slope s would show as s; a smooth curve shows step * curvature, below 1e-4 * 40.
                worst_jump = worst_jump.max(((w[2] - w[1]) - (w[1] - w[0])).abs() / step);
            }
            assert!(worst_jump < 4e-3, "slope jumps by {worst_jump} per second");
        }
    }

    #[test]
    fn a_film_starts_in_the_breath_hold_and_breathes_out_in_two_and_a_half_seconds_and_in_in_one_and_a_half() {
        let w = Waveform::default();
        assert_eq!(w.period_s(), 4.0);
        for i in 0..=50 {
            assert_eq!(w.phase(i as f64 * 0.01, 0), 0.0);
        }
        assert!((w.phase(3.0, 0) - 1.0).abs() < 1e-12);
        assert!(w.phase(4.5, 0).abs() < 1e-12);
        assert!((w.phase(7.0, 0) - 1.0).abs() < 1e-12);
        assert!((w.phase(2.0, 0) - w.phase(4002.0, 0)).abs() < 1e-9);
        for i in 50..299 {
            let t = i as f64 * 0.01;
            assert!(w.phase(t + 0.01, 0) > w.phase(t, 0), "exhaling at {t}");
        }
        for i in 300..449 {
            let t = i as f64 * 0.01;
            assert!(w.phase(t + 0.01, 0) < w.phase(t, 0), "inhaling at {t}");
        }
        // Shallow breaths come after the deep one of the CT.
        let shallow = Waveform { amplitude: 0.5, offset: 0.3, ..w };
        assert_eq!(shallow.phase(0.5, 0), 0.0);
        assert!((shallow.phase(3.0, 0) - 0.8).abs() < 1e-12 && (shallow.phase(4.5, 0) - 0.3).abs() < 1e-12);
    }

    #[test]
    fn a_held_breath_stays_at_full_inspiration_and_then_goes_on_as_if_nothing_had_been() {
        let (free, held) = (Waveform::default(), Waveform { hold_s: 2.0, ..Waveform::default() });
        assert_eq!(held.period_s(), 6.0);
        for i in 0..15 {
            let t = 0.1 * i as f64;
            assert!(held.phase(4.5 + t, 0).abs() < 1e-12);
            assert!((held.phase(6.5 + t, 0) - free.phase(4.5 + t, 0)).abs() < 1e-12);
            assert!((held.phase(9.0 + t, 0) - free.phase(7.0 + t, 0)).abs() < 1e-12);
        }
    }

    /// Salazar and Knowles: at a pressure P the volume is (1 - exp(-k P)) / (1 - exp(-k)), k = 0.8 out and 1.2 in.
    #[test]
    fn breathing_out_and_in_have_stiffnesses_of_their_own() {
        let (w, pi) = (Waveform::default(), std::f64::consts::PI);
        let volume = |pressure: f64, k: f64| (1.0 - (-k * pressure).exp()) / (1.0 - (-k).exp());
        // In the middle of an inhalation the pressure is one half; of an exhalation, the recoil has brought it lower.
        assert!((w.phase(3.75, 0) - (1.0 - volume(0.5, 1.2))).abs() < 1e-12, "{}", w.phase(3.75, 0));
        let out = 0.5 + 0.5 * (pi * (0.5 + 0.35 / pi)).cos();
        assert!((w.phase(1.75, 0) - (1.0 - volume(out, 0.8))).abs() < 1e-12, "{}", w.phase(1.75, 0));
    }

    #[test]
    fn the_breath_is_not_symmetric_in_time() {
        let w = Waveform::default();
        // Half of the expired volume is out well before half of the expiratory time.
        assert!(w.phase(0.5 + 1.25, 0) > 0.58);
        let half_in = w.phase(3.75, 0);
        assert!((half_in - (1.0 - w.phase(0.5 + 1.25, 0))).abs() > 0.02 || half_in < 0.5);
    }

    #[test]
    fn a_film_ends_at_the_drawn_phase_with_a_small_change_of_the_period() {
        for waveform in all() {
            for (duration_s, most) in [(4.0, 0.35), (16.0, 0.12), (60.0, 0.04)] {
                let mut ends = Vec::new();
                for seed in 0..40 {
                    let ending = waveform.ending(duration_s, seed);
                    let end = ending.phase(duration_s, seed);
                    let part = (end - waveform.offset) / waveform.amplitude;
                    assert!((0.149..=0.851).contains(&part), "{waveform:?}, seed {seed}: {end}");
                    if waveform.irregularity == 0.0 && waveform.start_hold_s == 0.5 {
                        let change = (ending.period_scale / waveform.period_scale).ln().abs();
                        assert!(change < most, "{duration_s} s, seed {seed}: {change}");
                    }
                    ends.push(part);
                }
                assert!(ends.iter().any(|&e| e < 0.3) && ends.iter().any(|&e| e > 0.7), "{ends:?}");
            }
            let wanted = Waveform { end_phase: Some(0.44), ..waveform };
            assert!((wanted.ending(16.0, 1).phase(16.0, 1) - 0.44).abs() < 1e-6);
        }
    }

    #[test]
    fn irregular_breaths_differ_and_follow_the_seed() {
        let w = Waveform { irregularity: 0.7, ..Waveform::default() };
        assert_eq!(w.phase(37.3, 5), w.phase(37.3, 5));
        assert_ne!(w.phase(37.3, 5), w.phase(37.3, 6));
        // Turning points: most breaths neither fill nor empty the lung as far as the CTs' did.
        let at = |i: usize| w.phase(10.0 + 0.01 * i as f64, 5);
        let turns = |sign: f64| {
            let is_top = |i: &usize| sign * at(*i) >= sign * at(i - 1) && sign * at(*i) > sign * at(i + 1);
            (1..20_000).filter(is_top).map(at).collect::<Vec<f64>>()
        };
        let (empty, full) = (turns(1.0), turns(-1.0));
        assert!(empty.len() > 30 && full.len() > 30);
        assert!(empty.iter().filter(|&&p| p < 0.999).count() > empty.len() / 2, "{empty:?}");
        assert!(full.iter().filter(|&&p| p > 0.001).count() > full.len() / 2, "{full:?}");
    }

    #[test]
    fn impossible_breaths_are_refused_by_key() {
        let w = Waveform { amplitude: 0.9, offset: 0.2, ..Waveform::default() };
        assert!(w.validate().unwrap_err().to_string().contains("waveform.amplitude"));
        let said = |w: Waveform| w.validate().unwrap_err().to_string();
        assert_eq!(
            said(Waveform { inhale_s: f64::NAN, ..Waveform::default() }),
            "waveform.inhale_s: NaN must lie in 0.1 to 60"
        );
        // What the loop over breaths would never end with.
        assert!(
            said(Waveform { period_scale: 1e-300, ..Waveform::default() }).contains("waveform.period_scale: 1e-300")
        );
        assert!(said(Waveform { start_hold_s: 1e12, ..Waveform::default() }).contains("waveform.start_hold_s: 1e12"));
    }
}
