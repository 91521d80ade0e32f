//! One frame of `ours-gn` against its image: robust Gauss-Newton on phase, and where asked for on the pose of the scope and
//! on the correction of the registration, coarse to fine, on the forward-mode derivatives of the image.

use nalgebra::{DMatrix, DVector};

use super::Tracker;
use super::scene::Velocity;
use crate::base::Result;
use crate::reconstruct::estimate::gauss_newton::{self, Comparison, Evidence, Prior, Robust, Unevenness};
use crate::reconstruct::estimate::window::drift::{POSE, after, apart, motion};
use crate::reconstruct::fitting::grid_search::grid_search;
use crate::reconstruct::fitting::scope_light::ScopeLight;
use crate::reconstruct::geometry::pyramid::Level;
use crate::splat::{DepthOutput, Direction, Motion, Settings, View};

/// Longest step of an angle (rad), a place and a correction (mm).
const LONGEST_TURN: f64 = 0.03;
const LONGEST_SHIFT_MM: f64 = 0.7;

/// What one frame's answer consists of.
#[derive(Clone, Debug)]
pub struct State {
    /// Breathing phase.
    pub phase: f64,
    /// Correction of the given pose.
    pub pose: [f64; POSE],
    /// Coefficients of the centres in view, mm.
    pub coefficients: Vec<[f64; 3]>,
}

/// A frame's answer, and what the last step saw.
pub struct Tracked {
    /// The answer.
    pub state: State,
    /// Standard deviation of the phase by this frame alone.
    pub deviation: f64,
    /// Covariance of the pose, where it is estimated.
    pub pose_covariance: Option<DMatrix<f64>>,
    /// Those of the coefficients, mm.
    pub coefficient_deviations: Vec<[f64; 3]>,
    /// What the last step saw.
    pub evidence: Evidence,
}

/// `view` with a corrected pose.
pub fn moved(view: &View, pose: [f64; POSE]) -> View {
    View { camera_from_world: motion(pose) * view.camera_from_world, ..*view }
}

