//! The path tracer: Embree 4, multi-bounce, co-located inverse-square light. Knows nothing of breathing or methods.
