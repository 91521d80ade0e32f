//! `ours`: discs anchored to the CT mesh, carried by one phase per frame (the paper's Sections 3.1 to 3.4). The same
//! program runs the sanity rows `static-ct` (inspiration mesh, phase 0 throughout) and `oracle-phase` (true phase). Discs on
//! faces that a wall hides are no part of a frame.

use crate::base::{Progress, Result, mesh};
use crate::splat::{DiscFrame, Gaussians, Gradients, View, Wanted};

use super::active::{Reach, Sides, nothing_in_view, pixel_areas, visible_faces};
use super::anchored::{DiscAdam, Patch, Rates, Start, Surface, adam_constants, to_f32};
use super::correction::Correction;
use super::level::Level;
use super::memory::Memory;
use super::mesh_depth::{Rays, unhidden};
use super::optimiser::StepCounter;
use super::phase_fit::{self, Carried, PhaseSource, at_phase};
use super::settings::PhaseMethod;
use super::window::{Setting, Shape, Window};
use super::{Access, FramePrediction, Listing, Observation, Poses, Reconstruct, Reconstruction};

/// Phases farther apart may show what is hidden at both of them. A hair above the reach of a frame with a guess, which
/// rounding may widen.
const WIDEST_REACH: f64 = 2.0 * phase_fit::REACH + 1e-6;

/// Which row of the report.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Row {
    /// The paper's method.
    Ours,
    /// Inspiration mesh, no deformation.
    StaticCt,
    /// True phase.
    OraclePhase,
}

/// Mesh-anchored method with one phase per frame.
pub struct Ours {
    settings: PhaseMethod,
    row: Row,
    iteration_scale: f64,
}

impl Ours {
    /// With `settings`, every iteration count times `iteration_scale`.
    pub fn new(settings: PhaseMethod, row: Row, iteration_scale: f64) -> Self {
        Ours { settings, row, iteration_scale }
    }
}

impl Reconstruct for Ours {
    fn id(&self) -> &str {
        &self.settings.id
    }

    fn listing(&self) -> Listing {
        self.settings.listing
    }

    fn access(&self) -> Access {
        Access {
            expiration_mesh: self.row != Row::StaticCt,
            first_depth: self.row == Row::Ours,
            true_phase: self.row == Row::OraclePhase,
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
        let mut carried = OnMesh::new(&self.settings, self.iteration_scale, observation)?;
        let preparation = start.elapsed().as_secs_f64();
        let source = match self.row {
            Row::Ours => PhaseSource::Estimated,
            Row::StaticCt => PhaseSource::Given(vec![0.0; observation.images.len()]),
            Row::OraclePhase => PhaseSource::Given(observation.true_phase.clone().unwrap_or_default()),
        };
        let (phase, mut done) =
            phase_fit::run(&self.settings, self.iteration_scale, &source, observation, &mut carried, emit, progress)?;
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
    fn new(settings: &PhaseMethod, iteration_scale: f64, observation: &Observation) -> Result<Self> {
        let rest = &observation.inspiration;
        let expiration = observation.expiration.as_ref().unwrap_or(rest);
        let rates = Rates::new(&settings.appearance, super::rate_factor(iteration_scale));
        let constants = adam_constants(&settings.appearance, observation.images[0].data.len());
        let surface = Surface::new(
            rest,
            &settings.appearance,
            DiscFrame::from(*settings.inherits),
            Start::Even,
            observation.seed,
        );
        Ok(OnMesh {
            memory: Memory::new(surface.len()),
            window: Window::new(&settings.window, None),
            pixels_per_disc: *settings.pixels_per_disc as f32,
            most_per_face: *settings.most_per_face as f32,
            surface,
            inspiration: to_f32(&rest.vertices),
            displacement: mesh::displacement(rest, expiration),
            reach: Reach::new(&settings.visibility),
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
