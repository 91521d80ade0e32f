//! The wall near the scope as its lamp shows it, with the derivatives of the picture by pose, phase, lens and lamp.
//!
//! With `Y` the point of the wall at a pixel in camera axes, `n` its normal, `l` the lamp, `v = Y - l`, `d = |v|` and
//! `c = |n . v| / d`, its brightness is that of [`virtual_view`](super::virtual_view), in the power law of an encoded image:
//!
//!   L = (c + k) / (1 + k) / d^2,   R = L^(1 / 2.2)
//!
//! By an unknown that moves the point by `dY` and the lamp by `dl`, the picture changes at a fixed pixel by
//!
//!   dR = R / 2.2 (dc / (c + k) - 2 (v . dv) / d^2) - grad R . J dY,   dv = dY - dl
//!
//! with `J` the derivative of the projection: the shade of the point changes, and another point comes to the pixel. Next
//! to an edge of a nearer wall, that wall's motion counts, since the edge moves with it. Left out: the turn of normals by
//! breathing, shadows, light between walls beyond its constant share `k`.

use glam::{DVec2, DVec3, Vec2, Vec3};
use rayon::prelude::*;

use super::breathing::BreathingMesh;
use super::mesh_depth::{PixelRays, nearest_faces, unhidden};
use super::rigid::POSE;
use super::virtual_view::{INDIRECT, NEAREST_MM, light_of_wall};
use crate::base::Camera;
use crate::base::color::POWER_LAW;
use crate::splat::View;

/// A neighbouring pixel whose wall is nearer than this share of a pixel's depth is an edge that moves over it.
const EDGE: f32 = 0.8;
/// Step of the forward difference of a projection, mm.
const WIDTH_MM: f64 = 1e-3;
/// Faces outside of the image count up to this share of its width.
const MARGIN: f32 = 0.35;
/// A wall that is nearer than this along the axis, mm, is out of focus, clips, and is lit from elsewhere than assumed.
pub const TOUCHING_MM: f32 = 1.5;
/// Rows per task.
const ROWS: usize = 8;

/// Unknowns of a picture: six of the pose (`exp(xi) camera_from_world`), the phase, image centre (as shares of the width)
/// and logarithm of the focal length, and the lamp's place beside the lens (mm, camera axes, right and down).
pub const PICTURE: usize = POSE + 6;
/// Place of the phase among them.
pub const PHASE: usize = POSE;
/// Place of the lens.
pub const LENS: usize = POSE + 1;
/// Place of the lamp.
pub const LAMP: usize = POSE + 4;

/// The part of the wall that is within sight of a place, with its own list of vertices.
pub struct NearWall {
    centre: DVec3,
    faces: Vec<[u32; 3]>,
    rest: Vec<[f32; 3]>,
    displacement: Vec<[f32; 3]>,
}

impl NearWall {
    /// The faces of `mesh` that are within `range_mm` of `place` at inspiration or expiration.
    pub fn around(mesh: BreathingMesh<'_>, place: DVec3, range_mm: f64) -> NearWall {
        let (centre, range2) = (place.as_vec3(), (range_mm * range_mm) as f32);
        let near: Vec<bool> = mesh
            .rest
            .par_iter()
            .zip(mesh.displacement)
            .with_min_len(4096)
            .map(|(rest, moved)| {
                let rest = Vec3::from(*rest);
                let other = rest + Vec3::from(*moved);
                rest.distance_squared(centre).min(other.distance_squared(centre)) < range2
            })
            .collect();
        let kept = mesh.faces.iter().filter(|face| face.iter().any(|&v| near[v as usize]));
        Self::of_faces(mesh, place, kept.copied())
    }

    /// `faces` of `mesh` with the vertices that they need.
    fn of_faces(mesh: BreathingMesh<'_>, centre: DVec3, faces: impl Iterator<Item = [u32; 3]>) -> NearWall {
        let mut place_of = vec![u32::MAX; mesh.rest.len()];
        let mut wall = NearWall { centre, faces: Vec::new(), rest: Vec::new(), displacement: Vec::new() };
        for face in faces {
            let own = face.map(|v| {
                if place_of[v as usize] == u32::MAX {
                    place_of[v as usize] = wall.rest.len() as u32;
                    wall.rest.push(mesh.rest[v as usize]);
                    wall.displacement.push(mesh.displacement[v as usize]);
                }
                place_of[v as usize]
            });
            wall.faces.push(own);
        }
        wall
    }

