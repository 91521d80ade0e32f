//! Geometry of the mesh at a phase and from a pose.

pub mod breathing;
pub mod lit_wall;
pub mod mesh_depth;
pub mod neighbours;
pub mod pyramid;
pub mod rigid;
pub mod targets;
pub mod virtual_view;
pub mod visible;
