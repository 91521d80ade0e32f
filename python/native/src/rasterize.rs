//! The splat core behind `rasterize`: arrays of numpy are read where they lie, and the images of a pass are written into
//! arrays of numpy. One call is one camera.
//!
//! A colour `c` of a Gaussian goes into the core as the spherical harmonic of degree 0 that gives `c + lift`, where
//! `lift` keeps all colours above the core's clamp at 0; the background is lifted alike, so that the image is only
//! `lift` too bright, everywhere. Colours beyond the third, and features, are further channels of the core, which it
//! does not clamp. Where a colour is so negative that its lift would cost the others their last digits, all colours are
//! further channels.

use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use numpy::{Element, PyArray1, PyArrayDyn, PyReadonlyArray, PyReadonlyArrayDyn};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use respire_bench::base::Camera;
use respire_bench::base::estimate::demand_memory;
use respire_bench::base::range::COORDINATE;
use respire_bench::splat::{
    DepthOutput, Filter, GaussianSlices, Gradients, ImageGradient, Rasterizer, Real, Rendered, Settings, ShapeSlices,
    SplatKernels, View, Wanted,
};

use crate::failure::{OrRaise, refused};
use crate::predict::rigid;
use crate::table::{Memory, Pool, Table, TableOf};
use crate::threads;

/// The constant spherical harmonic.
const C0: f64 = 0.28209479177387814;
/// Least value of a lifted colour: above 0, where the core would clamp it.
const LEAST_COLOR: f64 = 1e-3;
/// Most that colours are lifted: a colour loses a bit of float32 or two.
const MOST_LIFT: f64 = 1.0 + LEAST_COLOR;
/// Largest colour below which none is lifted: in float32 a lifted one is off by 1e-7.
const SMALL_COLOR: f64 = 0.05;
/// Rasterisers kept for later passes, per number type; each holds the tables of one pass.
const KEPT: usize = 4;

/// A number type of arrays that has a splat core.
pub trait Float: SplatKernels + Element {
    /// Rasterisers whose passes are over.
    fn idle() -> &'static Mutex<Vec<Rasterizer<Self>>>;
    /// Tables that Python is done with.
    fn pool() -> &'static Mutex<Pool<Self>>;
    /// A table for Python.
    fn memory(table: TableOf<Self>) -> Memory;
    /// A pass of this type.
    fn pass(of: PassOf<Self>) -> Pass;
    /// The pass, if it is of this type.
    fn in_pass(pass: &mut Pass) -> Option<&mut PassOf<Self>>;
}

macro_rules! float {
    ($type:ty, $kind:ident) => {
        impl Float for $type {
            fn idle() -> &'static Mutex<Vec<Rasterizer<Self>>> {
                static IDLE: Mutex<Vec<Rasterizer<$type>>> = Mutex::new(Vec::new());
                &IDLE
            }
            fn pool() -> &'static Mutex<Pool<Self>> {
                static POOL: Mutex<Pool<$type>> = Mutex::new(Pool::new());
                &POOL
            }
            fn memory(table: TableOf<Self>) -> Memory {
                Memory::$kind(table)
            }
            fn pass(of: PassOf<Self>) -> Pass {
                Pass(Kind::$kind(of))
            }
            fn in_pass(pass: &mut Pass) -> Option<&mut PassOf<Self>> {
                if let Kind::$kind(of) = &mut pass.0 { Some(of) } else { None }
            }
        }
    };
}
float!(f32, Single);
float!(f64, Double);

/// A forward pass, kept for its backward pass.
#[pyclass]
pub struct Pass(Kind);

enum Kind {
    Single(PassOf<f32>),
    Double(PassOf<f64>),
}

/// A forward pass in one number type.
pub struct PassOf<T: Float> {
    /// Taken only when the pass is dropped.
    rasterizer: Option<Rasterizer<T>>,
    plan: Plan,
    widths: Widths,
    /// Spherical harmonics made of plain colours; empty where they were handed in.
    sh: Vec<T>,
    /// Which Gaussians take part, where not all do.
    active: Option<Vec<u32>>,
}

