//! The airway surface as a function of the phase: `V(alpha) = V_insp + alpha D`, `D` the displacement from
//! inspiration to expiration (paper, Eq. 2).

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use crate::base::{TriangleMesh, mesh};
use crate::reconstruct::contract::Observation;

/// Vertices per task, at least.
const VERTICES: usize = 4096;

/// `rest + phase * displacement`, vertex by vertex (Eq. 2).
pub fn at_phase(rest: &[[f32; 3]], displacement: &[[f32; 3]], phase: f32, out: &mut Vec<[f32; 3]>) {
    let moved = rest.par_iter().zip(displacement).with_min_len(VERTICES);
    moved.map(|(r, d)| [0, 1, 2].map(|k| r[k] + phase * d[k])).collect_into_vec(out);
}

/// The airway at `phase` by the two CTs.
pub fn mesh_at(observation: &Observation, phase: f64) -> TriangleMesh {
    let vertices = match &observation.expiration {
        Some(expiration) => mesh::interpolate(&observation.inspiration.vertices, &expiration.vertices, phase),
        None => observation.inspiration.vertices.clone(),
    };
    TriangleMesh { vertices, faces: observation.inspiration.faces.clone() }
}

/// The airway at every phase.
#[derive(Clone, Copy)]
pub struct BreathingMesh<'a> {
    /// Vertices at inspiration, mm.
    pub rest: &'a [[f32; 3]],
    /// Their displacement from inspiration to expiration, mm.
    pub displacement: &'a [[f32; 3]],
    /// Corners of the faces.
    pub faces: &'a [[u32; 3]],
}

impl BreathingMesh<'_> {
    /// Vertices at `phase`.
    pub fn at(&self, phase: f64) -> Vec<[f32; 3]> {
        let mut out = Vec::new();
        at_phase(self.rest, self.displacement, phase as f32, &mut out);
        out
    }

    /// Corners of `face` at `phase`, in double precision.
    pub fn corners(&self, face: [u32; 3], phase: f64) -> [DVec3; 3] {
        face.map(|v| Vec3::from(self.rest[v as usize]).as_dvec3() + phase * self.displacement_of(v))
    }

    /// Displacement of vertex `v` from inspiration to expiration, mm.
    pub fn displacement_of(&self, v: u32) -> DVec3 {
        Vec3::from(self.displacement[v as usize]).as_dvec3()
    }
}
