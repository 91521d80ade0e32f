//! The three stages of a frame: (i) theta alone, (ii) appearance alone, (iii) both; and when each has settled.

use super::fitter::{Fitter, FrameTarget};
use super::patch::VisiblePatch;
use crate::base::Result;
use crate::reconstruct::fitting::optimiser::{Adam, AdamConstants, StepCounter};
use crate::splat::{Reuse, View, Wanted};

impl Fitter<'_> {
    /// Value and derivative by the phase of `w_t (alpha_t - alpha_{t-1})^2` (Eq. 4, second part).
    fn temporal(&self, phase: f64) -> (f64, f64) {
        let Some(last) = self.phases.last() else { return (0.0, 0.0) };
        let (weight, change) = (*self.estimation().temporal_weight, phase - last);
        (weight * change * change, 2.0 * weight * change)
    }

    /// Stage (i): candidates, then theta alone; on the remembered colours if there is a memory.
    pub(super) fn measure_phase(
        &mut self,
        patch: &mut dyn VisiblePatch,
        target: &mut FrameTarget,
        guess: f64,
    ) -> Result<f64> {
        // Reference for the measurement: the remembered colours, at the exposure and light of this frame.
        let shown = (*self.estimation().memory_frames > 0.0).then(|| {
            let (sh, memory) = patch.colors();
            memory.recall(sh)
        });
        self.place(&target.view, patch, guess)?;
        self.fit_exposure(&target.view, patch, &target.image)?;
        if *self.estimation().colored_before_phase {
            self.color_the_unseen(&target.view, patch, &target.image);
        }
        // The phase: the best candidate, then Adam on theta.
        let start = self.best_candidate(patch, target, guess)?;
        let phase = self.optimise_phase(patch, target, start)?;
        if let Some(shown) = shown {
            let (sh, memory) = patch.colors();
            memory.restore(shown, sh);
        }
        Ok(phase)
    }

    /// The candidate around `guess` with the least loss.
    fn best_candidate(&mut self, patch: &mut dyn VisiblePatch, target: &mut FrameTarget, guess: f64) -> Result<f64> {
        let mut tried: Vec<f64> = self.estimation().candidates.iter().map(|c| (guess + c).clamp(0.0, 1.0)).collect();
        tried.dedup();
        let mut best = (f64::INFINITY, guess);
        for phase in tried {
            self.place(&target.view, patch, phase)?;
            let value = *self.estimation().color_weight * self.evaluate(patch, target)? + self.temporal(phase).0;
            if value < best.0 {
                best = (value, phase);
            }
        }
        Ok(best.1)
    }

    /// Stage (i): Adam on theta; returns the phase with the least loss among all iterations.
    fn optimise_phase(&mut self, patch: &mut dyn VisiblePatch, target: &mut FrameTarget, start: f64) -> Result<f64> {
        let iterations = self.iterations(0, target.frame);
        let mut adam = Adam::new(AdamConstants::default());
        adam.begin(1, StepCounter::Restarted);
        let mut theta = [self.activation().theta(start) as f32];
        let mut settling = Settling::new(*self.settings.settled);
        let mut best = (f64::INFINITY, start);
        for i in 0..iterations {
            // Loss (Eq. 4) at alpha(theta) (Eq. 3).
            let phase = self.activation().phase(theta[0] as f64);
            self.place(&target.view, patch, phase)?;
            let value = *self.estimation().color_weight * self.evaluate(patch, target)? + self.temporal(phase).0;
            if value < best.0 {
                best = (value, phase);
            }
            if settling.settled(value) {
                break;
            }
            // Its derivative, and a step.
            self.backward(patch, self.phase_groups())?;
            self.step_theta(
                &target.view,
                patch,
                &mut adam,
                &mut theta,
                geometric(*self.estimation().theta_rate, i, iterations),
            )?;
        }
        Ok(best.1)
    }

    /// One Adam step on `dL/dtheta = (w_c dL_photo/dalpha + dL_temp/dalpha) dalpha/dtheta`.
    fn step_theta(
        &mut self,
        view: &View,
        patch: &mut dyn VisiblePatch,
        adam: &mut Adam,
        theta: &mut [f32; 1],
        rate: f64,
    ) -> Result<()> {
        let at = theta[0] as f64;
        let by_phase = *self.estimation().color_weight * self.phase_derivative(view, patch)?
            + self.temporal(self.activation().phase(at)).1;
        adam.step(rate, theta, &[(by_phase * self.activation().slope(at)) as f32]);
        let [low, high] = self.activation().range();
        theta[0] = theta[0].clamp(low as f32, high as f32);
        Ok(())
    }

    /// Stages (ii) and (iii); returns the phase.
    pub(super) fn optimise_appearance(
        &mut self,
        patch: &mut dyn VisiblePatch,
        target: &mut FrameTarget,
        start: f64,
        estimated: bool,
    ) -> Result<f64> {
        let (alone, joint) = (self.iterations(1, target.frame), self.iterations(2, target.frame));
        let groups = patch.appearance_groups();
        let move_theta = estimated && target.frame > 0;
        let mut adam = Adam::new(AdamConstants::default());
        adam.begin(1, StepCounter::Restarted);
        patch.begin_appearance();
        let mut theta = [if move_theta { self.activation().theta(start) as f32 } else { 0.0 }];
        // While only colours are learned, splats and tile lists stay those of the first iteration.
        let still = !groups.any(Wanted::POSITIONS | Wanted::SHAPES);
        self.rasterizer.reuse(if still { Reuse::Unchanged } else { Reuse::Never });
        let mut settling = Settling::new(*self.settings.settled);
        let mut i = 0;
        while i < alone + joint {
            // Loss; a stage that has settled ends, and (iii) follows (ii).
            let value = self.evaluate(patch, target)?;
            if settling.settled(value) {
                if i >= alone || joint == 0 {
                    break;
                }
                (i, settling) = (alone, Settling::new(*self.settings.settled));
            }
            // Gradients: of appearance, and in (iii) of theta.
            let moves = move_theta && i >= alone;
            self.backward(patch, if moves { groups | self.phase_groups() } else { groups })?;
            if moves {
                let rate = geometric(*self.estimation().theta_rate_joint, i - alone, joint);
                self.step_theta(&target.view, patch, &mut adam, &mut theta, rate)?;
            }
            // Step of appearance, and the new placement of the Gaussians.
            patch.step_appearance(self.rasterizer.gradients())?;
            if moves {
                self.place(&target.view, patch, self.activation().phase(theta[0] as f64))?;
            } else if !still {
                patch.place(start)?;
            }
            i += 1;
        }
        self.rasterizer.reuse(Reuse::Never);
        Ok(if move_theta { self.activation().phase(theta[0] as f64) } else { start })
    }
}

