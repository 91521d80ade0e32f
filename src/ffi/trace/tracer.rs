//! The path tracer's hot part: C++ (`cpp/trace/tracer.cpp`) on Embree 4 through cxx. Every call takes whole arrays (a
//! tile of pixels, a chunk of faces or vertices); `docs/decisions/0002-path-tracer-in-cpp.md` says why.
//!
//! Embree wants flush-to-zero while it runs and Rust assumes the default floating-point mode: the C++ side sets and
//! restores it inside each call.
//!
//! Colours are linear RGB, lengths mm. A place in a face is given by the barycentric weights `u` and `v` of its second
//! and third corner.

use cxx::UniquePtr;

use crate::base::{Error, ErrorKind, Result};
use crate::ffi::isa::Isa;

pub use bridge::{
    FaceLight, FacePlace, FacesAround, FilmPixel, FlatWalks, FrameSettings, Glint, GradientNoise, KnownLight,
    MaterialSettings, NoiseNeighbour, ProbedPoint, RestVertex, ScatterExit, SubsurfaceKind, TileCounters, TileRequest,
};

#[allow(unused_qualifications)] // cxx spells its generated derives in full
#[cxx::bridge(namespace = "respire")]
mod bridge {
    /// How the light that enters the wall leaves it.
    #[derive(Clone, Copy, Debug)]
    enum SubsurfaceKind {
        /// Where it enters.
        Off,
        /// After scattering below a diffuse boundary.
        Diffuse,
        /// After scattering below a boundary of the same refractive index on both sides.
        Matched,
    }

    /// What the wall is made of.
    #[derive(Clone, Copy, Debug, PartialEq)]
    struct MaterialSettings {
        /// Procedural albedo, film and relief on the rest shape.
        mucosa: bool,
        /// GGX coat over the Lambert base.
        coated: bool,
        /// Albedo of the base.
        albedo: [f32; 3],
        /// Roughness (GGX alpha) where the film is smoothest.
        alpha_low: f32,
        /// Roughness where it is roughest; equal to `alpha_low` for an even coat.
        alpha_high: f32,
        /// Refractive index of the coat.
        ior: f32,
        /// Strength of the vessels.
        vessels: f32,
        /// Strength of colour unevenness.
        blotches: f32,
        /// Strength of fine relief.
        relief: f32,
        /// Strength of the roughness variation.
        film: f32,
        /// Strength of cartilage rings.
        rings: f32,
        /// Distance between two rings in mm.
        ring_spacing_mm: f32,
        /// Strength of lengthwise folds.
        folds: f32,
        /// Strength of the pale edges of ridges.
        spurs: f32,
        /// Strength of dark patches of soot.
        anthracosis: f32,
        /// Seed of the pattern.
        seed: u32,
        /// Light in the wall.
        subsurface: SubsurfaceKind,
        /// Light scatters in the wall at every vertex of a path instead of the first alone.
        walk_at_every_vertex: bool,
        /// Part of the scatter walks that starts refracted through a rough surface of index `ior` instead of by the
        /// cosine law.
        refracted_entry: f32,
        /// Extinction in the wall, per mm.
        extinction: [f32; 3],
        /// `scattering` holds everywhere; otherwise it follows from the diffuse albedo.
        fixed_scattering: bool,
        /// Single-scattering albedo.
        scattering: [f32; 3],
    }

    /// What the look needs to know of the shape at rest at one vertex.
    #[derive(Clone, Copy, Debug, Default, PartialEq)]
    struct RestVertex {
        /// Generation of the airway, 0 for the trachea; may be fractional.
        generation: f32,
        /// Distance along the airway in mm.
        axial_mm: f32,
        /// From the middle of the airway to the vertex, across the airway, in mm.
        section_mm: [f32; 3],
        /// Mean curvature (1 / mm) of a wall that stands out into the lumen, else 0.
        ridge_per_mm: f32,
    }

