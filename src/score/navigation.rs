//! Errors of navigation: where the targets are in the *camera's* axes, predicted against true, so that errors of the pose
//! and of the tissue's motion count together. Where a prediction has no poses of its own, those that methods are told
//! stand in.

use glam::DVec3;

use super::prediction::Prediction;
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
    pub fn error_mm(&self) -> Option<f64> {
        mean(&self.distances_mm())
    }

    /// Whether the targets are lost by the truth (what the tracker says of itself is its error bar), in percent; `None`
    /// without any.
    pub fn lost_pct(&self) -> Option<f64> {
        self.error_mm().map(|error_mm| percent(error_mm > LOST_MM))
    }

    /// Whether the targets are lost while the error bar says otherwise, in percent; `None` where none is stated.
    pub fn silent_pct(&self) -> Option<f64> {
        self.error_mm().zip(self.bar_mm()).map(|(error_mm, bar_mm)| percent(error_mm > LOST_MM && bar_mm < UNSURE_MM))
    }

    /// Whether the targets are found again after a disturbance, in percent; `None` where none ends at this frame.
    pub fn recovered_pct(&self) -> Option<f64> {
        self.error_mm().zip(self.found_again).map(|(_, is_found)| percent(is_found))
    }

    /// The error bar: square root of the covariance's trace, mean over targets, mm; `None` where none is stated.
    pub fn bar_mm(&self) -> Option<f64> {
        mean(&self.deviations_mm.iter().map(|d| d.length()).collect::<Vec<_>>())
    }

    /// Percentage of the targets' coordinates in camera axes that are off by at most so many standard deviations; `None`
    /// where none are stated.
    pub fn coverage_pct(&self, deviations: f64) -> Option<f64> {
        let pairs = self.errors_mm.iter().zip(&self.deviations_mm);
        let within = pairs.flat_map(|(error, deviation)| {
            let (error, most) = (error.abs().to_array(), (*deviation * deviations).to_array());
            (0..3).map(move |k| percent(error[k] <= most[k]))
        });
        mean(&within.collect::<Vec<_>>())
    }
}

fn percent(holds: bool) -> f64 {
    if holds { 100.0 } else { 0.0 }
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
        let values = |error, bar| [frame(error, bar).lost_pct(), frame(error, bar).silent_pct()];
        assert_eq!(values(4.9, 1.0), [Some(0.0), Some(0.0)]);
        assert_eq!(values(5.1, 1.0), [Some(100.0), Some(100.0)]);
        assert_eq!(values(5.1, 2.6), [Some(100.0), Some(0.0)]);
        assert_eq!([frame(4.9, 0.0).silent_pct(), frame(4.9, 0.0).coverage_pct(2.0)], [None, None]);
        // Of three coordinates, two are exact and one is off by 3 deviations.
        let covered = frame(3.0, 3f64.sqrt()).coverage_pct(2.0).unwrap();
        assert!((covered - 200.0 / 3.0).abs() < 1e-9, "{covered}");
        assert_eq!(NavigationFrame::default().error_mm(), None);
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
