//! Flat discs intersected exactly by the rays of the pixels, after 2D Gaussian splatting (Huang et al., 2024): accurate
//! where an affine projection (EWA) is not, for discs that are near, wide or seen at a grazing angle.
//!
//! Symbols, camera axes: `t` centre, `a`, `b` the two axes (standard deviations, not necessarily perpendicular), `d`
//! the ray of a pixel, `N = a x b`. The ray meets the plane where `s a + u b + t = z d`: by Cramer's rule
//! `s = P.d / N.d`, `u = Q.d / N.d`, `z = N.t / N.d` with `P = b x t`, `Q = t x a`. Alpha is
//! `o exp(-(s^2 + u^2) / 2)`. `P.t = Q.t = 0`, so `P.d = P.(d - t d_z / t_z)`: the difference is taken first, which
//! keeps the digits of small discs.
//!
//! So that a disc seen edge-on or from afar does not vanish between pixels, its alpha is at least that of a Gaussian
//! of variance `dilation_px2` around its centre on screen (the screen filter; 2DGS has 0.5 px^2 here, 0 is the disc
//! alone). Intersections nearer than `near_mm` do not count. Depth is that of the intersection, or of the centre where
//! the filter is larger. Ellipsoids lose their shortest axis. Order, alpha bounds and stop are those of EWA.
//!
//! The gradient is exactly that of this function. For a disc seen edge-on it is valid for steps much smaller than the
//! width of the line that the disc covers on screen, which may be a hundredth of a pixel.
//!
//! Tiles are composited by vectorised kernels (`cpp/splat/disc.cpp`); projection, chain and the kernels' twin
//! (`disc_tile.rs`) are plain code over [`Real`], and directions of `Rasterizer::render_tangent` take a pass in dual
//! numbers each. `docs/performance.md` compares its cost with that of EWA. Left out: intrinsics of a fisheye,
//! `Filter::Compensate`.

use crate::ffi::splat::rasterize::Aligned;
use crate::splat::number::{Each, Real, cross, dot};
use crate::splat::types::table::{LOG2_255, SplatRow, at};
use crate::splat::types::{GaussianSlices, Settings, Tiling, View};

use super::bins::TileBox;
use super::projector::Projector;

/// Half size in pixels of a box that is larger than every image.
const EVERYWHERE: f64 = 1e6;

/// The numbers of one disc that rays need besides its row.
#[derive(Clone, Copy, Debug, Default)]
pub struct Disc<T> {
    /// `b x t`, `t x a`, `a x b`.
    pub p: [T; 3],
    pub q: [T; 3],
    pub n: [T; 3],
    /// `N.t`.
    pub height: T,
    /// `t / t_z`.
    pub slope: [T; 2],
    /// Box on screen in which it is visible.
    pub bounds: DiscBounds<T>,
}

impl<T: Real> Disc<T> {
    /// Its row in the tables (`DiscColumn` of `cpp/splat/kernel.h`).
    pub fn pack(&self) -> Aligned<T> {
        let (p, q, n, low, high) = (self.p, self.q, self.n, self.bounds.low, self.bounds.high);
        Aligned([
            p[0],
            p[1],
            p[2],
            q[0],
            q[1],
            q[2],
            n[0],
            n[1],
            n[2],
            self.height,
            self.slope[0],
            self.slope[1],
            low[0],
            low[1],
            high[0],
            high[1],
        ])
    }

    /// The inverse of [`Disc::pack`].
    #[inline(always)]
    pub fn unpack(Aligned(v): &Aligned<T>) -> Self {
        Disc {
            p: [v[0], v[1], v[2]],
            q: [v[3], v[4], v[5]],
            n: [v[6], v[7], v[8]],
            height: v[9],
            slope: [v[10], v[11]],
            bounds: DiscBounds { low: [v[12], v[13]], high: [v[14], v[15]] },
        }
    }
}

/// A box on screen, in pixels.
#[derive(Clone, Copy, Debug, Default)]
pub struct DiscBounds<T> {
    pub low: [T; 2],
    pub high: [T; 2],
}

impl<T: Real> DiscBounds<T> {
    /// True for a point inside or closer to it than `margin`.
    #[inline(always)]
    pub fn holds(&self, point: [T; 2], margin: T) -> bool {
        (0..2).all(|k| point[k] >= self.low[k] - margin && point[k] <= self.high[k] + margin)
    }
}

