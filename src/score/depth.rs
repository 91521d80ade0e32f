//! Depth errors of one frame, in mm, without any alignment: the methods know the metric CT and the pose.

use crate::base::Image;
use crate::base::depth::present;

/// Ratio below which a depth counts as right (Eigen et al. 2014).
const RATIO: f64 = 1.25;

/// Depth errors over the pixels whose true depth is above 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthErrors {
    /// Root mean square error in mm; an absent prediction counts with the farthest true depth of the frame as its error.
    pub rmse_mm: f64,
    /// Share with `max(p / t, t / p) < 1.25`; an absent prediction counts as wrong.
    pub delta_1_25: f64,
    /// Share with a prediction.
    pub coverage: f64,
}

/// Errors of `predicted` against `truth` (z-depth in mm, one channel, one shape); `None` when truth is nowhere above 0.
pub fn depth_errors(predicted: &Image<f32>, truth: &Image<f32>) -> Option<DepthErrors> {
    let farthest = truth.data.iter().copied().filter_map(present).fold(0.0, f64::max);
    let (mut squares, mut right, mut covered, mut valid) = (0.0, 0usize, 0usize, 0usize);
    for (&p, &t) in predicted.data.iter().zip(&truth.data) {
        let Some(t) = present(t) else { continue };
        valid += 1;
        let p = present(p);
        // Leaving out a pixel pays only against an error larger than any depth of the frame.
        let error = p.map_or(farthest, |p| p - t);
        squares += error * error;
        if let Some(p) = p {
            covered += 1;
            right += usize::from((p / t).max(t / p) < RATIO);
        }
    }
    let share = |count: usize| count as f64 / valid as f64;
    (valid > 0).then(|| DepthErrors {
        rmse_mm: (squares / valid as f64).sqrt(),
        delta_1_25: share(right),
        coverage: share(covered),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(data: &[f32]) -> Image<f32> {
        Image { width: data.len(), height: 1, channels: 1, data: data.to_vec() }
    }

    #[test]
    fn errors_by_hand() {
        let truth = image(&[10.0, 10.0, 20.0, 0.0, 4.0]);
        // Off by 3; ratio just inside 1.25; absent; no truth there; exact.
        let found = depth_errors(&image(&[13.0, 8.01, f32::NAN, 7.0, 4.0]), &truth).unwrap();
        let squares = 9.0 + (10.0f64 - f64::from(8.01f32)).powi(2) + 400.0;
        assert!((found.rmse_mm - (squares / 4.0).sqrt()).abs() < 1e-12);
        assert_eq!(found.delta_1_25, 0.5);
        assert_eq!(found.coverage, 0.75);
    }

    #[test]
    fn truth_is_perfect_and_what_has_no_truth_changes_nothing() {
        let truth = image(&[10.0, 0.0, 20.0]);
        let perfect = DepthErrors { rmse_mm: 0.0, delta_1_25: 1.0, coverage: 1.0 };
        assert_eq!(depth_errors(&truth, &truth), Some(perfect));
        assert_eq!(depth_errors(&image(&[10.0, 1e30, 20.0]), &truth), Some(perfect));
        assert_eq!(depth_errors(&truth, &image(&[0.0; 3])), None);
    }

    #[test]
    fn absent_values_of_every_kind_count_the_same() {
        let truth = image(&[10.0, 20.0]);
        let zero = depth_errors(&image(&[0.0, 20.0]), &truth);
        for absent in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -3.0, -0.0] {
            assert_eq!(depth_errors(&image(&[absent, 20.0]), &truth), zero);
        }
    }
}
