//! A prediction's folder: written apart, and moved to its place once it is whole.

use std::path::PathBuf;

use glam::{DAffine3, DVec3};
use numpy::{PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::prelude::*;
use respire_bench::base::range::COORDINATE;
use respire_bench::base::{Error as LibraryError, Image, Result, Staging, TriangleMesh, pose};
use respire_bench::reconstruct::{PredictionFolder as Folder, PredictionTiming};

use crate::failure::{OrRaise, refused};
use crate::threads;

/// A prediction on its way to its folder. Dropped before `finish`, it leaves nothing behind.
#[pyclass]
pub struct PredictionFolder {
    target: PathBuf,
    writing: Option<(Staging, Folder)>,
}

fn closed() -> PyErr {
    refused("the prediction is finished")
}

impl PredictionFolder {
    fn folder(&self) -> PyResult<&Folder> {
        self.writing.as_ref().map(|(_, folder)| folder).ok_or_else(closed)
    }

    fn folder_mut(&mut self) -> PyResult<&mut Folder> {
        self.writing.as_mut().map(|(_, folder)| folder).ok_or_else(closed)
    }
}

fn picture(image: &PyReadonlyArray3<'_, u8>) -> PyResult<Image<u8>> {
    let &[height, width, channels] = image.shape() else { return Err(refused("a picture has three dimensions")) };
    Ok(Image { width, height, channels, data: image.as_slice()?.to_vec() })
}

fn plane(depth: &PyReadonlyArray2<'_, f32>) -> PyResult<Image<f32>> {
    let &[height, width] = depth.shape() else { return Err(refused("a depth image has two dimensions")) };
    Ok(Image { width, height, channels: 1, data: depth.as_slice()?.to_vec() })
}

fn points(values: &PyReadonlyArray2<'_, f64>) -> PyResult<Vec<DVec3>> {
    Ok(values.as_slice()?.as_chunks::<3>().0.iter().map(|p| DVec3::from_array(*p)).collect())
}

#[pymethods]
impl PredictionFolder {
    /// `target` must be empty or not there.
    #[new]
    fn new(target: PathBuf) -> PyResult<Self> {
        let fail = |e| LibraryError::io("reading", &target, e);
        let is_taken = target.exists() && target.read_dir().map_err(fail).or_raise()?.next().is_some();
        if is_taken {
            return Err(refused(format!("{}: is not empty: nothing is overwritten", target.display())));
        }
        let staging = Staging::new(&target).or_raise()?;
        let folder = Folder::new(&staging.path(""));
        Ok(PredictionFolder { target, writing: Some((staging, folder)) })
    }

    /// Writes a picture of `kind` `color`, `ahead` or `novel`.
    fn picture(&self, py: Python<'_>, kind: &str, frame: usize, image: PyReadonlyArray3<'_, u8>) -> PyResult<()> {
        let (folder, image) = (self.folder()?, picture(&image)?);
        let write = || match kind {
            "color" => folder.color(frame, &image),
            "ahead" => folder.ahead(frame, &image),
            _ => folder.novel(frame, &image),
        };
        threads::run(py, || write().or_raise())
    }

    /// Writes a depth of `kind` `depth` or `novel_depth`.
    fn depth(&self, py: Python<'_>, kind: &str, frame: usize, depth: PyReadonlyArray2<'_, f32>) -> PyResult<()> {
        let (folder, depth) = (self.folder()?, plane(&depth)?);
        let write = || match kind {
            "depth" => folder.depth_mm(frame, &depth),
            _ => folder.novel_depth_mm(frame, &depth),
        };
        threads::run(py, || write().or_raise())
    }

    #[pyo3(signature = (frame, phase, deviation=None))]
    fn phase(&mut self, frame: usize, phase: f64, deviation: Option<f64>) -> PyResult<()> {
        self.folder_mut()?.add_phase(frame, phase, deviation);
        Ok(())
    }

    /// A pose as a 4x4 matrix.
    fn pose(&mut self, frame: usize, world_from_camera: PyReadonlyArray2<'_, f64>) -> PyResult<()> {
        let pose = rigid(world_from_camera.as_slice()?).ok_or_else(|| refused(format!("frame {frame}: {RIGID}")))?;
        self.folder_mut()?.add_pose(frame, pose);
        Ok(())
    }

    fn targets(&mut self, frame: usize, places_mm: PyReadonlyArray2<'_, f64>) -> PyResult<()> {
        let places = points(&places_mm)?;
        self.folder_mut()?.add_targets(frame, &places);
        Ok(())
    }

    /// Removes all that was written. Nothing can be added afterwards.
    fn abandon(&mut self) {
        self.writing = None;
    }

    /// Writes the rest and moves all of it to its place.
    #[pyo3(signature = (frames, method=None, vertices=None, faces=None, time_total_s=None, time_cpu_s=None))]
    fn finish(
        &mut self,
        frames: usize,
        method: Option<&str>,
        vertices: Option<PyReadonlyArray2<'_, f64>>,
        faces: Option<PyReadonlyArray1<'_, u32>>,
        time_total_s: Option<f64>,
        time_cpu_s: Option<f64>,
    ) -> PyResult<()> {
        let surface = match (vertices, faces) {
            (Some(vertices), Some(faces)) => {
                let faces = faces.as_slice()?.as_chunks::<3>().0.to_vec();
                let surface = TriangleMesh { vertices: points(&vertices)?, faces };
                surface.validate().map_err(|e| e.at(self.target.join("mesh/final.ply"))).or_raise()?;
                Some(surface)
            }
            _ => None,
        };
        let timing = time_total_s.map(|time_total_s| PredictionTiming {
            time_total_s,
            time_cpu_s,
            time_per_frame_s: time_total_s / frames as f64,
            frames,
        });
        let (staging, folder) = self.writing.take().ok_or_else(closed)?;
        let write = || -> Result<()> {
            if let Some(method) = method {
                folder.write_about(method)?;
            }
            folder.finish(surface.as_ref(), timing.as_ref())?;
            let inside = staging.path("");
            let fail = |e| LibraryError::io("reading", &inside, e);
            let entries: std::io::Result<Vec<_>> = inside.read_dir().map_err(fail)?.collect();
            let mut names: Vec<PathBuf> = entries.map_err(fail)?.iter().map(|entry| entry.file_name().into()).collect();
            names.sort();
            staging.publish(&names)
        };
        write().or_raise()
    }
}

/// What a matrix must be.
pub const RIGID: &str = "the pose is no rigid motion (a 4x4 matrix with a rotation, and 0 0 0 1 below)";

/// The rigid motion in the 16 numbers of a 4x4 matrix, row by row; `None` for anything else. Its unit is not known
/// here.
pub fn rigid(matrix: &[f64]) -> Option<DAffine3> {
    let rows: [[f64; 4]; 4] = matrix.as_chunks::<4>().0.try_into().ok().filter(|_| matrix.len() == 16)?;
    pose::from_rows(&rows, COORDINATE).ok()
}