    fn mesh(&self) -> BreathingMesh<'_> {
        BreathingMesh { rest: &self.rest, displacement: &self.displacement, faces: &self.faces }
    }
}

/// Way of a scope in mm after which the wall around it is gathered anew, for what looks at pictures against it frame by frame.
pub const GATHER_AGAIN_MM: f64 = 6.0;

/// Keeps the part of the airway that is within sight of the scope while the scope stays near.
#[derive(Default)]
pub struct WallInReach(Option<NearWall>);

impl WallInReach {
    /// The wall of `mesh` that is within `range_mm` of `place`, and some more of it: gathered anew where `place` is
    /// `again_mm` from where it was gathered last.
    pub fn around(&mut self, mesh: BreathingMesh<'_>, place: DVec3, range_mm: f64, again_mm: f64) -> &NearWall {
        let near = self.0.take().filter(|wall| wall.centre.distance(place) < again_mm);
        self.0.insert(near.unwrap_or_else(|| NearWall::around(mesh, place, range_mm + again_mm)))
    }

    /// Forgets it: the airway has changed.
    pub fn forget(&mut self) {
        self.0 = None;
    }
}

/// From where and how the wall is seen.
#[derive(Clone, Copy, Debug)]
pub struct LitView {
    /// Camera and pose.
    pub view: View,
    /// Phase of the wall.
    pub phase: f64,
    /// Lamp in camera axes, mm.
    pub lamp_mm: DVec3,
}

/// What is seen.
pub struct LitPicture {
    /// Encoded brightness, without exposure; 0 where there is no wall.
    pub brightness: Vec<f32>,
    /// Share of the pixels whose wall is nearer than [`TOUCHING_MM`].
    pub touching: f32,
    /// Derivatives of the brightness by the unknowns, a plane each; empty where none were asked for.
    pub slopes: Vec<Vec<f32>>,
}

/// A pixel's wall in camera axes.
#[derive(Clone, Copy, Default)]
struct Seen {
    place: Vec3,
    normal: Vec3,
    /// Motion per unit of phase.
    motion: Vec3,
    brightness: f32,
}

