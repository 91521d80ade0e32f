//! Extremes of functions on a grid. Minimum of a function of the phase: a grid over 0..1, then golden-section search; it
//! finds the first frame's phase by the depth given there (paper, Section 3.4). Top between the points: a parabola.

use crate::base::Result;

/// Ratio of the golden section.
const GOLDEN: f64 = 0.618_033_988_749_895;
/// Golden sections after the grid: each shortens the interval to .618 of its length.
const GOLDEN_STEPS: usize = 10;

/// The phase in 0..1 with the least `error`: the best of `steps` evenly spaced ones, then golden sections around it.
pub fn grid_search(steps: u32, mut error: impl FnMut(f64) -> Result<f64>) -> Result<f64> {
    let steps = steps.max(2);
    let step = 1.0 / (steps - 1) as f64;
    let mut best = (f64::INFINITY, 0.0);
    for i in 0..steps {
        let phase = i as f64 * step;
        let e = error(phase)?;
        if e < best.0 {
            best = (e, phase);
        }
    }
    let (mut low, mut high) = ((best.1 - step).max(0.0), (best.1 + step).min(1.0));
    for _ in 0..GOLDEN_STEPS {
        let (a, b) = (high - GOLDEN * (high - low), low + GOLDEN * (high - low));
        if error(a)? < error(b)? {
            high = b;
        } else {
            low = a;
        }
    }
    let refined = 0.5 * (low + high);
    Ok(if error(refined)? <= best.0 { refined } else { best.1 })
}

/// Where between -1/2 and 1/2 the parabola through the values at -1, 0 and 1 has its top; 0 where it has none.
pub fn top_of_parabola([low, middle, high]: [f64; 3]) -> f64 {
    let bend = low - 2.0 * middle + high;
    if bend < 0.0 { (0.5 * (low - high) / bend).clamp(-0.5, 0.5) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_minimum_is_found_also_at_the_ends_and_between_grid_points() {
        for truth in [0.0, 0.123, 0.5, 0.777, 1.0] {
            let found = grid_search(21, |p| Ok((p - truth).abs())).unwrap();
            assert!((found - truth).abs() < 1e-3, "{found} for {truth}");
        }
        let two_valleys = |p: f64| Ok(((p - 0.2).abs() + 0.1).min((p - 0.8).abs()));
        assert!((grid_search(21, two_valleys).unwrap() - 0.8).abs() < 1e-3);
    }
    #[test]
    fn the_top_of_a_parabola_is_exact_and_a_valley_has_none() {
        let through = |top: f64, bend: f64| [-1.0, 0.0, 1.0].map(|x: f64| 3.0 - bend * (x - top).powi(2));
        for top in [-0.4, 0.0, 0.31] {
            assert!((top_of_parabola(through(top, 2.0)) - top).abs() < 1e-12, "{top}");
            assert_eq!(top_of_parabola(through(top, -2.0)), 0.0);
        }
        assert_eq!(top_of_parabola([1.0; 3]), 0.0);
    }
}
