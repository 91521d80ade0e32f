//! `ours`: discs anchored to the CT mesh, carried by one phase per frame (the paper's Sections 3.1 to 3.4). The
//! same program runs `ours-window` and the bounds `static-ct` (inspiration mesh, phase 0 throughout),
//! `static-expiration` (phase 1) and `oracle-phase` (true phase), by their settings.

use crate::base::{Image, Progress, Result, mesh};
use crate::reconstruct::contract::{Access, FramePrediction, Observation, PoseAccuracy, Reconstruct, Reconstruction};
use crate::reconstruct::estimate::phase_fit::{self, BreathingGaussians, Fitter, PhaseSource, VisiblePatch};
use crate::reconstruct::estimate::window::{KeyframeWindow, WindowOptions};
use crate::reconstruct::fitting::anchored::{DiscAdam, Patch, Rates, Start, Surface, adam_constants, to_f32};
use crate::reconstruct::fitting::memory::Memory;
use crate::reconstruct::fitting::optimiser::StepCounter;
use crate::reconstruct::fitting::schedule::paced_rate_factor;
use crate::reconstruct::geometry::breathing::{BreathingMesh, at_phase, mesh_at};
use crate::reconstruct::geometry::mesh_depth::{PixelRays, surface_depth_mm, unhidden};
use crate::reconstruct::geometry::pyramid::PyramidLevel;
use crate::reconstruct::geometry::visible::{Reach, Sides, pixel_areas, visible_faces};
use crate::reconstruct::online::OnlineRun;
use crate::reconstruct::settings::{GivenPhaseSettings, KeyframeSettings, MethodHeader, OursSettings, PhaseEstimation};
use crate::splat::{DiscFrame, Gaussians, Gradients, View, Wanted};

/// Largest range of phases for which hidden faces are left out: over a wider one, a face hidden at both ends may be
/// visible in between. Slightly above the range of a frame with a guess, which rounding may widen.
const WIDEST_REACH: f64 = 2.0 * phase_fit::REACH + 1e-6;

/// The given phase of a sanity row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GivenPhase {
    /// 0 throughout: the inspiration mesh, which does not move.
    Inspiration,
    /// 1 throughout: the expiration mesh, which does not move.
    Expiration,
    /// The true one.
    True,
}

/// Which row of the report: where displacement and phase come from.
enum OursVariant {
    /// The paper's method, with how it estimates the phase and its keyframes.
    Ours(Box<PhaseEstimation>, KeyframeSettings),
    /// A sanity row.
    Given(GivenPhase),
}

/// Mesh-anchored method with one phase per frame.
pub struct Ours {
    settings: GivenPhaseSettings,
    variant: OursVariant,
    iteration_scale: f64,
}

impl Ours {
    /// The paper's method, with every iteration count times `iteration_scale`.
    pub fn new(settings: OursSettings, iteration_scale: f64) -> Self {
        let OursSettings { header, fit, estimation, window, discs } = settings;
        let variant = OursVariant::Ours(Box::new(estimation), window);
        Ours { settings: GivenPhaseSettings { header, fit, discs }, variant, iteration_scale }
    }

    /// The same with the phase given.
    pub fn with_given_phase(settings: GivenPhaseSettings, phase: GivenPhase, iteration_scale: f64) -> Self {
        Ours { settings, variant: OursVariant::Given(phase), iteration_scale }
    }
}

impl Reconstruct for Ours {
    fn header(&self) -> &MethodHeader {
        &self.settings.header
    }

    fn access(&self) -> Access {
        Access {
            expiration_mesh: !matches!(self.variant, OursVariant::Given(GivenPhase::Inspiration)),
            first_depth: matches!(self.variant, OursVariant::Ours(..)),
            true_phase: matches!(self.variant, OursVariant::Given(GivenPhase::True)),
            poses: PoseAccuracy::True,
        }
    }

