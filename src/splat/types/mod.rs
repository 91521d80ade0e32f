//! What goes in and what comes out (Gaussians, view, settings, motions; images, gradients), and the layout of the
//! tables between: tiles, rows of splats, sums of a backward pass.

mod gradients;
mod images;
mod motion;
mod scene;
mod settings;
pub mod table;
mod tiling;

pub use gradients::{GROUP, Gradients, Wanted, is_unheard};
pub use images::{ImageGradient, Rendered};
pub use motion::{Direction, Motion};
pub use scene::{GaussianSlices, Gaussians, Shape, ShapeSlices, View};
pub use settings::{DepthOutput, Filter, Footprint, Settings, Skips};
pub use tiling::{PIXELS, TILE_SIDE, Tiling, index_of, pixel_of};
