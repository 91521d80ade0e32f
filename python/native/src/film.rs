//! A film's folder or a participant's, read file by file: each is compared with the manifest's hash first.

use std::path::{Path, PathBuf};

use glam::{DAffine3, DVec3};
use numpy::{PyArray, PyArray1, PyArray2, PyArray3, PyArrayMethods};
use pyo3::prelude::*;
use respire_bench::base::{Image, Result, TriangleMesh, mesh};
use respire_bench::simulate::participant::{Given, Participant};
use respire_bench::simulate::sequence::{Sequence, held_out};

use crate::failure::{OrRaise, refused};
use crate::threads;

/// An opened folder.
enum Opened {
    /// The whole film.
    Whole(Box<Sequence>),
    /// What participants of a blind comparison get.
    Participant(Box<Participant>),
}

/// A film. Without `truth`, what methods may see and nothing else, from either kind of folder.
#[pyclass(frozen)]
pub struct Film {
    opened: Opened,
    truth: bool,
}

/// Vertices (n, 3) in mm and faces (m, 3).
type MeshArrays<'py> = (Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<u32>>);

/// Points as an array of shape (n, 3).
fn points<'py>(py: Python<'py>, points: impl IntoIterator<Item = DVec3>) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let flat: Vec<f64> = points.into_iter().flat_map(|p| p.to_array()).collect();
    let count = flat.len() / 3;
    PyArray1::from_vec(py, flat).reshape([count, 3])
}

/// Poses as an array of shape (n, 4, 4).
fn poses<'py>(py: Python<'py>, poses: impl IntoIterator<Item = DAffine3>) -> PyResult<Bound<'py, PyArray3<f64>>> {
    let rows = |pose: DAffine3| {
        let (m, t) = (pose.matrix3, pose.translation);
        let row = |k: usize| [m.x_axis[k], m.y_axis[k], m.z_axis[k], t[k]];
        [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]]
    };
    let flat: Vec<f64> = poses.into_iter().flat_map(|p| rows(p).into_iter().flatten()).collect();
    let count = flat.len() / 16;
    PyArray1::from_vec(py, flat).reshape([count, 4, 4])
}

fn mesh_arrays<'py>(py: Python<'py>, mesh: &TriangleMesh) -> PyResult<MeshArrays<'py>> {
    let faces: Vec<u32> = mesh.faces.iter().flatten().copied().collect();
    let faces = PyArray1::from_vec(py, faces).reshape([mesh.faces.len(), 3])?;
    Ok((points(py, mesh.vertices.iter().copied())?, faces))
}