impl<T: Float> Drop for PassOf<T> {
    fn drop(&mut self) {
        let mut idle = T::idle().lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(rasterizer) = self.rasterizer.take().filter(|_| idle.len() < KEPT) {
            idle.push(rasterizer);
        }
    }
}

/// What of a call is not an array of the Gaussians.
#[derive(Clone, Debug, FromPyObject)]
#[pyo3(from_item_all)]
pub struct Plan {
    /// Which of the call's cameras this is.
    camera: usize,
    width: u32,
    height: u32,
    near_plane: f64,
    far_plane: f64,
    eps2d: f64,
    antialiased: bool,
    /// Degree of the SH; `None` for plain colours.
    sh_degree: Option<u8>,
    /// Colours of a Gaussian that are shown.
    colors: usize,
    /// Features of a Gaussian.
    features: usize,
    /// 0 none, 1 accumulated, 2 expected.
    depth: u8,
    /// `k1..k4`; `None` for a pinhole.
    fisheye: Option<[f64; 4]>,
    /// World to camera, row by row.
    viewmat: [[f64; 4]; 4],
    /// `fl_x, fl_y, cx, cy`.
    intrinsics: [f64; 4],
    /// One value per colour.
    background: Option<Vec<f64>>,
}

/// The arrays of one call, C-contiguous and of one type.
struct Arrays<'py, T: Float> {
    means: PyReadonlyArrayDyn<'py, T>,
    quats: PyReadonlyArrayDyn<'py, T>,
    scales: PyReadonlyArrayDyn<'py, T>,
    opacities: PyReadonlyArrayDyn<'py, T>,
    colors: PyReadonlyArrayDyn<'py, T>,
    features: Option<PyReadonlyArrayDyn<'py, T>>,
}

/// The same as slices.
#[derive(Clone, Copy)]
struct Slices<'a, T> {
    means: &'a [[T; 3]],
    quats: &'a [[T; 4]],
    scales: &'a [[T; 3]],
    opacities: &'a [T],
    colors: &'a [T],
    features: &'a [T],
}

fn slice<'a, T: Element, D: numpy::ndarray::Dimension>(
    name: &str,
    array: &'a PyReadonlyArray<'_, T, D>,
) -> PyResult<&'a [T]> {
    array.as_slice().map_err(|_| refused(format!("{name}: the array is not contiguous and aligned")))
}

impl<'py, T: Float> Arrays<'py, T> {
    fn take(of: &Gathered<'py>) -> PyResult<Self> {
        let take = |name: &str, array: &Bound<'py, PyAny>| {
            array.extract().map_err(|_| refused(format!("{name}: is no array of the type of means")))
        };
        Ok(Arrays {
            means: take("means", &of.means)?,
            quats: take("quats", &of.quats)?,
            scales: take("scales", &of.scales)?,
            opacities: take("opacities", &of.opacities)?,
            colors: take("colors", &of.colors)?,
            features: of.features.as_ref().map(|array| take("features", array)).transpose()?,
        })
    }

    fn slices(&self) -> PyResult<Slices<'_, T>> {
        Ok(Slices {
            means: slice("means", &self.means)?.as_chunks().0,
            quats: slice("quats", &self.quats)?.as_chunks().0,
            scales: slice("scales", &self.scales)?.as_chunks().0,
            opacities: slice("opacities", &self.opacities)?,
            colors: slice("colors", &self.colors)?,
            features: self.features.as_ref().map_or(Ok(&[][..]), |array| slice("features", array))?,
        })
    }
}

/// The arrays of one call as objects.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct Gathered<'py> {
    means: Bound<'py, PyAny>,
    quats: Bound<'py, PyAny>,
    scales: Bound<'py, PyAny>,
    opacities: Bound<'py, PyAny>,
    colors: Bound<'py, PyAny>,
    features: Option<Bound<'py, PyAny>>,
}

impl Plan {
    /// One value per colour, or none.
    fn background(&self) -> &[f64] {
        self.background.as_deref().unwrap_or_default()
    }

