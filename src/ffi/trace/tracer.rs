//! The path tracer's hot part: C++ (`cpp/trace/tracer.cpp`) on Embree 4 through cxx, one call per tile of pixels.
//!
//! Embree wants flush-to-zero while it runs and Rust assumes the default floating-point mode: the C++ side sets and
//! restores it inside each call. `docs/decisions/path-tracer-in-cpp.md` says why whole tiles cross this border.

use cxx::UniquePtr;

use crate::base::{Error, ErrorKind, Result};
use crate::ffi::isa::Isa;

pub use bridge::{FrameSettings, MaterialSettings, Tile, TileCounters};

#[allow(unused_qualifications)] // cxx spells its generated derives in full
#[cxx::bridge(namespace = "respire")]
mod bridge {
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
        /// Seed of the pattern.
        seed: u32,
        /// Light in the wall: 0 stays where it enters, 1 walks below a diffuse boundary, 2 below a matched one.
        subsurface: u8,
        /// Walks at every vertex of a path instead of the first alone.
        walk_at_every_vertex: bool,
        /// Part of the walks that starts refracted through a rough surface of index `ior` instead of by the cosine law.
        refracted_entry: f32,
        /// Extinction in the wall, per mm.
        extinction: [f32; 3],
        /// `scattering` holds everywhere; otherwise it follows from the diffuse albedo.
        fixed_scattering: bool,
        /// Single-scattering albedo.
        scattering: [f32; 3],
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
        /// What is known at vertices lights what a camera sample's first ray or walk meets, and not what the camera sees.
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
    struct Tile {
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

