//! The map of `ours-gn`: the albedo of all discs; and the discs visible in one frame, placed at a phase and coloured
//! under the scope's light, with the derivatives of both by the phase.

use glam::Vec3;
use rayon::prelude::*;

use crate::base::Result;
use crate::reconstruct::contract::Observation;
use crate::reconstruct::fitting::anchored::{Patch, SH_C0, Start, Surface};
use crate::reconstruct::fitting::scope_light::ScopeLight;
use crate::reconstruct::fitting::unseen::{Shown, lent_colors};
use crate::reconstruct::geometry::breathing::{BreathingMesh, at_phase};
use crate::reconstruct::settings::GaussianSettings;
use crate::splat::{DiscFrame, Gaussians, Shape};

/// Discs per task, at least.
pub const DISCS: usize = 1024;

/// All discs of the airway.
pub struct DiscMap {
    surface: Surface,
    opacity: f32,
    albedo: Vec<[f32; 3]>,
    /// Weight of past frames, in pixels; 0 = no frame has shown the disc yet.
    memory: Vec<f32>,
}

impl DiscMap {
    /// Grey discs that no frame has shown.
    pub fn new(settings: &GaussianSettings, observation: &Observation) -> Self {
        let mesh = &observation.inspiration;
        let surface = Surface::new(mesh, settings, DiscFrame::InheritStretch, Start::Even, observation.seed);
        let (albedo, memory) = (vec![[0.5; 3]; surface.len()], vec![0.0; surface.len()]);
        DiscMap { surface, opacity: *settings.opacity as f32, albedo, memory }
    }

    /// Faces of the mesh.
    pub fn faces(&self) -> &[[u32; 3]] {
        &self.surface.faces
    }

    /// Makes the compact copy of the discs on `faces`, which [`DiscMap::leave`] takes back. Their colours do not
    /// depend on the viewing direction.
    pub fn enter(&self, faces: Vec<u32>, mesh: BreathingMesh<'_>) -> Result<ActiveFrame> {
        let mut patch = self.surface.patch(&faces)?;
        let discs = patch.discs.par_iter().with_min_len(DISCS);
        let (memory, albedo) = discs.map(|&i| (self.memory[i as usize], self.albedo[i as usize])).unzip();
        patch.gaussians = Gaussians::discs(patch.discs.len(), 0, self.opacity);
        Ok(ActiveFrame {
            rest: patch.pick(mesh.rest),
            displacement: patch.pick(mesh.displacement),
            vertices: Vec::new(),
            faces,
            patch,
            albedo,
            memory,
            pixels: Vec::new(),
            shade: Vec::new(),
        })
    }

    /// Writes back what the frame has learned.
    pub fn leave(&mut self, frame: ActiveFrame) {
        for (k, &i) in frame.patch.discs.iter().enumerate() {
            self.albedo[i as usize] = frame.albedo[k];
            self.memory[i as usize] = frame.memory[k];
        }
    }
}

/// The compact copy of the discs visible in one frame.
#[must_use = "what a frame has learned is lost unless the map takes it back"]
pub struct ActiveFrame {
    /// The faces in view, ascending.
    pub faces: Vec<u32>,
    patch: Patch,
    /// Local vertices at inspiration.
    rest: Vec<[f32; 3]>,
    /// Their displacement to expiration.
    displacement: Vec<[f32; 3]>,
    /// Local vertices at the current phase.
    vertices: Vec<[f32; 3]>,
    /// Albedo per disc.
    pub albedo: Vec<[f32; 3]>,
    /// Weight of past frames, in pixels; 0 = no frame has shown the disc yet.
    pub memory: Vec<f32>,
    /// Contribution of each disc to the image, in pixels; filled while the albedo is learned.
    pub pixels: Vec<f32>,
    /// Factor from each disc's albedo to its shown colour.
    pub shade: Vec<f32>,
}

/// Derivatives of the discs by the phase.
pub struct MapVelocity {
    /// Of the centres, mm per unit of phase.
    pub positions: Vec<[f32; 3]>,
    /// Of the axes, mm per unit of phase.
    pub axes: Vec<[[f32; 3]; 2]>,
    /// Of the colours, per unit of phase.
    pub colors: Vec<[f32; 3]>,
}

impl ActiveFrame {
    /// The discs, as placed.
    pub fn gaussians(&self) -> &Gaussians<f32> {
        &self.patch.gaussians
    }

    /// Takes the local part of another displacement field of the whole mesh.
    pub fn bend(&mut self, displacement: &[[f32; 3]]) {
        self.displacement = self.patch.pick(displacement);
    }

    /// Moves the discs to `phase` and colours them under the scope's light.
    pub fn place(&mut self, phase: f64, light: &ScopeLight) -> Result<()> {
        at_phase(&self.rest, &self.displacement, phase as f32, &mut self.vertices);
        self.patch.place(&self.vertices)?;
        let gaussians = &self.patch.gaussians;
        let Shape::Discs { axes } = &gaussians.shape else { unreachable!("a patch is made of discs") };
        let shades = gaussians.positions.par_iter().zip(axes).with_min_len(DISCS);
        shades
            .map(|(p, a)| light.shade((*p).into(), Some(normal(a)), Vec3::ZERO).value)
            .collect_into_vec(&mut self.shade);
        self.color();
        Ok(())
    }

    /// Colours the discs by albedo and shade.
    pub fn color(&mut self) {
        let shown = self.albedo.par_iter().zip(&self.shade).with_min_len(DISCS);
        self.patch.gaussians.sh.par_chunks_exact_mut(3).zip(shown).for_each(|(sh, (albedo, shade))| {
            for c in 0..3 {
                sh[c] = (albedo[c] * shade - 0.5) / SH_C0;
            }
        });
    }

    /// Discs that no frame has shown get the albedo of the wall beside them, where there is no image to take one from.
    pub fn color_the_unseen_as_beside(&mut self) {
        let shown = |k: usize| {
            let shade = self.shade[k];
            (self.memory[k] > 0.0).then(|| Shown { color: self.albedo[k].map(|v| v * shade), shade })
        };
        for (k, albedo) in lent_colors(&self.patch.gaussians.positions, shown) {
            self.albedo[k] = albedo;
        }
        self.color();
    }

    /// The derivatives of the discs and their colours by the phase.
    pub fn velocity(&self, light: &ScopeLight) -> Result<MapVelocity> {
        let (mut positions, mut axes) = (Vec::new(), Vec::new());
        self.patch.place_tangent(&self.vertices, &self.displacement, &mut positions, &mut axes)?;
        let gaussians = &self.patch.gaussians;
        let Shape::Discs { axes: placed } = &gaussians.shape else { unreachable!("a patch is made of discs") };
        let discs = gaussians.positions.par_iter().zip(placed).zip(&self.albedo).zip(&positions);
        let colors = discs
            .with_min_len(DISCS)
            .map(|(((centre, axes), albedo), velocity)| {
                let shade = light.shade((*centre).into(), Some(normal(axes)), (*velocity).into());
                albedo.map(|a| a * shade.value * shade.relative_slope)
            })
            .collect();
        Ok(MapVelocity { positions, axes, colors })
    }
}

/// Unit normal of a disc.
fn normal([a, b]: &[[f32; 3]; 2]) -> Vec3 {
    Vec3::from(*a).cross(Vec3::from(*b)).normalize_or_zero()
}
