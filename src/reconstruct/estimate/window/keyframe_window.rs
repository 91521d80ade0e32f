//! The window itself: places each frame against its keyframes by Gauss-Newton on all unknowns. The state of
//! knowledge is a Gaussian: [`KeyframeWindow`] holds its mean, information matrix and gradient.

use glam::DAffine3;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::bounded::{BoundedStep, bounded, marginalised};
use super::correction::Correction;
use super::drift::PoseDrift;
use super::pair::{Assumed, Keyframe, OtherUnknowns, Pair, PairPoses, TargetFrame, keyframe, misfit, pair};
use super::unknowns::UnknownLayout;
use crate::reconstruct::fitting::contrast::{ContrastImage, contrast_image};
use crate::reconstruct::geometry::breathing::BreathingMesh;
use crate::reconstruct::geometry::mesh_depth::{PixelRays, nearest_faces};
use crate::reconstruct::geometry::pyramid::PyramidLevel;
use crate::reconstruct::geometry::rigid::{POSE, moved};
use crate::reconstruct::settings::KeyframeSettings;
use crate::splat::View;

/// Half width of the neighbourhood of local contrast, as a share of the image's width.
pub const CONTRAST_RADIUS: f64 = 3.0 / 128.0;
/// Largest number of Gauss-Newton steps per frame, and the step length (phase, mm) below which they end.
const STEPS: usize = 4;
const SHORTEST_STEP: f64 = 2e-4;
/// Search before the first step, since the valley of the misfit is narrow: phases tried on each side of the
/// expected one, their spacing in phase, and the share of the misfit at the expected phase below which the best
/// of them is taken.
const SEARCH_STEPS: i32 = 6;
const SEARCH_SPACING: f64 = 0.01;
const CLEARLY_BETTER: f64 = 0.75;
/// Widest image that the window works on, pixels; wider ones are halved until they fit.
const WIDEST: usize = 160;
/// A frame becomes a keyframe if the last one is this many frames old, or if its points have moved by more than
/// this share of the width, or if less than this share of them is still visible.
const LONGEST_WAIT: usize = 4;
const LONGEST_FLOW: f64 = 0.06;
const FEWEST_KEPT: f64 = 0.7;
/// Largest product of pull and flow: all but .7 % of a difference is then taken over at once.
const STRONGEST_PULL: f64 = 5.0;
/// Standard deviation of the first frame's phase, which is found by the depth given there.
const FIRST_DEVIATION: f64 = 0.003;

/// Where the window puts a frame.
#[derive(Clone, Copy, Debug)]
pub struct FramePlacement {
    /// Phase, 0..1.
    pub phase: f64,
    /// Standard deviation of the phase.
    pub deviation: f64,
    /// Correction of its pose.
    pub pose: [f64; POSE],
}

/// A frame's phase as something else than keyframes tells it: rougher, but without their drift.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PhaseMeasurement {
    /// Phase, 0..1.
    pub phase: f64,
    /// How fast the window is drawn to it, per image width that the wall moves over the image: the difference falls by a
    /// factor of e over the inverse of this.
    pub pull: f64,
}

/// What a window estimates besides the phases; by default nothing.
#[derive(Default)]
pub struct WindowOptions {
    /// Drift of the given poses; `None` if they are exact.
    pub drift: Option<PoseDrift>,
    /// A correction of the displacement field between the two CTs.
    pub correction: Correction,
}

/// The keyframes, and what is known about their phases.
pub struct KeyframeWindow {
    /// Rays of the camera; set with the first frame.
    rays: Option<PixelRays>,
    most: usize,
    kept: f64,
    prior_deviation: f64,
    keyframes: Vec<Keyframe>,
    drift: Option<PoseDrift>,
    correction: Correction,
    /// Time of the frame to be placed next, to which the correction of the poses in `unknowns` refers.
    time_s: f64,
    /// The unknowns, in the order of [`UnknownLayout`].
    pub(super) unknowns: DVector<f64>,
    /// Information and gradient at `unknowns` from the images so far. The gradient is 0 unless there is a correction
    /// of the displacement field or a phase is held at an end of the breath.
    information: DMatrix<f64>,
    gradient: DVector<f64>,
    /// Frames since the last keyframe.
    waited: usize,
}

