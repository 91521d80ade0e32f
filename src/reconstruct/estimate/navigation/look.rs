//! What a picture tells of the state: an iterated Kalman update (Bell and Cathey 1993), which is Gauss-Newton on picture
//! and prior together,
//!
//!   (1 + P M^T A M) s = P M^T b + (prior - x)
//!
//! with `P` the covariance before, `A` and `b` the picture's normal equations ([`PictureEquations`]) and `M` the derivative
//! of the picture's unknowns by the state. Coarse to fine.
//!
//! Where the wall does not agree with the picture (a correlation below the limit: a cough, a touch of the wall, a film), all
//! phases are tried from the pose that is expected without the picture. If none agrees, the picture changes nothing: the
//! sensor goes on alone, and the covariance grows until a picture agrees again.

use glam::{DAffine3, DVec3};
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::state::{
    FIELD, LAMP_AT, LENS_AT, LOOP, NavigationState, PHASE_AT, RATE, SHADE, STATE, keep_phase_inside, twist, vector,
};
use crate::base::Camera;
use crate::reconstruct::fitting::wall_picture::{LONGEST_STEPS, PictureEquations, PictureLevel};
use crate::reconstruct::geometry::lit_wall::{LAMP, LENS, LitView, NearWall, PHASE, PICTURE, in_sight};
use crate::reconstruct::geometry::rigid::{POSE, motion};
use crate::reconstruct::settings::WallMatching;
use crate::splat::View;

/// Changes of phase, to both sides, that are tried on the coarsest picture before the first step.
const TRIED: [f64; 4] = [-0.16, -0.08, 0.08, 0.16];
/// A picture may change no angle and shift of the pose by more than so many of its standard deviations.
const MOST_DEVIATIONS: f64 = 4.0;
/// A tried phase must have a correlation higher by this to be the start.
const CLEARLY: f64 = 0.02;

/// Standard deviations of phase and rate (1/s) that are added when all phases are tried.
const OPEN_PHASE: f64 = 0.3;
const OPEN_RATE: f64 = 1.0;

/// What came of a picture.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LookOutcome {
    /// Correlation of local contrast at the end.
    pub correlation: f64,
    /// Whether the picture agreed, and was taken in.
    pub agrees: bool,
    /// How much each pixel of the finest resolution counted, 0 to 1; empty where the picture was not taken in.
    pub weights: Vec<f32>,
}

/// A mean that a picture led to, and how well it agrees there.
struct PictureSolution {
    mean: DVector<f64>,
    covariance: DMatrix<f64>,
    correlation: f64,
    weights: Vec<f32>,
}

impl NavigationState {
    /// How the wall is expected to be seen by a `camera` as told, if the state is `mean`.
    pub fn lit_view(&self, mean: &DVector<f64>, camera: &Camera) -> LitView {
        let [cx, cy, focal] = [0, 1, 2].map(|k| mean[LENS_AT + k]);
        let width = f64::from(camera.width);
        let lens = Camera {
            cx: camera.cx + cx * width,
            cy: camera.cy + cy * width,
            fl_x: camera.fl_x * focal.exp(),
            fl_y: camera.fl_y * focal.exp(),
            ..*camera
        };
        let offset = DAffine3::from_translation(self.wall_offset_mm(mean));
        let seen = motion(twist(mean, SHADE)) * motion(twist(mean, 0)) * self.camera_from_world * offset;
        LitView {
            view: View { camera_from_world: seen, ..View::new(lens, DAffine3::IDENTITY) },
            phase: mean[PHASE_AT].clamp(0.0, 1.0),
            lamp_mm: DVec3::new(mean[LAMP_AT], mean[LAMP_AT + 1], 0.0),
        }
    }

    /// The derivative of a picture's unknowns by the state at `mean`, seen as `lit`.
    fn picture_by_state(&self, mean: &DVector<f64>, lit: &LitView) -> DMatrix<f64> {
        let mut by = DMatrix::zeros(PICTURE, STATE);
        for k in 0..POSE {
            by[(k, k)] = 1.0;
            by[(k, SHADE + k)] = 1.0;
        }
        by[(PHASE, PHASE_AT)] = 1.0;
        (0..3).for_each(|k| by[(LENS + k, LENS_AT + k)] = 1.0);
        (0..2).for_each(|k| by[(LAMP + k, LAMP_AT + k)] = 1.0);
        // The wall's offset is a shift in the camera's axes.
        let turn = lit.view.camera_from_world.matrix3;
        let (phase, flow) = (mean[PHASE_AT], mean[RATE] / self.peak_rate());
        for axis in 0..3 {
            let along = turn.col(axis);
            for row in 0..3 {
                by[(3 + row, FIELD + axis)] = phase * along[row];
                by[(3 + row, LOOP + axis)] = flow * along[row];
            }
        }
        let (by_phase, by_rate) = (turn * vector(mean, FIELD), turn * vector(mean, LOOP) / self.peak_rate());
        for row in 0..3 {
            by[(3 + row, PHASE_AT)] += by_phase[row];
            by[(3 + row, RATE)] += by_rate[row];
        }
        by
    }

