//! The vectorised compositing kernels of the rasteriser: C++ (`cpp/splat_kernel.cpp`), compiled once per instruction
//! set and chosen at run time, through cxx.

use crate::base::{Error, Result};

#[cxx::bridge(namespace = "respire")]
#[allow(missing_docs)]
mod bridge {
    unsafe extern "C++" {
        include!("cpp/splat.h");

        fn splat_widest_isa() -> u8;
        fn splat_forward(
            isa: u8,
            rows: &[f32],
            entries: &[u32],
            masks: &mut [u16],
            x: f32,
            y: f32,
            state: &mut [f32],
            parts: u32,
        ) -> Result<()>;
        fn splat_backward(
            isa: u8,
            rows: &[f32],
            entries: &[u32],
            masks: &[u16],
            x: f32,
            y: f32,
            adjoint: &[f32],
            slots: &mut [f32],
            parts: u32,
        ) -> Result<()>;
    }
}

/// Sixteen numbers that begin at a cache line.
#[repr(C, align(64))]
#[derive(Clone, Copy, Debug, Default)]
pub struct Aligned<T>(pub [T; 16]);

impl<T> AsRef<[T; 16]> for Aligned<T> {
    fn as_ref(&self) -> &[T; 16] {
        &self.0
    }
}

fn flat(rows: &[Aligned<f32>]) -> &[f32] {
    // SAFETY: `Aligned<f32>` is 64 bytes without padding, exactly its 16 floats.
    unsafe { std::slice::from_raw_parts(rows.as_ptr().cast(), rows.len() * 16) }
}

fn flat_mut(rows: &mut [Aligned<f32>]) -> &mut [f32] {
    // SAFETY: as in `flat`; the borrow is exclusive.
    unsafe { std::slice::from_raw_parts_mut(rows.as_mut_ptr().cast(), rows.len() * 16) }
}

/// Which code composites.
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
        match bridge::splat_widest_isa() {
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
                crate::base::ErrorKind::Environment,
                format!("this processor has no {self}; the widest is {}", Isa::widest()),
            ))
        }
    }

    fn code(self) -> u8 {
        match self {
            Isa::Scalar | Isa::Baseline => 0,
            Isa::Avx2 => 1,
            Isa::Avx512 => 2,
        }
    }
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

/// Composites one tile; see `cpp/splat_kernel.h` for the tables. Panics when they do not belong together (a defect of
/// the caller, never of the input).
pub fn forward(
    isa: Isa,
    rows: &[Aligned<f32>],
    entries: &[u32],
    masks: &mut [u16],
    corner: [f32; 2],
    state: &mut [f32],
    parts: u32,
) {
    bridge::splat_forward(isa.code(), flat(rows), entries, masks, corner[0], corner[1], state, parts)
        .expect("the rasteriser hands over tables that belong together");
}

/// Backward of [`forward`].
pub fn backward(
    isa: Isa,
    rows: &[Aligned<f32>],
    entries: &[u32],
    masks: &[u16],
    corner: [f32; 2],
    adjoint: &[f32],
    slots: &mut [Aligned<f32>],
    parts: u32,
) {
    bridge::splat_backward(
        isa.code(),
        flat(rows),
        entries,
        masks,
        corner[0],
        corner[1],
        adjoint,
        flat_mut(slots),
        parts,
    )
    .expect("the rasteriser hands over tables that belong together");
}
