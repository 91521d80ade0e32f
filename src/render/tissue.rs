//! Light transport on the shapes at the two ends of the motion, fixed to the tissue: which faces a face's rays meet,
//! and where scatter walks through the wall come out. Both are made once, kept, and weighted by how far a shape is
//! between the two ends.
//!
//! The rows of walks, one per vertex and end, form a linear map from the light that falls on the faces to the light
//! that comes out at the vertex. Most of the noise of a few walks is in how much light survives and in how far to one
//! side it goes. Below a flat wall the means of both are known: the same random numbers walk there as well, and what
//! they are off is taken off the row ([`FlatWalks`]). Rows are not smoothed over their neighbours: how much light
//! survives follows the wall's curvature, by several per cent from a ridge to the hollow beside it.
//!
//! A row is made when a camera first sees its vertex or face, and serves every frame; it depends on the two shapes, the
//! material and the seed alone, and not on which frames came before. So noise does not flicker, and light changes
//! smoothly with the breath. Interpolating between the two ends is the approximation
//! (`docs/decisions/0005-light-at-vertices.md` has its size).

use std::sync::OnceLock;

use rayon::prelude::*;

use super::topology::Topology;
use crate::base::{Error, Result};
use crate::ffi::trace::tracer::{
    FlatWalks, FrameSettings, MaterialSettings, MeshTracer, NO_FACE, RestVertex, ScatterExit, SubsurfaceKind,
};

/// Scatter walks per vertex and end.
const WALKS: usize = 256;
/// Vertices per task.
const CHUNK: usize = 16;

/// Where one vertex gets its scattered light from.
pub(super) struct ScatterRow {
    /// Exits of the walks that come out. Weights are the parts of the irradiance there that come out at the vertex, over
    /// the vertex' albedo; their sum is free of the noise that the same walks have below a flat surface.
    pub exits: Box<[ScatterExit]>,
    /// Per channel the first moment (mm, xyz) by which the exits lie to one side by chance, as the same walks do below a
    /// flat surface.
    pub moments: [[f32; 3]; 3],
}

impl ScatterRow {
    fn new(walks: &[ScatterExit], flat: &FlatWalks) -> Self {
        let part = 1.0 / walks.len() as f32;
        let out = || walks.iter().filter(|walk| walk.place.face != NO_FACE);
        let scale: [f32; 3] = std::array::from_fn(|c| {
            let sum = out().map(|walk| walk.weight[c]).sum::<f32>() * part;
            if sum > 0.0 { (sum - flat.excess[c]).max(0.0) / sum } else { 0.0 }
        });
        let scaled = |walk: &ScatterExit| ScatterExit {
            weight: std::array::from_fn(|c| walk.weight[c] * part * scale[c]),
            ..*walk
        };
        let moments = std::array::from_fn(|c| std::array::from_fn(|k| flat.moments[3 * c + k] * scale[c]));
        ScatterRow { exits: out().map(scaled).collect(), moments }
    }
}

/// What the tracers of the two ends are built from.
pub(super) struct RestShape {
    /// What the look needs to know, per vertex.
    pub look: Vec<RestVertex>,
    /// The wall's material.
    pub material: MaterialSettings,
}

/// Hits and rows of both ends, computed when first needed.
pub(super) struct Tissue {
    rest: RestShape,
    ends: Vec<MotionEnd>,
}

/// One of the two ends of the motion, the first one being the shape at rest.
struct MotionEnd {
    /// xyz interleaved, in the tracer's world.
    vertices: Vec<f32>,
    tracer: OnceLock<Result<MeshTracer>>,
    hits: Vec<OnceLock<Box<[u32]>>>,
    rows: Vec<OnceLock<ScatterRow>>,
}

impl MotionEnd {
    fn new(vertices: Vec<f32>, topology: &Topology) -> Self {
        let (faces, count) = (topology.faces.len(), topology.vertex_count());
        MotionEnd { vertices, tracer: OnceLock::new(), hits: empty(faces), rows: empty(count) }
    }
}

fn empty<T>(count: usize) -> Vec<OnceLock<T>> {
    (0..count).map(|_| OnceLock::new()).collect()
}

impl Tissue {
    /// Nothing is traced yet. `vertices` of the shape at rest: xyz interleaved, in the tracer's world.
    pub(super) fn new(rest: RestShape, vertices: Vec<f32>, topology: &Topology) -> Self {
        Tissue { rest, ends: vec![MotionEnd::new(vertices, topology)] }
    }

    /// The shape at the other end of the motion.
    pub(super) fn set_other_end(&mut self, vertices: Vec<f32>, topology: &Topology) {
        self.ends.truncate(1);
        self.ends.push(MotionEnd::new(vertices, topology));
    }

