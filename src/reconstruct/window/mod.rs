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
//! any phase, may go into a correction of the displacement field ([`super::correction`]): its coefficients are unknowns of
//! the window, too, which no keyframe takes along when it leaves. Where walls are near, the valley of the misfit is .01 of a phase wide: before the
//! first step the phase around the expected one is looked for at which the frame agrees best with the last keyframe.
//! Left out: levels of resolution, and poses that are unknown: with six more unknowns per frame the way along a tube and the
//! phase are one, and both run away (docs/methods.md).

mod contrast;
mod pair;
#[cfg(test)]
mod tests;

use glam::DAffine3;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::correction::Correction;
use super::level::Level;
use super::mesh_depth::{Rays, nearest_faces};
use super::settings;
use contrast::picture;
use pair::{Keyframe, Pair, Sight, keyframe, misfit, pair};

pub use pair::Shape;

/// Most Gauss-Newton steps per frame, the longest of them, and one that ends them.
const STEPS: usize = 4;
const LONGEST_STEP: f64 = 0.05;
const SHORTEST_STEP: f64 = 2e-4;
/// Longest step of a coefficient of the correction.
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
}

/// The keyframes, and what is known about their phases.
pub struct Window {
    /// Of the pictures' camera, from the first one on.
    rays: Option<Rays>,
    most: usize,
    kept: f64,
    prior_deviation: f64,
    keyframes: Vec<Keyframe>,
    /// The unknowns: coefficients of the correction in mm, three per centre, then the phases of the keyframes.
    unknowns: DVector<f64>,
    /// What images say about them around there: second and first derivatives. Where there is no correction, the first are 0.
    information: DMatrix<f64>,
    pull: DVector<f64>,
    /// Frames since the last keyframe.
    waited: usize,
}

impl Window {
    /// An empty window; `None` where `settings` ask for no keyframes.
    pub fn new(settings: &settings::Window) -> Option<Window> {
        let empty = Window {
            rays: None,
            most: *settings.keyframes as usize,
            kept: *settings.memory,
            prior_deviation: *settings.prior_deviation,
            keyframes: Vec::new(),
            unknowns: DVector::zeros(0),
            information: DMatrix::zeros(0, 0),
            pull: DVector::zeros(0),
            waited: 0,
        };
        (empty.most > 0).then_some(empty)
    }

    /// Whether the window works on pictures of this size; larger ones are to be halved.
    pub fn suits(level: &Level) -> bool {
        level.image.width <= WIDEST
    }

    /// Places a frame in the breath, which is expected at `expected` and has the faces `visible` in view; `shape` is the one that
    /// is given, without `correction`, which learns from the frame. All frames have one camera and one correction.
    pub fn place(
        &mut self,
        frame: &Level,
        visible: &[u32],
        expected: f64,
        shape: Shape<'_>,
        correction: &mut Correction,
    ) -> Placed {
        let deviation = if self.keyframes.is_empty() { FIRST_DEVIATION } else { self.prior_deviation };
        let rays = self.rays.take().unwrap_or_else(|| Rays::new(&frame.view.camera));
        let picture = picture(&frame.image, &frame.weights);
        let offsets = self.offsets(correction, &frame.view.camera_from_world.inverse());
        let mut displacement = correction.corrected(shape.displacement, &correction.coefficients);
        let assumed = Shape { displacement: &displacement, ..shape };
        let nearest = nearest_faces(&frame.view, &rays, &assumed.at(expected), shape.faces, visible);
        let sight = Sight { view: &frame.view, picture: &picture, nearest: &nearest };
        let (first, now) = (offsets.precision.len(), self.unknowns.len());
        let mean = self.unknowns.clone().push(expected);
        let mut known = self.information.clone().resize(now + 1, now + 1, 0.0);
        known[(now, now)] = 1.0 / (deviation * deviation);
        let pull = self.pull.clone().push(0.0);
        let (mut at, mut total) = (mean.clone(), known.clone());
        at[now] = self.nearest_fit(&sight, expected, assumed);
        let mut last = None;
        for _ in 0..STEPS {
            let assumed = Shape { displacement: &displacement, ..shape };
            let pairs: Vec<Pair> = (self.keyframes.par_iter().enumerate())
                .map(|(k, key)| pair(key, at[first + k], &sight, at[now], assumed, &offsets.weights))
                .collect();
            total.copy_from(&known);
            let mut gradient = &pull + &known * (&mean - &at);
            for (k, pair) in pairs.iter().enumerate() {
                // Columns of the pair among the unknowns.
                let places = [first + k, now].into_iter().chain(offsets.places.iter().copied());
                let places: Vec<usize> = places.collect();
                for (i, &a) in places.iter().enumerate() {
                    gradient[a] += pair.gradient[i];
                    places.iter().enumerate().for_each(|(j, &b)| total[(a, b)] += pair.hessian[(i, j)]);
                }
            }
            last = pairs.last().map(|pair| (pair.flow, pair.kept));
            // The prior of the correction is no part of what images say.
            let mut posterior = total.clone();
            for (k, precision) in offsets.precision.iter().enumerate() {
                posterior[(k, k)] += precision;
                gradient[k] -= precision * at[k];
            }
            let Some(factor) = posterior.cholesky() else { break };
            let step = factor.solve(&gradient);
            for (k, (value, step)) in at.iter_mut().zip(step.iter()).enumerate() {
                *value = if k < first {
                    *value + step.clamp(-LONGEST_SHIFT_MM, LONGEST_SHIFT_MM)
                } else {
                    (*value + step.clamp(-LONGEST_STEP, LONGEST_STEP)).clamp(0.0, 1.0)
                };
            }
            if correction.estimates() {
                displacement = correction.corrected(shape.displacement, at.as_slice()[..first].as_chunks().0);
            }
            if step.amax() < SHORTEST_STEP {
                break;
            }
        }
        let mut posterior = total.clone();
        offsets.precision.iter().enumerate().for_each(|(k, precision)| posterior[(k, k)] += precision);
        let variance = posterior.cholesky().map_or(deviation * deviation, |f| f.inverse()[(now, now)]);
        let placed = Placed { phase: at[now], deviation: variance.sqrt() };
        self.waited += 1;
        let enough = |(flow, kept): (f64, f64)| flow > LONGEST_FLOW || kept < FEWEST_KEPT;
        if last.is_none_or(enough) || self.waited >= LONGEST_WAIT {
            let assumed = Shape { displacement: &displacement, ..shape };
            let nearest = nearest_faces(&frame.view, &rays, &assumed.at(placed.phase), shape.faces, visible);
            let sight = Sight { nearest: &nearest, ..sight };
            // At the answer, images pull the correction as much one way as its prior the other.
            let pull = DVector::from_fn(now + 1, |k, _| offsets.precision.get(k).map_or(0.0, |p| p * at[k]));
            self.add(keyframe(&sight, assumed), at, total, pull, &offsets);
        }
        // A frame that leaves no information behind leaves no correction.
        correction.set(self.unknowns.as_slice()[..first].as_chunks().0);
        self.rays = Some(rays);
        placed
    }