impl KeyframeWindow {
    /// An empty window; `None` if `settings` ask for no keyframes.
    pub fn new(settings: &KeyframeSettings, options: WindowOptions) -> Option<KeyframeWindow> {
        let mut window = KeyframeWindow {
            rays: None,
            most: *settings.keyframes as usize,
            kept: *settings.memory,
            prior_deviation: *settings.prior_deviation,
            keyframes: Vec::new(),
            drift: options.drift,
            correction: options.correction,
            time_s: 0.0,
            unknowns: DVector::zeros(0),
            information: DMatrix::zeros(0, 0),
            gradient: DVector::zeros(0),
            waited: 0,
        };
        window.begin([0.0; POSE], 0.0);
        (window.most > 0).then_some(window)
    }

    /// Starts with the correction `xi` of the first frame's pose.
    pub fn begin(&mut self, xi: [f64; POSE], time_s: f64) {
        self.time_s = time_s;
        if let Some(drift) = self.drift {
            self.unknowns = DVector::zeros(2 * POSE);
            self.unknowns.rows_mut(0, POSE).copy_from_slice(&xi);
            let variances = DVector::from_column_slice(&drift.start_variances());
            self.information = DMatrix::from_diagonal(&variances.map(|v| 1.0 / v));
            self.gradient = DVector::zeros(2 * POSE);
        }
    }

    /// Predicts the pose correction at `time_s`, the time of the next frame, and returns it.
    ///
    /// The new state `x' = F x + noise` of precision `N` joins the information as
    /// `[N, -N F; -F^T N, F^T N F]`, and the old one is marginalised.
    pub fn advance_to(&mut self, time_s: f64) -> [f64; POSE] {
        const S: usize = 2 * POSE;
        let seconds = time_s - self.time_s;
        self.time_s = time_s;
        if let Some(drift) = self.drift
            && seconds > 0.0
        {
            let step = drift.transition(seconds);
            let noise = DMatrix::from_diagonal(&DVector::from_column_slice(&drift.noise(seconds)).map(|v| 1.0 / v));
            let now = &step * self.unknowns.rows(0, S);
            self.unknowns.rows_mut(0, S).copy_from(&now);
            // The new state comes before the old one.
            let n = self.information.nrows();
            let mut all = DMatrix::zeros(S + n, S + n);
            all.view_mut((S, S), (n, n)).copy_from(&self.information);
            all.view_mut((0, 0), (S, S)).copy_from(&noise);
            let across = &noise * &step;
            all.view_mut((0, S), (S, S)).copy_from(&-&across);
            all.view_mut((S, 0), (S, S)).copy_from(&-across.transpose());
            let mut old = all.view_mut((S, S), (S, S));
            old += step.transpose() * across;
            for _ in 0..S {
                all = marginalised(all, S);
            }
            self.information = all;
        }
        self.correction_of_poses(&self.unknowns, 0.0)
    }

    /// The correction of the poses according to `unknowns`, `ago_s` seconds ago.
    fn correction_of_poses(&self, unknowns: &DVector<f64>, ago_s: f64) -> [f64; POSE] {
        let part = |k: usize| unknowns[k] - ago_s * unknowns[POSE + k];
        std::array::from_fn(|k| if self.drift.is_some() { part(k) } else { 0.0 })
    }

    /// Whether the window works on images of this size; larger ones are to be halved.
    pub fn suits(level: &PyramidLevel) -> bool {
        level.image.width <= WIDEST
    }

    /// `given` with the current correction of the displacement field; `None` if none is estimated.
    pub fn corrected(&self, given: &[[f32; 3]]) -> Option<Vec<[f32; 3]>> {
        self.correction.estimates().then(|| self.correction.apply(given).into_owned())
    }

