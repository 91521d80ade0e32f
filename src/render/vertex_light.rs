//! Light at the vertices that the camera sees: a radiosity solution on the faces from which light gets there.
//!
//! The light that other walls send (irradiance, all bounces) and the light that has scattered in the wall are smooth
//! over the surface, so they are computed once per vertex and interpolated; what is sharp (the lamp on an uncovered
//! base, the coat's glare, colour, edges) stays with the camera's samples. Recipe per frame:
//!
//! 1. The faces around the visible vertices each send some rays after the cosine law; the faces that these hit send
//!    fewer, and so on for [`DEPTH`] generations: the cost follows what is visible, not the size of the tree; of bright
//!    walls, for as long as there are new faces. Which faces hit which is found once at each end of the breath (`tissue.rs`) and weighted by the phase.
//! 2. Every face that a ray meets gets the lamp's irradiance in closed form (one shadow ray).
//! 3. Jacobi steps of `E = G (sent + R E)` along the recorded rays: all bounces, or as many as were asked for.
//! 4. Vertices take the mean of the faces around them; with light in the wall also their rows of `tissue.rs`.
//!
//! In symbols, per face: `E` irradiance by other walls, `R` its reflectance, `sent` the radiosity by the lamp's own
//! light ([`FaceLight`]), `G` the form factors that the recorded rays estimate, with each ray's [`Glint`].
//!
//! Approximations: faces reflect all they reflect as Lambert surfaces do (the coat's share too), light is even over a
//! face, and after the last generation only the lamp's light is sent on. `docs/decisions/0005-light-at-vertices.md` has
//! the bias.

use glam::{Mat3, Vec3};
use rayon::prelude::*;

use super::scene::Scene;
use super::settings::DRAFT_RAYS_PER_FACE;
use super::tissue::WalkedVertex;
use crate::base::{Error, Result};
use crate::ffi::trace::tracer::{FaceLight, FacePlace, FrameSettings, Glint, KnownLight, NO_FACE, ScatterExit};

/// Generations of faces that send rays between dark walls.
const DEPTH: usize = 4;
/// Divisor of the rays per face in the generations after the first.
const LATER_PART: u32 = 2;
/// Edges from a visible vertex over which its light is spread to vertices without any.
const SPREAD_EDGES: usize = 12;
/// Faces per task.
const CHUNK: usize = 64;
/// The solution has converged when a step changes the mean by no more than this fraction.
const CONVERGED: f64 = 1e-4;
/// And when the steps to come, as a geometric series, change it by no more than this one: bright walls converge slowly.
const CONVERGED_TAIL: f64 = 1e-3;
/// Most Jacobi steps: enough for closed walls of albedo .993. Brighter ones take minutes, white ones for ever.
const MOST_STEPS: u32 = 1024;

/// The solution.
pub(super) struct VertexLight {
    /// Per vertex, -1 for what is not known.
    pub known: Vec<KnownLight>,
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
    /// What the faces that the rays meet send along them.
    glints: Vec<Glint>,
}

impl Generation {
    fn len(&self) -> usize {
        self.hits.len() / self.weights.len()
    }
}

type Rgb = [f32; 3];

/// An uncoated face sends the same in all directions.
const EVEN: Glint = Glint { base: 1.0, coat: 0.0 };