    /// Camera, light and limits of one frame, in the tracer's (shifted) world.
    #[derive(Clone, Copy, Debug, PartialEq)]
    struct FrameSettings {
        /// Image width in pixels.
        width: u32,
        /// Image height in pixels.
        height: u32,
        /// Camera position.
        origin: [f32; 3],
        /// World-from-camera rotation, row-major.
        rotation: [f32; 9],
        /// Light position.
        light: [f32; 3],
        /// The light sits at the camera: what the camera sees needs no shadow ray.
        light_at_camera: bool,
        /// Radiant intensity, W/sr per channel.
        intensity: [f32; 3],
        /// It falls with this power of the cosine to the camera's axis; 0 = even.
        emission_exponent: f32,
        /// Radiance of rays that leave the scene.
        background: [f32; 3],
        /// Surface scatterings of the longest path, direct light = 1; 0 = unlimited.
        max_scatterings: u32,
        /// Interpolated instead of geometric normals.
        smooth: bool,
        /// The light at vertices is used where a camera sample's first ray or scatter walk ends, not where the camera
        /// looks.
        gathers: bool,
        /// Radians that a pixel spans.
        pixel_angle: f32,
        /// Key of the sample sequences (seed and frame).
        key: u32,
        /// Key of the samples that lie on the tissue (seed).
        pattern_key: u32,
    }

    /// Pixels `x0..x1` x `y0..y1` and the samples to take of each.
    #[derive(Clone, Copy, Debug, PartialEq)]
    struct TileRequest {
        /// First column.
        x0: u32,
        /// One past the last column.
        x1: u32,
        /// First row.
        y0: u32,
        /// One past the last row.
        y1: u32,
        /// Index of the first sample.
        first_sample: u32,
        /// Number of samples per pixel.
        samples: u32,
    }

    /// Work done for a tile.
    #[derive(Clone, Copy, Debug, Default, PartialEq)]
    struct TileCounters {
        /// Camera samples.
        paths: u64,
        /// Rays of all kinds.
        rays: u64,
        /// Samples thrown away because they were negative or not finite; a flaw if ever above 0.
        rejected: u64,
    }

    /// Sums over a pixel's samples.
    #[derive(Clone, Copy, Debug, Default, PartialEq)]
    struct FilmPixel {
        /// The lamp's own light.
        direct: [f32; 3],
        /// All other light.
        indirect: [f32; 3],
        /// The part of `indirect` that the base sends, over its albedo.
        indirect_base: [f32; 3],
        /// The part of `indirect` that the coat mirrors.
        indirect_coat: [f32; 3],
        /// Albedo of the base.
        albedo: [f32; 3],
        /// Smooth normal, world axes.
        normal: [f32; 3],
        /// Samples that have hit the wall.
        hits: f32,
    }

    /// Light at a vertex; negative where it is not known.
    #[derive(Clone, Copy, Debug, Default, PartialEq)]
    struct KnownLight {
        /// Light that the base sends after scattering in the wall, over its albedo and times pi.
        scattered: [f32; 3],
        /// Irradiance by other walls.
        irradiance: [f32; 3],
        /// Part of the scatter walks' light that comes out at the faces around the vertex, over the albedo.
        nearby: [f32; 3],
        /// That part times the lamp's unshadowed irradiance around the vertex.
        lamp_nearby: [f32; 3],
    }

    /// The lamp's light on a face, and how the face reflects light.
    #[derive(Clone, Copy, Debug, Default, PartialEq)]
    struct FaceLight {
        /// The lamp's irradiance.
        irradiance: [f32; 3],
        /// The part of it that the base reflects (radiosity).
        sent: [f32; 3],
        /// Fraction of other light that is reflected alike in all directions.
        reflectance: [f32; 3],
        /// Centre.
        centre: [f32; 3],
        /// Normal there.
        normal: [f32; 3],
        /// What the coat mirrors of the lamp's irradiance, over [`Glint::coat`].
        mirrored_lamp: f32,
        /// The same of other light.
        mirrored_other: [f32; 3],
        /// The lamp's irradiance without shadows.
        unshadowed: [f32; 3],
        /// The face is so near the lamp that its light is not even over it.
        uneven: bool,
    }

    /// What a face sends along a ray.
    #[derive(Clone, Copy, Debug, Default, PartialEq)]
    struct Glint {
        /// By its base, over the mean of all directions (under a coat, less at grazing angles).
        base: f32,
        /// By its coat, of light from the lamp's side: radiance times pi, over the irradiance from there.
        coat: f32,
    }

    /// A place in a face.
    #[derive(Clone, Copy, Debug, Default, PartialEq)]
    struct FacePlace {
        /// The face, or [`NO_FACE`].
        face: u32,
        /// Weight of its second corner.
        u: f32,
        /// Weight of its third corner.
        v: f32,
    }