impl Tracker<'_> {
    /// Whether the map is to tell poses; where there is a window, that does.
    fn refines_pose(&self) -> bool {
        *self.settings.unknown_pose && self.window.is_none()
    }

    fn robust(&self, width: usize) -> Robust {
        Robust {
            huber: *self.settings.huber,
            block_px: ((width as f64 * *self.settings.block_share).round() as usize).max(2),
            gain_limit: *self.settings.exposure_limit,
            last_gain: self.gain,
            unevenness: Unevenness::Even,
        }
    }

    /// The state that is expected at `phase`.
    pub fn state_at(&self, phase: f64) -> State {
        let coefficients = self.centres.iter().map(|&c| self.correction.prior(c).0).collect();
        State { phase, pose: self.pose, coefficients }
    }

    /// The unknowns of `state` in the order of the derivatives.
    fn vector(&self, state: &State) -> DVector<f64> {
        let pose: &[f64] = if self.refines_pose() { &state.pose } else { &[] };
        let all = [state.phase].into_iter().chain(pose.iter().copied());
        DVector::from_vec(all.chain(state.coefficients.iter().flatten().copied()).collect())
    }

    /// What is known of the unknowns before the image, seen from `state`.
    fn prior(&self, state: &State) -> Prior {
        let expected = self.state_at(self.breath.expected());
        let corrections = self.centres.iter().flat_map(|&c| self.correction.prior(c).1);
        let deviations: Vec<f64> = [*self.settings.prior_deviation].into_iter().chain(corrections).collect();
        let mut variances = DMatrix::from_diagonal(&DVector::from_vec(deviations)).map(|d| d * d);
        let mut step = self.vector(&expected) - self.vector(state);
        if self.refines_pose() {
            variances = variances.insert_rows(1, POSE, 0.0).insert_columns(1, POSE, 0.0);
            variances.view_mut((1, 1), (POSE, POSE)).copy_from(&self.walk.covariance());
            step.rows_mut(1, POSE).copy_from_slice(&apart(expected.pose, state.pose));
        }
        let size = step.len();
        let precision = variances.try_inverse().unwrap_or_else(|| DMatrix::zeros(size, size));
        Prior { step, precision }
    }

    /// Takes a step, none of its parts longer than is sensible.
    fn advance(&self, state: &mut State, step: &DVector<f64>) {
        let longest = *self.settings.longest_step;
        state.phase = (state.phase + step[0].clamp(-longest, longest)).clamp(0.0, 1.0);
        let mut rest = step.iter().skip(1);
        if self.refines_pose() {
            let mut change = [0.0; POSE];
            for (k, (value, step)) in change.iter_mut().zip(rest.by_ref()).enumerate() {
                let longest = if k < 3 { LONGEST_TURN } else { LONGEST_SHIFT_MM };
                *value = step.clamp(-longest, longest);
            }
            state.pose = after(change, state.pose);
        }
        for (value, step) in state.coefficients.iter_mut().flatten().zip(rest) {
            *value += step.clamp(-LONGEST_SHIFT_MM, LONGEST_SHIFT_MM);
        }
    }

    /// What `level` says about the unknowns at `state`.
    fn look(&mut self, level: &Level, state: &State) -> Result<Option<Evidence>> {
        let robust = self.robust(level.image.width);
        let view = moved(&level.view, state.pose);
        let light = self.light(&view);
        let refines_pose = self.refines_pose();
        let seen = self.seen.as_mut().expect("a frame is entered before it is worked on");
        seen.correct(&state.coefficients);
        seen.place(state.phase, &light)?;
        let mut velocities = vec![seen.velocity(&light, &seen.displacement)?];
        if refines_pose {
            let world_from_camera = view.camera_from_world.matrix3.transpose();
            let axes = world_from_camera.to_cols_array_2d();
            velocities.extend(axes.map(|axis| seen.shift(&light, axis.map(|v| v as f32))));
        }
        for weights in &seen.modes {
            for axis in 0..3 {
                let by = |w: &f32| std::array::from_fn(|k| if k == axis { w * state.phase as f32 } else { 0.0 });
                let by: Vec<[f32; 3]> = weights.iter().map(by).collect();
                velocities.push(seen.velocity(&light, &by)?);
            }
        }
        let mut directions: Vec<Direction<'_, f32>> = velocities.iter().map(direction).collect();
        if refines_pose {
            let turn = |k: usize| Direction::Pose(std::array::from_fn(|i| f64::from(u8::from(i == k))));
            directions.splice(1..1, [0, 1, 2].map(turn));
        }
        let settings = Settings { depth: DepthOutput::Skip, ..Settings::default() };
        let tangents = self.rasterizer.render_tangent(&seen.patch.gaussians, &view, &settings, None, &directions)?;
        let tangents = tangents.to_vec();
        let rendered = &self.rasterizer.rendered().color;
        let seen = Comparison {
            width: level.image.width,
            image: &level.image.data,
            rendered,
            weights: &level.weights,
            tangents: &tangents,
        };
        Ok(gauss_newton::evidence(&seen, robust))
    }

    /// Gauss-Newton from `start`, coarse to fine; `None` when the image says nothing.
    pub fn track(&mut self, levels: &[Level], start: State) -> Result<Option<Tracked>> {
        let (mut state, mut tracked) = (start, None);
        // Levels that would be too small are left out.
        let left_out = self.settings.steps.len() - levels.len();
        for (k, level) in levels.iter().enumerate() {
            for _ in 0..self.settings.steps[left_out + k] {
                let Some(mut evidence) = self.look(level, &state)? else { return Ok(tracked) };
                if self.refines_pose() {
                    evidence.information /= self.settings.pose_caution.powi(2);
                }
                let prior = self.prior(&state);
                let Some((step, covariance)) = gauss_newton::posterior(&evidence, &prior) else {
                    return Ok(tracked);
                };
                self.advance(&mut state, &step);
                let deviations: Vec<f64> = covariance.diagonal().iter().map(|v| v.sqrt()).collect();
                let first = deviations.len() - 3 * state.coefficients.len();
                tracked = Some(Tracked {
                    state: state.clone(),
                    deviation: deviations[0],
                    pose_covariance: self.refines_pose().then(|| covariance.view((1, 1), (POSE, POSE)).into()),
                    coefficient_deviations: deviations[first..].as_chunks::<3>().0.to_vec(),
                    evidence,
                });
            }
        }
        Ok(tracked)
    }

    /// The phase at which the image fits best, whatever was expected.
    pub fn search_by_image(&mut self, level: &Level) -> Result<f64> {
        grid_search(*self.settings.grid_steps, |phase| {
            let state = self.state_at(phase);
            Ok(self.look(level, &state)?.map_or(f64::INFINITY, |found| found.cost))
        })
    }

    /// Whether an answer is none.
    pub fn is_lost(&self, found: Option<&Tracked>) -> bool {
        found.is_none_or(|f| self.cost.is_finite() && f.evidence.cost > *self.settings.lost_factor * self.cost)
    }

    /// The light of the scope at `view`.
    pub fn light(&self, view: &View) -> ScopeLight {
        ScopeLight::new(view, *self.settings.falloff_exponent, *self.settings.indirect_share)
    }
}

fn direction(velocity: &Velocity) -> Direction<'_, f32> {
    let Velocity { positions, axes, colors } = velocity;
    Direction::Motion(Motion { positions, axes, colors, ..Motion::default() })
}
