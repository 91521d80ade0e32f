//! What goes in and what comes out: Gaussians, view, settings, images, gradients.

use std::ops::BitOr;

use glam::DAffine3;

use crate::base::{Camera, Error, Result};

use crate::splat::number::real::Real;

/// How the spread of each Gaussian is given.
#[derive(Clone, Debug, PartialEq)]
pub enum Shape<T> {
    /// Standard 3DGS: covariance `R diag(s)^2 R^T`.
    Ellipsoids {
        /// Quaternions `w x y z`; any length but 0, normalised inside (gradients are through the normalisation).
        rotations: Vec<[T; 4]>,
        /// Standard deviations in mm (linear, not logarithms).
        scales: Vec<[T; 3]>,
    },
    /// Flat discs: covariance `a a^T + b b^T`. The two axes need not be perpendicular, so that a disc can be carried
    /// by any affine map.
    Discs {
        /// The two axes of each disc, in mm.
        axes: Vec<[[T; 3]; 2]>,
    },
}

/// A set of Gaussians, structure of arrays.
#[derive(Clone, Debug, PartialEq)]
pub struct Gaussians<T> {
    /// Centres in mm.
    pub positions: Vec<[T; 3]>,
    /// Their spread.
    pub shape: Shape<T>,
    /// Opacities in 0..1.
    pub opacities: Vec<T>,
    /// Spherical harmonics, `n * (degree + 1)^2 * 3`, Gaussian by Gaussian, coefficient by coefficient, RGB
    /// interleaved; basis and signs of Inria's 3DGS; colour = `max(0, sum + 0.5)`.
    pub sh: Vec<T>,
    /// 0 to 3.
    pub sh_degree: u8,
}

impl<T: Real> Gaussians<T> {
    /// `n` discs at the origin, black to grey: to be filled by [`crate::splat::Anchors::place`].
    pub fn discs(n: usize, sh_degree: u8, opacity: T) -> Self {
        let coefficients = (sh_degree as usize + 1).pow(2);
        Gaussians {
            positions: vec![[T::zero(); 3]; n],
            shape: Shape::Discs { axes: vec![[[T::zero(); 3]; 2]; n] },
            opacities: vec![opacity; n],
            sh: vec![T::zero(); n * coefficients * 3],
            sh_degree,
        }
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// True when there is none.
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// Values of `sh` that belong to one Gaussian.
    pub fn sh_stride(&self) -> usize {
        (self.sh_degree as usize + 1).pow(2) * 3
    }

    /// The same Gaussians in another number type.
    pub fn cast<U: Real>(&self) -> Gaussians<U> {
        let one = |v: T| U::of(v.to_f64());
        let three = |v: &[T; 3]| v.map(one);
        Gaussians {
            positions: self.positions.iter().map(three).collect(),
            shape: match &self.shape {
                Shape::Ellipsoids { rotations, scales } => Shape::Ellipsoids {
                    rotations: rotations.iter().map(|q| q.map(one)).collect(),
                    scales: scales.iter().map(three).collect(),
                },
                Shape::Discs { axes } => Shape::Discs { axes: axes.iter().map(|a| a.map(|v| v.map(one))).collect() },
            },
            opacities: self.opacities.iter().map(|&v| one(v)).collect(),
            sh: self.sh.iter().map(|&v| one(v)).collect(),
            sh_degree: self.sh_degree,
        }
    }

    /// Errors when the arrays do not belong together.
    pub fn validate(&self) -> Result<()> {
        let n = self.len();
        let shapes = match &self.shape {
            Shape::Ellipsoids { rotations, scales } => rotations.len() == n && scales.len() == n,
            Shape::Discs { axes } => axes.len() == n,
        };
        if self.sh_degree > 3 {
            return Err(Error::input(format!("SH degree {} is more than 3", self.sh_degree)));
        }
        if !shapes || self.opacities.len() != n || self.sh.len() != n * self.sh_stride() {
            return Err(Error::input("the arrays of the Gaussians differ in length"));
        }
        Ok(())
    }
}

/// Where from, and through which lens.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// Intrinsics.
    pub camera: Camera,
    /// Rigid transform into the axes of the camera.
    pub camera_from_world: DAffine3,
}

impl View {
    /// The view of a camera that stands at `world_from_camera`.
    pub fn new(camera: Camera, world_from_camera: DAffine3) -> Self {
        View { camera, camera_from_world: world_from_camera.inverse() }
    }

    /// Width and height of its image in pixels.
    pub(in crate::splat) fn size(&self) -> [usize; 2] {
        [self.camera.width, self.camera.height].map(|v| v as usize)
    }
}

/// Whether the expected depth is composited too (it costs about a twentieth of the forward pass).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DepthOutput {
    /// `Rendered::depth` stays 0.
    Skip,
    /// Mean z-depth of the centres weighted by contribution, divided by alpha.
    Expected,
    /// Mean z-depth of the splats' surfaces along each ray (`surface_depth.rs`); forward only with `Footprint::Ewa`.
    Surface,
    /// z-depth where the ray meets the splat behind which no more than half of the light is left; 0 where there is
    /// none. Forward only.
    Median,
}

/// What the screen-space filter (`Settings::dilation_px2`) does to a splat's peak.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Filter {
    /// 3DGS: the splat grows and keeps its opacity, so that what is smaller than a pixel gains weight.
    #[default]
    Dilate,
    /// Mip-Splatting (Yu et al., 2024; gsplat's `antialiased`): the opacity is multiplied by
    /// `sqrt(det before / det after)` of the covariance on screen, so that the splat keeps its weight.
    Compensate,
}

