//! A prediction's folder: written apart, and moved to its place once it is whole.

use std::path::PathBuf;

use glam::{DAffine3, DMat3, DVec3};
use numpy::{PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::prelude::*;
use respire_bench::base::depth::check_predicted_depth;
use respire_bench::base::range::{
    COORDINATE_MM, COVARIANCE_MM2, NumberRange, PREDICTED_PHASE, PREDICTED_PHASE_SD, WORK_TIME_S,
};
use respire_bench::base::{Error as LibraryError, Image, Result, Staging, TriangleMesh, method_name, pose};
use respire_bench::reconstruct::{PredictionFolder as Folder, PredictionTiming};

use crate::failure::{OrRaise, refused};
use crate::threads;

/// A prediction on its way to its folder. Dropped before `finish`, it leaves nothing behind.
#[pyclass]
pub struct PredictionFolder {
    method: Option<String>,
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

/// Places in mm; the error names one that no prediction may have.
fn points(name: &str, values: &PyReadonlyArray2<'_, f64>) -> PyResult<Vec<DVec3>> {
    let point = |(i, place): (usize, &[f64; 3])| {
        let within = place.iter().try_for_each(|v| COORDINATE_MM.check(*v));
        within.map_err(|e| refused(format!("{name}: point {i}: {e}")))?;
        Ok(DVec3::from_array(*place))
    };
    values.as_slice()?.as_chunks::<3>().0.iter().enumerate().map(point).collect()
}

#[pymethods]
impl PredictionFolder {
    /// `target` must be empty or not there.
    #[new]
    #[pyo3(signature = (target, method=None))]
    fn new(target: PathBuf, method: Option<String>) -> PyResult<Self> {
        let named = method.as_deref().map_or(Ok(()), method_name::check_foreign);
        named.map_err(|e| refused(format!("method: {e}")))?;
        let fail = |e| LibraryError::io("reading", &target, e);
        let is_taken = target.exists() && target.read_dir().map_err(fail).or_raise()?.next().is_some();
        if is_taken {
            return Err(refused(format!("{}: is not empty: nothing is overwritten", target.display())));
        }
        let staging = Staging::new(&target).or_raise()?;
        let folder = Folder::new(&staging.path(""));
        Ok(PredictionFolder { method, writing: Some((staging, folder)) })
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
        check_predicted_depth(&depth).map_err(|e| refused(format!("{kind}_mm, frame {frame}: {e}")))?;
        let write = || match kind {
            "depth" => folder.depth_mm(frame, &depth),
            _ => folder.novel_depth_mm(frame, &depth),
        };
        threads::run(py, || write().or_raise())
    }

    #[pyo3(signature = (frame, phase, deviation=None))]
    fn phase(&mut self, frame: usize, phase: f64, deviation: Option<f64>) -> PyResult<()> {
        let within = |name: &str, range: NumberRange, value: f64| {
            range.check(value).map_err(|e| refused(format!("{name}, frame {frame}: {e}")))
        };
        within("phase", PREDICTED_PHASE, phase)?;
        deviation.map_or(Ok(()), |sd| within("phase_sd", PREDICTED_PHASE_SD, sd))?;
        self.folder_mut()?.add_phase(frame, phase, deviation);
        Ok(())
    }

    /// A pose as a 4x4 matrix.
    fn pose(&mut self, frame: usize, world_from_camera: PyReadonlyArray2<'_, f64>) -> PyResult<()> {
        let pose = rigid(&format!("poses, frame {frame}"), world_from_camera.as_slice()?, COORDINATE_MM)?;
        self.folder_mut()?.add_pose(frame, pose);
        Ok(())
    }

    fn targets(&mut self, frame: usize, places_mm: PyReadonlyArray2<'_, f64>) -> PyResult<()> {
        let places = points(&format!("targets_mm, frame {frame}"), &places_mm)?;
        self.folder_mut()?.add_targets(frame, &places);
        Ok(())
    }

    /// Covariances of the targets' places, nine numbers each.
    fn target_covariances(&mut self, frame: usize, covariances_mm2: PyReadonlyArray2<'_, f64>) -> PyResult<()> {
        let entries = covariances_mm2.as_slice()?;
        for (i, entry) in entries.iter().enumerate() {
            let named = |e| format!("target_covariance_mm2, frame {frame}: that of target {}: {e}", i / 9);
            COVARIANCE_MM2.check(*entry).map_err(|e| refused(named(e)))?;
        }
        let matrices: Vec<DMat3> = entries.as_chunks::<9>().0.iter().map(DMat3::from_cols_array).collect();
        self.folder_mut()?.add_target_covariances(frame, &matrices);
        Ok(())
    }

    /// Removes all that was written. Nothing can be added afterwards.
    fn abandon(&mut self) {
        self.writing = None;
    }

    /// Writes the rest and moves all of it to its place.
    #[pyo3(signature = (frames, vertices=None, faces=None, time_total_s=None, time_cpu_s=None))]
    fn finish(
        &mut self,
        frames: usize,
        vertices: Option<PyReadonlyArray2<'_, f64>>,
        faces: Option<PyReadonlyArray1<'_, u32>>,
        time_total_s: Option<f64>,
        time_cpu_s: Option<f64>,
    ) -> PyResult<()> {
        let surface = match (vertices, faces) {
            (Some(vertices), Some(faces)) => {
                let faces = faces.as_slice()?.as_chunks::<3>().0.to_vec();
                let surface = TriangleMesh { vertices: points("mesh", &vertices)?, faces };
                surface.validate().map_err(|e| refused(format!("mesh: {e}")))?;
                Some(surface)
            }
            _ => None,
        };
        for (name, time) in [("time_total_s", time_total_s), ("time_cpu_s", time_cpu_s)] {
            let within = time.map_or(Ok(()), |seconds| WORK_TIME_S.check(seconds));
            within.map_err(|e| refused(format!("{name}: {e}")))?;
        }
        let timing = time_total_s.map(|time_total_s| PredictionTiming {
            time_total_s,
            time_cpu_s,
            time_per_frame_s: time_total_s / frames as f64,
            frames,
        });
        let (staging, folder) = self.writing.take().ok_or_else(closed)?;
        let write = || -> Result<()> {
            if let Some(method) = &self.method {
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

/// The rigid motion in the 16 numbers of a 4x4 matrix, row by row, with its place in `places`; an error names `name`.
pub fn rigid(name: &str, matrix: &[f64], places: NumberRange) -> PyResult<DAffine3> {
    let rows = matrix.as_chunks::<4>().0.try_into().map_err(|_| refused(format!("{name}: is no 4x4 matrix")))?;
    pose::from_rows(rows, places).map_err(|e| refused(format!("{name}: {e}")))
}
