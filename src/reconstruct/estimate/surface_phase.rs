//! The phase at which the CT's surface, lit from the scope, agrees best with a frame: correlation of local contrast, as
//! navigation systems register a picture to a CT (Luo et al., Med Image Anal 16:577, 2012). It is less exact than what
//! keyframes tell, but owes nothing to the frames before: it does not drift.

use glam::DVec3;

use crate::reconstruct::fitting::contrast::{Surroundings, agreement};
use crate::reconstruct::fitting::grid_search::top_of_parabola;
use crate::reconstruct::geometry::lit_wall::{LitView, NearWall, lit_picture, smoothed};
use crate::reconstruct::geometry::pyramid::PyramidLevel;
use crate::reconstruct::settings::SurfaceMatching;
use crate::splat::View;

/// The green channel: the red of tissue clips first.
const CHANNEL: usize = 1;
/// Below this correlation the surface is not what the frame shows.
const LEAST_CORRELATION: f64 = 0.1;

/// A phase and how well the surface agrees there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePhase {
    /// Phase, 0..1.
    pub phase: f64,
    /// What the surface explains of the picture's contrast over what it does not, squared: 1 where it explains half. The
    /// inverse variance of the phase goes with it.
    pub weight: f64,
}

/// The phase near `expected` at which `wall` agrees best with `frame` as taken from `view`; `None` where it agrees with none.
/// `frame` is in the power law and without the darkening of lamp and lens. Phases are tried `spacing` apart, uphill from
/// `expected`.
pub fn surface_phase(
    settings: &SurfaceMatching,
    frame: &PyramidLevel,
    view: &View,
    wall: &NearWall,
    expected: f64,
) -> Option<SurfacePhase> {
    let width = frame.image.width;
    let pixels = width * frame.image.height;
    let green: Vec<f32> = frame.image.data.iter().skip(CHANNEL).step_by(3).copied().collect();
    let weights = (0..pixels).map(|i| frame.weight(i)).collect();
    let around = Surroundings::new(weights, width, *settings.contrast_radius);
    let (seen, _) = around.contrast(&smoothed(&green, width));
    let correlation_at = |phase: f64| {
        let lit = LitView { view: *view, phase, lamp_mm: DVec3::ZERO };
        let (shown, _) = around.contrast(&lit_picture(wall, &lit, false).brightness);
        agreement(&seen, &shown, around.weights()).correlation
    };
    let (phase, correlation) = uphill(*settings.spacing, expected, correlation_at);
    let explained = correlation * correlation;
    let weight = (explained / (1.0 - explained).max(1e-6)).powi(2);
    (correlation > LEAST_CORRELATION).then_some(SurfacePhase { phase, weight })
}

