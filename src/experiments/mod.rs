//! Measurements of the program itself: what each part of a method is worth, cost against error of its settings,
//! numerical stability, time. Computes and returns data; the command line prints it.
//!
//! ```text
//! ablation: variants of methods and cases, scored beside the shipped ones
//! ct_loop:  cases scanned and imported again, held against the truth
//! light_bias: light at vertices, which films use, against path tracing, frame by frame
//! pareto:   cost against error: path tracer, trackers, rasteriser (and what skipping saves)
//! picture_statistics: what tells a simulated picture from a real one
//! stress:   scenes, inputs and metrics at the edge of their definition; gradients against central differences
//! timing:   the scene, repetitions and medians behind every figure of the rasteriser's speed
//! ```

pub mod ablation;
pub mod case_scene;
pub mod ct_loop;
pub mod difference;
pub mod light_bias;
pub mod pareto;
pub mod picture_statistics;
pub mod stress;
pub mod timing;
mod watcher;

pub use watcher::ExperimentWatcher;