/// An image of shape (height, width, 3).
fn picture(py: Python<'_>, image: Image<u8>) -> PyResult<Bound<'_, PyArray3<u8>>> {
    let shape = [image.height, image.width, image.channels];
    PyArray1::from_vec(py, image.data).reshape(shape)
}

/// A plane of shape (height, width).
fn plane(py: Python<'_>, image: Image<f32>) -> PyResult<Bound<'_, PyArray2<f32>>> {
    let shape = [image.height, image.width];
    PyArray1::from_vec(py, image.data).reshape(shape)
}

impl Film {
    fn given(&self) -> &dyn Given {
        match &self.opened {
            Opened::Whole(film) => film.as_ref(),
            Opened::Participant(film) => film.as_ref(),
        }
    }

    /// The film with its truth, if that was asked for.
    fn whole(&self, what: &str) -> PyResult<&Sequence> {
        match &self.opened {
            Opened::Whole(film) if self.truth => Ok(film),
            _ => Err(refused(format!("{what} is truth, which no method may see: load(.., truth=True) opens it"))),
        }
    }

    fn index(&self, frame: usize) -> PyResult<usize> {
        let count = self.given().given_frames().len();
        if frame < count { Ok(frame) } else { Err(refused(format!("frame {frame} of a film of {count} frames"))) }
    }
}

/// Reads without holding the interpreter.
fn read<T: Send>(py: Python<'_>, read: impl FnOnce() -> Result<T> + Send) -> PyResult<T> {
    threads::run(py, || read().or_raise())
}

#[pymethods]
impl Film {
    /// Opens a sequence folder, or a participant's, which has no truth.
    #[staticmethod]
    fn open(py: Python<'_>, folder: PathBuf, truth: bool) -> PyResult<Film> {
        let open = |folder: &Path| {
            if Participant::is_at(folder) {
                Participant::open(folder).map(|film| Opened::Participant(Box::new(film)))
            } else {
                Sequence::open(folder).map(|film| Opened::Whole(Box::new(film)))
            }
        };
        let opened = read(py, || open(&folder))?;
        if truth && matches!(opened, Opened::Participant(_)) {
            let why = "is a participant's folder, which holds no truth";
            return Err(refused(format!("{}: {why}", folder.display())));
        }
        Ok(Film { opened, truth })
    }

    /// Number of frames.
    #[getter]
    fn frames(&self) -> usize {
        self.given().given_frames().len()
    }

    /// Width and height in pixels.
    #[getter]
    fn size(&self) -> (u32, u32) {
        let camera = self.given().given_camera();
        (camera.width, camera.height)
    }

    /// `fl_x, fl_y, cx, cy` in pixels.
    #[getter]
    fn intrinsics(&self) -> [f64; 4] {
        let camera = self.given().given_camera();
        [camera.fl_x, camera.fl_y, camera.cx, camera.cy]
    }

    /// `fl_x, fl_y, cx, cy` in pixels as they were (truth).
    #[getter]
    fn true_intrinsics(&self) -> PyResult<[f64; 4]> {
        let camera = self.whole("the true camera")?.camera;
        Ok([camera.fl_x, camera.fl_y, camera.cx, camera.cy])
    }

    /// `k1..k4` as they were (truth).
    #[getter]
    fn true_fisheye(&self) -> PyResult<Option<[f64; 4]>> {
        Ok(self.whole("the true camera")?.camera.fisheye)
    }

    /// Poses as they were (truth).
    #[getter]
    fn true_poses<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<f64>>> {
        let film = self.whole("the true pose")?;
        poses(py, film.frames.iter().map(|f| f.world_from_camera))
    }

    /// Poses of the second cameras as they were (truth).
    #[getter]
    fn true_novel_poses<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<f64>>> {
        let film = self.whole("the true pose of a second camera")?;
        poses(py, film.novel_views.iter().map(|view| view.world_from_camera))
    }

    /// Where the targets are at every frame (truth).
    #[getter]
    fn targets_by_frame_mm<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<f64>>> {
        let film = self.whole("the place of a target at a frame")?;
        let (frames, targets) = (film.frames.len(), film.targets.len());
        let places = (0..frames).flat_map(|frame| (0..targets).map(move |index| film.target_mm(index, frame)));
        let numbers: Vec<f64> = places.flat_map(|place| place.to_array()).collect();
        PyArray1::from_vec(py, numbers).reshape([frames, targets, 3])
    }

    /// `k1..k4` of OpenCV's fisheye model; `None` for a pinhole.
    #[getter]
    fn fisheye(&self) -> Option<[f64; 4]> {
        self.given().given_camera().fisheye
    }

    /// Seconds since the first frame.
    #[getter]
    fn times_s<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        PyArray::from_iter(py, self.given().given_frames().iter().map(|f| f.time_s))
    }

    /// Given poses, world from camera.
    #[getter]
    fn poses<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<f64>>> {
        poses(py, self.given().given_frames().iter().map(|f| f.world_from_camera))
    }

    /// Frames with a second camera.
    #[getter]
    fn novel_frames(&self) -> Vec<usize> {
        self.given().given_views().iter().map(|view| view.frame).collect()
    }

    /// Poses of the second cameras, in the order of their frames.
    #[getter]
    fn novel_poses<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<f64>>> {
        poses(py, self.given().given_views().iter().map(|view| view.world_from_camera))
    }

    /// Frames that are to be rendered before their image is used.
    #[getter]
    fn held_out_frames(&self) -> Vec<usize> {
        (0..self.frames()).filter(|&frame| held_out(frame)).collect()
    }

    /// Mean duration of a breath in seconds.
    #[getter]
    fn breathing_period_s(&self) -> f64 {
        self.given().given_period_s()
    }

    /// Targets as planned at inspiration.
    #[getter]
    fn targets_mm<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        points(py, self.given().planned_targets_mm())
    }

    fn image<'py>(&self, py: Python<'py>, frame: usize) -> PyResult<Bound<'py, PyArray3<u8>>> {
        let frame = self.index(frame)?;
        picture(py, read(py, || self.given().given_image(frame))?)
    }

    /// Depth of the first frame, and with the truth of any.
    fn depth_mm<'py>(&self, py: Python<'py>, frame: usize) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let frame = self.index(frame)?;
        let image = match frame {
            0 => read(py, || self.given().first_depth_mm())?,
            _ => {
                let film = self.whole(&format!("the depth of frame {frame}"))?;
                read(py, || film.depth_mm(frame))?
            }
        };
        plane(py, image)
    }

    /// Which pixels count.
    fn mask<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<bool>>>> {
        let Some(mask) = read(py, || self.given().given_mask())? else { return Ok(None) };
        let shown = PyArray::from_iter(py, (0..mask.width * mask.height).map(|pixel| mask.shows(pixel)));
        shown.reshape([mask.height, mask.width]).map(Some)
    }

    fn inspiration<'py>(&self, py: Python<'py>) -> PyResult<MeshArrays<'py>> {
        mesh_arrays(py, &read(py, || self.given().given_inspiration())?)
    }

    fn expiration<'py>(&self, py: Python<'py>) -> PyResult<MeshArrays<'py>> {
        mesh_arrays(py, &read(py, || self.given().given_expiration())?)
    }

    fn centerline_mm<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        points(py, read(py, || self.given().given_centerline_mm())?)
    }

    /// Case that was filmed (truth).
    #[getter]
    fn case_id(&self) -> PyResult<&str> {
        Ok(&self.whole("the case")?.case_id)
    }

    /// True phases.
    #[getter]
    fn phases<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let film = self.whole("the phase")?;
        Ok(PyArray::from_iter(py, film.frames.iter().map(|f| f.phase)))
    }

    /// True exposure gains.
    #[getter]
    fn gains<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let film = self.whole("the exposure")?;
        Ok(PyArray::from_iter(py, film.frames.iter().map(|f| f.gain)))
    }

    /// Where the targets are at full expiration (truth).
    #[getter]
    fn targets_expiration_mm<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let film = self.whole("the place of a target at expiration")?;
        points(py, film.targets.iter().map(|target| target.expiration_mm))
    }

    /// The surface at full inspiration (truth).
    fn true_inspiration<'py>(&self, py: Python<'py>) -> PyResult<MeshArrays<'py>> {
        let film = self.whole("the true surface")?;
        mesh_arrays(py, &read(py, || film.inspiration())?)
    }

    /// The surface at full expiration, same faces (truth).
    fn true_expiration<'py>(&self, py: Python<'py>) -> PyResult<MeshArrays<'py>> {
        let film = self.whole("the true surface")?;
        mesh_arrays(py, &read(py, || film.expiration())?)
    }

    /// The true surface at a frame; of a film of the clinical track, at the last one.
    fn true_mesh<'py>(&self, py: Python<'py>, frame: usize) -> PyResult<MeshArrays<'py>> {
        let film = self.whole("the surface at a frame")?;
        let frame = self.index(frame)?;
        if film.clinical.is_some() {
            let last = film.frames.len() - 1;
            if frame != last {
                let why = "the film is of the clinical track, where no phase says where the wall is";
                return Err(refused(format!("meshes[{frame}]: {why}; it is known at the last frame, {last}")));
            }
            let Some(surface) = read(py, || film.last_surface())? else { return Err(refused("no surface")) };
            return mesh_arrays(py, &surface);
        }
        let phase = film.frames[frame].phase;
        let (inspiration, expiration) = read(py, || Ok((film.inspiration()?, film.expiration()?)))?;
        let vertices = mesh::interpolate(&inspiration.vertices, &expiration.vertices, phase);
        mesh_arrays(py, &TriangleMesh { vertices, faces: inspiration.faces })
    }

    /// What the second camera of a frame saw (truth).
    fn novel_image<'py>(&self, py: Python<'py>, frame: usize) -> PyResult<Bound<'py, PyArray3<u8>>> {
        let film = self.whole("the picture of a second camera")?;
        picture(py, read(py, || film.novel_image(frame))?)
    }

    /// Depth of the second camera of a frame (truth).
    fn novel_depth_mm<'py>(&self, py: Python<'py>, frame: usize) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let film = self.whole("the depth of a second camera")?;
        plane(py, read(py, || film.novel_depth_mm(frame))?)
    }
}
