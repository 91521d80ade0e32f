//! Light at the vertices that the camera sees: a radiosity solution on the faces from which light gets there.
//!
//! The light that other walls send (irradiance, all bounces) and the light that has walked through the wall are smooth
//! over the surface, so they are found once per vertex and interpolated; what is sharp (the lamp on an uncovered base, the
//! coat's glare, colour, edges) stays with the camera's samples. Recipe per frame:
//!
//! 1. The faces around the seen vertices each send some rays after the cosine law; the faces that these meet send
//!    fewer, and so on for [`DEPTH`] generations: cost follows what can be seen, not the size of the tree. Which faces
//!    meet which is found once at either end of the breath (`tissue.rs`) and weighed by the phase.
//! 2. Every face met gets the lamp's irradiance in closed form (one shadow ray).
//! 3. Jacobi steps of `E = G (sent + R E)` along the recorded rays: all bounces, or as many as were asked for.
//! 4. Vertices take the mean of the faces around them; with light in the wall also their rows of `tissue.rs`.
//!
//! Approximations: faces reflect all
//! they reflect as Lambert surfaces do (the coat's share too), light is even over a face, and after the last generation
//! only the lamp's light is sent on. `docs/decisions/0005-light-at-vertices.md` has the bias.

use rayon::prelude::*;

use super::scene::Scene;
use super::tissue::Source;
use crate::base::Result;
use crate::ffi::trace::tracer::{FrameSettings, KNOWN_VALUES, LAMP_VALUES, NO_FACE};

/// Generations of faces that send rays.
const DEPTH: usize = 4;
/// Rays per face after the first generation, as a part of the first's.
const LATER_PART: u32 = 2;
/// Edges from a seen vertex over which its light stands for others'.
const SPREAD_EDGES: usize = 12;
/// Faces per task.
const CHUNK: usize = 64;
/// The solution is good when no step changes the mean by more than this part.
const CONVERGED: f64 = 1e-4;
/// Most steps (white walls converge slowly).
const MOST_STEPS: u32 = 256;

/// What was found.
pub(super) struct VertexLight {
    /// [`KNOWN_VALUES`] per vertex, -1 for what is not known.
    pub known: Vec<f32>,
    /// Rays it took.
    pub rays: u64,
}

/// The faces that take part, in the order in which they were found.
struct Faces {
    place: Vec<u32>,
    list: Vec<u32>,
}

impl Faces {
    fn new(count: usize) -> Self {
        Faces { place: vec![NO_FACE; count], list: Vec::new() }
    }

    fn add(&mut self, face: u32) {
        if self.place[face as usize] == NO_FACE {
            self.place[face as usize] = self.list.len() as u32;
            self.list.push(face);
        }
    }

    fn place(&self, face: u32) -> usize {
        self.place[face as usize] as usize
    }
}

/// The rays of one generation: those of face `first + k` meet the faces at the places
/// `hits[k * weights.len() .. (k + 1) * weights.len()]`, [`NO_FACE`] for none, and count as much as `weights` says.
struct Generation {
    first: usize,
    weights: Vec<f32>,
    hits: Vec<u32>,
    /// What base and coat of the faces that the rays meet send along them (`MeshTracer::glints`).
    parts: Vec<[f32; 2]>,
}

impl Generation {
    fn len(&self) -> usize {
        self.hits.len() / self.weights.len()
    }
}

type Rgb = [f32; 3];

