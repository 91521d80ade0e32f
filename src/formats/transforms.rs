//! `transforms.json` in the layout of nerfstudio, with the extra per-frame keys of this project. What other programs
//! write is read too: intrinsics of each frame in place of those of all, sizes as `160.0`, and a field of view
//! (`camera_angle_x` and `camera_angle_y`, Blender's and D-NeRF's) in place of a focal length.
//!
//! Camera axes in the file are OpenGL's (x right, y up, z backwards) and `transform_matrix` is world-from-camera, row
//! major; this module converts from and to OpenCV axes. World z points up (LPS: towards the head). Lengths are mm.

use std::path::Path;

use glam::{DAffine3, DMat3, DVec3};
use serde::{Deserialize, Deserializer, Serialize};

use crate::base::range::{COORDINATE, NumberRange};
use crate::base::{Camera, Error, Result, files, pose};

/// Angles of view of a picture in radians: in degrees from .06 to 177.6.
const ANGLE_RAD: NumberRange = NumberRange::new(1e-3, 3.1);

/// Intrinsics as they stand in the file, at its top or in a frame; what a frame leaves out is as at the top.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TransformsLens {
    /// `OPENCV` (pinhole; the default) or `OPENCV_FISHEYE`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub camera_model: Option<String>,
    /// The same as instant-ngp says it; it must not contradict `camera_model`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub is_fisheye: Option<bool>,
    /// Image width in pixels.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "pixels")]
    pub w: Option<u32>,
    /// Image height in pixels.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "pixels")]
    pub h: Option<u32>,
    /// Horizontal field of view in radians, where there is no `fl_x`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub camera_angle_x: Option<f64>,
    /// Vertical field of view in radians, where there is no `fl_y`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub camera_angle_y: Option<f64>,
    /// Focal lengths and principal point in pixels. Without the vertical one pixels are square, without `cx` and `cy`
    /// the principal point is the middle of the image.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fl_x: Option<f64>,
    /// See `fl_x`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fl_y: Option<f64>,
    /// See `fl_x`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cx: Option<f64>,
    /// See `fl_x`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cy: Option<f64>,
    /// Distortion; all zero for a pinhole.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub k1: Option<f64>,
    /// See `k1`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub k2: Option<f64>,
    /// See `k1`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub k3: Option<f64>,
    /// See `k1`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub k4: Option<f64>,
    /// Tangential distortion, which is not supported.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub p1: Option<f64>,
    /// See `p1`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub p2: Option<f64>,
}

/// Reads a whole number that may be written as a float, as Python's `json` writes the sizes of instant-ngp and others.
fn pixels<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<u32>, D::Error> {
    let Some(value) = Option::<f64>::deserialize(deserializer)? else { return Ok(None) };
    if value.fract() == 0.0 && (0.0..=f64::from(u32::MAX)).contains(&value) {
        return Ok(Some(value as u32));
    }
    Err(serde::de::Error::custom(format!("{value} is no number of pixels")))
}

impl TransformsLens {
    /// Those of `camera`.
    fn of(camera: &Camera) -> Self {
        let [k1, k2, k3, k4] = camera.fisheye.unwrap_or([0.0; 4]).map(Some);
        TransformsLens {
            camera_model: Some(if camera.fisheye.is_some() { "OPENCV_FISHEYE" } else { "OPENCV" }.into()),
            w: Some(camera.width),
            h: Some(camera.height),
            is_fisheye: None,
            camera_angle_x: None,
            camera_angle_y: None,
            fl_x: Some(camera.fl_x),
            fl_y: Some(camera.fl_y),
            cx: Some(camera.cx),
            cy: Some(camera.cy),
            k1,
            k2,
            k3,
            k4,
            p1: None,
            p2: None,
        }
    }

