//! Numbers that the rasteriser computes with: `f32` for work, `f64` to be checked against, [`crate::splat::Dual`] of either
//! for forward-mode derivatives. One generic source serves all of them.

use std::fmt::Debug;
use std::ops::{Add, AddAssign, Div, Mul, MulAssign, Neg, Sub, SubAssign};

use crate::ffi::isa::Isa;
use crate::ffi::splat::image::{self as image, ImageBand, Light};
use crate::ffi::splat::rasterize::{self as native, Aligned, Slots};

use crate::splat::kernels::{Native, Numbers, Work};
use crate::splat::plain::disc_tile::{DiscTile, Sums};
use crate::splat::plain::project::Projector;
use crate::splat::plain::tile::{BackwardTile, ForwardTile, Parts};
use crate::splat::types::scene::{Gaussians, ImageGradient, Settings};
use crate::splat::types::tiling::{TILE_SIDE, Tiling};

/// A real number.
pub trait Real:
    Copy
    + Debug
    + Default
    + PartialEq
    + PartialOrd
    + Send
    + Sync
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + AddAssign
    + SubAssign
    + MulAssign
    + 'static
{
    /// A number without a derivative: what is computed in double and rounded loses nothing.
    const PLAIN: bool = false;
    /// The nearest number to `value`.
    fn of(value: f64) -> Self;
    /// The value (without any derivative) as `f64`.
    fn to_f64(self) -> f64;
    /// Square root.
    fn sqrt(self) -> Self;
    /// `2^self`.
    fn exp2(self) -> Self;
    /// `e^self`.
    fn exp(self) -> Self;
    /// Logarithm to base 2.
    fn log2(self) -> Self;
    /// Angle of the vector `(x, self)`.
    fn atan2(self, x: Self) -> Self;
    /// Neither infinite nor NaN.
    fn is_finite(self) -> bool;

    /// True when every value is finite.
    fn all_finite(values: &[Self]) -> bool {
        values.iter().all(|v| v.is_finite())
    }

    /// Zero.
    #[inline(always)]
    fn zero() -> Self {
        Self::of(0.0)
    }

    /// One.
    #[inline(always)]
    fn one() -> Self {
        Self::of(1.0)
    }

    /// The smaller of two numbers, `other` where `self` is NaN.
    #[inline(always)]
    fn minimum(self, other: Self) -> Self {
        if self < other { self } else { other }
    }

    /// The larger of two numbers, `other` where `self` is NaN.
    #[inline(always)]
    fn maximum(self, other: Self) -> Self {
        if self > other { self } else { other }
    }

    /// The vectorised kernels for this scene and view; `None` when there are none for this type, instruction set or
    /// lens.
    fn native<'a>(
        _isa: Isa,
        _gaussians: &'a Gaussians<Self>,
        _projector: &Projector<Self>,
        _numbers: &'a mut Numbers,
        _active: Option<&'a [u32]>,
    ) -> Option<Box<dyn Native<Self> + 'a>> {
        None
    }

    /// Composites one tile together with the velocities of its pixels along up to four directions (`velocities`: one
    /// row per splat, direction by direction; `moving`: red, green, blue and transmittance of each); `false` when there
    /// is no kernel for it.
    fn forward_moving(
        _isa: Isa,
        _tile: &mut ForwardTile<'_, Self>,
        _velocities: &[[Self; 8]],
        _moving: &mut [Self],
    ) -> bool {
        false
    }

    /// Develops a row of tiles (width of the image, side of a tile) with vectorised code; `false` when there is none for this type.
    fn develop_band(_state: &[Self], _width_and_side: [usize; 2], _light: &Light, _band: ImageBand<'_, Self>) -> bool {
        false
    }

    /// Develops a row of tiles' velocities along direction `k` of `directions` with vectorised code; `false` when there is
    /// none for this type.
    fn develop_moving(
        _moving: &[Self],
        _of: [usize; 2],
        _width_and_side: [usize; 2],
        _settings: &Settings,
        _color: &mut [Self],
    ) -> bool {
        false
    }

    /// Adjoint of a tile of an image of `size` with vectorised code, and its part of the gradient of the gain; `None` when there
    /// is none for this type.
    fn adjoint_tile(
        _state: &[Self],
        _tile: (Tiling, usize),
        _size: [usize; 2],
        _light: &Light,
        _image: &ImageGradient<'_, Self>,
        _adjoint: &mut [Self],
    ) -> Option<[f64; 3]> {
        None
    }

    /// Composites one tile with a vectorised kernel; `false` when there is none for this type.
    fn forward_tile(_isa: Isa, _tile: &mut ForwardTile<'_, Self>) -> bool {
        false
    }

    /// Composites one tile of exact discs with a vectorised kernel; `false` when there is none for this type.
    fn disc_forward(_isa: Isa, _tile: &DiscTile<'_, Self>, _with_depth: bool, _state: &mut [Self]) -> bool {
        false
    }

    /// Backward of [`Real::disc_forward`]: the sums of each entry.
    fn disc_backward(
        _isa: Isa,
        _tile: &DiscTile<'_, Self>,
        _adjoint: &[Self],
        _parts: Parts,
    ) -> Option<Vec<Sums<Self>>> {
        None
    }

    /// The slots as the vectorised backward kernel shares them among tiles; `None` when there is none for this type.
    fn shared(_isa: Isa, _slots: &mut [Aligned<Self>]) -> Option<Slots<'_>> {
        None
    }

    /// Backward of [`Real::forward_tile`], for a type that has shared slots.
    fn backward_tile(_isa: Isa, _tile: &BackwardTile<'_, Self>, _slots: &Slots<'_>) {}
}

