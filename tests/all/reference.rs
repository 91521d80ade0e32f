//! Reference data that we did not make (`../shared`), and measures between images.

use std::path::{Path, PathBuf};

use respire_bench::base::{Image, TriangleMesh};
use respire_bench::formats::mesh;

use crate::skip::{shared, skip};

/// A folder below `../shared`.
pub struct Reference(PathBuf);

impl Reference {
    /// `None` where the folder is absent, which is said.
    pub fn open(folder: &str) -> Option<Self> {
        shared(folder).map(Reference)
    }

    /// Where a file of it lies.
    pub fn path(&self, file: &str) -> PathBuf {
        self.0.join(file)
    }

    /// A text file of it.
    pub fn text(&self, file: &str) -> Option<String> {
        let path = self.0.join(file);
        present(&path).then(|| std::fs::read_to_string(path).unwrap())
    }

    /// A float32 array of shape (height, width, 3).
    pub fn npy_rgb(&self, file: &str) -> Option<Image<f32>> {
        let path = self.0.join(file);
        present(&path).then(|| {
            let array = npyz::NpyFile::new(std::io::BufReader::new(std::fs::File::open(path).unwrap())).unwrap();
            let shape = array.shape().to_vec();
            assert_eq!((shape.len(), shape[2]), (3, 3));
            let (height, width) = (shape[0] as usize, shape[1] as usize);
            Image { width, height, channels: 3, data: array.into_vec::<f32>().unwrap() }
        })
    }

    /// A surface.
    pub fn mesh(&self, file: &str) -> Option<TriangleMesh> {
        let path = self.0.join(file);
        present(&path).then(|| mesh::read(&path).unwrap())
    }
}

fn present(path: &Path) -> bool {
    if !path.exists() {
        skip("shared", &format!("{} is absent", path.display()));
    }
    path.exists()
}

/// Mean over pixels and channels of `(image - truth)^2 / (truth^2 + 1e-4)`.
pub fn relative_mse(image: &Image<f32>, truth: &Image<f32>) -> f64 {
    assert!(image.same_shape(truth));
    let error = |(&a, &b): (&f32, &f32)| ((a - b) as f64).powi(2) / ((b as f64).powi(2) + 1e-4);
    image.data.iter().zip(&truth.data).map(error).sum::<f64>() / image.data.len() as f64
}

/// Relative differences of the means over `side` x `side` pixels, per block and channel.
pub fn block_errors(image: &Image<f32>, truth: &Image<f32>, side: usize) -> Vec<f64> {
    assert!(image.same_shape(truth));
    let block_mean = |image: &Image<f32>, bx: usize, by: usize, c: usize| -> f64 {
        let rows = by * side..(by + 1) * side;
        rows.flat_map(|y| (bx * side..(bx + 1) * side).map(move |x| (x, y)))
            .map(|(x, y)| image.pixel(x, y)[c] as f64)
            .sum()
    };
    let mut errors = Vec::new();
    for by in 0..image.height / side {
        for bx in 0..image.width / side {
            for c in 0..image.channels {
                errors.push((block_mean(image, bx, by, c) / block_mean(truth, bx, by, c) - 1.0).abs());
            }
        }
    }
    errors
}
