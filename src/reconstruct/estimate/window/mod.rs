//! The phases of a window of keyframes, by direct alignment of their pictures through the moving mesh. No map is involved,
//! so nothing that was painted in the wrong place can pull a phase along. Windowed photometric bundle adjustment (Engel,
//! Koltun and Cremers, "Direct sparse odometry", 2018) in which poses and shapes are given, and one phase per frame is
//! all that is unknown.
//!
//! A map alone drifts. Where the assumed wall is too wide its picture grows too slowly while the scope advances, and a
//! phase that makes it wider still mends that: an error of the phase grows by a factor of e on a way as long as the wall
//! is distant. Two frames from different places see that the wall is elsewhere (parallax). With the point that a pixel of
//! frame `k` shows at `X_k(a_k) = o + t r`, in barycentric coordinates `b(a_k)` of its face, frame `n` sees it at
//! `X_n = sum b_i v_i(a_n)`; the derivatives of its place in that picture by `a_k` and by `a_n` differ ([`fn@pair`]).
//!
//! Pictures are compared by their local contrast ([`picture`]): what the light does to large areas says nothing. Each frame is
//! placed against all keyframes of the window; a frame that shows enough new wall becomes one, and the oldest leaves, its
//! knowledge marginalised. Of what is known a share is forgotten with each keyframe, since systematic errors (glare,
//! light inside the wall) do not average out. What two frames from different places say about where the wall is, beyond
//! any phase, may go into a correction of the displacement field ([`crate::reconstruct::estimate::window::correction`]): its coefficients are unknowns of
//! the window, too, which no keyframe takes along when it leaves. Where walls are near, the valley of the misfit is .01 of a phase wide: before the
//! first step the phase around the expected one is looked for at which the frame agrees best with the last keyframe. Where that is
//! elsewhere, steps are taken from both, and all keyframes choose: walls that are very near can mislead one of them.
//! Poses that are off may be unknowns, too: one correction and its change per second for the whole window, under the drift of
//! [`crate::reconstruct::estimate::window::drift`]. (Six unknowns per frame run away: along a tube, way and phase are one.) Phases stay within 0..1 in every step
//! ([`bounded`]): where images push one against an end of the breath, it is the poses that must be wrong.
//! Left out: levels of resolution.

mod contrast;
pub mod correction;
pub mod drift;
mod pair;
#[cfg(test)]
mod tests;

use std::borrow::Cow;

use glam::DAffine3;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use crate::reconstruct::estimate::window::correction::Correction;
use crate::reconstruct::estimate::window::drift::{Drift, POSE, motion};
use crate::reconstruct::geometry::mesh_depth::{Rays, nearest_faces};
use crate::reconstruct::geometry::pyramid::Level;
use crate::reconstruct::settings;
use crate::splat::View;
use contrast::{Picture, picture};
use pair::{Assumed, Keyframe, Others, Pair, Poses, Sight, keyframe, misfit, pair};

pub use pair::Shape;

/// Most Gauss-Newton steps per frame, the longest of them, and one that ends them.
const STEPS: usize = 4;
const LONGEST_STEP: f64 = 0.05;
const SHORTEST_STEP: f64 = 2e-4;
/// Most pivots of a step; two dozen phases take fewer.
const MOST_PIVOTS: usize = 1000;
/// Longest step of a coefficient of the correction and of a place; angles are never so long.
const LONGEST_SHIFT_MM: f64 = 0.3;
/// A least misfit is narrow: before the first step it is looked for at so many phases either way, so far apart, and
/// believed where it is less than this share of that at the expected phase.
const TRIED: i32 = 6;
const APART: f64 = 0.01;
const BETTER: f64 = 0.75;
/// The window works on the finest halving of a picture that is not wider than this many pixels.
const WIDEST: usize = 160;
/// A frame becomes a keyframe after so many frames, or when the points of the last one have moved by this share of the
/// width, or fewer than this share of them are left.
const LONGEST_WAIT: usize = 4;
const LONGEST_FLOW: f64 = 0.06;
const FEWEST_KEPT: f64 = 0.7;
/// Standard deviation of the phase that the given depth of the first frame tells.
const FIRST_DEVIATION: f64 = 0.003;

