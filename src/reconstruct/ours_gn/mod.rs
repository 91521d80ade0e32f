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
//! step ([`super::gauss_newton`]), together with a prior of constant velocity. A frame whose cost jumps is searched over
//! all phases again. The standard deviation that comes with the answer has two parts: that of the last step, and a
//! random walk, since a frame is tracked on what earlier frames have painted, and inherits their errors: its variance
//! grows by `drift_factor^2` times that of each frame's step, and keeps `drift_memory` of itself from frame to frame,
//! since what was painted in the wrong place leaves the view or is painted over.
//!
//! Left out: correction of registration errors, unknown poses, learning of disc centres and sizes.

mod albedo;
mod light;
mod scene;

use std::time::Instant;

use nalgebra::DVector;

use crate::base::{Image, Progress, Result, mesh};
use crate::splat::{DepthOutput, Direction, Frame, Motion, Rasterizer, Rendered, Settings, View};

use super::active::{Reach, Sides, nothing_in_view, visible_faces};
use super::anchored::{Start, Surface, to_f32};
use super::gauss_newton::{self, Comparison, Evidence, Prior, Robust};
use super::online::{fit_in_order, held_out};
use super::phase_fit::{at_phase, mesh_at};
use super::phase_search::{depth_error_mm, grid_search};
use super::settings::GaussNewtonMethod;
use super::{Access, FramePrediction, Observation, Reconstruct, Reconstruction};
use light::{Light, Scope};
use scene::{Seen, Velocity};

/// Darkest albedo: a colour of zero has no gradient.
const DARKEST: f32 = 0.005;
/// Phases around the expected one for which the visible faces are chosen.
const REACH: f64 = 0.15;
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
        Access { expiration_mesh: true, first_depth: true, true_phase: false }
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
        let fitting = fit_in_order(observation.images.len(), |frame| tracker.fit(frame), emit, progress)?;
        let last = tracker.phases.last().copied().unwrap_or(0.0);
        Ok(Reconstruction { final_mesh: Some(mesh_at(observation, last)), seconds: preparation + fitting })
    }
}

/// One resolution of a frame.
struct Level {
    view: View,
    image: Image<f32>,
    steps: u32,
}

struct Tracker<'a> {
    settings: &'a GaussNewtonMethod,
    iteration_scale: f64,
    observation: &'a Observation,
    surface: Surface,
    rest: Vec<[f32; 3]>,
    displacement: Vec<[f32; 3]>,
    /// Per disc of the surface.
    albedo: Vec<[f32; 3]>,
    /// Weight of past frames, in pixels; 0 = never seen.
    memory: Vec<f32>,
    scope: Scope,
    rasterizer: Rasterizer<f32>,
    seen: Option<Seen>,
    gain: [f64; 3],
    /// Variance of what all past frames may have painted in the wrong place.
    drift: f64,
    phases: Vec<f64>,
    cost: f64,
    mean_color: [f32; 3],
}

impl<'a> Tracker<'a> {
    fn new(settings: &'a GaussNewtonMethod, iteration_scale: f64, observation: &'a Observation) -> Self {
        let inspiration = &observation.inspiration;
        let expiration = observation.expiration.as_ref().unwrap_or(inspiration);
        let surface = Surface::new(inspiration, &settings.discs, Frame::InheritStretch, Start::Even, observation.seed);
        let discs = surface.faces.len() * surface.per_face;
        Tracker {
            settings,
            iteration_scale,
            observation,
            surface,
            rest: to_f32(&inspiration.vertices),
            displacement: mesh::displacement(inspiration, expiration),
            albedo: vec![[0.5; 3]; discs],
            memory: vec![0.0; discs],
            scope: Scope::new(&observation.camera, &settings.scope),
            rasterizer: Rasterizer::new(),
            seen: None,
            gain: [1.0; 3],
            drift: 0.0,
            phases: Vec::new(),
            cost: f64::INFINITY,
            mean_color: [0.5; 3],
        }
    }

    fn light(&self, view: &View) -> Light {
        Light {
            eye: view.camera_from_world.inverse().translation.as_vec3(),
            exponent: *self.settings.falloff_exponent as f32,
            indirect: *self.settings.indirect_share as f32,
        }
    }