/// `wall` as seen from `lit`, and with `with_slopes` the derivatives.
pub fn lit_picture(wall: &NearWall, lit: &LitView, with_slopes: bool) -> LitPicture {
    let LitView { view, phase, lamp_mm } = *lit;
    let (width, height) = (view.camera.width as usize, view.camera.height as usize);
    let rays = PixelRays::new(&view.camera);
    let vertices = wall.mesh().at(phase);
    let from = view.camera_from_world.as_affine3();
    let in_camera: Vec<Vec3> =
        vertices.par_iter().with_min_len(4096).map(|v| from.transform_point3(Vec3::from(*v))).collect();
    let which = towards(&in_camera, &wall.faces, &view.camera);
    let nearest = nearest_faces(&view, &rays, &vertices, &wall.faces, &which);
    let lamp = lamp_mm.as_vec3();
    let seen: Vec<Seen> = nearest
        .par_iter()
        .zip(rays.rays())
        .with_min_len(1024)
        .map(|(&(depth, face), ray)| {
            if depth <= 0.0 {
                return Seen::default();
            }
            let corners = wall.faces[face as usize];
            let [a, b, c] = corners.map(|v| in_camera[v as usize]);
            let place = depth * *ray;
            let normal = (b - a).cross(c - a).normalize_or_zero();
            let motion = corners.map(|v| Vec3::from(wall.displacement[v as usize])).into_iter().sum::<Vec3>() / 3.0;
            let (cosine, distance) = incidence(place - lamp, normal);
            let brightness = light_of_wall(cosine, distance).powf(1.0 / POWER_LAW);
            Seen { place, normal, motion: from.transform_vector3(motion), brightness }
        })
        .collect();
    let shown: Vec<f32> = seen.iter().map(|s| s.brightness).collect();
    let mut picture = LitPicture {
        brightness: smoothed(&shown, width),
        touching: nearest.iter().filter(|n| n.0 > 0.0 && n.0 < TOUCHING_MM).count() as f32
            / nearest.len().max(1) as f32,
        slopes: Vec::new(),
    };
    if !with_slopes {
        return picture;
    }
    let mut rows: Vec<[f32; PICTURE]> = vec![[0.0; PICTURE]; width * height];
    rows.par_chunks_mut(width * ROWS).enumerate().for_each(|(chunk, rows)| {
        for (k, out) in rows.iter_mut().enumerate() {
            let at = chunk * width * ROWS + k;
            let (x, y) = (at % width, at / width);
            if x == 0 || y == 0 || x + 1 == width || y + 1 == height {
                continue;
            }
            let slope = Vec2::new(shown[at + 1] - shown[at - 1], shown[at + width] - shown[at - width]) * 0.5;
            // The nearest wall of the neighbourhood, if it is an edge before this pixel's.
            let mut mover = at;
            let [above, below] = [at - width, at + width];
            for other in [above - 1, above, above + 1, at - 1, at + 1, below - 1, below, below + 1] {
                let (near, own) = (nearest[other].0, nearest[mover].0);
                if near > 0.0 && (own <= 0.0 || near < EDGE * own) {
                    mover = other;
                }
            }
            *out = slopes_at(&seen[at], &seen[mover], slope, &view.camera, lamp);
        }
    });
    picture.slopes = (0..PICTURE).map(|k| smoothed(&rows.iter().map(|r| r[k]).collect::<Vec<_>>(), width)).collect();
    picture
}

/// `c` and `d` of the module's formula.
fn incidence(from_lamp: Vec3, normal: Vec3) -> (f32, f32) {
    let distance = from_lamp.length().max(NEAREST_MM);
    ((normal.dot(from_lamp) / distance).abs(), distance)
}

/// The derivatives at one pixel that shows `own`; edges move with `mover`. `slope` is the picture's, per pixel.
fn slopes_at(own: &Seen, mover: &Seen, slope: Vec2, camera: &Camera, lamp: Vec3) -> [f32; PICTURE] {
    let mut out = [0.0; PICTURE];
    // The motion over the image.
    let anchor = if mover.place.z > 0.0 { mover } else { own };
    if anchor.place.z > 0.0
        && let Some(jacobian) = projection(camera, anchor.place.as_dvec3())
    {
        let along = |by: Vec3| slope.dot(jacobian[0] * by.x + jacobian[1] * by.y + jacobian[2] * by.z);
        for (k, axis) in Vec3::AXES.into_iter().enumerate() {
            out[k] -= along(axis.cross(anchor.place));
            out[3 + k] -= along(axis);
        }
        out[PHASE] -= along(anchor.motion);
        let pixel = camera.project(anchor.place.as_dvec3()).unwrap_or(DVec2::new(camera.cx, camera.cy));
        let width = camera.width as f32;
        out[LENS] -= slope.x * width;
        out[LENS + 1] -= slope.y * width;
        out[LENS + 2] -= slope.dot((pixel - DVec2::new(camera.cx, camera.cy)).as_vec2());
    }
    // The change of shade.
    if own.brightness > 0.0 {
        let from_lamp = own.place - lamp;
        let (cosine, distance) = incidence(from_lamp, own.normal);
        let sign = own.normal.dot(from_lamp).signum();
        let shade = |moved: Vec3, turned: Vec3| {
            let stretch = if from_lamp.length() > NEAREST_MM { from_lamp.dot(moved) / distance } else { 0.0 };
            let tilt = sign * (turned.dot(from_lamp) + own.normal.dot(moved)) / distance - cosine * stretch / distance;
            own.brightness / POWER_LAW * (tilt / (cosine + INDIRECT) - 2.0 * stretch / distance)
        };
        for (k, axis) in Vec3::AXES.into_iter().enumerate() {
            out[k] += shade(axis.cross(own.place), axis.cross(own.normal));
            out[3 + k] += shade(axis, Vec3::ZERO);
        }
        out[PHASE] += shade(own.motion, Vec3::ZERO);
        out[LAMP] += shade(-Vec3::X, Vec3::ZERO);
        out[LAMP + 1] += shade(-Vec3::Y, Vec3::ZERO);
    }
    out
}