    fn run(
        &self,
        observation: &Observation,
        emit: &mut dyn FnMut(FramePrediction) -> Result<()>,
        progress: &dyn Progress,
    ) -> Result<Reconstruction> {
        let run = OnlineRun::begin(self.access(), observation)?;
        let window = match &self.variant {
            OursVariant::Ours(_, keyframes) => KeyframeWindow::new(keyframes, WindowOptions::default()),
            OursVariant::Given(_) => None,
        };
        let mut discs = BreathingDiscs::new(&self.settings, window, self.iteration_scale, observation)?;
        let source = match &self.variant {
            OursVariant::Ours(estimation, _) => PhaseSource::Estimated(estimation),
            OursVariant::Given(GivenPhase::Inspiration) => PhaseSource::Given(vec![0.0; observation.images.len()]),
            OursVariant::Given(GivenPhase::Expiration) => PhaseSource::Given(vec![1.0; observation.images.len()]),
            OursVariant::Given(GivenPhase::True) => {
                PhaseSource::Given(observation.true_phase.clone().unwrap_or_default())
            }
        };
        let fitter = Fitter::new(&self.settings.fit, source.estimation(), self.iteration_scale, observation);
        let (phase, mut done) = fitter.run(run, &source, &mut discs, emit, progress)?;
        done.final_mesh = Some(mesh_at(observation, phase));
        Ok(done)
    }
}

/// Discs on the breathing mesh.
struct BreathingDiscs {
    surface: Surface,
    inspiration: Vec<[f32; 3]>,
    displacement: Vec<[f32; 3]>,
    reach: Reach,
    rays: PixelRays,
    adam: DiscAdam,
    memory: Memory,
    window: Option<KeyframeWindow>,
    pixels_per_disc: f32,
    most_per_face: f32,
    hidden_left_out: bool,
    depth_of_surface: bool,
}

impl BreathingDiscs {
    fn new(
        settings: &GivenPhaseSettings,
        window: Option<KeyframeWindow>,
        iteration_scale: f64,
        observation: &Observation,
    ) -> Result<Self> {
        let discs = &settings.discs;
        let rest = &observation.inspiration;
        let expiration = observation.expiration.as_ref().unwrap_or(rest);
        let factor = paced_rate_factor(iteration_scale, *discs.pace.rate_interval_s, &observation.time_s);
        let rates = Rates::new(&discs.appearance, factor);
        let constants = adam_constants(*discs.pace.quiet_share);
        let surface = Surface::new(
            rest,
            &discs.appearance,
            DiscFrame::from(*discs.on_face.inherits),
            Start::Even,
            observation.seed,
        );
        Ok(BreathingDiscs {
            memory: Memory::new(surface.len()),
            window,
            pixels_per_disc: *discs.on_face.pixels_per_disc as f32,
            most_per_face: *discs.on_face.most_per_face as f32,
            hidden_left_out: *discs.on_face.hidden_left_out,
            depth_of_surface: *discs.on_face.depth_of_surface,
            surface,
            inspiration: to_f32(&rest.vertices),
            displacement: mesh::displacement(rest, expiration),
            reach: Reach::new(&settings.fit.visibility),
            rays: PixelRays::new(&observation.camera),
            adam: DiscAdam::new(rates, StepCounter::Restarted, constants),
        })
    }

    fn mesh(&self) -> BreathingMesh<'_> {
        BreathingMesh { rest: &self.inspiration, displacement: &self.displacement, faces: &self.surface.faces }
    }

    /// The faces of `faces` that no wall hides in at least one of the `states`.
    fn unhidden(&self, view: &View, states: &[&[[f32; 3]]], faces: &[u32]) -> Vec<u32> {
        let mut unhidden: Vec<u32> = (states.iter())
            .flat_map(|vertices| unhidden(view, &self.rays, vertices, &self.surface.faces, faces))
            .collect();
        unhidden.sort_unstable();
        unhidden.dedup();
        unhidden
    }

    /// Gives more discs to faces that have come close.
    fn refine(&mut self, faces: &[u32], vertices: &[[f32; 3]], view: &View) {
        if self.pixels_per_disc > 0.0 {
            let mut wanted = pixel_areas(&self.surface.faces, faces, vertices, view);
            wanted.iter_mut().for_each(|v| *v = (*v / self.pixels_per_disc).min(self.most_per_face));
            let parents = self.surface.refine(faces, &wanted);
            self.memory.split(&parents);
        }
    }
}