/// The peak of `value` on 0..1 that lies uphill from `start`, on a grid of about `spacing`, and the value of the grid's
/// highest point; between the points by the parabola through the peak and its neighbours.
fn uphill(spacing: f64, start: f64, value: impl Fn(f64) -> f64) -> (f64, f64) {
    let last = (1.0 / spacing).round().max(2.0) as usize;
    let mut known = vec![None; last + 1];
    let mut at = |k: usize| *known[k].get_or_insert_with(|| value(k as f64 / last as f64));
    let mut best = ((start * last as f64).round() as usize).min(last);
    loop {
        let (below, above) = (best.saturating_sub(1), (best + 1).min(last));
        let next = [below, above].into_iter().fold(best, |best, k| if at(k) > at(best) { k } else { best });
        if next == best {
            break;
        }
        best = next;
    }
    let top = at(best);
    let mut place = best as f64;
    if (1..last).contains(&best) {
        place += top_of_parabola([at(best - 1), top, at(best + 1)]);
    }
    (place / last as f64, top)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::{CounterRng, Stage};
    use crate::base::{Camera, Image};
    use crate::reconstruct::estimate::navigation::tests::World;
    use crate::reconstruct::settings::{NumberSource, Sourced};

    fn ours<T>(value: T) -> Sourced<T> {
        Sourced { value, source: NumberSource::Ours, why: String::new() }
    }

    fn settings() -> SurfaceMatching {
        SurfaceMatching {
            flow: ours(0.02),
            largest_width: ours(128),
            contrast_radius: ours(0.06),
            spacing: ours(0.025),
        }
    }

    fn grey(width: usize, values: &[f32]) -> Image<f32> {
        let data = values.iter().flat_map(|v| [*v; 3]).collect();
        Image { width, height: values.len() / width, channels: 3, data }
    }

    /// Vessels that the surface lacks, and the shutter's exposure, leave the phase where it is.
    #[test]
    fn the_phase_of_a_lit_wall_is_found_under_vessels_and_any_exposure() {
        let world = World::new();
        let camera = Camera::pinhole(96, 96, 1.7);
        let mut weights: Vec<f64> = Vec::new();
        for (seed, truth, start) in [(1, 0.0, 0.15), (2, 0.31, 0.45), (3, 0.62, 0.5), (4, 1.0, 0.85)] {
            let pose = world.pose(8.0 + 5.0 * seed as f64);
            let view = View::new(camera, pose);
            let wall = NearWall::around(world.mesh(), pose.translation, 90.0);
            let lit = LitView { view, phase: truth, lamp_mm: DVec3::ZERO };
            let clean = lit_picture(&wall, &lit, false).brightness;
            for vessels in [0.0, 0.1] {
                let mut random = CounterRng::new(seed, Stage::Test, &[9]);
                let spots: Vec<f32> = (0..clean.len()).map(|_| 1.0 + vessels * random.normal() as f32).collect();
                let spots = smoothed(&spots, 96);
                let shown: Vec<f32> = clean.iter().zip(&spots).map(|(v, s)| 0.3 * seed as f32 * v * s).collect();
                let frame = PyramidLevel { view, image: grey(96, &shown), weights: Vec::new() };
                let found = surface_phase(&settings(), &frame, &view, &wall, start).unwrap();
                assert!((found.phase - truth).abs() < 0.01, "{} for {truth}, vessels {vessels}", found.phase);
                weights.push(found.weight);
            }
        }
        assert!(weights.chunks(2).all(|pair| pair[0] > 4.0 * pair[1]), "{weights:?}");
    }

    #[test]
    fn a_picture_of_something_else_says_nothing_or_little() {
        let world = World::new();
        let pose = world.pose(15.0);
        let view = View::new(Camera::pinhole(64, 64, 1.7), pose);
        let wall = NearWall::around(world.mesh(), pose.translation, 90.0);
        let mut random = CounterRng::new(5, Stage::Test, &[4]);
        let noise: Vec<f32> = (0..64 * 64).map(|_| 0.5 + 0.1 * random.normal() as f32).collect();
        for shown in [noise, vec![0.4; 64 * 64]] {
            let frame = PyramidLevel { view, image: grey(64, &shown), weights: Vec::new() };
            let found = surface_phase(&settings(), &frame, &view, &wall, 0.5);
            assert!(found.is_none_or(|found| found.weight < 0.01), "{found:?}");
        }
    }

    #[test]
    fn the_peak_uphill_is_found_between_the_points_and_at_the_ends() {
        for truth in [0.0, 0.03, 0.512, 1.0] {
            let calls = std::cell::Cell::new(0);
            let value = |phase: f64| {
                calls.set(calls.get() + 1);
                1.0 - (phase - truth).powi(2)
            };
            let (found, top) = uphill(0.05, 0.5, value);
            assert!((found - truth).abs() < 0.026 && top > 0.99, "{found} for {truth}");
            // No phase is tried twice, and none beyond the peak's neighbours.
            assert!(calls.get() <= 13, "{} phases were tried", calls.get());
        }
        assert!((uphill(0.05, 0.4, |phase| -(phase - 0.512f64).powi(2)).0 - 0.512).abs() < 1e-9);
    }
}