    /// Places a frame whose predicted phase is `expected`. `mesh` is the given airway, `visible` the faces in view; without
    /// any, the frame says nothing, and what is expected stands. All frames share one camera. A frame that becomes a
    /// keyframe is drawn to what `measure` tells of it, given its phase by the keyframes so far; no other is measured.
    pub fn place(
        &mut self,
        frame: &PyramidLevel,
        mesh: BreathingMesh<'_>,
        visible: &[u32],
        expected: f64,
        measure: impl FnOnce(f64) -> Option<PhaseMeasurement>,
    ) -> FramePlacement {
        let rays = self.rays.take().unwrap_or_else(|| PixelRays::new(&frame.view.camera));
        let mut correction = std::mem::take(&mut self.correction);
        let layout = UnknownLayout::new(self.drift.is_some(), &correction, &frame.view);
        self.make_room(layout.first);
        if visible.is_empty() {
            let at = self.unknowns.clone().push(expected);
            let pose = self.correction_of_poses(&at, 0.0);
            (self.rays, self.correction) = (Some(rays), correction);
            return FramePlacement { phase: expected, deviation: self.prior_deviation, pose };
        }
        self.waited += 1;

        // The wall that the frame shows at the expected values of all unknowns.
        let contrast = contrast_image(&frame.image, &frame.weights, CONTRAST_RADIUS);
        let expected_at = self.unknowns.clone().push(expected);
        let view_and_walls = |at: &DVector<f64>| {
            let view = self.moved(&frame.view, at, 0.0);
            let corrected = layout.corrected(mesh, at);
            let mesh = BreathingMesh { displacement: &corrected, ..mesh };
            (view, nearest_faces(&view, &rays, &mesh.at(at[at.len() - 1]), mesh.faces, visible))
        };
        let nearest = view_and_walls(&expected_at).1;

        // Solve for all unknowns; the frame's phase is the last.
        let incoming = IncomingFrame { given: &frame.view, contrast: &contrast, nearest: &nearest };
        let mut solution = self.solve(&incoming, expected_at, &layout, mesh);
        let now = solution.at.len() - 1;
        // A frame that shows enough new wall becomes a keyframe.
        let enough = |(flow, kept): (f64, f64)| flow > LONGEST_FLOW || kept < FEWEST_KEPT;
        let becomes_keyframe = solution.last.is_none_or(enough) || self.waited >= LONGEST_WAIT;
        if becomes_keyframe && let Some(measured) = measure(solution.at[now]) {
            solution.draw_to(measured, &layout);
        }
        let placement = FramePlacement {
            phase: solution.at[now],
            deviation: solution.deviation(&layout).unwrap_or(self.prior_deviation),
            pose: self.correction_of_poses(&solution.at, 0.0),
        };

        if becomes_keyframe {
            let (view, nearest) = view_and_walls(&solution.at);
            let target = TargetFrame { view: &view, contrast_image: &contrast, nearest: &nearest };
            let key = keyframe(&target, &frame.view, self.time_s, mesh.faces);
            self.remember(key, solution, &layout);
        }
        // The correction follows `unknowns`, which only a keyframe changes.
        let coefficients = layout.poses..layout.first;
        correction.set(self.unknowns.as_slice()[coefficients].as_chunks().0);
        (self.rays, self.correction) = (Some(rays), correction);
        placement
    }

    /// Grows the state to `first` unknowns before the first phase.
    fn make_room(&mut self, first: usize) {
        if self.keyframes.is_empty() {
            self.unknowns.resize_vertically_mut(first, 0.0);
            self.information.resize_mut(first, first, 0.0);
            self.gradient.resize_vertically_mut(first, 0.0);
        }
    }

