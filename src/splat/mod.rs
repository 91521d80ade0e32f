//! The differentiable Gaussian rasteriser on CPU: tiled forward, analytic backward, deterministic for any number of
//! threads. Knows nothing of methods, losses or optimisers.
