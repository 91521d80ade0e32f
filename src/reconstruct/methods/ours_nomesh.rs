//! `ours-nomesh`: free Gaussians carried by the interpolated displacement field of the two CTs, one phase per frame
//! ("Ours w/o mesh" of the paper, which does not say how; this is our reading). Born at random points of the
//! inspiration surface; centre = own centre + phase * displacement, the displacement interpolated once from the
//! nearest mesh vertices (inverse distance); own centre, rotation, scale and SH-1 are learned. No mesh comes out.

use crate::base::{Progress, Result};
use crate::reconstruct::contract::{Access, FramePrediction, Observation, PoseAccuracy, Reconstruct, Reconstruction};
use crate::reconstruct::estimate::phase_fit::{BreathingGaussians, Fitter, PhaseSource, VisiblePatch};
use crate::reconstruct::fitting::anchored::{Rates, adam_constants};
use crate::reconstruct::fitting::free::{Free, FreeAdam, FreePatch};
use crate::reconstruct::fitting::memory::Memory;
use crate::reconstruct::fitting::optimiser::StepCounter;
use crate::reconstruct::fitting::schedule::paced_rate_factor;
use crate::reconstruct::geometry::breathing::at_phase;
use crate::reconstruct::geometry::neighbours;
use crate::reconstruct::geometry::visible::{Reach, visible_points};
use crate::reconstruct::online::OnlineRun;
use crate::reconstruct::settings::{MethodHeader, OursNomeshSettings, PerFace};
use crate::splat::{Gaussians, Gradients, View, Wanted};

/// Mesh vertices whose displacements a Gaussian averages.
const FIELD_NEIGHBOURS: usize = 4;

/// Free Gaussians with one phase per frame.
pub struct OursNomesh {
    settings: OursNomeshSettings,
    iteration_scale: f64,
}

impl OursNomesh {
    /// With `settings`, every iteration count times `iteration_scale`.
    pub fn new(settings: OursNomeshSettings, iteration_scale: f64) -> Self {
        OursNomesh { settings, iteration_scale }
    }
}

impl Reconstruct for OursNomesh {
    fn header(&self) -> &MethodHeader {
        &self.settings.header
    }

    fn access(&self) -> Access {
        Access { expiration_mesh: true, first_depth: true, true_phase: false, poses: PoseAccuracy::True }
    }

    /// One Gaussian lies at the centroid of its face; several are drawn.
    fn draws(&self) -> bool {
        *self.settings.appearance.gaussians.gaussians_per_face != PerFace::Count(1)
    }

    fn run(
        &self,
        observation: &Observation,
        emit: &mut dyn FnMut(FramePrediction) -> Result<()>,
        progress: &dyn Progress,
    ) -> Result<Reconstruction> {
        let run = OnlineRun::begin(self.access(), observation)?;
        let mut gaussians = FieldGaussians::new(&self.settings, self.iteration_scale, observation);
        let source = PhaseSource::Estimated(&self.settings.estimation);
        let fitter = Fitter::new(&self.settings.fit, source.estimation(), self.iteration_scale, observation);
        let (_, done) = fitter.run(run, &source, &mut gaussians, emit, progress)?;
        Ok(done)
    }
}

/// Free Gaussians in the displacement field.
struct FieldGaussians {
    free: Free,
    displacement: Vec<[f32; 3]>,
    reach: Reach,
    adam: FreeAdam,
    memory: Memory,
}

