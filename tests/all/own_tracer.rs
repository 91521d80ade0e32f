//! A renderer of films that shares nothing with the one it checks: every ray against every triangle in f64, the lens by
//! the formula of OpenCV's documentation, light by the closed form of a lamp at the camera over a dark Lambert wall.

use glam::{DAffine3, DVec3};
use rayon::prelude::*;
use respire_bench::base::Camera;

/// A triangle mesh at one moment with its area-weighted vertex normals.
pub struct Wall<'a> {
    pub vertices: Vec<DVec3>,
    pub faces: &'a [[u32; 3]],
    normals: Vec<DVec3>,
}

/// Where a ray meets the wall.
#[derive(Clone, Copy)]
pub struct Met {
    pub face: usize,
    /// Of the face's corners.
    pub weights: [f64; 3],
    pub distance_mm: f64,
}

/// OpenCV's fisheye model, from its documentation: theta_d = theta (1 + k1 theta^2 + ... + k4 theta^8), x' = theta_d x / r;
/// or a pinhole. Unit direction through the image point, theta by bisection.
pub fn direction(camera: &Camera, u: f64, v: f64) -> DVec3 {
    let (x, y) = ((u - camera.cx) / camera.fl_x, (v - camera.cy) / camera.fl_y);
    let Some(k) = camera.fisheye else { return DVec3::new(x, y, 1.0).normalize() };
    let theta_d = |theta: f64| {
        let mut sum = theta;
        for (power, k) in [3, 5, 7, 9].into_iter().zip(k) {
            sum += k * theta.powi(power);
        }
        sum
    };
    let wanted = (x * x + y * y).sqrt();
    let (mut low, mut high) = (0.0, 0.6 * std::f64::consts::PI);
    for _ in 0..80 {
        let middle = 0.5 * (low + high);
        if theta_d(middle) < wanted { low = middle } else { high = middle }
    }
    if wanted < 1e-14 {
        return DVec3::Z;
    }
    DVec3::new(low.sin() * x / wanted, low.sin() * y / wanted, low.cos())
}

/// Where the image of a point in camera axes lies, by the same formula.
pub fn image_point(camera: &Camera, point: DVec3) -> (f64, f64) {
    let (a, b) = (point.x / point.z, point.y / point.z);
    let r = (a * a + b * b).sqrt();
    let scale = match camera.fisheye {
        Some(k) if r > 0.0 => {
            let theta = if point.z > 0.0 { r.atan() } else { std::f64::consts::PI - r.atan() };
            let t2 = theta * theta;
            theta * (1.0 + k[0] * t2 + k[1] * t2.powi(2) + k[2] * t2.powi(3) + k[3] * t2.powi(4)) / r
        }
        _ => 1.0,
    };
    (camera.fl_x * a * scale + camera.cx, camera.fl_y * b * scale + camera.cy)
}

impl<'a> Wall<'a> {
    pub fn new(vertices: Vec<DVec3>, faces: &'a [[u32; 3]]) -> Self {
        let mut normals = vec![DVec3::ZERO; vertices.len()];
        for face in faces {
            let [a, b, c] = face.map(|v| vertices[v as usize]);
            face.iter().for_each(|&v| normals[v as usize] += (b - a).cross(c - a));
        }
        Wall { vertices, faces, normals }
    }

    /// The shape that is `phase` of the way from one mesh's vertices to another's.
    pub fn between(rest: &[DVec3], other: &[DVec3], phase: f64, faces: &'a [[u32; 3]]) -> Self {
        Wall::new(rest.iter().zip(other).map(|(a, b)| *a * (1.0 - phase) + *b * phase).collect(), faces)
    }

    /// Möller and Trumbore's intersection with all triangles; the nearest one.
    pub fn meet(&self, origin: DVec3, direction: DVec3) -> Option<Met> {
        let mut nearest: Option<Met> = None;
        for (face, corners) in self.faces.iter().enumerate() {
            let a = self.vertices[corners[0] as usize];
            let (e1, e2) = (self.vertices[corners[1] as usize] - a, self.vertices[corners[2] as usize] - a);
            let p = direction.cross(e2);
            let determinant = e1.dot(p);
            if determinant.abs() < 1e-14 {
                continue;
            }
            let s = origin - a;
            let u = s.dot(p) / determinant;
            if !(0.0..=1.0).contains(&u) {
                continue;
            }
            let q = s.cross(e1);
            let v = direction.dot(q) / determinant;
            let t = e2.dot(q) / determinant;
            if v >= 0.0 && u + v <= 1.0 && t > 0.0 && nearest.is_none_or(|n| t < n.distance_mm) {
                nearest = Some(Met { face, weights: [1.0 - u - v, u, v], distance_mm: t });
            }
        }
        nearest
    }

    /// The point of some shape of the same faces.
    pub fn point(&self, met: Met) -> DVec3 {
        let corners = self.faces[met.face].map(|v| self.vertices[v as usize]);
        (0..3).map(|k| corners[k] * met.weights[k]).sum()
    }

    pub fn face_normal(&self, met: Met) -> DVec3 {
        let [a, b, c] = self.faces[met.face].map(|v| self.vertices[v as usize]);
        (b - a).cross(c - a).normalize()
    }

