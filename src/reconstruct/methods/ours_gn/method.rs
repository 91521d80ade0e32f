//! The method: its access to data, and one frame from the expected phase to the answer.

use glam::{DAffine3, DMat3, DVec3, Vec3};

use super::light::Scope;
use super::map::{ActiveFrame, DiscMap};
use super::registration::{self, Before};
use super::renderer::DiscRenderer;
use super::track::Tracked;
use crate::base::{Error, Image, Progress, Result, TriangleMesh, mesh};
use crate::reconstruct::contract::{
    Access, ArrivedFrame, FollowFrames, FramePrediction, LiveAnswer, NovelPrediction, Observation, PoseAccuracy,
    Reconstruct, Reconstruction, TrackState,
};
use crate::reconstruct::estimate::breath::{BreathPredictor, Repetition};
use crate::reconstruct::estimate::surface_phase::surface_phase;
use crate::reconstruct::estimate::window::correction::Correction;
use crate::reconstruct::estimate::window::drift::PoseDrift;
use crate::reconstruct::estimate::window::{KeyframeWindow, PhaseMeasurement, WindowOptions};
use crate::reconstruct::fitting::anchored::to_f32;
use crate::reconstruct::fitting::grid_search::grid_search;
use crate::reconstruct::geometry::breathing::BreathingMesh;
use crate::reconstruct::geometry::lit_wall::WallInReach;
use crate::reconstruct::geometry::mesh_depth::{PixelRays, depth_gap_mm, nearest_depth_mm, surface_depth_mm, unhidden};
use crate::reconstruct::geometry::pyramid::PyramidLevel;
use crate::reconstruct::geometry::rigid::{POSE, moved};
use crate::reconstruct::geometry::targets::CarriedTargets;
use crate::reconstruct::geometry::visible::{Reach, Sides, nothing_in_view, visible_faces};
use crate::reconstruct::online::{OnlineRun, held_out};
use crate::reconstruct::settings::{MethodHeader, OursGnSettings};
use crate::splat::{Reuse, View};

/// Visible faces are chosen for phases up to this far from the expected one.
const REACH: f64 = 0.15;
/// Margin around the image, as a share of its width, in which walls are kept while the first pose is searched for.
const BLIND_MARGIN: f64 = 1.5;
/// Weight of the newest frame in the running mean of the cost.
const COST_SHARE: f64 = 0.2;
/// Standard deviation of the phase from which on a live answer counts as unsure: a target that breathes by 15 mm is then
/// known to 1.5 mm.
const UNSURE_DEVIATION: f64 = 0.1;

/// Share of what keyframes and surface are still apart by, once the one is drawn to the other, that counts as a deviation.
const DISAGREEMENT: f64 = 0.5;

/// The method with its settings.
pub struct OursGn {
    settings: OursGnSettings,
    iteration_scale: f64,
}

impl OursGn {
    /// With `settings`; `iteration_scale` multiplies the sweeps over the appearance.
    pub fn new(settings: OursGnSettings, iteration_scale: f64) -> Self {
        OursGn { settings, iteration_scale }
    }
}

impl Reconstruct for OursGn {
    fn header(&self) -> &MethodHeader {
        &self.settings.header
    }

    fn access(&self) -> Access {
        let poses = if *self.settings.unknown_pose { PoseAccuracy::Rough } else { PoseAccuracy::True };
        Access { expiration_mesh: true, first_depth: true, true_phase: false, poses }
    }

    fn run(
        &self,
        observation: &Observation,
        emit: &mut dyn FnMut(FramePrediction) -> Result<()>,
        progress: &dyn Progress,
    ) -> Result<Reconstruction> {
        let run = OnlineRun::begin(self.access(), observation)?;
        let mut tracker = Tracker::new(&self.settings, self.iteration_scale, observation)?;
        let fit = |frame| {
            let arrived = FrameInput {
                frame,
                image: &observation.images[frame],
                time_s: observation.time_s[frame],
                world_from_camera: observation.world_from_camera[frame],
                novel_pose: observation.novel_pose[frame],
            };
            tracker.fit(&arrived)
        };
        let spent = run.fit_in_order(fit, emit, progress)?;
        Ok(Reconstruction { final_mesh: Some(tracker.mesh()), spent })
    }

    fn live(&self) -> Option<&dyn FollowFrames> {
        Some(self)
    }
}

