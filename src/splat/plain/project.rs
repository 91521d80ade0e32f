//! Projection of one Gaussian to one splat, after EWA splatting (Zwicker et al., 2001) as 3DGS (Kerbl et al., 2023)
//! and gsplat do it.
//!
//! Symbols: `p` centre, `m_k` columns of the square root of the covariance (`R_k s_k` of an ellipsoid, the two axes of
//! a disc), `R`, `eye` camera, `t = R (p - eye)`, `c_k = R m_k`, `J` Jacobian of the projection at `t`, `u_k = J c_k`,
//! covariance on screen `sum u_k u_k^T + dilation I`, conic `(A, B, C)` its inverse.
//! The Jacobian of a pinhole is taken at `t` clamped to 1.3 times the half field of view, as in 3DGS.
//! A splat reaches as far as its alpha is 1/255 or more, whatever its opacity. With `Filter::Compensate` the opacity is
//! first multiplied by `sqrt(det / det dilated)`; what is visible then has a determinant that is not tiny, so that the
//! gradient needs no floor.

use std::f64::consts::LOG2_E;

use crate::base::{Error, Result};

use crate::splat::number::real::Real;
use crate::splat::number::sh;
use crate::splat::plain::lens::{Exact, Lens, largest_stretch};
use crate::splat::types::scene::{Filter, Footprint, Gaussians, Settings, Shape, View};
use crate::splat::types::skips::Skips;

/// Where a splat's numbers stand in its row of 16.
pub(in crate::splat) mod at {
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
    /// What rounding took from X and Y: at some hundred pixels single precision is a hundred thousandth of a pixel, which
    /// changes the alpha of a splat that is no larger than a pixel by 1e-4.
    pub const X_REST: usize = 14;
    pub const Y_REST: usize = 15;
}

/// One splat.
pub type Row<T> = [T; 16];

/// `log2(255)`: how far below 1 an alpha of 1/255 lies.
pub(in crate::splat) const LOG2_255: f64 = 7.994353436858858;

/// One view, ready to project.
pub struct Projector<T> {
    pub(in crate::splat) rotation: [[T; 3]; 3],
    pub(in crate::splat) eye: [T; 3],
    pub(in crate::splat) focal: [T; 2],
    pub(in crate::splat) center: [T; 2],
    pub(in crate::splat) limit: [T; 2],
    size: [T; 2],
    near: T,
    dilation: T,
    filter: Filter,
    footprint: Footprint,
    skips: Skips,
    pub(in crate::splat) fisheye: Option<[T; 4]>,
    fisheye_stretch: Option<T>,
    pub(in crate::splat) exact: Exact,
}

/// What the projection of one Gaussian passes through; its backward starts here.
pub struct Geometry<T> {
    /// Centre in camera axes.
    pub t: [T; 3],
    /// Columns in camera axes and on screen.
    pub c: [[T; 3]; 3],
    pub u: [[T; 2]; 3],
    pub jacobian: [[T; 3]; 2],
    /// Centre on screen, and what rounding took from it.
    pub point: [T; 2],
    pub rest: [T; 2],
    /// Covariance on screen and the inverse's `(A, B, C)`.
    pub covariance: [T; 3],
    pub conic: [T; 3],
    pub inverse_determinant: T,
    /// Of the covariance before dilation.
    pub plain_determinant: T,
    /// Unit vector from the eye, and the distance.
    pub direction: [T; 3],
    pub distance: T,
}

#[inline(always)]
pub(in crate::splat) fn dot<T: Real>(a: [T; 3], b: [T; 3]) -> T {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Columns of the rotation of a unit quaternion `w x y z`.
#[inline(always)]
pub(in crate::splat) fn rotation_columns<T: Real>([w, x, y, z]: [T; 4]) -> [[T; 3]; 3] {
    let (one, two) = (T::one(), T::of(2.0));
    [
        [one - two * (y * y + z * z), two * (x * y + w * z), two * (x * z - w * y)],
        [two * (x * y - w * z), one - two * (x * x + z * z), two * (y * z + w * x)],
        [two * (x * z + w * y), two * (y * z - w * x), one - two * (x * x + y * y)],
    ]
}

/// A quaternion divided by its length, and 1 / length.
#[inline(always)]
pub(in crate::splat) fn normalized<T: Real>(q: [T; 4]) -> ([T; 4], T) {
    let inverse = T::one() / (q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]).sqrt();
    (q.map(|v| v * inverse), inverse)
}

