//! `ours-gn`: the geometry of `ours` (discs on the CT mesh, one phase per frame), tracked by Gauss-Newton instead of
//! Adam. Beyond the paper.
//!
//! Appearance. Pictures are flat-fielded and kept in a power law ([`light::Scope`]). The light sits at the tip of the
//! scope, so a disc at distance `d` seen under the cosine `c` shows
//! `albedo * (d0 / d)^p * ((c + k) / (1 + k))^(p / 2)`, `k` the share of light that comes from all sides. Approaching the
//! wall is thus no change of appearance, and the albedo needs no chasing ([`albedo`]). The discs must be small against
//! the vessels: a map that cannot show them lets them pull the phase along.
//!
//! Phase. At a quarter, half and full resolution: render with the derivative of the image by the phase, one robust
//! step ([`super::gauss_newton`], [`track`]), together with what is expected of the breath ([`breath`]). A frame whose cost
//! jumps is searched over all phases again. The standard deviation that comes with the answer has two parts: that of the last step, and a
//! random walk, since a frame is tracked on what earlier frames have painted, and inherits their errors: its variance
//! grows by `drift_factor^2` times that of each frame's step, and keeps `drift_memory` of itself from frame to frame,
//! since what was painted in the wrong place leaves the view or is painted over.
//!
//! Options: poses that are only roughly known ([`pose`]), and a correction of the registration of the two CTs
//! ([`super::correction`]), both estimated with the phase. Depth, and what is hidden, are those of the mesh ([`super::mesh_depth`]).
//!
//! Left out: learning of disc centres and sizes.

mod albedo;
mod breath;
mod light;
mod pose;
mod scene;
mod track;

use std::time::Instant;

use glam::Vec3;
use rayon::prelude::*;

use crate::base::{Image, Progress, Result, TriangleMesh, mesh};
use crate::splat::{DepthOutput, DiscFrame, Rasterizer, Rendered, Reuse, Settings, View};

use super::active::{Reach, Sides, nothing_in_view, visible_faces};
use super::anchored::{Start, Surface, to_f32};
use super::correction::Correction;
use super::level::Level;
use super::mesh_depth::{Rays, depth_gap_mm, nearest_depth_mm, unhidden};
use super::online::{fit_in_order, held_out};
use super::phase_fit::at_phase;
use super::phase_search::grid_search;
use super::pose_drift::{Drift, POSE, Walk};
use super::settings::GaussNewtonMethod;
use super::window::{Setting, Shape, Window};
use super::{Access, FramePrediction, Observation, Poses, Reconstruct, Reconstruction};
use breath::{Breath, Repetition};
use light::Scope;
use pose::Before;
use scene::{DISCS, Seen};
use track::{Tracked, moved};

/// Darkest albedo: a colour of zero has no gradient.
const DARKEST: f32 = 0.005;
/// Phases around the expected one for which the visible faces are chosen.
const REACH: f64 = 0.15;
/// Share of the image width around it in which a wall counts while the first pose is sought.
const BLIND_MARGIN: f64 = 1.5;
/// Share of the newest frame in the running mean of the cost.
const COST_SHARE: f64 = 0.2;

/// The method with its settings.
pub struct OursGn {
    settings: GaussNewtonMethod,
    iteration_scale: f64,
}

impl OursGn {
    /// With `settings`; `iteration_scale` multiplies the sweeps over the appearance.
    pub fn new(settings: GaussNewtonMethod, iteration_scale: f64) -> Self {
        OursGn { settings, iteration_scale }
    }
}

impl Reconstruct for OursGn {
    fn id(&self) -> &str {
        &self.settings.id
    }

    fn access(&self) -> Access {
        let poses = if *self.settings.unknown_pose { Poses::Rough } else { Poses::True };
        Access { expiration_mesh: true, first_depth: true, true_phase: false, poses }
    }

    fn run(
        &self,
        observation: &Observation,
        emit: &mut dyn FnMut(FramePrediction) -> Result<()>,
        progress: &dyn Progress,
    ) -> Result<Reconstruction> {
        observation.validate(self.access())?;
        let start = Instant::now();
        let mut tracker = Tracker::new(&self.settings, self.iteration_scale, observation);
        let preparation = start.elapsed().as_secs_f64();
        let fitting = fit_in_order(
            observation.images.len(),
            // From inside the pool: handing it work from outside costs more than much of this work does.
            |frame| rayon::scope(|_| tracker.fit(frame)),
            emit,
            progress,
        )?;
        Ok(Reconstruction { final_mesh: Some(tracker.mesh()), seconds: preparation + fitting })
    }
}