/// Light at the vertices of the faces in `visible` ([`NO_FACE`] allowed, and repetitions). `rays_per_face` above 0.
pub(super) fn vertex_light(
    scene: &Scene,
    frame: &FrameSettings,
    visible: &[u32],
    rays_per_face: u32,
) -> Result<VertexLight> {
    let mut vertices = visible_vertices(scene, visible);
    let ends = scene.tissue.weighted_ends(scene.progress);
    let mut rays = 0;
    let mut faces = Faces::new(scene.topology.faces.len());
    vertices.iter().flat_map(|&v| scene.topology.faces_around(v)).for_each(|&f| faces.add(f));
    let mut lamp = lamp_on(scene, frame, &faces.list, &mut rays)?;
    // Where a camera sample's own scatter walk comes out, or its ray ends, only the light of other walls is asked for.
    let scatters = scene.tissue.scatters() && !frame.gathers;
    let walked = match scatters {
        true if rays_per_face <= DRAFT_RAYS_PER_FACE => {
            vertices.iter().map(|&vertex| WalkedVertex { vertex, share: None }).collect()
        }
        true => walked_vertices(scene, &vertices, visible, &faces, &lamp),
        false => Vec::new(),
    };
    for &(end, _) in &ends {
        rays += scene.tissue.prepare(frame, end, &walked, &scene.topology)?;
    }
    let mut generations = gather(scene, frame, &ends, &walked, rays_per_face, &mut faces, &mut rays)?;
    let met = lamp_on(scene, frame, &faces.list[lamp.len()..], &mut rays)?;
    lamp.extend(met);
    add_glints(scene, frame, &mut generations, &lamp)?;
    let irradiance = solve(frame, steps(scene, frame), &generations, &lamp)?;
    let solved = generations.iter().map(Generation::len).sum();
    let scattered =
        if scatters { scattered_light(scene, frame, &ends, &walked, &faces, &lamp, &irradiance)? } else { Vec::new() };
    let mut known = means_at_vertices(scene, &vertices, &scattered, &faces, &irradiance[..solved]);
    if frame.gathers {
        vertices =
            (0..scene.topology.vertex_count() as u32).filter(|&v| known[v as usize].irradiance[0] >= 0.0).collect();
    }
    sharpen(scene, &vertices, &mut known);
    spread(scene, &vertices, &mut known);
    Ok(VertexLight { known, rays })
}

/// Corners of the visible faces, each once.
fn visible_vertices(scene: &Scene, visible: &[u32]) -> Vec<u32> {
    let mut known = vec![false; scene.topology.vertex_count()];
    let mut list = Vec::new();
    for &face in visible.iter().filter(|f| **f != NO_FACE) {
        for v in scene.topology.faces[face as usize] {
            if !std::mem::replace(&mut known[v as usize], true) {
                list.push(v);
            }
        }
    }
    list
}

/// `vertices` with their shares of the frame's light: a pixel's is the lamp's irradiance on the face that it sees, a
/// third of it for each corner. `visible`: the face in every pixel; `lamp`: of the faces in it, at least.
fn walked_vertices(
    scene: &Scene,
    vertices: &[u32],
    visible: &[u32],
    faces: &Faces,
    lamp: &[FaceLight],
) -> Vec<WalkedVertex> {
    let mut light = vec![0.0; scene.topology.vertex_count()];
    let mut whole = 0.0;
    for &face in visible.iter().filter(|f| **f != NO_FACE) {
        let pixel = lamp[faces.place(face)].irradiance.iter().sum::<f32>();
        whole += f64::from(pixel);
        for v in scene.topology.faces[face as usize] {
            light[v as usize] += f64::from(pixel) / 3.0;
        }
    }
    let share = |v: u32| if whole > 0.0 { (light[v as usize] / whole) as f32 } else { 0.0 };
    vertices.iter().map(|&vertex| WalkedVertex { vertex, share: Some(share(vertex)) }).collect()
}

fn gather(
    scene: &Scene,
    frame: &FrameSettings,
    ends: &[(usize, f32)],
    walked: &[WalkedVertex],
    rays_per_face: u32,
    faces: &mut Faces,
    rays: &mut u64,
) -> Result<Vec<Generation>> {
    let mut generations: Vec<Generation> = Vec::new();
    let mut first = 0;
    for depth in 0..if scene.is_dark { DEPTH } else { usize::MAX } {
        let end = faces.list.len();
        if first == end {
            break;
        }
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
        if depth == 0 {
            let rows = walked.iter().flat_map(|&vertex| scene.tissue.rows(ends, vertex));
            rows.flat_map(|(row, _)| &row.exits).for_each(|exit| faces.add(exit.place.face));
        }
        let weights =
            ends.iter().flat_map(|&(_, part)| std::iter::repeat_n(part / per_face as f32, per_face)).collect();
        generations.push(Generation { first, weights, glints: vec![EVEN; hits.len()], hits });
        first = end;
    }
    for hit in generations.iter_mut().flat_map(|g| &mut g.hits).filter(|h| **h != NO_FACE) {
        *hit = faces.place[*hit as usize];
    }
    Ok(generations)
}