impl FollowFrames for OursGn {
    fn follow(
        &self,
        known: &Observation,
        next: &mut dyn FnMut() -> Result<Option<ArrivedFrame>>,
        answer: &mut dyn FnMut(LiveAnswer) -> Result<()>,
    ) -> Result<()> {
        known.validate(self.access())?;
        if *self.settings.correction_rank > 0 {
            let reason = "a correction of the registration lies along the way of the scope, which a live tracker learns too late";
            return Err(Error::input(format!("must be 0: {reason}")).element("correction_rank"));
        }
        let mut tracker = Tracker::new(&self.settings, self.iteration_scale, known)?;
        let mut frame = 0;
        while let Some(arrived) = next()? {
            let input = FrameInput {
                frame,
                image: &arrived.image,
                time_s: arrived.time_s,
                world_from_camera: arrived.world_from_camera,
                novel_pose: None,
            };
            (0..arrived.left_out).for_each(|_| tracker.pass_over());
            // Inside the thread pool, as `OnlineRun` has it.
            answer(rayon::scope(|_| tracker.follow(&input))?)?;
            frame += 1;
        }
        Ok(())
    }
}

/// What the tracker gets of one frame.
struct FrameInput<'f> {
    /// How many came before.
    frame: usize,
    image: &'f Image<u8>,
    time_s: f64,
    world_from_camera: DAffine3,
    novel_pose: Option<DAffine3>,
}

/// A frame that is placed, with the colours that it taught.
struct PlacedFrame {
    active: ActiveFrame,
    /// The full resolution, from the corrected pose.
    finest: PyramidLevel,
    phase: f64,
    phase_deviation: Option<f64>,
    /// The picture agrees with no phase.
    lost: bool,
    ahead: Option<Image<f32>>,
}

struct Tracker<'a> {
    settings: &'a OursGnSettings,
    observation: &'a Observation,
    map: DiscMap,
    rest: Vec<[f32; 3]>,
    given_displacement: Vec<[f32; 3]>,
    /// The given displacement with its current correction.
    displacement: Vec<[f32; 3]>,
    /// Correction of the given poses.
    pose: [f64; POSE],
    scope: Scope,
    rays: PixelRays,
    renderer: DiscRenderer<'a>,
    breath: BreathPredictor,
    /// Running mean of the cost of the frames so far.
    mean_cost: f64,
    window: Option<KeyframeWindow>,
    wall: WallInReach,
    /// By how much the surface's phase was off when last compared, from the one that it had drawn the keyframes' to.
    apart: f64,
    targets: CarriedTargets,
}

/// The unknowns of the window besides the phases.
fn window_options(settings: &OursGnSettings, rest: &[[f32; 3]], observation: &Observation) -> WindowOptions {
    let drift = PoseDrift::new(*settings.pose_drift, *settings.pose_steady_s, *settings.pose_caution);
    let [reach_mm, deviation_mm] = [*settings.correction_reach_mm, *settings.correction_deviation_mm];
    let (poses, rank) = (&observation.world_from_camera, *settings.correction_rank as usize);
    WindowOptions {
        drift: settings.unknown_pose.then_some(drift),
        correction: Correction::new(rest, poses, rank, reach_mm, deviation_mm),
    }
}

impl<'a> Tracker<'a> {
    fn new(settings: &'a OursGnSettings, iteration_scale: f64, observation: &'a Observation) -> Result<Self> {
        let inspiration = &observation.inspiration;
        let expiration = observation.expiration.as_ref().unwrap_or(inspiration);
        let repetition = if *settings.period_prior { Repetition::Expected } else { Repetition::Ignored };
        let rest = to_f32(&inspiration.vertices);
        let displacement = mesh::displacement(inspiration, expiration);
        let window = KeyframeWindow::new(&settings.window, window_options(settings, &rest, observation));
        if window.is_none() && (*settings.unknown_pose || *settings.correction_rank > 0) {
            let reason = "unknown poses and a correction of the registration are estimated by the window of keyframes";
            return Err(Error::input(format!("must not be 0: {reason}")).element("window.keyframes"));
        }
        let scope = Scope::new(&observation.camera, &settings.scope);
        let clipped_from = scope.clipped_from(&observation.camera, settings.steps.len() - 1);
        Ok(Tracker {
            settings,
            observation,
            map: DiscMap::new(&settings.discs, observation),
            rest,
            given_displacement: displacement.clone(),
            displacement,
            pose: [0.0; POSE],
            scope,
            rays: PixelRays::new(&observation.camera),
            renderer: DiscRenderer::new(settings, iteration_scale, clipped_from),
            breath: BreathPredictor::new(*settings.velocity, repetition),
            mean_cost: f64::INFINITY,
            window,
            wall: WallInReach::default(),
            apart: 0.0,
            targets: CarriedTargets::new(&observation.targets_mm, inspiration),
        })
    }

