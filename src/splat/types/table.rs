//! Columns of the tables between the stages, shared with C++ (`cpp/splat/kernel.h`).

/// One splat: sixteen numbers, whose columns are in [`at`].
pub type SplatRow<T> = [T; 16];

/// The sums of a backward pass over the pixels of one exact disc; columns in [`disc_sum`].
pub type DiscSums<T> = [T; disc_sum::COUNT];

/// The three thresholds of 3DGS (Kerbl et al. 2023, its public rasteriser), as in `cpp/splat/kernel.h`: nothing is blended
/// below this alpha,
pub const ALPHA_MIN: f64 = 1.0 / 255.0;
/// no alpha is larger than this,
pub const ALPHA_MAX: f64 = 0.99;
/// and a pixel stops at the splat that would leave no more than this part of the light.
pub const STOP: f64 = 1e-4;
/// A logarithm (base 2) well below that of [`ALPHA_MIN`], where the power is spared.
pub const SPARED_LOG2_ALPHA: f64 = -8.0;
/// `log2(255)`: how far below 1 an alpha of [`ALPHA_MIN`] lies, in powers of 2.
pub const LOG2_255: f64 = 7.994353436858858;

/// Planes of a tile's state (red, green, blue, depth, transmittance) and of its adjoint (the same, then `behind`).
pub const PLANES: usize = 5;
/// Planes of the velocity of a tile along a direction: red, green, blue, transmittance.
pub const VELOCITY_PLANES: usize = 4;
/// Directions that one pass of the vectorised kernels carries.
pub const DIRECTIONS_PER_PASS: usize = 4;
/// The mask of an entry that may touch every 4x4 block of its tile.
pub const ALL_BLOCKS: u16 = 0xffff;

/// Columns of a splat's row of 16 numbers.
pub mod at {
    /// Image point of the centre (pixels).
    pub const X: usize = 0;
    pub const Y: usize = 1;
    /// `exponent = LOG2_OPACITY - (A dx^2 + B dx dy + C dy^2)`, alpha is 2 to that.
    pub const A: usize = 2;
    pub const B: usize = 3;
    pub const C: usize = 4;
    pub const LOG2_OPACITY: usize = 5;
    /// Colour towards the eye.
    pub const RED: usize = 6;
    pub const DEPTH: usize = 9;
    /// Half size of the bounding box of alpha >= 1/255 (pixels).
    pub const HALF_WIDTH: usize = 10;
    pub const HALF_HEIGHT: usize = 11;
    /// `B^2 - 4 A C`, computed without cancellation.
    pub const DISCRIMINANT: usize = 12;
    /// `y` of the rightmost point of the outline of alpha = 1/255.
    pub const WIDEST: usize = 13;
    /// Rounding error of X and Y: at some hundred pixels single precision resolves 1e-5 of a pixel, which changes the
    /// alpha of a splat that is no larger than a pixel by 1e-4.
    pub const X_REST: usize = 14;
    pub const Y_REST: usize = 15;
}

/// Columns of the moments of one splat in one tile: sums over its pixels, with `v = alpha d loss / d alpha` and the
/// offset `(dx, dy)` of the pixel from the splat.
pub mod moment {
    /// Of `v`, `v dx`, `v dy`, `v dx^2`, `v dx dy`, `v dy^2`.
    pub const S: usize = 0;
    pub const X: usize = 1;
    pub const Y: usize = 2;
    pub const XX: usize = 3;
    pub const XY: usize = 4;
    pub const YY: usize = 5;
    /// Of the gradient of the depth.
    pub const DEPTH: usize = 6;
    /// Of the gradient of the colour.
    pub const RED: usize = 8;
}

/// Columns of the sums of one exact disc in one tile (symbols in `plain/disc.rs`).
pub mod disc_sum {
    pub const S: usize = 0;
    pub const RED: usize = 1;
    /// Of the screen filter: `v dx`, `v dy`.
    pub const FILTER: usize = 4;
    /// Depth of the centre.
    pub const DEPTH: usize = 6;
    /// `N.t`.
    pub const HEIGHT: usize = 7;
    /// Of `P.d`, `Q.d` with the offset of the ray, and with `d_z`.
    pub const P: usize = 8;
    pub const Q: usize = 11;
    pub const P_ALONG: usize = 14;
    pub const Q_ALONG: usize = 15;
    /// Of `N.d` with the ray.
    pub const N: usize = 16;
    pub const COUNT: usize = 19;
}
