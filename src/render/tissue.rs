//! What light does on the rest shape, fixed to the tissue: which faces a face's rays meet, and where walks through the wall
//! come out. Both are kept, once made.
//!
//! Rows of walks, one per vertex, are a linear map from the light that falls on the faces to the light that comes out at
//! the vertex. Most of the noise of a few walks is in how much light survives, which hardly differs between neighbours:
//! every row is scaled to the mean sum of the rows around it.
//!
//! A row is made when a camera first sees its vertex or face, and serves every frame; it depends on the rest shape, the
//! material and the seed alone, and not on which frames came before. So noise does not flicker, and light changes
//! smoothly with the breath. That the wall is stretched by a breath, and the rows are not, is the approximation
//! (`docs/decisions/0005-light-at-vertices.md` has its size).

use std::sync::OnceLock;

use rayon::prelude::*;

use super::topology::Topology;
use crate::base::{Error, Result};
use crate::ffi::tracer::{FrameSettings, MaterialSettings, MeshTracer, NO_FACE};

/// Walks per vertex.
pub(super) const WALKS: usize = 64;
/// Vertices per task.
const CHUNK: usize = 16;

/// One face from which a vertex gets light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Source {
    /// The face.
    pub face: u32,
    /// Part of its irradiance that comes out at the vertex, over the vertex' albedo.
    pub weight: [f32; 3],
}

/// What makes the tracers of the fixed shapes.
pub(super) struct Rest {
    /// Airway generation per vertex.
    pub generation: Vec<f32>,
    /// Distance along the airway per vertex.
    pub axial: Vec<f32>,
    /// Of the wall.
    pub material: MaterialSettings,
}

/// Rows, made where they are asked for.
pub(super) struct Tissue {
    rest: Rest,
    ends: Vec<End>,
    rows: Vec<OnceLock<Box<[Source]>>>,
    scales: Vec<OnceLock<[f32; 3]>>,
}

/// One of the two ends of the motion, the first one being the shape at rest.
struct End {
    /// xyz interleaved, in the tracer's world.
    vertices: Vec<f32>,
    tracer: OnceLock<Result<MeshTracer>>,
    hits: Vec<OnceLock<Box<[u32]>>>,
}

impl End {
    fn new(vertices: Vec<f32>, faces: usize) -> Self {
        End { vertices, tracer: OnceLock::new(), hits: empty(faces) }
    }
}

fn empty<T>(count: usize) -> Vec<OnceLock<T>> {
    (0..count).map(|_| OnceLock::new()).collect()
}

impl Tissue {
    /// Nothing is traced yet. `vertices` of the shape at rest: xyz interleaved, in the tracer's world.
    pub(super) fn new(rest: Rest, vertices: Vec<f32>, topology: &Topology) -> Self {
        let count = topology.vertex_count();
        let ends = vec![End::new(vertices, topology.faces.len())];
        Tissue { rest, ends, rows: empty(count), scales: empty(count) }
    }

    /// The shape at the other end of the motion.
    pub(super) fn set_other_end(&mut self, vertices: Vec<f32>, topology: &Topology) {
        self.ends.truncate(1);
        self.ends.push(End::new(vertices, topology.faces.len()));
    }

    /// How far `vertices` are on the way from rest to the other end: 0 to 1, 0 where there is no other end.
    pub(super) fn progress(&self, vertices: &[f32]) -> f64 {
        let [rest, other] = &self.ends[..] else { return 0.0 };
        let (mut along, mut whole) = (0.0, 0.0);
        for ((&r, &o), &v) in rest.vertices.iter().zip(&other.vertices).zip(vertices) {
            along += f64::from(v - r) * f64::from(o - r);
            whole += f64::from(o - r).powi(2);
        }
        if whole > 0.0 { (along / whole).clamp(0.0, 1.0) } else { 0.0 }
    }

    /// The ends that speak for a shape, and how much.
    pub(super) fn weighted_ends(&self, progress: f64) -> Vec<(usize, f32)> {
        let parts = [(0, 1.0 - progress as f32), (1, progress as f32)];
        parts.into_iter().filter(|&(_, part)| part > 0.0).collect()
    }

    /// Light leaves the wall elsewhere than where it enters.
    pub(super) fn walks(&self) -> bool {
        self.rest.material.subsurface == 1
    }

    fn tracer(&self, end: usize, topology: &Topology) -> Result<&MeshTracer> {
        let end = &self.ends[end];
        let make = || {
            let Rest { generation, axial, material } = &self.rest;
            MeshTracer::new(&end.vertices, topology.faces.as_flattened(), generation, axial, material)
        };
        end.tracer.get_or_init(make).as_ref().map_err(|e| Error::new(e.kind(), e.to_string()))
    }

    /// The faces that `per_face` rays from each of `faces` meet on the shape of `end`, [`NO_FACE`] where one leaves the mesh;
    /// and the number of rays that were traced for it.
    pub(super) fn hits(
        &self,
        frame: &FrameSettings,
        end: usize,
        faces: &[u32],
        per_face: usize,
        topology: &Topology,
    ) -> Result<(Vec<u32>, u64)> {
        let tracer = self.tracer(end, topology)?;
        let kept = &self.ends[end].hits;
        let mut all = Vec::with_capacity(faces.len() * per_face);
        let mut rays = 0;
        for &face in faces {
            let row = match kept[face as usize].get() {
                Some(row) if row.len() >= per_face => row,
                _ => {
                    let mut row = vec![NO_FACE; per_face];
                    rays += tracer.gather(frame, &[face], &mut row)?;
                    // Whoever comes first is kept: ray k is the same in rows of any length.
                    kept[face as usize].get_or_init(|| row.clone().into_boxed_slice());
                    all.extend_from_slice(&row);
                    continue;
                }
            };
            all.extend_from_slice(&row[..per_face]);
        }
        Ok((all, rays))
    }

