//! How a profile's iteration scale changes iteration counts and learning rates.

use crate::base::statistics::upper_median;

/// `published * scale`, at least one; none stays none.
pub fn scaled_iterations(published: f64, scale: f64) -> usize {
    if published == 0.0 { 0 } else { (published * scale).round().max(1.0) as usize }
}

/// Factor on rates that keeps the distance Adam can travel in a frame when a profile cuts the iterations: the same for
/// all methods. Left out where that distance is many times what a frame needs, and larger steps only overshoot: for the
/// phase, and for the mesh of BridgeSplat (10 mm a frame in `quick`).
pub fn rate_factor(iteration_scale: f64) -> f64 {
    (1.0 / iteration_scale).clamp(1.0, 10.0)
}

/// [`rate_factor`] for rates that hold for frames `rate_interval_s` apart, in a film of frames taken at `time_s`: what
/// differs between two frames, their light above all, grows with the time between them. The median interval counts, to
/// the nearest nanosecond, so that neither a frame left out nor the last bits of the times matter. The interval changes
/// nothing where `rate_interval_s` is 0, and for a film of one frame.
pub fn paced_rate_factor(iteration_scale: f64, rate_interval_s: f64, time_s: &[f64]) -> f64 {
    rate_factor(iteration_scale) * interval_factor(rate_interval_s, time_s)
}

fn interval_factor(rate_interval_s: f64, time_s: &[f64]) -> f64 {
    let median = upper_median(time_s.windows(2).map(|pair| pair[1] - pair[0])).unwrap_or(0.0);
    let interval_s = (median * 1e9).round() / 1e9;
    if rate_interval_s > 0.0 && interval_s > 0.0 { (interval_s / rate_interval_s).clamp(0.1, 10.0) } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// As much is learned in a second, whatever the rate of frames; and a film may have one frame, or no times.
    #[test]
    fn rates_follow_the_interval() {
        assert_eq!(interval_factor(0.1, &[0.0, 0.1, 0.2]), 1.0);
        assert_eq!(interval_factor(0.1, &[3.0, 3.5]), 5.0);
        // Ten frames a second with their last bits, then with a gap at the start.
        let mut times: Vec<f64> = (0..40).map(|i| i as f64 / 10.0).collect();
        assert_eq!(interval_factor(0.1, &times), 1.0);
        times[0] = -3.0;
        assert_eq!(interval_factor(0.1, &times), 1.0);
        assert_eq!(paced_rate_factor(0.4, 0.1, &[3.0, 3.5]), 12.5);
        assert_eq!([0.0, 1e-9, 1e9].map(|s| interval_factor(0.1, &[0.0, s])), [1.0, 0.1, 10.0]);
        assert_eq!([&[][..], &[0.0]].map(|times| interval_factor(0.1, times)), [1.0; 2]);
        assert_eq!(interval_factor(0.0, &[0.0, 0.04]), 1.0);
    }

    /// A tenth of the iterations at ten times the rate goes as far; no profile goes slower than published.
    #[test]
    fn fewer_iterations_go_as_far() {
        assert_eq!([(100.0, 0.1), (3.0, 0.1), (0.0, 0.1)].map(|(n, scale)| scaled_iterations(n, scale)), [10, 1, 0]);
        assert_eq!([0.25, 0.01, 1.0, 2.0].map(rate_factor), [4.0, 10.0, 1.0, 1.0]);
    }
}