    /// Places a frame and draws it.
    fn fit(&mut self, input: &FrameInput<'_>) -> Result<FramePrediction> {
        let PlacedFrame { mut active, finest, phase, phase_deviation, ahead, .. } =
            self.place(input, held_out(input.frame))?;
        self.renderer.touch_up(&mut active, &finest)?;
        self.renderer.draw(&active, &finest.view)?;
        let color = self.shown();
        self.renderer.rasterizer.reuse(Reuse::Never);
        let depth_mm = self.surface_depth_mm(&finest.view, phase);
        self.map.leave(active);
        self.breath.add(phase);
        let world_from_camera = self.settings.unknown_pose.then(|| finest.view.camera_from_world.inverse());
        let targets_mm = Some(self.targets_at(phase));
        // The second camera is given relative to the first.
        let second =
            |pose: DAffine3| world_from_camera.map_or(pose, |own| own * input.world_from_camera.inverse() * pose);
        let (novel, phase) = (self.novel(input.novel_pose.map(second), phase)?, Some(phase));
        Ok(FramePrediction {
            frame: input.frame,
            color,
            depth_mm,
            phase,
            phase_deviation,
            world_from_camera,
            ahead,
            targets_mm,
            target_covariance_mm2: None,
            novel,
        })
    }

    /// Places a frame, and draws nothing.
    fn follow(&mut self, input: &FrameInput<'_>) -> Result<LiveAnswer> {
        let PlacedFrame { active, finest, phase, phase_deviation, lost, .. } = self.place(input, false)?;
        self.renderer.rasterizer.reuse(Reuse::Never);
        self.map.leave(active);
        self.breath.add(phase);
        let camera_from_world = finest.view.camera_from_world;
        let motions = self.targets_at(1.0).into_iter().zip(self.targets_at(0.0));
        let motions = motions.map(|(out, rest)| camera_from_world.transform_vector3(out - rest));
        let variance = phase_deviation.unwrap_or(1.0).powi(2);
        let covariance = |way: DVec3| DMat3::from_cols(way * way.x, way * way.y, way * way.z) * variance;
        let state = match phase_deviation {
            _ if lost => TrackState::Lost,
            Some(deviation) if deviation < UNSURE_DEVIATION => TrackState::Tracking,
            _ => TrackState::Unsure,
        };
        Ok(LiveAnswer {
            state,
            phase,
            phase_deviation,
            world_from_camera: camera_from_world.inverse(),
            targets_mm: self.targets_at(phase),
            target_covariance_mm2: motions.map(covariance).collect(),
            masked_share: None,
            mask: None,
        })
    }

    /// A frame that is not seen: the breath goes on as expected.
    fn pass_over(&mut self) {
        self.breath.add(self.breath.expected());
    }

    /// Where the targets are at `phase`, by the corrected displacement.
    fn targets_at(&self, phase: f64) -> Vec<DVec3> {
        self.targets.moved(|v| phase * Vec3::from(self.displacement[v as usize]).as_dvec3())
    }