    /// These, and `other` where one is left out.
    fn or(&self, other: &Self) -> Self {
        // A frame's field of view goes before the focal length of all frames, and makes square pixels if it is alone;
        // a frame's model goes before what is said of all frames in other words.
        let angle_x = self.camera_angle_x.is_some();
        let angle_y = angle_x || self.camera_angle_y.is_some();
        let models = if self.is_fisheye.is_some() { &None } else { &other.camera_model };
        TransformsLens {
            camera_model: self.camera_model.clone().or_else(|| models.clone()),
            is_fisheye: self.is_fisheye.or(if self.camera_model.is_some() { None } else { other.is_fisheye }),
            w: self.w.or(other.w),
            h: self.h.or(other.h),
            camera_angle_x: self.camera_angle_x.or(other.camera_angle_x),
            camera_angle_y: self.camera_angle_y.or(if angle_x { None } else { other.camera_angle_y }),
            fl_x: self.fl_x.or(if angle_x { None } else { other.fl_x }),
            fl_y: self.fl_y.or(if angle_y { None } else { other.fl_y }),
            cx: self.cx.or(other.cx),
            cy: self.cy.or(other.cy),
            k1: self.k1.or(other.k1),
            k2: self.k2.or(other.k2),
            k3: self.k3.or(other.k3),
            k4: self.k4.or(other.k4),
            p1: self.p1.or(other.p1),
            p2: self.p2.or(other.p2),
        }
    }

    /// The camera of these. Errors: one that is missing, a model that is neither pinhole nor fisheye, two models that
    /// contradict each other, impossible values.
    fn camera(&self) -> Result<Camera> {
        let wanted =
            |key: &str| Error::input(format!("`{key}` stands neither in the frame nor at the top of the file"));
        let distortion = [self.k1, self.k2, self.k3, self.k4].map(Option::unwrap_or_default);
        if [self.p1, self.p2].into_iter().flatten().any(|p| p != 0.0) {
            return Err(Error::input("tangential distortion is not supported").element("p1, p2"));
        }
        let usual = if self.is_fisheye == Some(true) { "OPENCV_FISHEYE" } else { "OPENCV" };
        let model = self.camera_model.as_deref().unwrap_or(usual);
        let fisheye = match model {
            "OPENCV_FISHEYE" => Some(distortion),
            "OPENCV" | "PINHOLE" | "SIMPLE_PINHOLE" | "PERSPECTIVE" => None,
            other => return Err(Error::input(format!("`{other}` is not supported")).element("camera_model")),
        };
        if let Some(said) = self.is_fisheye.filter(|said| *said != fisheye.is_some()) {
            return Err(Error::input(format!("{said} contradicts the camera_model `{model}`")).element("is_fisheye"));
        }
        if let (None, Some(k)) = (fisheye, distortion.iter().position(|k| *k != 0.0)) {
            let message = "radial distortion of a pinhole is not supported";
            return Err(Error::input(message).element(format!("k{}", k + 1)));
        }
        let (width, height) = (self.w.ok_or_else(|| wanted("w"))?, self.h.ok_or_else(|| wanted("h"))?);
        let length = |length: Option<f64>, angle: Option<f64>, key: &str, size: u32| match (length, angle) {
            (Some(length), _) => Ok(Some(length)),
            (None, Some(angle)) => {
                ANGLE_RAD.check(angle).map_err(|e| Error::input(format!("{e}: it is in radians")).element(key))?;
                Ok(Some(f64::from(size) / 2.0 / (angle / 2.0).tan()))
            }
            (None, None) => Ok(None),
        };
        let fl_x = length(self.fl_x, self.camera_angle_x, "camera_angle_x", width)?.ok_or_else(|| wanted("fl_x"))?;
        let fl_y = length(self.fl_y, self.camera_angle_y, "camera_angle_y", height)?;
        let camera = Camera {
            width,
            height,
            fl_x,
            fl_y: fl_y.unwrap_or(fl_x),
            cx: self.cx.unwrap_or(f64::from(width) / 2.0),
            cy: self.cy.unwrap_or(f64::from(height) / 2.0),
            fisheye,
        };
        camera.validate()?;
        Ok(camera)
    }
}