impl FieldGaussians {
    fn new(settings: &OursNomeshSettings, iteration_scale: f64, observation: &Observation) -> Self {
        let rest = &observation.inspiration;
        let expiration = observation.expiration.as_ref().unwrap_or(rest);
        let free = Free::new(rest, &settings.appearance.gaussians, 0.5, observation.seed);
        let centres: Vec<_> = free.centres.iter().map(|c| glam::Vec3::from(*c).as_dvec3()).collect();
        let displacement = neighbours::nearest(&rest.vertices, &centres, FIELD_NEIGHBOURS)
            .iter()
            .map(|list| {
                let (mut sum, mut weights) = (glam::DVec3::ZERO, 0.0);
                for &(v, d) in list {
                    let w = 1.0 / (d + 1e-3);
                    sum += (expiration.vertices[v as usize] - rest.vertices[v as usize]) * w;
                    weights += w;
                }
                (sum / weights).as_vec3().to_array()
            })
            .collect();
        let memory = Memory::new(free.centres.len());
        let factor = paced_rate_factor(iteration_scale, *settings.pace.rate_interval_s, &observation.time_s);
        let rates = Rates { scale: *settings.scale_rate, ..Rates::from(&settings.appearance) };
        FieldGaussians {
            free,
            displacement,
            reach: Reach::new(&settings.fit.visibility),
            adam: FreeAdam::new(
                Rates::new(rates, factor),
                StepCounter::Restarted,
                adam_constants(*settings.pace.quiet_share),
            ),
            memory,
        }
    }
}

impl BreathingGaussians for FieldGaussians {
    fn enter<'a>(&'a mut self, view: &View, [low, high]: [f64; 2]) -> Result<Box<dyn VisiblePatch + 'a>> {
        let phases: &[f64] = if low == high { &[low] } else { &[low, 0.5 * (low + high), high] };
        let at = |&phase: &f64| {
            let mut places = Vec::new();
            at_phase(&self.free.centres, &self.displacement, phase as f32, &mut places);
            places
        };
        let states: Vec<Vec<[f32; 3]>> = phases.iter().map(at).collect();
        let states: Vec<&[[f32; 3]]> = states.iter().map(|s| &s[..]).collect();
        let ids = visible_points(&states, &self.free.sizes_mm(), view, self.reach);
        let patch = self.free.patch(ids);
        Ok(Box::new(VisibleFree {
            displacement: patch.ids.iter().map(|&i| self.displacement[i as usize]).collect(),
            memory: self.memory.pick(&patch.ids),
            patch,
            all: self,
        }))
    }

    fn look<'a>(&'a mut self, view: &View, phase: f64) -> Result<Box<dyn VisiblePatch + 'a>> {
        self.enter(view, [phase, phase])
    }
}

/// The Gaussians visible in one frame.
struct VisibleFree<'a> {
    all: &'a mut FieldGaussians,
    patch: FreePatch,
    displacement: Vec<[f32; 3]>,
    memory: Memory,
}

impl VisiblePatch for VisibleFree<'_> {
    fn place(&mut self, phase: f64) -> Result<()> {
        let (displacement, p) = (&self.displacement, phase as f32);
        self.patch.place(|k| displacement[k].map(|v| p * v), |_| [0.0; 4]);
        Ok(())
    }

    fn gaussians(&self) -> &Gaussians<f32> {
        &self.patch.gaussians
    }

    fn colors(&mut self) -> (&mut [f32], &mut Memory) {
        (&mut self.patch.gaussians.sh, &mut self.memory)
    }

    fn velocities(&self, out: &mut Vec<[f32; 3]>) -> Result<()> {
        out.clone_from(&self.displacement);
        Ok(())
    }

    fn phase_derivative(&self, gradients: &Gradients<f32>) -> Result<f64> {
        let dot = |(g, d): (&[f32; 3], &[f32; 3])| (0..3).map(|k| (g[k] * d[k]) as f64).sum::<f64>();
        Ok(gradients.positions.iter().zip(&self.displacement).map(dot).sum())
    }

    fn begin_appearance(&mut self) {
        self.all.adam.begin(self.patch.ids.len());
    }

    fn appearance_groups(&self) -> Wanted {
        self.all.adam.rates.groups()
    }

    fn step_appearance(&mut self, gradients: &Gradients<f32>) -> Result<()> {
        self.patch.step(&mut self.all.adam, gradients);
        Ok(())
    }

    fn leave(self: Box<Self>) {
        self.all.free.absorb(&self.patch);
        self.all.memory.put(&self.patch.ids, &self.memory);
    }
}