/// How a Gaussian comes onto the screen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Footprint {
    /// The affine projection of 3DGS (EWA), vectorised.
    #[default]
    Ewa,
    /// Flat discs that each ray meets exactly (2DGS; `disc_mode.rs`), in plain code. Ellipsoids lose their shortest
    /// axis. Expected depth is that of the points met.
    Disc,
}

/// How to render.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// How a Gaussian comes onto the screen.
    pub footprint: Footprint,
    /// Gaussians with a centre nearer than this z-depth are left out.
    pub near_mm: f64,
    /// Added to the diagonal of the projected covariance (px^2): the screen-space filter of 3DGS. With `Footprint::Disc`
    /// the variance that a disc has on screen at least; 0 is no filter.
    pub dilation_px2: f64,
    /// What that filter does to the opacity.
    pub filter: Filter,
    /// Multiplies the finished image per channel (exposure).
    pub gain: [f64; 3],
    /// Colour behind everything (before the gain).
    pub background: [f64; 3],
    /// Whether depth is wanted.
    pub depth: DepthOutput,
}

impl Default for Settings {
    fn default() -> Self {
        Settings {
            footprint: Footprint::Ewa,
            near_mm: 0.2,
            dilation_px2: 0.3,
            filter: Filter::Dilate,
            gain: [1.0; 3],
            background: [0.0; 3],
            depth: DepthOutput::Expected,
        }
    }
}

/// The images of one forward pass.
#[derive(Clone, Debug, Default)]
pub struct Rendered<T> {
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// `height * width * 3`, with background and gain.
    pub color: Vec<T>,
    /// `height * width`: z-depth in mm as asked for ([`DepthOutput`]); the means are divided by alpha, 0 where it is 0.
    pub depth: Vec<T>,
    /// `height * width`: 1 minus what is left of the light from behind.
    pub alpha: Vec<T>,
    /// One flag per active Gaussian (in the order of `active`): its ellipse of alpha >= 1/255 touches the image.
    pub visible: Vec<bool>,
    /// How many flags are set.
    pub visible_count: usize,
    /// Entries of the lists of all tiles: pairs of a tile and a splat that may have a pixel centre of it in its ellipse.
    pub intersections: usize,
}

/// Derivatives of a loss with respect to the images of the last forward pass. An empty slice is all zeros.
#[derive(Clone, Copy, Debug, Default)]
pub struct ImageGradient<'a, T> {
    /// Like `Rendered::color`.
    pub color: &'a [T],
    /// Like `Rendered::depth`.
    pub depth: &'a [T],
    /// Like `Rendered::alpha`.
    pub alpha: &'a [T],
    /// Like the image of `Rasterizer::render_channels`.
    pub channels: &'a [T],
}

/// Groups of parameters whose gradients are wanted; the others cost nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct Wanted(u16);

impl Wanted {
    /// Nothing.
    pub const NONE: Wanted = Wanted(0);
    /// Centres.
    pub const POSITIONS: Wanted = Wanted(1);
    /// Spread: rotations and scales of ellipsoids, axes of discs.
    pub const SHAPES: Wanted = Wanted(2);
    /// Opacities.
    pub const OPACITIES: Wanted = Wanted(4);
    /// Spherical harmonics.
    pub const SH: Wanted = Wanted(8);
    /// The camera.
    pub const POSE: Wanted = Wanted(16);
    /// Exposure.
    pub const GAIN: Wanted = Wanted(32);
    /// All of the above: every parameter of the Gaussians, the pose and the exposure.
    pub const ALL: Wanted = Wanted(63);
    /// Focal lengths and principal point.
    pub const LENS: Wanted = Wanted(64);
    /// Features of the further channels (`Rasterizer::render_channels`).
    pub const CHANNELS: Wanted = Wanted(128);

    /// The groups as bits, as the kernels know them.
    pub(in crate::splat) fn bits(self) -> u32 {
        self.0 as u32
    }

    /// True when `self` has any group of `other`.
    pub fn any(self, other: Wanted) -> bool {
        self.0 & other.0 != 0
    }
}

impl BitOr for Wanted {
    type Output = Wanted;
    fn bitor(self, other: Wanted) -> Wanted {
        Wanted(self.0 | other.0)
    }
}

/// Gradients of a loss. **Entry `k` belongs to the `k`-th *active* Gaussian** of the last forward pass (to Gaussian
/// `k` when all were active), so that nothing is done for the inactive. Groups that were not wanted are empty.
#[derive(Clone, Debug, Default)]
pub struct Gradients<T> {
    /// Of the centres, through projection, its Jacobian and the view direction of the SH.
    pub positions: Vec<[T; 3]>,
    /// Of the quaternions as given (through the normalisation); ellipsoids only.
    pub rotations: Vec<[T; 4]>,
    /// Of the linear scales; ellipsoids only.
    pub scales: Vec<[T; 3]>,
    /// Of the disc axes; discs only.
    pub axes: Vec<[[T; 3]; 2]>,
    /// Of the opacities.
    pub opacities: Vec<T>,
    /// Of the features of the further channels, Gaussian by Gaussian.
    pub channels: Vec<T>,
    /// Of the SH coefficients, laid out as in [`Gaussians`].
    pub sh: Vec<T>,
    /// Of a small motion of the camera, `camera_from_world <- exp(xi) camera_from_world` with
    /// `xi = (omega, tau)`: rotation vector (rad) and translation (mm) in camera axes.
    pub pose: [f64; 6],
    /// Of the gain per channel.
    pub gain: [f64; 3],
    /// Of `fl_x`, `fl_y`, `cx`, `cy` of the camera (per pixel).
    pub lens: [f64; 4],
}