struct Tracker<'a> {
    settings: &'a GaussNewtonMethod,
    iteration_scale: f64,
    observation: &'a Observation,
    surface: Surface,
    rest: Vec<[f32; 3]>,
    given_displacement: Vec<[f32; 3]>,
    /// With what is known of its error.
    displacement: Vec<[f32; 3]>,
    correction: Correction,
    /// Centres of the correction in view that each frame estimates on the map.
    centres: Vec<usize>,
    /// Correction of the given poses.
    pose: [f64; POSE],
    /// How that drifts.
    walk: Walk,
    /// Per disc of the surface.
    albedo: Vec<[f32; 3]>,
    /// Weight of past frames, in pixels; 0 = never seen.
    memory: Vec<f32>,
    scope: Scope,
    rays: Rays,
    rasterizer: Rasterizer<f32>,
    seen: Option<Seen>,
    /// Faces of `seen`.
    faces: Vec<u32>,
    gain: [f64; 3],
    /// Variance of what all past frames may have painted in the wrong place.
    drift: f64,
    breath: Breath,
    cost: f64,
    mean_color: [f32; 3],
    window: Option<Window>,
}

impl<'a> Tracker<'a> {
    fn new(settings: &'a GaussNewtonMethod, iteration_scale: f64, observation: &'a Observation) -> Self {
        let inspiration = &observation.inspiration;
        let expiration = observation.expiration.as_ref().unwrap_or(inspiration);
        let surface =
            Surface::new(inspiration, &settings.discs, DiscFrame::InheritStretch, Start::Even, observation.seed);
        let discs = surface.faces.len() * surface.per_face;
        let repetition = if *settings.period_prior { Repetition::Expected } else { Repetition::Ignored };
        let rest = to_f32(&inspiration.vertices);
        let displacement = mesh::displacement(inspiration, expiration);
        let [rank, reach_mm, deviation_mm] =
            [*settings.correction_rank as f64, *settings.correction_reach_mm, *settings.correction_deviation_mm];
        let poses = &observation.world_from_camera;
        let drift = Drift::new(*settings.pose_drift, *settings.pose_steady_s, *settings.pose_caution);
        Tracker {
            correction: Correction::new(&rest, poses, rank as usize, reach_mm, deviation_mm),
            centres: Vec::new(),
            pose: [0.0; POSE],
            walk: Walk::new(drift),
            given_displacement: displacement.clone(),
            settings,
            iteration_scale,
            observation,
            surface,
            rest,
            displacement,
            albedo: vec![[0.5; 3]; discs],
            memory: vec![0.0; discs],
            scope: Scope::new(&observation.camera, &settings.scope),
            rays: Rays::new(&observation.camera),
            rasterizer: Rasterizer::new(),
            seen: None,
            faces: Vec::new(),
            gain: [1.0; 3],
            drift: 0.0,
            breath: Breath::new(*settings.velocity, repetition),
            cost: f64::INFINITY,
            mean_color: [0.5; 3],
            window: Window::new(&settings.window, settings.unknown_pose.then_some(drift)),
        }
    }

    fn fit(&mut self, frame: usize) -> Result<FramePrediction> {
        let given = View::new(self.observation.camera, self.observation.world_from_camera[frame]);
        if frame > 0 && *self.settings.unknown_pose {
            self.walk.wait(self.observation.time_s[frame] - self.observation.time_s[frame - 1]);
            self.pose = match &mut self.window {
                Some(window) => window.wait_until(self.observation.time_s[frame]),
                None => self.walk.expected(),
            };
        }
        let mut phase = if frame == 0 { self.search_by_depth(&given)? } else { self.breath.expected() };
        let mut deviation = *self.settings.prior_deviation;
        self.enter(&given, phase, REACH)?;
        let ahead = if held_out(frame) {
            self.place(phase, &given)?;
            self.draw(&moved(&given, self.pose))?;
            Some(self.shown())
        } else {
            None
        };
        // From here on the frame's image may be looked at.
        let mut levels = self.levels(frame, &given);
        if frame > 0
            && let Some(found) = self.find(&given, &levels, phase)?
        {
            phase = found.state.phase;
            deviation = self.take(&found);
        }
        if let Some(window) = &mut self.window {
            let level = levels.iter().rev().find(|level| Window::suits(level)).unwrap_or(&levels[0]);
            let shape = Shape { rest: &self.rest, displacement: &self.given_displacement, faces: &self.surface.faces };
            let time_s = self.observation.time_s[frame];
            let placed =
                window.place(level, time_s, Setting { shape, visible: &self.faces }, phase, &mut self.correction);
            self.pose = placed.pose;
            (phase, deviation) = (placed.phase, *self.settings.window_deviation_factor * placed.deviation);
            if self.correction.estimates() {
                self.displacement = self.corrected();
                let seen = self.seen.as_mut().expect("a frame is entered before it is worked on");
                seen.displacement = seen.patch.pick(&self.displacement);
            }
        }
        levels.iter_mut().for_each(|level| level.view = moved(&level.view, self.pose));
        self.place(phase, &given)?;
        let finest = levels.pop().expect("there is always the full resolution");
        self.learn(frame, &finest)?;
        self.touch_up(&finest)?;
        self.draw(&finest.view)?;
        let color = self.shown();
        self.rasterizer.reuse(Reuse::Never);
        self.leave();
        let depth_mm = self.depth_mm(&finest.view, phase);
        self.breath.add(phase);
        let world_from_camera = self.settings.unknown_pose.then(|| finest.view.camera_from_world.inverse());
        Ok(FramePrediction {
            frame,
            color,
            depth_mm,
            phase: Some(phase),
            phase_deviation: Some(deviation),
            world_from_camera,
            ahead,
        })
    }

