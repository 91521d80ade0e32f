//! Any number of further channels (normals, labels, features), composited with the weights of the image.
//!
//! Three channels at a time take the place of the colours in the tables of the last pass and go through the same
//! kernels, forward and backward: a group of three costs about a forward composite, and in the backward pass a backward
//! one. Where nobody asks, nothing is done. No background, no gain, not divided by alpha.

use rayon::prelude::*;

use glam::DVec3;

use crate::base::{Error, Result};

use crate::splat::number::real::Real;
use crate::splat::pass::rasterizer::Rasterizer;
use crate::splat::plain::chain::ellipsoid_gradient;
use crate::splat::plain::disc::{cross, plane_of};
use crate::splat::plain::disc_tile::sum;
use crate::splat::plain::fault::{Faults, Sound};
use crate::splat::plain::project::{at, columns, dot};
use crate::splat::plain::tile::{PIXELS, PLANES, Parts, moment};
use crate::splat::types::scene::{
    DepthOutput, Footprint, Gaussians, Gradients, ImageGradient, Settings, Shape, View, Wanted,
};
use crate::splat::types::skips::Skips;

/// Channels per pass.
const GROUP: usize = 3;

/// The further channels of the last pass.
#[derive(Debug, Default)]
pub(in crate::splat) struct Extra<T> {
    /// How many there are; 0 for none.
    pub count: usize,
    /// Per active Gaussian.
    features: Vec<T>,
    /// State of the tiles per group.
    states: Vec<Vec<T>>,
    image: Vec<T>,
}

fn plain(settings: &Settings) -> Settings {
    Settings { gain: [1.0; 3], background: [0.0; 3], depth: DepthOutput::Skip, ..*settings }
}

impl<T: Real> Rasterizer<T> {
    /// Composites `count` further channels in the view of the last [`Rasterizer::render`]: `features` has `count` values
    /// per Gaussian (of all, not of the active alone), the image `count` per pixel, row by row: sums of the features
    /// weighted like the colours, 0 where nothing is, not divided by alpha. [`Rasterizer::backward`] then takes their
    /// gradient in `ImageGradient::channels`.
    ///
    /// Errors: no render before; another number of features; a feature that is not finite.
    pub fn render_channels(&mut self, features: &[T], count: usize) -> Result<&[T]> {
        let (view, settings, n) = self.last.ok_or_else(|| Error::input("channels need a render before them"))?;
        if count == 0 || features.len() != n * count {
            let found = features.len();
            return Err(Error::input(format!("{count} channels of {n} Gaussians are not {found} features")));
        }
        if let Some(bad) = features.iter().position(|v| !v.is_finite()) {
            let element = format!("Gaussian {}, channel {}", bad / count, bad % count);
            return Err(Error::input("a feature is not finite").element(element));
        }
        let mut extra = std::mem::take(&mut self.extra);
        extra.count = count;
        extra.features.clear();
        match self.active.as_deref() {
            None => extra.features.extend_from_slice(features),
            Some(list) => {
                let of = |&i: &u32| &features[i as usize * count..(i as usize + 1) * count];
                extra.features.extend(list.iter().flat_map(of));
            }
        }
        let (width, height) = (self.rendered.width, self.rendered.height);
        extra.image.resize(width * height * count, T::zero());
        extra.states.resize_with(count.div_ceil(GROUP), Vec::new);
        let colors = self.colors();
        for group in 0..count.div_ceil(GROUP) {
            self.show(&extra, group);
            std::mem::swap(&mut self.state, &mut extra.states[group]);
            match settings.footprint {
                Footprint::Ewa => drop(self.composite(DepthOutput::Skip, &[], 0)),
                Footprint::Disc => self.composite_discs(&view, &plain(&settings)),
            }
            std::mem::swap(&mut self.state, &mut extra.states[group]);
            let (state, tiling) = (&extra.states[group], self.bins.tiling);
            extra.image.par_chunks_mut(width * count).enumerate().for_each(|(y, line)| {
                for (x, pixel) in line.chunks_mut(count).enumerate() {
                    let (t, p) = tiling.place(x, y);
                    let tile = &state[t * PLANES * PIXELS..][..PLANES * PIXELS];
                    for (k, value) in pixel.iter_mut().skip(GROUP * group).take(GROUP).enumerate() {
                        *value = tile[k * PIXELS + p];
                    }
                }
            });
        }
        self.restore(&colors);
        self.extra = extra;
        Ok(&self.extra.image)
    }

