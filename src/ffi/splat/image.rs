//! Between the tiles of the rasteriser and images in rows: C++ (`cpp/splat/image.cpp`), four pixels at a time, through
//! cxx. Panics when tables do not belong together (a defect of the caller, never of the input).

#[cxx::bridge(namespace = "respire")]
#[allow(missing_docs)]
mod bridge {
    unsafe extern "C++" {
        include!("cpp/splat/image.h");

        fn splat_develop(
            state: &[f32],
            width: usize,
            side: usize,
            gain: [f32; 3],
            background: [f32; 3],
            with_depth: bool,
            color: &mut [f32],
            depth: &mut [f32],
            alpha: &mut [f32],
        ) -> Result<()>;
        fn splat_develop_moving(
            moving: &[f32],
            directions: usize,
            k: usize,
            width: usize,
            side: usize,
            gain: [f32; 3],
            background: [f32; 3],
            color: &mut [f32],
        ) -> Result<()>;
        fn splat_adjoint(
            state: &[f32],
            x: usize,
            y: usize,
            side: usize,
            width: usize,
            height: usize,
            gain: [f32; 3],
            background: [f32; 3],
            color: &[f32],
            depth: &[f32],
            alpha: &[f32],
            adjoint: &mut [f32],
            by_gain: &mut [f64; 3],
        ) -> Result<()>;
    }
}

const AGREE: &str = "the rasteriser hands over tables that belong together";

/// What the sums of a tile are seen through.
#[derive(Clone, Copy, Debug)]
pub struct Light {
    /// Per channel.
    pub gain: [f64; 3],
    /// Before the gain.
    pub background: [f64; 3],
    /// Whether the depth plane is filled.
    pub with_depth: bool,
}

/// The lines of the three images that a row of tiles covers.
#[derive(Debug)]
pub struct ImageBand<'a, T> {
    /// 3 values a pixel.
    pub color: &'a mut [T],
    /// 1 value a pixel, or empty where it stays as it is.
    pub depth: &'a mut [T],
    /// 1 value a pixel.
    pub alpha: &'a mut [T],
}

fn single(v: [f64; 3]) -> [f32; 3] {
    v.map(|c| c as f32)
}

/// Sums of a row of tiles of `side` pixels to images of `width` pixels.
pub fn develop(state: &[f32], [width, side]: [usize; 2], light: &Light, band: ImageBand<'_, f32>) {
    let (gain, background) = (single(light.gain), single(light.background));
    bridge::splat_develop(state, width, side, gain, background, light.with_depth, band.color, band.depth, band.alpha)
        .expect(AGREE);
}

/// Velocities of a row of tiles, `directions` in each, to lines of the velocity of the colour along direction `k`.
pub fn develop_moving(
    moving: &[f32],
    [k, directions]: [usize; 2],
    [width, side]: [usize; 2],
    gain: [f64; 3],
    background: [f64; 3],
    color: &mut [f32],
) {
    bridge::splat_develop_moving(moving, directions, k, width, side, single(gain), single(background), color)
        .expect(AGREE);
}

/// Image gradients (colour, depth, alpha; empty for none) to the adjoint of the tile at `corner`, `side` pixels wide, of an image of `size`;
/// returns the tile's part of the gradient of the gain.
pub fn adjoint(
    state: &[f32],
    corner: [usize; 2],
    side: usize,
    size: [usize; 2],
    light: &Light,
    image: [&[f32]; 3],
    adjoint: &mut [f32],
) -> [f64; 3] {
    let mut by_gain = [0.0; 3];
    let ([x, y], [width, height]) = (corner, size);
    let (gain, background) = (single(light.gain), single(light.background));
    let [color, depth, alpha] = image;
    bridge::splat_adjoint(
        state,
        x,
        y,
        side,
        width,
        height,
        gain,
        background,
        color,
        depth,
        alpha,
        adjoint,
        &mut by_gain,
    )
    .expect(AGREE);
    by_gain
}

/// True when every value is finite.
pub fn all_finite(values: &[f32]) -> bool {
    // Without branches, so that the compiler can look at many at once.
    let wrong = |v: &f32| (v.to_bits() & 0x7f80_0000 == 0x7f80_0000) as u32;
    values.chunks(1024).all(|chunk| chunk.iter().fold(0, |found, v| found | wrong(v)) == 0)
}
