//! The method: what it is given, and what it hands out.

use glam::DAffine3;

use super::tracker::{NavTracker, Navigated, NavigationInput};
use crate::base::{Image, Progress, Result};
use crate::reconstruct::contract::{
    Access, ArrivedFrame, FollowFrames, FramePrediction, LiveAnswer, NovelPrediction, Observation, PoseAccuracy,
    Reconstruct, Reconstruction,
};
use crate::reconstruct::geometry::breathing::mesh_at;
use crate::reconstruct::geometry::virtual_view::VirtualCamera;
use crate::reconstruct::geometry::visible::Reach;
use crate::reconstruct::online::{OnlineRun, held_out};
use crate::reconstruct::settings::{MethodHeader, OursNavSettings};
use crate::splat::View;

/// The method with its settings.
pub struct OursNav {
    settings: OursNavSettings,
}

impl OursNav {
    /// With `settings`.
    pub fn new(settings: OursNavSettings) -> Self {
        OursNav { settings }
    }

    /// The pose (world from camera) of a frame of the breath hold in which a film starts, by its picture alone, from
    /// `start`, which is off by about `deviation` (rad and mm, each about or along one axis).
    pub fn find_pose(&self, observation: &Observation, frame: usize, start: DAffine3, deviation: [f64; 2]) -> DAffine3 {
        NavTracker::new(&self.settings, observation).find_pose(&observation.images[frame], start, deviation)
    }
}

impl Reconstruct for OursNav {
    fn header(&self) -> &MethodHeader {
        &self.settings.header
    }

    fn access(&self) -> Access {
        Access { expiration_mesh: true, first_depth: false, true_phase: false, poses: PoseAccuracy::True }
    }

    fn run(
        &self,
        observation: &Observation,
        emit: &mut dyn FnMut(FramePrediction) -> Result<()>,
        progress: &dyn Progress,
    ) -> Result<Reconstruction> {
        let run = OnlineRun::begin(self.access(), observation)?;
        let mut tracker = NavTracker::new(&self.settings, observation);
        let camera = VirtualCamera::new(observation.camera, Reach::new(&self.settings.visibility));
        let view = |tracker: &NavTracker<'_>, pose: DAffine3, phase: f64| {
            let aimed = camera.aim(&View::new(observation.camera, pose), tracker.mesh());
            let seen = camera.render(&aimed, tracker.mesh(), phase);
            NovelPrediction { color: seen.color, depth_mm: seen.depth_mm }
        };
        let mut last = 0.0;
        let fit = |frame: usize| {
            let input = NavigationInput {
                image: &observation.images[frame],
                time_s: observation.time_s[frame],
                world_from_camera: observation.world_from_camera[frame],
            };
            let (pose, phase) = tracker.expect(input.time_s, &input.world_from_camera);
            let ahead: Option<Image<f32>> = held_out(frame).then(|| view(&tracker, pose, phase).color);
            let found = tracker.look(input.image, input.time_s);
            last = found.phase[0];
            let shown = view(&tracker, found.world_from_camera, last);
            // The second camera is told relative to the first.
            let moved = found.world_from_camera * input.world_from_camera.inverse();
            let novel = observation.novel_pose[frame].map(|pose| view(&tracker, moved * pose, last));
            Ok(FramePrediction {
                frame,
                color: shown.color,
                depth_mm: shown.depth_mm,
                phase: Some(found.phase[0]),
                phase_deviation: Some(found.phase[1]),
                world_from_camera: Some(found.world_from_camera),
                ahead,
                targets_mm: Some(found.targets_mm),
                target_covariance_mm2: Some(found.covariance_mm2),
                novel,
            })
        };
        let spent = run.fit_in_order(fit, emit, progress)?;
        Ok(Reconstruction { final_mesh: Some(mesh_at(observation, last)), spent })
    }

    fn live(&self) -> Option<&dyn FollowFrames> {
        Some(self)
    }
}

impl FollowFrames for OursNav {
    fn follow(
        &self,
        known: &Observation,
        next: &mut dyn FnMut() -> Result<Option<ArrivedFrame>>,
        answer: &mut dyn FnMut(LiveAnswer) -> Result<()>,
    ) -> Result<()> {
        known.validate(self.access())?;
        let mut tracker = NavTracker::new(&self.settings, known);
        while let Some(arrived) = next()? {
            // Inside the thread pool, as `OnlineRun` has it.
            let found = rayon::scope(|_| {
                tracker.expect(arrived.time_s, &arrived.world_from_camera);
                tracker.look(&arrived.image, arrived.time_s)
            });
            answer(live_answer(found))?;
        }
        Ok(())
    }
}

fn live_answer(found: Navigated) -> LiveAnswer {
    LiveAnswer {
        state: found.state,
        phase: found.phase[0],
        phase_deviation: Some(found.phase[1]),
        world_from_camera: found.world_from_camera,
        targets_mm: found.targets_mm,
        target_covariance_mm2: found.covariance_mm2,
        masked_share: Some(found.masked_share),
        mask: Some(found.mask),
    }
}