    /// The colours in the tables.
    fn colors(&self) -> Vec<[T; 3]> {
        let of = |j: usize| [0, 1, 2].map(|k| self.rows[j].0[at::RED + k]);
        (0..self.rendered.visible.len()).map(of).collect()
    }

    fn restore(&mut self, colors: &[[T; 3]]) {
        for (row, color) in self.rows.iter_mut().zip(colors) {
            row.0[at::RED..at::RED + 3].copy_from_slice(color);
        }
    }

    /// Puts a group of channels in the place of the colours.
    fn show(&mut self, extra: &Extra<T>, group: usize) {
        for (row, features) in self.rows.iter_mut().zip(extra.features.chunks(extra.count)) {
            for k in 0..GROUP {
                row.0[at::RED + k] = features.get(GROUP * group + k).copied().unwrap_or_default();
            }
        }
    }

    /// Adds what comes through the channels to the moments of the last backward pass (`geometry`), and computes the
    /// gradients of the features.
    pub(in crate::splat) fn channels_backward(
        &mut self,
        by_channels: &[T],
        view: &View,
        settings: &Settings,
        geometry: bool,
        wanted: Wanted,
        faults: impl Faults,
    ) {
        let mut extra = std::mem::take(&mut self.extra);
        let (n, count) = (self.rendered.visible.len(), extra.count);
        let with_features = wanted.any(Wanted::CHANNELS);
        self.gradients.channels.clear();
        self.gradients.channels.resize(if with_features { n * count } else { 0 }, T::zero());
        if by_channels.is_empty() || !(with_features || geometry) {
            self.extra = extra;
            return;
        }
        let parts = Some(Parts {
            geometry,
            color: with_features,
            depth: false,
            known: false,
            endless: !self.skips.any(Skips::STOP),
        });
        let (gain, colors) = (self.gradients.gain, self.colors());
        let pixels = self.rendered.width * self.rendered.height;
        let mut by_color = vec![T::zero(); pixels * 3];
        for group in 0..count.div_ceil(GROUP) {
            for (pixel, channels) in by_color.as_chunks_mut::<3>().0.iter_mut().zip(by_channels.chunks(count)) {
                *pixel = [0, 1, 2].map(|k| channels.get(GROUP * group + k).copied().unwrap_or_default());
            }
            self.show(&extra, group);
            std::mem::swap(&mut self.state, &mut extra.states[group]);
            let (slots, sums) = (std::mem::take(&mut self.slots), std::mem::take(&mut self.disc_slots));
            let image = ImageGradient { color: &by_color, ..ImageGradient::default() };
            self.composite_backward(&image, view, &plain(settings), parts, false, faults);
            let of_group = (std::mem::replace(&mut self.slots, slots), std::mem::replace(&mut self.disc_slots, sums));
            std::mem::swap(&mut self.state, &mut extra.states[group]);
            let discs = settings.footprint == Footprint::Disc;
            if geometry && discs {
                for (sums, more) in self.disc_slots.iter_mut().zip(&of_group.1) {
                    let of_colors = sum::RED..sum::RED + 3;
                    (0..sum::COUNT).filter(|k| !of_colors.contains(k)).for_each(|k| sums[k] += more[k]);
                }
            } else if geometry {
                for (slot, more) in self.slots.iter_mut().zip(&of_group.0) {
                    (0..moment::RED).for_each(|k| slot.0[k] += more.0[k]);
                }
            }
            if with_features {
                let starts = &self.bins.starts;
                let out = self.gradients.channels.par_chunks_mut(count).zip(starts.par_windows(2));
                out.zip(&self.rendered.visible).for_each(|((out, span), visible)| {
                    let span = if *visible { span } else { &[0, 0] };
                    for (k, out) in out.iter_mut().skip(GROUP * group).take(GROUP).enumerate() {
                        let mut total = T::zero();
                        for place in span[0] as usize..span[1] as usize {
                            total += if discs {
                                of_group.1[place][sum::RED + k]
                            } else {
                                of_group.0[place].0[moment::RED + k]
                            };
                        }
                        *out = if total.is_finite() { total } else { T::zero() };
                    }
                });
            }
        }
        self.restore(&colors);
        self.gradients.gain = gain;
        self.extra = extra;
    }
}