/// Square root of the covariance of Gaussian `i`, column by column (the third of a disc is 0).
#[inline(always)]
pub(in crate::splat) fn columns<T: Real>(shape: &Shape<T>, i: usize) -> [[T; 3]; 3] {
    match shape {
        Shape::Ellipsoids { rotations, scales } => {
            let mut columns = rotation_columns(normalized(rotations[i]).0);
            for (column, scale) in columns.iter_mut().zip(scales[i]) {
                *column = column.map(|v| v * scale);
            }
            columns
        }
        Shape::Discs { axes } => [axes[i][0], axes[i][1], [T::zero(); 3]],
    }
}

impl<T: Real> Projector<T> {
    pub fn new(view: &View, settings: &Settings) -> Result<Self> {
        let camera = &view.camera;
        camera.validate()?;
        if camera.width > 16384 || camera.height > 16384 {
            return Err(Error::input(format!(
                "image of {}x{} pixels is larger than 16384",
                camera.width, camera.height
            )));
        }
        let transform = view.camera_from_world;
        if !transform.is_finite() {
            return Err(Error::input("camera pose is not finite"));
        }
        let scalars = [settings.near_mm, settings.dilation_px2];
        let colors = settings.gain.iter().chain(&settings.background);
        let finite = scalars.iter().chain(colors).all(|v| v.is_finite());
        if !finite || settings.near_mm <= 0.0 || settings.dilation_px2 < 0.0 {
            return Err(Error::input("near must be positive, dilation not negative, gain and background finite"));
        }
        let m = transform.matrix3;
        let eye = transform.inverse().translation;
        let row = |i: usize| [T::of(m.x_axis[i]), T::of(m.y_axis[i]), T::of(m.z_axis[i])];
        let (width, height) = (camera.width as f64, camera.height as f64);
        Ok(Projector {
            rotation: [row(0), row(1), row(2)],
            eye: [T::of(eye.x), T::of(eye.y), T::of(eye.z)],
            focal: [T::of(camera.fl_x), T::of(camera.fl_y)],
            center: [T::of(camera.cx), T::of(camera.cy)],
            limit: [T::of(1.3 * 0.5 * width / camera.fl_x), T::of(1.3 * 0.5 * height / camera.fl_y)],
            size: [T::of(width), T::of(height)],
            near: T::of(settings.near_mm),
            dilation: T::of(settings.dilation_px2),
            filter: settings.filter,
            footprint: settings.footprint,
            skips: Skips::ALL,
            fisheye: camera.fisheye.map(|k| k.map(T::of)),
            fisheye_stretch: camera.fisheye.map(|k| T::of(largest_stretch(k))),
            exact: Exact {
                rotation: [0, 1, 2].map(|i| [m.x_axis[i], m.y_axis[i], m.z_axis[i]]),
                eye: eye.to_array(),
                focal: [camera.fl_x, camera.fl_y],
                center: [camera.cx, camera.cy],
                fisheye: camera.fisheye,
            },
        })
    }

    /// The same, leaving out what `skips` says.
    pub fn with_skips(self, skips: Skips) -> Self {
        Projector { skips, ..self }
    }

    /// How far below its peak, in powers of 2, a splat of that opacity ends.
    #[inline(always)]
    pub(in crate::splat) fn extent(&self, log2_opacity: T) -> T {
        let by_opacity = if self.skips.any(Skips::EXTENTS) { log2_opacity } else { T::zero() };
        by_opacity + T::of(LOG2_255)
    }

    /// True for a camera without distortion.
    pub fn is_pinhole(&self) -> bool {
        self.fisheye.is_none()
    }

    /// What the screen-space filter does.
    pub fn filter(&self) -> Filter {
        self.filter
    }

    /// How Gaussians come onto the screen.
    pub fn footprint(&self) -> Footprint {
        self.footprint
    }

    pub(in crate::splat) fn near_depth(&self) -> T {
        self.near
    }

    pub(in crate::splat) fn focal_length(&self) -> [T; 2] {
        self.focal
    }

    pub(in crate::splat) fn center(&self) -> [T; 2] {
        self.center
    }

    pub(in crate::splat) fn image_size(&self) -> [T; 2] {
        self.size
    }

    /// Variance of the screen-space filter.
    pub(in crate::splat) fn filter_px2(&self) -> T {
        self.dilation
    }

    /// Image point of `t` in camera axes.
    #[inline(always)]
    pub(in crate::splat) fn image_point(&self, t: [T; 3]) -> [T; 2] {
        self.lens(t).point
    }

