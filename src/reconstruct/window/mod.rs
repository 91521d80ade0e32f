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
//! light inside the wall) do not average out. Where walls are near, the valley of the misfit is .01 of a phase wide: before the
//! first step the phase around the expected one is looked for at which the frame agrees best with the last keyframe.
//! Left out: levels of resolution, and poses that are unknown: with six more unknowns per frame the way along a tube and the
//! phase are one, and both run away (docs/methods.md).

mod contrast;
mod pair;
#[cfg(test)]
mod tests;

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

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
    phases: DVector<f64>,
    information: DMatrix<f64>,
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
            phases: DVector::zeros(0),
            information: DMatrix::zeros(0, 0),
            waited: 0,
        };
        (empty.most > 0).then_some(empty)
    }

    /// Whether the window works on pictures of this size; larger ones are to be halved.
    pub fn suits(level: &Level) -> bool {
        level.image.width <= WIDEST
    }

    /// Places a frame in the breath, which is expected at `expected` and has the faces `visible` in view. All frames have
    /// one camera.
    pub fn place(&mut self, frame: &Level, visible: &[u32], expected: f64, shape: Shape<'_>) -> Placed {
        let deviation = if self.keyframes.is_empty() { FIRST_DEVIATION } else { self.prior_deviation };
        let rays = self.rays.take().unwrap_or_else(|| Rays::new(&frame.view.camera));
        let picture = picture(&frame.image, &frame.weights);
        let nearest = nearest_faces(&frame.view, &rays, &shape.at(expected), shape.faces, visible);
        let sight = Sight { view: &frame.view, picture: &picture, nearest: &nearest };
        let now = self.keyframes.len();
        let mean = self.phases.clone().push(expected);
        let mut known = self.information.clone().resize(now + 1, now + 1, 0.0);
        known[(now, now)] = 1.0 / (deviation * deviation);
        let (mut at, mut total) = (mean.clone(), known.clone());
        at[now] = self.nearest_fit(&sight, expected, shape);
        let mut last = None;
        for _ in 0..STEPS {
            let pairs: Vec<Pair> = (self.keyframes.par_iter().enumerate())
                .map(|(k, key)| pair(key, at[k], &sight, at[now], shape))
                .collect();
            total.copy_from(&known);
            let mut gradient = &known * (&mean - &at);
            for (k, pair) in pairs.iter().enumerate() {
                total[(k, k)] += pair.hessian[0];
                total[(k, now)] += pair.hessian[1];
                total[(now, k)] += pair.hessian[1];
                total[(now, now)] += pair.hessian[2];
                gradient[k] += pair.gradient[0];
                gradient[now] += pair.gradient[1];
            }
            last = pairs.last().copied();
            let Some(factor) = total.clone().cholesky() else { break };
            let step = factor.solve(&gradient);
            for (phase, step) in at.iter_mut().zip(step.iter()) {
                *phase = (*phase + step.clamp(-LONGEST_STEP, LONGEST_STEP)).clamp(0.0, 1.0);
            }
            if step.amax() < SHORTEST_STEP {
                break;
            }
        }
        let variance = total.clone().cholesky().map_or(deviation * deviation, |f| f.inverse()[(now, now)]);
        let placed = Placed { phase: at[now], deviation: variance.sqrt() };
        self.waited += 1;
        let enough = |pair: Pair| pair.flow > LONGEST_FLOW || pair.kept < FEWEST_KEPT;
        if last.is_none_or(enough) || self.waited >= LONGEST_WAIT {
            let nearest = nearest_faces(&frame.view, &rays, &shape.at(placed.phase), shape.faces, visible);
            let sight = Sight { nearest: &nearest, ..sight };
            self.add(keyframe(&sight, shape), at, total);
        }
        self.rays = Some(rays);
        placed
    }

    /// The phase around `expected` at which a frame agrees best with the last keyframe, if it does so clearly better.
    fn nearest_fit(&self, sight: &Sight<'_>, expected: f64, shape: Shape<'_>) -> f64 {
        let Some(last) = self.keyframes.last() else { return expected };
        let known = self.phases[self.keyframes.len() - 1];
        let score = |phase: f64| (misfit(last, known, sight, phase, shape), phase);
        let tried: Vec<f64> = (-TRIED..=TRIED).map(|k| (expected + APART * k as f64).clamp(0.0, 1.0)).collect();
        let best = tried.into_par_iter().map(score).min_by(|a, b| a.0.total_cmp(&b.0));
        match best {
            Some((least, phase)) if least < BETTER * score(expected).0 => phase,
            _ => expected,
        }
    }

    /// Takes a keyframe in, given all phases with it and what is known about them; the oldest leaves a full window.
    fn add(&mut self, keyframe: Keyframe, phases: DVector<f64>, mut information: DMatrix<f64>) {
        self.waited = 0;
        self.keyframes.push(keyframe);
        self.phases = phases;
        if self.keyframes.len() > self.most {
            // What is known about the others without it: Schur's complement.
            let n = information.nrows();
            let row = information.row(0).columns(1, n - 1).clone_owned();
            information = information.view((1, 1), (n - 1, n - 1)) - row.transpose() * &row / information[(0, 0)];
            self.keyframes.remove(0);
            self.phases = self.phases.clone().remove_row(0);
        }
        self.information = information * self.kept;
    }
}
