//! Volumes: values on a regular grid in a patient's body, such as a CT scan, a mask, or a displacement field.

use glam::{DMat3, DVec3};

use super::error::{Error, Result};
use super::estimate::demand_memory;

/// Farthest first voxel from the scanner's origin, in mm.
const MOST_ORIGIN_MM: f64 = 1e5;
/// Most voxels along one axis. Scanners write 512 to 2048.
pub const MOST_VOXELS_A_SIDE: usize = 4096;

/// Where the voxels of a volume lie. Voxel (i, j, k) has its centre at `origin_mm + axes_mm * (i, j, k)`, in LPS.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VoxelGrid {
    /// Voxels along i, j and k.
    pub size: [usize; 3],
    /// Centre of the first voxel, LPS, mm.
    pub origin_mm: DVec3,
    /// Columns: the step in mm from a voxel to the next along i, j and k.
    pub axes_mm: DMat3,
}

impl VoxelGrid {
    /// A grid along the axes of LPS.
    pub fn upright(size: [usize; 3], origin_mm: DVec3, spacing_mm: DVec3) -> Self {
        VoxelGrid { size, origin_mm, axes_mm: DMat3::from_diagonal(spacing_mm) }
    }

    /// Number of voxels.
    pub fn count(&self) -> usize {
        self.size.iter().product()
    }

    /// Distance in mm between neighbouring voxels along i, j and k.
    pub fn spacing_mm(&self) -> DVec3 {
        DVec3::new(self.axes_mm.x_axis.length(), self.axes_mm.y_axis.length(), self.axes_mm.z_axis.length())
    }

    /// Volume of a voxel in mm^3.
    pub fn voxel_mm3(&self) -> f64 {
        self.axes_mm.determinant().abs()
    }

    /// Place in mm of a (fractional) voxel index.
    pub fn position(&self, index: DVec3) -> DVec3 {
        self.origin_mm + self.axes_mm * index
    }

    /// Centre in mm of the voxel at place `at` of the data.
    pub fn centre(&self, at: usize) -> DVec3 {
        let [i, j, k] = self.cell(at);
        self.position(DVec3::new(i as f64, j as f64, k as f64))
    }

    /// Index (i, j, k) of the voxel at place `at` of the data.
    pub fn cell(&self, at: usize) -> [usize; 3] {
        let [nx, ny, _] = self.size;
        [at % nx, at / nx % ny, at / nx / ny]
    }

    /// Place in the data of voxel (i, j, k).
    pub fn at(&self, [i, j, k]: [usize; 3]) -> usize {
        (k * self.size[1] + j) * self.size[0] + i
    }

    /// The map from places in mm to (fractional) voxel indices.
    pub fn index_from_place(&self) -> impl Fn(DVec3) -> DVec3 + Copy + Send + Sync + use<> {
        let (inverse, origin_mm) = (self.axes_mm.inverse(), self.origin_mm);
        move |place_mm| inverse * (place_mm - origin_mm)
    }