    fn view(&self) -> PyResult<View> {
        let named = |argument: &str| format!("{argument}[{}]", self.camera);
        let camera_from_world = rigid(&named("viewmats"), self.viewmat.as_flattened(), COORDINATE)?;
        let [fl_x, fl_y, cx, cy] = self.intrinsics;
        let camera = Camera { width: self.width, height: self.height, fl_x, fl_y, cx, cy, fisheye: self.fisheye };
        Camera { fisheye: None, ..camera }.validate().map_err(|e| e.element(named("Ks"))).or_raise()?;
        camera.validate().map_err(|e| e.element(named("radial_coeffs"))).or_raise()?;
        Ok(View { camera, camera_from_world })
    }

    /// Settings for colours that are lifted by `lift`.
    fn settings(&self, lift: f64) -> Settings {
        let behind = |k: usize| self.background().get(k).copied().unwrap_or(0.0) + lift;
        Settings {
            near_mm: self.near_plane,
            dilation_px2: self.eps2d,
            filter: if self.antialiased { Filter::Compensate } else { Filter::Dilate },
            background: [0, 1, 2].map(behind),
            depth: if self.depth > 0 { DepthOutput::Expected } else { DepthOutput::Skip },
            ..Settings::default()
        }
    }

    /// Whether the colours of the arrays are the core's SH.
    fn takes_sh(&self) -> bool {
        self.sh_degree.is_some() && self.colors > 0
    }

    /// With colours that are lifted by `lift`; `None` where they are not.
    fn widths(&self, lift: Option<f64>) -> Widths {
        let shown = if lift.is_some() { self.colors.min(3) } else { 0 };
        Widths { colors: self.colors, shown, features: self.features, depth: usize::from(self.depth > 0) }
    }
}

/// Channels of the image: colours, features, depth.
#[derive(Clone, Copy)]
struct Widths {
    colors: usize,
    /// The first of the colours, which are the core's own.
    shown: usize,
    features: usize,
    depth: usize,
}

impl Widths {
    fn all(self) -> usize {
        self.colors + self.features + self.depth
    }

    /// Channels of the core beside its three colours.
    fn further(self) -> usize {
        self.colors - self.shown + self.features
    }
}

/// How far plain colours are lifted; `None` if that is too far, or so far for colours so small that they lose digits.
fn lift_of<T: Real>(colors: &[T]) -> Option<f64> {
    let ends = |(least, most): (f64, f64), c: f64| (least.min(c), most.max(c.abs()));
    let (least, most) = colors.iter().map(|c| c.to_f64()).fold((f64::INFINITY, 0.0), ends);
    Some((LEAST_COLOR - least).max(0.0)).filter(|lift| *lift <= MOST_LIFT && most >= SMALL_COLOR)
}

/// Refuses `values`, `width` of each Gaussian, of which one is not finite.
fn demand_finite<T: Float>(name: &str, values: &[T], width: usize) -> PyResult<()> {
    if T::all_finite(values) {
        return Ok(());
    }
    let bad = values.iter().position(|v| !v.is_finite()).unwrap_or_default();
    Err(refused(format!("{name}: channel {} of Gaussian {} is not finite", bad % width, bad / width)))
}

/// SH of degree 0 that show the first `widths.shown` plain colours of each of `n` Gaussians, lifted.
fn constant_sh<T: Real>(colors: &[T], widths: Widths, n: usize, lift: f64) -> Vec<T> {
    if widths.shown == 0 {
        return vec![T::zero(); 3 * n];
    }
    let sh = |c: T| T::of((c.to_f64() + lift - 0.5) / C0);
    let shown = |c: &[T]| [0, 1, 2].map(|k| c.get(k).map_or(T::zero(), |c| sh(*c)));
    colors.chunks_exact(widths.colors).flat_map(shown).collect()
}

/// The further channels of all Gaussians: colours that are not the core's own, then features.
fn further_channels<T: Real>(slices: &Slices<'_, T>, widths: Widths) -> Vec<T> {
    if widths.colors == widths.shown {
        return slices.features.to_vec();
    }
    let colors = slices.colors.chunks_exact(widths.colors);
    let mut features = slices.features.chunks_exact(widths.features.max(1));
    colors.flat_map(|c| c[widths.shown..].iter().chain(features.next().unwrap_or_default()).copied()).collect()
}

