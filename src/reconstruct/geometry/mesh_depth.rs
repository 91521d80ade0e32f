//! Depth of the mesh itself, by a z-buffer over the faces in view, exact for pinhole and fisheye. Rendered discs
//! would only blur it. It also finds faces hidden behind a wall, which need not be drawn.
//!
//! With corners `a`, `b`, `c` in camera axes and the ray `r` of a pixel, `r . (b x c)`, `r . (c x a)` and
//! `r . (a x b)` have the same sign if the ray meets the face; the intersection is `a . (b x c) / sum * r`.

use glam::{DVec2, Vec3};
use rayon::prelude::*;

use crate::base::{Camera, Image};
use crate::splat::View;

/// What is nearer than this to the plane of the camera, mm of z-depth, is cut off.
const NEAR_MM: f32 = 0.05;
/// A ray meets a face in single precision, so that it may pass it by this much, pixels.
const ROUNDING_PX: f64 = 0.01;
/// Rows that one thread fills at a time.
const BAND: usize = 16;
/// A face is hidden if all its corners lie behind the farthest wall next to their pixels by more than this share
/// of that depth plus this many mm.
const SLACK: [f32; 2] = [0.05, 1.0];
/// Largest difference of depth that counts, as a share of the given depth.
const LARGEST_SHARE: f32 = 0.25;

/// The ray of each pixel of a camera, scaled to z = 1.
pub struct PixelRays {
    width: usize,
    rays: Vec<Vec3>,
}

impl PixelRays {
    /// The rays through the pixel centres of `camera`; rays that point sideways or backwards are zero and hit nothing.
    pub fn new(camera: &Camera) -> PixelRays {
        let width = camera.width as usize;
        let ray = |i: usize| {
            let direction = camera.direction(DVec2::new((i % width) as f64 + 0.5, (i / width) as f64 + 0.5));
            if direction.z > 1e-3 { (direction / direction.z).as_vec3() } else { Vec3::ZERO }
        };
        PixelRays { width, rays: (0..width * camera.height as usize).map(ray).collect() }
    }
}

impl PixelRays {
    /// One ray per pixel, row-major.
    pub fn rays(&self) -> &[Vec3] {
        &self.rays
    }
}

/// A face in camera axes (cross products and volume as at the head of this file), and the rectangle it covers.
struct Triangle {
    sides: [Vec3; 3],
    volume: f32,
    columns: [usize; 2],
    rows: [usize; 2],
}

fn on_screen(camera: &Camera, [a, b, c]: [Vec3; 3]) -> Option<Triangle> {
    let (mut low, mut high) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
    for (p, next) in [(a, b), (b, c), (c, a)] {
        // The part before the camera: corners, and where an edge passes the near plane.
        let before = p.z >= NEAR_MM;
        let cut = (before != (next.z >= NEAR_MM)).then(|| p.lerp(next, (NEAR_MM - p.z) / (next.z - p.z)));
        for point in before.then_some(p).into_iter().chain(cut) {
            let pixel = camera.project(point.as_dvec3())?;
            (low, high) = (low.min(pixel), high.max(pixel));
        }
    }
    if low.x > high.x {
        return None;
    }
    // A lens bends edges outwards.
    let bulge = if camera.fisheye.is_some() { 0.1 * (high - low).max_element() } else { 0.0 };
    let (low, high) = (low - bulge, high + bulge);
    let last = DVec2::new(camera.width as f64 - 1.0, camera.height as f64 - 1.0);
    // The pixels whose centres lie in the rectangle; most faces of a far wall have none.
    let low = (low - 0.5 - ROUNDING_PX).ceil().max(DVec2::ZERO);
    let high = (high - 0.5 + ROUNDING_PX).floor().min(last);
    low.cmple(high).all().then(|| Triangle {
        sides: [b.cross(c), c.cross(a), a.cross(b)],
        volume: a.dot(b.cross(c)),
        columns: [low.x as usize, high.x as usize],
        rows: [low.y as usize, high.y as usize],
    })
}