    /// Where a scatter walk comes out of the wall.
    #[derive(Clone, Copy, Debug, Default, PartialEq)]
    struct ScatterExit {
        /// The place; [`NO_FACE`] where none of its light comes out.
        place: FacePlace,
        /// What is left of its light, over the albedo where it began.
        weight: [f32; 3],
    }

    /// What a vertex' scatter walks bring out of a flat wall, where their means are known: noise that they share with
    /// those through the mesh.
    #[derive(Clone, Copy, Debug, Default, PartialEq)]
    struct FlatWalks {
        /// Light over the albedo, less its known mean, per channel.
        excess: [f32; 3],
        /// Per channel the first moment of the places where it comes out, light over the albedo times mm (xyz
        /// interleaved), about the mean place of the starts, long ways shortened: 0 in the mean.
        moments: [f32; 9],
    }

    /// The faces around every vertex: those of vertex v are `faces[offsets[v]..offsets[v + 1]]`.
    #[derive(Clone, Copy, Debug)]
    struct FacesAround<'a> {
        /// One per vertex, and the end.
        offsets: &'a [u32],
        /// Faces, vertex after vertex.
        faces: &'a [u32],
    }

    /// What a camera ray hits.
    #[derive(Clone, Copy, Debug, Default, PartialEq)]
    struct ProbedPoint {
        /// The place; [`NO_FACE`] at a miss.
        place: FacePlace,
        /// Albedo of the base.
        albedo: [f32; 3],
    }

    /// Gradient noise at a point.
    #[derive(Clone, Copy, Debug, PartialEq)]
    struct GradientNoise {
        /// Value, in about [-1, 1].
        value: f32,
        /// Its gradient.
        gradient: [f32; 3],
    }

    /// A point of the jittered lattice.
    #[derive(Clone, Copy, Debug, Default, PartialEq)]
    struct NoiseNeighbour {
        /// Relative to the cell that the asking point lies in.
        place: [f32; 3],
        /// Squared distance from the asking point.
        distance2: f32,
        /// Hash that names its cell.
        cell: u32,
    }

    // SAFETY: the functions check lengths, faces and vertices before they read or write (`require` in
    // `cpp/trace/tracer.cpp`) and throw where they do not fit, which becomes an `Err`; none keeps a pointer (the mesh is
    // copied) or calls back into Rust. `Tracer` owns its Embree objects; its const functions only read them, each with
    // rays and samplers of its own. `coat_albedo` and `medium_albedo` compute and throw nothing.
    unsafe extern "C++" {
        include!("cpp/trace/tracer.h");

        type Tracer;

        fn new_tracer(
            vertices: &[f32],
            faces: &[u32],
            rest: &[RestVertex],
            material: &MaterialSettings,
        ) -> Result<UniquePtr<Tracer>>;
        fn update(self: Pin<&mut Tracer>, vertices: &[f32]) -> Result<()>;
        fn refit(self: Pin<&mut Tracer>) -> Result<()>;

        fn trace_tile(
            self: &Tracer,
            frame: &FrameSettings,
            tile: &TileRequest,
            corners: &[f32],
            known: &[KnownLight],
            film: &mut [FilmPixel],
        ) -> Result<TileCounters>;
        fn probe_depth(
            self: &Tracer,
            frame: &FrameSettings,
            directions: &[f32],
            distances: &mut [f32],
            faces: &mut [u32],
        ) -> Result<()>;
        fn probe(self: &Tracer, frame: &FrameSettings, directions: &[f32], points: &mut [ProbedPoint]) -> Result<()>;
        fn cast(self: &Tracer, origins: &[f32], directions: &[f32], distances: &mut [f32]) -> Result<()>;

        fn lamp_on_faces(self: &Tracer, frame: &FrameSettings, faces: &[u32], light: &mut [FaceLight]) -> Result<u64>;
        fn glints(
            self: &Tracer,
            frame: &FrameSettings,
            light: &[FaceLight],
            to: &[u32],
            from: &[u32],
            glints: &mut [Glint],
        ) -> Result<()>;
        fn gather(self: &Tracer, frame: &FrameSettings, faces: &[u32], hits: &mut [u32]) -> Result<u64>;
        fn scatter_walks(
            self: &Tracer,
            frame: &FrameSettings,
            vertices: &[u32],
            around: &FacesAround,
            exits: &mut [ScatterExit],
            flat: &mut [FlatWalks],
        ) -> Result<u64>;
        fn unshadowed(self: &Tracer, frame: &FrameSettings, places: &[FacePlace], irradiance: &mut [f32])
        -> Result<()>;
        fn unshadowed_around(
            self: &Tracer,
            frame: &FrameSettings,
            vertices: &[u32],
            around: &FacesAround,
            irradiance: &mut [f32],
        ) -> Result<()>;

        fn coat_albedo(alpha: f32, ior: f32, cosine: f32) -> f32;
        fn medium_albedo(rho: f32) -> f32;
        fn sobol_pair(key: u32, index: u32, dimension: u32, pair: &mut [f32]) -> Result<()>;
        fn gradient_noise(isa: u8, point: &[f32], seed: u32) -> Result<GradientNoise>;
        fn noise_neighbours(isa: u8, point: &[f32], seed: u32, nearest: &mut [NoiseNeighbour]) -> Result<()>;
    }
}