/// Puts the image together, `height * width * channels`.
fn assemble<T: Real>(images: &Rendered<T>, channels: &[T], widths: Widths, plan: &Plan, lift: f64) -> Vec<T> {
    let (lift, behind): (T, Vec<T>) = (T::of(lift), plan.background().iter().map(|v| T::of(*v)).collect());
    let (shown, further) = (widths.shown, widths.further());
    let mut image = Vec::with_capacity(images.alpha.len() * widths.all());
    for (pixel, color) in images.color.as_chunks::<3>().0.iter().enumerate() {
        let alpha = images.alpha[pixel];
        image.extend(color[..shown].iter().map(|c| *c - lift));
        for (k, value) in channels[pixel * further..(pixel + 1) * further].iter().enumerate() {
            image.push(match behind.get(shown + k).filter(|_| shown + k < widths.colors) {
                Some(behind) => *value + *behind * (T::one() - alpha),
                None => *value,
            });
        }
        match plan.depth {
            0 => {}
            1 => image.push(images.depth[pixel] * alpha),
            _ => image.push(images.depth[pixel]),
        }
    }
    image
}

fn gaussians<'a, T: Real>(slices: &Slices<'a, T>, sh: &'a [T], plan: &Plan) -> GaussianSlices<'a, T> {
    GaussianSlices {
        positions: slices.means,
        shape: ShapeSlices::Ellipsoids { rotations: slices.quats, scales: slices.scales },
        opacities: slices.opacities,
        sh: if plan.takes_sh() { slices.colors } else { sh },
        sh_degree: plan.sh_degree.filter(|_| plan.takes_sh()).unwrap_or_default(),
    }
}

/// Gaussians no farther than the far plane, unless all are.
fn near_enough<T: Real>(means: &[[T; 3]], view: &View, far: f64) -> Option<Vec<u32>> {
    let z = |p: &[T; 3]| view.camera_from_world.transform_point3(p.map(T::to_f64).into()).z;
    let near: Vec<u32> = (0u32..).zip(means).filter(|(_, p)| z(p) <= far).map(|(i, _)| i).collect();
    (near.len() < means.len()).then_some(near)
}

/// Refuses a call whose images this machine has no memory left for: those of all channels, of the core's further ones
/// twice, and what the core keeps of these. A backward pass takes as much again.
fn demand_images<T: Float>(plan: &Plan, widths: Widths) -> PyResult<()> {
    let size = [plan.width as usize, plan.height as usize];
    let values = (widths.all() + 2 * widths.further()) as f64 * size[0] as f64 * size[1] as f64;
    let bytes = values * size_of::<T>() as f64 + Rasterizer::<T>::channels_bytes(size, widths.further());
    let what = format!("images of {} channels with {}x{} pixels", widths.all(), plan.width, plan.height);
    demand_memory(what, bytes).or_raise()
}

/// A forward pass: image, alpha, flags of the Gaussians that touch the image, entries in the lists of all tiles.
type Forward<T> = (PassOf<T>, Vec<T>, Vec<T>, Vec<bool>, usize);

