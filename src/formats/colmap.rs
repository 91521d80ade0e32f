//! A COLMAP model (<https://colmap.github.io/format.html>), as text and as its binary twin: `cameras`, `images`,
//! `points3D`. One camera, no 2D points, empty tracks: what trainers of Gaussians read. Poses are camera-from-world
//! with OpenCV axes; the quaternion is Hamilton's, w first; pixel centres are at integer + 0.5, as here.
//!
//! Both forms are written since readers differ: nerfstudio takes the text first, OpenSplat knows the binary alone.

use std::fmt::Write;

use glam::{DAffine3, DQuat, DVec3};

use crate::base::Camera;

/// A point with its colour.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ColoredPoint {
    /// Where it is, in the unit of the poses.
    pub position: DVec3,
    /// 8-bit sRGB.
    pub color: [u8; 3],
}

/// An image's name, relative to the folder of images, and the pose of its camera.
pub type PosedImage = (String, DAffine3);

/// A model of one camera.
#[derive(Clone, Debug)]
pub struct ColmapModel {
    /// Intrinsics of all images.
    pub camera: Camera,
    /// Images; their ids are their places, from 1.
    pub images: Vec<PosedImage>,
    /// Points; their ids are their places, from 1.
    pub points: Vec<ColoredPoint>,
}

/// The one camera's id.
const CAMERA_ID: u32 = 1;

/// Name, number and parameters of COLMAP's model of `camera`.
fn model(camera: &Camera) -> (&'static str, i32, Vec<f64>) {
    let pinhole = vec![camera.fl_x, camera.fl_y, camera.cx, camera.cy];
    match camera.fisheye {
        None => ("PINHOLE", 1, pinhole),
        Some(k) => ("OPENCV_FISHEYE", 5, [pinhole, k.to_vec()].concat()),
    }
}

/// Rotation (w, x, y, z; w not negative) and translation of camera from world.
fn pose(world_from_camera: &DAffine3) -> ([f64; 4], DVec3) {
    let camera_from_world = world_from_camera.inverse();
    let q = DQuat::from_mat3(&camera_from_world.matrix3).normalize();
    let q = if q.w < 0.0 { -q } else { q };
    ([q.w, q.x, q.y, q.z], camera_from_world.translation)
}

/// Numbers between blanks; no zero is negative.
fn spaced(values: impl IntoIterator<Item = f64>) -> String {
    values.into_iter().map(|v| (v + 0.0).to_string()).collect::<Vec<_>>().join(" ")
}

impl ColmapModel {
    /// `cameras.txt`.
    pub fn cameras_text(&self) -> String {
        let (name, _, parameters) = model(&self.camera);
        let (width, height) = (self.camera.width, self.camera.height);
        format!(
            "# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n{CAMERA_ID} {name} {width} {height} {}\n",
            spaced(parameters)
        )
    }

    /// `images.txt`: two lines per image, the second (2D points) empty.
    pub fn images_text(&self) -> String {
        let mut text =
            "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n# POINTS2D[] as (X, Y, POINT3D_ID)\n".to_owned();
        for (place, (name, world_from_camera)) in self.images.iter().enumerate() {
            let (rotation, translation) = pose(world_from_camera);
            let numbers = spaced(rotation.into_iter().chain(translation.to_array()));
            // Writing to a string cannot fail.
            let _ = writeln!(text, "{} {numbers} {CAMERA_ID} {name}\n", place + 1);
        }
        text
    }

    /// `points3D.txt`; the error of a point is 0, its track empty.
    pub fn points_text(&self) -> String {
        let mut text = "# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)\n".to_owned();
        for (place, ColoredPoint { position, color: [r, g, b] }) in self.points.iter().enumerate() {
            let _ = writeln!(text, "{} {} {r} {g} {b} 0", place + 1, spaced(position.to_array()));
        }
        text
    }

    /// `cameras.bin`.
    pub fn cameras_binary(&self) -> Vec<u8> {
        let (_, number, parameters) = model(&self.camera);
        let mut bytes = 1u64.to_le_bytes().to_vec();
        bytes.extend(CAMERA_ID.to_le_bytes());
        bytes.extend(number.to_le_bytes());
        bytes.extend(u64::from(self.camera.width).to_le_bytes());
        bytes.extend(u64::from(self.camera.height).to_le_bytes());
        parameters.iter().for_each(|v| bytes.extend(v.to_le_bytes()));
        bytes
    }

