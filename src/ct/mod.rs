//! From two CT scans of a breathing patient to the two states of an airway: lungs, airway, surface, registration.
//!
//! ```text
//! scan --> coarse scan, lungs, contrast --> registration (elastix) --> displacement field
//!   |                                                                        |
//!   +----> airway mask (given, or grown) --> surface at inspiration ---------+--> surface at expiration --> case
//! ```
//!
//! `simulated` goes the other way: from a case to two scans whose truth is known.
//!
//! Knows the airway's shape and motion; nothing of films, methods or scores. Volumes are in `base::volume`, their files
//! in `formats`.

pub mod airway_mask;
pub mod dicom_conversion;
mod distance;
mod isosurface;
mod local_contrast;
pub mod lumen;
pub mod lungs;
pub mod motion_field;
mod parts;
pub mod program;
pub mod quality;
mod quality_picture;
pub mod region;
pub mod registration;
pub mod scan;
pub mod scan_pair;
pub mod simulated;
pub mod surface_pair;
mod topology;