/// Phase of a frame, and its standard deviation by the window.
#[derive(Clone, Copy, Debug)]
pub struct Placed {
    /// Phase, 0..1.
    pub phase: f64,
    /// Its standard deviation.
    pub deviation: f64,
    /// Correction of its pose.
    pub pose: [f64; POSE],
}

/// What a frame is to be placed in.
#[derive(Clone, Copy)]
pub struct Setting<'a> {
    /// The airway as it is given.
    pub shape: Shape<'a>,
    /// Faces in view.
    pub visible: &'a [u32],
}

/// The keyframes, and what is known about their phases.
pub struct Window {
    /// Of the pictures' camera, from the first one on.
    rays: Option<Rays>,
    most: usize,
    kept: f64,
    prior_deviation: f64,
    keyframes: Vec<Keyframe>,
    /// How given poses drift; `None`: they are true.
    drift: Option<Drift>,
    /// When the correction of the poses is what `unknowns` says.
    time_s: f64,
    /// The unknowns: correction of the poses and its change per second, where they drift; coefficients of the correction of
    /// the displacement field in mm, three per centre; phases of the keyframes.
    unknowns: DVector<f64>,
    /// What images say about them around there: second and first derivatives. Where there is no correction, the first are 0.
    information: DMatrix<f64>,
    pull: DVector<f64>,
    /// Frames since the last keyframe.
    waited: usize,
}

impl Window {
    /// An empty window; `None` where `settings` ask for no keyframes. Poses are true, or off by what drifts.
    pub fn new(settings: &settings::KeyframeSettings, drift: Option<Drift>) -> Option<Window> {
        let empty = Window {
            rays: None,
            most: *settings.keyframes as usize,
            kept: *settings.memory,
            prior_deviation: *settings.prior_deviation,
            keyframes: Vec::new(),
            drift,
            time_s: 0.0,
            unknowns: DVector::zeros(0),
            information: DMatrix::zeros(0, 0),
            pull: DVector::zeros(0),
            waited: 0,
        };
        let mut window = (empty.most > 0).then_some(empty)?;
        window.begin([0.0; POSE], 0.0);
        Some(window)
    }

    /// Begins with the correction `xi` of the first frame's pose.
    pub fn begin(&mut self, xi: [f64; POSE], time_s: f64) {
        if let Some(drift) = self.drift {
            self.time_s = time_s;
            self.unknowns = DVector::zeros(2 * POSE);
            self.unknowns.rows_mut(0, POSE).copy_from_slice(&xi);
            let variances = DVector::from_column_slice(&drift.start_variances());
            self.information = DMatrix::from_diagonal(&variances.map(|v| 1.0 / v));
            self.pull = DVector::zeros(2 * POSE);
        }
    }