/// Light at the vertices of the faces in `seen` ([`NO_FACE`] allowed, and repetitions). `rays_per_face` above 0.
pub(super) fn vertex_light(
    scene: &Scene,
    frame: &FrameSettings,
    seen: &[u32],
    rays_per_face: u32,
) -> Result<VertexLight> {
    let mut vertices = seen_vertices(scene, seen);
    let ends = scene.tissue.weighted_ends(scene.progress);
    // Where a camera sample's own walk comes out, or its ray ends, only the light of other walls is asked for.
    let walks = scene.tissue.walks() && !frame.gathers;
    let mut rays = 0;
    for &(end, _) in ends.iter().filter(|_| walks) {
        rays += scene.tissue.prepare(frame, end, &vertices, &scene.topology)?;
    }
    let mut faces = Faces::new(scene.topology.faces.len());
    vertices.iter().flat_map(|&v| scene.topology.faces_around(v)).for_each(|&f| faces.add(f));
    let mut generations = gather(scene, frame, &ends, &vertices, rays_per_face, &mut faces, &mut rays)?;
    let lamp = lamp(scene, frame, &faces.list, &mut rays)?;
    add_glints(scene, frame, &mut generations, &lamp)?;
    let irradiance = solve(frame, steps(scene, frame), &generations, &lamp);
    let solved = generations.iter().map(Generation::len).sum();
    let walked =
        if walks { walked_light(scene, frame, &ends, &vertices, &faces, &lamp, &irradiance)? } else { Vec::new() };
    let mut known = means_at_vertices(scene, &vertices, &walked, &faces, &irradiance, solved);
    if frame.gathers {
        vertices = (0..scene.topology.vertex_count() as u32).filter(|&v| is_lit(&known, v)).collect();
    }
    sharpen(scene, &vertices, &mut known);
    spread(scene, &vertices, &mut known);
    Ok(VertexLight { known, rays })
}

/// Corners of the seen faces, each once.
fn seen_vertices(scene: &Scene, seen: &[u32]) -> Vec<u32> {
    let mut known = vec![false; scene.topology.vertex_count()];
    let mut list = Vec::new();
    for &face in seen.iter().filter(|f| **f != NO_FACE) {
        for v in scene.topology.faces[face as usize] {
            if !std::mem::replace(&mut known[v as usize], true) {
                list.push(v);
            }
        }
    }
    list
}

fn gather(
    scene: &Scene,
    frame: &FrameSettings,
    ends: &[(usize, f32)],
    vertices: &[u32],
    rays_per_face: u32,
    faces: &mut Faces,
    rays: &mut u64,
) -> Result<Vec<Generation>> {
    let mut generations: Vec<Generation> = Vec::new();
    let mut first = 0;
    for depth in 0..DEPTH {
        let end = faces.list.len();
        let per_face = if depth == 0 { rays_per_face } else { rays_per_face.div_ceil(LATER_PART) } as usize;
        let met = |chunk: &[u32]| -> Result<(Vec<u32>, u64)> {
            let mut rays = 0;
            let mut of_ends = Vec::new();
            for &(shape, _) in ends {
                let (hits, traced) = scene.tissue.hits(frame, shape, chunk, per_face, &scene.topology)?;
                of_ends.push(hits);
                rays += traced;
            }
            let row = |k: usize| of_ends.iter().flat_map(move |hits| &hits[k * per_face..(k + 1) * per_face]).copied();
            Ok(((0..chunk.len()).flat_map(row).collect(), rays))
        };
        let parts: Vec<(Vec<u32>, u64)> = faces.list[first..end].par_chunks(CHUNK).map(met).collect::<Result<_>>()?;
        *rays += parts.iter().map(|p| p.1).sum::<u64>();
        let hits: Vec<u32> = parts.into_iter().flat_map(|p| p.0).collect();
        hits.iter().filter(|h| **h != NO_FACE).for_each(|&h| faces.add(h));
        if depth == 0 && !frame.gathers {
            for &(end, _) in ends {
                vertices.iter().flat_map(|&v| scene.tissue.sources(end, v)).for_each(|s| faces.add(s.face));
            }
        }
        let weights =
            ends.iter().flat_map(|&(_, part)| std::iter::repeat_n(part / per_face as f32, per_face)).collect();
        generations.push(Generation { first, weights, parts: vec![[1.0, 0.0]; hits.len()], hits });
        first = end;
    }
    for hit in generations.iter_mut().flat_map(|g| &mut g.hits).filter(|h| **h != NO_FACE) {
        *hit = faces.place[*hit as usize];
    }
    Ok(generations)
}

/// [`LAMP_VALUES`] per face.
fn lamp(scene: &Scene, frame: &FrameSettings, faces: &[u32], rays: &mut u64) -> Result<Vec<f32>> {
    let parts: Vec<(Vec<f32>, u64)> = faces
        .par_chunks(CHUNK)
        .map(|chunk| {
            let mut values = vec![0.0; chunk.len() * LAMP_VALUES];
            let rays = scene.tracer.lamp(frame, chunk, &mut values)?;
            Ok((values, rays))
        })
        .collect::<Result<_>>()?;
    *rays += parts.iter().map(|p| p.1).sum::<u64>();
    Ok(parts.into_iter().flat_map(|p| p.0).collect())
}