    /// Gauss-Newton on all unknowns and the phase of the incoming frame, the last of `mean`. It starts there and, if
    /// another phase agrees much better with the last keyframe, from that phase, too. Of two solutions, the one with
    /// the smaller misfit over all keyframes is returned.
    fn solve(
        &self,
        incoming: &IncomingFrame<'_>,
        mean: DVector<f64>,
        layout: &UnknownLayout<'_>,
        mesh: BreathingMesh<'_>,
    ) -> Solution {
        let expected = mean[mean.len() - 1];
        let corrected = |at: &DVector<f64>| layout.corrected(mesh, at).into_owned();
        let nearest = self.nearest_fit(incoming, &mean, BreathingMesh { displacement: &corrected(&mean), ..mesh });
        let from = |start: f64| self.solve_from(start, incoming, &mean, layout, mesh);
        let solution = from(nearest);
        if nearest == expected {
            return solution;
        }
        let other = from(expected);
        let misfits =
            |at: &DVector<f64>| self.misfits(incoming, at, BreathingMesh { displacement: &corrected(at), ..mesh });
        let differences = misfits(&solution.at).into_iter().zip(misfits(&other.at)).map(|(a, b)| a - b);
        if differences.filter(|d| d.is_finite()).sum::<f64>() <= 0.0 { solution } else { other }
    }

    /// How badly each keyframe agrees with the incoming frame.
    fn misfits(&self, incoming: &IncomingFrame<'_>, at: &DVector<f64>, mesh: BreathingMesh<'_>) -> Vec<f64> {
        let view = self.moved(incoming.given, at, 0.0);
        let target = incoming.at(&view);
        let (first, second) = (at.len() - 1 - self.keyframes.len(), at[at.len() - 1]);
        let of = |(k, key): (usize, &Keyframe)| {
            let key_from_world = self.key_from_world(key, incoming, at);
            misfit(key, &target, &Assumed { first: at[first + k], key_from_world, second, mesh })
        };
        self.keyframes.par_iter().enumerate().map(of).collect()
    }

    /// [`KeyframeWindow::solve`] with `start` as the initial phase of the frame.
    ///
    /// Each step solves `(Lambda + P + sum_k H_k) s = g + Lambda (mean - x) - P x + sum_k g_k`, with `Lambda` and
    /// `g` the window's information and gradient, `P` the prior of the correction, and `H_k` and `g_k` the normal
    /// equations of the pair of keyframe `k` and the frame.
    fn solve_from(
        &self,
        start: f64,
        incoming: &IncomingFrame<'_>,
        mean: &DVector<f64>,
        layout: &UnknownLayout<'_>,
        mesh: BreathingMesh<'_>,
    ) -> Solution {
        // Knowledge before the image: the window's, and the prior of the frame's own phase.
        let now = mean.len() - 1;
        let deviation = if self.keyframes.is_empty() { FIRST_DEVIATION } else { self.prior_deviation };
        let mut known = self.information.clone().resize(now + 1, now + 1, 0.0);
        known[(now, now)] = 1.0 / (deviation * deviation);
        let known_gradient = self.gradient.clone().push(0.0);
        let mut solution =
            Solution { at: mean.clone(), total: known.clone(), push: DVector::zeros(now + 1), last: None };
        solution.at[now] = start;
        for _ in 0..STEPS {
            // Sum of the pairs' normal equations.
            let corrected = layout.corrected(mesh, &solution.at);
            let pairs = self.pairs(incoming, &solution.at, layout, BreathingMesh { displacement: &corrected, ..mesh });
            solution.total.copy_from(&known);
            let mut gradient = &known_gradient + &known * (mean - &solution.at);
            for (k, pair) in pairs.iter().enumerate() {
                let places = layout.places(k, now);
                for (i, &a) in places.iter().enumerate() {
                    gradient[a] += pair.gradient[i];
                    places.iter().enumerate().for_each(|(j, &b)| solution.total[(a, b)] += pair.hessian[(i, j)]);
                }
            }
            solution.last = pairs.last().map(|pair| (pair.flow, pair.kept));
            // The prior of the correction is added here only: `total` holds the images' information.
            gradient -= layout.prior_gradient(&solution.at);
            let curvature = layout.with_prior(&solution.total);
            // The step, with all phases within 0..1.
            let Some(BoundedStep { step, push }) = bounded(&curvature, &gradient, &solution.at, layout.first) else {
                break;
            };
            solution.push = push;
            layout.advance(&mut solution.at, &step);
            if step.amax() < SHORTEST_STEP {
                break;
            }
        }
        solution
    }