    /// Lets the poses drift until `time_s`; the correction that is expected then.
    pub fn wait_until(&mut self, time_s: f64) -> [f64; POSE] {
        let Some(drift) = self.drift else { return [0.0; POSE] };
        let seconds = time_s - self.time_s;
        self.time_s = time_s;
        if seconds > 0.0 {
            const S: usize = 2 * POSE;
            let step = drift.transition(seconds);
            let noise = DMatrix::from_diagonal(&DVector::from_column_slice(&drift.noise(seconds)).map(|v| 1.0 / v));
            let now = &step * self.unknowns.rows(0, S);
            self.unknowns.rows_mut(0, S).copy_from(&now);
            // The new state before the old one, which is then no longer asked for.
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
                all = without(all, S);
            }
            self.information = all;
        }
        self.correction_of_poses(&self.unknowns, 0.0)
    }

    /// The correction of the poses by `unknowns`, so many seconds ago.
    fn correction_of_poses(&self, unknowns: &DVector<f64>, ago_s: f64) -> [f64; POSE] {
        let part = |k: usize| unknowns[k] - ago_s * unknowns[POSE + k];
        std::array::from_fn(|k| if self.drift.is_some() { part(k) } else { 0.0 })
    }

    /// Whether the window works on pictures of this size; larger ones are to be halved.
    pub fn suits(level: &Level) -> bool {
        level.image.width <= WIDEST
    }

    /// Places a frame in the breath, which is expected at `expected`; the setting is the one that is given, without
    /// `correction`, which learns from the frame. All frames have one camera and one correction.
    pub fn place(
        &mut self,
        frame: &Level,
        time_s: f64,
        Setting { shape, visible }: Setting<'_>,
        expected: f64,
        correction: &mut Correction,
    ) -> Placed {
        let rays = self.rays.take().unwrap_or_else(|| Rays::new(&frame.view.camera));
        let layout = Layout::new(self.drift.is_some(), correction, &frame.view);
        self.make_room(layout.first);
        self.waited += 1;
        let picture = picture(&frame.image, &frame.weights);
        let expected_at = self.unknowns.clone().push(expected);
        let look = |at: &DVector<f64>| {
            let view = self.moved(&frame.view, at, 0.0);
            let corrected = layout.corrected(correction, shape, at);
            let shape = Shape { displacement: &corrected, ..shape };
            (view, nearest_faces(&view, &rays, &shape.at(at[at.len() - 1]), shape.faces, visible))
        };
        let nearest = look(&expected_at).1;
        let seen = Seen { given: &frame.view, time_s, picture: &picture, nearest: &nearest };
        let found = self.solve(&seen, expected_at, &layout, shape, correction);
        let now = found.at.len() - 1;
        let placed = Placed {
            phase: found.at[now],
            deviation: found.deviation(&layout).unwrap_or(self.prior_deviation),
            pose: self.correction_of_poses(&found.at, 0.0),
        };
        let enough = |(flow, kept): (f64, f64)| flow > LONGEST_FLOW || kept < FEWEST_KEPT;
        if found.last.is_none_or(enough) || self.waited >= LONGEST_WAIT {
            let (view, nearest) = look(&found.at);
            let sight = Sight { view: &view, picture: &picture, nearest: &nearest };
            let key = keyframe(&sight, &frame.view, time_s, shape.faces);
            self.remember(key, found, &layout);
        }
        // A frame that leaves no information behind leaves no correction.
        correction.set(self.unknowns.as_slice()[layout.poses..layout.first].as_chunks().0);
        self.rays = Some(rays);
        placed
    }

    /// Room for so many unknowns before the first phase.
    fn make_room(&mut self, first: usize) {
        if self.keyframes.is_empty() {
            self.unknowns.resize_vertically_mut(first, 0.0);
            self.information.resize_mut(first, first, 0.0);
            self.pull.resize_vertically_mut(first, 0.0);
        }
    }

    /// Gauss-Newton on all unknowns and the phase of the frame that is `seen`, the last of `mean`: from there, and from where the
    /// frame agrees much better with the last keyframe. Of two answers it is the one that all keyframes agree with best.
    fn solve(
        &self,
        seen: &Seen<'_>,
        mean: DVector<f64>,
        layout: &Layout<'_>,
        shape: Shape<'_>,
        correction: &Correction,
    ) -> Found {
        let expected = mean[mean.len() - 1];
        let corrected = |at: &DVector<f64>| layout.corrected(correction, shape, at).into_owned();
        let nearest = self.nearest_fit(seen, &mean, Shape { displacement: &corrected(&mean), ..shape });
        let from = |start: f64| self.solve_from(start, seen, &mean, layout, shape, correction);
        let found = from(nearest);
        if nearest == expected {
            return found;
        }
        let other = from(expected);
        let misfits = |at: &DVector<f64>| self.misfits(seen, at, Shape { displacement: &corrected(at), ..shape });
        let differences = misfits(&found.at).into_iter().zip(misfits(&other.at)).map(|(a, b)| a - b);
        if differences.filter(|d| d.is_finite()).sum::<f64>() <= 0.0 { found } else { other }
    }

    /// How badly each keyframe agrees with the frame that is `seen`.
    fn misfits(&self, seen: &Seen<'_>, at: &DVector<f64>, shape: Shape<'_>) -> Vec<f64> {
        let view = self.moved(seen.given, at, 0.0);
        let sight = Sight { view: &view, picture: seen.picture, nearest: seen.nearest };
        let (first, second) = (at.len() - 1 - self.keyframes.len(), at[at.len() - 1]);
        let of = |(k, key): (usize, &Keyframe)| {
            let key_from_world = self.key_from_world(key, seen, at);
            misfit(key, &sight, &Assumed { first: at[first + k], key_from_world, second, shape })
        };
        self.keyframes.par_iter().enumerate().map(of).collect()
    }

    /// [`Window::solve`] with the frame's phase first taken for `start`.
    fn solve_from(
        &self,
        start: f64,
        seen: &Seen<'_>,
        mean: &DVector<f64>,
        layout: &Layout<'_>,
        shape: Shape<'_>,
        correction: &Correction,
    ) -> Found {
        let now = mean.len() - 1;
        let deviation = if self.keyframes.is_empty() { FIRST_DEVIATION } else { self.prior_deviation };
        let mut known = self.information.clone().resize(now + 1, now + 1, 0.0);
        known[(now, now)] = 1.0 / (deviation * deviation);
        let pull = self.pull.clone().push(0.0);
        let mut found = Found { at: mean.clone(), total: known.clone(), push: DVector::zeros(now + 1), last: None };
        found.at[now] = start;
        for _ in 0..STEPS {
            let corrected = layout.corrected(correction, shape, &found.at);
            let pairs = self.pairs(seen, &found.at, layout, Shape { displacement: &corrected, ..shape });
            found.total.copy_from(&known);
            let mut gradient = &pull + &known * (mean - &found.at);
            for (k, pair) in pairs.iter().enumerate() {
                let places = layout.places(k, now);
                for (i, &a) in places.iter().enumerate() {
                    gradient[a] += pair.gradient[i];
                    places.iter().enumerate().for_each(|(j, &b)| found.total[(a, b)] += pair.hessian[(i, j)]);
                }
            }
            found.last = pairs.last().map(|pair| (pair.flow, pair.kept));
            // The prior of the correction is no part of what images say.
            gradient -= layout.pull(&found.at);
            let curvature = layout.with_prior(&found.total);
            let Some(Step { step, push }) = bounded(&curvature, &gradient, &found.at, layout.first) else { break };
            found.push = push;
            layout.advance(&mut found.at, &step);
            if step.amax() < SHORTEST_STEP {
                break;
            }
        }
        found
    }

    /// What each keyframe and the frame that is `seen` say.
    fn pairs(&self, seen: &Seen<'_>, at: &DVector<f64>, layout: &Layout<'_>, shape: Shape<'_>) -> Vec<Pair> {
        let view = self.moved(seen.given, at, 0.0);
        let sight = Sight { view: &view, picture: seen.picture, nearest: seen.nearest };
        let pair_with = |(k, key): (usize, &Keyframe)| {
            let elapsed_s = seen.time_s - key.time_s;
            let assumed = Assumed {
                first: at[layout.first + k],
                key_from_world: self.key_from_world(key, seen, at),
                second: at[at.len() - 1],
                shape,
            };
            let corrections = [elapsed_s, 0.0].map(|ago_s| self.correction_of_poses(at, ago_s));
            let poses = self.drift.map(|_| Poses { corrections, elapsed_s });
            let mut pair = pair(key, &sight, &assumed, &Others { poses, weights: &layout.weights });
            if let Some(drift) = self.drift {
                pair.hessian /= drift.caution.powi(2);
                pair.gradient /= drift.caution.powi(2);
            }
            pair
        };
        self.keyframes.par_iter().enumerate().map(pair_with).collect()
    }

    /// Where a keyframe was taken from by the unknowns `at` the time of the frame that is `seen`.
    fn key_from_world(&self, key: &Keyframe, seen: &Seen<'_>, at: &DVector<f64>) -> DAffine3 {
        let given = View { camera_from_world: key.camera_from_world, ..*seen.given };
        self.moved(&given, at, seen.time_s - key.time_s).camera_from_world
    }

    /// Makes a keyframe of the last frame, and takes over what was `found` with it; the oldest leaves a full window.
    fn remember(&mut self, keyframe: Keyframe, found: Found, layout: &Layout<'_>) {
        self.waited = 0;
        self.keyframes.push(keyframe);
        // At the answer, images pull the correction as much one way as its prior the other.
        self.pull = layout.pull(&found.at) + &found.push;
        let oldest_is_held = found.push[layout.first] != 0.0;
        (self.unknowns, self.information) = (found.at, found.total);
        if self.keyframes.len() > self.most {
            let mut information = std::mem::take(&mut self.information);
            if oldest_is_held {
                // The end pushes back as hard as images push; whether it does is as sure as any phase is before an image.
                information[(layout.first, layout.first)] += self.prior_deviation.powi(-2);
            }
            self.information = without(information, layout.first);
            self.pull = self.pull.clone().remove_row(layout.first);
            self.unknowns = self.unknowns.clone().remove_row(layout.first);
            self.keyframes.remove(0);
        }
        // What is not looked at any more is not forgotten, and a drift forgets itself.
        let forgets = |k: usize| k >= layout.first || (k >= layout.poses && layout.others.contains(&k));
        let kept = DVector::from_fn(self.unknowns.len(), |k, _| if forgets(k) { self.kept } else { 1.0 });
        for (k, column) in kept.iter().enumerate() {
            self.information.column_mut(k).iter_mut().zip(&kept).for_each(|(value, row)| *value *= row.min(*column));
        }
        self.pull.component_mul_assign(&kept);
    }

    /// The `given` view of so many seconds ago with the correction of its pose by `unknowns`.
    fn moved(&self, given: &View, unknowns: &DVector<f64>, ago_s: f64) -> View {
        if self.drift.is_none() {
            return *given;
        }
        let xi = self.correction_of_poses(unknowns, ago_s);
        View { camera_from_world: motion(xi) * given.camera_from_world, ..*given }
    }

    /// The phase around the last of `mean` at which the frame agrees best with the last keyframe, if it does so clearly better.
    fn nearest_fit(&self, seen: &Seen<'_>, mean: &DVector<f64>, shape: Shape<'_>) -> f64 {
        let expected = mean[mean.len() - 1];
        let Some(last) = self.keyframes.last() else { return expected };
        let view = self.moved(seen.given, mean, 0.0);
        let sight = Sight { view: &view, picture: seen.picture, nearest: seen.nearest };
        let (first, key_from_world) = (mean[mean.len() - 2], self.key_from_world(last, seen, mean));
        let score = |second: f64| (misfit(last, &sight, &Assumed { first, key_from_world, second, shape }), second);
        let tried: Vec<f64> = (-TRIED..=TRIED).map(|k| (expected + APART * k as f64).clamp(0.0, 1.0)).collect();
        let best = tried.into_par_iter().map(score).min_by(|a, b| a.0.total_cmp(&b.0));
        match best {
            Some((least, phase)) if least < BETTER * score(expected).0 => phase,
            _ => expected,
        }
    }
}