    /// `images.bin`.
    pub fn images_binary(&self) -> Vec<u8> {
        let mut bytes = (self.images.len() as u64).to_le_bytes().to_vec();
        for (place, (name, world_from_camera)) in self.images.iter().enumerate() {
            let (rotation, translation) = pose(world_from_camera);
            bytes.extend((place as u32 + 1).to_le_bytes());
            rotation.into_iter().chain(translation.to_array()).for_each(|v| bytes.extend(v.to_le_bytes()));
            bytes.extend(CAMERA_ID.to_le_bytes());
            bytes.extend(name.as_bytes());
            bytes.push(0);
            bytes.extend(0u64.to_le_bytes());
        }
        bytes
    }

    /// `points3D.bin`.
    pub fn points_binary(&self) -> Vec<u8> {
        let mut bytes = (self.points.len() as u64).to_le_bytes().to_vec();
        for (place, ColoredPoint { position, color }) in self.points.iter().enumerate() {
            bytes.extend((place as u64 + 1).to_le_bytes());
            position.to_array().iter().for_each(|v| bytes.extend(v.to_le_bytes()));
            bytes.extend(color);
            bytes.extend(0f64.to_le_bytes());
            bytes.extend(0u64.to_le_bytes());
        }
        bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::camera::world_from_camera_looking;

    fn small() -> ColmapModel {
        let looking = world_from_camera_looking(DVec3::new(1.0, 2.0, 3.0), DVec3::new(0.0, 1.0, 0.0), DVec3::Z);
        ColmapModel {
            camera: Camera { fl_y: 41.0, ..Camera::pinhole(64, 48, 1.5) },
            images: vec![("000000.png".into(), DAffine3::IDENTITY), ("000001.png".into(), looking)],
            points: vec![ColoredPoint { position: DVec3::new(0.5, -1.0, 1e-3), color: [200, 90, 80] }],
        }
    }

    #[test]
    fn lines_are_those_of_the_format() {
        let model = small();
        assert!(model.cameras_text().ends_with(&format!("\n1 PINHOLE 64 48 {} 41 32 24\n", model.camera.fl_x)));
        let images: Vec<String> = model.images_text().lines().skip(2).map(str::to_owned).collect();
        assert_eq!(images[..2], ["1 1 0 0 0 0 0 0 1 000000.png", ""]);
        assert_eq!(images.len(), 4);
        assert!(model.points_text().ends_with("\n1 0.5 -1 0.001 200 90 80 0\n"));
        let fisheye = Camera { fisheye: Some([0.1, 0.2, 0.3, 0.4]), ..model.camera };
        assert!(ColmapModel { camera: fisheye, ..model }.cameras_text().contains("OPENCV_FISHEYE 64 48 "));
    }

    /// Rotation by the quaternion as COLMAP's documentation has it: a point's camera coordinates are R(q) X + t.
    #[test]
    fn rotation_and_translation_map_the_world_into_the_camera() {
        let (_, world_from_camera) = small().images[1].clone();
        let ([w, x, y, z], t) = pose(&world_from_camera);
        let rows = [
            DVec3::new(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (z * x + w * y)),
            DVec3::new(2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
            DVec3::new(2.0 * (z * x - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
        ];
        let point = DVec3::new(3.0, 10.0, 4.0);
        let seen = DVec3::from_array(rows.map(|row| row.dot(point))) + t;
        assert!(seen.distance(world_from_camera.inverse().transform_point3(point)) < 1e-12);
        assert!(seen.z > 0.0 && w >= 0.0);
    }

    #[test]
    fn binary_records_have_their_lengths() {
        let model = small();
        assert_eq!(model.cameras_binary().len(), 8 + 4 + 4 + 16 + 4 * 8);
        assert_eq!(model.images_binary().len(), 8 + 2 * (4 + 7 * 8 + 4 + 11 + 8));
        assert_eq!(model.points_binary().len(), 8 + 8 + 24 + 3 + 8 + 8);
    }
}
