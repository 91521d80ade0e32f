//! The path tracer: Embree 4, multi-bounce, co-located inverse-square light. Knows nothing of breathing or methods.
//!
//! ```text
//!  TriangleMesh + Material -> Scene --deform--> render(camera, pose, light, settings) -> RenderedFrame
//! ```
//!
//! In `cpp/trace/`:
//!
//! | file | what |
//! |---|---|
//! | `traced_mesh.h` | the mesh in Embree, rays through it |
//! | `wall_material.h`, `mucosa.h`, `noise.h` | what the wall is made of, its look, the look's noise |
//! | `coat.h`, `scatter_walk.h` | reflection by the coat, light inside the wall |
//! | `surface.h`, `lamp.h` | the wall at a path's vertex, the lamp's light on it |
//! | `path.h` | paths |
//! | `face_light.h`, `known_light.h` | light on faces and at vertices, camera samples that use it |
//! | `tracer.h` | the border to Rust |

mod axial;
mod denoise;
mod frame;
mod material;
pub mod probe;
mod rest_shape;
mod sampling;
mod scene;
pub mod scene_file;
mod settings;
mod tissue;
mod topology;
mod vertex_light;

pub use frame::{RenderedFrame, Statistics, estimate, render, render_watched};
pub use material::{Boundary, Material, MaterialKind, Subsurface, WalkedVertices};
pub use scene::Scene;
pub use settings::{DRAFT_RAYS_PER_FACE, Denoise, Light, RenderSettings, Shading, Transport};

/// Instruction set that Embree is pinned to: others round the same rays differently.
pub const ISA: &str = "avx2";