/// The frame that is to be placed.
struct Seen<'a> {
    /// Its pose as it is given, with its camera.
    given: &'a View,
    time_s: f64,
    picture: &'a Picture,
    nearest: &'a [(f32, u32)],
}

/// What a frame was found to say.
struct Found {
    /// All unknowns, its phase the last.
    at: DVector<f64>,
    /// What images say about them.
    total: DMatrix<f64>,
    /// How hard they push phases against the ends of the breath; 0 for those that lie between.
    push: DVector<f64>,
    /// Flow of the points of the last keyframe, and the share of them that is left.
    last: Option<(f64, f64)>,
}

impl Found {
    /// Standard deviation of the phase.
    fn deviation(&self, layout: &Layout<'_>) -> Option<f64> {
        let now = self.at.len() - 1;
        layout.with_prior(&self.total).cholesky().map(|factor| factor.inverse()[(now, now)].sqrt())
    }
}

/// Where what is among the unknowns, and what is known of the correction of the displacement field before any image.
struct Layout<'a> {
    /// How many belong to the poses; they are the first.
    poses: usize,
    /// The first phase.
    first: usize,
    /// Those that a frame tells besides phases.
    others: Vec<usize>,
    /// Weights of all vertices at the centres of the correction that a frame tells.
    weights: Vec<&'a [f32]>,
    /// Of the prior of all coefficients.
    precision: Vec<f64>,
}

