//! `transforms.json` in the layout of nerfstudio, with the extra per-frame keys of this project.
//!
//! Camera axes in the file are OpenGL's (x right, y up, z backwards) and `transform_matrix` is world-from-camera, row
//! major; this module converts from and to OpenCV axes. World z points up (LPS: towards the head). Lengths are mm.

use std::path::Path;

use glam::{DAffine3, DMat3, DVec3};
use serde::{Deserialize, Serialize};

use crate::base::{Camera, Error, Result, files};

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
    /// `OPENCV` (pinhole; the default) or `OPENCV_FISHEYE`.
    #[serde(default = "pinhole")]
    pub camera_model: String,
    /// Image width in pixels.
    pub w: u32,
    /// Image height in pixels.
    pub h: u32,
    /// Focal lengths and principal point in pixels.
    pub fl_x: f64,
    /// See `fl_x`.
    pub fl_y: f64,
    /// See `fl_x`.
    pub cx: f64,
    /// See `fl_x`.
    pub cy: f64,
    /// Distortion; all zero for a pinhole.
    #[serde(default)]
    pub k1: f64,
    /// See `k1`.
    #[serde(default)]
    pub k2: f64,
    /// See `k1`.
    #[serde(default)]
    pub k3: f64,
    /// See `k1`.
    #[serde(default)]
    pub k4: f64,
    /// Tangential distortion, which is not supported.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub p1: f64,
    /// See `p1`.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub p2: f64,
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

fn pinhole() -> String {
    "OPENCV".into()
}

fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

/// Columns of unit length at right angles, right-handed: to a thousandth, since files round.
fn is_rigid(pose: &DAffine3) -> bool {
    let m = pose.matrix3;
    let products = (m.transpose() * m - DMat3::IDENTITY).to_cols_array();
    products.iter().all(|v| v.abs() <= 2e-3) && m.determinant() > 0.0
}

fn thousandth() -> f64 {
    1e-3
}

impl Transforms {
    /// A file for `camera`.
    pub fn new(camera: &Camera, frames: Vec<TransformsFrame>) -> Self {
        let [k1, k2, k3, k4] = camera.fisheye.unwrap_or([0.0; 4]);
        Transforms {
            camera_model: if camera.fisheye.is_some() { "OPENCV_FISHEYE" } else { "OPENCV" }.into(),
            w: camera.width,
            h: camera.height,
            fl_x: camera.fl_x,
            fl_y: camera.fl_y,
            cx: camera.cx,
            cy: camera.cy,
            k1,
            k2,
            k3,
            k4,
            p1: 0.0,
            p2: 0.0,
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
        transforms.camera()?;
        let broken = |f: &TransformsFrame| f.transform_matrix.iter().flatten().any(|v| !v.is_finite());
        if let Some(f) = transforms.frames.iter().position(broken) {
            return Err(Error::input("transform_matrix is not finite").element(format!("frame {f}")));
        }
        if let Some(f) = transforms.frames.iter().position(|f| !is_rigid(&f.world_from_camera())) {
            let message = "transform_matrix is no rotation and translation (it scales, shears, mirrors or is singular)";
            return Err(Error::input(message).element(format!("frame {f}")));
        }
        Ok(transforms)
    }

    /// Writes the file atomically.
    pub fn write(&self, path: &Path) -> Result<()> {
        files::write_json(path, self)
    }

    /// Intrinsics. Errors: a camera model that is neither pinhole nor fisheye, impossible values.
    pub fn camera(&self) -> Result<Camera> {
        let distortion = [self.k1, self.k2, self.k3, self.k4];
        if self.p1 != 0.0 || self.p2 != 0.0 {
            return Err(Error::input("tangential distortion is not supported").element("p1, p2"));
        }
        let fisheye = match self.camera_model.as_str() {
            "OPENCV_FISHEYE" => Some(distortion),
            "OPENCV" | "PINHOLE" | "SIMPLE_PINHOLE" if distortion == [0.0; 4] => None,
            "OPENCV" => return Err(Error::input("radial distortion of a pinhole is not supported").element("k1")),
            other => return Err(Error::input(format!("`{other}` is not supported")).element("camera_model")),
        };
        let camera = Camera {
            width: self.w,
            height: self.h,
            fl_x: self.fl_x,
            fl_y: self.fl_y,
            cx: self.cx,
            cy: self.cy,
            fisheye,
        };
        camera.validate()?;
        Ok(camera)
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
        for matrix in [
            "[[2,0,0,0],[0,2,0,0],[0,0,2,0],[0,0,0,1]]",
            "[[-1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]",
            "[[0,0,0,0],[0,0,0,0],[0,0,0,0],[0,0,0,1]]",
            "[[1,0.1,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]",
        ] {
            let sentence = refused("", matrix);
            assert!(sentence.contains("transforms.json") && sentence.contains("frame 0"), "{sentence}");
        }
    }
}
