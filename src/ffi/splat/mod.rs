//! Bridges of the splat core and of what trains it (`cpp/splat/`). No film depends on anything here.

pub mod adam;
pub mod bin;
pub mod image;
pub mod loss;
pub mod rasterize;
