//! The order of the window's unknowns: the correction of the poses and its change per second (if poses drift), the
//! coefficients of the correction of the displacement field, then the phases.

use std::borrow::Cow;

use nalgebra::{DMatrix, DVector};

use super::correction::Correction;
use crate::reconstruct::geometry::breathing::BreathingMesh;
use crate::reconstruct::geometry::rigid::POSE;
use crate::splat::View;

/// Longest step of a phase (phases are 0..1).
const LONGEST_STEP: f64 = 0.05;
/// Longest step of a coefficient of the correction and of a translation, mm. Angles (rad) share the limit and never
/// reach it.
const LONGEST_SHIFT_MM: f64 = 0.3;

/// The index of each unknown, and the prior of the correction of the displacement field.
pub struct UnknownLayout<'a> {
    /// How many unknowns belong to the poses; they come first.
    pub poses: usize,
    /// Index of the first phase.
    pub first: usize,
    /// Unknowns besides phases on which a frame's residuals depend.
    pub others: Vec<usize>,
    /// Weights of all vertices at the centres of the correction in front of the frame.
    pub weights: Vec<&'a [f32]>,
    correction: &'a Correction,
    /// Precision of the prior of each coefficient, 1 / mm^2.
    precision: Vec<f64>,
}

impl<'a> UnknownLayout<'a> {
    /// The order for a frame that was taken from `given`.
    pub fn new(drifts: bool, correction: &'a Correction, given: &View) -> UnknownLayout<'a> {
        let poses = if drifts { 2 * POSE } else { 0 };
        let ahead = correction.in_view(&given.camera_from_world.inverse());
        let offsets = ahead.iter().flat_map(|&centre| (0..3).map(move |axis| poses + 3 * centre + axis));
        let precision = correction.precision();
        UnknownLayout {
            poses,
            first: poses + precision.len(),
            others: (0..poses).chain(offsets).collect(),
            weights: ahead.iter().map(|&centre| correction.weights(centre)).collect(),
            correction,
            precision,
        }
    }

    /// The unknowns of the pair of keyframe `k` and the frame with phase index `now`, in the pair's order.
    pub fn places(&self, k: usize, now: usize) -> Vec<usize> {
        [self.first + k, now].into_iter().chain(self.others.iter().copied()).collect()
    }

    /// The displacement field of `mesh`, corrected by the unknowns `at`.
    pub fn corrected<'s>(&self, mesh: BreathingMesh<'s>, at: &DVector<f64>) -> Cow<'s, [[f32; 3]]> {
        self.correction.apply_with(mesh.displacement, at.as_slice()[self.poses..self.first].as_chunks().0)
    }

    /// `information` with that of the prior.
    pub fn with_prior(&self, information: &DMatrix<f64>) -> DMatrix<f64> {
        let mut all = information.clone();
        self.precision.iter().enumerate().for_each(|(k, p)| all[(self.poses + k, self.poses + k)] += p);
        all
    }

    /// Gradient of the prior of the coefficients: their precision times themselves.
    pub fn prior_gradient(&self, at: &DVector<f64>) -> DVector<f64> {
        let mut gradient = DVector::zeros(at.len());
        self.precision.iter().enumerate().for_each(|(k, p)| gradient[self.poses + k] = p * at[self.poses + k]);
        gradient
    }

    /// Takes a step, each component limited in length and phases kept within 0..1.
    pub fn advance(&self, at: &mut DVector<f64>, step: &DVector<f64>) {
        for (k, (value, step)) in at.iter_mut().zip(step.iter()).enumerate() {
            if k < self.first {
                *value += step.clamp(-LONGEST_SHIFT_MM, LONGEST_SHIFT_MM);
            } else {
                *value = (*value + step.clamp(-LONGEST_STEP, LONGEST_STEP)).clamp(0.0, 1.0);
            }
        }
    }
}