    unsafe extern "C++" {
        include!("cpp/trace/tracer.h");

        type Tracer;

        fn new_tracer(
            vertices: &[f32],
            faces: &[u32],
            generations: &[f32],
            axial_mm: &[f32],
            material: &MaterialSettings,
        ) -> Result<UniquePtr<Tracer>>;
        fn update(self: Pin<&mut Tracer>, vertices: &[f32]) -> Result<()>;
        fn refit(self: Pin<&mut Tracer>) -> Result<()>;
        fn trace_tile(
            self: &Tracer,
            frame: &FrameSettings,
            tile: &Tile,
            corners: &[f32],
            known: &[f32],
            film: &mut [f32],
        ) -> Result<TileCounters>;
        fn trace_distances(
            self: &Tracer,
            frame: &FrameSettings,
            directions: &[f32],
            distances: &mut [f32],
            faces: &mut [u32],
        ) -> Result<()>;
        fn lamp(self: &Tracer, frame: &FrameSettings, faces: &[u32], values: &mut [f32]) -> Result<u64>;
        fn glints(
            self: &Tracer,
            frame: &FrameSettings,
            lamp: &[f32],
            to: &[u32],
            from: &[u32],
            parts: &mut [f32],
        ) -> Result<()>;
        fn gather(self: &Tracer, frame: &FrameSettings, faces: &[u32], hits: &mut [u32]) -> Result<u64>;
        fn walks(
            self: &Tracer,
            frame: &FrameSettings,
            vertices: &[u32],
            offsets: &[u32],
            adjacent: &[u32],
            exits: &mut [u32],
            places: &mut [f32],
            weights: &mut [f32],
            flat: &mut [f32],
        ) -> Result<u64>;
        fn unshadowed(
            self: &Tracer,
            frame: &FrameSettings,
            faces: &[u32],
            places: &[f32],
            values: &mut [f32],
        ) -> Result<()>;
        fn unshadowed_around(
            self: &Tracer,
            frame: &FrameSettings,
            vertices: &[u32],
            offsets: &[u32],
            adjacent: &[u32],
            values: &mut [f32],
        ) -> Result<()>;
        fn probe(
            self: &Tracer,
            frame: &FrameSettings,
            directions: &[f32],
            faces: &mut [u32],
            values: &mut [f32],
        ) -> Result<()>;
        fn cast(self: &Tracer, origins: &[f32], directions: &[f32], distances: &mut [f32]) -> Result<()>;

        fn coat_albedo(alpha: f32, ior: f32, cosine: f32) -> f32;
        fn medium_albedo(rho: f32) -> f32;
        fn sobol_pair(key: u32, index: u32, dimension: u32, pair: &mut [f32]) -> Result<()>;
        fn gradient_noise(isa: u8, point: &[f32], seed: u32, values: &mut [f32]) -> Result<()>;
        fn noise_neighbours(isa: u8, point: &[f32], seed: u32, values: &mut [f32], cells: &mut [u32]) -> Result<()>;
    }
}

/// Values per pixel of a tile's film, in this order: direct (3), indirect (3), indirect from the base over its albedo
/// (3), indirect from the coat (3), albedo (3), smooth normal (3), hits (1). Sums over samples.
pub const FILM_CHANNELS: usize = 19;

/// Values per vertex: what the base sends of light that walked in the wall, over its albedo and times pi (3); irradiance by
/// other walls (3); the part of walks that comes out nearby, over the albedo (3), and that part times the lamp's unshadowed
/// irradiance around the vertex (3).
pub const KNOWN_VALUES: usize = 12;

/// Values per face: the lamp's irradiance (3), what the base sends on of it (3), what is sent on to all sides alike of other
/// light (3), centre (3), normal (3), what the coat mirrors of the lamp's light and of other light, over [`MeshTracer::glints`]
/// (2); the lamp's unshadowed irradiance (3); 1 where the face is so near that this is not even over it, or 0.
pub const LAMP_VALUES: usize = 21;

/// Walks through the wall, the same number for every vertex.
#[derive(Clone, Debug, Default)]
pub struct Walks {
    /// Per walk the face where it comes out; [`NO_FACE`] where it does not.
    pub exits: Vec<u32>,
    /// Per walk the place there: barycentric weights of the face's second and third corner.
    pub places: Vec<f32>,
    /// Per walk what is left of its light over the albedo where it began, three channels.
    pub weights: Vec<f32>,
    /// Per vertex, three channels: by how much the mean weight of the same walks below a flat surface is above what is known of it.
    pub flat: Vec<f32>,
    /// Rays that it took.
    pub rays: u64,
}

/// In place of a face: nothing was hit.
pub const NO_FACE: u32 = u32::MAX;

/// Values per probed ray: distance, barycentric weights of the face's second and third corner, albedo (3).
pub const PROBE_VALUES: usize = 6;

/// One triangle mesh, its material and its bounding volume hierarchy.
pub struct MeshTracer(UniquePtr<bridge::Tracer>);

// SAFETY: the C++ object has no thread affinity, and its const methods only read it (Embree allows concurrent traversal
// of a committed scene); the one mutating method needs `&mut`.
unsafe impl Send for MeshTracer {}
// SAFETY: as above.
unsafe impl Sync for MeshTracer {}

fn failed(e: cxx::Exception) -> Error {
    Error::new(ErrorKind::Environment, format!("the path tracer failed: {e}"))
}

impl MeshTracer {
    /// Builds the hierarchy. `vertices` xyz interleaved in mm, three indices per face, one generation and axial distance
    /// per vertex. Fails on lengths that do not fit, and where Embree refuses.
    pub fn new(
        vertices: &[f32],
        faces: &[u32],
        generations: &[f32],
        axial_mm: &[f32],
        material: &MaterialSettings,
    ) -> Result<Self> {
        bridge::new_tracer(vertices, faces, generations, axial_mm, material).map(MeshTracer).map_err(failed)
    }

    /// Moves the vertices and refits the hierarchy.
    pub fn update(&mut self, vertices: &[f32]) -> Result<()> {
        self.0.pin_mut().update(vertices).map_err(failed)
    }

    /// Refits the hierarchy to the vertices as they are.
    pub fn refit(&mut self) -> Result<()> {
        self.0.pin_mut().refit().map_err(failed)
    }

    /// Adds a tile's samples to its film ([`FILM_CHANNELS`] values per pixel). `corners`: directions in camera axes
    /// through the (width + 1) x (height + 1) pixel corners of the image. `known`: [`KNOWN_VALUES`] per vertex,
    /// negative where nothing is known, or empty: then all light is traced.
    pub fn trace_tile(
        &self,
        frame: &FrameSettings,
        tile: &Tile,
        corners: &[f32],
        known: &[f32],
        film: &mut [f32],
    ) -> Result<TileCounters> {
        self.0.trace_tile(frame, tile, corners, known, film).map_err(failed)
    }

    /// Lengths of camera rays along unit directions (camera axes) and the faces there; infinity and [`NO_FACE`] where
    /// nothing is hit.
    pub fn distances(
        &self,
        frame: &FrameSettings,
        directions: &[f32],
        distances: &mut [f32],
        faces: &mut [u32],
    ) -> Result<()> {
        self.0.trace_distances(frame, directions, distances, faces).map_err(failed)
    }

    /// [`LAMP_VALUES`] per face; gives back the number of rays.
    pub fn lamp(&self, frame: &FrameSettings, faces: &[u32], values: &mut [f32]) -> Result<u64> {
        self.0.lamp(frame, faces, values).map_err(failed)
    }

