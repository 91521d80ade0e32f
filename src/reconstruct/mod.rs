//! The methods. Each gets an [`Observation`], which holds what it may use and nothing else.
//!
//! The floors of this room; each imports only from those above it in the table:
//!
//! | floor | holds |
//! |---|---|
//! | `contract`, `settings`, `activation`, `stopwatch` | inputs and outputs of a method, and its numbers |
//! | `online`, `observe`, `rough_poses`, `prediction_folder`, `prediction` | the protocol, from the sequence to the prediction |
//! | `geometry` | the mesh at a phase: visible faces, depth, image pyramid, rigid motions, neighbours |
//! | `fitting` | building blocks: optimiser, losses, discs and free Gaussians, light, memory of colours |
//! | `estimate` | estimators, which do not know each other: phase fit, keyframe window, Gauss-Newton, breath |
//! | `methods` | the methods, which combine the floors above |
//! | `library` | from a method's file to the method |

mod activation;
mod contract;
mod estimate;
mod fitting;
mod geometry;
mod library;
mod methods;
mod observe;
mod online;
mod prediction;
mod prediction_folder;
mod rough_poses;
pub mod settings;
mod stopwatch;

pub use contract::{
    Access, ArrivedFrame, FollowFrames, FramePrediction, LiveAnswer, Observation, PoseAccuracy, Reconstruct,
    Reconstruction, TrackState, WallMask,
};
pub use fitting::{loss, optimiser};
pub use library::{MethodFile, method_files};
pub use methods::bridgesplat::Bridgesplat;
pub use methods::bridgesplat_nomesh::BridgesplatNomesh;
pub use methods::ours::{GivenPhase, Ours};
pub use methods::ours_gn::OursGn;
pub use methods::ours_nav::OursNav;
pub use methods::ours_nomesh::OursNomesh;
pub use observe::{given_poses, observe, observe_first};
pub use prediction::write_prediction;
pub use prediction_folder::{PredictionFolder, PredictionTiming};
pub use rough_poses::rough_poses;
pub use settings::Listing;
pub use stopwatch::Spent;