    /// Lowest and highest corner in mm of the box around all voxel centres.
    pub fn bounds_mm(&self) -> (DVec3, DVec3) {
        let last = DVec3::new(self.size[0] as f64, self.size[1] as f64, self.size[2] as f64) - 1.0;
        let corners = (0..8).map(|c| {
            let pick = |axis: usize| if c >> axis & 1 == 1 { last[axis] } else { 0.0 };
            self.position(DVec3::new(pick(0), pick(1), pick(2)))
        });
        corners.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), c| (low.min(c), high.max(c)))
    }

    /// Whether another grid has the same voxels, to a hundredth of one.
    pub fn same_as(&self, other: &VoxelGrid) -> bool {
        let tolerance = 0.01 * self.spacing_mm().min_element();
        let (a, b) = (self.bounds_mm(), other.bounds_mm());
        self.size == other.size
            && a.0.distance(b.0) < tolerance
            && a.1.distance(b.1) < tolerance
            && self.origin_mm.distance(other.origin_mm) < tolerance
    }

    /// Refuses a grid that no scanner makes: no or too many voxels, steps that are not finite, too small, too large, or
    /// all in one plane; and one whose data of `bytes_a_voxel` this machine has no memory for.
    pub fn validate(&self, bytes_a_voxel: f64) -> Result<()> {
        let [nx, ny, nz] = self.size;
        if self.size.contains(&0) || self.size.iter().any(|&n| n > MOST_VOXELS_A_SIDE) {
            return Err(Error::input(format!(
                "{nx} x {ny} x {nz} voxels are none of a scan: 1 to {MOST_VOXELS_A_SIDE} along each axis are"
            )));
        }
        let spacing = self.spacing_mm();
        if !self.origin_mm.is_finite() || self.origin_mm.abs().max_element() > MOST_ORIGIN_MM {
            return Err(Error::input(format!(
                "its first voxel lies at {} mm, farther away than {MOST_ORIGIN_MM} mm",
                self.origin_mm
            )));
        }
        if !spacing.is_finite() || spacing.min_element() < 0.01 || spacing.max_element() > 20.0 {
            return Err(Error::input(format!(
                "voxels of {:.4} x {:.4} x {:.4} mm are none of a scan: .01 to 20 mm are; a file in other units has to be \
                 rewritten in mm",
                spacing.x, spacing.y, spacing.z
            )));
        }
        if self.voxel_mm3() < 0.2 * spacing.element_product() {
            return Err(Error::input("the axes of its voxels lie almost in one plane"));
        }
        demand_memory(format_args!("{nx} x {ny} x {nz} voxels"), self.count() as f64 * bytes_a_voxel)
    }
}

/// One value per voxel; i runs fastest, then j, then k.
#[derive(Clone, Debug, PartialEq)]
pub struct Volume<T> {
    /// Where the voxels lie.
    pub grid: VoxelGrid,
    /// `grid.count()` values.
    pub data: Vec<T>,
}

impl<T: Copy> Volume<T> {
    /// A volume of one value.
    pub fn filled(grid: VoxelGrid, value: T) -> Self {
        Volume { grid, data: vec![value; grid.count()] }
    }

    /// The value of voxel (i, j, k).
    pub fn value(&self, cell: [usize; 3]) -> T {
        self.data[self.grid.at(cell)]
    }

    /// Every value through `f`.
    pub fn map<U>(&self, f: impl Fn(T) -> U) -> Volume<U> {
        Volume { grid: self.grid, data: self.data.iter().map(|&v| f(v)).collect() }
    }

    /// The voxels from `low` (included) to `high` (excluded).
    pub fn cropped(&self, low: [usize; 3], high: [usize; 3]) -> Volume<T> {
        let size = [0, 1, 2].map(|a| high[a] - low[a]);
        let origin_mm = self.grid.position(DVec3::new(low[0] as f64, low[1] as f64, low[2] as f64));
        let mut data = Vec::with_capacity(size.iter().product());
        for k in low[2]..high[2] {
            for j in low[1]..high[1] {
                let start = self.grid.at([low[0], j, k]);
                data.extend_from_slice(&self.data[start..start + size[0]]);
            }
        }
        Volume { grid: VoxelGrid { size, origin_mm, ..self.grid }, data }
    }

    /// The value of the voxel nearest to a fractional index; `None` outside.
    pub fn nearest(&self, index: DVec3) -> Option<T> {
        let rounded = index.round();
        let inside = (0..3).all(|a| rounded[a] >= 0.0 && rounded[a] < self.grid.size[a] as f64);
        inside.then(|| self.value([rounded.x as usize, rounded.y as usize, rounded.z as usize]))
    }

    /// The eight voxels around a fractional index with their weights; `None` outside of the voxel centres. An index
    /// less than half a voxel outside counts as on the rim.
    fn around(&self, index: DVec3) -> Option<[(usize, f64); 8]> {
        let size = self.grid.size;
        let strides = [1, size[0], size[0] * size[1]];
        let (mut first, mut step, mut part) = (0, [0usize; 3], [0.0f64; 3]);
        for axis in 0..3 {
            let last = (size[axis] - 1) as f64;
            if !(-0.5..=last + 0.5).contains(&index[axis]) {
                return None;
            }
            let clamped = index[axis].clamp(0.0, last);
            let base = (clamped as usize).min(size[axis].saturating_sub(2));
            part[axis] = clamped - base as f64;
            first += base * strides[axis];
            step[axis] = if size[axis] > 1 { strides[axis] } else { 0 };
        }
        // Loops, not closures over arrays: a volume is sampled tens of millions of times.
        let mut corners = [(first, 1.0); 8];
        for (corner, (at, weight)) in corners.iter_mut().enumerate() {
            for axis in 0..3 {
                let up = corner >> axis & 1;
                *at += up * step[axis];
                *weight *= if up == 1 { part[axis] } else { 1.0 - part[axis] };
            }
        }
        Some(corners)
    }
}