    /// Tracks from the expected `phase`; where that is lost, from the best of all phases.
    fn find(&mut self, given: &View, levels: &[Level], phase: f64) -> Result<Option<Tracked>> {
        let found = self.track(levels, self.state_at(phase))?;
        if !self.is_lost(found.as_ref()) {
            return Ok(found);
        }
        self.leave();
        self.enter(given, 0.5, 1.0)?;
        let best = self.search_by_image(&levels[0])?;
        Ok(self.track(levels, self.state_at(best))?.or(found))
    }

    /// Takes over what a frame has found; the standard deviation of its phase, drift included.
    fn take(&mut self, found: &Tracked) -> f64 {
        let step = found.deviation;
        self.drift = *self.settings.drift_memory * self.drift + (*self.settings.drift_factor * step).powi(2);
        self.gain = found.evidence.gain;
        self.pose = found.state.pose;
        if let Some(covariance) = &found.pose_covariance {
            self.walk.learn(self.pose, covariance);
        }
        for ((&centre, c), deviations) in
            self.centres.iter().zip(&found.state.coefficients).zip(&found.coefficient_deviations)
        {
            self.correction.learn(centre, *c, *deviations);
        }
        if !self.centres.is_empty() {
            self.displacement = self.corrected();
            self.seen().correct(&found.state.coefficients);
        }
        let cost = found.evidence.cost;
        self.cost = if self.cost.is_finite() { self.cost + COST_SHARE * (cost - self.cost) } else { cost };
        (step * step + self.drift).sqrt()
    }

    /// The displacement field by all that is known.
    fn corrected(&self) -> Vec<[f32; 3]> {
        self.correction.corrected(&self.given_displacement, &self.correction.coefficients).into_owned()
    }

    /// The airway as the last frame has it.
    fn mesh(&self) -> TriangleMesh {
        let phase = self.breath.phases().last().copied().unwrap_or(0.0);
        let rest = &self.observation.inspiration;
        let moved = rest.vertices.iter().zip(&self.displacement);
        let vertices = moved.map(|(v, d)| *v + phase * Vec3::from(*d).as_dvec3()).collect();
        TriangleMesh { vertices, faces: rest.faces.clone() }
    }

    /// The last rendering as the film would show it.
    fn shown(&self) -> Image<f32> {
        let rendered = self.rasterizer.rendered();
        self.scope.shown(rendered.width, rendered.height, &rendered.color)
    }

    /// Coarse to fine; levels that would be too small are left out.
    fn levels(&self, frame: usize, view: &View) -> Vec<Level> {
        let full = self.scope.flat(&self.observation.images[frame]);
        let weights = self.observation.pixel_weights().unwrap_or_default();
        let mut levels = vec![Level { view: *view, image: full, weights }];
        while levels.len() < self.settings.steps.len() {
            let coarser = levels[0].halved();
            if coarser.image.width.min(coarser.image.height) < *self.settings.smallest_width as usize {
                break;
            }
            levels.insert(0, coarser);
        }
        levels
    }

    fn at(&self, phase: f64) -> Vec<[f32; 3]> {
        let mut out = Vec::new();
        at_phase(&self.rest, &self.displacement, phase as f32, &mut out);
        out
    }

