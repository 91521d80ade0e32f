//! How well a frame agrees with the virtual view of each phase: normalised cross-correlation of local contrast, which
//! neither the exposure nor slow changes of the light affect (Luo et al., Med Image Anal 16:577, 2012).

use glam::DAffine3;
use rayon::prelude::*;

use crate::base::Image;
use crate::reconstruct::contract::Observation;
use crate::reconstruct::fitting::contrast::{ContrastImage, contrast_image};
use crate::reconstruct::fitting::grid_search::top_of_parabola;
use crate::reconstruct::geometry::breathing::BreathingMesh;
use crate::reconstruct::geometry::pyramid::PyramidLevel;
use crate::reconstruct::geometry::virtual_view::VirtualCamera;
use crate::reconstruct::geometry::visible::Reach;
use crate::reconstruct::settings::ContrastMatching;
use crate::splat::View;

/// Compares frames with virtual views.
pub struct ContrastMatcher<'a> {
    settings: &'a ContrastMatching,
    camera: VirtualCamera,
    observation: &'a Observation,
}

impl<'a> ContrastMatcher<'a> {
    /// For the frames of `observation`.
    pub fn new(settings: &'a ContrastMatching, reach: Reach, observation: &'a Observation) -> Self {
        let level = small(settings, observation, 0, &observation.world_from_camera[0]);
        ContrastMatcher { settings, camera: VirtualCamera::new(level.view.camera, reach), observation }
    }

    /// The correlation of `frame` with the view of `mesh` from `pose` (world from camera) at each phase of an even grid from
    /// 0 to 1.
    pub fn correlations(&self, frame: usize, pose: &DAffine3, mesh: BreathingMesh<'_>) -> Vec<f64> {
        let level = small(self.settings, self.observation, frame, pose);
        let radius = *self.settings.contrast_radius;
        let seen = contrast_image(&level.image, &level.weights, radius);
        let aimed = self.camera.aim(&level.view, mesh);
        let steps = (*self.settings.grid_steps).max(2);
        let at = |step: u32| {
            let expected = self.camera.render(&aimed, mesh, f64::from(step) / f64::from(steps - 1));
            correlation(&seen, &contrast_image(&expected.color, &level.weights, radius))
        };
        (0..steps).into_par_iter().map(at).collect()
    }
}

/// The frame from `pose` at a width of at most `largest_width`.
fn small(settings: &ContrastMatching, observation: &Observation, frame: usize, pose: &DAffine3) -> PyramidLevel {
    let level = PyramidLevel {
        view: View::new(observation.camera, *pose),
        image: observation.images[frame].to_unit(),
        weights: observation.pixel_weights().unwrap_or_default(),
    };
    level.halved_until(|level| level.is_within(*settings.largest_width))
}

/// Pearson correlation over the pixels that both images count, all channels together; 0 where one is even.
fn correlation(a: &ContrastImage, b: &ContrastImage) -> f64 {
    let grey =
        |image: &Image<f32>, i: usize| f64::from(image.data[3 * i] + image.data[3 * i + 1] + image.data[3 * i + 2]);
    let both: Vec<(f64, f64)> = (0..a.counts.len())
        .filter(|&i| a.counts[i] && b.counts[i])
        .map(|i| (grey(&a.contrast, i), grey(&b.contrast, i)))
        .collect();
    let count = both.len().max(1) as f64;
    let (mean_a, mean_b) = both.iter().fold((0.0, 0.0), |(a, b), (x, y)| (a + x / count, b + y / count));
    let (mut ab, mut aa, mut bb) = (0.0, 0.0, 0.0);
    for (x, y) in both {
        let (x, y) = (x - mean_a, y - mean_b);
        (ab, aa, bb) = (ab + x * y, aa + x * x, bb + y * y);
    }
    if aa > 0.0 && bb > 0.0 { ab / (aa * bb).sqrt() } else { 0.0 }
}

/// The phase at the peak of `values`, which stand at an even grid from 0 to 1: the highest, refined by the parabola
/// through its neighbours.
pub fn peak(values: &[f64]) -> f64 {
    let last = values.len() - 1;
    let best = (0..=last).fold(0, |best, i| if values[i] > values[best] { i } else { best });
    let mut place = best as f64;
    if (1..last).contains(&best) {
        place += top_of_parabola([values[best - 1], values[best], values[best + 1]]);
    }
    place / last as f64
}

/// `values` at `phase`, linear between the points of their grid.
pub fn at_phase_of(values: &[f64], phase: f64) -> f64 {
    let last = values.len() - 1;
    let place = phase.clamp(0.0, 1.0) * last as f64;
    let low = (place.floor() as usize).min(last - 1);
    values[low] + (values[low + 1] - values[low]) * (place - low as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_peak_is_found_between_the_points_of_the_grid_and_at_its_ends() {
        let values = |truth: f64| -> Vec<f64> { (0..21).map(|i| -(i as f64 / 20.0 - truth).powi(2)).collect() };
        for truth in [0.0, 0.03, 0.512, 1.0] {
            assert!((peak(&values(truth)) - truth).abs() < 0.026, "{truth}");
        }
        assert!((peak(&values(0.512)) - 0.512).abs() < 1e-12);
        assert!((at_phase_of(&[0.0, 1.0, 4.0], 0.75) - 2.5).abs() < 1e-12);
    }

    #[test]
    fn correlation_is_one_with_itself_and_blind_to_exposure() {
        let wave = |gain: f32| Image {
            width: 32,
            height: 32,
            channels: 3,
            data: (0..32 * 32 * 3).map(|i| gain * (0.5 + 0.3 * ((i / 3) as f32 * 0.37).sin())).collect(),
        };
        let [one, dark] = [1.0, 0.5].map(|gain| contrast_image(&wave(gain), &[], 0.1));
        assert!((correlation(&one, &one) - 1.0).abs() < 1e-9);
        assert!(correlation(&one, &dark) > 0.999);
        let even = contrast_image(&Image::filled(32, 32, 3, 0.4), &[], 0.1);
        assert!(correlation(&one, &even).abs() < 0.2);
    }
}
