//! Faces and points that may be visible in a frame: inside the frustum with a margin, near enough and, if requested,
//! facing the camera. Occlusion is not tested (nor is it in the released BridgeSplat).

use glam::{Affine3, Vec3};
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
    let frustum = Frustum::new(view, reach);
    let eye = view.camera_from_world.inverse().translation.as_vec3();
    let sees = |corners: [Vec3; 3]| {
        let [a, b, c] = corners;
        let centre = (a + b + c) / 3.0;
        let size = (b - a).length().max((c - a).length());
        let normal = (b - a).cross(c - a);
        // A face seen edge-on may turn towards the camera while breathing: slack of 0.1 on the cosine.
        let towards =
            sides == Sides::Both || normal.dot(eye - centre) > -0.1 * normal.length() * (eye - centre).length();
        towards && frustum.may_show(centre, size)
    };
    indices_where(faces.len(), |f| states.iter().any(|v| sees(faces[f].map(|i| Vec3::from(v[i as usize])))))
}

/// Points that may be visible from `view` in any of the `states` of their places, ascending. `sizes_mm`: how far across
/// each is.
pub fn visible_points(states: &[&[[f32; 3]]], sizes_mm: &[f32], view: &View, reach: Reach) -> Vec<u32> {
    let frustum = Frustum::new(view, reach);
    indices_where(sizes_mm.len(), |k| states.iter().any(|at| frustum.may_show(Vec3::from(at[k]), sizes_mm[k])))
}

/// What a view may show.
struct Frustum<'a> {
    view: &'a View,
    camera_from_world: Affine3,
    margin_px: f32,
    range_mm: f32,
}

impl<'a> Frustum<'a> {
    fn new(view: &'a View, reach: Reach) -> Self {
        let margin_px = (reach.margin * view.camera.width as f64) as f32;
        let camera_from_world = view.camera_from_world.as_affine3();
        Frustum { view, camera_from_world, margin_px, range_mm: reach.range_mm as f32 }
    }

    /// Whether the image, with its margin, may show something around `centre` that is `size` mm across.
    fn may_show(&self, centre: Vec3, size: f32) -> bool {
        let camera = &self.view.camera;
        let (width, height) = (camera.width as f32, camera.height as f32);
        let p = self.camera_from_world.transform_point3(centre);
        // What the size in the picture goes by: the depth behind a pinhole; in a fisheye the distance, as what is near the
        // edge of its picture is before the camera by hardly anything, however far away.
        let away = if camera.fisheye.is_some() { p.length() } else { p.z };
        if p.z <= 0.0 || p.z > self.range_mm || away < 0.5 * size {
            return false;
        }
        let Some(pixel) = camera.project(p.as_dvec3()) else { return false };
        // The extent beyond the margin, limited: beside the camera the linearised projection of a Gaussian would cover
        // the whole image.
        let slack = self.margin_px + (size / away * camera.fl_x as f32).min(0.15 * width);
        let (x, y) = (pixel.x as f32, pixel.y as f32);
        x > -slack && y > -slack && x < width + slack && y < height + slack
    }
}

fn indices_where(count: usize, holds: impl Fn(usize) -> bool + Sync + Send) -> Vec<u32> {
    let flags: Vec<bool> = (0..count).into_par_iter().with_min_len(1024).map(holds).collect();
    (0..count as u32).filter(|&k| flags[k as usize]).collect()
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
    fn a_point_is_where_it_lies_in_any_state_and_as_large_as_it_is() {
        let camera = Camera { width: 32, height: 32, fl_x: 16.0, fl_y: 16.0, cx: 16.0, cy: 16.0, fisheye: None };
        let view = View::new(camera, DAffine3::IDENTITY);
        let reach = Reach { margin: 0.0, range_mm: 150.0 };
        // In view; beside it; behind the camera; beyond the range; beside it, but large enough to reach into it.
        let places = [[0.0, 0.0, 8.0], [9.5, 0.0, 8.0], [0.0, 0.0, -8.0], [0.0, 0.0, 151.0], [9.5, 0.0, 8.0]];
        let sizes_mm = [0.1, 0.1, 0.1, 0.1, 2.0];
        assert_eq!(visible_points(&[&places], &sizes_mm, &view, reach), [0, 4]);
        let later = places.map(|[x, y, z]: [f32; 3]| [x - 9.5, y, z]);
        assert_eq!(visible_points(&[&places, &later], &sizes_mm, &view, reach), [0, 1, 4]);
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