    /// How far `vertices` are from rest to the other end: 0 to 1, 0 where there is no other end.
    pub(super) fn progress(&self, vertices: &[f32]) -> f64 {
        let [rest, other] = &self.ends[..] else { return 0.0 };
        let (mut along, mut whole) = (0.0, 0.0);
        for ((&r, &o), &v) in rest.vertices.iter().zip(&other.vertices).zip(vertices) {
            along += f64::from(v - r) * f64::from(o - r);
            whole += f64::from(o - r).powi(2);
        }
        if whole > 0.0 { (along / whole).clamp(0.0, 1.0) } else { 0.0 }
    }

    /// The ends that represent a shape, and their weights.
    pub(super) fn weighted_ends(&self, progress: f64) -> Vec<(usize, f32)> {
        let parts = [(0, 1.0 - progress as f32), (1, progress as f32)];
        parts.into_iter().filter(|&(_, part)| part > 0.0).collect()
    }

    /// Whether light scatters in the wall and leaves it elsewhere.
    pub(super) fn scatters(&self) -> bool {
        self.rest.material.subsurface == SubsurfaceKind::Diffuse
    }

    fn tracer(&self, end: usize, topology: &Topology) -> Result<&MeshTracer> {
        let end = &self.ends[end];
        let make = || {
            let RestShape { look, material } = &self.rest;
            // The look belongs to the shape at rest.
            let rest = &self.ends[0].vertices;
            let mut tracer = MeshTracer::new(rest, topology.faces.as_flattened(), look, material)?;
            tracer.update(&end.vertices)?;
            Ok(tracer)
        };
        end.tracer.get_or_init(make).as_ref().map_err(|e| Error::new(e.kind(), e.to_string()))
    }

    /// The faces that `per_face` rays from each of `faces` meet on the shape of `end`, [`NO_FACE`] where one leaves the
    /// mesh; and the number of rays that were traced for it.
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
                    // The first row made is kept: ray k is the same in rows of any length.
                    kept[face as usize].get_or_init(|| row.clone().into_boxed_slice());
                    all.extend_from_slice(&row);
                    continue;
                }
            };
            all.extend_from_slice(&row[..per_face]);
        }
        Ok((all, rays))
    }

    /// Makes the missing rows of `vertices` at `end`. Returns the number of rays.
    pub(super) fn prepare(
        &self,
        frame: &FrameSettings,
        end: usize,
        vertices: &[u32],
        topology: &Topology,
    ) -> Result<u64> {
        if !self.scatters() {
            return Ok(0);
        }
        let kept = &self.ends[end];
        let missing: Vec<u32> = vertices.iter().copied().filter(|&v| kept.rows[v as usize].get().is_none()).collect();
        if missing.is_empty() {
            return Ok(0);
        }
        let tracer = self.tracer(end, topology)?;
        let rays: Vec<u64> = missing
            .par_chunks(CHUNK)
            .map(|chunk| {
                let walks = tracer.scatter_walks(frame, chunk, &topology.around(), WALKS)?;
                let exits = walks.exits.chunks_exact(WALKS);
                for ((&v, exits), flat) in chunk.iter().zip(exits).zip(&walks.flat) {
                    kept.rows[v as usize].get_or_init(|| ScatterRow::new(exits, flat));
                }
                Ok(walks.rays)
            })
            .collect::<Result<_>>()?;
        Ok(rays.iter().sum())
    }

    /// Where a vertex gets its light from at `end`; `None` before [`Tissue::prepare`].
    pub(super) fn row(&self, end: usize, vertex: u32) -> Option<&ScatterRow> {
        self.ends[end].rows[vertex as usize].get()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ffi::trace::tracer::FacePlace;

    #[test]
    fn a_row_holds_what_comes_out_freed_of_the_flat_walks_noise() {
        let nowhere = ScatterExit { place: FacePlace { face: NO_FACE, u: 0.25, v: 0.25 }, weight: [0.0; 3] };
        let mut walks = vec![nowhere; 4];
        let flat = FlatWalks { excess: [0.25, -0.5, 1.0], moments: [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0] };
        assert!(ScatterRow::new(&walks, &flat).exits.is_empty());
        let place = FacePlace { face: 7, u: 0.25, v: 0.25 };
        walks[3] = ScatterExit { place, weight: [4.0, 2.0, 2.0] };
        let row = ScatterRow::new(&walks, &flat);
        // Of the sums 1, 0.5 and 0.5 the excess is taken off; no light is less than none.
        assert_eq!(*row.exits, [ScatterExit { place, weight: [0.75, 1.0, 0.0] }]);
        assert_eq!(row.moments, [[0.75, 1.5, 2.25], [8.0, 10.0, 12.0], [0.0; 3]]);
    }
}
