pub mod scene;
pub mod skips;
pub mod tiling;
