//! The instruction sets that the C++ is compiled for, and which of them this processor has.

use crate::base::{Error, ErrorKind, Result};

#[cxx::bridge(namespace = "respire")]
mod bridge {
    // SAFETY: it takes nothing, returns a number, and throws nothing.
    unsafe extern "C++" {
        include!("cpp/common/isa.h");

        fn widest_isa() -> u8;
    }
}

/// Which code runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Isa {
    /// The plain Rust twin, pixel by pixel.
    Scalar,
    /// C++ for any x86-64 (SSE2).
    Baseline,
    /// C++ for AVX2 with FMA.
    Avx2,
    /// C++ for AVX-512 (F, VL, DQ, BW).
    Avx512,
}

impl Isa {
    /// The widest that this processor runs.
    pub fn widest() -> Isa {
        match bridge::widest_isa() {
            2 => Isa::Avx512,
            1 => Isa::Avx2,
            _ => Isa::Baseline,
        }
    }

    /// `self`, or an error of the environment when this processor cannot run it.
    pub fn available(self) -> Result<Isa> {
        if self <= Isa::widest() {
            Ok(self)
        } else {
            Err(Error::new(
                ErrorKind::Environment,
                format!("this processor has no {self}; the widest is {}", Isa::widest()),
            ))
        }
    }

    pub(in crate::ffi) fn code(self) -> u8 {
        match self {
            Isa::Scalar | Isa::Baseline => 0,
            Isa::Avx2 => 1,
            Isa::Avx512 => 2,
        }
    }
}

/// A loop that [`with_avx2`] runs. A trait, since a closure is not inlined into a function with more instructions.
pub trait VectorLoop {
    /// Runs it. Write it `#[inline(always)]`, and so whatever it calls: the rest is compiled for SSE2.
    fn run(self);
}

/// Runs `work` with AVX2 where the processor has it: Rust otherwise compiles for SSE2. No operation is fused or
/// reordered, so the bytes are the same.
pub fn with_avx2(work: impl VectorLoop) {
    #[target_feature(enable = "avx2")]
    fn compiled(work: impl VectorLoop) {
        work.run();
    }
    if is_x86_feature_detected!("avx2") {
        // SAFETY: `compiled` is safe code; calling it needs AVX2, which the line above has found.
        return unsafe { compiled(work) };
    }
    work.run();
}

impl std::fmt::Display for Isa {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Isa::Scalar => "scalar",
            Isa::Baseline => "sse2",
            Isa::Avx2 => "avx2",
            Isa::Avx512 => "avx512",
        })
    }
}