    fn robust(&self, width: usize) -> Robust {
        Robust {
            huber: *self.settings.huber,
            block_px: ((width as f64 * *self.settings.block_share).round() as usize).max(2),
            gain_limit: *self.settings.exposure_limit,
            last_gain: self.gain,
        }
    }

    fn expected(&self) -> f64 {
        match *self.phases.as_slice() {
            [] => 0.5,
            [only] => only,
            [.., before, last] => (last + *self.settings.velocity * (last - before)).clamp(0.0, 1.0),
        }
    }

    fn fit(&mut self, frame: usize) -> Result<FramePrediction> {
        let view = View::new(self.observation.camera, self.observation.world_from_camera[frame]);
        let light = self.light(&view);
        let mut phase = self.expected();
        let reach = if frame == 0 { [0.0, 1.0] } else { [(phase - REACH).max(0.0), (phase + REACH).min(1.0)] };
        self.enter(&view, reach)?;
        let mut deviation = *self.settings.prior_deviation;
        if frame == 0 {
            phase = self.search_by_depth(&view, &light)?;
        }
        let ahead = if held_out(frame) {
            self.render(phase, &view, &light, DepthOutput::Skip)?;
            Some(self.shown())
        } else {
            None
        };
        // From here on the frame's image may be looked at.
        let levels = self.levels(frame, &view);
        let finest = levels.last().expect("there is always the full resolution");
        if frame > 0 {
            let mut found = self.track(&levels, &light, phase)?;
            if self.is_lost(found.as_ref()) {
                self.leave();
                self.enter(&view, [0.0, 1.0])?;
                let best = self.search_by_image(&levels[0], &light)?;
                found = self.track(&levels, &light, best)?.or(found);
            }
            if let Some(Tracked { phase: at, deviation: sd, evidence }) = found {
                self.drift = *self.settings.drift_memory * self.drift + (*self.settings.drift_factor * sd).powi(2);
                (phase, deviation, self.gain) = (at, (sd * sd + self.drift).sqrt(), evidence.gain);
                let share = if self.cost.is_finite() { COST_SHARE } else { 1.0 };
                self.cost =
                    (if self.cost.is_finite() { self.cost } else { 0.0 }) * (1.0 - share) + evidence.cost * share;
            }
        }
        self.place(phase, &light)?;
        self.learn(frame, finest)?;
        self.render(phase, &view, &light, DepthOutput::Surface)?;
        let color = self.shown();
        let depth_mm = super::depth_image(self.rasterizer.rendered(), color.width, color.height);
        self.leave();
        self.phases.push(phase);
        Ok(FramePrediction { frame, color, depth_mm, phase: Some(phase), phase_deviation: Some(deviation), ahead })
    }

    /// The last rendering as the film would show it.
    fn shown(&self) -> Image<f32> {
        let rendered = self.rasterizer.rendered();
        self.scope.shown(rendered.width, rendered.height, &rendered.color)
    }

    /// Coarse to fine; levels that would be too small are left out.
    fn levels(&self, frame: usize, view: &View) -> Vec<Level> {
        let full = self.scope.flat(&self.observation.images[frame]);
        let mut levels = vec![Level { view: *view, image: full, steps: self.settings.steps[2] }];
        for steps in [self.settings.steps[1], self.settings.steps[0]] {
            let finer = &levels[0];
            let image = finer.image.halved();
            if image.width.min(image.height) < *self.settings.smallest_width as usize {
                break;
            }
            let mut camera = finer.view.camera.scaled(0.5);
            (camera.width, camera.height) = (image.width as u32, image.height as u32);
            let view = View { camera, ..finer.view };
            levels.insert(0, Level { view, image, steps });
        }
        levels
    }