impl<'a> Layout<'a> {
    fn new(drifts: bool, correction: &'a Correction, given: &View) -> Layout<'a> {
        let poses = if drifts { 2 * POSE } else { 0 };
        let ahead = correction.in_view(&given.camera_from_world.inverse());
        let offsets = ahead.iter().flat_map(|&centre| (0..3).map(move |axis| poses + 3 * centre + axis));
        let precision = correction.precision();
        Layout {
            poses,
            first: poses + precision.len(),
            others: (0..poses).chain(offsets).collect(),
            weights: ahead.iter().map(|&centre| correction.weights(centre)).collect(),
            precision,
        }
    }

    /// The unknowns that a pair of keyframe `k` and the frame `now` tells, in its order.
    fn places(&self, k: usize, now: usize) -> Vec<usize> {
        [self.first + k, now].into_iter().chain(self.others.iter().copied()).collect()
    }

    /// The displacement field of `shape` by the unknowns `at`.
    fn corrected<'s>(&self, correction: &Correction, shape: Shape<'s>, at: &DVector<f64>) -> Cow<'s, [[f32; 3]]> {
        correction.corrected(shape.displacement, at.as_slice()[self.poses..self.first].as_chunks().0)
    }

    /// `information` with that of the prior.
    fn with_prior(&self, information: &DMatrix<f64>) -> DMatrix<f64> {
        let mut all = information.clone();
        self.precision.iter().enumerate().for_each(|(k, p)| all[(self.poses + k, self.poses + k)] += p);
        all
    }

    /// How much the prior pulls the coefficients back.
    fn pull(&self, at: &DVector<f64>) -> DVector<f64> {
        let mut pull = DVector::zeros(at.len());
        self.precision.iter().enumerate().for_each(|(k, p)| pull[self.poses + k] = p * at[self.poses + k]);
        pull
    }

    /// Takes a step, none of its parts longer than is sensible.
    fn advance(&self, at: &mut DVector<f64>, step: &DVector<f64>) {
        for (k, (value, step)) in at.iter_mut().zip(step.iter()).enumerate() {
            if k < self.first {
                *value += step.clamp(-LONGEST_SHIFT_MM, LONGEST_SHIFT_MM);
            } else {
                *value = (*value + step.clamp(-LONGEST_STEP, LONGEST_STEP)).clamp(0.0, 1.0);
            }
        }
    }
}