    /// Makes the compact copy of what can be seen from the `given` pose, corrected, at phases within `reach` of `phase`.
    fn enter(&mut self, given: &View, phase: f64, reach: f64) -> Result<()> {
        let view = &moved(given, self.pose);
        let states = [(phase - reach).max(0.0), phase, (phase + reach).min(1.0)].map(|phase| self.at(phase));
        let bounds = Reach::new(&self.settings.visibility);
        let faces = &self.surface.faces;
        let mut seen = visible_faces(faces, &[&states[0], &states[1], &states[2]], view, bounds, Sides::Lumen);
        if reach <= REACH {
            seen = unhidden(view, &self.rays, &states[1], faces, &seen);
        }
        if seen.is_empty() {
            return Err(nothing_in_view());
        }
        let patch = self.surface.patch(&seen)?;
        let discs = patch.discs.par_iter().with_min_len(DISCS);
        let (memory, albedo) = discs.map(|&i| (self.memory[i as usize], self.albedo[i as usize])).unzip();
        let (rest, displacement) = (patch.pick(&self.rest), patch.pick(&self.displacement));
        self.faces = seen;
        // Where there is a window, it is the window that estimates the correction.
        self.centres = match &self.window {
            Some(_) => Vec::new(),
            None => self.correction.in_view(&view.camera_from_world.inverse()),
        };
        let modes = self.centres.iter().map(|&c| self.correction.pick(c, &patch.vertices)).collect();
        let coefficients: Vec<[f64; 3]> = self.centres.iter().map(|&c| self.correction.prior(c).0).collect();
        let mut seen = Seen::new(patch, rest, displacement, albedo, memory, *self.settings.discs.opacity as f32);
        seen.set_modes(modes, &coefficients);
        self.seen = Some(seen);
        Ok(())
    }

    /// Depth of the mesh at `phase`.
    fn depth_mm(&self, view: &View, phase: f64) -> Image<f32> {
        nearest_depth_mm(view, &self.rays, &self.at(phase), &self.surface.faces, &self.faces)
    }

    fn leave(&mut self) {
        if let Some(seen) = self.seen.take() {
            for (k, &i) in seen.patch.discs.iter().enumerate() {
                self.albedo[i as usize] = seen.albedo[k];
                self.memory[i as usize] = seen.memory[k];
            }
        }
    }

    fn seen(&mut self) -> &mut Seen {
        self.seen.as_mut().expect("a frame is entered before it is worked on")
    }

    /// Puts the discs where they are at `phase`, seen from the `given` pose, corrected.
    fn place(&mut self, phase: f64, given: &View) -> Result<()> {
        let light = self.light(&moved(given, self.pose));
        self.seen().place(phase, &light)
    }

    /// Renders the discs as they are.
    fn draw(&mut self, view: &View) -> Result<&Rendered<f32>> {
        let settings = Settings { gain: self.gain, depth: DepthOutput::Skip, ..Settings::default() };
        let seen = self.seen.as_ref().expect("a frame is entered before it is worked on");
        self.rasterizer.render(&seen.patch.gaussians, view, &settings, None)
    }

    /// Phase of the first frame, and where asked for its pose, by the depth that is given there.
    fn search_by_depth(&mut self, view: &View) -> Result<f64> {
        let observation = self.observation;
        let Some(depth) = &observation.first_depth_mm else { return Ok(0.0) };
        self.enter(view, 0.5, 1.0)?;
        let found = if *self.settings.unknown_pose {
            // A wrong pose must not hide what the true one sees.
            let states = [0.0, 0.5, 1.0].map(|phase| self.at(phase));
            let bounds = Reach { margin: BLIND_MARGIN, range_mm: *self.settings.visibility.range_mm };
            let states = states.each_ref().map(|s| s.as_slice());
            self.faces = visible_faces(&self.surface.faces, &states, view, bounds, Sides::Both);
            let [turn, shift_mm] = *self.settings.pose_deviation;
            let before = Before { phase: 1.0, turn, shift_mm };
            let (phase, pose) = pose::register(depth, &before, |phase, xi| self.depth_mm(&moved(view, xi), phase));
            self.pose = pose;
            self.walk.begin(pose);
            if let Some(window) = &mut self.window {
                window.begin(pose, observation.time_s[0]);
            }
            phase
        } else {
            grid_search(*self.settings.grid_steps, |phase| Ok(depth_gap_mm(&self.depth_mm(view, phase), depth)))?
        };
        self.leave();
        Ok(found)
    }
}
