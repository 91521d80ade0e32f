//! The rows that show the CT's surface itself: two that follow the phase without looking at a picture (`mean-breath` looks
//! at those of the first seconds), and the one that navigation systems use.
//!
//! | row | phase |
//! |---|---|
//! | `pose-only` | the one whose lumen is best centred on the given pose |
//! | `mean-breath` | the mean breath at the given rate, shifted so that it fits the first seconds best |
//! | `virtual-bronchoscopy` | the one whose virtual view correlates best with the frame; so is its pose, where poses are measured |

use glam::{DAffine3, DVec3};

use crate::airway::waveform::Waveform;
use crate::base::{Image, Progress, Result, mesh};
use crate::reconstruct::contract::{
    Access, FramePrediction, NovelPrediction, Observation, PoseAccuracy, Reconstruct, Reconstruction,
};
use crate::reconstruct::estimate::contrast_match::{ContrastMatcher, at_phase_of, peak};
use crate::reconstruct::estimate::pose_match::PoseMatcher;
use crate::reconstruct::fitting::anchored::to_f32;
use crate::reconstruct::geometry::breathing::{BreathingMesh, mesh_at};
use crate::reconstruct::geometry::targets::CarriedTargets;
use crate::reconstruct::geometry::virtual_view::VirtualCamera;
use crate::reconstruct::geometry::visible::Reach;
use crate::reconstruct::online::{OnlineRun, held_out};
use crate::reconstruct::settings::{
    MeanBreathSettings, MethodHeader, PoseOnlySettings, VirtualBronchoscopySettings, Visibility,
};
use crate::splat::View;

/// Which row.
enum VirtualRow {
    PoseOnly(PoseOnlySettings),
    MeanBreath(MeanBreathSettings),
    VirtualBronchoscopy(VirtualBronchoscopySettings),
}

/// A method that shows the CT's surface at a phase that it finds without a map of its own.
pub struct VirtualMethod(VirtualRow);

impl VirtualMethod {
    /// `pose-only`.
    pub fn pose_only(settings: PoseOnlySettings) -> Self {
        VirtualMethod(VirtualRow::PoseOnly(settings))
    }

    /// `mean-breath`.
    pub fn mean_breath(settings: MeanBreathSettings) -> Self {
        VirtualMethod(VirtualRow::MeanBreath(settings))
    }

    /// `virtual-bronchoscopy`.
    pub fn virtual_bronchoscopy(settings: VirtualBronchoscopySettings) -> Self {
        VirtualMethod(VirtualRow::VirtualBronchoscopy(settings))
    }

    fn visibility(&self) -> &Visibility {
        match &self.0 {
            VirtualRow::PoseOnly(s) => &s.visibility,
            VirtualRow::MeanBreath(s) => &s.visibility,
            VirtualRow::VirtualBronchoscopy(s) => &s.visibility,
        }
    }
}

impl Reconstruct for VirtualMethod {
    fn header(&self) -> &MethodHeader {
        match &self.0 {
            VirtualRow::PoseOnly(s) => &s.header,
            VirtualRow::MeanBreath(s) => &s.header,
            VirtualRow::VirtualBronchoscopy(s) => &s.header,
        }
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
        let expiration = observation.expiration.as_ref().unwrap_or(&observation.inspiration);
        let rest = to_f32(&observation.inspiration.vertices);
        let displacement = mesh::displacement(&observation.inspiration, expiration);
        let airway = BreathingMesh { rest: &rest, displacement: &displacement, faces: &observation.inspiration.faces };
        let reach = Reach::new(self.visibility());
        let mut finder = self.finder(observation, reach);
        let screen = Screen {
            observation,
            airway,
            camera: VirtualCamera::new(observation.camera, reach),
            targets: CarriedTargets::new(&observation.targets_mm, &observation.inspiration),
        };
        let mut last = 0.0;
        let fit = |frame: usize| {
            let expected = finder.expected(frame);
            let found = finder.find(frame, airway);
            last = found.phase;
            Ok(screen.prediction(frame, found, expected))
        };
        let spent = run.fit_in_order(fit, emit, progress)?;
        Ok(Reconstruction { final_mesh: Some(mesh_at(observation, last)), spent })
    }
}

