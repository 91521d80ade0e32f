//! Any number of further channels (normals, labels, features), composited with the weights of the image.
//!
//! Three channels at a time take the place of the colours in the tables of the last pass and go through the same
//! kernels: a group of three costs about as much as compositing the colours, forward and backward. Without channels
//! nothing is done. No background, no gain, not divided by alpha.

use rayon::prelude::*;

use crate::base::estimate::demand_memory;
use crate::base::{Error, Result};
use crate::ffi::splat::rasterize::Aligned;
use crate::splat::kernels::SplatKernels;
use crate::splat::plain::fault::Faults;
use crate::splat::plain::tile::Parts;
use crate::splat::types::table::{PLANES, disc_sum, moment};
use crate::splat::types::{DepthOutput, ImageGradient, PIXELS, Settings, Skips, Tiling};

use super::backward::{Moments, TileGradient};
use super::bins::Bins;
use super::forward::TilePass;
use super::splats::Splats;

/// Channels per pass.
const GROUP: usize = 3;

/// The further channels of the last pass.
#[derive(Debug, Default)]
pub struct Channels<T> {
    /// How many there are; 0 for none.
    pub count: usize,
    /// Per active Gaussian.
    features: Vec<T>,
    /// State of the tiles per group.
    states: Vec<Vec<T>>,
    pub image: Vec<T>,
}

/// Which gradients of the channels are wanted.
#[derive(Clone, Copy)]
pub struct ChannelsWanted {
    /// Those of the features.
    pub features: bool,
    /// Those of the geometry, through the weights.
    pub geometry: bool,
}

/// The pass with neither gain nor background nor depth.
fn bare<'a, T>(pass: &TilePass<'a, T>) -> TilePass<'a, T>
where
    T: Copy,
{
    let settings = Settings { gain: [1.0; 3], background: [0.0; 3], depth: DepthOutput::Skip, ..pass.settings };
    TilePass { settings, ..*pass }
}

impl<T: SplatKernels> Channels<T> {
    /// Bytes of the image of `count` channels, and of the states of its groups, for an image of `size` (width, height).
    pub fn bytes(size: [usize; 2], count: usize) -> f64 {
        let (pixels, of_tiles) = (size[0] as f64 * size[1] as f64, (Tiling::of(size).count() * PIXELS) as f64);
        let states = count.div_ceil(GROUP) as f64 * PLANES as f64 * of_tiles;
        (pixels * count as f64 + states) * size_of::<T>() as f64
    }

    /// Takes `count` features of each of `n` Gaussians and keeps those of the active ones, for an image of `size`
    /// (width, height).
    ///
    /// Errors: another number of features, one that is not finite, more than this machine has memory left for.
    pub fn set_features(
        &mut self,
        features: &[T],
        (count, n): (usize, usize),
        active: Option<&[u32]>,
        size: [usize; 2],
    ) -> Result<()> {
        if count == 0 || n.checked_mul(count) != Some(features.len()) {
            let found = features.len();
            return Err(Error::input(format!("{count} channels of {n} Gaussians are not {found} features")));
        }
        if let Some(bad) = features.iter().position(|v| !v.is_finite()) {
            let element = format!("Gaussian {}, channel {}", bad / count, bad % count);
            return Err(Error::input("a feature is not finite").element(element));
        }
        let there = self.image.capacity() + self.states.iter().map(Vec::capacity).sum::<usize>();
        let wanted = Self::bytes(size, count) + size_of_val(features) as f64;
        let new_bytes = wanted - (there * size_of::<T>()) as f64;
        demand_memory(format_args!("{count} channels of an image of {}x{} pixels", size[0], size[1]), new_bytes)?;
        self.count = count;
        self.features.clear();
        match active {
            None => self.features.extend_from_slice(features),
            Some(list) => {
                let of = |&i: &u32| &features[i as usize * count..(i as usize + 1) * count];
                self.features.extend(list.iter().flat_map(of));
            }
        }
        Ok(())
    }