/// Centre and axes of Gaussian `i` in camera axes.
pub struct DiscInCamera<T> {
    pub t: [T; 3],
    pub a: [T; 3],
    pub b: [T; 3],
    /// From the eye to the centre, world axes.
    pub offset: [T; 3],
}

impl<T: Real> DiscInCamera<T> {
    pub fn of(projector: &Projector<T>, gaussians: &GaussianSlices<'_, T>, i: usize) -> DiscInCamera<T> {
        let offset = [0, 1, 2].each(|k| gaussians.positions[i][k] - projector.eye[k]);
        let columns = gaussians.shape.columns(i);
        let [a, b] = gaussians.shape.disc_columns(i).each(|k| projector.turn(columns[k]));
        DiscInCamera { t: projector.turn(offset), a, b, offset }
    }

    pub fn disc(&self) -> Disc<T> {
        let (t, n) = (self.t, cross(self.a, self.b));
        Disc {
            p: cross(self.b, t),
            q: cross(t, self.a),
            n,
            height: dot(n, t),
            slope: [t[0] / t[2], t[1] / t[2]],
            bounds: DiscBounds::default(),
        }
    }

    /// Corners in pixels of a box that holds every intersection at less than `reach` standard deviations and at `near`
    /// or beyond.
    fn bounds(&self, projector: &Projector<T>, reach: T) -> DiscBounds<T> {
        let (t, point) = (self.t, projector.lens.image_of(self.t).point);
        let everywhere = T::of(EVERYWHERE);
        let around = |half: [T; 2]| DiscBounds {
            low: [0, 1].each(|k| point[k] - half[k].minimum(everywhere)),
            high: [0, 1].each(|k| point[k] + half[k].minimum(everywhere)),
        };
        if let Some(stretch) = projector.lens.fisheye_stretch() {
            let radius = reach * (dot(self.a, self.a) + dot(self.b, self.b)).sqrt();
            let sine = radius / dot(t, t).sqrt();
            // asin(x) <= pi/2 x
            let angle = sine * T::of(std::f64::consts::FRAC_PI_2);
            return around(if sine < T::one() { stretch.each(|s| s * angle) } else { [everywhere; 2] });
        }
        let mut bounds = around([T::zero(); 2]);
        for k in 0..2 {
            let Some([low, high]) = self.slopes(k, reach, projector.near) else {
                return around([everywhere; 2]);
            };
            let focal = projector.lens.focal[k];
            bounds.low[k] = point[k] + (focal * low).maximum(-everywhere);
            bounds.high[k] = point[k] + (focal * high).minimum(everywhere);
        }
        bounds
    }

    /// Least and greatest slope, relative to that of the centre, over the part of the disc at `near` or beyond. They
    /// occur where lines through the eye touch its outline, or where the near plane cuts it. `None` if not finite.
    fn slopes(&self, k: usize, reach: T, near: T) -> Option<[T; 2]> {
        let t = self.t;
        let along = [reach * self.a[2], reach * self.b[2]];
        // Moved so that the centre lies on the axis.
        let slope = t[k] / t[2];
        let side = [reach * self.a[k] - slope * along[0], reach * self.b[k] - slope * along[1]];
        let product = |x: [T; 2], y: [T; 2]| x[0] * y[0] + x[1] * y[1];
        let (depth, mixed, square) = (product(along, along), product(side, along), product(side, side));
        let (mut low, mut high) = (T::zero(), T::zero());
        let mut take = |value: T| {
            low = low.minimum(value);
            high = high.maximum(value);
            value.is_finite()
        };
        let room = t[2] * t[2] - depth;
        let root = (mixed * mixed + room * square).maximum(T::zero()).sqrt();
        let far = mixed + if mixed < T::zero() { -root } else { root };
        let whole = t[2] - depth.sqrt() >= near;
        let mut finite = true;
        for touching in [-far / room, square / far] {
            let aside = [side[0] - touching * along[0], side[1] - touching * along[1]];
            let towards = touching * t[2] / product(aside, aside);
            let z = t[2] + towards * product(along, aside);
            if whole || z >= near {
                // A disc that projects to a line or a point has no points of contact, or infinitely many.
                finite &= if square == T::zero() { true } else { take(touching) };
            }
        }
        if !whole {
            let ratio = (near - t[2]) / depth;
            let across = (T::one() / depth - ratio * ratio).maximum(T::zero()).sqrt();
            for sign in [T::one(), -T::one()] {
                let e = [ratio * along[0] - sign * across * along[1], ratio * along[1] + sign * across * along[0]];
                finite &= take(product(side, e) / near);
            }
        }
        finite.then_some([low, high])
    }
}