    /// Takes in a picture at its resolutions, coarse to fine. `wall` is what is near the scope.
    pub fn look(&mut self, settings: &WallMatching, levels: &[PictureLevel], wall: &NearWall) -> LookOutcome {
        let least = *settings.least_correlation;
        let start = self.nearest_phase(levels, wall);
        let mut found = self.solve(settings, levels, wall, start);
        if found.as_ref().is_none_or(|found| found.correlation < least) {
            // A breath that went elsewhere than expected: its phase is as good as unknown.
            let mut open = self.clone();
            open.covariance[(PHASE_AT, PHASE_AT)] += OPEN_PHASE.powi(2);
            open.covariance[(RATE, RATE)] += OPEN_RATE.powi(2);
            let start = open.best_phase(settings, levels, wall);
            let other = start.and_then(|start| open.solve(settings, levels, wall, start));
            let better =
                |other: &PictureSolution| found.as_ref().is_none_or(|found| other.correlation > found.correlation);
            if other.as_ref().is_some_and(better) {
                found = other;
            }
        }
        match found {
            Some(found) if found.correlation >= least && self.is_likely(&found.mean) => {
                self.settle(found.mean, found.covariance);
                LookOutcome { correlation: found.correlation, agrees: true, weights: found.weights }
            }
            found => LookOutcome { correlation: found.map_or(0.0, |f| f.correlation), ..LookOutcome::default() },
        }
    }

    /// Whether `mean` has a pose that the sensor and the past allow: wrong minima are mostly far away.
    fn is_likely(&self, mean: &DVector<f64>) -> bool {
        (0..POSE).all(|k| (mean[k] - self.mean[k]).powi(2) <= MOST_DEVIATIONS.powi(2) * self.covariance[(k, k)])
    }

    /// The expected mean, or one with a phase nearby whose view agrees clearly better at the coarsest resolution.
    fn nearest_phase(&self, levels: &[PictureLevel], wall: &NearWall) -> DVector<f64> {
        let Some(level) = levels.first() else { return self.mean.clone() };
        let at = |change: f64| {
            let mut mean = self.mean.clone();
            mean[PHASE_AT] = (mean[PHASE_AT] + change).clamp(0.0, 1.0);
            mean
        };
        let score = |mean: DVector<f64>| (level.correlation(wall, &self.lit_view(&mean, &level.camera)), mean);
        let expected = score(at(0.0));
        let tried: Vec<_> = TRIED.into_par_iter().map(|change| score(at(change))).collect();
        let best = tried.into_iter().fold(None, |best: Option<(f64, DVector<f64>)>, next| match best {
            Some(best) if best.0 >= next.0 => Some(best),
            _ => Some(next),
        });
        match best {
            Some(best) if best.0 > expected.0 + CLEARLY => best.1,
            _ => expected.1,
        }
    }

    /// The expected mean with the phase, of an even grid, whose view agrees best at the coarsest resolution.
    fn best_phase(&self, settings: &WallMatching, levels: &[PictureLevel], wall: &NearWall) -> Option<DVector<f64>> {
        let level = levels.first()?;
        let steps = (*settings.grid_steps).max(2);
        let at = |step: u32| {
            let mut mean = self.mean.clone();
            mean[PHASE_AT] = f64::from(step) / f64::from(steps - 1);
            let correlation = level.correlation(wall, &self.lit_view(&mean, &level.camera));
            (correlation, mean)
        };
        let tried: Vec<_> = (0..steps).into_par_iter().map(at).collect();
        let best = tried.into_iter().fold(None, |best: Option<(f64, DVector<f64>)>, next| match best {
            Some(best) if best.0 >= next.0 => Some(best),
            _ => Some(next),
        });
        best.map(|(_, mean)| mean)
    }

    /// Gauss-Newton from `start` on picture and prior together.
    fn solve(
        &self,
        settings: &WallMatching,
        levels: &[PictureLevel],
        wall: &NearWall,
        start: DVector<f64>,
    ) -> Option<PictureSolution> {
        let mut solution =
            PictureSolution { mean: start, covariance: self.covariance.clone(), correlation: 0.0, weights: Vec::new() };
        for level in levels {
            let near = in_sight(wall, &self.lit_view(&solution.mean, &level.camera));
            for _ in 0..level.steps {
                let lit = self.lit_view(&solution.mean, &level.camera);
                let equations = level.equations(&settings.picture, *settings.together_px, &near, &lit)?;
                let (step, covariance) = self.step(&equations, &solution.mean, &lit)?;
                advance(&mut solution.mean, &step);
                solution.covariance = covariance;
                solution.weights = equations.weights;
            }
        }
        let finest = levels.last()?;
        solution.correlation = finest.correlation(wall, &self.lit_view(&solution.mean, &finest.camera));
        Some(solution)
    }

    /// The step from `mean`, and the covariance after it.
    fn step(
        &self,
        equations: &PictureEquations,
        mean: &DVector<f64>,
        lit: &LitView,
    ) -> Option<(DVector<f64>, DMatrix<f64>)> {
        let by = self.picture_by_state(mean, lit);
        let spread = &self.covariance * by.transpose();
        let system = DMatrix::identity(STATE, STATE) + &spread * &equations.hessian * &by;
        let factor = system.lu();
        let right = spread * &equations.gradient + (&self.mean - mean);
        Some((factor.solve(&right)?, factor.solve(&self.covariance)?))
    }
}

/// Takes a step, shortened as a whole so that no part of it is too long.
fn advance(mean: &mut DVector<f64>, step: &DVector<f64>) {
    let limit = |k: usize| match k {
        0..3 => LONGEST_STEPS[0],
        3..6 => LONGEST_STEPS[1],
        PHASE_AT => LONGEST_STEPS[2],
        _ => f64::INFINITY,
    };
    let share = (0..step.len()).map(|k| limit(k) / step[k].abs().max(1e-300)).fold(1.0, f64::min);
    *mean += step * share;
    keep_phase_inside(mean);
}