    /// What of `correction` a scope at `pose` tells; its unknowns come first in the window.
    fn offsets<'a>(&mut self, correction: &'a Correction, pose: &DAffine3) -> Offsets<'a> {
        let precision = correction.precision();
        if self.keyframes.is_empty() {
            let n = precision.len();
            (self.unknowns, self.pull) = (DVector::zeros(n), DVector::zeros(n));
            self.information = DMatrix::zeros(n, n);
        }
        let ahead = correction.in_view(pose);
        Offsets {
            weights: ahead.iter().map(|&centre| correction.weights(centre)).collect(),
            places: ahead.iter().flat_map(|&centre| (0..3).map(move |axis| 3 * centre + axis)).collect(),
            precision,
        }
    }

    /// The phase around `expected` at which a frame agrees best with the last keyframe, if it does so clearly better.
    fn nearest_fit(&self, sight: &Sight<'_>, expected: f64, shape: Shape<'_>) -> f64 {
        let Some(last) = self.keyframes.last() else { return expected };
        let known = self.unknowns[self.unknowns.len() - 1];
        let score = |phase: f64| (misfit(last, known, sight, phase, shape), phase);
        let tried: Vec<f64> = (-TRIED..=TRIED).map(|k| (expected + APART * k as f64).clamp(0.0, 1.0)).collect();
        let best = tried.into_par_iter().map(score).min_by(|a, b| a.0.total_cmp(&b.0));
        match best {
            Some((least, phase)) if least < BETTER * score(expected).0 => phase,
            _ => expected,
        }
    }

    /// Takes a keyframe in, given all unknowns with its phase and what images say about them; the oldest leaves a full window.
    fn add(
        &mut self,
        keyframe: Keyframe,
        unknowns: DVector<f64>,
        mut information: DMatrix<f64>,
        mut pull: DVector<f64>,
        offsets: &Offsets<'_>,
    ) {
        self.waited = 0;
        self.keyframes.push(keyframe);
        self.unknowns = unknowns;
        let first = offsets.precision.len();
        if self.keyframes.len() > self.most {
            // What is known about the others without it: Schur's complement.
            let own = information[(first, first)];
            let column = information.column(first).clone_owned();
            information -= &column * column.transpose() / own;
            information = information.remove_row(first).remove_column(first);
            pull = pull.remove_row(first);
            self.keyframes.remove(0);
            self.unknowns = self.unknowns.clone().remove_row(first);
        }
        // What is not looked at any more is not forgotten.
        let kept = |k: usize| if k >= first || offsets.places.contains(&k) { self.kept } else { 1.0 };
        self.information =
            DMatrix::from_fn(information.nrows(), information.ncols(), |i, j| kept(i).min(kept(j)) * information[(i, j)]);
        self.pull = DVector::from_fn(pull.len(), |k, _| kept(k) * pull[k]);
    }
}

/// What a frame may tell about the correction.
struct Offsets<'a> {
    /// Weights of all vertices at each centre in view.
    weights: Vec<&'a [f32]>,
    /// Their coefficients among the unknowns.
    places: Vec<usize>,
    /// Of the prior of all coefficients.
    precision: Vec<f64>,
}