fn forward_of<T: Float>(slices: &Slices<'_, T>, plan: Plan) -> PyResult<Forward<T>> {
    let (n, view) = (slices.means.len(), plan.view()?);
    let is_plain = plan.colors > 0 && !plan.takes_sh();
    if is_plain {
        demand_finite("colors", slices.colors, plan.colors)?;
    }
    demand_finite("features", slices.features, plan.features)?;
    let lift = if is_plain { lift_of(slices.colors) } else { Some(0.0) };
    let (widths, lift) = (plan.widths(lift), lift.unwrap_or_default());
    let sh = if plan.takes_sh() { Vec::new() } else { constant_sh(slices.colors, widths, n, lift) };
    demand_images::<T>(&plan, widths)?;
    let active = if plan.far_plane < 1e10 { near_enough(slices.means, &view, plan.far_plane) } else { None };
    let kept = T::idle().lock().unwrap_or_else(PoisonError::into_inner).pop();
    let mut pass = PassOf { rasterizer: Some(kept.unwrap_or_default()), plan, widths, sh, active };
    let PassOf { rasterizer: Some(rasterizer), plan, sh, active, .. } = &mut pass else {
        return Err(refused("no core"));
    };
    let scene = gaussians(slices, sh, plan);
    rasterizer.render(scene, &view, &plan.settings(lift), active.as_deref()).or_raise()?;
    let channels = match widths.further() {
        0 => Vec::new(),
        count => rasterizer.render_channels(&further_channels(slices, widths), count).or_raise()?.to_vec(),
    };
    // Three colours that are not lifted are the core's own image.
    let image = if widths.all() == 3 && widths.shown == 3 && lift == 0.0 {
        rasterizer.take_color()
    } else {
        assemble(rasterizer.rendered(), &channels, widths, plan, lift)
    };
    let images = rasterizer.rendered();
    let mut visible = images.visible.clone();
    if let Some(list) = active {
        visible = vec![false; n];
        list.iter().zip(&images.visible).for_each(|(i, shown)| visible[*i as usize] = *shown);
    }
    let (alpha, entries) = (images.alpha.clone(), images.intersections);
    Ok((pass, image, alpha, visible, entries))
}

/// Values of a gradient, `width` of each active Gaussian, at the places of all `n`: 0 where they took no part. One that
/// was not wanted is empty, as it was.
fn spread<T: Real>(table: TableOf<T>, active: Option<&[u32]>, n: usize, width: usize) -> TableOf<T> {
    let Some(list) = active.filter(|list| table.values().len() == list.len() * width) else { return table };
    let mut all = vec![T::zero(); n * width];
    for (i, value) in list.iter().zip(table.values().chunks(width.max(1))) {
        all[*i as usize * width..][..width].copy_from_slice(value);
    }
    TableOf::One(all)
}

/// Gradients by the name of the argument; empty where not wanted.
struct Backward<T> {
    means: TableOf<T>,
    quats: TableOf<T>,
    scales: TableOf<T>,
    opacities: TableOf<T>,
    colors: TableOf<T>,
    features: TableOf<T>,
    viewmat: [f64; 16],
    intrinsics: [f64; 9],
    background: Vec<f64>,
}

/// Gradient by the entries of the 3x3 matrix from that by `fl_x, fl_y, cx, cy`.
fn by_matrix([fl_x, fl_y, cx, cy]: [f64; 4]) -> [f64; 9] {
    [fl_x, 0.0, cx, 0.0, fl_y, cy, 0.0, 0.0, 0.0]
}

/// Gradient by the entries of the 4x4 matrix from that by a small motion `(omega, tau)` of the camera: the one that is
/// tangent to the rotations. With `R <- exp(omega) R` and `t <- exp(omega) t + tau`, it is `tau` by `t` and
/// `[omega - t x tau] R / 2` by `R`.
fn by_viewmat(pose: [f64; 6], view: &View) -> [f64; 16] {
    let (rotation, t) = (view.camera_from_world.matrix3, view.camera_from_world.translation);
    let (omega, tau) = (glam::DVec3::from_slice(&pose[..3]), glam::DVec3::from_slice(&pose[3..]));
    let w = omega - t.cross(tau);
    let columns = [rotation.x_axis, rotation.y_axis, rotation.z_axis].map(|column| w.cross(column) * 0.5);
    let row = |k: usize| [columns[0][k], columns[1][k], columns[2][k], tau[k]];
    let mut all = [0.0; 16];
    all[..12].copy_from_slice([row(0), row(1), row(2)].as_flattened());
    all
}

/// The gradient of the images of the core, and of the background, from that of the assembled image.
struct Taken<T> {
    color: Vec<T>,
    depth: Vec<T>,
    alpha: Vec<T>,
    channels: Vec<T>,
    background: Vec<f64>,
}

