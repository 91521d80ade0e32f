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
//!     bench: which cells, in which order, resumed from where          cli: words in, words out
//!     experiments: ablations, cost against error, numerical stability, timing
//!     base, ffi, formats: below everything; the only `unsafe` is in ffi
//! ```
//!
//! An arrow between rooms may only point *up* this list (a room uses the rooms above its own); a test in
//! `tests/all/layering.rs` reads the `use crate::` lines and fails on any other arrow:
//!
//! | room | knows | must not know |
//! |---|---|---|
//! | [`base`] | vectors, cameras, mesh, image, counter-based randomness, errors, hashes, atomic files | anything else |
//! | [`ffi`] | Embree, OpenCV, own C++; the only `unsafe` | the domain |
//! | [`formats`] | one external file format per file, pure functions both ways | stages |
//! | [`airway`] | case files, bronchial tree, surface, breathing field and waveform, centreline, import | rendering |
//! | [`render`] | the path tracer | breathing, methods |
//! | [`simulate`] | trajectory, exposure, sequence writer and reader | methods |
//! | [`splat`] | the differentiable rasteriser | methods, losses, optimiser |
//! | [`reconstruct`] | the methods: losses, optimiser, schedules | the truth |
//! | [`score`] | metric registry, protocol, aggregation | how predictions were made |
//! | [`report`] | CSV, Markdown, LaTeX, HTML, plots, JUnit, gate verdicts | how scores were made |
//! | [`mod@bench`] | profiles, plan of cells, executor, journal | formats of the report |
//! | [`experiments`] | ablations, cost against error, numerical stability, timing | arguments, printing |
//! | [`cli`] | arguments, progress, printing, exit codes | algorithms |
//!
//! Conventions, one home each: millimetres, seconds, radians; right-handed world; camera axes as OpenCV (x right,
//! y down, z forward); transforms named by what they map (`world_from_camera`); pixel centres at integer + 0.5;
//! depth is z-depth in mm; colour is linear RGB inside and 8-bit sRGB only at the edge; breathing phase 0 is full
//! inspiration, 1 is full expiration.

pub mod base;
pub mod ffi;
pub mod formats;

pub mod airway;
pub mod render;
pub mod simulate;

pub mod splat;

pub mod reconstruct;

pub mod score;

pub mod report;

pub mod bench;
pub mod cli;
pub mod experiments;
