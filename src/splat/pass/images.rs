//! The last stage of a forward pass: from the sums of the tiles to images in rows.

use rayon::prelude::*;

use crate::ffi::splat::image::ImageBand;
use crate::splat::kernels::SplatKernels;
use crate::splat::types::table::PLANES;
use crate::splat::types::{DepthOutput, PIXELS, Rendered, TILE_SIDE};

use super::bins::Bins;
use super::forward::{TilePass, image_formation};
use super::pool::{PIECE, cut};

/// The images of the last pass.
#[derive(Debug, Default)]
pub struct Images<T> {
    pub rendered: Rendered<T>,
    /// Whether all of `rendered.depth` is known to be 0.
    depth_is_zero: bool,
}

impl<T: SplatKernels> Images<T> {
    /// Fills the images: adds the background, applies the gain, divides depth by alpha.
    pub fn develop(&mut self, pass: &TilePass<'_, T>, bins: &Bins, state: &[T]) {
        let ([width, height], settings) = (pass.size, &pass.settings);
        let out = &mut self.rendered;
        (out.width, out.height) = (width, height);
        out.color.resize(width * height * 3, T::zero());
        // A depth image that is not requested is not written again while it is 0.
        let depth_stays =
            settings.depth == DepthOutput::Skip && self.depth_is_zero && out.depth.len() == width * height;
        out.depth.resize(width * height, T::zero());
        out.alpha.resize(width * height, T::zero());
        let formation = image_formation(settings, settings.composites_depth());
        let (band, per_row) = (TILE_SIDE * width, bins.tiling.columns * PLANES * PIXELS);
        let depth = if depth_stays { &mut [][..] } else { &mut out.depth[..] };
        let depths = cut(depth, out.alpha.chunks(band).map(|alpha| if depth_stays { 0 } else { alpha.len() }));
        let bands = out.color.par_chunks_mut(3 * band).zip(depths);
        bands.zip(out.alpha.par_chunks_mut(band)).enumerate().with_max_len(PIECE).for_each(
            |(row, ((color, depth), alpha))| {
                T::develop(&state[row * per_row..][..per_row], width, &formation, ImageBand { color, depth, alpha });
            },
        );
        self.depth_is_zero = !formation.with_depth;
    }

    /// Takes a depth image that was not composited with the colours.
    pub fn set_depth(&mut self, depth: Vec<T>) {
        self.rendered.depth = depth;
        self.depth_is_zero = false;
    }
}
