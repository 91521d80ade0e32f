//! Faces that may be visible in a frame: inside the frustum with a margin, near enough and, if requested, facing
//! the camera. Occlusion is not tested (nor is it in the released BridgeSplat).

use glam::Vec3;
use rayon::prelude::*;

use crate::base::Error;
use crate::splat::View;

use crate::reconstruct::settings::Visibility;

/// Bounds of the region whose faces are kept.
#[derive(Clone, Copy, Debug)]
pub struct Reach {
    /// Share of the image width by which a face centre may lie outside.
    pub margin: f64,
    /// Largest z-depth in mm.
    pub range_mm: f64,
}

impl Reach {
    /// The bounds in a method's settings.
    pub fn new(visibility: &Visibility) -> Self {
        Reach { margin: *visibility.margin, range_mm: *visibility.range_mm }
    }
}

/// The error of a method that begins where it sees no part of the airway. Later, and with a phase that is given, a scope
/// that its mesh says is inside the wall has a black picture.
pub fn nothing_in_view() -> Error {
    Error::input("the camera sees no face of the airway mesh: poses and mesh do not belong together")
}

/// Which sides of a face count.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sides {
    /// The side facing the lumen: enough for a camera that stays inside.
    Lumen,
    /// Both: a mesh that deforms freely may leave the camera outside.
    Both,
}

/// Pixels that each face in `of` covers in `view`, by its area, distance and incidence at `vertices`.
pub fn pixel_areas(faces: &[[u32; 3]], of: &[u32], vertices: &[[f32; 3]], view: &View) -> Vec<f32> {
    let eye = view.camera_from_world.inverse().translation.as_vec3();
    let focal_px2 = (view.camera.fl_x * view.camera.fl_y) as f32;
    of.iter()
        .map(|&f| {
            let [a, b, c] = faces[f as usize].map(|i| Vec3::from(vertices[i as usize]));
            let (offset, twice_area) = ((a + b + c) / 3.0 - eye, (b - a).cross(c - a));
            let distance2 = offset.length_squared().max(1e-6);
            0.5 * twice_area.dot(offset).abs() / distance2.sqrt() / distance2 * focal_px2
        })
        .collect()
}

/// Faces that may be visible from `view` in any of the `states` of the vertices, ascending.
pub fn visible_faces(faces: &[[u32; 3]], states: &[&[[f32; 3]]], view: &View, reach: Reach, sides: Sides) -> Vec<u32> {
    let camera_from_world = view.camera_from_world.as_affine3();
    let eye = view.camera_from_world.inverse().translation.as_vec3();
    let margin = (reach.margin * view.camera.width as f64) as f32;
    let (width, height) = (view.camera.width as f32, view.camera.height as f32);
    let sees = |corners: [Vec3; 3]| {
        let [a, b, c] = corners;
        let centre = (a + b + c) / 3.0;
        let size = (b - a).length().max((c - a).length());
        let normal = (b - a).cross(c - a);
        // A face seen edge-on may turn towards the camera while breathing: slack of 0.1 on the cosine.
        let towards =
            sides == Sides::Both || normal.dot(eye - centre) > -0.1 * normal.length() * (eye - centre).length();
        let p = camera_from_world.transform_point3(centre);
        // What the face's size in the picture goes by: the depth behind a pinhole; in a fisheye the distance, as a
        // face near the edge of its picture is before the camera by hardly anything, however far away.
        let away = if view.camera.fisheye.is_some() { p.length() } else { p.z };
        if !towards || p.z <= 0.0 || p.z > reach.range_mm as f32 || away < 0.5 * size {
            return false;
        }
        let Some(pixel) = view.camera.project(p.as_dvec3()) else { return false };
        // The extent of a face beyond the margin, limited: beside the camera the linearised projection of a Gaussian
        // would cover the whole image.
        let slack = margin + (size / away * view.camera.fl_x as f32).min(0.15 * width);
        let (x, y) = (pixel.x as f32, pixel.y as f32);
        x > -slack && y > -slack && x < width + slack && y < height + slack
    };
    let flags: Vec<bool> = faces
        .par_iter()
        .with_min_len(1024)
        .map(|face| states.iter().any(|v| sees(face.map(|i| Vec3::from(v[i as usize])))))
        .collect();
    (0..faces.len() as u32).filter(|&f| flags[f as usize]).collect()
}

/// The pixel onto which each of the `centres` projects; `None` outside the image and within 0.2 mm of the camera.
pub fn pixels(view: &View, centres: &[[f32; 3]]) -> Vec<Option<[usize; 2]>> {
    let (width, height) = (view.camera.width as f64, view.camera.height as f64);
    in_camera(view, centres)
        .par_iter()
        .with_min_len(1024)
        .map(|p| {
            let pixel = view.camera.project(p.as_dvec3())?;
            let inside = p.z > 0.2 && pixel.x >= 0.0 && pixel.y >= 0.0 && pixel.x < width && pixel.y < height;
            inside.then_some([pixel.x as usize, pixel.y as usize])
        })
        .collect()
}

/// z-depth in mm of each of the `centres`.
pub fn depths_mm(view: &View, centres: &[[f32; 3]]) -> Vec<f32> {
    in_camera(view, centres).iter().map(|p| p.z).collect()
}

fn in_camera(view: &View, centres: &[[f32; 3]]) -> Vec<Vec3> {
    let transform = view.camera_from_world.as_affine3();
    centres.par_iter().with_min_len(4096).map(|p| transform.transform_point3(Vec3::from(*p))).collect()
}

#[cfg(test)]
mod tests {
    use glam::{DAffine3, DVec2};

    use super::*;
    use crate::base::Camera;

    /// A face of 2 mm that faces the camera, 8 mm away in the direction of a pixel.
    fn sees(camera: Camera, pixel: DVec2) -> bool {
        let view = View::new(camera, DAffine3::IDENTITY);
        let towards = camera.direction(pixel).normalize().as_vec3();
        let (x, y) = towards.any_orthonormal_pair();
        let corners = [-x - y, y * 1.5, x - y].map(|d| (towards * 8.0 + d).into());
        !visible_faces(&[[0, 1, 2]], &[&corners], &view, Reach { margin: 0.0, range_mm: 150.0 }, Sides::Both).is_empty()
    }

    #[test]
    fn a_face_is_seen_in_the_corner_of_a_fisheye_picture() {
        let wide = Camera {
            fl_x: 125.0,
            fl_y: 125.0,
            fisheye: Some([-0.02, 0.0, 0.0, 0.0]),
            ..Camera::pinhole(256, 256, 1.0)
        };
        let corner = wide.direction(DVec2::splat(2.0));
        assert!(corner.z > 0.0 && 8.0 * corner.z < 1.0, "a corner less than a face's half before the camera: {corner}");
        assert!(sees(wide, DVec2::splat(2.0)) && sees(wide, DVec2::splat(128.0)));
        assert!(!sees(wide, DVec2::splat(-60.0)), "nothing behind the camera");
        let pinhole = Camera::pinhole(256, 256, 1.6);
        assert!(sees(pinhole, DVec2::splat(2.0)) && !sees(pinhole, DVec2::splat(-120.0)));
    }
}
