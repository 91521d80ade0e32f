//! The vectorised photometric loss: C++ (`cpp/splat/loss_kernel.cpp`), compiled once per instruction set, through cxx.

use std::cell::RefCell;

use crate::ffi::isa::Isa;

#[cxx::bridge(namespace = "respire")]
#[allow(missing_docs, unused_qualifications)]
mod bridge {
    /// The image of one frame, prepared: itself, its blur and the blur of its square, red, green, blue of each pixel.
    struct LossImage<'a> {
        width: usize,
        height: usize,
        target: &'a [f32],
        mean: &'a [f32],
        square: &'a [f32],
        mask: &'a [f32],
        window: &'a [f32],
        ssim_weight: f32,
        /// 0: L1, 1: Charbonnier, 2: Huber.
        norm: u8,
        /// Where the norm becomes linear.
        softness: f32,
    }

    unsafe extern "C++" {
        include!("cpp/splat/loss.h");

        fn loss_scratch(width: usize) -> usize;
        fn loss_band(
            isa: u8,
            image: &LossImage,
            rendered: &[f32],
            y0: usize,
            gradient: &mut [f32],
            room: &mut [f32],
        ) -> Result<f64>;
    }
}

pub use bridge::LossImage;

/// Loss and gradient of some lines of an image, from line `first` on, as many as `gradient` has room for (interleaved).
/// Panics when the tables do not belong together (a defect of the caller, never of the input).
pub fn band(isa: Isa, image: &LossImage<'_>, rendered: &[f32], first: usize, gradient: &mut [f32]) -> f64 {
    // Kept for each thread: its first touch would cost a fifth of the loss.
    thread_local!(static ROOM: RefCell<Vec<f32>> = const { RefCell::new(Vec::new()) });
    ROOM.with_borrow_mut(|room| {
        room.resize(room.len().max(bridge::loss_scratch(image.width)), 0.0);
        bridge::loss_band(isa.code(), image, rendered, first, gradient, room)
            .expect("the loss hands over tables that belong together")
    })
}