/// The face index where nothing was hit.
pub const NO_FACE: u32 = u32::MAX;

/// Scatter walks through the wall, the same number for every vertex.
#[derive(Clone, Debug, Default)]
pub struct ScatterWalks {
    /// Vertex after vertex.
    pub exits: Vec<ScatterExit>,
    /// Per vertex: the mean weight of the same walks below a flat surface, less its known value.
    pub flat: Vec<FlatWalks>,
    /// Rays that it took.
    pub rays: u64,
}

/// One triangle mesh, its material and its bounding volume hierarchy.
pub struct MeshTracer(UniquePtr<bridge::Tracer>);

// SAFETY: the C++ object has no thread affinity: Embree's handles may be used and released on any thread, and the
// floating-point mode, which belongs to a thread, is set and restored inside each call.
unsafe impl Send for MeshTracer {}
// SAFETY: what `&self` reaches are const functions without `mutable` members behind them, which only read the object;
// Embree allows concurrent traversal of a committed scene. `update` and `refit`, which commit it, need `&mut`.
unsafe impl Sync for MeshTracer {}

fn failed(e: cxx::Exception) -> Error {
    Error::new(ErrorKind::Environment, format!("the path tracer failed: {e}"))
}

impl MeshTracer {
    /// Builds the hierarchy. `vertices` xyz interleaved in mm, three indices per face, one record per vertex.
    /// Fails on lengths that do not fit, and where Embree refuses.
    pub fn new(vertices: &[f32], faces: &[u32], rest: &[RestVertex], material: &MaterialSettings) -> Result<Self> {
        bridge::new_tracer(vertices, faces, rest, material).map(MeshTracer).map_err(failed)
    }

    /// Moves the vertices and refits the hierarchy.
    pub fn update(&mut self, vertices: &[f32]) -> Result<()> {
        self.0.pin_mut().update(vertices).map_err(failed)
    }

    /// Refits the hierarchy to the vertices as they are.
    pub fn refit(&mut self) -> Result<()> {
        self.0.pin_mut().refit().map_err(failed)
    }

    /// Adds a tile's samples to its film, row-major. `corners`: directions in camera axes (xyz) through the (width + 1)
    /// x (height + 1) pixel corners of the image. `known`: light per vertex, or empty: then all light is traced.
    pub fn trace_tile(
        &self,
        frame: &FrameSettings,
        tile: &TileRequest,
        corners: &[f32],
        known: &[KnownLight],
        film: &mut [FilmPixel],
    ) -> Result<TileCounters> {
        self.0.trace_tile(frame, tile, corners, known, film).map_err(failed)
    }

    /// Lengths of camera rays along unit directions (camera axes, xyz) and the faces there; infinity and [`NO_FACE`]
    /// where nothing is hit.
    pub fn distances(
        &self,
        frame: &FrameSettings,
        directions: &[f32],
        distances: &mut [f32],
        faces: &mut [u32],
    ) -> Result<()> {
        self.0.probe_depth(frame, directions, distances, faces).map_err(failed)
    }

    /// What camera rays along unit directions (camera axes, xyz) hit.
    pub fn probe(&self, frame: &FrameSettings, directions: &[f32]) -> Result<Vec<ProbedPoint>> {
        let mut points = vec![ProbedPoint::default(); directions.len() / 3];
        self.0.probe(frame, directions, &mut points).map_err(failed)?;
        Ok(points)
    }

    /// Lengths of arbitrary rays in the tracer's world, in units of the directions' lengths; infinity at a miss.
    pub fn cast(&self, origins: &[f32], directions: &[f32], distances: &mut [f32]) -> Result<()> {
        self.0.cast(origins, directions, distances).map_err(failed)
    }

