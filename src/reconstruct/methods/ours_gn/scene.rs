//! The discs that one frame of `ours-gn` can see: placed at a phase, coloured as the scope's light shows them, and how
//! both change with the phase.

use glam::Vec3;
use rayon::prelude::*;

use crate::base::Result;
use crate::splat::{Gaussians, Shape};

use crate::reconstruct::estimate::phase_fit::at_phase;
use crate::reconstruct::estimate::window::correction::add;
use crate::reconstruct::fitting::anchored::{Patch, SH_C0};
use crate::reconstruct::fitting::scope_light::ScopeLight;

/// Discs per task, at least.
pub const DISCS: usize = 1024;

/// The compact copy of what one frame can see.
pub struct Seen {
    /// The discs.
    pub patch: Patch,
    /// Local vertices at inspiration.
    pub rest: Vec<[f32; 3]>,
    /// Their way to expiration.
    pub displacement: Vec<[f32; 3]>,
    /// Where they are now.
    pub vertices: Vec<[f32; 3]>,
    /// Per disc.
    pub albedo: Vec<[f32; 3]>,
    /// Weight of past frames, in pixels; 0 = never seen.
    pub memory: Vec<f32>,
    /// What each disc contributes to the image, in pixels; filled by `Tracker::learn`.
    pub pixels: Vec<f32>,
    /// What each disc shows of its albedo now.
    pub shade: Vec<f32>,
    /// Weights of the local vertices at each centre of the correction in view.
    pub modes: Vec<Vec<f32>>,
    /// `displacement` without the correction of those centres.
    plain: Vec<[f32; 3]>,
}

/// Derivatives of the discs by one unknown.
pub struct Velocity {
    /// Of the centres, mm.
    pub positions: Vec<[f32; 3]>,
    /// Of the axes, mm; empty: they stay.
    pub axes: Vec<[[f32; 3]; 2]>,
    /// Of the colours.
    pub colors: Vec<[f32; 3]>,
}

impl Seen {
    /// The discs of `patch`, with colours that look the same from all sides.
    pub fn new(
        mut patch: Patch,
        rest: Vec<[f32; 3]>,
        displacement: Vec<[f32; 3]>,
        albedo: Vec<[f32; 3]>,
        memory: Vec<f32>,
        opacity: f32,
    ) -> Seen {
        patch.gaussians = Gaussians::discs(patch.discs.len(), 0, opacity);
        let (vertices, pixels, shade) = (Vec::new(), Vec::new(), Vec::new());
        let (modes, plain) = (Vec::new(), displacement.clone());
        Seen { patch, rest, displacement, vertices, albedo, memory, pixels, shade, modes, plain }
    }

    /// Names the centres of the correction in view, by the weights of the local vertices and the coefficients that
    /// `displacement` contains.
    pub fn set_modes(&mut self, modes: Vec<Vec<f32>>, coefficients: &[[f64; 3]]) {
        for (weights, c) in modes.iter().zip(coefficients) {
            add(&mut self.plain, weights, c.map(|v| -v));
        }
        self.modes = modes;
    }

    /// Gives the centres in view other coefficients.
    pub fn correct(&mut self, coefficients: &[[f64; 3]]) {
        if !self.modes.is_empty() {
            self.displacement.clone_from(&self.plain);
            for (weights, c) in self.modes.iter().zip(coefficients) {
                add(&mut self.displacement, weights, *c);
            }
        }
    }

    /// Moves the discs to `phase` and colours them as the scope's light shows them.
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

    /// How discs and their colours move while the local vertices move by `by`.
    pub fn velocity(&self, light: &ScopeLight, by: &[[f32; 3]]) -> Result<Velocity> {
        let (mut positions, mut axes) = (Vec::new(), Vec::new());
        self.patch.place_tangent(&self.vertices, by, &mut positions, &mut axes)?;
        let colors = self.color_change(light, |k| positions[k]);
        Ok(Velocity { positions, axes, colors })
    }

    /// How discs and their colours move while the scope moves against `by` (mm, world), or all else by it.
    pub fn shift(&self, light: &ScopeLight, by: [f32; 3]) -> Velocity {
        let colors = self.color_change(light, |_| by);
        Velocity { positions: vec![by; colors.len()], axes: Vec::new(), colors }
    }

    fn color_change(&self, light: &ScopeLight, velocity: impl Fn(usize) -> [f32; 3] + Sync) -> Vec<[f32; 3]> {
        let gaussians = &self.patch.gaussians;
        let Shape::Discs { axes } = &gaussians.shape else { unreachable!("a patch is made of discs") };
        let discs = gaussians.positions.par_iter().zip(axes).zip(&self.albedo).enumerate();
        discs
            .with_min_len(DISCS)
            .map(|(k, ((centre, axes), albedo))| {
                let shade = light.shade((*centre).into(), Some(normal(axes)), velocity(k).into());
                albedo.map(|a| a * shade.value * shade.relative_slope)
            })
            .collect()
    }
}

/// Unit normal of a disc.
fn normal([a, b]: &[[f32; 3]; 2]) -> Vec3 {
    Vec3::from(*a).cross(Vec3::from(*b)).normalize_or_zero()
}