/// A step to where a quadratic model is least within bounds, and how hard the model pushes against those that hold it.
struct Step {
    step: DVector<f64>,
    push: DVector<f64>,
}

/// The step of Gauss-Newton with phases, from number `first` on, within 0..1: those that would leave it stop at its end, and all others
/// go where the images then agree best. A push against an end of the breath so tells the others where they are. By principal
/// pivots, the last of those that are wrong each time, which ends (Murty, "Note on a Bard-type scheme for solving the
/// complementarity problem", 1974). `None` where the curvature is none.
fn bounded(curvature: &DMatrix<f64>, gradient: &DVector<f64>, at: &DVector<f64>, first: usize) -> Option<Step> {
    let count = at.len();
    // Where phases are held.
    let mut ends: Vec<Option<f64>> = vec![None; count];
    for pivots in 0.. {
        let free: Vec<usize> = (0..count).filter(|&k| ends[k].is_none()).collect();
        let mut step = DVector::from_fn(count, |k, _| ends[k].map_or(0.0, |end| end - at[k]));
        let rest = gradient - curvature * &step;
        let found = curvature.select_rows(&free).select_columns(&free).cholesky()?.solve(&rest.select_rows(&free));
        free.iter().zip(found.iter()).for_each(|(&k, &value)| step[k] = value);
        let left = gradient - curvature * &step;
        let push = DVector::from_fn(count, |k, _| if ends[k].is_some() { left[k] } else { 0.0 });
        let is_wrong = |k: &usize| match ends[*k] {
            None => !(0.0..=1.0).contains(&(at[*k] + step[*k])),
            Some(end) => push[*k] * (end - 0.5) < 0.0,
        };
        // Rounding may turn a phase that is just at an end to and fro.
        let wrong = (first..count).rev().find(is_wrong).filter(|_| pivots < MOST_PIVOTS);
        let Some(wrong) = wrong else { return Some(Step { step, push }) };
        ends[wrong] = if ends[wrong].is_none() { Some((at[wrong] + step[wrong]).clamp(0.0, 1.0)) } else { None };
    }
    None
}

/// What is known about the others without unknown number `k`: Schur's complement.
fn without(mut information: DMatrix<f64>, k: usize) -> DMatrix<f64> {
    let column = information.column(k).clone_owned();
    information -= &column * column.transpose() / column[k];
    information.remove_row(k).remove_column(k)
}