fn take_apart<T: Real>(by_image: &[T], by_alpha: &[T], images: &Rendered<T>, widths: Widths, plan: &Plan) -> Taken<T> {
    let (pixels, all, shown) = (images.alpha.len(), widths.all(), widths.shown);
    let further = widths.further();
    let mut taken = Taken {
        color: vec![T::zero(); 3 * pixels],
        depth: vec![T::zero(); pixels * widths.depth],
        alpha: by_alpha.to_vec(),
        channels: vec![T::zero(); pixels * further],
        background: vec![0.0; plan.background().len()],
    };
    taken.alpha.resize(pixels, T::zero());
    for (pixel, by) in by_image.chunks_exact(all.max(1)).enumerate() {
        let alpha = images.alpha[pixel];
        taken.color[3 * pixel..][..shown].copy_from_slice(&by[..shown]);
        taken.channels[pixel * further..][..further].copy_from_slice(&by[shown..shown + further]);
        for (k, sum) in taken.background.iter_mut().enumerate().take(widths.colors) {
            *sum += (by[k] * (T::one() - alpha)).to_f64();
            if k >= shown {
                taken.alpha[pixel] -= T::of(plan.background()[k]) * by[k];
            }
        }
        match plan.depth {
            0 => {}
            1 => {
                taken.depth[pixel] = by[all - 1] * alpha;
                taken.alpha[pixel] += by[all - 1] * images.depth[pixel];
            }
            _ => taken.depth[pixel] = by[all - 1],
        }
    }
    taken
}

fn backward_of<T: Float>(
    pass: &mut PassOf<T>,
    slices: &Slices<'_, T>,
    by_image: &[T],
    by_alpha: &[T],
    wanted: Wishes,
) -> PyResult<Backward<T>> {
    let PassOf { rasterizer: Some(rasterizer), plan, widths, sh, active } = pass else {
        return Err(refused("no core"));
    };
    let (n, widths) = (slices.means.len(), *widths);
    let pixels = plan.width as usize * plan.height as usize;
    let fits = |found: usize, wanted: usize| found == 0 || found == wanted;
    if !fits(by_image.len(), pixels * widths.all()) || !fits(by_alpha.len(), pixels) {
        return Err(refused("the gradient of the images has another size than the images"));
    }
    demand_images::<T>(plan, widths)?;
    // The gradient of a plain colour image goes to the core as it lies there.
    let direct = widths.all() == 3 && widths.shown == 3 && plan.background().is_empty();
    let taken = (!direct).then(|| take_apart(by_image, by_alpha, rasterizer.rendered(), widths, plan));
    let by = match &taken {
        None => ImageGradient { color: by_image, alpha: by_alpha, ..ImageGradient::default() },
        Some(t) => ImageGradient { color: &t.color, depth: &t.depth, alpha: &t.alpha, channels: &t.channels },
    };
    let view = plan.view()?;
    let scene = gaussians(slices, sh, plan);
    let groups = wanted.groups(widths);
    rasterizer.give_tables(T::pool().lock().unwrap_or_else(PoisonError::into_inner).take(n, scene.sh.len(), groups));
    rasterizer.backward(scene, &by, groups).or_raise()?;
    let mut found = rasterizer.take_gradients();
    let list = active.as_deref();
    let (colors, features) = if plan.takes_sh() {
        (std::mem::take(&mut found.sh), std::mem::take(&mut found.channels))
    } else {
        let by_colors = by_plain_colors(&found, widths, wanted);
        T::pool().lock().unwrap_or_else(PoisonError::into_inner).give(TableOf::One(std::mem::take(&mut found.sh)));
        by_colors
    };
    let color_width =
        if plan.takes_sh() { slices.colors.len().checked_div(n).unwrap_or_default() } else { plan.colors };
    Ok(Backward {
        means: spread(TableOf::Three(found.positions), list, n, 3),
        quats: spread(TableOf::Four(found.rotations), list, n, 4),
        scales: spread(TableOf::Three(found.scales), list, n, 3),
        opacities: spread(TableOf::One(found.opacities), list, n, 1),
        colors: spread(TableOf::One(colors), list, n, color_width),
        features: spread(TableOf::One(features), list, n, plan.features),
        viewmat: by_viewmat(found.pose, &view),
        intrinsics: by_matrix(found.lens),
        background: taken.map_or_else(Vec::new, |t| t.background),
    })
}

