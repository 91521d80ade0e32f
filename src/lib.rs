//! # respire-bench
//!
//! How accurate is a method that reconstructs a *breathing* airway from bronchoscopy video, and what does that
//! accuracy cost? This crate makes the video (with exact truth), runs reference methods on its own CPU splat core,
//! scores them and anybody else's predictions the same way, and reports.
//!
//! The way of the data is the plan of the house. Stages are joined by folders on disk, so that each can be run,
//! resumed, inspected, replaced and scored alone:
//!
//! ```text
//!  bench-cases/*.toml                                                        PREDICTION/ of a third party
//!        |                                                                          |
//!        v                                                                          v
//!     airway ----> simulate ----> SEQUENCE/ ----> reconstruct ----> PREDICTION/ -> score -> rows -> report, gate
//!                     ^                               ^
//!                   render                          splat
//!
//!     ct: two scans of a patient --> case.toml
//!     bench: which cells, in which order, resumed from where          cli: words in, words out
//!     experiments: ablations, cost against error, numerical stability, timing
//!     base, ffi, formats: below everything; the only `unsafe` is in ffi
//! ```
//!
//! A room may import only from rooms above it in this list. The tests in `tests/all/layering/` parse the sources and
//! refuse any other import, a circle between the files or folders of a room, and a type name that stands twice:
//!
//! | room | knows | must not know |
//! |---|---|---|
//! | [`base`] | vectors, cameras, mesh, image, counter-based randomness, errors, hashes, atomic files | anything else |
//! | [`ffi`] | Embree, OpenCV, own C++; the only `unsafe` | the domain |
//! | [`formats`] | one external file format per file, pure functions both ways | stages |
//! | [`airway`] | case files, bronchial tree, surface, breathing field and waveform, centreline, import | rendering |
//! | [`ct`] | CT scans: lungs, airway mask and its surface, registration by elastix, the page of an import | films, rendering |
//! | [`render`] | the path tracer | breathing, methods |
//! | [`simulate`] | trajectory, exposure, sequence writer and reader, export to other layouts | methods |
//! | [`splat`] | the differentiable rasteriser | methods, losses, optimiser |
//! | [`reconstruct`] | the methods: losses, optimiser, schedules | the truth |
//! | [`score`] | metric registry, protocol, aggregation | how predictions were made |
//! | [`report`] | CSV, Markdown, LaTeX, HTML, plots, JUnit, gate verdicts | how scores were made |
//! | [`mod@bench`] | profiles, plan of cells, executor, cache | formats of the report |
//! | [`experiments`] | ablations, cost against error, numerical stability, timing | arguments, printing |
//! | [`cli`] | arguments, progress, printing, exit codes | algorithms |
//!
//! Where is it decided?
//!
//! | question | place |
//! |---|---|
//! | the phase of a frame | [`reconstruct`]: the method (`methods/ours.rs`, `methods/ours_gn/`), by an estimator of `estimate/` |
//! | the colour of a pixel in the splat core | [`splat`]: `plain/tile.rs`, and for `f32` its twin `cpp/splat/kernel.cpp` |
//! | a film's exposure | [`simulate`]: `exposure.rs`; noise and 8 bits in `sensor.rs` |
//! | the radiance of a pixel of a film | [`render`]: `cpp/trace/path.h`, light at vertices in `vertex_light.rs` |
//! | what a method may see | [`reconstruct`]: `contract.rs` says it, `observe.rs` alone fills it |
//! | what a metric means | [`score`]: its entry in `registry.rs`, and the functions in `measures.rs` that the entry names |
//! | which cases and methods there are | [`mod@bench`]: `catalogue.rs`; those that the program carries: [`base::shipped`] |
//! | order, looks and names of this program's own rows | [`base::own_row`] |
//! | the names in a prediction's folder | [`formats::prediction`] |
//! | a cell's cache key | [`mod@bench`]: `plan.rs`, with the revision of the code from `revision.rs` |
//!
//! Cargo features, all on by default. Without any, the crate needs a C++ compiler and nothing else:
//!
//! | feature | rooms | needs |
//! |---|---|---|
//! | none | [`base`], [`splat`], the [`formats`] of films and predictions; of [`simulate`] the readers `sequence` and `participant`, of [`reconstruct`] the writer of predictions | g++ |
//! | `methods` | [`airway`], [`reconstruct`], of [`simulate`] `export`, all formats but those of scans; vectorised derivatives along directions | g++ |
//! | `trace` | [`render`], [`simulate`] | Embree 4, libclang |
//! | `vision` | [`score`] | OpenCV 4, clang |
//! | `program` | [`ct`], [`report`], [`mod@bench`], [`experiments`], [`cli`] | both |
//!
//! Conventions, one home each: millimetres, seconds, radians; right-handed world; camera axes as OpenCV (x right,
//! y down, z forward); transforms named by what they map (`world_from_camera`); pixel centres at integer + 0.5;
//! depth is z-depth in mm; colour is linear RGB inside and 8-bit sRGB only at the edge; breathing phase 0 is full
//! inspiration, 1 is full expiration.

pub mod base;
pub mod ffi;
pub mod formats;

#[cfg(feature = "methods")]
pub mod airway;
/// What a film tells of the airway.
#[cfg(not(feature = "methods"))]
#[allow(dead_code, reason = "what only the maker of airways needs")]
pub mod airway {
    pub mod case_centerline;
    pub mod centerline;
    pub mod target;
}
#[cfg(feature = "program")]
pub mod ct;
#[cfg(feature = "trace")]
pub mod render;
#[cfg(feature = "trace")]
pub mod simulate;
/// Sequences can be read without the path tracer, but not made.
#[cfg(not(feature = "trace"))]
#[allow(dead_code, reason = "names and entries that only the writer needs")]
pub mod simulate {
    #[cfg(feature = "methods")]
    pub mod export;
    mod film_tables;
    pub mod participant;
    pub mod sequence;
}

pub mod splat;

/// How tests say what they cannot test here.
#[cfg(all(test, feature = "methods"))]
#[path = "../tests/all/skip.rs"]
mod skip;

#[cfg(feature = "methods")]
pub mod reconstruct;
/// Predictions can be written without the methods.
#[cfg(not(feature = "methods"))]
pub mod reconstruct {
    mod prediction_folder;
    pub use prediction_folder::{PredictionFolder, PredictionTiming};
}

#[cfg(feature = "vision")]
pub mod score;

#[cfg(feature = "program")]
pub mod report;

#[cfg(feature = "program")]
pub mod bench;

#[cfg(feature = "program")]
pub mod experiments;

#[cfg(feature = "program")]
pub mod cli;