    /// The lamp's light on faces, and the number of rays that it took.
    pub fn lamp_on(&self, frame: &FrameSettings, faces: &[u32]) -> Result<(Vec<FaceLight>, u64)> {
        let mut light = vec![FaceLight::default(); faces.len()];
        let rays = self.0.lamp_on_faces(frame, faces, &mut light).map_err(failed)?;
        Ok((light, rays))
    }

    /// What the rays of the faces `light[to]` bring, each from the face `light[from]` that it hits ([`NO_FACE`] for
    /// none; the same number of rays for each of `to`). Does nothing where there is no coat.
    pub fn glints(
        &self,
        frame: &FrameSettings,
        light: &[FaceLight],
        to: &[u32],
        from: &[u32],
        glints: &mut [Glint],
    ) -> Result<()> {
        self.0.glints(frame, light, to, from, glints).map_err(failed)
    }

    /// Per face the faces that `hits.len() / faces.len()` rays from it meet ([`NO_FACE`] where one leaves the mesh);
    /// returns the number of rays.
    pub fn gather(&self, frame: &FrameSettings, faces: &[u32], hits: &mut [u32]) -> Result<u64> {
        self.0.gather(frame, faces, hits).map_err(failed)
    }

    /// `count` scatter walks through the wall for every vertex.
    pub fn scatter_walks(
        &self,
        frame: &FrameSettings,
        vertices: &[u32],
        around: &FacesAround,
        count: usize,
    ) -> Result<ScatterWalks> {
        let mut exits = vec![ScatterExit::default(); vertices.len() * count];
        let mut flat = vec![FlatWalks::default(); vertices.len()];
        let rays = self.0.scatter_walks(frame, vertices, around, &mut exits, &mut flat).map_err(failed)?;
        Ok(ScatterWalks { exits, flat, rays })
    }

    /// The lamp's irradiance at places, without shadows.
    pub fn unshadowed(&self, frame: &FrameSettings, places: &[FacePlace]) -> Result<Vec<[f32; 3]>> {
        let mut irradiance = vec![[0.0; 3]; places.len()];
        self.0.unshadowed(frame, places, irradiance.as_flattened_mut()).map_err(failed)?;
        Ok(irradiance)
    }

    /// The same around `vertices`, as a mean with the weights of linear interpolation.
    pub fn unshadowed_around(
        &self,
        frame: &FrameSettings,
        vertices: &[u32],
        around: &FacesAround,
    ) -> Result<Vec<[f32; 3]>> {
        let mut irradiance = vec![[0.0; 3]; vertices.len()];
        self.0.unshadowed_around(frame, vertices, around, irradiance.as_flattened_mut()).map_err(failed)?;
        Ok(irradiance)
    }
}

/// Directional albedo of the GGX coat of roughness `alpha` and index `ior`, seen under `cosine`.
pub fn coat_albedo(alpha: f32, ior: f32, cosine: f32) -> f32 {
    bridge::coat_albedo(alpha, ior, cosine)
}

/// Single-scattering albedo of a half-space (isotropic scattering) whose diffuse albedo is `rho`.
pub fn medium_albedo(rho: f32) -> f32 {
    bridge::medium_albedo(rho)
}

/// Two-dimensional point `index` of the `dimension`-th padded pair of the sequence `key`.
pub fn sobol_pair(key: u32, index: u32, dimension: u32) -> [f32; 2] {
    let mut pair = [0.0; 2];
    bridge::sobol_pair(key, index, dimension, &mut pair).expect("two values are given");
    pair
}

/// Gradient noise (after Perlin, SIGGRAPH 2002) at a point; features have a period of 1. Panics where this processor
/// lacks `isa`.
pub fn gradient_noise(isa: Isa, point: [f32; 3], seed: u32) -> GradientNoise {
    bridge::gradient_noise(isa.code(), &point, seed).expect("a processor that has the instruction set")
}

/// The two nearest points of the jittered lattice, one point per unit cell. Panics where this processor lacks `isa`.
pub fn noise_neighbours(isa: Isa, point: [f32; 3], seed: u32) -> [NoiseNeighbour; 2] {
    let mut nearest = [NoiseNeighbour::default(); 2];
    bridge::noise_neighbours(isa.code(), &point, seed, &mut nearest).expect("a processor that has the instruction set");
    nearest
}