    /// The normal equations of each keyframe with the incoming frame.
    fn pairs(
        &self,
        incoming: &IncomingFrame<'_>,
        at: &DVector<f64>,
        layout: &UnknownLayout<'_>,
        mesh: BreathingMesh<'_>,
    ) -> Vec<Pair> {
        let view = self.moved(incoming.given, at, 0.0);
        let target = incoming.at(&view);
        let pair_with = |(k, key): (usize, &Keyframe)| {
            let elapsed_s = self.time_s - key.time_s;
            let assumed = Assumed {
                first: at[layout.first + k],
                key_from_world: self.key_from_world(key, incoming, at),
                second: at[at.len() - 1],
                mesh,
            };
            let corrections = [elapsed_s, 0.0].map(|ago_s| self.correction_of_poses(at, ago_s));
            let poses = self.drift.map(|_| PairPoses { corrections, elapsed_s });
            let mut pair = pair(key, &target, &assumed, &OtherUnknowns { poses, weights: &layout.weights });
            if let Some(drift) = self.drift {
                pair.hessian /= drift.caution.powi(2);
                pair.gradient /= drift.caution.powi(2);
            }
            pair
        };
        self.keyframes.par_iter().enumerate().map(pair_with).collect()
    }

    /// Pose of a keyframe according to the unknowns `at`, which refer to the time of the incoming frame.
    fn key_from_world(&self, key: &Keyframe, incoming: &IncomingFrame<'_>, at: &DVector<f64>) -> DAffine3 {
        let given = View { camera_from_world: key.camera_from_world, ..*incoming.given };
        self.moved(&given, at, self.time_s - key.time_s).camera_from_world
    }

    /// Adds `keyframe` and takes over its `solution`; the oldest keyframe leaves a full window.
    fn remember(&mut self, keyframe: Keyframe, solution: Solution, layout: &UnknownLayout<'_>) {
        self.waited = 0;
        self.keyframes.push(keyframe);
        // At the solution, the gradient of the images is the opposite of that of the correction's prior.
        self.gradient = layout.prior_gradient(&solution.at) + &solution.push;
        let oldest_is_held = solution.push[layout.first] != 0.0;
        (self.unknowns, self.information) = (solution.at, solution.total);

        // The phase of the oldest keyframe of a full window is marginalised.
        if self.keyframes.len() > self.most {
            let mut information = std::mem::take(&mut self.information);
            if oldest_is_held {
                // The bound balances the push of the images; its information is taken to be that of a phase's prior.
                information[(layout.first, layout.first)] += self.prior_deviation.powi(-2);
            }
            self.information = marginalised(information, layout.first);
            self.gradient = self.gradient.clone().remove_row(layout.first);
            self.unknowns = self.unknowns.clone().remove_row(layout.first);
            self.keyframes.remove(0);
        }

        // Forget a share of the information on the phases and the coefficients in view. Coefficients out of view
        // collect no new errors, and the drift model adds its own noise.
        let forgets = |k: usize| k >= layout.first || (k >= layout.poses && layout.others.contains(&k));
        let kept = DVector::from_fn(self.unknowns.len(), |k, _| if forgets(k) { self.kept } else { 1.0 });
        for (k, column) in kept.iter().enumerate() {
            self.information.column_mut(k).iter_mut().zip(&kept).for_each(|(value, row)| *value *= row.min(*column));
        }
        self.gradient.component_mul_assign(&kept);
    }

