//! `ours`: discs anchored to the CT mesh, carried by one phase per frame (the paper's Sections 3.1 to 3.4). The same
//! program runs the sanity rows `static-ct` (inspiration mesh, phase 0 throughout) and `oracle-phase` (true phase). Discs on
//! faces that a wall hides are no part of a frame.

use crate::base::{Progress, Result, mesh};
use crate::reconstruct::fitting::schedule::rate_factor;
use crate::splat::{Frame, Gaussians, Gradients, View, Wanted};

use crate::reconstruct::contract::{Access, FramePrediction, Observation, Poses, Reconstruct, Reconstruction};
use crate::reconstruct::estimate::phase_fit::{self, Carried, PhaseSource, at_phase};
use crate::reconstruct::estimate::window::correction::Correction;
use crate::reconstruct::estimate::window::{Setting, Shape, Window};
use crate::reconstruct::fitting::anchored::{DiscAdam, Patch, Rates, Start, Surface, adam_constants, to_f32};
use crate::reconstruct::fitting::memory::Memory;
use crate::reconstruct::fitting::optimiser::StepCounter;
use crate::reconstruct::geometry::mesh_depth::{Rays, unhidden};
use crate::reconstruct::geometry::pyramid::Level;
use crate::reconstruct::geometry::visible::{Reach, Sides, nothing_in_view, pixel_areas, visible_faces};
use crate::reconstruct::settings::{GivenPhaseSettings, KeyframeSettings, MethodHeader, OursSettings, PhaseEstimation};

/// Phases farther apart may show what is hidden at both of them. A hair above the reach of a frame with a guess, which
/// rounding may widen.
const WIDEST_REACH: f64 = 2.0 * phase_fit::REACH + 1e-6;

/// The phase that a sanity row is given.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GivenPhase {
    /// 0 throughout: the inspiration mesh, which does not move.
    Inspiration,
    /// The true one.
    True,
}

/// Which row of the report.
enum ReportRow {
    /// The paper's method, with how it estimates the phase and its keyframes.
    Estimated(Box<PhaseEstimation>, KeyframeSettings),
    /// A sanity row.
    Given(GivenPhase),
}

/// Mesh-anchored method with one phase per frame.
pub struct Ours {
    settings: GivenPhaseSettings,
    row: ReportRow,
    iteration_scale: f64,
}

impl Ours {
    /// The paper's method, with every iteration count times `iteration_scale`.
    pub fn new(settings: OursSettings, iteration_scale: f64) -> Self {
        let OursSettings { header, fit, estimation, window, discs } = settings;
        let row = ReportRow::Estimated(Box::new(estimation), window);
        Ours { settings: GivenPhaseSettings { header, fit, discs }, row, iteration_scale }
    }

    /// The same with the phase given.
    pub fn with_given_phase(settings: GivenPhaseSettings, phase: GivenPhase, iteration_scale: f64) -> Self {
        Ours { settings, row: ReportRow::Given(phase), iteration_scale }
    }
}

impl Reconstruct for Ours {
    fn header(&self) -> &MethodHeader {
        &self.settings.header
    }

    fn access(&self) -> Access {
        Access {
            expiration_mesh: !matches!(self.row, ReportRow::Given(GivenPhase::Inspiration)),
            first_depth: matches!(self.row, ReportRow::Estimated(..)),
            true_phase: matches!(self.row, ReportRow::Given(GivenPhase::True)),
            poses: Poses::True,
        }
    }

    fn run(
        &self,
        observation: &Observation,
        emit: &mut dyn FnMut(FramePrediction) -> Result<()>,
        progress: &dyn Progress,
    ) -> Result<Reconstruction> {
        observation.validate(self.access())?;
        let start = std::time::Instant::now();
        let window = match &self.row {
            ReportRow::Estimated(_, keyframes) => Window::new(keyframes, None),
            ReportRow::Given(_) => None,
        };
        let mut carried = OnMesh::new(&self.settings, window, self.iteration_scale, observation)?;
        let preparation = start.elapsed().as_secs_f64();
        let source = match &self.row {
            ReportRow::Estimated(estimation, _) => PhaseSource::Estimated(estimation),
            ReportRow::Given(GivenPhase::Inspiration) => PhaseSource::Given(vec![0.0; observation.images.len()]),
            ReportRow::Given(GivenPhase::True) => {
                PhaseSource::Given(observation.true_phase.clone().unwrap_or_default())
            }
        };
        let (phase, mut done) = phase_fit::run(
            &self.settings.fit,
            self.iteration_scale,
            &source,
            observation,
            &mut carried,
            emit,
            progress,
        )?;
        done.final_mesh = Some(phase_fit::mesh_at(observation, phase));
        done.seconds += preparation;
        Ok(done)
    }
}

/// Discs on the breathing mesh.
struct OnMesh {
    surface: Surface,
    inspiration: Vec<[f32; 3]>,
    displacement: Vec<[f32; 3]>,
    reach: Reach,
    rays: Rays,
    adam: DiscAdam,
    seen: Option<Seen>,
    memory: Memory,
    window: Option<Window>,
    pixels_per_disc: f32,
    most_per_face: f32,
}

/// The compact copy of one frame.
struct Seen {
    faces: Vec<u32>,
    patch: Patch,
    rest: Vec<[f32; 3]>,
    displacement: Vec<[f32; 3]>,
    vertices: Vec<[f32; 3]>,
    memory: Memory,
}

