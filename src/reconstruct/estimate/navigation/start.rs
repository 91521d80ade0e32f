//! The first pose, where it is known to some millimetres and tens of degrees: many are tried coarsely, a few go on.

use nalgebra::DMatrix;
use rayon::prelude::*;

use super::look::LookOutcome;
use super::state::{NavigationState, STATE};
use crate::base::random::{CounterRng, Stage};
use crate::reconstruct::fitting::wall_picture::PictureLevel;
use crate::reconstruct::geometry::lit_wall::NearWall;
use crate::reconstruct::geometry::rigid::{POSE, motion};
use crate::reconstruct::settings::WallMatching;

/// Poses that are tried beside the given one, and those of them that go on.
const TRIED: u64 = 1500;
const KEPT: usize = 24;
/// Pictures are taken in so many times, each time with the pose as uncertain as at first.
const ROUNDS: usize = 3;
/// Standard deviations within which poses are drawn.
const MOST: f64 = 1.8;

impl NavigationState {
    /// Looks for the pose whose wall agrees best with a picture, near this one, which is off by about `deviation` (rad and
    /// mm, each about or along one axis). The pose alone is opened again for each round: what
    /// else is uncertain becomes too sure, as if each round had a picture of its own.
    pub fn find_pose(
        &mut self,
        settings: &WallMatching,
        levels: &[PictureLevel],
        wall: &NearWall,
        deviation: [f64; 2],
    ) -> LookOutcome {
        let Some(coarse) = levels.first() else {
            return LookOutcome::default();
        };
        let of_axis = |k: usize| deviation[usize::from(k >= 3)];
        let at = |k: u64| {
            let mut random = CounterRng::new(k, Stage::Method, &[17]);
            let draw = |axis: usize| of_axis(axis) * random.normal().clamp(-MOST, MOST);
            let drawn: Vec<f64> = (0..POSE).map(draw).collect();
            let xi = std::array::from_fn(|axis| if k == 0 { 0.0 } else { drawn[axis] });
            let mut state = self.clone();
            state.camera_from_world = motion(xi) * state.camera_from_world;
            (coarse.correlation(wall, &state.lit_view(&state.mean, &coarse.camera)), state)
        };
        let mut tried: Vec<(f64, NavigationState)> = (0..=TRIED).into_par_iter().map(at).collect();
        tried.sort_by(|a, b| b.0.total_cmp(&a.0));
        tried.truncate(KEPT);
        let refine = |(_, mut state): (f64, NavigationState)| {
            let mut look = LookOutcome::default();
            for _ in 0..ROUNDS {
                open_pose(&mut state.covariance, of_axis);
                look = state.look(settings, levels, wall);
            }
            (look, state)
        };
        let found: Vec<(LookOutcome, NavigationState)> = tried.into_par_iter().map(refine).collect();
        let best =
            found.into_iter().reduce(|best, next| if next.0.correlation > best.0.correlation { next } else { best });
        let Some((look, state)) = best else { return LookOutcome::default() };
        *self = state;
        look
    }
}

/// Makes the pose independent of everything else, with its first deviations.
fn open_pose(covariance: &mut DMatrix<f64>, of_axis: impl Fn(usize) -> f64) {
    for k in 0..POSE {
        for other in 0..STATE {
            covariance[(k, other)] = 0.0;
            covariance[(other, k)] = 0.0;
        }
        covariance[(k, k)] = of_axis(k).powi(2);
    }
}