impl<T: Copy + Into<f64>> Volume<T> {
    /// Trilinear value at a fractional index; `None` outside.
    pub fn sample(&self, index: DVec3) -> Option<f64> {
        let corners = self.around(index)?;
        Some(corners.iter().map(|&(at, weight)| self.data[at].into() * weight).sum())
    }
}

impl Volume<[f32; 3]> {
    /// Trilinear vector at a fractional index; `None` outside.
    pub fn sample_vector(&self, index: DVec3) -> Option<DVec3> {
        let corners = self.around(index)?;
        Some(
            corners
                .iter()
                .map(|&(at, weight)| {
                    let [x, y, z] = self.data[at].map(f64::from);
                    DVec3::new(x, y, z) * weight
                })
                .sum(),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn oblique() -> VoxelGrid {
        let turn = DMat3::from_rotation_z(0.3) * DMat3::from_rotation_x(-0.2);
        VoxelGrid {
            size: [4, 5, 6],
            origin_mm: DVec3::new(-10.0, 20.0, 5.0),
            axes_mm: turn * DMat3::from_diagonal(DVec3::new(0.7, 0.8, 2.5)),
        }
    }

    #[test]
    fn places_and_indices_are_inverse_and_a_linear_volume_is_sampled_exactly() {
        let grid = oblique();
        grid.validate(2.0).unwrap();
        assert!((grid.spacing_mm() - DVec3::new(0.7, 0.8, 2.5)).length() < 1e-12);
        assert!((grid.voxel_mm3() - 1.4).abs() < 1e-12);
        let to_index = grid.index_from_place();
        let height = |p: DVec3| 3.0 * p.x - p.y + 0.5 * p.z;
        let volume = Volume { grid, data: (0..grid.count()).map(|at| height(grid.centre(at))).collect() };
        for index in [DVec3::ZERO, DVec3::new(1.3, 2.9, 4.4), DVec3::new(3.0, 4.0, 5.0)] {
            let place = grid.position(index);
            assert!((to_index(place) - index).length() < 1e-9);
            assert!((volume.sample(index).unwrap() - height(place)).abs() < 1e-9);
        }
        assert_eq!(volume.sample(DVec3::new(3.6, 0.0, 0.0)), None);
        assert_eq!(volume.nearest(DVec3::new(1.4, 1.6, 0.2)), Some(volume.value([1, 2, 0])));
        let part = volume.cropped([1, 2, 3], [3, 5, 6]);
        assert_eq!(part.value([1, 2, 2]), volume.value([2, 4, 5]));
        assert!((part.grid.centre(0) - grid.centre(grid.at([1, 2, 3]))).length() < 1e-12);
    }

    #[test]
    fn impossible_grids_are_refused_in_one_sentence() {
        let said = |grid: VoxelGrid| grid.validate(2.0).unwrap_err().to_string();
        assert!(said(VoxelGrid { size: [512, 0, 3], ..oblique() }).contains("512 x 0 x 3 voxels"));
        assert!(said(VoxelGrid { size: [4096; 3], ..oblique() }).contains("would take"));
        assert!(said(VoxelGrid { axes_mm: oblique().axes_mm * 1e-3, ..oblique() }).contains("mm"));
        let flat = DMat3::from_cols(DVec3::X, DVec3::Y, DVec3::X + DVec3::Y);
        assert!(said(VoxelGrid { axes_mm: flat, ..oblique() }).contains("in one plane"));
        assert!(said(VoxelGrid { origin_mm: DVec3::NAN, ..oblique() }).contains("farther away"));
    }
}