impl OnMesh {
    fn new(
        settings: &GivenPhaseSettings,
        window: Option<Window>,
        iteration_scale: f64,
        observation: &Observation,
    ) -> Result<Self> {
        let discs = &settings.discs;
        let rest = &observation.inspiration;
        let expiration = observation.expiration.as_ref().unwrap_or(rest);
        let rates = Rates::new(&discs.appearance, rate_factor(iteration_scale));
        let constants = adam_constants(*discs.quiet_values, observation.images[0].data.len());
        let surface =
            Surface::new(rest, &discs.appearance, Frame::from(*discs.on_face.inherits), Start::Even, observation.seed);
        Ok(OnMesh {
            memory: Memory::new(surface.len()),
            window,
            pixels_per_disc: *discs.on_face.pixels_per_disc as f32,
            most_per_face: *discs.on_face.most_per_face as f32,
            surface,
            inspiration: to_f32(&rest.vertices),
            displacement: mesh::displacement(rest, expiration),
            reach: Reach::new(&settings.fit.visibility),
            rays: Rays::new(&observation.camera),
            adam: DiscAdam::new(rates, StepCounter::Restarted, constants),
            seen: None,
        })
    }

    /// Of `faces` those that no wall hides in one of the `states`.
    fn unhidden(&self, view: &View, states: &[&[[f32; 3]]], faces: &[u32]) -> Vec<u32> {
        let mut seen: Vec<u32> = (states.iter())
            .flat_map(|vertices| unhidden(view, &self.rays, vertices, &self.surface.faces, faces))
            .collect();
        seen.sort_unstable();
        seen.dedup();
        seen
    }

    /// Faces that have come near get more discs.
    fn refine(&mut self, faces: &[u32], vertices: &[[f32; 3]], view: &View) {
        if self.pixels_per_disc > 0.0 {
            let mut wanted = pixel_areas(&self.surface.faces, faces, vertices, view);
            wanted.iter_mut().for_each(|v| *v = (*v / self.pixels_per_disc).min(self.most_per_face));
            let parents = self.surface.refine(faces, &wanted);
            self.memory.split(&parents);
        }
    }

    fn seen(&self) -> &Seen {
        self.seen.as_ref().expect("a frame is entered before it is worked on")
    }

    fn seen_mut(&mut self) -> &mut Seen {
        self.seen.as_mut().expect("a frame is entered before it is worked on")
    }
}

impl Carried for OnMesh {
    fn enter(&mut self, view: &View, [low, high]: [f64; 2]) -> Result<()> {
        let phases: &[f64] = if low == high { &[low] } else { &[low, 0.5 * (low + high), high] };
        let states: Vec<Vec<[f32; 3]>> = phases
            .iter()
            .map(|&p| {
                let mut out = Vec::new();
                at_phase(&self.inspiration, &self.displacement, p as f32, &mut out);
                out
            })
            .collect();
        let states: Vec<&[[f32; 3]]> = states.iter().map(|s| &s[..]).collect();
        let mut faces = visible_faces(&self.surface.faces, &states, view, self.reach, Sides::Lumen);
        if high - low <= WIDEST_REACH {
            faces = self.unhidden(view, &states, &faces);
        }
        if faces.is_empty() {
            return Err(nothing_in_view());
        }
        self.refine(&faces, states[states.len() / 2], view);
        let patch = self.surface.patch(&faces)?;
        self.seen = Some(Seen {
            rest: patch.pick(&self.inspiration),
            displacement: patch.pick(&self.displacement),
            vertices: Vec::new(),
            memory: self.memory.pick(&patch.discs),
            patch,
            faces,
        });
        Ok(())
    }

    fn place(&mut self, phase: f64) -> Result<()> {
        let seen = self.seen_mut();
        at_phase(&seen.rest, &seen.displacement, phase as f32, &mut seen.vertices);
        seen.patch.place(&seen.vertices)
    }

    fn gaussians(&self) -> &Gaussians<f32> {
        &self.seen().patch.gaussians
    }

    fn colors(&mut self) -> (&mut [f32], &mut Memory) {
        let seen = self.seen_mut();
        (&mut seen.patch.gaussians.sh, &mut seen.memory)
    }

    fn velocities(&self, out: &mut Vec<[f32; 3]>) -> Result<()> {
        let seen = self.seen();
        seen.patch.place_tangent(&seen.vertices, &seen.displacement, out, &mut Vec::new())
    }

    fn phase_derivative(&self, gradients: &Gradients<f32>) -> Result<f64> {
        let seen = self.seen();
        seen.patch.phase_derivative(gradients, &seen.vertices, &seen.displacement)
    }

    fn begin_appearance(&mut self) {
        let discs = self.seen().patch.discs.len();
        self.adam.begin(discs);
    }

    fn appearance_groups(&self) -> Wanted {
        self.adam.rates.groups()
    }

    fn step_appearance(&mut self, gradients: &Gradients<f32>, visible: &[bool]) -> Result<()> {
        let seen = self.seen.as_mut().expect("a frame is entered before it is worked on");
        seen.patch.step(&mut self.adam, gradients, visible, &seen.vertices)
    }

    fn place_among_keyframes(&mut self, frame: Level, expected: f64) -> f64 {
        let (Some(window), Some(seen)) = (&mut self.window, &self.seen) else { return expected };
        let mut level = frame;
        while !Window::suits(&level) {
            level = level.halved();
        }
        let shape = Shape { rest: &self.inspiration, displacement: &self.displacement, faces: &self.surface.faces };
        let setting = Setting { shape, visible: &seen.faces };
        window.place(&level, 0.0, setting, expected, &mut Correction::none()).phase
    }

    fn leave(&mut self) {
        if let Some(seen) = self.seen.take() {
            self.surface.absorb(&seen.patch);
            self.memory.put(&seen.patch.discs, &seen.memory);
        }
    }
}