/// Unit normal of Gaussian `i` in world axes, turned towards the eye; its sign and the length of what it was divided by.
fn normal<T: Real>(gaussians: &Gaussians<T>, i: usize, eye: [T; 3]) -> ([T; 3], T, T) {
    let columns = columns(&gaussians.shape, i);
    let [a, b] = plane_of(&gaussians.shape, i).map(|k| columns[k]);
    let product = cross(a, b);
    let length = dot(product, product).sqrt();
    let offset = [0, 1, 2].map(|k| gaussians.positions[i][k] - eye[k]);
    let sign = if dot(product, offset) > T::zero() { -T::one() } else { T::one() };
    let unit = product.map(|v| sign * v / length);
    if unit.iter().all(|v| v.is_finite()) { (unit, sign, length) } else { ([T::zero(); 3], T::zero(), T::one()) }
}

fn matrix<T: Real>(view: &View) -> [[T; 3]; 3] {
    let m = view.camera_from_world.matrix3;
    [0, 1, 2].map(|row| [m.x_axis[row], m.y_axis[row], m.z_axis[row]].map(T::of))
}

fn eye<T: Real>(view: &View) -> [T; 3] {
    let eye: DVec3 = view.camera_from_world.inverse().translation;
    eye.to_array().map(T::of)
}

impl<T: Real> Gaussians<T> {
    /// Unit normals in camera axes, three values per Gaussian, turned towards the camera: features for
    /// [`Rasterizer::render_channels`]. Of a disc the normal of its axes, of an ellipsoid the direction of its shortest
    /// axis; 0 where there is none.
    pub fn normals(&self, view: &View) -> Vec<T> {
        let (m, eye) = (matrix::<T>(view), eye::<T>(view));
        let of = |i: usize| {
            let unit = normal(self, i, eye).0;
            m.map(|row| dot(row, unit))
        };
        (0..self.len()).into_par_iter().flat_map_iter(of).collect()
    }

    /// Adds to `gradients` (groups that it holds: axes or rotations, and the pose) what comes through
    /// [`Gaussians::normals`], whose gradient is `by_normals`, three values per active Gaussian.
    ///
    /// Errors: another number of values than of gradients.
    pub fn normals_pullback(
        &self,
        view: &View,
        by_normals: &[T],
        active: Option<&[u32]>,
        gradients: &mut Gradients<T>,
    ) -> Result<()> {
        let n = active.map_or(self.len(), <[u32]>::len);
        let fits = |held: usize| held == 0 || held == n;
        if by_normals.len() != 3 * n || !fits(gradients.axes.len()) || !fits(gradients.rotations.len()) {
            return Err(Error::input("the gradient of the normals has another length than the other gradients"));
        }
        let (m, eye) = (matrix::<T>(view), eye::<T>(view));
        for (j, by_normal) in by_normals.as_chunks::<3>().0.iter().enumerate() {
            let i = active.map_or(j, |list| list[j] as usize);
            let (unit, sign, length) = normal(self, i, eye);
            let turned = cross(m.map(|row| dot(row, unit)), *by_normal);
            (0..3).for_each(|k| gradients.pose[k] += turned[k].to_f64());
            let by_unit = [0, 1, 2].map(|k| m[0][k] * by_normal[0] + m[1][k] * by_normal[1] + m[2][k] * by_normal[2]);
            let along = dot(by_unit, unit);
            let by_product = [0, 1, 2].map(|k| sign * (by_unit[k] - along * unit[k]) / length);
            let [first, second] = plane_of(&self.shape, i);
            let all = columns(&self.shape, i);
            let mut by_columns = [[T::zero(); 3]; 3];
            by_columns[first] = cross(all[second], by_product);
            by_columns[second] = cross(by_product, all[first]);
            if let Some(axes) = gradients.axes.get_mut(j) {
                (0..3).for_each(|k| axes[0][k] += by_columns[0][k]);
                (0..3).for_each(|k| axes[1][k] += by_columns[1][k]);
            }
            if let (Some(rotation), Shape::Ellipsoids { .. }) = (gradients.rotations.get_mut(j), &self.shape) {
                let (by_rotation, _) = ellipsoid_gradient(&self.shape, i, &by_columns, Sound);
                (0..4).for_each(|k| rotation[k] += by_rotation[k]);
            }
        }
        Ok(())
    }
}