/// What the lamp does to every face.
fn lamp_on(scene: &Scene, frame: &FrameSettings, faces: &[u32], rays: &mut u64) -> Result<Vec<FaceLight>> {
    let parts: Vec<(Vec<FaceLight>, u64)> =
        faces.par_chunks(CHUNK).map(|chunk| scene.tracer.lamp_on(frame, chunk)).collect::<Result<_>>()?;
    *rays += parts.iter().map(|p| p.1).sum::<u64>();
    Ok(parts.into_iter().flat_map(|p| p.0).collect())
}

fn add_glints(scene: &Scene, frame: &FrameSettings, generations: &mut [Generation], lamp: &[FaceLight]) -> Result<()> {
    for generation in generations.iter_mut().filter(|g| !g.hits.is_empty()) {
        let to: Vec<u32> = (generation.first..generation.first + generation.len()).map(|p| p as u32).collect();
        let rays = CHUNK * generation.weights.len();
        to.par_chunks(CHUNK)
            .zip(generation.hits.par_chunks(rays))
            .zip(generation.glints.par_chunks_mut(rays))
            .try_for_each(|((to, from), glints)| scene.tracer.glints(frame, lamp, to, from, glints))?;
    }
    Ok(())
}

/// What a face sends to others: by its base alike in all directions, by its coat as a [`Glint`] says.
#[derive(Clone, Copy)]
struct Sent {
    base: Rgb,
    coat: Rgb,
}

/// How often light is sent on between walls; `None`: until nothing changes any more.
fn steps(scene: &Scene, frame: &FrameSettings) -> Option<u32> {
    // A gathered ray is a scattering of its own; a scatter walk and what it comes out of count as one.
    let own = if frame.gathers && !scene.tissue.scatters() { 2 } else { 1 };
    (frame.max_scatterings > 0).then(|| frame.max_scatterings.saturating_sub(own))
}

/// How a sum of light grows from step to step.
#[derive(Default)]
struct Convergence {
    total: f64,
    /// By how much the last step changed it.
    change: f64,
}

impl Convergence {
    /// Takes in the total after one more step; whether nothing worth a step is missing. With changes c that shrink by q
    /// the rest of the series is c q / (1 - q).
    fn reached(&mut self, total: f64) -> bool {
        let change = (total - self.total).abs();
        let last = std::mem::replace(&mut self.change, change);
        self.total = total;
        change <= CONVERGED * total && (change == 0.0 || change * change <= CONVERGED_TAIL * total * (last - change))
    }
}

/// Irradiance by other walls, per face: Jacobi steps of `E = G (sent + R E)`.
///
/// Errors: without a limit on the steps, walls so bright that the solution does not converge.
fn solve(
    frame: &FrameSettings,
    steps: Option<u32>,
    generations: &[Generation],
    lamp: &[FaceLight],
) -> Result<Vec<Rgb>> {
    let mut irradiance = vec![[0.0; 3]; lamp.len()];
    let mut progress = Convergence::default();
    for _ in 0..steps.unwrap_or(MOST_STEPS) {
        let sent: Vec<Sent> = irradiance
            .iter()
            .zip(lamp)
            .map(|(e, face)| Sent {
                base: std::array::from_fn(|c| face.sent[c] + face.reflectance[c] * e[c]),
                coat: std::array::from_fn(|c| face.mirrored_lamp * face.irradiance[c] + face.mirrored_other[c] * e[c]),
            })
            .collect();
        irradiance = step(frame, generations, &sent);
        let total: f64 = irradiance.iter().flatten().map(|&v| f64::from(v)).sum();
        if steps.is_none() && progress.reached(total) {
            return Ok(irradiance);
        }
    }
    if steps.is_some() {
        return Ok(irradiance);
    }
    Err(Error::input(
        "light between walls so bright does not settle at the vertices: darken them (`material.albedo`), or in a scene of \
         `render` limit max_scatterings or take transport \"paths\"",
    ))
}

