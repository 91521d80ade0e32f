//! Errors of navigation: where the targets are in the *camera's* axes, predicted against true, so that errors of the pose
//! and of the tissue's motion count together. Where a prediction has no poses of its own, those that methods are told
//! stand in.

use glam::DVec3;

use super::prediction::Prediction;
use super::registry::metric;
use super::statistics::mean;
use super::truth::Truth;
use crate::base::Result;
use crate::base::target_limits::{LOST_MM, UNSURE_MM};
use crate::simulate::sequence::FrameRecord;

/// Seconds after a cough or a touch of the wall within which the targets are to be found again.
const RECOVERY_S: f64 = 1.0;

/// Errors of one frame.
#[derive(Clone, Debug, Default)]
pub struct NavigationFrame {
    /// Predicted minus true place of each target in camera axes, mm.
    errors_mm: Vec<DVec3>,
    /// Standard deviations that the prediction states of each place, along the camera's axes, mm; empty without any.
    deviations_mm: Vec<DVec3>,
    /// Of the last frame of a cough or a touch of the wall: whether the targets were found again soon enough.
    found_again: Option<bool>,
}

/// The errors of each frame; empty for a prediction without targets.
pub fn navigation_errors(truth: &dyn Truth, prediction: &Prediction) -> Result<Vec<NavigationFrame>> {
    let Some(places) = prediction.targets() else { return Ok(Vec::new()) };
    let told = truth.told_poses();
    let frame = |(index, record): (usize, &FrameRecord)| {
        let own = prediction.poses().map_or(told[index], |poses| poses[index]).inverse();
        let (seen, count) = (record.world_from_camera.inverse(), truth.targets().len());
        let error = |(target, place): (usize, &DVec3)| {
            own.transform_point3(*place) - seen.transform_point3(truth.target_mm(target, index))
        };
        let stated = prediction.target_covariance_mm2().map_or_else(Vec::new, |all| {
            all[index].iter().map(|c| DVec3::new(c.x_axis.x, c.y_axis.y, c.z_axis.z).map(f64::sqrt)).collect()
        });
        let errors_mm = places[index].iter().take(count).enumerate().map(error).collect();
        NavigationFrame { errors_mm, deviations_mm: stated, found_again: None }
    };
    let mut frames: Vec<NavigationFrame> = truth.frames().iter().enumerate().map(frame).collect();
    let times_s: Vec<f64> = truth.frames().iter().map(|frame| frame.time_s).collect();
    let is_found: Vec<bool> = frames.iter().map(|f| f.error_mm().is_some_and(|error| error <= LOST_MM)).collect();
    let found_again = recoveries(&times_s, &truth.disturbed()?, &is_found);
    frames.iter_mut().zip(found_again).for_each(|(frame, found)| frame.found_again = found);
    Ok(frames)
}

/// For the last frame of each stretch of disturbed ones: whether the targets are found within [`RECOVERY_S`] after it.
/// Nothing where the film ends before that can be told.
fn recoveries(times_s: &[f64], disturbed: &[bool], is_found: &[bool]) -> Vec<Option<bool>> {
    let of_frame = |end: usize| {
        if !disturbed[end] || *disturbed.get(end + 1)? {
            return None;
        }
        let since_s = |frame: usize| times_s[frame] - times_s[end];
        let mut after = end + 1..times_s.len();
        let within = |frame: &usize| since_s(*frame) <= RECOVERY_S + 1e-9;
        let is_told = after.clone().next_back().is_some_and(|last| since_s(last) >= RECOVERY_S - 1e-9);
        let is_found_again = after.by_ref().take_while(within).any(|frame| is_found[frame]);
        (is_found_again || is_told).then_some(is_found_again)
    };
    (0..times_s.len()).map(of_frame).collect()
}

impl NavigationFrame {
    /// Distance of each target from its true place in camera axes, mm.
    pub fn distances_mm(&self) -> Vec<f64> {
        self.errors_mm.iter().map(|e| e.length()).collect()
    }

    /// Mean over the targets, mm; `None` without any.
    fn error_mm(&self) -> Option<f64> {
        mean(&self.distances_mm())
    }