impl<T: Real> Projector<T> {
    /// The row of the tables and the disc of Gaussian `i`; `None` if it is invisible or not finite.
    pub fn project_disc(&self, gaussians: &GaussianSlices<'_, T>, i: usize) -> Option<(SplatRow<T>, Disc<T>)> {
        let log2_opacity = gaussians.opacities[i].log2();
        let reach = log2_opacity + T::of(LOG2_255);
        if !reach.is_finite() || reach <= T::zero() {
            return None;
        }
        let placed = DiscInCamera::of(self, gaussians, i);
        let in_front = placed.t[2] >= self.near;
        if !in_front {
            return None;
        }
        let mut disc = placed.disc();
        let point = self.lens.image_of(placed.t).point;
        let distance = dot(placed.offset, placed.offset).sqrt();
        let rgb = gaussians.color(i, placed.offset.each(|v| v / distance));
        // A sum is finite only if every term is.
        let sums = [disc.p, disc.q, disc.n, rgb].each(|v| v[0] + v[1] + v[2]);
        let sum = sums[0] + sums[1] + sums[2] + sums[3] + disc.height + point[0] + point[1];
        if !(sum + disc.slope[0] + disc.slope[1]).is_finite() {
            return None;
        }
        // alpha = 1/255 at `deviations` standard deviations.
        let deviations = (T::of(2.0 * std::f64::consts::LN_2) * reach).sqrt();
        let filter = deviations * self.dilation.sqrt();
        let met = placed.bounds(self, deviations);
        // Slack against rounding, in pixels.
        let slack = T::of(1e-2);
        for k in 0..2 {
            let room = slack + T::of(1e-4) * (met.high[k] - met.low[k]);
            disc.bounds.low[k] = (met.low[k] - room).minimum(point[k] - filter - slack);
            disc.bounds.high[k] = (met.high[k] + room).maximum(point[k] + filter + slack);
        }
        let mut row = [T::zero(); 16];
        (row[at::X], row[at::Y]) = (point[0], point[1]);
        row[at::LOG2_OPACITY] = log2_opacity;
        for k in 0..3 {
            row[at::RED + k] = rgb[k].maximum(T::zero());
        }
        row[at::DEPTH] = placed.t[2];
        let on_screen = (0..2).all(|k| disc.bounds.high[k] > T::zero() && disc.bounds.low[k] < self.size[k]);
        on_screen.then_some((row, disc))
    }
}

/// Tiles that a box meets.
pub fn tiles_of<T: Real>(bounds: &DiscBounds<T>, tiling: &Tiling) -> TileBox {
    let half = T::of(0.5);
    let mut row = [T::zero(); 16];
    for k in 0..2 {
        row[at::X + k] = half * (bounds.low[k] + bounds.high[k]);
        // Enlarged against the rounding of large numbers.
        row[at::HALF_WIDTH + k] = half * (bounds.high[k] - bounds.low[k]) * T::of(1.0 + 1e-6) + T::of(1e-2);
    }
    TileBox::of(&row, tiling)
}

/// The inputs that all pixels of a view share.
#[derive(Clone, Copy, Debug)]
pub struct DiscOptics<'a, T> {
    /// Ray of each pixel in camera axes, row by row.
    pub rays: &'a [[T; 3]],
    pub size: [usize; 2],
    /// `1 / focal length` of a pinhole.
    pub per_pixel: Option<[T; 2]>,
    pub near: T,
    /// Variance of the screen filter and its inverse; `None` without one.
    pub filter: Option<T>,
}

impl<'a, T: Real> DiscOptics<'a, T> {
    /// The optics of a view, whose rays are `rays`.
    pub fn new(view: &View, settings: &Settings, rays: &'a [[T; 3]]) -> Self {
        let camera = &view.camera;
        let per_pixel = [camera.fl_x, camera.fl_y].each(|f| T::of(1.0 / f));
        DiscOptics {
            rays,
            size: view.size(),
            per_pixel: camera.fisheye.is_none().then_some(per_pixel),
            near: T::of(settings.near_mm),
            filter: (settings.dilation_px2 > 0.0).then(|| T::of(1.0 / settings.dilation_px2)),
        }
    }
}