/// One frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TransformsFrame {
    /// Image, relative to the file.
    pub file_path: String,
    /// z-depth image, relative to the file.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub depth_file_path: Option<String>,
    /// One-channel image that is 0 where the image holds nothing, relative to the file.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mask_path: Option<String>,
    /// World from camera, OpenGL camera axes, row-major 4x4.
    pub transform_matrix: [[f64; 4]; 4],
    /// Seconds since the first frame.
    #[serde(default)]
    pub time: f64,
    /// True breathing phase.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub breathing_phase: Option<f64>,
    /// Gain on linear radiance.
    #[serde(default = "one")]
    pub exposure: f64,
    /// Factors on red, green and blue.
    #[serde(default = "ones")]
    pub white_balance: [f64; 3],
    /// Intrinsics of this frame alone, which films do not have.
    #[serde(flatten)]
    pub lens: TransformsLens,
}

fn one() -> f64 {
    1.0
}

fn ones() -> [f64; 3] {
    [1.0; 3]
}

impl TransformsFrame {
    /// World from camera with OpenCV axes.
    pub fn world_from_camera(&self) -> DAffine3 {
        let m = &self.transform_matrix;
        let column = |c: usize| DVec3::new(m[0][c], m[1][c], m[2][c]);
        DAffine3::from_mat3_translation(DMat3::from_cols(column(0), -column(1), -column(2)), column(3))
    }

    /// Matrix of the file for a pose with OpenCV axes.
    pub fn matrix(world_from_camera: &DAffine3) -> [[f64; 4]; 4] {
        let r = &world_from_camera.matrix3;
        let t = world_from_camera.translation;
        let row = |a: usize| [r.x_axis[a], -r.y_axis[a], -r.z_axis[a], t[a]];
        [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]]
    }
}

/// The whole file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Transforms {
    /// Intrinsics of all frames that have none of their own.
    #[serde(flatten)]
    pub lens: TransformsLens,
    /// One unit of a depth image in metres. nerfstudio does not look for it here, but has the same default.
    #[serde(default = "thousandth")]
    pub depth_unit_scale_factor: f64,
    /// Units of `transform_matrix` in a metre. nerfstudio turns depths into metres and multiplies them with this, so
    /// that they fit poses that are not in metres; without it the two would differ by a factor of a thousand.
    #[serde(default = "one")]
    pub applied_scale: f64,
    /// Frames in order of time.
    pub frames: Vec<TransformsFrame>,
}

fn thousandth() -> f64 {
    1e-3
}

impl Transforms {
    /// A file for `camera`.
    pub fn new(camera: &Camera, frames: Vec<TransformsFrame>) -> Self {
        Transforms {
            lens: TransformsLens::of(camera),
            depth_unit_scale_factor: thousandth(),
            applied_scale: 1.0 / thousandth(),
            frames,
        }
    }

    /// Reads a file; the error names it and the key or frame.
    pub fn read(path: &Path) -> Result<Self> {
        Self::parse(&files::read_bytes(path)?).map_err(|e| e.at(path))
    }

    /// [`Transforms::read`] for bytes in memory.
    pub fn parse(bytes: &[u8]) -> Result<Self> {
        let transforms: Transforms = serde_json::from_slice(bytes).map_err(|e| Error::input(e.to_string()))?;
        // Of all frames, and of a file without any.
        (0..transforms.frames.len()).try_for_each(|frame| transforms.frame_camera(frame).map(drop))?;
        if transforms.frames.is_empty() {
            transforms.lens.camera()?;
        }
        for (index, frame) in transforms.frames.iter().enumerate() {
            let named = |e: Error| Error::input(format!("transform_matrix {e}")).element(format!("frame {index}"));
            pose::from_rows(&frame.transform_matrix, COORDINATE).map_err(named)?;
        }
        Ok(transforms)
    }

    /// Writes the file atomically.
    pub fn write(&self, path: &Path) -> Result<()> {
        files::write_json(path, self)
    }