    /// Pixels per radian that a fisheye has at most before the camera, along both axes; `None` for a pinhole.
    pub(in crate::splat) fn fisheye_stretch(&self) -> Option<[T; 2]> {
        self.fisheye_stretch.map(|s| self.focal.map(|f| f * s))
    }

    /// The camera in single precision: `View` of `cpp/splat/kernel.h`.
    pub fn numbers(&self) -> [f32; 33] {
        let mut out = [0.0; 33];
        out[32] = f32::from(u8::from(self.filter == Filter::Compensate));
        let vectors = [self.focal, self.center, self.limit, self.size];
        let flag = |skip: Skips| T::of(f64::from(u8::from(self.skips.any(skip))));
        let scalars = [self.near, self.dilation, flag(Skips::EXTENTS), flag(Skips::BESIDE)];
        let all = self.rotation.as_flattened().iter().chain(&self.eye).chain(vectors.as_flattened()).chain(&scalars);
        out.iter_mut().zip(all).for_each(|(place, v)| *place = v.to_f64() as f32);
        if let Some(lens) = self.exact.fisheye {
            let dilation = self.dilation.to_f64();
            let size = self.size.map(T::to_f64);
            let rest = lens.into_iter().chain(self.exact.cone(lens, size, dilation)).chain([1.0]);
            out[24..].iter_mut().zip(rest).for_each(|(place, v)| *place = v as f32);
        }
        out
    }

    /// What splats are sorted by: z-depth of the centre, computed in double for every number type and rounded once, so
    /// that the order belongs to the scene and not to rounding. Positive floats sort like their bits.
    #[inline(always)]
    pub fn key(&self, position: [T; 3]) -> u32 {
        (self.exact.seen(position.map(T::to_f64))[2] as f32).to_bits()
    }

    /// A vector in camera axes.
    #[inline(always)]
    pub fn turn(&self, v: [T; 3]) -> [T; 3] {
        self.rotation.map(|row| dot(row, v))
    }

    /// A vector in world axes.
    #[inline(always)]
    pub fn turn_back(&self, v: [T; 3]) -> [T; 3] {
        let r = &self.rotation;
        [0, 1, 2].map(|k| r[0][k] * v[0] + r[1][k] * v[1] + r[2][k] * v[2])
    }

    /// Everything up to the conic; `None` before the near plane or where a number stops being finite.
    #[inline(always)]
    pub fn geometry(&self, position: [T; 3], columns: [[T; 3]; 3]) -> Option<Geometry<T>> {
        let offset = [0, 1, 2].map(|k| position[k] - self.eye[k]);
        let exact = self.exact.seen(position.map(T::to_f64));
        let t = if T::PLAIN { exact.map(T::of) } else { self.turn(offset) };
        let in_front = t[2] >= self.near;
        if !in_front {
            return None;
        }
        let mut g = self.geometry_of(t, columns.map(|m| self.turn(m)), offset)?;
        if T::PLAIN {
            let point = self.exact.point(exact);
            g.point = point.map(T::of);
            g.rest = [0, 1].map(|k| T::of(point[k] - g.point[k].to_f64()));
        }
        Some(g)
    }

    /// The same from the centre and the columns in camera axes, and the vector from the eye in world axes.
    #[inline(always)]
    pub fn geometry_of(&self, t: [T; 3], c: [[T; 3]; 3], offset: [T; 3]) -> Option<Geometry<T>> {
        let Lens { point, jacobian } = self.lens(t);
        let u = c.map(|column| jacobian.map(|row| dot(row, column)));
        let sum = |a: usize, b: usize| u[0][a] * u[0][b] + u[1][a] * u[1][b] + u[2][a] * u[2][b];
        let plain = [sum(0, 0), sum(0, 1), sum(1, 1)];
        let d = self.dilation;
        // Cauchy and Binet: the determinant as a sum of squares, so that thin splats keep their digits.
        let cross = |a: usize, b: usize| u[a][0] * u[b][1] - u[a][1] * u[b][0];
        let (k01, k02, k12) = (cross(0, 1), cross(0, 2), cross(1, 2));
        let plain_determinant = k01 * k01 + k02 * k02 + k12 * k12;
        let determinant = plain_determinant + d * (plain[0] + plain[2]) + d * d;
        let covariance = [plain[0] + d, plain[1], plain[2] + d];
        let inverse_determinant = T::one() / determinant;
        let conic = [
            covariance[2] * inverse_determinant,
            -covariance[1] * inverse_determinant,
            covariance[0] * inverse_determinant,
        ];
        let distance = dot(offset, offset).sqrt();
        let direction = offset.map(|v| v / distance);
        // A sum is finite only if every term is (0 times infinity and infinities of both signs give NaN).
        let sum = conic[0] + conic[1] + conic[2] + point[0] + point[1] + covariance[0] + covariance[2];
        let finite = (sum + direction[0] + direction[1] + direction[2] + inverse_determinant).is_finite();
        if !finite || determinant <= T::zero() {
            return None;
        }
        Some(Geometry {
            t,
            c,
            u,
            jacobian,
            point,
            rest: [T::zero(); 2],
            covariance,
            conic,
            inverse_determinant,
            plain_determinant,
            direction,
            distance,
        })
    }

