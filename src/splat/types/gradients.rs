//! Gradients, and which of them are wanted.

use std::ops::BitOr;

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

    /// The groups as the bits that the kernels use.
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

/// Gaussians that share a flag of [`Gradients::heard`]; `GROUP` in `cpp/splat/kernel.h`.
pub const GROUP: usize = 16;

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
    /// Of the SH coefficients, laid out as in `Gaussians`.
    pub sh: Vec<T>,
    /// By a small motion of the camera, `camera_from_world <- exp(xi) camera_from_world` with
    /// `xi = (omega, tau)`: rotation vector (rad) and translation (mm) in camera axes.
    pub pose: [f64; 6],
    /// Of the gain per channel.
    pub gain: [f64; 3],
    /// Of `fl_x`, `fl_y`, `cx`, `cy` of the camera (per pixel).
    pub lens: [f64; 4],
    /// Per [`GROUP`] active Gaussians, whether any of their gradients, those of the channels apart, may differ from 0:
    /// what is out of sight, or behind what is opaque, has none, and need not be read. Empty where nothing is known.
    pub heard: Vec<bool>,
}

impl<T> Gradients<T> {
    /// Whether the `k`-th active Gaussian is in a group without gradients.
    #[inline(always)]
    pub fn is_unheard(&self, k: usize) -> bool {
        is_unheard(&self.heard, k)
    }
}

/// Whether `heard`, of [`Gradients::heard`], says that number `k` has no gradients.
#[inline(always)]
pub fn is_unheard(heard: &[bool], k: usize) -> bool {
    heard.get(k / GROUP) == Some(&false)
}