    /// Two values for every ray of the faces at the places `to` of `lamp` ([`LAMP_VALUES`] each), which meets a face (place in
    /// `from`, [`NO_FACE`] for none; the same number for each of `to`): what that face's base sends along it, over its mean to
    /// all sides, and what its coat sends of light from the lamp's side, as irradiance over what the coat gets. Left alone
    /// where there is no coat.
    pub fn glints(
        &self,
        frame: &FrameSettings,
        lamp: &[f32],
        [to, from]: [&[u32]; 2],
        parts: &mut [f32],
    ) -> Result<()> {
        self.0.glints(frame, lamp, to, from, parts).map_err(failed)
    }

    /// Per face the faces that `hits.len() / faces.len()` rays from it meet ([`NO_FACE`] where one leaves the mesh); gives
    /// back the number of rays.
    pub fn gather(&self, frame: &FrameSettings, faces: &[u32], hits: &mut [u32]) -> Result<u64> {
        self.0.gather(frame, faces, hits).map_err(failed)
    }

    /// `count` walks through the wall for every vertex. `adjacent[offsets[v]..offsets[v + 1]]` are the faces around vertex v.
    pub fn walks(
        &self,
        frame: &FrameSettings,
        vertices: &[u32],
        [offsets, adjacent]: [&[u32]; 2],
        count: usize,
    ) -> Result<Walks> {
        let all = vertices.len() * count;
        let mut walks = Walks {
            exits: vec![NO_FACE; all],
            places: vec![0.0; 2 * all],
            weights: vec![0.0; 3 * all],
            flat: vec![0.0; 3 * vertices.len()],
            rays: 0,
        };
        let Walks { exits, places, weights, flat, rays } = &mut walks;
        *rays = self.0.walks(frame, vertices, offsets, adjacent, exits, places, weights, flat).map_err(failed)?;
        Ok(walks)
    }

    /// The lamp's irradiance (three channels) at `places` in `faces` (barycentric weights of the second and third corner) if
    /// nothing stood in its way.
    pub fn unshadowed(&self, frame: &FrameSettings, faces: &[u32], places: &[f32], values: &mut [f32]) -> Result<()> {
        self.0.unshadowed(frame, faces, places, values).map_err(failed)
    }

    /// The same around `vertices`, as a mean with the weights of linear interpolation.
    pub fn unshadowed_around(
        &self,
        frame: &FrameSettings,
        vertices: &[u32],
        [offsets, adjacent]: [&[u32]; 2],
        values: &mut [f32],
    ) -> Result<()> {
        self.0.unshadowed_around(frame, vertices, offsets, adjacent, values).map_err(failed)
    }

    /// What camera rays along unit directions (camera axes) hit: face (`u32::MAX` for nothing) and [`PROBE_VALUES`] values.
    pub fn probe(
        &self,
        frame: &FrameSettings,
        directions: &[f32],
        faces: &mut [u32],
        values: &mut [f32],
    ) -> Result<()> {
        self.0.probe(frame, directions, faces, values).map_err(failed)
    }

    /// Lengths of arbitrary rays in the tracer's world, in units of the directions' lengths; infinity at a miss.
    pub fn cast(&self, origins: &[f32], directions: &[f32], distances: &mut [f32]) -> Result<()> {
        self.0.cast(origins, directions, distances).map_err(failed)
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

/// Gradient noise (after Perlin, SIGGRAPH 2002) at a point: its value, in about [-1, 1], and its gradient. Features have a
/// period of 1. Panics where this processor lacks `isa`.
pub fn gradient_noise(isa: Isa, point: [f32; 3], seed: u32) -> [f32; 4] {
    let mut values = [0.0; 4];
    bridge::gradient_noise(isa.code(), &point, seed, &mut values).expect("a processor that has the instruction set");
    values
}

/// The two nearest points of the jittered lattice, one point per unit cell: place relative to the cell that `point` lies in
/// (3), squared distance; and the hash that names the cell. Panics where this processor lacks `isa`.
pub fn noise_neighbours(isa: Isa, point: [f32; 3], seed: u32) -> [([f32; 4], u32); 2] {
    let (mut values, mut cells) = ([0.0; 8], [0; 2]);
    bridge::noise_neighbours(isa.code(), &point, seed, &mut values, &mut cells)
        .expect("a processor that has the instruction set");
    [0, 1].map(|k| (std::array::from_fn(|i| values[4 * k + i]), cells[k]))
}