    /// Intrinsics of all frames. Errors: frames that differ, and those of [`Transforms::frame_camera`].
    pub fn camera(&self) -> Result<Camera> {
        if self.frames.is_empty() {
            return self.lens.camera();
        }
        let camera = self.frame_camera(0)?;
        match (1..self.frames.len()).find(|&frame| self.frame_camera(frame).ok() != Some(camera)) {
            Some(frame) => Err(Error::input("has other intrinsics than frame 0").element(format!("frame {frame}"))),
            None => Ok(camera),
        }
    }

    /// Intrinsics of a frame. Errors: one that is missing, a camera model that is neither pinhole nor fisheye,
    /// impossible values.
    pub fn frame_camera(&self, frame: usize) -> Result<Camera> {
        let own = &self.frames[frame].lens;
        if *own == TransformsLens::default() {
            return self.lens.camera();
        }
        own.or(&self.lens).camera().map_err(|e| Error::input(e.to_string()).element(format!("frame {frame}")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::camera::world_from_camera_looking;

    #[test]
    fn poses_and_cameras_survive_to_the_bit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("transforms.json");
        let pose = world_from_camera_looking(DVec3::new(0.1, -7.3, 1e3), DVec3::new(0.3, 0.2, -0.7), DVec3::X);
        let frame = TransformsFrame {
            file_path: "images/000000.png".into(),
            depth_file_path: None,
            mask_path: None,
            transform_matrix: TransformsFrame::matrix(&pose),
            time: 1.0 / 3.0,
            breathing_phase: Some(0.123456789123),
            exposure: 0.7,
            white_balance: [1.01, 1.0, 0.98],
            lens: TransformsLens::default(),
        };
        for fisheye in [None, Some([0.01, 0.0, -0.002, 0.0])] {
            let camera = Camera { fisheye, ..Camera::pinhole(64, 48, 1.7) };
            Transforms::new(&camera, vec![frame.clone()]).write(&path).unwrap();
            let back = Transforms::read(&path).unwrap();
            assert_eq!(back.camera().unwrap(), camera);
            assert_eq!(back.frames[0], frame);
            assert_eq!(back.frames[0].world_from_camera(), pose);
        }
        // OpenGL: the camera looks along its negative z.
        let z = frame.transform_matrix.map(|row| row[2]);
        assert!((DVec3::new(z[0], z[1], z[2]) + pose.matrix3.z_axis).length() < 1e-15);
    }

    #[test]
    fn a_written_out_example_of_nerfstudios_conventions() {
        // "Data conventions": columns of transform_matrix are the camera's +X (right), +Y (up) and +Z
        // (backwards) axes and its position; OPENCV_FISHEYE uses k1 to k4; intrinsics at the top.
        let text = r#"{
            "fl_x": 107.2, "fl_y": 106.8, "cx": 150.4, "cy": 100.0, "w": 300, "h": 200,
            "camera_model": "OPENCV_FISHEYE", "k1": 0.03, "k2": 0.005, "k3": 0.0006, "k4": 0.0001,
            "frames": [{"file_path": "images/frame_00001.jpeg",
                "transform_matrix": [[1.0, 0.0, 0.0, 4.0], [0.0, 1.0, 0.0, 5.0], [0.0, 0.0, 1.0, 6.0], [0.0, 0.0, 0.0, 1.0]]}]
        }"#;
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("transforms.json");
        std::fs::write(&path, text).unwrap();
        let read = Transforms::read(&path).unwrap();
        let (camera, pose) = (read.camera().unwrap(), read.frames[0].world_from_camera());
        assert_eq!(camera.fisheye, Some([0.03, 0.005, 0.0006, 0.0001]));
        // A point before the camera (along -Z), to its right and above: right of the centre and in the upper half.
        let seen = camera.project(pose.inverse().transform_point3(DVec3::new(5.0, 7.0, -4.0))).unwrap();
        let (x, y, theta) = (0.1, 0.2, (0.05f64).sqrt().atan());
        let distorted =
            theta + 0.03 * theta.powi(3) + 0.005 * theta.powi(5) + 0.0006 * theta.powi(7) + 0.0001 * theta.powi(9);
        let scale = distorted / (0.05f64).sqrt();
        assert!((seen.x - (150.4 + 107.2 * scale * x)).abs() < 1e-9, "{seen}");
        assert!((seen.y - (100.0 - 106.8 * scale * y)).abs() < 1e-9, "{seen}");
        assert_eq!(TransformsFrame::matrix(&pose), read.frames[0].transform_matrix);
    }

    #[test]
    fn damage_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("transforms.json");
        std::fs::write(&path, "{\"camera_model\":\"EQUIRECTANGULAR\",\"w\":4,\"h\":4,\"fl_x\":1,\"fl_y\":1,\"cx\":2,\"cy\":2,\"frames\":[]}").unwrap();
        assert!(Transforms::read(&path).unwrap_err().to_string().contains("camera_model: `EQUIRECTANGULAR`"));
        std::fs::write(&path, "{").unwrap();
        assert!(Transforms::read(&path).unwrap_err().to_string().contains("transforms.json"));
        let refused = |more: &str, matrix: &str| {
            let text = format!(
                "{{\"w\":4,\"h\":4,\"fl_x\":1,\"fl_y\":1,\"cx\":2,\"cy\":2{more},\"frames\":[{{\"file_path\":\"a\",\
                 \"transform_matrix\":{matrix}}}]}}"
            );
            std::fs::write(&path, text).unwrap();
            Transforms::read(&path).err().map(|e| e.to_string()).unwrap_or_default()
        };
        let rigid = "[[1,0,0,0],[0,0,-1,2],[0,1,0,0],[0,0,0,1]]";
        assert_eq!(refused("", rigid), "", "the model of a camera is a pinhole unless it is named");
        assert!(refused(",\"p2\":0.01", rigid).contains("tangential"));
        assert!(refused(",\"k1\":0.1", rigid).contains("k1: radial"));
        assert!(refused(",\"k3\":0.1", rigid).contains("k3: radial"));
        assert!(refused(",\"k1\":0.1,\"camera_model\":\"PINHOLE\"", rigid).contains("k1: radial"));
        assert!(
            refused(",\"is_fisheye\":true,\"camera_model\":\"OPENCV\"", rigid)
                .contains("is_fisheye: true contradicts the camera_model `OPENCV`")
        );
        assert_eq!(refused(",\"is_fisheye\":false,\"camera_model\":\"PINHOLE\"", rigid), "");
        for matrix in [
            "[[2,0,0,0],[0,2,0,0],[0,0,2,0],[0,0,0,1]]",
            "[[-1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]",
            "[[0,0,0,0],[0,0,0,0],[0,0,0,0],[0,0,0,1]]",
            "[[1,0.1,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]",
            "[[1,0,0,0],[0,1,0,0],[0,0,1,0],[4,5,6,1]]",
            "[[1,0,0,1e300],[0,1,0,0],[0,0,1,0],[0,0,0,1]]",
        ] {
            let sentence = refused("", matrix);
            assert!(sentence.contains("transforms.json") && sentence.contains("frame 0"), "{sentence}");
        }
    }

