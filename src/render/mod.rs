//! The path tracer: Embree 4, multi-bounce, co-located inverse-square light. Knows nothing of breathing or methods.
//!
//! ```text
//!  TriangleMesh + Material -> Scene --deform--> render(camera, pose, light, settings) -> RenderedFrame
//! ```
//!
//! `cpp/trace/surface.h` holds what rays meet, `cpp/trace/lamp.h` the lamp, `cpp/trace/path.h` paths, `cpp/trace/vertex_light.h` light at
//! vertices, `cpp/trace/coat.h` the reflection, `cpp/trace/mucosa.h` the look of the wall (`cpp/trace/noise_kernel.cpp` its noise, in vectors),
//! `cpp/trace/scatter_walk.h` the light inside it.

mod axial;
mod denoise;
mod frame;
mod material;
pub mod probe;
mod sampling;
mod scene;
pub mod scene_file;
mod settings;
mod tissue;
mod topology;
mod vertex_light;

pub use frame::{RenderedFrame, Statistics, render, render_watched};
pub use material::{Boundary, Material, MaterialKind, Subsurface, WalkedVertices};
pub use scene::Scene;
pub use settings::{Denoise, Light, RenderSettings, Shading, Transport};

/// Instruction set that Embree is pinned to: others trace the same rays with other last bits.
pub const ISA: &str = "avx2";