/// One product with `G`: every face takes the weighted mean of what its rays bring.
fn step(frame: &FrameSettings, generations: &[Generation], sent: &[Sent]) -> Vec<Rgb> {
    let outside = frame.background.map(|v| v * std::f32::consts::PI);
    let mut next: Vec<Rgb> = Vec::with_capacity(sent.len());
    for generation in generations.iter().filter(|g| !g.hits.is_empty()) {
        debug_assert_eq!(generation.first, next.len());
        let rays = generation.weights.len();
        let received = |(hits, glints): (&[u32], &[Glint])| -> Rgb {
            let mut sum = [0.0; 3];
            for ((&hit, glint), &weight) in hits.iter().zip(glints).zip(&generation.weights) {
                if hit == NO_FACE {
                    (0..3).for_each(|c| sum[c] += weight * outside[c]);
                } else {
                    let Sent { base, coat } = &sent[hit as usize];
                    (0..3).for_each(|c| sum[c] += weight * (glint.base * base[c] + glint.coat * coat[c]));
                }
            }
            sum
        };
        next.par_extend(
            generation.hits.par_chunks_exact(rays).zip(generation.glints.par_chunks_exact(rays)).map(received),
        );
    }
    next.resize(sent.len(), [0.0; 3]);
    next
}

/// Light that has scattered in the wall below the vertices ([`KnownLight`] without the irradiance). Faces near the lamp
/// are not lit evenly: there the lamp's unshadowed irradiance is evaluated where a walk comes out; shadow and light
/// from other walls are taken as even over the face.
fn scattered_light(
    scene: &Scene,
    frame: &FrameSettings,
    ends: &[(usize, f32)],
    walked: &[WalkedVertex],
    faces: &Faces,
    lamp: &[FaceLight],
    irradiance: &[Rgb],
) -> Result<Vec<KnownLight>> {
    let lamp_on = |face: u32| &lamp[faces.place(face)];
    let at_face = |face: u32| -> ([f32; 3], Rgb) {
        let (lamp, indirect) = (lamp_on(face), irradiance[faces.place(face)]);
        (lamp.centre, std::array::from_fn(|c| lamp.irradiance[c] + indirect[c]))
    };
    let is_near = |exit: &&ScatterExit| lamp_on(exit.place.face).uneven;
    let chunk = |walked: &[WalkedVertex]| -> Result<Vec<KnownLight>> {
        // The lamp without shadows around the vertices, and where walks come out on faces near it.
        let vertices: Vec<u32> = walked.iter().map(|v| v.vertex).collect();
        let around = scene.tracer.unshadowed_around(frame, &vertices, &scene.topology.around())?;
        let rows = walked.iter().flat_map(|&vertex| scene.tissue.rows(ends, vertex));
        let near: Vec<FacePlace> =
            rows.flat_map(|(row, _)| &row.exits).filter(is_near).map(|exit| exit.place).collect();
        let at_exits = scene.tracer.unshadowed(frame, &near)?;
        let mut at_exits = at_exits.iter();
        // Rows of walks times light.
        let scattered = |(&vertex, around): (&WalkedVertex, &Rgb)| {
            let mut light = KnownLight::default();
            let slope = slope_around(scene, vertex.vertex, &at_face);
            for (row, part) in scene.tissue.rows(ends, vertex) {
                for (c, moment) in row.moments.iter().enumerate() {
                    light.scattered[c] -= part * dot(moment, &slope[c]);
                }
                for exit in &row.exits {
                    let face = exit.place.face;
                    let (lamp, indirect) = (lamp_on(face), irradiance[faces.place(face)]);
                    let own = scene.topology.faces[face as usize].contains(&vertex.vertex);
                    let sharp = if lamp.uneven { at_exits.next() } else { None };
                    for c in 0..3 {
                        let uneven = sharp.map_or(0.0, |sharp| sharp[c] - lamp.unshadowed[c]);
                        let weight = exit.weight[c] * part;
                        light.scattered[c] += weight * (lamp.irradiance[c] + indirect[c] + uneven);
                        light.nearby[c] += if own { weight } else { 0.0 };
                    }
                }
            }
            for c in 0..3 {
                light.scattered[c] = light.scattered[c].max(0.0);
                light.lamp_nearby[c] = light.nearby[c] * around[c];
            }
            light
        };
        Ok(walked.iter().zip(&around).map(scattered).collect())
    };
    let parts: Vec<Vec<KnownLight>> = walked.par_chunks(CHUNK).map(chunk).collect::<Result<_>>()?;
    Ok(parts.into_iter().flatten().collect())
}