impl BreathingDiscs {
    /// The faces that `view` may show while the phase stays within the range.
    fn faces_in_view(&self, view: &View, [low, high]: [f64; 2]) -> Vec<u32> {
        let phases: &[f64] = if low == high { &[low] } else { &[low, 0.5 * (low + high), high] };
        let states: Vec<Vec<[f32; 3]>> = phases.iter().map(|&phase| self.mesh().at(phase)).collect();
        let states: Vec<&[[f32; 3]]> = states.iter().map(|s| &s[..]).collect();
        let sides = if self.hidden_left_out { Sides::Lumen } else { Sides::Both };
        let faces = visible_faces(&self.surface.faces, &states, view, self.reach, sides);
        if self.hidden_left_out && high - low <= WIDEST_REACH { self.unhidden(view, &states, &faces) } else { faces }
    }

    fn patch_of(&mut self, faces: Vec<u32>) -> Result<Box<dyn VisiblePatch + '_>> {
        let patch = self.surface.patch(&faces)?;
        Ok(Box::new(VisibleDiscs {
            rest: patch.pick(&self.inspiration),
            displacement: patch.pick(&self.displacement),
            vertices: Vec::new(),
            memory: self.memory.pick(&patch.discs),
            patch,
            faces,
            all: self,
        }))
    }
}

impl BreathingGaussians for BreathingDiscs {
    fn enter<'a>(&'a mut self, view: &View, [low, high]: [f64; 2]) -> Result<Box<dyn VisiblePatch + 'a>> {
        let faces = self.faces_in_view(view, [low, high]);
        let middle = self.mesh().at(if low == high { low } else { 0.5 * (low + high) });
        self.refine(&faces, &middle, view);
        self.patch_of(faces)
    }

    fn look<'a>(&'a mut self, view: &View, phase: f64) -> Result<Box<dyn VisiblePatch + 'a>> {
        let faces = self.faces_in_view(view, [phase, phase]);
        self.patch_of(faces)
    }

    fn surface_depth_mm(&self, view: &View, phase: f64) -> Option<Image<f32>> {
        self.depth_of_surface.then(|| {
            let vertices = self.mesh().at(phase);
            surface_depth_mm(view, &self.rays, &vertices, &self.surface.faces, self.reach.range_mm)
        })
    }
}

/// The discs visible in one frame.
struct VisibleDiscs<'a> {
    all: &'a mut BreathingDiscs,
    faces: Vec<u32>,
    patch: Patch,
    rest: Vec<[f32; 3]>,
    displacement: Vec<[f32; 3]>,
    vertices: Vec<[f32; 3]>,
    memory: Memory,
}

impl VisiblePatch for VisibleDiscs<'_> {
    fn place(&mut self, phase: f64) -> Result<()> {
        at_phase(&self.rest, &self.displacement, phase as f32, &mut self.vertices);
        self.patch.place(&self.vertices)
    }

    fn gaussians(&self) -> &Gaussians<f32> {
        &self.patch.gaussians
    }

    fn colors(&mut self) -> (&mut [f32], &mut Memory) {
        (&mut self.patch.gaussians.sh, &mut self.memory)
    }

    fn velocities(&self, out: &mut Vec<[f32; 3]>) -> Result<()> {
        self.patch.place_tangent(&self.vertices, &self.displacement, out, &mut Vec::new())
    }

    fn phase_derivative(&self, gradients: &Gradients<f32>) -> Result<f64> {
        self.patch.phase_derivative(gradients, &self.vertices, &self.displacement)
    }

    fn begin_appearance(&mut self) {
        self.all.adam.begin(self.patch.discs.len());
    }

    fn appearance_groups(&self) -> Wanted {
        self.all.adam.rates.groups()
    }

    fn step_appearance(&mut self, gradients: &Gradients<f32>) -> Result<()> {
        self.patch.step(&mut self.all.adam, gradients, &self.vertices)
    }

    fn place_among_keyframes(&mut self, frame: PyramidLevel, expected: f64) -> f64 {
        let BreathingDiscs { window, inspiration, displacement, surface, .. } = &mut *self.all;
        let Some(window) = window else { return expected };
        let level = frame.halved_until(KeyframeWindow::suits);
        let mesh = BreathingMesh { rest: inspiration, displacement, faces: &surface.faces };
        window.place(&level, mesh, &self.faces, expected, |_| None).phase
    }

    fn leave(self: Box<Self>) {
        self.all.surface.absorb(&self.patch);
        self.all.memory.put(&self.patch.discs, &self.memory);
    }
}
