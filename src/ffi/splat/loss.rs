//! The vectorised photometric loss: C++ through cxx (`cpp/splat/loss.cpp`), which calls the kernel of one instruction
//! set (`cpp/splat/loss_kernel.cpp`), chosen at run time.

use std::cell::RefCell;

use crate::ffi::isa::Isa;

#[cxx::bridge(namespace = "respire")]
#[allow(missing_docs, unused_qualifications)]
mod bridge {
    /// The image of one frame, prepared; images are red, green, blue of each pixel, row by row.
    struct LossImage<'a> {
        width: usize,
        height: usize,
        /// The image itself.
        target: &'a [f32],
        /// Its blur.
        mean: &'a [f32],
        /// The blur of its square.
        square: &'a [f32],
        /// Weight of each pixel; empty where all weigh the same.
        mask: &'a [f32],
        /// Half of the 11 taps of the blur, the outermost first, the centre last.
        window: [f32; 6],
        /// Share of `1 - SSIM`; L1 has the rest.
        ssim_weight: f32,
    }

    // SAFETY: the functions check all indices and lengths before they read or write (`cpp/splat/loss.cpp`) and throw
    // where they do not fit, which becomes an `Err`; none keeps a pointer, calls back into Rust, or writes what it was
    // not given as `&mut`. The scratch belongs to the calling thread alone.
    unsafe extern "C++" {
        include!("cpp/splat/loss.h");

        fn loss_scratch(width: usize) -> usize;
        fn loss_band(
            isa: u8,
            image: &LossImage,
            rendered: &[f32],
            first: usize,
            gradient: &mut [f32],
            scratch: &mut [f32],
        ) -> Result<f64>;
    }
}

pub use bridge::LossImage;

/// Loss and gradient of some lines of an image, from line `first` on, as many as `gradient` has room for (interleaved).
/// Panics when the tables do not belong together (a defect of the caller, never of the input).
pub fn band(isa: Isa, image: &LossImage<'_>, rendered: &[f32], first: usize, gradient: &mut [f32]) -> f64 {
    // Kept for each thread: its first touch would cost a fifth of the loss.
    thread_local!(static SCRATCH: RefCell<Vec<f32>> = const { RefCell::new(Vec::new()) });
    SCRATCH.with_borrow_mut(|scratch| {
        scratch.resize(scratch.len().max(bridge::loss_scratch(image.width)), 0.0);
        bridge::loss_band(isa.code(), image, rendered, first, gradient, scratch)
            .expect("the loss hands over tables that belong together")
    })
}
