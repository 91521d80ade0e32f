//! Between the tiles of the rasteriser and images in rows: C++ (`cpp/splat/image.cpp`), four pixels at a time, through
//! cxx. Panics when tables do not belong together (a defect of the caller, never of the input).

#[cxx::bridge(namespace = "respire")]
#[allow(missing_docs, unused_qualifications)]
mod bridge {
    /// How the sums of a tile become pixels: `color = gain (sum + transmittance background)`.
    #[derive(Clone, Copy, Debug)]
    struct ImageFormation {
        /// Per channel.
        gain: [f64; 3],
        /// Before the gain.
        background: [f64; 3],
        /// Whether the depth plane is filled.
        with_depth: bool,
    }

    /// A tile's place in its image, in pixels.
    #[derive(Clone, Copy, Debug)]
    struct TilePlace {
        /// Upper left corner.
        corner: [usize; 2],
        /// Width and height of the image.
        size: [usize; 2],
    }

    /// Gradients by the images, row by row; empty for none.
    #[derive(Clone, Copy, Debug)]
    struct PixelGradients<'a> {
        /// 3 values a pixel.
        color: &'a [f32],
        /// 1 value a pixel.
        depth: &'a [f32],
        /// 1 value a pixel.
        alpha: &'a [f32],
    }

    // SAFETY: the functions check all indices and lengths before they read or write (`cpp/splat/image.cpp`) and throw
    // where they do not fit, which becomes an `Err`; none keeps a pointer, calls back into Rust, or writes what it was
    // not given as `&mut`. Sides are bounded, so that their products do not wrap.
    unsafe extern "C++" {
        include!("cpp/splat/image.h");

        fn splat_develop(
            state: &[f32],
            width: usize,
            formation: &ImageFormation,
            color: &mut [f32],
            depth: &mut [f32],
            alpha: &mut [f32],
        ) -> Result<()>;
        fn splat_develop_moving(
            moving: &[f32],
            directions: usize,
            direction: usize,
            width: usize,
            formation: &ImageFormation,
            color: &mut [f32],
        ) -> Result<()>;
        fn splat_adjoint(
            state: &[f32],
            place: &TilePlace,
            formation: &ImageFormation,
            image: &PixelGradients,
            adjoint: &mut [f32],
        ) -> Result<[f64; 3]>;
    }
}

pub use bridge::{ImageFormation, PixelGradients, TilePlace};

/// The caller's invariant: breaking it is a defect of this crate, never of the input.
const AGREE: &str = "the rasteriser hands over tables that belong together";

/// The lines of the three images that a row of tiles covers.
#[derive(Debug)]
pub struct ImageBand<'a, T> {
    /// 3 values a pixel.
    pub color: &'a mut [T],
    /// 1 value a pixel, or empty if it is to stay unchanged.
    pub depth: &'a mut [T],
    /// 1 value a pixel.
    pub alpha: &'a mut [T],
}

/// From the sums of a row of tiles to images of `width` pixels.
pub fn develop(state: &[f32], width: usize, formation: &ImageFormation, band: ImageBand<'_, f32>) {
    bridge::splat_develop(state, width, formation, band.color, band.depth, band.alpha).expect(AGREE);
}

/// From the velocities of a row of tiles, along `directions` directions in each, to lines of the velocity of the colour
/// along number `direction`.
pub fn develop_moving(
    moving: &[f32],
    [direction, directions]: [usize; 2],
    width: usize,
    formation: &ImageFormation,
    color: &mut [f32],
) {
    bridge::splat_develop_moving(moving, directions, direction, width, formation, color).expect(AGREE);
}

/// From image gradients to the adjoint of one tile; returns the tile's part of the gradient of the gain.
pub fn adjoint(
    state: &[f32],
    place: &TilePlace,
    formation: &ImageFormation,
    image: &PixelGradients<'_>,
    adjoint: &mut [f32],
) -> [f64; 3] {
    bridge::splat_adjoint(state, place, formation, image, adjoint).expect(AGREE)
}

/// True when every value is finite.
pub fn all_finite(values: &[f32]) -> bool {
    // Without branches, so that the compiler can test many at once.
    let wrong = |v: &f32| (v.to_bits() & 0x7f80_0000 == 0x7f80_0000) as u32;
    values.chunks(1024).all(|chunk| chunk.iter().fold(0, |any, v| any | wrong(v)) == 0)
}