    #[test]
    fn a_lens_that_no_camera_has_is_named() {
        for (key, value) in [("fl_x", "1e-300"), ("fl_y", "-4"), ("cx", "1e300"), ("k1", "1e300"), ("k4", "-1e9")] {
            let lens = [("fl_x", "4"), ("fl_y", "4"), ("cx", "2"), ("cy", "2"), ("k1", "0"), ("k4", "0")];
            let lens = lens.map(|(name, good)| format!("\"{name}\":{}", if name == key { value } else { good }));
            let text =
                format!("{{\"camera_model\":\"OPENCV_FISHEYE\",\"w\":4,\"h\":4,{},\"frames\":[]}}", lens.join(","));
            let said = Transforms::parse(text.as_bytes()).unwrap_err().to_string();
            assert!(said.starts_with(&format!("{key}: {value} must lie in")), "{said}");
        }
    }

    /// As instant-ngp, Blender's exporters and phones write it.
    #[test]
    fn intrinsics_of_frames_sizes_as_floats_and_fields_of_view_are_read() {
        let matrix = "[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]";
        let parse = |top: &str, frames: &[&str]| {
            let frame = |own: &&str| format!("{{\"file_path\":\"a\",\"transform_matrix\":{matrix}{own}}}");
            let frames: Vec<String> = frames.iter().map(frame).collect();
            Transforms::parse(format!("{{{top}\"frames\":[{}]}}", frames.join(",")).as_bytes())
        };
        let own = ",\"w\":160.0,\"h\":120.0,\"fl_x\":100,\"fl_y\":101,\"cx\":80.5,\"cy\":60.5";
        let other = ",\"w\":80,\"h\":60,\"fl_x\":50,\"camera_model\":\"OPENCV_FISHEYE\",\"k1\":0.1";
        let read = parse("", &[own, other]).unwrap();
        let first = read.frame_camera(0).unwrap();
        assert_eq!((first.width, first.height, first.fl_y, first.cx), (160, 120, 101.0, 80.5));
        let second = read.frame_camera(1).unwrap();
        assert_eq!((second.fl_y, second.cx, second.fisheye), (50.0, 40.0, Some([0.1, 0.0, 0.0, 0.0])));
        assert_eq!(read.camera().unwrap_err().to_string(), "frame 1: has other intrinsics than frame 0");
        // A frame's own goes before the file's, and a field of view makes a focal length.
        let angled =
            parse("\"camera_angle_x\":1.5707963267948966,\"w\":160.0,\"h\":120,", &["", ",\"fl_x\":70"]).unwrap();
        assert!((angled.frame_camera(0).unwrap().fl_y - 80.0).abs() < 1e-9);
        assert_eq!(angled.frame_camera(1).unwrap().fl_x, 70.0);
        // A vertical one too: of all frames, of a frame, and not where the frame has a horizontal one alone.
        let top = "\"camera_angle_x\":1.5707963267948966,\"camera_angle_y\":1.2870022175866,\"w\":160,\"h\":120,";
        let frames = ["", ",\"fl_y\":70", ",\"camera_angle_x\":1", ",\"camera_angle_y\":1.5707963267948966"];
        let angled = parse(top, &frames).unwrap();
        let focal_y = [0, 1, 2, 3].map(|frame| angled.frame_camera(frame).unwrap().fl_y.round());
        assert_eq!(focal_y, [80.0, 70.0, 146.0, 60.0]);
        // A model as instant-ngp says it; the frame's word goes first.
        let frames = ["", ",\"is_fisheye\":false,\"k1\":0", ",\"camera_model\":\"PINHOLE\",\"k1\":0"];
        let fisheye = parse("\"is_fisheye\":true,\"k1\":0.1,\"w\":160,\"h\":120,\"fl_x\":80,", &frames).unwrap();
        assert_eq!(fisheye.frame_camera(0).unwrap().fisheye, Some([0.1, 0.0, 0.0, 0.0]));
        assert_eq!([1, 2].map(|frame| fisheye.frame_camera(frame).unwrap().fisheye), [None; 2]);
        for (top, frames, says) in [
            ("", vec![own, ""], "`w` stands neither"),
            ("\"w\":160.5,\"h\":1,\"fl_x\":1,", vec![""], "160.5 is no number of pixels"),
            ("\"w\":-1,\"h\":1,\"fl_x\":1,", vec![""], "-1 is no number of pixels"),
            (
                "\"w\":8,\"h\":8,\"camera_angle_x\":90,",
                vec![""],
                "camera_angle_x: 90 must lie in 0.001 to 3.1: it is in",
            ),
            ("\"w\":8,\"h\":8,\"fl_x\":4,\"camera_angle_y\":-1,", vec![""], "camera_angle_y: -1 must lie"),
            ("", vec![own, ",\"w\":8,\"h\":8,\"fl_x\":1,\"k2\":1"], "frame 1: k2: radial"),
        ] {
            let said = parse(top, &frames).unwrap_err().to_string();
            assert!(said.contains(says), "{said}");
        }
    }
}
