//! One external file format per file, pure functions both ways. Damaged input gives an error that names file and
//! element, never a panic.

pub mod exr;
pub mod landmarks;
pub mod mesh;
pub mod png;
