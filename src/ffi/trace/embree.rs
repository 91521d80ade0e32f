//! Raw Embree 4 bindings, made by bindgen from the headers that the library came with.
#![allow(non_camel_case_types, non_snake_case, non_upper_case_globals, missing_docs, dead_code)]
#![allow(clippy::all, unsafe_op_in_unsafe_fn, unused_qualifications)]

include!(concat!(env!("OUT_DIR"), "/embree.rs"));

// `RTCRayHit` is what a newer library writes into: a header of Embree 4.2 would be too small.
const _: () = assert!(size_of::<RTCRayHit>() == 96 && size_of::<RTCHit>() == 48);