    /// The `given` view of `ago_s` seconds ago with its pose corrected according to `unknowns`.
    fn moved(&self, given: &View, unknowns: &DVector<f64>, ago_s: f64) -> View {
        if self.drift.is_none() { *given } else { moved(given, self.correction_of_poses(unknowns, ago_s)) }
    }

    /// The phase near the last of `mean` with the least misfit to the last keyframe, if it is clearly better than the
    /// last of `mean`, which is returned otherwise.
    pub(super) fn nearest_fit(
        &self,
        incoming: &IncomingFrame<'_>,
        mean: &DVector<f64>,
        mesh: BreathingMesh<'_>,
    ) -> f64 {
        let expected = mean[mean.len() - 1];
        let Some(last) = self.keyframes.last() else { return expected };
        let view = self.moved(incoming.given, mean, 0.0);
        let target = incoming.at(&view);
        let (first, key_from_world) = (mean[mean.len() - 2], self.key_from_world(last, incoming, mean));
        let score = |second: f64| (misfit(last, &target, &Assumed { first, key_from_world, second, mesh }), second);
        let tried: Vec<f64> =
            (-SEARCH_STEPS..=SEARCH_STEPS).map(|k| (expected + SEARCH_SPACING * k as f64).clamp(0.0, 1.0)).collect();
        let best = tried.into_par_iter().map(score).min_by(|a, b| a.0.total_cmp(&b.0));
        match best {
            Some((least, phase)) if least < CLEARLY_BETTER * score(expected).0 => phase,
            _ => expected,
        }
    }
}

/// The frame to be placed.
pub(super) struct IncomingFrame<'a> {
    /// Its given pose, with its camera.
    pub given: &'a View,
    pub contrast: &'a ContrastImage,
    /// Depth in mm and index of the face at each pixel, at the expected values of all unknowns.
    pub nearest: &'a [(f32, u32)],
}

impl<'a> IncomingFrame<'a> {
    /// The frame as taken from `view`.
    fn at(&self, view: &'a View) -> TargetFrame<'a> {
        TargetFrame { view, contrast_image: self.contrast, nearest: self.nearest }
    }
}

/// The result of placing a frame.
struct Solution {
    /// All unknowns; the frame's phase is the last.
    at: DVector<f64>,
    /// Information about them, without the prior of the correction.
    total: DMatrix<f64>,
    /// Gradient that pushes phases against the ends of the breath; 0 for phases in between.
    push: DVector<f64>,
    /// Flow of the last keyframe's points, and the share of them that is still visible.
    last: Option<(f64, f64)>,
}

impl Solution {
    /// Takes over a share of the difference to a measured phase, and the same share of the window's uncertainty.
    ///
    /// That is a Kalman update whose gain `k = 1 - exp(-pull flow)` is given, not the measurement's variance: the window's
    /// own deviation leaves out its drift, which grows with the way that the wall has moved over the image since the last
    /// keyframe. Keyframes are drawn along as far as their phases depend on the frame's.
    fn draw_to(&mut self, measured: PhaseMeasurement, layout: &UnknownLayout<'_>) {
        let Some((flow, _)) = self.last else { return };
        let Some(factor) = layout.with_prior(&self.total).cholesky() else { return };
        let now = self.at.len() - 1;
        let strength = (measured.pull * flow).min(STRONGEST_PULL);
        let share = -(-strength).exp_m1();
        let covariance = factor.inverse();
        let variance = covariance[(now, now)];
        let moved = covariance.column(now) * (share / variance * (measured.phase - self.at[now]));
        layout.advance(&mut self.at, &moved);
        self.total[(now, now)] += strength.exp_m1() / variance;
    }

    /// Standard deviation of the phase.
    fn deviation(&self, layout: &UnknownLayout<'_>) -> Option<f64> {
        let now = self.at.len() - 1;
        layout.with_prior(&self.total).cholesky().map(|factor| factor.inverse()[(now, now)].sqrt())
    }
}