    /// Makes the rows of `vertices` that are not there yet. Gives back the number of rays.
    pub(super) fn prepare(&self, frame: &FrameSettings, vertices: &[u32], topology: &Topology) -> Result<u64> {
        if !self.walks() {
            return Ok(0);
        }
        let unscaled: Vec<u32> =
            vertices.iter().copied().filter(|&v| self.scales[v as usize].get().is_none()).collect();
        if unscaled.is_empty() {
            return Ok(0);
        }
        let neighbourhoods: Vec<Vec<u32>> = unscaled.par_iter().map(|&v| topology.second_ring(v)).collect();
        let mut missing: Vec<u32> =
            neighbourhoods.iter().flatten().copied().filter(|&v| self.rows[v as usize].get().is_none()).collect();
        missing.sort_unstable();
        missing.dedup();
        let rays = self.make_rows(frame, &missing, topology)?;
        unscaled.par_iter().zip(&neighbourhoods).for_each(|(&v, around)| {
            self.scales[v as usize].get_or_init(|| self.scale(v, around));
        });
        Ok(rays)
    }

    fn make_rows(&self, frame: &FrameSettings, missing: &[u32], topology: &Topology) -> Result<u64> {
        let tracer = self.tracer(0, topology)?;
        let rays: Vec<u64> = missing
            .par_chunks(CHUNK)
            .map(|chunk| {
                let mut exits = vec![NO_FACE; chunk.len() * WALKS];
                let mut weights = vec![0.0; exits.len() * 3];
                let rays = tracer.walks(frame, chunk, topology.around(), &mut exits, &mut weights)?;
                for ((&v, exits), weights) in
                    chunk.iter().zip(exits.chunks_exact(WALKS)).zip(weights.chunks_exact(3 * WALKS))
                {
                    self.rows[v as usize].get_or_init(|| row(exits, weights));
                }
                Ok(rays)
            })
            .collect::<Result<_>>()?;
        Ok(rays.iter().sum())
    }

    fn scale(&self, vertex: u32, around: &[u32]) -> [f32; 3] {
        let mut mean = [0.0; 3];
        for &v in around {
            let sum = self.sum(v);
            (0..3).for_each(|c| mean[c] += sum[c] / around.len() as f32);
        }
        let own = self.sum(vertex);
        std::array::from_fn(|c| if own[c] > 0.0 { mean[c] / own[c] } else { 0.0 })
    }

    fn sum(&self, vertex: u32) -> [f32; 3] {
        let mut sum = [0.0; 3];
        for source in self.sources(vertex) {
            (0..3).for_each(|c| sum[c] += source.weight[c]);
        }
        sum
    }

    /// Where a vertex gets its light from, unscaled; empty before [`Tissue::prepare`].
    pub(super) fn sources(&self, vertex: u32) -> &[Source] {
        self.rows[vertex as usize].get().map_or(&[], |r| r)
    }

    /// Light that comes out at a vertex, over its albedo and times pi. `received`: irradiance of a face.
    pub(super) fn light(&self, vertex: u32, received: impl Fn(u32) -> [f32; 3]) -> [f32; 3] {
        let mut light = [0.0; 3];
        for source in self.sources(vertex) {
            let irradiance = received(source.face);
            (0..3).for_each(|c| light[c] += source.weight[c] * irradiance[c]);
        }
        let scale = self.scales[vertex as usize].get().copied().unwrap_or([0.0; 3]);
        std::array::from_fn(|c| light[c] * scale[c])
    }
}

/// Walks that come out at the same face become one source.
fn row(exits: &[u32], weights: &[f32]) -> Box<[Source]> {
    let mut walks: Vec<Source> = exits
        .iter()
        .zip(weights.chunks_exact(3))
        .filter(|(face, _)| **face != NO_FACE)
        .map(|(&face, w)| Source { face, weight: [w[0], w[1], w[2]].map(|v| v / WALKS as f32) })
        .collect();
    // Stable: walks to one face are added in their order.
    walks.sort_by_key(|s| s.face);
    let mut row: Vec<Source> = Vec::new();
    for walk in walks {
        match row.last_mut().filter(|last| last.face == walk.face) {
            Some(last) => (0..3).for_each(|c| last.weight[c] += walk.weight[c]),
            None => row.push(walk),
        }
    }
    row.into_boxed_slice()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn walks_to_one_face_are_added() {
        let weights = [1.0, 2.0, 3.0, 10.0, 10.0, 10.0, 1.0, 1.0, 1.0, 9.0, 9.0, 9.0];
        let found = row(&[7, 3, 7, NO_FACE], &weights);
        let scale = 1.0 / WALKS as f32;
        assert_eq!(found.len(), 2);
        assert_eq!(found[0], Source { face: 3, weight: [10.0 * scale; 3] });
        assert_eq!(found[1], Source { face: 7, weight: [2.0 * scale, 3.0 * scale, 4.0 * scale] });
    }
}