/// Derivatives of the pixel of `place` by its three coordinates, 1 / mm.
fn projection(camera: &Camera, place: DVec3) -> Option<[Vec2; 3]> {
    if camera.fisheye.is_none() {
        let (x, y, z) = (place.x / place.z, place.y / place.z, place.z);
        let [fx, fy] = [camera.fl_x / z, camera.fl_y / z];
        return Some([DVec2::new(fx, 0.0), DVec2::new(0.0, fy), DVec2::new(-fx * x, -fy * y)].map(|d| d.as_vec2()));
    }
    let pixel = camera.project(place)?;
    let change = |by: DVec3| Some((camera.project(place + WIDTH_MM * by)? - pixel) / WIDTH_MM);
    Some([change(DVec3::X)?, change(DVec3::Y)?, change(DVec3::Z)?].map(|d: DVec2| d.as_vec2()))
}

/// The faces that look at the camera and may lie in its picture, ascending.
fn towards(vertices: &[Vec3], faces: &[[u32; 3]], camera: &Camera) -> Vec<u32> {
    let reach = [
        (camera.width as f32 * (0.5 + MARGIN)) / camera.fl_x as f32,
        (camera.height as f32 * (0.5 + MARGIN)) / camera.fl_y as f32,
    ];
    let seen = |face: &u32| {
        let [a, b, c] = faces[*face as usize].map(|v| vertices[v as usize]);
        let far = a.z.max(b.z).max(c.z);
        if far <= 0.0 || (b - a).cross(c - a).dot(a) >= 0.0 {
            return false;
        }
        // Outside of one side of the picture with all corners.
        let beyond =
            |axis: usize, sign: f32| [a, b, c].iter().all(|p| sign * p[axis] > reach[axis] * p.z.max(0.0) + 0.05);
        camera.fisheye.is_some() || !(beyond(0, 1.0) || beyond(0, -1.0) || beyond(1, 1.0) || beyond(1, -1.0))
    };
    (0..faces.len() as u32).into_par_iter().with_min_len(2048).filter(seen).collect()
}

/// The wall of `wall` that no nearer wall hides from `lit`, with some slack: enough for small changes of pose and phase.
pub fn in_sight(wall: &NearWall, lit: &LitView) -> NearWall {
    let view = lit.view;
    let vertices = wall.mesh().at(lit.phase);
    let from = view.camera_from_world.as_affine3();
    let in_camera: Vec<Vec3> =
        vertices.par_iter().with_min_len(4096).map(|v| from.transform_point3(Vec3::from(*v))).collect();
    let which = towards(&in_camera, &wall.faces, &view.camera);
    let kept = unhidden(&view, &PixelRays::new(&view.camera), &vertices, &wall.faces, &which);
    NearWall::of_faces(wall.mesh(), wall.centre, kept.into_iter().map(|face| wall.faces[face as usize]))
}

/// The plane averaged by 1 2 1 along rows and columns; its rim is kept.
pub fn smoothed(plane: &[f32], width: usize) -> Vec<f32> {
    let mut rows = plane.to_vec();
    for (out, row) in rows.chunks_exact_mut(width).zip(plane.chunks_exact(width)) {
        for x in 1..width - 1 {
            out[x] = 0.25 * (row[x - 1] + 2.0 * row[x] + row[x + 1]);
        }
    }
    let mut out = rows.clone();
    let height = plane.len() / width;
    for y in 1..height.saturating_sub(1) {
        for x in 0..width {
            let at = y * width + x;
            out[at] = 0.25 * (rows[at - width] + 2.0 * rows[at] + rows[at + width]);
        }
    }
    out
}