macro_rules! real_functions {
    ($t:ty) => {
        #[inline(always)]
        fn of(value: f64) -> Self {
            value as $t
        }
        #[inline(always)]
        fn to_f64(self) -> f64 {
            self as f64
        }
        #[inline(always)]
        fn sqrt(self) -> Self {
            <$t>::sqrt(self)
        }
        #[inline(always)]
        fn exp2(self) -> Self {
            <$t>::exp2(self)
        }
        #[inline(always)]
        fn exp(self) -> Self {
            <$t>::exp(self)
        }
        #[inline(always)]
        fn log2(self) -> Self {
            <$t>::log2(self)
        }
        #[inline(always)]
        fn atan2(self, x: Self) -> Self {
            <$t>::atan2(self, x)
        }
        #[inline(always)]
        fn is_finite(self) -> bool {
            <$t>::is_finite(self)
        }
    };
}

impl Real for f64 {
    const PLAIN: bool = true;
    real_functions!(f64);
}

impl Real for f32 {
    const PLAIN: bool = true;
    real_functions!(f32);

    fn native<'a>(
        isa: Isa,
        gaussians: &'a Gaussians<f32>,
        projector: &Projector<f32>,
        numbers: &'a mut Numbers,
        active: Option<&'a [u32]>,
    ) -> Option<Box<dyn Native<f32> + 'a>> {
        Some(Box::new(Work::new(isa, gaussians, projector, numbers, active)?))
    }

    fn all_finite(values: &[f32]) -> bool {
        image::all_finite(values)
    }

    fn develop_band(state: &[f32], width_and_side: [usize; 2], light: &Light, band: ImageBand<'_, f32>) -> bool {
        image::develop(state, width_and_side, light, band);
        true
    }

    fn develop_moving(
        moving: &[f32],
        of: [usize; 2],
        width_and_side: [usize; 2],
        settings: &Settings,
        color: &mut [f32],
    ) -> bool {
        image::develop_moving(moving, of, width_and_side, settings.gain, settings.background, color);
        true
    }

    fn adjoint_tile(
        state: &[f32],
        (tiling, t): (Tiling, usize),
        size: [usize; 2],
        light: &Light,
        image: &ImageGradient<'_, f32>,
        adjoint: &mut [f32],
    ) -> Option<[f64; 3]> {
        let (corner, side) = (tiling.corner(t), TILE_SIDE);
        Some(image::adjoint(state, corner, side, size, light, [image.color, image.depth, image.alpha], adjoint))
    }

    fn forward_moving(isa: Isa, tile: &mut ForwardTile<'_, f32>, velocities: &[[f32; 8]], moving: &mut [f32]) -> bool {
        crate::splat::plain::tile::vector_forward(isa, tile, velocities, moving)
    }

    fn forward_tile(isa: Isa, tile: &mut ForwardTile<'_, f32>) -> bool {
        crate::splat::plain::tile::vector_forward(isa, tile, &[], &mut [])
    }

    fn disc_forward(isa: Isa, tile: &DiscTile<'_, f32>, with_depth: bool, state: &mut [f32]) -> bool {
        if isa != Isa::Scalar {
            native::disc_forward(isa, &tile.native(), with_depth, state);
        }
        isa != Isa::Scalar
    }

    fn disc_backward(isa: Isa, tile: &DiscTile<'_, f32>, adjoint: &[f32], parts: Parts) -> Option<Vec<Sums<f32>>> {
        if isa == Isa::Scalar {
            return None;
        }
        let mut sums = vec![Sums::<f32>::default(); tile.entries.len()];
        native::disc_backward(isa, &tile.native(), adjoint, parts.bits(), sums.as_flattened_mut());
        Some(sums)
    }

    fn shared(isa: Isa, slots: &mut [Aligned<f32>]) -> Option<Slots<'_>> {
        (isa != Isa::Scalar).then(|| Slots::new(slots))
    }

    fn backward_tile(isa: Isa, tile: &BackwardTile<'_, f32>, slots: &Slots<'_>) {
        crate::splat::plain::tile::vector_backward(isa, tile, slots);
    }
}