    /// Places a frame and learns its colours. `ahead`: draws it before its image is used.
    fn place(&mut self, input: &FrameInput<'_>, ahead: bool) -> Result<PlacedFrame> {
        let frame = input.frame;
        let given = View::new(self.observation.camera, input.world_from_camera);
        let time_s = input.time_s;
        if frame > 0
            && let Some(window) = &mut self.window
        {
            self.pose = window.advance_to(time_s);
        }
        let mut phase = if frame == 0 { self.search_by_depth(&given, time_s)? } else { self.breath.expected() };
        let mut active = self.enter(&moved(&given, self.pose), phase, REACH)?;
        if frame == 0 && active.faces.is_empty() {
            return Err(nothing_in_view());
        }
        let ahead = if ahead {
            let view = moved(&given, self.pose);
            active.place(phase, &self.renderer.light(&view))?;
            self.renderer.draw(&active, &view)?;
            Some(self.shown())
        } else {
            None
        };

        // From here on the frame's image may be used. First, the phase by the map:
        let mut levels = self.levels(input.image, &given);
        let mut lost = false;
        if frame > 0 {
            let tracked;
            (active, tracked, lost) = self.track(active, &given, &levels, phase)?;
            if let Some(tracked) = tracked {
                phase = tracked.phase;
                self.take(&tracked);
            }
        }

        // Starting there: phase, pose and correction of the registration by the keyframe window, and by the CT's surface,
        // which does not drift as map and keyframes do.
        let mut phase_deviation = None;
        if let Some(window) = &mut self.window {
            let level = levels.iter().rev().find(|level| KeyframeWindow::suits(level)).unwrap_or(&levels[0]);
            let mesh =
                BreathingMesh { rest: &self.rest, displacement: &self.given_displacement, faces: self.map.faces() };
            let mut measured = None;
            let by_surface = |expected: f64| {
                let settings = &self.settings.surface;
                if *settings.flow == 0.0 {
                    return None;
                }
                let small = |level: &PyramidLevel| level.is_within(*settings.largest_width);
                let halved;
                let level = match levels.iter().rev().find(|level| small(level)) {
                    Some(level) => level,
                    None => {
                        halved = levels[0].halved().halved_until(small);
                        &halved
                    }
                };
                let view = moved(&level.view, self.pose);
                let mesh = BreathingMesh { displacement: &self.displacement, ..mesh };
                let place = view.camera_from_world.inverse().translation;
                let range_mm = *self.settings.visibility.range_mm;
                let wall = self.wall.around(mesh, place, range_mm, 0.25 * range_mm);
                measured = surface_phase(settings, level, &view, wall, expected);
                measured.map(|found| PhaseMeasurement { phase: found.phase, pull: found.weight / *settings.flow })
            };
            let placement = window.place(level, mesh, &active.faces, phase, by_surface);
            (phase, self.pose) = (placement.phase, placement.pose);
            self.apart = measured.map_or(self.apart, |surface| surface.phase - phase);
            let by_window = *self.settings.window_deviation_factor * placement.deviation;
            let floor = *self.settings.window_deviation_floor;
            let apart = DISAGREEMENT * self.apart;
            phase_deviation = Some((by_window * by_window + apart * apart + floor * floor).sqrt());
            if let Some(corrected) = window.corrected(&self.given_displacement) {
                active.bend(&corrected);
                self.displacement = corrected;
                self.wall.forget();
            }
        }

        // Appearance at the final phase and pose.
        let mut finest = levels.pop().expect("there is always the full resolution");
        finest.view = moved(&finest.view, self.pose);
        active.place(phase, &self.renderer.light(&finest.view))?;
        self.renderer.learn(&mut active, frame, &finest)?;
        Ok(PlacedFrame { active, finest, phase, phase_deviation, lost, ahead })
    }

    /// The view of the frame's second camera, at its own place, at `phase`, with the map as it is now.
    fn novel(&mut self, pose: Option<DAffine3>, phase: f64) -> Result<Option<NovelPrediction>> {
        let Some(pose) = pose else { return Ok(None) };
        let view = View::new(self.observation.camera, pose);
        let mut active = self.enter(&view, phase, 0.0)?;
        active.place(phase, &self.renderer.light(&view))?;
        active.color_the_unseen_as_beside();
        self.renderer.draw(&active, &view)?;
        let color = self.shown();
        Ok(Some(NovelPrediction { color, depth_mm: self.surface_depth_mm(&view, phase) }))
    }

    /// Tracks from the expected `phase`; if tracking is lost, from the best of all phases. The last: whether it is lost
    /// even then.
    fn track(
        &mut self,
        mut active: ActiveFrame,
        given: &View,
        levels: &[PyramidLevel],
        phase: f64,
    ) -> Result<(ActiveFrame, Option<Tracked>, bool)> {
        let found = self.renderer.track(&mut active, levels, self.pose, phase, phase)?;
        if !self.is_lost(found.as_ref()) {
            return Ok((active, found, false));
        }
        self.map.leave(active);
        let mut active = self.enter(&moved(given, self.pose), 0.5, 1.0)?;
        let best = self.renderer.search_by_image(&mut active, &levels[0], self.pose)?;
        let again = self.renderer.track(&mut active, levels, self.pose, best, phase)?;
        let lost = self.is_lost(again.as_ref());
        Ok((active, again.or(found), lost))
    }

    /// Whether tracking is lost: no answer, or a cost far above the running mean.
    fn is_lost(&self, found: Option<&Tracked>) -> bool {
        let largest = *self.settings.lost_factor * self.mean_cost;
        found.is_none_or(|f| self.mean_cost.is_finite() && f.evidence.cost > largest)
    }

    /// Takes over the exposure of a tracked frame and adds its cost to the running mean.
    fn take(&mut self, found: &Tracked) {
        self.renderer.gain = found.evidence.gain;
        let cost = found.evidence.cost;
        let mean = self.mean_cost;
        self.mean_cost = if mean.is_finite() { mean + COST_SHARE * (cost - mean) } else { cost };
    }