    /// Composites the features group by group.
    pub fn render(&mut self, pass: &TilePass<'_, T>, splats: &mut Splats<T>, bins: &mut Bins) {
        let ([width, height], count) = (pass.size, self.count);
        self.image.resize(width * height * count, T::zero());
        self.states.resize_with(count.div_ceil(GROUP), Vec::new);
        let colors = splats.colors(self.features.len() / count);
        for group in 0..count.div_ceil(GROUP) {
            splats.set_colors(self.group(group));
            bare(pass).forward(splats, bins, false, &mut self.states[group]);
            let (state, tiling) = (&self.states[group], bins.tiling);
            self.image.par_chunks_mut(width * count).enumerate().for_each(|(y, line)| {
                for (x, pixel) in line.chunks_mut(count).enumerate() {
                    let (t, p) = tiling.place(x, y);
                    let tile = &state[t * PLANES * PIXELS..][..PLANES * PIXELS];
                    for (k, value) in pixel.iter_mut().skip(GROUP * group).take(GROUP).enumerate() {
                        *value = tile[k * PIXELS + p];
                    }
                }
            });
        }
        splats.set_colors(colors.into_iter());
    }

    /// The features of a group, laid out as colours.
    fn group(&self, group: usize) -> impl Iterator<Item = [T; 3]> {
        let of = move |features: &[T]| [0, 1, 2].map(|k| features.get(GROUP * group + k).copied().unwrap_or_default());
        self.features.chunks(self.count).map(of)
    }

    /// Adds the gradients through the channels to the moments of the last backward pass, and returns the gradients of
    /// the features, Gaussian by Gaussian; none if they are not wanted.
    pub fn backward(
        &mut self,
        by_channels: &[T],
        pass: &TilePass<'_, T>,
        splats: &mut Splats<T>,
        (bins, visible): (&Bins, &[bool]),
        moments: &mut Moments<T>,
        (wanted, faults): (ChannelsWanted, impl Faults),
    ) -> Vec<T> {
        let count = self.count;
        let mut by_features = vec![T::zero(); if wanted.features { visible.len() * count } else { 0 }];
        if by_channels.is_empty() || !(wanted.features || wanted.geometry) {
            return by_features;
        }
        let parts = Some(Parts {
            geometry: wanted.geometry,
            color: wanted.features,
            depth: false,
            known: false,
            endless: !pass.options.skips.any(Skips::STOP),
        });
        let colors = splats.colors(visible.len());
        let mut by_color = vec![T::zero(); pass.size[0] * pass.size[1] * 3];
        for group in 0..count.div_ceil(GROUP) {
            for (pixel, channels) in by_color.as_chunks_mut::<3>().0.iter_mut().zip(by_channels.chunks(count)) {
                *pixel = [0, 1, 2].map(|k| channels.get(GROUP * group + k).copied().unwrap_or_default());
            }
            splats.set_colors(self.group(group));
            let image = ImageGradient { color: &by_color, ..ImageGradient::default() };
            let mut of_group = Moments::default();
            let gradient = TileGradient { image: &image, parts };
            bare(pass).backward(splats, bins, &self.states[group], &gradient, &mut of_group, faults);
            if wanted.geometry {
                moments.add_geometry(&of_group);
            }
            if wanted.features {
                let out = by_features.par_chunks_mut(count).zip(bins.starts.par_windows(2));
                out.zip(visible).for_each(|((out, span), visible)| {
                    let span = if *visible { span } else { &[0, 0] };
                    for (k, out) in out.iter_mut().skip(GROUP * group).take(GROUP).enumerate() {
                        let mut total = T::zero();
                        for slot in span[0] as usize..span[1] as usize {
                            total += of_group.color(slot, k, pass.optics.is_some());
                        }
                        *out = total.finite_or_zero();
                    }
                });
            }
        }
        splats.set_colors(colors.into_iter());
        by_features
    }
}

impl<T: SplatKernels> Moments<T> {
    /// Adds all columns of `more` but the colours.
    fn add_geometry(&mut self, more: &Moments<T>) {
        let of_colors = disc_sum::RED..disc_sum::RED + 3;
        for (sums, more) in self.discs.iter_mut().zip(&more.discs) {
            (0..disc_sum::COUNT).filter(|k| !of_colors.contains(k)).for_each(|k| sums[k] += more[k]);
        }
        let slots = self.splats.iter_mut().zip(&mut self.live).zip(more.splats.iter().zip(&more.live));
        for ((slot, live), (more, _)) in slots.filter(|(_, (_, live))| **live) {
            if !*live {
                (*slot, *live) = (Aligned([T::zero(); 16]), true);
            }
            (0..moment::RED).for_each(|k| slot.0[k] += more.0[k]);
        }
    }

    /// Gradient of colour `k` in a slot.
    fn color(&self, slot: usize, k: usize, discs: bool) -> T {
        if discs { self.discs[slot][disc_sum::RED + k] } else { self.splats[slot].0[moment::RED + k] }
    }
}