    /// Radiance over (albedo x intensity / pi) of what `direction` (camera axes) sees by the light of a lamp at the camera
    /// that falls with `exponent` of the cosine to its axis: no light by way of other walls.
    pub fn lit(&self, pose: &DAffine3, direction: DVec3, exponent: f64) -> f64 {
        let ray = pose.matrix3 * direction;
        let Some(met) = self.meet(pose.translation, ray) else { return 0.0 };
        let corners = self.faces[met.face];
        let smooth: DVec3 = (0..3).map(|k| self.normals[corners[k] as usize].normalize() * met.weights[k]).sum();
        let cosine = -smooth.normalize().dot(ray);
        if cosine <= 0.0 {
            return 0.0;
        }
        direction.z.max(0.0).powf(exponent) * cosine / met.distance_mm.powi(2)
    }

    /// Means of [`Wall::lit`] over `side` x `side` points of every pixel.
    pub fn picture(&self, camera: &Camera, pose: &DAffine3, exponent: f64, side: u32) -> Vec<f64> {
        let pixel = |p: u32| {
            let (x, y) = (f64::from(p % camera.width), f64::from(p / camera.width));
            let at = |i: u32| (f64::from(i) + 0.5) / f64::from(side);
            let mut sum = 0.0;
            for (i, j) in (0..side * side).map(|k| (k % side, k / side)) {
                sum += self.lit(pose, direction(camera, x + at(i), y + at(j)), exponent);
            }
            sum / f64::from(side * side)
        };
        (0..camera.width * camera.height).into_par_iter().map(pixel).collect()
    }

    /// How often the wall winds around a point: 1 inside a closed wall whose normals point inwards, 0 outside. Solid angles
    /// by Van Oosterom and Strackee (1983).
    pub fn winding(&self, point: DVec3) -> f64 {
        let angle = |face: &[u32; 3]| {
            let [a, b, c] = face.map(|v| self.vertices[v as usize] - point);
            let (la, lb, lc) = (a.length(), b.length(), c.length());
            let below = la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb;
            2.0 * a.dot(b.cross(c)).atan2(below)
        };
        -self.faces.iter().map(angle).sum::<f64>() / (4.0 * std::f64::consts::PI)
    }
}

/// A dark Lambert wall: light by way of other walls is less than half a percent of what it sends.
pub fn dark_wall() -> toml::Table {
    toml::from_str("kind = \"lambert\"\nalbedo = [0.002, 0.0015, 0.001]").unwrap()
}

/// Albedo of [`dark_wall`].
pub const DARK: [f64; 3] = [0.002, 0.0015, 0.001];

/// Root of the mean squared difference over that of the values, and the ratio of the means.
pub fn differs(found: &[f64], expected: &[f64]) -> (f64, f64) {
    let square: f64 = found.iter().zip(expected).map(|(a, b)| (a - b).powi(2)).sum();
    let norm: f64 = expected.iter().map(|b| b * b).sum();
    ((square / norm).sqrt(), found.iter().sum::<f64>() / expected.iter().sum::<f64>())
}

#[test]
fn the_wall_winds_once_around_what_is_inside_and_rays_meet_it_where_they_must() {
    // A tetrahedron, normals inwards.
    let corner = |x: f64, y: f64, z: f64| DVec3::new(x, y, z);
    let vertices = vec![corner(0.0, 0.0, 0.0), corner(1.0, 0.0, 0.0), corner(0.0, 1.0, 0.0), corner(0.0, 0.0, 1.0)];
    let faces = [[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]];
    let wall = Wall::new(vertices, &faces);
    assert!((wall.winding(DVec3::splat(0.2)) - 1.0).abs() < 1e-12);
    assert!(wall.winding(DVec3::splat(0.5)).abs() < 1e-12);
    let met = wall.meet(DVec3::splat(0.1), DVec3::splat(1.0).normalize()).unwrap();
    assert!(met.face == 3 && (met.distance_mm - (1.0 / 3.0 - 0.1) * 3f64.sqrt()).abs() < 1e-12);
    assert!(wall.face_normal(met).dot(DVec3::ONE) < 0.0);
}

#[test]
fn the_lens_is_opencvs() {
    let camera = Camera {
        width: 200,
        height: 100,
        fl_x: 80.5,
        fl_y: 79.25,
        cx: 100.25,
        cy: 51.5,
        fisheye: Some([-0.031, 0.012, -0.004, 0.0007]),
    };
    // cv2.fisheye.projectPoints of OpenCV 5.0.0.
    for (point, (x, y)) in [
        ([0.3, -0.2, 1.0], (123.346030513425, 36.341735667173)),
        ([2.0, 1.0, 1.5], (169.278370726978, 85.478250808155)),
    ] {
        let point = DVec3::from_array(point);
        let found = image_point(&camera, point);
        assert!((found.0 - x).hypot(found.1 - y) < 1e-9, "{found:?}");
        assert!(direction(&camera, x, y).distance(point.normalize()) < 1e-9);
        assert!(camera.direction(glam::DVec2::new(x, y)).normalize().distance(point.normalize()) < 1e-9);
    }
}