impl VirtualMethod {
    fn finder<'a>(&'a self, observation: &'a Observation, reach: Reach) -> Finder<'a> {
        match &self.0 {
            VirtualRow::PoseOnly(s) => Finder::Centred(CentredLumen::new(observation, *s.grid_steps)),
            VirtualRow::MeanBreath(s) => Finder::Clock(Clock::new(s, observation, reach)),
            VirtualRow::VirtualBronchoscopy(s) => {
                let matcher = ContrastMatcher::new(&s.matching, reach, observation);
                let measured = observation.poses_are_measured;
                let poses = measured.then(|| PoseMatcher::new(&s.pose, *s.visibility.range_mm, observation));
                Finder::Picture(PictureSearch { observation, matcher, poses, last: 0.0 })
            }
        }
    }
}

/// How the phase of a frame is found, and by a picture the pose where it is measured.
enum Finder<'a> {
    Centred(CentredLumen<'a>),
    Clock(Clock<'a>),
    Picture(PictureSearch<'a>),
}

impl Finder<'_> {
    /// What is taken to be so before the frame's picture is looked at.
    fn expected(&self, frame: usize) -> Found {
        match self {
            Finder::Centred(lumen) => Found::at(lumen.phase(frame)),
            Finder::Clock(clock) => Found::at(clock.expected(frame)),
            Finder::Picture(row) => {
                Found { phase: row.last, world_from_camera: row.poses.as_ref().map(|poses| poses.expected(frame)) }
            }
        }
    }

    fn find(&mut self, frame: usize, airway: BreathingMesh<'_>) -> Found {
        match self {
            Finder::Centred(lumen) => Found::at(lumen.phase(frame)),
            Finder::Clock(clock) => Found::at(clock.phase(frame, airway)),
            Finder::Picture(row) => row.find(frame, airway),
        }
    }
}

/// What is shown of a frame: the airway's phase, and the pose (world from camera) where it is not the given one.
#[derive(Clone, Copy)]
struct Found {
    phase: f64,
    world_from_camera: Option<DAffine3>,
}

impl Found {
    /// A phase, seen from the given pose.
    fn at(phase: f64) -> Self {
        Found { phase, world_from_camera: None }
    }
}

/// The search by pictures.
struct PictureSearch<'a> {
    observation: &'a Observation,
    matcher: ContrastMatcher<'a>,
    /// Where poses are measured: the pose is looked for, too.
    poses: Option<PoseMatcher<'a>>,
    /// Phase of the frame before.
    last: f64,
}

impl PictureSearch<'_> {
    fn find(&mut self, frame: usize, airway: BreathingMesh<'_>) -> Found {
        let matcher = &self.matcher;
        let phase_at = |pose: &DAffine3| peak(&matcher.correlations(frame, pose, airway));
        let found = match &mut self.poses {
            None => Found::at(phase_at(&self.observation.world_from_camera[frame])),
            Some(poses) => {
                let found = poses.find(frame, airway, phase_at);
                Found { phase: found.phase, world_from_camera: Some(found.world_from_camera) }
            }
        };
        self.last = found.phase;
        found
    }
}

/// The centreline at every phase.
struct CentredLumen<'a> {
    observation: &'a Observation,
    steps: u32,
    /// Displacement in mm of each point of the centreline from inspiration to expiration.
    motion: Vec<DVec3>,
}

impl<'a> CentredLumen<'a> {
    fn new(observation: &'a Observation, steps: u32) -> Self {
        let line = &observation.centerline_mm;
        let carried = CarriedTargets::on_axis(line, &observation.inspiration.vertices);
        let motion = carried.at_phase(observation, 1.0).iter().zip(line).map(|(moved, p)| *moved - *p).collect();
        CentredLumen { observation, steps: steps.max(2), motion }
    }