fn add_glints(scene: &Scene, frame: &FrameSettings, generations: &mut [Generation], lamp: &[f32]) -> Result<()> {
    for generation in generations.iter_mut().filter(|g| !g.hits.is_empty()) {
        let to: Vec<u32> = (generation.first..generation.first + generation.len()).map(|p| p as u32).collect();
        let rays = CHUNK * generation.weights.len();
        to.par_chunks(CHUNK)
            .zip(generation.hits.par_chunks(rays))
            .zip(generation.parts.par_chunks_mut(rays))
            .try_for_each(|((to, from), parts)| {
                scene.tracer.glints(frame, lamp, [to, from], parts.as_flattened_mut())
            })?;
    }
    Ok(())
}

/// What a face sends to others: by its base to all sides alike, by its coat as [`Generation::parts`] says.
#[derive(Clone, Copy)]
struct Sent {
    base: Rgb,
    coat: Rgb,
}

/// How often light is sent on between walls; `None`: until nothing changes any more.
fn steps(scene: &Scene, frame: &FrameSettings) -> Option<u32> {
    // A gathered ray is a scattering of its own; a walk and what it comes out of count as one.
    let own = if frame.gathers && !scene.tissue.walks() { 2 } else { 1 };
    (frame.max_scatterings > 0).then(|| frame.max_scatterings.saturating_sub(own))
}

/// Irradiance by other walls, per face.
fn solve(frame: &FrameSettings, steps: Option<u32>, generations: &[Generation], lamp: &[f32]) -> Vec<Rgb> {
    let mut irradiance = vec![[0.0; 3]; lamp.len() / LAMP_VALUES];
    let mut before = 0.0;
    for _ in 0..steps.unwrap_or(MOST_STEPS) {
        let sent: Vec<Sent> = irradiance
            .iter()
            .zip(lamp.chunks_exact(LAMP_VALUES))
            .map(|(e, l)| Sent {
                base: std::array::from_fn(|c| l[3 + c] + l[6 + c] * e[c]),
                coat: std::array::from_fn(|c| l[15] * l[c] + l[16] * e[c]),
            })
            .collect();
        irradiance = step(frame, generations, &sent);
        let total: f64 = irradiance.iter().flatten().map(|&v| f64::from(v)).sum();
        if steps.is_none() && (total - before).abs() <= CONVERGED * total {
            break;
        }
        before = total;
    }
    irradiance
}

fn step(frame: &FrameSettings, generations: &[Generation], sent: &[Sent]) -> Vec<Rgb> {
    let outside = frame.background.map(|v| v * std::f32::consts::PI);
    let mut next: Vec<Rgb> = Vec::with_capacity(sent.len());
    for generation in generations.iter().filter(|g| !g.hits.is_empty()) {
        debug_assert_eq!(generation.first, next.len());
        let rays = generation.weights.len();
        let received = |(hits, parts): (&[u32], &[[f32; 2]])| -> Rgb {
            let mut sum = [0.0; 3];
            for ((&hit, part), &weight) in hits.iter().zip(parts).zip(&generation.weights) {
                if hit == NO_FACE {
                    (0..3).for_each(|c| sum[c] += weight * outside[c]);
                } else {
                    let Sent { base, coat } = &sent[hit as usize];
                    (0..3).for_each(|c| sum[c] += weight * (part[0] * base[c] + part[1] * coat[c]));
                }
            }
            sum
        };
        next.par_extend(
            generation.hits.par_chunks_exact(rays).zip(generation.parts.par_chunks_exact(rays)).map(received),
        );
    }
    next.resize(sent.len(), [0.0; 3]);
    next
}

/// What a vertex sends by way of the wall, over its albedo and times pi.
#[derive(Clone, Copy, Default)]
struct Walked {
    light: Rgb,
    /// Part of the walks' light that comes out at the faces around the vertex.
    nearby: Rgb,
    /// `nearby` times the lamp's unshadowed irradiance there.
    lamp_nearby: Rgb,
}

impl Walked {
    fn known(&self, irradiance: Rgb) -> [f32; KNOWN_VALUES] {
        let parts = [self.light, irradiance, self.nearby, self.lamp_nearby];
        std::array::from_fn(|c| parts[c / 3][c % 3])
    }
}