    /// The airway at the last frame.
    fn mesh(&self) -> TriangleMesh {
        let phase = self.breath.phases().last().copied().unwrap_or(0.0);
        let rest = &self.observation.inspiration;
        let moved = rest.vertices.iter().zip(&self.displacement);
        let vertices = moved.map(|(v, d)| *v + phase * Vec3::from(*d).as_dvec3()).collect();
        TriangleMesh { vertices, faces: rest.faces.clone() }
    }

    fn breathing(&self) -> BreathingMesh<'_> {
        BreathingMesh { rest: &self.rest, displacement: &self.displacement, faces: self.map.faces() }
    }

    /// The last rendering as the film would show it.
    fn shown(&self) -> Image<f32> {
        let rendered = self.renderer.rasterizer.rendered();
        self.scope.shown(rendered.width, rendered.height, &rendered.color)
    }

    /// The image pyramid, coarse to fine; levels that would be too small are left out.
    fn levels(&self, image: &Image<u8>, view: &View) -> Vec<PyramidLevel> {
        let full = self.scope.flat(image);
        let weights = self.observation.pixel_weights().unwrap_or_default();
        let mut levels = vec![PyramidLevel { view: *view, image: full, weights }];
        while levels.len() < self.settings.steps.len() {
            let coarser = levels[0].halved();
            if coarser.image.width.min(coarser.image.height) < *self.settings.smallest_width as usize {
                break;
            }
            levels.insert(0, coarser);
        }
        levels
    }

    /// Starts a frame: the compact copy of what is visible from `view` at phases within `reach` of `phase`.
    fn enter(&self, view: &View, phase: f64, reach: f64) -> Result<ActiveFrame> {
        self.map.enter(self.faces_in_view(view, phase, reach), self.breathing())
    }

    fn faces_in_view(&self, view: &View, phase: f64, reach: f64) -> Vec<u32> {
        let states =
            [(phase - reach).max(0.0), phase, (phase + reach).min(1.0)].map(|phase| self.breathing().at(phase));
        let bounds = Reach::new(&self.settings.visibility);
        let mut faces = visible_faces(self.map.faces(), &states.each_ref().map(|s| &s[..]), view, bounds, Sides::Lumen);
        if reach <= REACH {
            faces = unhidden(view, &self.rays, &states[1], self.map.faces(), &faces);
        }
        faces
    }

    /// Depth of the mesh at `phase`, considering only `faces`.
    fn depth_mm(&self, view: &View, phase: f64, faces: &[u32]) -> Image<f32> {
        nearest_depth_mm(view, &self.rays, &self.breathing().at(phase), self.map.faces(), faces)
    }

    /// Depth of the mesh at `phase`, with the faces beside the camera, which hold no disc that is drawn.
    fn surface_depth_mm(&self, view: &View, phase: f64) -> Image<f32> {
        let (vertices, range_mm) = (self.breathing().at(phase), *self.settings.visibility.range_mm);
        surface_depth_mm(view, &self.rays, &vertices, self.map.faces(), range_mm)
    }

    /// Phase of the first frame and, if poses are unknown, its pose correction, by the depth given there.
    fn search_by_depth(&mut self, view: &View, time_s: f64) -> Result<f64> {
        let observation = self.observation;
        let Some(depth) = &observation.first_depth_mm else { return Ok(0.0) };
        let faces = self.faces_in_view(&moved(view, self.pose), 0.5, 1.0);
        if !*self.settings.unknown_pose {
            let gap = |phase| Ok(depth_gap_mm(&self.depth_mm(view, phase, &faces), depth));
            return grid_search(*self.settings.grid_steps, gap);
        }
        // A wrong pose must not hide faces that are visible from the true one.
        let states = [0.0, 0.5, 1.0].map(|phase| self.breathing().at(phase));
        let bounds = Reach { margin: BLIND_MARGIN, range_mm: *self.settings.visibility.range_mm };
        let faces = visible_faces(self.map.faces(), &states.each_ref().map(|s| &s[..]), view, bounds, Sides::Both);
        let [turn, shift_mm] = *self.settings.pose_deviation;
        let before = Before { phase: 1.0, turn, shift_mm };
        let render = |phase, xi| self.depth_mm(&moved(view, xi), phase, &faces);
        let (phase, pose) = registration::register(depth, &before, render);
        self.pose = pose;
        if let Some(window) = &mut self.window {
            window.begin(pose, time_s);
        }
        Ok(phase)
    }
}