/// How the irradiance changes along the surface at a vertex, per mm (xyz) and channel: the linear fit to the faces
/// around. `at`: a face's centre and irradiance.
fn slope_around(scene: &Scene, vertex: u32, at: &dyn Fn(u32) -> ([f32; 3], Rgb)) -> [[f32; 3]; 3] {
    /// Share of its trace that is added to the fit's matrix, which across the surface is nearly 0.
    const REGULAR: f32 = 0.02;
    let faces = scene.topology.faces_around(vertex);
    let each = 1.0 / faces.len() as f32;
    let (mut centre, mut mean) = (Vec3::ZERO, Vec3::ZERO);
    for &face in faces {
        let (place, light) = at(face);
        (centre, mean) = (centre + Vec3::from(place) * each, mean + Vec3::from(light) * each);
    }
    let (mut spread, mut rise) = (Mat3::ZERO, Mat3::ZERO);
    for &face in faces {
        let (place, light) = at(face);
        let way = Vec3::from(place) - centre;
        let above = Vec3::from(light) - mean;
        spread += Mat3::from_cols(way * way.x, way * way.y, way * way.z);
        rise += Mat3::from_cols(way * above.x, way * above.y, way * above.z);
    }
    let trace = spread.x_axis.x + spread.y_axis.y + spread.z_axis.z;
    if trace.is_nan() || trace <= 0.0 {
        return [[0.0; 3]; 3];
    }
    ((spread + Mat3::from_diagonal(Vec3::splat(REGULAR * trace))).inverse() * rise).to_cols_array_2d()
}