/// Gradients of plain colours and of the features of the active Gaussians, from those of constant SH and of channels.
fn by_plain_colors<T: Real>(found: &Gradients<T>, widths: Widths, wanted: Wishes) -> (Vec<T>, Vec<T>) {
    let (shown, further) = (widths.shown, widths.further());
    let (more, mut colors, mut features) = (widths.colors - shown, Vec::new(), Vec::new());
    let mut channels = found.channels.chunks_exact(further.max(1));
    if wanted.colors && shown > 0 {
        for by in found.sh.as_chunks::<3>().0 {
            colors.extend(by[..shown].iter().map(|v| *v / T::of(C0)));
            colors.extend_from_slice(channels.next().and_then(|of| of.get(..more)).unwrap_or_default());
        }
    } else if wanted.colors && more > 0 {
        channels.clone().for_each(|of| colors.extend_from_slice(&of[..more]));
    }
    if wanted.features && widths.features > 0 {
        found.channels.chunks_exact(further).for_each(|of| features.extend_from_slice(&of[more..]));
    }
    (colors, features)
}

/// Arguments whose gradients are wanted.
#[derive(Clone, Copy, FromPyObject)]
#[pyo3(from_item_all)]
pub struct Wishes {
    means: bool,
    quats: bool,
    scales: bool,
    opacities: bool,
    colors: bool,
    features: bool,
    viewmats: bool,
    #[pyo3(item("Ks"))]
    intrinsics: bool,
}

impl Wishes {
    fn groups(self, widths: Widths) -> Wanted {
        let colors = self.colors && widths.shown > 0;
        let further = (self.colors && widths.colors > widths.shown) || (self.features && widths.features > 0);
        let groups = [
            (self.means, Wanted::POSITIONS),
            (self.quats || self.scales, Wanted::SHAPES),
            (self.opacities, Wanted::OPACITIES),
            (colors, Wanted::SH),
            (further, Wanted::CHANNELS),
            (self.viewmats, Wanted::POSE),
            (self.intrinsics, Wanted::LENS),
        ];
        groups.into_iter().filter(|(is_wanted, _)| *is_wanted).fold(Wanted::NONE, |all, (_, group)| all | group)
    }
}

/// Whether the arrays are of single precision.
fn is_single(arrays: &Gathered<'_>) -> bool {
    arrays.means.cast::<PyArrayDyn<f32>>().is_ok()
}

/// A pass, its image (height * width * channels), alpha (height * width), which Gaussians touch the image, and the
/// number of pairs of a tile and a splat.
type Rendering<'py> = (Pass, Bound<'py, PyAny>, Bound<'py, PyAny>, Bound<'py, PyArray1<bool>>, usize);

fn forward_in<'py, T: Float>(py: Python<'py>, arrays: &Gathered<'py>, plan: Plan) -> PyResult<Rendering<'py>> {
    let arrays = Arrays::<T>::take(arrays)?;
    let slices = arrays.slices()?;
    let (pass, image, alpha, visible, entries) = threads::run(py, || forward_of(&slices, plan))?;
    let (image, alpha) = (PyArray1::from_vec(py, image).into_any(), PyArray1::from_vec(py, alpha).into_any());
    Ok((T::pass(pass), image, alpha, PyArray1::from_vec(py, visible), entries))
}

/// Renders one camera.
#[pyfunction]
pub fn forward<'py>(py: Python<'py>, arrays: Gathered<'py>, plan: Plan) -> PyResult<Rendering<'py>> {
    threads::join();
    if is_single(&arrays) { forward_in::<f32>(py, &arrays, plan) } else { forward_in::<f64>(py, &arrays, plan) }
}

