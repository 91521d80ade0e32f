//! What is rendered, and from where.

use glam::{DAffine3, DVec3};

use crate::base::{Camera, Error, Result};

use crate::splat::number::{Each, Real, normalized, rotation_columns, sh};

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

/// [`Shape`], borrowed.
#[derive(Clone, Copy, Debug)]
pub enum ShapeSlices<'a, T> {
    /// As [`Shape::Ellipsoids`].
    Ellipsoids {
        /// Quaternions `w x y z`.
        rotations: &'a [[T; 4]],
        /// Standard deviations in mm.
        scales: &'a [[T; 3]],
    },
    /// As [`Shape::Discs`].
    Discs {
        /// The two axes of each disc, in mm.
        axes: &'a [[[T; 3]; 2]],
    },
}

/// [`Gaussians`], borrowed: from a `&Gaussians`, or from arrays of another owner without a copy.
#[derive(Clone, Copy, Debug)]
pub struct GaussianSlices<'a, T> {
    /// Centres in mm.
    pub positions: &'a [[T; 3]],
    /// Their spread.
    pub shape: ShapeSlices<'a, T>,
    /// Opacities in 0..1.
    pub opacities: &'a [T],
    /// Spherical harmonics, as in [`Gaussians`].
    pub sh: &'a [T],
    /// 0 to 3.
    pub sh_degree: u8,
}

impl<'a, T> From<&'a Gaussians<T>> for GaussianSlices<'a, T> {
    fn from(owned: &'a Gaussians<T>) -> Self {
        GaussianSlices {
            positions: &owned.positions,
            shape: match &owned.shape {
                Shape::Ellipsoids { rotations, scales } => ShapeSlices::Ellipsoids { rotations, scales },
                Shape::Discs { axes } => ShapeSlices::Discs { axes },
            },
            opacities: &owned.opacities,
            sh: &owned.sh,
            sh_degree: owned.sh_degree,
        }
    }
}

impl<T: Real> ShapeSlices<'_, T> {
    /// An owned copy.
    pub(in crate::splat) fn to_shape(self) -> Shape<T> {
        match self {
            ShapeSlices::Ellipsoids { rotations, scales } => {
                Shape::Ellipsoids { rotations: rotations.to_vec(), scales: scales.to_vec() }
            }
            ShapeSlices::Discs { axes } => Shape::Discs { axes: axes.to_vec() },
        }
    }

    /// Square root of the covariance of Gaussian `i`, column by column, in mm (the third of a disc is 0).
    #[inline(always)]
    pub(in crate::splat) fn columns(&self, i: usize) -> [[T; 3]; 3] {
        match self {
            ShapeSlices::Ellipsoids { rotations, scales } => {
                let mut columns = rotation_columns(normalized(rotations[i]).0);
                for (column, scale) in columns.iter_mut().zip(scales[i]) {
                    *column = column.each(|v| v * scale);
                }
                columns
            }
            ShapeSlices::Discs { axes } => [axes[i][0], axes[i][1], [T::zero(); 3]],
        }
    }

    /// Which two of the columns span Gaussian `i` as a disc: all but the shortest.
    pub(in crate::splat) fn disc_columns(&self, i: usize) -> [usize; 2] {
        let ShapeSlices::Ellipsoids { scales, .. } = self else { return [0, 1] };
        let s = scales[i];
        if s[2] <= s[0] && s[2] <= s[1] {
            [0, 1]
        } else if s[0] <= s[1] {
            [1, 2]
        } else {
            [2, 0]
        }
    }
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
        GaussianSlices::from(self).cast()
    }
}

impl<'a, T: Real> GaussianSlices<'a, T> {
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

    /// The SH coefficients of Gaussian `i`.
    #[inline(always)]
    pub(in crate::splat) fn coefficients(&self, i: usize) -> &'a [T] {
        let stride = self.sh_stride();
        &self.sh[i * stride..(i + 1) * stride]
    }

    /// Colour of Gaussian `i` seen along the unit vector `direction`, before the clamp at 0.
    #[inline(always)]
    pub(in crate::splat) fn color(&self, i: usize, direction: [T; 3]) -> [T; 3] {
        sh::color(&sh::basis(direction, self.sh_degree), self.coefficients(i))
    }

    /// How many centres lie before the camera of `view`, and how many of these at a z-depth of at least `near_mm`: why
    /// an image may be empty.
    pub fn before_camera(&self, view: &View, near_mm: f64) -> [usize; 2] {
        let mut counts = [0; 2];
        for position in self.positions {
            let depth_mm = view.camera_from_world.transform_point3(DVec3::from_array(position.each(T::to_f64))).z;
            counts[0] += usize::from(depth_mm > 0.0);
            counts[1] += usize::from(depth_mm > 0.0 && depth_mm >= near_mm);
        }
        counts
    }

    /// The same Gaussians in another number type.
    pub fn cast<U: Real>(&self) -> Gaussians<U> {
        let one = |v: T| U::of(v.to_f64());
        let three = |v: &[T; 3]| v.map(one);
        Gaussians {
            positions: self.positions.iter().map(three).collect(),
            shape: match self.shape {
                ShapeSlices::Ellipsoids { rotations, scales } => Shape::Ellipsoids {
                    rotations: rotations.iter().map(|q| q.map(one)).collect(),
                    scales: scales.iter().map(three).collect(),
                },
                ShapeSlices::Discs { axes } => {
                    Shape::Discs { axes: axes.iter().map(|a| a.map(|v| v.map(one))).collect() }
                }
            },
            opacities: self.opacities.iter().map(|&v| one(v)).collect(),
            sh: self.sh.iter().map(|&v| one(v)).collect(),
            sh_degree: self.sh_degree,
        }
    }

    /// Errors if the arrays' lengths do not match.
    pub fn validate(&self) -> Result<()> {
        let n = self.len();
        let shapes = match self.shape {
            ShapeSlices::Ellipsoids { rotations, scales } => rotations.len() == n && scales.len() == n,
            ShapeSlices::Discs { axes } => axes.len() == n,
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

/// A camera and its pose.
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
