//! The wall between Rust and C/C++: Embree (bindgen), OpenCV (the `opencv` crate), own C++ (cxx, `cpp/`), libc.
//!
//! The only room that may say `unsafe`. Every C object has one owning handle; `Mat`, `RTCScene` and cxx types never
//! leave this room. Knows nothing of airways.
#![allow(unsafe_code)]

pub mod embree;
pub mod system;
#[allow(missing_docs)]
mod tracer;
pub mod versions;
pub mod vision;

#[cfg(test)]
mod tests {
    #[test]
    fn a_scene_is_built_and_refitted() {
        let vertices = [-1., -1., 2., 1., -1., 2., 1., 1., 2., -1., 1., 2.];
        let mut tracer = super::tracer::new_tracer(&vertices, &[0, 1, 2, 0, 2, 3]).unwrap();
        tracer.pin_mut().update(&vertices).unwrap();
        assert!(tracer.pin_mut().update(&vertices[3..]).is_err());
    }
}