    /// The splat of Gaussian `i`, `None` when it cannot be seen or is not finite.
    pub fn project(&self, gaussians: &Gaussians<T>, i: usize) -> Option<Row<T>> {
        let opacity = gaussians.opacities[i];
        let log2_opacity = opacity.log2();
        let reach = log2_opacity + T::of(LOG2_255);
        if !reach.is_finite() || reach <= T::zero() {
            return None;
        }
        let g = self.geometry(gaussians.positions[i], columns(&gaussians.shape, i))?;
        let row = self.row(&g, log2_opacity, color(gaussians, i, g.direction))?;
        for axis in 0..2 {
            let (center, half) = (row[at::X + axis], row[at::HALF_WIDTH + axis]);
            if !(center + half > T::zero() && center - half < self.size[axis]) {
                return None;
            }
        }
        Some(row)
    }

    /// The row of a splat of that colour (before the clamp at 0); `None` for a colour that is not finite.
    #[inline(always)]
    pub fn row(&self, g: &Geometry<T>, log2_opacity: T, color: [T; 3]) -> Option<Row<T>> {
        if !(color[0] + color[1] + color[2]).is_finite() {
            return None;
        }
        let log2_opacity = match self.filter {
            Filter::Dilate => log2_opacity,
            Filter::Compensate => log2_opacity + T::of(0.5) * (g.plain_determinant * g.inverse_determinant).log2(),
        };
        // Half axes of the box around `exponent >= -log2(255)`.
        let reach = log2_opacity + T::of(LOG2_255);
        if self.filter == Filter::Compensate && !(reach.is_finite() && reach > T::zero()) {
            return None;
        }
        let reach = self.extent(log2_opacity);
        let k = T::of(2.0 / LOG2_E) * reach;
        let mut row = [T::zero(); 16];
        row[at::X] = g.point[0];
        row[at::Y] = g.point[1];
        row[at::A] = T::of(0.5 * LOG2_E) * g.conic[0];
        row[at::B] = T::of(LOG2_E) * g.conic[1];
        row[at::C] = T::of(0.5 * LOG2_E) * g.conic[2];
        row[at::LOG2_OPACITY] = log2_opacity;
        for k in 0..3 {
            row[at::RED + k] = color[k].maximum(T::zero());
        }
        row[at::DEPTH] = g.t[2];
        row[at::HALF_WIDTH] = (k * g.covariance[0]).sqrt();
        row[at::HALF_HEIGHT] = (k * g.covariance[2]).sqrt();
        row[at::DISCRIMINANT] = T::of(-LOG2_E * LOG2_E) * g.inverse_determinant;
        row[at::WIDEST] = -T::of(0.5) * row[at::B] * row[at::HALF_WIDTH] / row[at::C];
        row[at::X_REST] = g.rest[0];
        row[at::Y_REST] = g.rest[1];
        Some(row)
    }
}

/// Colour of Gaussian `i` seen along `direction`, before the clamp at 0.
#[inline(always)]
pub(in crate::splat) fn color<T: Real>(gaussians: &Gaussians<T>, i: usize, direction: [T; 3]) -> [T; 3] {
    let stride = gaussians.sh_stride();
    let basis = sh::basis(direction, gaussians.sh_degree);
    sum_of_basis(&basis, &gaussians.sh[i * stride..(i + 1) * stride])
}

/// `0.5 + sum_k basis[k] * coefficients[k]` per channel.
#[inline(always)]
pub(in crate::splat) fn sum_of_basis<T: Real>(basis: &[T; 16], coefficients: &[T]) -> [T; 3] {
    let mut color = [T::of(0.5); 3];
    for (weight, rgb) in basis.iter().zip(coefficients.as_chunks::<3>().0) {
        for k in 0..3 {
            color[k] += *weight * rgb[k];
        }
    }
    color
}
