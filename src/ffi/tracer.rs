//! Batches of rays against one deforming triangle mesh: C++ (`cpp/tracer.cpp`) on Embree 4, through cxx.

#[cxx::bridge(namespace = "respire")]
mod bridge {
    unsafe extern "C++" {
        include!("cpp/tracer.h");

        type Tracer;

        fn new_tracer(vertices: &[f32], faces: &[u32]) -> Result<UniquePtr<Tracer>>;
        fn update(self: Pin<&mut Tracer>, vertices: &[f32]) -> Result<()>;
    }
}

pub use bridge::*;