    /// The phase at which the camera is nearest to the centreline.
    fn phase(&self, frame: usize) -> f64 {
        let camera = self.observation.world_from_camera[frame].translation;
        let at = |step: u32| f64::from(step) / f64::from(self.steps - 1);
        let off = |phase: f64| {
            let points = self.observation.centerline_mm.iter().zip(&self.motion);
            points.map(|(p, d)| (*p + *d * phase).distance_squared(camera)).fold(f64::INFINITY, f64::min)
        };
        let offs: Vec<f64> = (0..self.steps).map(|step| -off(at(step))).collect();
        peak(&offs)
    }
}

/// The mean breath, and when it began.
struct Clock<'a> {
    observation: &'a Observation,
    matcher: ContrastMatcher<'a>,
    calibration_s: f64,
    offsets: u32,
    mean_breath: Waveform,
    /// Correlations of the frames so far, while the offset is looked for.
    seen: Vec<(f64, Vec<f64>)>,
    offset_s: f64,
}

impl<'a> Clock<'a> {
    fn new(settings: &'a MeanBreathSettings, observation: &'a Observation, reach: Reach) -> Self {
        let one = Waveform { start_hold_s: 0.0, ..Waveform::default() };
        let period_scale = observation.breathing_period_s / one.period_s();
        Clock {
            observation,
            matcher: ContrastMatcher::new(&settings.matching, reach, observation),
            calibration_s: *settings.calibration_s,
            offsets: (*settings.offsets).max(1),
            mean_breath: Waveform { period_scale, ..one },
            seen: Vec::new(),
            offset_s: 0.0,
        }
    }

    fn at(&self, time_s: f64, offset_s: f64) -> f64 {
        self.mean_breath.phase(time_s + offset_s, 0)
    }

    /// The phase that the offset so far says.
    fn expected(&self, frame: usize) -> f64 {
        self.at(self.observation.time_s[frame], self.offset_s)
    }

    fn phase(&mut self, frame: usize, airway: BreathingMesh<'_>) -> f64 {
        let time_s = self.observation.time_s[frame];
        if time_s <= self.calibration_s {
            self.seen
                .push((time_s, self.matcher.correlations(frame, &self.observation.world_from_camera[frame], airway)));
            let period_s = self.mean_breath.period_s();
            let offset = |k: u32| period_s * f64::from(k) / f64::from(self.offsets);
            let agreement = |offset_s: f64| -> f64 {
                self.seen.iter().map(|(time_s, values)| at_phase_of(values, self.at(*time_s, offset_s))).sum()
            };
            let sums: Vec<f64> = (0..self.offsets).map(|k| agreement(offset(k))).collect();
            let best = (0..sums.len()).fold(0, |best, k| if sums[k] > sums[best] { k } else { best });
            self.offset_s = offset(best as u32);
        }
        self.expected(frame)
    }
}

/// Shows the surface.
struct Screen<'a> {
    observation: &'a Observation,
    airway: BreathingMesh<'a>,
    camera: VirtualCamera,
    targets: CarriedTargets,
}

impl Screen<'_> {
    fn view(&self, pose: DAffine3, phase: f64) -> NovelPrediction {
        let aimed = self.camera.aim(&View::new(self.observation.camera, pose), self.airway);
        let seen = self.camera.render(&aimed, self.airway, phase);
        NovelPrediction { color: seen.color, depth_mm: seen.depth_mm }
    }

    fn prediction(&self, frame: usize, found: Found, expected: Found) -> FramePrediction {
        let given = self.observation.world_from_camera[frame];
        let pose_of = |found: Found| found.world_from_camera.unwrap_or(given);
        let ahead: Option<Image<f32>> = held_out(frame).then(|| self.view(pose_of(expected), expected.phase).color);
        let NovelPrediction { color, depth_mm } = self.view(pose_of(found), found.phase);
        // The second camera is given relative to the first.
        let second = |pose: DAffine3| found.world_from_camera.map_or(pose, |own| own * given.inverse() * pose);
        FramePrediction {
            frame,
            color,
            depth_mm,
            phase: Some(found.phase),
            phase_deviation: None,
            world_from_camera: found.world_from_camera,
            ahead,
            targets_mm: Some(self.targets.at_phase(self.observation, found.phase)),
            target_covariance_mm2: None,
            novel: self.observation.novel_pose[frame].map(|pose| self.view(second(pose), found.phase)),
        }
    }
}
