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
//! smoothly with the breath. A frame's mean hangs on the hundred vertices nearest to the scope: a vertex has rows of
//! three sizes, and the larger its share in a frame, the larger the row that is used ([`WalkedVertex`]), with a smooth
//! passage from one to the next. Interpolating between the two ends is the approximation
//! (`docs/decisions/0005-light-at-vertices.md` has its size).

use std::sync::OnceLock;

use glam::Vec3;
use rayon::prelude::*;

use super::topology::Topology;
use crate::base::{Error, Result};
use crate::ffi::trace::tracer::{
    FacePlace, FlatWalks, FrameSettings, MaterialSettings, MeshTracer, NO_FACE, RestVertex, ScatterExit, SubsurfaceKind,
};

/// Scatter walks of the rows of a vertex at one end, by level: that of drafts, and three by the vertex' share of the light.
const WALKS: [usize; 4] = [32, 256, 1024, 4096];
/// The lowest level that is no draft.
const LOWEST_LEVEL: usize = 1;
/// Share of a frame's light up to which a vertex takes the lowest level; four times as much takes the next. A hundred
/// vertices with a hundredth of the light each then have 2000 walks each, which leaves the frame's mean a noise of .2 %.
const LOWEST_LEVEL_SHARE: f32 = 1.0 / 800.0;
/// Walks per task.
const WALKS_AT_ONCE: usize = 4096;

/// A vertex that takes its scattered light from rows of walks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct WalkedVertex {
    /// Its number in the mesh.
    pub vertex: u32,
    /// About which part of the frame's light the camera sees around it, 0 to 1; `None` in a draft.
    pub share: Option<f32>,
}

impl WalkedVertex {
    /// The levels of rows that the vertex takes, and their weights, which sum to 1.
    fn levels(&self) -> impl Iterator<Item = (usize, f32)> + use<> {
        let highest = (WALKS.len() - 1 - LOWEST_LEVEL) as f32;
        let above_lowest = |share: f32| (0.5 * (share / LOWEST_LEVEL_SHARE).log2()).clamp(0.0, highest);
        let (low, part) = self.share.map_or((0, 0.0), |share| {
            let level = above_lowest(share);
            (LOWEST_LEVEL + level as usize, level.fract())
        });
        [(low, 1.0 - part), (low + 1, part)].into_iter().filter(|&(_, part)| part > 0.0)
    }
}

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
        ScatterRow { exits: merged(out().map(scaled).collect()), moments }
    }
}

/// The exits with those in one quarter of a face made one, at the mean of their places: what they are multiplied with
/// changes little over a quarter of a face, and there are many.
fn merged(mut exits: Vec<ScatterExit>) -> Box<[ScatterExit]> {
    // The three at the corners, and the middle one.
    let quarter = |place: &FacePlace| match (place.u, place.v) {
        (u, _) if u > 0.5 => 1,
        (_, v) if v > 0.5 => 2,
        (u, v) if u + v < 0.5 => 0,
        _ => 3,
    };
    let key = |exit: &ScatterExit| (exit.place.face, quarter(&exit.place));
    let mass = |exit: &ScatterExit| exit.weight.iter().sum::<f32>();
    exits.retain(|exit| mass(exit) > 0.0);
    exits.sort_by_key(key);
    let one = |group: &[ScatterExit]| {
        let whole: f32 = group.iter().map(mass).sum();
        let mean = |of: fn(&FacePlace) -> f32| group.iter().map(|exit| mass(exit) / whole * of(&exit.place)).sum();
        ScatterExit {
            place: FacePlace { face: group[0].place.face, u: mean(|place| place.u), v: mean(|place| place.v) },
            weight: std::array::from_fn(|c| group.iter().map(|exit| exit.weight[c]).sum()),
        }
    };
    exits.chunk_by(|a, b| key(a) == key(b)).map(one).collect()
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
    /// By level and vertex; a level that no frame takes has no vertices.
    rows: [OnceLock<Vec<OnceLock<ScatterRow>>>; WALKS.len()],
}