fn backward_in<'py, T: Float>(
    py: Python<'py>,
    pass: &mut Pass,
    arrays: &Gathered<'py>,
    (by_image, by_alpha): (Option<Bound<'py, PyAny>>, Option<Bound<'py, PyAny>>),
    wanted: Wishes,
) -> PyResult<Bound<'py, PyDict>> {
    let pass =
        T::in_pass(pass).ok_or_else(|| refused("the arrays are of another type than those of the forward pass"))?;
    let arrays = Arrays::<T>::take(arrays)?;
    let slices = arrays.slices()?;
    let gradient = |array: Bound<'py, PyAny>| -> PyResult<PyReadonlyArrayDyn<'py, T>> {
        array.extract().map_err(|_| refused("the gradient of the images is of another type than the images"))
    };
    let (by_image, by_alpha) = (by_image.map(gradient).transpose()?, by_alpha.map(gradient).transpose()?);
    let by_image = by_image.as_ref().map_or(Ok(&[][..]), |array| slice("the gradient of the image", array))?;
    let by_alpha = by_alpha.as_ref().map_or(Ok(&[][..]), |array| slice("the gradient of alpha", array))?;
    let widths = pass.widths;
    let found = threads::run(py, || backward_of(pass, &slices, by_image, by_alpha, wanted))?;
    let all = PyDict::new(py);
    for (name, is_wanted, values) in [
        ("means", wanted.means, found.means),
        ("quats", wanted.quats, found.quats),
        ("scales", wanted.scales, found.scales),
        ("opacities", wanted.opacities, found.opacities),
        ("colors", wanted.colors && widths.colors > 0, found.colors),
        ("features", wanted.features && widths.features > 0, found.features),
    ] {
        if is_wanted {
            all.set_item(name, Table::new(T::memory(values)))?;
        }
    }
    if wanted.viewmats {
        all.set_item("viewmats", PyArray1::from_slice(py, &found.viewmat))?;
    }
    if wanted.intrinsics {
        all.set_item("Ks", PyArray1::from_slice(py, &found.intrinsics))?;
    }
    if !found.background.is_empty() {
        all.set_item("backgrounds", PyArray1::from_vec(py, found.background))?;
    }
    Ok(all)
}

#[pymethods]
impl Pass {
    /// Flat gradients by the names of the arguments, those that are wanted; of a background always. Those of the Gaussians
    /// are tables, which `numpy.asarray` takes as they lie in memory.
    #[pyo3(signature = (arrays, by_image, by_alpha, wanted))]
    fn backward<'py>(
        &mut self,
        py: Python<'py>,
        arrays: Gathered<'py>,
        by_image: Option<Bound<'py, PyAny>>,
        by_alpha: Option<Bound<'py, PyAny>>,
        wanted: Wishes,
    ) -> PyResult<Bound<'py, PyDict>> {
        let by = (by_image, by_alpha);
        match self.0 {
            Kind::Single(_) => backward_in::<f32>(py, self, &arrays, by, wanted),
            Kind::Double(_) => backward_in::<f64>(py, self, &arrays, by, wanted),
        }
    }
}

/// Seconds of one forward and one backward pass of the core alone, for the benchmark: no array of Python is made,
/// nothing is copied, and the rasteriser keeps its tables from call to call.
#[pyfunction]
pub fn time_core<'py>(
    py: Python<'py>,
    arrays: Gathered<'py>,
    plan: Plan,
    by_image: PyReadonlyArrayDyn<'py, f32>,
    wanted: Wishes,
) -> PyResult<(f64, f64)> {
    threads::join();
    let arrays = Arrays::<f32>::take(&arrays)?;
    let (slices, by_image) = (arrays.slices()?, slice("the gradient of the image", &by_image)?);
    let view = plan.view()?;
    static RASTERIZER: Mutex<Option<Rasterizer<f32>>> = Mutex::new(None);
    threads::run(py, || {
        let mut kept = RASTERIZER.lock().unwrap_or_else(PoisonError::into_inner);
        let rasterizer = kept.get_or_insert_default();
        let scene = gaussians(&slices, &[], &plan);
        let start = Instant::now();
        rasterizer.render(scene, &view, &plan.settings(0.0), None).or_raise()?;
        let forward = start.elapsed().as_secs_f64();
        let by = ImageGradient { color: by_image, ..ImageGradient::default() };
        rasterizer.backward(scene, &by, wanted.groups(plan.widths(Some(0.0)))).or_raise()?;
        let both = start.elapsed().as_secs_f64();
        Ok((forward, both))
    })
}