    fn enter(&mut self, view: &View, [low, high]: [f64; 2]) -> Result<()> {
        let states = [low, 0.5 * (low + high), high].map(|phase| {
            let mut out = Vec::new();
            at_phase(&self.rest, &self.displacement, phase as f32, &mut out);
            out
        });
        let states: Vec<&[[f32; 3]]> = states.iter().map(|s| &s[..]).collect();
        let reach = Reach::new(&self.settings.visibility);
        let faces = visible_faces(&self.surface.faces, &states, view, reach, Sides::Lumen);
        if faces.is_empty() {
            return Err(nothing_in_view());
        }
        let patch = self.surface.patch(&faces)?;
        self.seen = Some(Seen {
            rest: patch.pick(&self.rest),
            displacement: patch.pick(&self.displacement),
            vertices: Vec::new(),
            albedo: patch.discs.iter().map(|&i| self.albedo[i as usize]).collect(),
            memory: patch.discs.iter().map(|&i| self.memory[i as usize]).collect(),
            shade: Vec::new(),
            velocity: Default::default(),
            patch,
        });
        Ok(())
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

    fn place(&mut self, phase: f64, light: &Light) -> Result<()> {
        self.seen().place(phase, light)
    }

    fn render(&mut self, phase: f64, view: &View, light: &Light, depth: DepthOutput) -> Result<&Rendered<f32>> {
        self.place(phase, light)?;
        let settings = Settings { gain: self.gain, depth, ..Settings::default() };
        let seen = self.seen.as_ref().expect("a frame is entered before it is worked on");
        self.rasterizer.render(&seen.patch.gaussians, view, &settings, None)
    }

    fn search_by_depth(&mut self, view: &View, light: &Light) -> Result<f64> {
        let observation = self.observation;
        let Some(given) = &observation.first_depth_mm else { return Ok(0.0) };
        grid_search(*self.settings.grid_steps, |phase| {
            Ok(depth_error_mm(self.render(phase, view, light, DepthOutput::Surface)?, given))
        })
    }

    fn search_by_image(&mut self, level: &Level, light: &Light) -> Result<f64> {
        grid_search(*self.settings.grid_steps, |phase| {
            Ok(self.look(level, light, phase)?.map_or(f64::INFINITY, |found| found.cost))
        })
    }

    fn is_lost(&self, found: Option<&Tracked>) -> bool {
        found.is_none_or(|f| self.cost.is_finite() && f.evidence.cost > *self.settings.lost_factor * self.cost)
    }

    /// What `level` says about the phase at `phase`.
    fn look(&mut self, level: &Level, light: &Light, phase: f64) -> Result<Option<Evidence>> {
        let robust = self.robust(level.image.width);
        let seen = self.seen.as_mut().expect("a frame is entered before it is worked on");
        seen.place(phase, light)?;
        seen.motion(light)?;
        let Velocity { positions, axes, colors } = &seen.velocity;
        let breathing = Motion { positions, axes, colors, ..Motion::default() };
        let settings = Settings { depth: DepthOutput::Skip, ..Settings::default() };
        let directions = [Direction::Motion(breathing)];
        let gaussians = &seen.patch.gaussians;
        let tangents = self.rasterizer.render_tangent(gaussians, &level.view, &settings, None, &directions)?.to_vec();
        let rendered = &self.rasterizer.rendered().color;
        let seen = Comparison { width: level.image.width, image: &level.image.data, rendered, tangents: &tangents };
        Ok(gauss_newton::evidence(&seen, robust))
    }

    /// Gauss-Newton from the phase `start`, coarse to fine; `None` when the image says nothing.
    fn track(&mut self, levels: &[Level], light: &Light, start: f64) -> Result<Option<Tracked>> {
        let s = self.settings;
        let prior = Prior {
            mean: DVector::from_element(1, self.expected()),
            deviation: DVector::from_element(1, *s.prior_deviation),
        };
        let (mut phase, mut tracked) = (start, None);
        for level in levels {
            for _ in 0..level.steps {
                let Some(evidence) = self.look(level, light, phase)? else { return Ok(tracked) };
                let now = DVector::from_element(1, phase);
                let Some((step, covariance)) = gauss_newton::posterior(&evidence, &prior, &now) else {
                    return Ok(tracked);
                };
                phase = (phase + step[0].clamp(-*s.longest_step, *s.longest_step)).clamp(0.0, 1.0);
                tracked = Some(Tracked { phase, deviation: covariance[(0, 0)].sqrt(), evidence });
            }
        }
        Ok(tracked)
    }
}

/// A frame's phase with its standard deviation, and what the last step saw.
struct Tracked {
    phase: f64,
    deviation: f64,
    evidence: Evidence,
}
