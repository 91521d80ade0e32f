//! From anatomy to a filmed sequence on disk, and back: trajectory, exposure, writer, reader. Knows nothing of methods.

pub mod sequence;