/// Draws `triangle` into `band`, the rows from `first` on, where it is nearer than the stored depth.
fn fill(band: &mut [(f32, u32)], rays: &PixelRays, first: usize, face: u32, triangle: &Triangle) {
    let last = first + band.len() / rays.width - 1;
    for y in triangle.rows[0].max(first)..=triangle.rows[1].min(last) {
        let columns = triangle.columns[0]..=triangle.columns[1];
        let row = &rays.rays[y * rays.width..][..rays.width];
        let near = &mut band[(y - first) * rays.width..][..rays.width];
        for (near, ray) in near[columns.clone()].iter_mut().zip(&row[columns]) {
            let [u, v, w] = triangle.sides.map(|side| side.dot(*ray));
            if (u >= 0.0 && v >= 0.0 && w >= 0.0) || (u <= 0.0 && v <= 0.0 && w <= 0.0) {
                let depth = triangle.volume / (u + v + w);
                if depth >= NEAR_MM && depth < near.0 {
                    *near = (depth, face);
                }
            }
        }
    }
}

/// The faces whose lumen side is before the camera of `view` and within `range_mm` of z-depth in at least one of `states`,
/// ascending. Unlike discs, faces beside the camera are drawn as they are: none is left out for being near.
pub fn faces_before(view: &View, states: &[&[[f32; 3]]], faces: &[[u32; 3]], range_mm: f32) -> Vec<u32> {
    let camera_from_world = view.camera_from_world.as_affine3();
    let seen = |corners: [Vec3; 3]| {
        let [a, b, c] = corners.map(|corner| camera_from_world.transform_point3(corner));
        let towards = (b - a).cross(c - a).dot(a) < 0.0;
        towards && a.z.max(b.z).max(c.z) > 0.0 && a.z.min(b.z).min(c.z) < range_mm
    };
    let before = |face: &u32| {
        let corners = faces[*face as usize];
        states.iter().any(|state| seen(corners.map(|v| Vec3::from(state[v as usize]))))
    };
    (0..faces.len() as u32).into_par_iter().with_min_len(1024).filter(before).collect()
}

/// z-depth in mm of the nearest of the faces `which` at each pixel of `view`, whose rays are `rays`; 0 where
/// there is none.
pub fn nearest_depth_mm(
    view: &View,
    rays: &PixelRays,
    vertices: &[[f32; 3]],
    faces: &[[u32; 3]],
    which: &[u32],
) -> Image<f32> {
    let nearest = nearest_faces(view, rays, vertices, faces, which);
    let data = nearest.into_iter().map(|(depth, _)| depth).collect();
    Image { width: rays.width, height: view.camera.height as usize, channels: 1, data }
}

/// z-depth in mm of the mesh at each pixel of `view`, whose rays are `rays`, by all faces before the camera within
/// `range_mm`; 0 where there is none.
pub fn surface_depth_mm(
    view: &View,
    rays: &PixelRays,
    vertices: &[[f32; 3]],
    faces: &[[u32; 3]],
    range_mm: f64,
) -> Image<f32> {
    let before = faces_before(view, &[vertices], faces, range_mm as f32);
    nearest_depth_mm(view, rays, vertices, faces, &before)
}

/// z-depth in mm of the nearest of the faces `which` at each pixel of `view`, and its index; depth 0 where
/// there is none.
pub fn nearest_faces(
    view: &View,
    rays: &PixelRays,
    vertices: &[[f32; 3]],
    faces: &[[u32; 3]],
    which: &[u32],
) -> Vec<(f32, u32)> {
    let camera_from_world = view.camera_from_world.as_affine3();
    let corner = |v: u32| camera_from_world.transform_point3(Vec3::from(vertices[v as usize]));
    let triangle = |f: &u32| Some((*f, on_screen(&view.camera, faces[*f as usize].map(corner))?));
    let triangles: Vec<(u32, Triangle)> = which.par_iter().with_min_len(512).filter_map(triangle).collect();
    let mut nearest = vec![(f32::INFINITY, 0); rays.rays.len()];
    nearest.par_chunks_mut(rays.width * BAND).enumerate().for_each(|(band, near)| {
        let first = band * BAND;
        let here = triangles.iter().filter(|(_, t)| t.rows[0] < first + BAND && t.rows[1] >= first);
        here.for_each(|(face, t)| fill(near, rays, first, *face, t));
        near.iter_mut().filter(|v| v.0.is_infinite()).for_each(|v| v.0 = 0.0);
    });
    nearest
}

/// Mean absolute difference in mm between rendered and given depth where both exist; infinite if they nowhere do.
/// Differences beyond [`LARGEST_SHARE`] of the given depth count as that share, so that edges and holes do not
/// dominate.
pub fn depth_gap_mm(rendered: &Image<f32>, given: &Image<f32>) -> f64 {
    let both = rendered.data.iter().zip(&given.data).filter(|(d, t)| **d > 0.0 && **t > 0.0);
    let (sum, count) = both
        .fold((0.0, 0usize), |(sum, count), (&d, &t)| (sum + (d - t).abs().min(LARGEST_SHARE * t) as f64, count + 1));
    if count == 0 { f64::INFINITY } else { sum / count as f64 }
}