/// Iterations over which a stage must have made progress.
const SETTLING: usize = 5;

/// Notices when a loss no longer falls.
struct Settling {
    share: f64,
    last: [f64; SETTLING],
    count: usize,
}

impl Settling {
    /// A loss has settled when it fell by less than `share` of itself over [`SETTLING`] iterations; never with 0.
    fn new(share: f64) -> Self {
        Settling { share, last: [f64::INFINITY; SETTLING], count: 0 }
    }

    fn settled(&mut self, value: f64) -> bool {
        let before = std::mem::replace(&mut self.last[self.count % SETTLING], value);
        self.count += 1;
        self.share > 0.0 && before - value < self.share * value
    }
}

/// Value `i` of `n` of a geometric sequence from the first to the last rate, neither of which is 0.
fn geometric([first, last]: [f64; 2], i: usize, n: usize) -> f64 {
    first * (last / first).powf(i as f64 / (n.max(2) - 1) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_loss_settles_when_five_iterations_gain_less_than_the_share() {
        let first_settled = |share: f64, loss: fn(usize) -> f64| {
            let mut settling = Settling::new(share);
            (0..50).find(|&i| settling.settled(loss(i)))
        };
        assert_eq!(first_settled(0.01, |_| 1.0), Some(SETTLING));
        assert_eq!(first_settled(0.01, |i| 0.9f64.powi(i as i32)), None);
        assert_eq!(first_settled(0.01, |i| if i < 10 { 0.9f64.powi(i as i32) } else { 0.3 }), Some(15));
        assert_eq!(first_settled(0.0, |_| 1.0), None);
    }

    #[test]
    fn a_falling_rate_ends_with_the_last() {
        assert!((geometric([0.04, 0.004], 9, 10) - 0.004).abs() < 1e-12);
    }
}