/// Light that has walked to the vertices. Faces near the lamp are not lit evenly: there the lamp's unshadowed irradiance is
/// taken at the place where a walk comes out, and what else there is (shadow, other walls) as even.
fn walked_light(
    scene: &Scene,
    frame: &FrameSettings,
    ends: &[(usize, f32)],
    vertices: &[u32],
    faces: &Faces,
    lamp: &[f32],
    irradiance: &[Rgb],
) -> Result<Vec<Walked>> {
    let of_lamp = |face: u32| &lamp[faces.place(face) * LAMP_VALUES..][..LAMP_VALUES];
    let near = |source: &&Source| of_lamp(source.face)[20] > 0.0;
    let chunk = |vertices: &[u32]| -> Result<Vec<Walked>> {
        let mut around = vec![0.0; 3 * vertices.len()];
        scene.tracer.unshadowed_around(frame, vertices, scene.topology.around(), &mut around)?;
        let sources =
            || vertices.iter().flat_map(|&v| ends.iter().flat_map(move |&(end, _)| scene.tissue.sources(end, v)));
        let exits: Vec<u32> = sources().filter(near).map(|s| s.face).collect();
        let places: Vec<f32> = sources().filter(near).flat_map(|s| s.place).collect();
        let mut sharp = vec![0.0; 3 * exits.len()];
        scene.tracer.unshadowed(frame, &exits, &places, &mut sharp)?;
        let mut sharp = sharp.chunks_exact(3);
        let walked = |(&v, around): (&u32, &[f32])| {
            let mut found = Walked::default();
            for &(end, part) in ends {
                let scale = scene.tissue.scale_of(end, v).map(|s| s * part);
                for source in scene.tissue.sources(end, v) {
                    let (lamp, indirect) = (of_lamp(source.face), irradiance[faces.place(source.face)]);
                    let own = scene.topology.faces[source.face as usize].contains(&v);
                    let sharp = if near(&source) { sharp.next() } else { None };
                    for c in 0..3 {
                        let uneven = sharp.map_or(0.0, |sharp| sharp[c] - lamp[17 + c]);
                        let weight = source.weight[c] * scale[c];
                        found.light[c] += weight * (lamp[c] + indirect[c] + uneven);
                        found.nearby[c] += if own { weight } else { 0.0 };
                    }
                }
            }
            for c in 0..3 {
                found.light[c] = found.light[c].max(0.0);
                found.lamp_nearby[c] = found.nearby[c] * around[c];
            }
            found
        };
        Ok(vertices.iter().zip(around.chunks_exact(3)).map(walked).collect())
    };
    let parts: Vec<Vec<Walked>> = vertices.par_chunks(CHUNK).map(chunk).collect::<Result<_>>()?;
    Ok(parts.into_iter().flatten().collect())
}

/// [`KNOWN_VALUES`] per vertex of the mesh. `walked`: of `vertices`, or empty.
fn means_at_vertices(
    scene: &Scene,
    vertices: &[u32],
    walked: &[Walked],
    faces: &Faces,
    irradiance: &[Rgb],
    solved: usize,
) -> Vec<f32> {
    let nothing = Walked { light: [-1.0; 3], ..Walked::default() };
    let mut known = nothing.known([-1.0; 3]).repeat(scene.topology.vertex_count());
    for (k, &v) in vertices.iter().enumerate() {
        let walked = walked.get(k).copied().unwrap_or_default();
        known[v as usize * KNOWN_VALUES..][..KNOWN_VALUES].copy_from_slice(&walked.known([-1.0; 3]));
    }
    // Also where the camera does not look: the coat mirrors it, and rays are gathered from there.
    let mut counts = vec![0u32; scene.topology.vertex_count()];
    for (&face, light) in faces.list.iter().zip(irradiance).take(solved) {
        for v in scene.topology.faces[face as usize].map(|v| v as usize) {
            let sum = &mut known[v * KNOWN_VALUES + 3..][..3];
            for c in 0..3 {
                sum[c] = if counts[v] == 0 { light[c] } else { sum[c] + light[c] };
            }
            counts[v] += 1;
        }
    }
    for (v, &count) in counts.iter().enumerate().filter(|(_, count)| **count > 0) {
        known[v * KNOWN_VALUES + 3..][..3].iter_mut().for_each(|e| *e /= count as f32);
    }
    known
}