fn dot(a: &[f32; 3], b: &[f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Light at every vertex of the mesh. `scattered`: of `vertices`, or empty. `irradiance`: of the faces that have it.
fn means_at_vertices(
    scene: &Scene,
    vertices: &[u32],
    scattered: &[KnownLight],
    faces: &Faces,
    irradiance: &[Rgb],
) -> Vec<KnownLight> {
    let nothing = KnownLight { scattered: [-1.0; 3], irradiance: [-1.0; 3], ..KnownLight::default() };
    let mut known = vec![nothing; scene.topology.vertex_count()];
    for (k, &v) in vertices.iter().enumerate() {
        known[v as usize] = KnownLight { irradiance: [-1.0; 3], ..scattered.get(k).copied().unwrap_or_default() };
    }
    // Also outside the camera's view: the coat mirrors it, and gathered rays end there.
    let mut counts = vec![0u32; scene.topology.vertex_count()];
    for (&face, light) in faces.list.iter().zip(irradiance) {
        for v in scene.topology.faces[face as usize].map(|v| v as usize) {
            let sum = &mut known[v].irradiance;
            for c in 0..3 {
                sum[c] = if counts[v] == 0 { light[c] } else { sum[c] + light[c] };
            }
            counts[v] += 1;
        }
    }
    for (known, &count) in known.iter_mut().zip(&counts).filter(|(_, count)| **count > 0) {
        known.irradiance.iter_mut().for_each(|e| *e /= count as f32);
    }
    known
}

/// Channels of the two lights at a vertex that are sharpened and spread alike: scattered light, then irradiance.
const CHANNELS: usize = 6;
type VertexChannels = [f32; CHANNELS];

fn channels(known: &KnownLight) -> VertexChannels {
    std::array::from_fn(|c| if c < 3 { known.scattered[c] } else { known.irradiance[c - 3] })
}

fn set_channels(known: &mut KnownLight, values: VertexChannels) {
    known.scattered.copy_from_slice(&values[..3]);
    known.irradiance.copy_from_slice(&values[3..]);
}

/// Linear interpolation between vertices lies above a valley and below a crest, and means over the faces around a
/// vertex flatten both: second-order terms that the difference from the neighbours' mean takes off again, where all of
/// them are known. (Six neighbours at distance h: their mean is h^2/4 times the Laplacian off; interpolation h^2/16 on
/// average over a face, the mean over the faces around another 5/48 h^2.)
fn sharpen(scene: &Scene, vertices: &[u32], known: &mut [KnownLight]) {
    const SCATTERED: f32 = 1.0 / 2.0;
    const IRRADIANCE: f32 = 2.0 / 3.0;
    // Without the part that camera samples evaluate at their own point anyway (`KnownLight::lamp_nearby`).
    let blunt = |v: u32| -> VertexChannels {
        let values = &known[v as usize];
        let all = channels(values);
        std::array::from_fn(|c| if c < 3 { all[c] - values.lamp_nearby[c] } else { all[c] })
    };
    let sharp = |&v: &u32| -> VertexChannels {
        let own = channels(&known[v as usize]);
        let own_blunt = blunt(v);
        let (mut sum, mut count, mut all) = ([0.0; CHANNELS], 0.0, own.map(|v| v >= 0.0));
        for n in scene.topology.neighbours(v).filter(|&n| n != v) {
            let (blunt, known) = (blunt(n), channels(&known[n as usize]));
            for c in 0..CHANNELS {
                sum[c] += blunt[c];
                all[c] &= known[c] >= 0.0;
            }
            count += 1.0;
        }
        std::array::from_fn(|c| {
            let part = if c < 3 { SCATTERED } else { IRRADIANCE };
            if !all[c] || count == 0.0 {
                return own[c];
            }
            (own[c] + part * (own_blunt[c] - sum[c] / count)).clamp(0.5 * own[c], 1.5 * own[c])
        })
    };
    let sharpened: Vec<VertexChannels> = vertices.par_iter().map(sharp).collect();
    for (&v, values) in vertices.iter().zip(sharpened) {
        set_channels(&mut known[v as usize], values);
    }
}

/// Far down a lumen many faces share a pixel, but its central ray hits only one: a vertex without light takes the mean
/// of its known neighbours, over up to [`SPREAD_EDGES`] edges.
fn spread(scene: &Scene, vertices: &[u32], known: &mut [KnownLight]) {
    let mut edge = vertices.to_vec();
    for _ in 0..SPREAD_EDGES {
        let mut beyond: Vec<u32> = edge.iter().flat_map(|&v| scene.topology.neighbours(v)).collect();
        beyond.retain(|&v| known[v as usize].scattered[0] < 0.0);
        beyond.sort_unstable();
        beyond.dedup();
        let means: Vec<VertexChannels> = beyond.iter().map(|&v| mean_around(scene, v, known)).collect();
        for (&v, mean) in beyond.iter().zip(&means) {
            let own = channels(&known[v as usize]);
            let filled = std::array::from_fn(|c| if own[c] < 0.0 { mean[c] } else { own[c] });
            set_channels(&mut known[v as usize], filled);
        }
        edge = beyond;
    }
}

/// Means over the neighbours whose light is known; -1 where none is.
fn mean_around(scene: &Scene, vertex: u32, known: &[KnownLight]) -> VertexChannels {
    let (mut sum, mut count) = ([0.0; CHANNELS], [0u32; CHANNELS]);
    for n in scene.topology.neighbours(vertex) {
        for (c, value) in channels(&known[n as usize]).into_iter().enumerate() {
            if value >= 0.0 {
                sum[c] += value;
                count[c] += 1;
            }
        }
    }
    std::array::from_fn(|c| if count[c] > 0 { sum[c] / count[c] as f32 } else { -1.0 })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn series_of_bright_walls_go_on_until_little_is_missing() {
        for (albedo, most_steps) in [(0.5, 16), (0.8, 44), (0.99, 700)] {
            let (mut sum, mut term, mut convergence) = (0.0, 1.0, Convergence::default());
            let steps = (1..=MOST_STEPS).find(|_| {
                sum += term;
                term *= albedo;
                convergence.reached(sum)
            });
            let missing = 1.0 - sum * (1.0 - albedo);
            assert!(
                steps.is_some_and(|steps| steps <= most_steps) && missing < 1.1e-3,
                "{albedo}: {steps:?}, {missing}"
            );
        }
        let (mut white, mut nearly) = (Convergence::default(), Convergence::default());
        assert!((1..=MOST_STEPS).all(|step| !white.reached(f64::from(step))));
        assert!((1..=MOST_STEPS as i32).all(|step| !nearly.reached(1.0 - 0.999f64.powi(step))));
        // No light at all.
        assert!(Convergence::default().reached(0.0));
    }
}
