//! How a profile's iteration scale changes iteration counts and learning rates.

/// `published * scale`, at least one; none stays none.
pub fn scaled_iterations(published: f64, scale: f64) -> usize {
    if published == 0.0 { 0 } else { (published * scale).round().max(1.0) as usize }
}

/// Factor on rates that keeps the distance Adam can travel in a frame when a profile cuts the iterations: the same for
/// all methods. Left out where that distance is many times what a frame needs, and larger steps only overshoot: for the
/// phase, and for the mesh of BridgeSplat (10 mm a frame in `quick`).
pub fn rate_factor(iteration_scale: f64) -> f64 {
    (1.0 / iteration_scale).clamp(1.0, 10.0)
}