impl MotionEnd {
    fn new(vertices: Vec<f32>, topology: &Topology) -> Self {
        let faces = topology.faces.len();
        MotionEnd { vertices, tracer: OnceLock::new(), hits: empty(faces), rows: Default::default() }
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

    /// Normal of a face as wound, not normalised, at `progress` on the way to the other end.
    pub(super) fn face_normal(&self, corners: [u32; 3], progress: f64) -> Vec3 {
        let place = |vertices: &[f32], v: u32| Vec3::from_slice(&vertices[3 * v as usize..]);
        let [a, b, c] = corners.map(|v| {
            let rest = place(&self.ends[0].vertices, v);
            self.ends.get(1).map_or(rest, |other| rest.lerp(place(&other.vertices, v), progress as f32))
        });
        (b - a).cross(c - a)
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

    /// Makes the rows of `vertices` at `end` that are missing. Returns the number of rays.
    pub(super) fn prepare(
        &self,
        frame: &FrameSettings,
        end: usize,
        vertices: &[WalkedVertex],
        topology: &Topology,
    ) -> Result<u64> {
        if !self.scatters() {
            return Ok(0);
        }
        let mut rays = 0;
        for (level, (&walks, kept)) in WALKS.iter().zip(&self.ends[end].rows).enumerate() {
            let takes = |v: &&WalkedVertex| v.levels().any(|(taken, _)| taken == level);
            let all = vertices.iter().filter(takes).map(|v| v.vertex);
            if all.clone().next().is_none() {
                continue;
            }
            let kept = kept.get_or_init(|| empty(topology.vertex_count()));
            let missing: Vec<u32> = all.filter(|&v| kept[v as usize].get().is_none()).collect();
            if missing.is_empty() {
                continue;
            }
            let tracer = self.tracer(end, topology)?;
            let make = |chunk: &[u32]| {
                let walked = tracer.scatter_walks(frame, chunk, &topology.around(), walks)?;
                for ((&v, exits), flat) in chunk.iter().zip(walked.exits.chunks_exact(walks)).zip(&walked.flat) {
                    kept[v as usize].get_or_init(|| ScatterRow::new(exits, flat));
                }
                Ok(walked.rays)
            };
            rays +=
                missing.par_chunks(WALKS_AT_ONCE / walks).map(make).collect::<Result<Vec<u64>>>()?.iter().sum::<u64>();
        }
        Ok(rays)
    }

    /// Where a vertex gets its light from on the shape that `ends` represent: rows and their weights. None before
    /// [`Tissue::prepare`].
    pub(super) fn rows(&self, ends: &[(usize, f32)], vertex: WalkedVertex) -> impl Iterator<Item = (&ScatterRow, f32)> {
        let of_end = move |&(end, of_end): &(usize, f32)| {
            let row = move |(level, part): (usize, f32)| {
                let row = self.ends[end].rows[level].get()?[vertex.vertex as usize].get();
                row.map(|row| (row, part * of_end))
            };
            vertex.levels().filter_map(row)
        };
        ends.iter().flat_map(of_end)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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

    #[test]
    fn a_quarter_of_a_face_has_one_exit_that_carries_all() {
        let exit = |face, u, v, weight| ScatterExit { place: FacePlace { face, u, v }, weight: [weight; 3] };
        let exits =
            vec![exit(2, 0.75, 0.0, 1.0), exit(1, 0.25, 0.125, 2.0), exit(2, 1.0, 0.0, 3.0), exit(2, 0.5, 0.5, 4.0)];
        // In the order of the faces; places are means by weight.
        let expected = [exit(1, 0.25, 0.125, 2.0), exit(2, 0.9375, 0.0, 4.0), exit(2, 0.5, 0.5, 4.0)];
        assert_eq!(*merged(exits), expected);
    }

    #[test]
    fn walks_grow_with_the_share_and_pass_smoothly_from_level_to_level() {
        let of = |share| WalkedVertex { vertex: 0, share }.levels().map(|(level, part)| (WALKS[level], part));
        let walks = |share| of(Some(share)).collect::<Vec<_>>();
        assert_eq!(walks(0.0), [(256, 1.0)]);
        assert_eq!(walks(LOWEST_LEVEL_SHARE), [(256, 1.0)]);
        assert_eq!(walks(2.0 * LOWEST_LEVEL_SHARE), [(256, 0.5), (1024, 0.5)]);
        assert_eq!(walks(4.0 * LOWEST_LEVEL_SHARE), [(1024, 1.0)]);
        assert_eq!(walks(1.0), [(4096, 1.0)]);
        assert_eq!(of(None).collect::<Vec<_>>(), [(32, 1.0)]);
    }
}