/// The faces of `which` that no nearer wall hides, judged with some slack.
pub fn unhidden(view: &View, rays: &PixelRays, vertices: &[[f32; 3]], faces: &[[u32; 3]], which: &[u32]) -> Vec<u32> {
    let depth = nearest_depth_mm(view, rays, vertices, faces, which);
    let (width, height) = (depth.width as i64, depth.height as i64);
    let camera_from_world = view.camera_from_world.as_affine3();
    // Farthest wall around a pixel; infinite where there is a hole.
    let farthest = |x: i64, y: i64| {
        let mut far = 0.0f32;
        for (dx, dy) in (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (dx, dy))) {
            let (x, y) = ((x + dx).clamp(0, width - 1), (y + dy).clamp(0, height - 1));
            let d = depth.data[(y * width + x) as usize];
            far = far.max(if d > 0.0 { d } else { f32::INFINITY });
        }
        far
    };
    let unhidden = |p: Vec3| match view.camera.project(p.as_dvec3()) {
        Some(pixel) => {
            let far = farthest((pixel.x as i64).clamp(0, width - 1), (pixel.y as i64).clamp(0, height - 1));
            p.z <= far * (1.0 + SLACK[0]) + SLACK[1]
        }
        None => true,
    };
    let corner = |v: u32| camera_from_world.transform_point3(Vec3::from(vertices[v as usize]));
    let flags: Vec<bool> =
        which.par_iter().with_min_len(512).map(|&f| faces[f as usize].map(corner).into_iter().any(unhidden)).collect();
    which.iter().zip(flags).filter(|(_, unhidden)| *unhidden).map(|(&f, _)| f).collect()
}

#[cfg(test)]
mod tests {
    use glam::{DAffine3, DVec3};

    use super::*;

    const EYE: DVec3 = DVec3::new(2.0, -1.0, 5.0);

    /// Two triangles that fill the view: a slanted one, and a farther one behind it.
    fn scene(fisheye: Option<[f64; 4]>) -> (View, Vec<[f32; 3]>, Vec<[u32; 3]>) {
        let camera = Camera { fisheye, ..Camera::pinhole(40, 30, 1.5) };
        let view = View::new(camera, DAffine3::from_translation(EYE));
        let at = |x: f64, y: f64, z: f64| (EYE + DVec3::new(x, y, z)).as_vec3().to_array();
        let near = [at(-60.0, -50.0, 4.0), at(60.0, -50.0, 16.0), at(0.0, 90.0, 10.0)];
        let far = [at(-99.0, -99.0, 30.0), at(99.0, -99.0, 30.0), at(0.0, 140.0, 30.0)];
        (view, [near, far].concat(), vec![[0, 1, 2], [3, 4, 5]])
    }

    #[test]
    fn depth_is_that_of_the_plane_which_each_ray_meets() {
        for fisheye in [None, Some([0.05, -0.01, 0.002, 0.0])] {
            let (view, vertices, faces) = scene(fisheye);
            let [a, b, c] = [0, 1, 2].map(|i| Vec3::from(vertices[i]).as_dvec3() - EYE);
            let normal = (b - a).cross(c - a);
            let found = nearest_depth_mm(&view, &PixelRays::new(&view.camera), &vertices, &faces, &[0, 1]);
            for (i, &depth) in found.data.iter().enumerate() {
                let pixel = DVec2::new((i % 40) as f64 + 0.5, (i / 40) as f64 + 0.5);
                let ray = view.camera.direction(pixel);
                let expected = normal.dot(a) / normal.dot(ray) * ray.z;
                assert!((depth as f64 - expected).abs() < 1e-3 * expected, "{pixel}: {depth} {expected}");
            }
        }
    }

    #[test]
    fn what_stands_behind_a_wall_is_hidden_and_what_stands_before_it_is_not() {
        let (view, mut vertices, faces) = scene(None);
        let rays = PixelRays::new(&view.camera);
        assert_eq!(unhidden(&view, &rays, &vertices, &faces, &[0, 1]), [0]);
        vertices[3..].iter_mut().for_each(|v| v[2] -= 28.0);
        assert_eq!(unhidden(&view, &rays, &vertices, &faces, &[0, 1]), [1]);
        assert_eq!(unhidden(&view, &rays, &vertices, &faces, &[0]), [0]);
    }
}
