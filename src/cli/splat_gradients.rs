//! What `splat --gradients` reads and writes: the weights of the images, and the gradients of their weighted sum.

use std::path::Path;

use crate::base::{Error, Result};
use crate::formats::gaussians_ply::GaussianCloud;
use crate::formats::npy;
use crate::splat::{Gradients, Wanted};

/// Weights of each frame, all in one array.
pub(super) struct Weights {
    data: Vec<f32>,
    per_frame: usize,
}

impl Weights {
    /// Reads the weights; the error names the file, and the shape that is wanted or the pixel that is not finite.
    pub fn read(path: &Path, [height, width]: [usize; 2], frames: usize) -> Result<Weights> {
        let array = npy::read(path)?;
        let one = [height, width, 3];
        if array.shape != one && array.shape != [frames, height, width, 3] {
            let message = format!("has shape {:?}; {one:?} is wanted, or one such image per frame", array.shape);
            return Err(Error::input(message).at(path));
        }
        let per_frame = height * width * 3;
        if let Some(bad) = array.data.iter().position(|v| !v.is_finite()) {
            let (frame, pixel) = (bad / per_frame, bad % per_frame / 3);
            let pixel = format!("pixel ({}, {})", pixel % width, pixel / width);
            let element = if array.shape == one { pixel } else { format!("frame {frame}, {pixel}") };
            return Err(Error::input("a weight is not finite").element(element).at(path));
        }
        Ok(Weights { data: array.data, per_frame })
    }

    /// Those of a frame.
    pub fn of_frame(&self, frame: usize) -> &[f32] {
        let start = frame * self.per_frame;
        self.data.get(start..start + self.per_frame).unwrap_or(&self.data[..self.per_frame])
    }
}

/// Gradients summed over the frames, one row per Gaussian of the file (zeros for those left out).
pub(super) struct GradientSums {
    groups: Vec<(&'static str, Vec<f64>, Vec<usize>)>,
}

impl GradientSums {
    /// For `n` Gaussians of `coefficients` SH coefficients in `frames` frames.
    pub fn new(n: usize, coefficients: usize, frames: usize, wanted: Wanted) -> GradientSums {
        let group = |name, shape: &[usize]| (name, vec![0.0; shape.iter().product()], shape.to_vec());
        let mut groups = vec![
            group("means", &[n, 3]),
            group("scales", &[n, 3]),
            group("quats", &[n, 4]),
            group("opacities", &[n]),
            group("sh", &[n, coefficients, 3]),
            group("pose", &[frames, 6]),
        ];
        if wanted.any(Wanted::LENS) {
            groups.push(group("lens", &[frames, 4]));
        }
        GradientSums { groups }
    }

    /// Adds the gradients of a frame.
    pub fn add(&mut self, cloud: &GaussianCloud, frame: usize, gradients: &Gradients<f32>) {
        let values: [&[f32]; 5] = [
            gradients.positions.as_flattened(),
            gradients.scales.as_flattened(),
            gradients.rotations.as_flattened(),
            &gradients.opacities,
            &gradients.sh,
        ];
        for (name, sums, _) in &mut self.groups {
            match *name {
                "pose" => sums[6 * frame..6 * (frame + 1)].copy_from_slice(&gradients.pose),
                "lens" => sums[4 * frame..4 * (frame + 1)].copy_from_slice(&gradients.lens),
                _ => {}
            }
        }
        for ((_, sums, shape), values) in self.groups.iter_mut().zip(values) {
            let each = shape[1..].iter().product::<usize>();
            for (row, &i) in values.chunks(each).zip(&cloud.index) {
                let place = &mut sums[i as usize * each..(i as usize + 1) * each];
                place.iter_mut().zip(row).for_each(|(sum, v)| *sum += f64::from(*v));
            }
        }
    }

    /// Writes all groups.
    pub fn write(&self, path: &Path) -> Result<()> {
        let narrow: Vec<Vec<f32>> =
            self.groups.iter().map(|(_, sums, _)| sums.iter().map(|&v| v as f32).collect()).collect();
        let arrays: Vec<(&str, &[usize], &[f32])> = self
            .groups
            .iter()
            .zip(&narrow)
            .map(|((name, _, shape), data)| (*name, shape.as_slice(), data.as_slice()))
            .collect();
        npy::write_npz(path, &arrays)
    }
}
