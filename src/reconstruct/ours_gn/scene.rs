//! The discs that one frame of `ours-gn` can see: placed at a phase, coloured as the scope's light shows them, and how
//! both change with the phase.

use crate::base::Result;
use crate::splat::Shape;

use super::light::Light;
use crate::reconstruct::anchored::{Patch, SH_C0, SH_VALUES};
use crate::reconstruct::phase_fit::at_phase;

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
    /// What each disc shows of its albedo now.
    pub shade: Vec<f32>,
    /// Filled by [`Seen::motion`].
    pub velocity: Velocity,
}

/// Derivatives of the discs by the phase.
#[derive(Default)]
pub struct Velocity {
    /// Of the centres, mm.
    pub positions: Vec<[f32; 3]>,
    /// Of the axes, mm.
    pub axes: Vec<[[f32; 3]; 2]>,
    /// Of the colours.
    pub colors: Vec<[f32; 3]>,
}

impl Seen {
    /// Moves the discs to `phase` and colours them as the scope's light shows them.
    pub fn place(&mut self, phase: f64, light: &Light) -> Result<()> {
        at_phase(&self.rest, &self.displacement, phase as f32, &mut self.vertices);
        self.patch.place(&self.vertices)?;
        self.shade.clear();
        let gaussians = &self.patch.gaussians;
        let Shape::Discs { axes } = &gaussians.shape else { unreachable!("a patch is made of discs") };
        let shades = gaussians.positions.iter().zip(axes).map(|(p, a)| light.shade(*p, a, [0.0; 3]).value);
        self.shade.extend(shades);
        self.color();
        Ok(())
    }

    /// Colours the discs by albedo and shade.
    pub fn color(&mut self) {
        let shown = self.albedo.iter().zip(&self.shade);
        for (sh, (albedo, shade)) in self.patch.gaussians.sh.chunks_exact_mut(SH_VALUES).zip(shown) {
            for c in 0..3 {
                sh[c] = (albedo[c] * shade - 0.5) / SH_C0;
            }
        }
    }

    /// How discs and their colours move with the phase.
    pub fn motion(&mut self, light: &Light) -> Result<()> {
        let Velocity { positions, axes: moving_axes, colors } = &mut self.velocity;
        self.patch.place_tangent(&self.vertices, &self.displacement, positions, moving_axes)?;
        let gaussians = &self.patch.gaussians;
        let Shape::Discs { axes } = &gaussians.shape else { unreachable!("a patch is made of discs") };
        colors.clear();
        for (((centre, axes), velocity), albedo) in
            gaussians.positions.iter().zip(axes).zip(positions.iter()).zip(&self.albedo)
        {
            let shade = light.shade(*centre, axes, *velocity);
            colors.push(albedo.map(|a| a * shade.by_phase));
        }
        Ok(())
    }
}