/// Whether light of other walls is known at a vertex.
fn is_lit(known: &[f32], vertex: u32) -> bool {
    known[vertex as usize * KNOWN_VALUES + 3] >= 0.0
}

/// Channels of light (walked light and irradiance) among the [`KNOWN_VALUES`].
const LIGHTS: usize = 6;

/// Linear interpolation between vertices lies above a valley and below a crest, and means over the faces around a vertex
/// flatten both: second-order terms that the difference from the neighbours' mean takes off again, where all of them are
/// known. (Six neighbours at distance h: their mean is h^2/4 times the Laplacian off; interpolation h^2/16 on average
/// over a face, the mean over the faces around another 5/48 h^2.)
fn sharpen(scene: &Scene, vertices: &[u32], known: &mut [f32]) {
    const WALKED: f32 = 1.0 / 2.0;
    const IRRADIANCE: f32 = 2.0 / 3.0;
    // What is not taken sharply anyway (`Walked::lamp_nearby`).
    let blunt = |v: u32| -> [f32; LIGHTS] {
        let values = &known[v as usize * KNOWN_VALUES..][..KNOWN_VALUES];
        std::array::from_fn(|c| if c < 3 { values[c] - values[9 + c] } else { values[c] })
    };
    let sharp = |&v: &u32| -> [f32; LIGHTS] {
        let own: [f32; LIGHTS] = std::array::from_fn(|c| known[v as usize * KNOWN_VALUES + c]);
        let own_blunt = blunt(v);
        let (mut sum, mut count, mut all) = ([0.0; LIGHTS], 0.0, own.map(|v| v >= 0.0));
        for n in scene.topology.neighbours(v).filter(|&n| n != v) {
            for (c, value) in blunt(n).into_iter().enumerate() {
                sum[c] += value;
                all[c] &= known[n as usize * KNOWN_VALUES + c] >= 0.0;
            }
            count += 1.0;
        }
        std::array::from_fn(|c| {
            let part = if c < 3 { WALKED } else { IRRADIANCE };
            if !all[c] || count == 0.0 {
                return own[c];
            }
            (own[c] + part * (own_blunt[c] - sum[c] / count)).clamp(0.5 * own[c], 1.5 * own[c])
        })
    };
    let sharpened: Vec<[f32; LIGHTS]> = vertices.par_iter().map(sharp).collect();
    for (&v, values) in vertices.iter().zip(&sharpened) {
        known[v as usize * KNOWN_VALUES..][..LIGHTS].copy_from_slice(values);
    }
}

/// Far down a lumen many faces share a pixel and its central ray sees one: what is not known takes the mean of its known
/// neighbours, some edges far.
fn spread(scene: &Scene, vertices: &[u32], known: &mut [f32]) {
    let mut edge = vertices.to_vec();
    for _ in 0..SPREAD_EDGES {
        let mut beyond: Vec<u32> = edge.iter().flat_map(|&v| scene.topology.neighbours(v)).collect();
        beyond.retain(|&v| known[v as usize * KNOWN_VALUES] < 0.0);
        beyond.sort_unstable();
        beyond.dedup();
        let means: Vec<[f32; LIGHTS]> = beyond.iter().map(|&v| mean_around(scene, v, known)).collect();
        for (&v, value) in beyond.iter().zip(&means) {
            for (c, own) in known[v as usize * KNOWN_VALUES..][..LIGHTS].iter_mut().enumerate() {
                if *own < 0.0 {
                    *own = value[c];
                }
            }
        }
        edge = beyond;
    }
}

/// Means over the neighbours of which something is known; -1 where of none.
fn mean_around(scene: &Scene, vertex: u32, known: &[f32]) -> [f32; LIGHTS] {
    let (mut sum, mut count) = ([0.0; LIGHTS], [0u32; LIGHTS]);
    for n in scene.topology.neighbours(vertex) {
        for (c, &value) in known[n as usize * KNOWN_VALUES..][..LIGHTS].iter().enumerate() {
            if value >= 0.0 {
                sum[c] += value;
                count[c] += 1;
            }
        }
    }
    std::array::from_fn(|c| if count[c] > 0 { sum[c] / count[c] as f32 } else { -1.0 })
}
