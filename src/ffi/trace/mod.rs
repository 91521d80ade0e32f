//! Bridges of the path tracer (`cpp/trace/`) and the bindings of Embree.

pub mod embree;
pub mod tracer;