    /// The frame's value of the metric `id`; `None` for a metric that is not of navigation, and where the prediction
    /// states no error bar that it needs.
    pub fn value(&self, id: &str) -> Option<f64> {
        let error_mm = self.error_mm()?;
        // By the truth: what the tracker says of itself is its error bar.
        let is_off = error_mm > LOST_MM;
        let percent = |holds: bool| if holds { 100.0 } else { 0.0 };
        match id {
            "navigation_error_mm" => Some(error_mm),
            "lost_pct" => Some(percent(is_off)),
            "silent_pct" => self.bar_mm().map(|bar_mm| percent(is_off && bar_mm < UNSURE_MM)),
            "recovered_pct" => self.found_again.map(percent),
            "navigation_coverage_1sd_pct" => self.coverage(1.0),
            "navigation_coverage_2sd_pct" => self.coverage(2.0),
            "navigation_sd_mm" => self.bar_mm(),
            _ => None,
        }
    }

    /// The error bar: square root of the covariance's trace, mean over targets, mm.
    fn bar_mm(&self) -> Option<f64> {
        mean(&self.deviations_mm.iter().map(|d| d.length()).collect::<Vec<_>>())
    }

    /// Percentage of the targets' coordinates in camera axes that are off by at most so many standard deviations.
    fn coverage(&self, deviations: f64) -> Option<f64> {
        let pairs = self.errors_mm.iter().zip(&self.deviations_mm);
        let within = pairs.flat_map(|(error, deviation)| {
            let (error, most) = (error.abs().to_array(), (*deviation * deviations).to_array());
            (0..3).map(move |k| if error[k] <= most[k] { 100.0 } else { 0.0 })
        });
        mean(&within.collect::<Vec<_>>())
    }
}

/// The values of one frame, by metric; none where there are no targets.
pub fn frame_values(frame: &NavigationFrame) -> impl Iterator<Item = (&'static str, f64)> {
    let ids = super::registry::registry().iter().map(|m| m.id);
    ids.filter_map(|id| Some((id, frame.value(id)?)))
}

/// Whether `id` is a metric of navigation that is a mean over frames.
pub fn is_frame_wise(id: &str) -> bool {
    metric(id).is_some()
        && (id.starts_with("navigation_") || ["lost_pct", "silent_pct", "recovered_pct"].contains(&id))
        && !id.contains("p95")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_is_lost_in_silence_only_if_its_error_bar_is_small() {
        let frame = |error: f64, bar: f64| NavigationFrame {
            errors_mm: vec![DVec3::X * error; 2],
            deviations_mm: if bar > 0.0 { vec![DVec3::splat(bar / 3f64.sqrt()); 2] } else { Vec::new() },
            found_again: None,
        };
        let values = |error, bar| ["lost_pct", "silent_pct"].map(|id| frame(error, bar).value(id));
        assert_eq!(values(4.9, 1.0), [Some(0.0), Some(0.0)]);
        assert_eq!(values(5.1, 1.0), [Some(100.0), Some(100.0)]);
        assert_eq!(values(5.1, 2.6), [Some(100.0), Some(0.0)]);
        assert_eq!(["silent_pct", "navigation_coverage_2sd_pct"].map(|id| frame(4.9, 0.0).value(id)), [None, None]);
        // Of three coordinates, two are exact and one is off by 3 deviations.
        let covered = frame(3.0, 3f64.sqrt()).value("navigation_coverage_2sd_pct").unwrap();
        assert!((covered - 200.0 / 3.0).abs() < 1e-9, "{covered}");
        assert_eq!(NavigationFrame::default().value("navigation_error_mm"), None);
    }

    #[test]
    fn a_disturbance_is_over_with_its_last_frame_and_recovery_has_a_second() {
        let times: Vec<f64> = (0..40).map(|frame| frame as f64 * 0.1).collect();
        let disturbed: Vec<bool> = (0..40).map(|frame| [2, 3, 4, 20, 21, 35].contains(&frame)).collect();
        let ends = |is_found: &dyn Fn(usize) -> bool| {
            let is_found: Vec<bool> = (0..40).map(is_found).collect();
            let found = recoveries(&times, &disturbed, &is_found);
            found.into_iter().enumerate().filter_map(|(frame, found)| Some((frame, found?))).collect::<Vec<_>>()
        };
        assert_eq!(ends(&|_| true), [(4, true), (21, true), (35, true)]);
        // Found during the disturbance alone; the film ends .4 s after the last one.
        assert_eq!(ends(&|frame| disturbed[frame]), [(4, false), (21, false)]);
        // A film that ends exactly a second later tells.
        let of_film = |frames: usize| recoveries(&times[..frames], &disturbed[..frames], &vec![false; frames])[4];
        assert_eq!((of_film(15), of_film(14)), (Some(false), None));
        // Exactly a second after the first, a frame later than that after the second.
        assert_eq!(ends(&|frame| [14, 32].contains(&frame)), [(4, true), (21, false)]);
    }
}
