//! The loop over the frames.

use super::fitter::{Fitter, FrameTarget};
use super::patch::{BreathingGaussians, VisiblePatch};
use crate::base::{Progress, Result};
use crate::reconstruct::contract::{FramePrediction, NovelPrediction, Reconstruction};
use crate::reconstruct::fitting::grid_search::grid_search;
use crate::reconstruct::geometry::mesh_depth::depth_gap_mm;
use crate::reconstruct::geometry::pyramid::PyramidLevel;
use crate::reconstruct::geometry::visible::nothing_in_view;
use crate::reconstruct::online::{OnlineRun, color_image, depth_image, held_out, shown};
use crate::reconstruct::settings::PhaseEstimation;
use crate::splat::{DepthOutput, View};

/// Largest difference between a frame's phase and its guess for which visible faces are chosen.
pub const REACH: f64 = 0.15;

/// Where the phase comes from.
#[derive(Clone, Debug)]
pub enum PhaseSource<'a> {
    /// Estimated from RGB; the first one by depth.
    Estimated(&'a PhaseEstimation),
    /// Given for every frame (`static-ct`: zeros; `oracle-phase`: the truth).
    Given(Vec<f64>),
}

impl<'a> PhaseSource<'a> {
    /// How the phase is estimated; `None` if it is given.
    pub fn estimation(&self) -> Option<&'a PhaseEstimation> {
        match self {
            PhaseSource::Estimated(estimation) => Some(estimation),
            PhaseSource::Given(_) => None,
        }
    }
}

impl Fitter<'_> {
    /// Runs the loop over all frames; the last phase, and what remains.
    pub fn run(
        mut self,
        run: OnlineRun,
        source: &PhaseSource<'_>,
        gaussians: &mut dyn BreathingGaussians,
        emit: &mut dyn FnMut(FramePrediction) -> Result<()>,
        progress: &dyn Progress,
    ) -> Result<(f64, Reconstruction)> {
        let spent = run.fit_in_order(|frame| self.fit(frame, source, gaussians), emit, progress)?;
        let last = self.phases.last().copied().unwrap_or(0.0);
        Ok((last, Reconstruction { final_mesh: None, spent }))
    }

    /// The phase of the next frame if part of the last change continues.
    fn guess(&self) -> f64 {
        match *self.phases.as_slice() {
            [] => 0.0,
            [only] => only,
            [.., before, last] => (last + *self.estimation().velocity * (last - before)).clamp(0.0, 1.0),
        }
    }

    fn fit(
        &mut self,
        frame: usize,
        source: &PhaseSource<'_>,
        gaussians: &mut dyn BreathingGaussians,
    ) -> Result<FramePrediction> {
        let view = View::new(self.observation.camera, self.observation.world_from_camera[frame]);
        let estimated = self.estimation.is_some();
        let mut phase = match source {
            PhaseSource::Given(phases) => phases[frame],
            PhaseSource::Estimated(_) => self.guess(),
        };
        let reach = match (estimated, frame) {
            (true, 0) => [0.0, 1.0],
            (true, _) => [(phase - REACH).max(0.0), (phase + REACH).min(1.0)],
            (false, _) => [phase, phase],
        };
        let mut entered = gaussians.enter(&view, reach)?;
        let patch = &mut *entered;
        if estimated && frame == 0 && patch.gaussians().positions.is_empty() {
            return Err(nothing_in_view());
        }
        self.place(&view, patch, phase)?;
        if estimated && frame == 0 {
            phase = self.search_by_depth(&view, patch)?;
            self.place(&view, patch, phase)?;
        }
        let ahead = if held_out(frame) {
            self.render(&view, patch, DepthOutput::Skip)?;
            Some(color_image(&self.rasterizer))
        } else {
            None
        };

        // From here on the frame's image may be used.
        let mut target = FrameTarget::new(frame, view, self.observation, self.largest_ssim_weight());
        if estimated {
            // Stage (i): theta alone.
            if frame > 0 {
                target.loss.set_ssim_weight(*self.estimation().phase_ssim_weight);
                phase = self.measure_phase(patch, &mut target, phase)?;
            }
            let weights = self.observation.pixel_weights().unwrap_or_default();
            phase = patch.place_among_keyframes(PyramidLevel { view, image: target.image.clone(), weights }, phase);
            self.place(&view, patch, phase)?;
        }
        if frame > 0 {
            self.fit_exposure(&view, patch, &target.image)?;
        }
        self.color_the_unseen(&view, patch, &target.image);
        let (sh, memory) = patch.colors();
        let before = memory.set_aside(sh);

        // Stages (ii) and (iii): appearance, then both.
        target.loss.set_ssim_weight(*self.settings.ssim_weight);
        phase = self.optimise_appearance(patch, &mut target, phase, estimated)?;
        self.place(&view, patch, phase)?;
        self.render(&view, patch, DepthOutput::Surface)?;
        let NovelPrediction { color, depth_mm } = shown(&self.rasterizer);
        self.mark_fitted(patch, &target, &before);
        entered.leave();
        let depth_mm = gaussians.surface_depth_mm(&view, phase).unwrap_or(depth_mm);
        self.phases.push(phase);
        let novel = self.novel(frame, phase, gaussians)?;
        Ok(FramePrediction {
            frame,
            color,
            depth_mm,
            phase: estimated.then_some(phase),
            phase_deviation: None,
            world_from_camera: None,
            ahead,
            targets_mm: Some(self.targets.at_phase(self.observation, phase)),
            target_covariance_mm2: None,
            novel,
        })
    }

    /// The view of the frame's second camera at `phase`, with what has been learned so far.
    fn novel(
        &mut self,
        frame: usize,
        phase: f64,
        gaussians: &mut dyn BreathingGaussians,
    ) -> Result<Option<NovelPrediction>> {
        let Some(pose) = self.observation.novel_pose[frame] else { return Ok(None) };
        let view = View::new(self.observation.camera, pose);
        let surface = gaussians.surface_depth_mm(&view, phase);
        let mut patch = gaussians.look(&view, phase)?;
        self.place(&view, &mut *patch, phase)?;
        if *self.settings.lent_colors {
            self.color_the_unseen_as_beside(&view, &mut *patch);
        }
        let depth = if surface.is_some() { DepthOutput::Skip } else { DepthOutput::Surface };
        self.render(&view, &*patch, depth)?;
        let shown = shown(&self.rasterizer);
        Ok(Some(NovelPrediction { depth_mm: surface.unwrap_or(shown.depth_mm), ..shown }))
    }

    /// First frame: the phase whose rendered depth is closest to the given depth.
    fn search_by_depth(&mut self, view: &View, patch: &mut dyn VisiblePatch) -> Result<f64> {
        let Some(given) = &self.observation.first_depth_mm else { return Ok(0.0) };
        grid_search(*self.estimation().grid_steps, |phase| {
            self.place(view, patch, phase)?;
            let rendered = self.render(view, patch, DepthOutput::Surface)?;
            Ok(depth_gap_mm(&depth_image(rendered, given.width, given.height), given))
        })
    }
}
