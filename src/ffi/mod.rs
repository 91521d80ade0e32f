//! The boundary between Rust and C/C++: Embree (bindgen), OpenCV (the `opencv` crate), our C++ (cxx, `cpp/`), libc; and
//! what Rust compiles for one instruction set.
//!
//! The only room that may say `unsafe`. Every C object has one owning handle; `Mat`, `RTCScene` and cxx types never
//! leave this room. Knows nothing of airways.
#![allow(unsafe_code)]

pub mod isa;
pub mod splat;
pub mod system;
#[cfg(feature = "trace")]
pub mod trace;
#[cfg(feature = "trace")]
pub mod versions;
#[cfg(feature = "vision")]
pub mod vision;
