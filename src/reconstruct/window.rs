//! The phases of a window of keyframes, by direct alignment of their pictures through the moving mesh. No map is involved,
//! so nothing that was painted in the wrong place can pull a phase along. Windowed photometric bundle adjustment (Engel,
//! Koltun and Cremers, "Direct sparse odometry", 2018) in which poses and shapes are given, and one phase per frame is
//! all that is unknown.
//!
//! A map alone drifts. Where the assumed wall is too wide its picture grows too slowly while the scope advances, and a
//! phase that makes it wider still mends that: an error of the phase grows by a factor of e on a way as long as the wall
//! is distant. Two frames from different places see that the wall is elsewhere (parallax). With the point that a pixel of
//! frame `k` shows at `X_k(a_k) = o + t r`, in barycentric coordinates `b(a_k)` of its face, frame `n` sees it at
//! `X_n = sum b_i v_i(a_n)`; the derivatives of its place in that picture by `a_k` and by `a_n` differ ([`pair`]).
//!
//! Pictures are compared by their local contrast ([`picture`]): what the light does to large areas says nothing. Each frame is
//! placed against all keyframes of the window; a frame that shows enough new wall becomes one, and the oldest leaves, its
//! knowledge marginalised. Of what is known a share is forgotten with each keyframe, since systematic errors (glare,
//! light inside the wall) do not average out. Left out: levels of resolution (the map's track is near enough to start from),
//! and poses that are unknown: with six more unknowns per frame the way along a tube and the phase are one, and both run
//! away (docs/methods.md).

use glam::{DMat3, DVec2, DVec3, Vec3};
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use crate::base::Image;
use crate::splat::View;

use super::level::Level;
use super::mesh_depth::{Rays, nearest_faces};
use super::phase_fit::at_phase;
use super::settings;

/// Most Gauss-Newton steps per frame, the longest of them, and one that ends them.
const STEPS: usize = 4;
const LONGEST_STEP: f64 = 0.05;
const SHORTEST_STEP: f64 = 2e-4;
/// The window works on the finest halving of a picture that is not wider than this many pixels.
const WIDEST: usize = 160;
/// Half width of the square over which a picture is averaged (twice), as a share of its width.
const RADIUS_SHARE: f64 = 3.0 / 128.0;
/// Added to the averaged picture: darker than this has no contrast.
const CONTRAST_FLOOR: f32 = 0.05;
/// One point, that of the steepest contrast, is taken from each square of so many pixels a side.
const CELL_PX: usize = 4;
/// Relative jump of depth that is the edge of a wall: edges move otherwise than walls.
const EDGE: f32 = 0.15;
/// Residuals beyond so many robust standard deviations count linearly, and the least such deviation.
const HUBER: f32 = 2.0;
const SMALLEST_SCALE: f32 = 0.01;
/// Neighbouring points err together: so many values count as one.
const TOGETHER: f64 = 20.0;
/// Pairs with fewer points say nothing.
const FEWEST_POINTS: usize = 30;
/// A point is hidden where it lies so much of the wall's depth, and so many mm, behind the nearest wall, and has left its
/// face where it lies three times that much before it.
const SLACK: f64 = 0.05;
const SLACK_MM: f64 = 0.5;
/// A frame becomes a keyframe after so many frames, or when the points of the last one have moved by this share of the
/// width, or fewer than this share of them are left.
const LONGEST_WAIT: usize = 4;
const LONGEST_FLOW: f64 = 0.06;
const FEWEST_KEPT: f64 = 0.7;
/// Standard deviation of the phase that the given depth of the first frame tells.
const FIRST_DEVIATION: f64 = 0.003;
/// Step over which a projection is differentiated, phase.
const WIDTH: f64 = 1e-3;

/// The airway at every phase.
#[derive(Clone, Copy)]
pub struct Shape<'a> {
    /// Vertices at inspiration, mm.
    pub rest: &'a [[f32; 3]],
    /// Their way to expiration, mm.
    pub displacement: &'a [[f32; 3]],
    /// Corners of the faces.
    pub faces: &'a [[u32; 3]],
}

impl Shape<'_> {
    fn at(&self, phase: f64) -> Vec<[f32; 3]> {
        let mut out = Vec::new();
        at_phase(self.rest, self.displacement, phase as f32, &mut out);
        out
    }

    fn corners(&self, face: [u32; 3], phase: f64) -> [DVec3; 3] {
        face.map(|v| Vec3::from(self.rest[v as usize]).as_dvec3() + phase * self.way(v))
    }

    fn way(&self, v: u32) -> DVec3 {
        Vec3::from(self.displacement[v as usize]).as_dvec3()
    }
}

/// Phase of a frame, and its standard deviation by the window.
#[derive(Clone, Copy, Debug)]
pub struct Placed {
    /// Phase, 0..1.
    pub phase: f64,
    /// Its standard deviation.
    pub deviation: f64,
}

/// The keyframes, and what is known about their phases.
pub struct Window {
    /// Of the pictures' camera, from the first one on.
    rays: Option<Rays>,
    most: usize,
    kept: f64,
    prior_deviation: f64,
    keyframes: Vec<Keyframe>,
    phases: DVector<f64>,
    information: DMatrix<f64>,
    /// Frames since the last keyframe.
    waited: usize,
}

/// A frame whose points are looked for in later ones.
struct Keyframe {
    eye: DVec3,
    points: Vec<Point>,
}

/// A pixel of a keyframe.
struct Point {
    pixel: DVec2,
    /// Its direction in the world, of unit z-depth.
    ray: DVec3,
    /// Corners of the face that it shows.
    face: [u32; 3],
    contrast: [f32; 3],
}

/// What is compared of a picture.
struct Picture {
    contrast: Image<f32>,
    counts: Vec<bool>,
}

/// The later frame of a pair.
struct Sight<'a> {
    view: &'a View,
    picture: &'a Picture,
    /// Depth in mm and index of the face at each pixel.
    nearest: &'a [(f32, u32)],
}

/// What a pair of frames says about the phases of both.
#[derive(Clone, Copy, Debug, Default)]
struct Pair {
    /// Of the first, of both, of the second.
    hessian: [f64; 3],
    gradient: [f64; 2],
    /// Share of the points that the second frame shows.
    kept: f64,
    /// Mean way of the points across the picture, as a share of its width.
    flow: f64,
}

impl Window {
    /// An empty window; `None` where `settings` ask for no keyframes.
    pub fn new(settings: &settings::Window) -> Option<Window> {
        let empty = Window {
            rays: None,
            most: *settings.keyframes as usize,
            kept: *settings.memory,
            prior_deviation: *settings.prior_deviation,
            keyframes: Vec::new(),
            phases: DVector::zeros(0),
            information: DMatrix::zeros(0, 0),
            waited: 0,
        };
        (empty.most > 0).then_some(empty)
    }

    /// Whether the window works on pictures of this size; larger ones are to be halved.
    pub fn suits(level: &Level) -> bool {
        level.image.width <= WIDEST
    }

    /// Places a frame in the breath, which is expected at `expected` and has the faces `visible` in view. All frames have
    /// one camera.
    pub fn place(&mut self, frame: &Level, visible: &[u32], expected: f64, shape: Shape<'_>) -> Placed {
        let deviation = if self.keyframes.is_empty() { FIRST_DEVIATION } else { self.prior_deviation };
        let rays = self.rays.take().unwrap_or_else(|| Rays::new(&frame.view.camera));
        let picture = picture(&frame.image, &frame.weights);
        let nearest = nearest_faces(&frame.view, &rays, &shape.at(expected), shape.faces, visible);
        let sight = Sight { view: &frame.view, picture: &picture, nearest: &nearest };
        let now = self.keyframes.len();
        let mean = self.phases.clone().push(expected);
        let mut known = self.information.clone().resize(now + 1, now + 1, 0.0);
        known[(now, now)] = 1.0 / (deviation * deviation);
        let (mut at, mut total) = (mean.clone(), known.clone());
        let mut last = None;
        for _ in 0..STEPS {
            let pairs: Vec<Pair> = (self.keyframes.par_iter().enumerate())
                .map(|(k, key)| pair(key, at[k], &sight, at[now], shape))
                .collect();
            total.copy_from(&known);
            let mut gradient = &known * (&mean - &at);
            for (k, pair) in pairs.iter().enumerate() {
                total[(k, k)] += pair.hessian[0];
                total[(k, now)] += pair.hessian[1];
                total[(now, k)] += pair.hessian[1];
                total[(now, now)] += pair.hessian[2];
                gradient[k] += pair.gradient[0];
                gradient[now] += pair.gradient[1];
            }
            last = pairs.last().copied();
            let Some(factor) = total.clone().cholesky() else { break };
            let step = factor.solve(&gradient);
            for (phase, step) in at.iter_mut().zip(step.iter()) {
                *phase = (*phase + step.clamp(-LONGEST_STEP, LONGEST_STEP)).clamp(0.0, 1.0);
            }
            if step.amax() < SHORTEST_STEP {
                break;
            }
        }
        let variance = total.clone().cholesky().map_or(deviation * deviation, |f| f.inverse()[(now, now)]);
        let placed = Placed { phase: at[now], deviation: variance.sqrt() };
        self.waited += 1;
        let enough = |pair: Pair| pair.flow > LONGEST_FLOW || pair.kept < FEWEST_KEPT;
        if last.is_none_or(enough) || self.waited >= LONGEST_WAIT {
            let nearest = nearest_faces(&frame.view, &rays, &shape.at(placed.phase), shape.faces, visible);
            let sight = Sight { nearest: &nearest, ..sight };
            self.add(keyframe(&sight, shape), at, total);
        }
        self.rays = Some(rays);
        placed
    }

    /// Takes a keyframe in, given all phases with it and what is known about them; the oldest leaves a full window.
    fn add(&mut self, keyframe: Keyframe, phases: DVector<f64>, mut information: DMatrix<f64>) {
        self.waited = 0;
        self.keyframes.push(keyframe);
        self.phases = phases;
        if self.keyframes.len() > self.most {
            // What is known about the others without it: Schur's complement.
            let n = information.nrows();
            let row = information.row(0).columns(1, n - 1).clone_owned();
            information = information.view((1, 1), (n - 1, n - 1)) - row.transpose() * &row / information[(0, 0)];
            self.keyframes.remove(0);
            self.phases = self.phases.clone().remove_row(0);
        }
        self.information = information * self.kept;
    }
}

/// Local contrast `(I - B) / (B + floor)` of `image`, `B` its mean over a neighbourhood, per channel.
fn picture(image: &Image<f32>, weights: &[f32]) -> Picture {
    let (width, pixels) = (image.width, image.width * image.height);
    let counts: Vec<bool> = (0..pixels).map(|i| weights.get(i).is_none_or(|&w| w > 0.0)).collect();
    let radius = ((width as f64 * RADIUS_SHARE).round() as usize).max(1);
    // The fourth plane counts the pixels in the neighbourhood that count.
    let value = |i: usize, c: usize| if c < 3 { image.data[3 * i + c] } else { 1.0 };
    let averaged = |c: usize| {
        let mut plane: Vec<f32> = (0..pixels).map(|i| if counts[i] { value(i, c) } else { 0.0 }).collect();
        for _ in 0..2 {
            average_rows(&mut plane, width, radius);
            plane = transposed(&plane, width);
            average_rows(&mut plane, image.height, radius);
            plane = transposed(&plane, image.height);
        }
        plane
    };
    let planes: Vec<Vec<f32>> = (0..4).into_par_iter().map(averaged).collect();
    let mut contrast = Image::filled(width, image.height, 3, 0.0f32);
    for i in (0..pixels).filter(|&i| counts[i]) {
        for (c, plane) in planes[..3].iter().enumerate() {
            let mean = plane[i] / planes[3][i];
            contrast.data[3 * i + c] = (value(i, c) - mean) / (mean + CONTRAST_FLOOR);
        }
    }
    Picture { contrast, counts }
}

/// Sums over `2 radius + 1` pixels along rows of `width`, zero outside.
fn average_rows(plane: &mut [f32], width: usize, radius: usize) {
    let mut row = vec![0.0f32; width];
    for values in plane.chunks_exact_mut(width) {
        row.copy_from_slice(values);
        let mut sum: f32 = row.iter().take(radius).sum();
        for (i, value) in values.iter_mut().enumerate() {
            sum += row.get(i + radius).unwrap_or(&0.0);
            if i > radius {
                sum -= row[i - radius - 1];
            }
            *value = sum;
        }
    }
}

/// Rows of `width` as columns.
fn transposed(plane: &[f32], width: usize) -> Vec<f32> {
    let height = plane.len() / width;
    (0..plane.len()).map(|i| plane[(i % height) * width + i / height]).collect()
}

/// The points of a frame: of each cell the pixel on a wall whose contrast is steepest.
fn keyframe(sight: &Sight<'_>, shape: Shape<'_>) -> Keyframe {
    let Sight { view, picture: Picture { contrast, counts }, nearest } = *sight;
    let world_from_camera = view.camera_from_world.inverse();
    let (width, height) = (contrast.width, contrast.height);
    let on_wall = |i: usize| {
        let depth = nearest[i].0;
        let near = |j: usize| counts[j] && nearest[j].0 > 0.0 && (nearest[j].0 - depth).abs() < EDGE * depth;
        [i, i - 1, i + 1, i - width, i + width].into_iter().all(near)
    };
    let steepness = |i: usize| -> f32 {
        let across = |step: usize| (0..3).map(move |c| (3 * (i + step) + c, 3 * (i - step) + c));
        let pairs = across(1).chain(across(width));
        pairs.map(|(a, b)| (contrast.data[a] - contrast.data[b]).powi(2)).sum()
    };
    let mut points = Vec::new();
    for (top, left) in (0..height / CELL_PX).flat_map(|y| (0..width / CELL_PX).map(move |x| (y * CELL_PX, x * CELL_PX)))
    {
        let rows = top.max(1)..(top + CELL_PX).min(height - 1);
        let cell = rows.flat_map(|y| (left.max(1)..(left + CELL_PX).min(width - 1)).map(move |x| y * width + x));
        let steepest = cell.filter(|&i| on_wall(i)).map(|i| (steepness(i), i)).max_by(|a, b| a.0.total_cmp(&b.0));
        let Some((_, i)) = steepest.filter(|(steepness, _)| *steepness > 0.0) else { continue };
        let pixel = DVec2::new((i % width) as f64 + 0.5, (i / width) as f64 + 0.5);
        let direction = view.camera.direction(pixel);
        points.push(Point {
            pixel,
            ray: world_from_camera.transform_vector3(direction / direction.z),
            face: shape.faces[nearest[i].1 as usize],
            contrast: [0, 1, 2].map(|c| contrast.data[3 * i + c]),
        });
    }
    Keyframe { eye: world_from_camera.translation, points }
}

/// Where what a ray from `eye` meets on its face at phase `first` is at phase `second`, and the derivatives of that by
/// both phases (mm, world); `None` where the ray grazes the face.
fn carried(eye: DVec3, point: &Point, first: f64, second: f64, shape: Shape<'_>) -> Option<[DVec3; 3]> {
    let [a, b, c] = shape.corners(point.face, first);
    let [way_a, way_b, way_c] = point.face.map(|v| shape.way(v));
    // eye + t ray = a + u (b - a) + v (c - a).
    let met = DMat3::from_cols(b - a, c - a, -point.ray);
    if met.determinant().abs() < 1e-9 {
        return None;
    }
    let solved = met.inverse();
    let uvt = solved * (eye - a);
    let on_face = |[a, b, c]: [DVec3; 3]| a + uvt.x * (b - a) + uvt.y * (c - a);
    let way = on_face([way_a, way_b, way_c]);
    let change = solved * -way;
    let later = shape.corners(point.face, second);
    Some([on_face(later), change.x * (later[1] - later[0]) + change.y * (later[2] - later[0]), way])
}

/// A point as both frames show it: difference of contrasts, and the derivatives of the later one by both phases.
struct Row {
    residual: [f32; 3],
    by: [[f64; 3]; 2],
    way_px: f64,
}

fn row(eye: DVec3, point: &Point, first: f64, sight: &Sight<'_>, second: f64, shape: Shape<'_>) -> Option<Row> {
    let Sight { view: View { camera, camera_from_world, .. }, picture: Picture { contrast, counts }, nearest } = *sight;
    let (width, height) = (contrast.width, contrast.height);
    let [place, by_first, by_second] = carried(eye, point, first, second, shape)?;
    let place = camera_from_world.transform_point3(place);
    let pixel = if place.z > 0.0 { camera.project(place)? } else { return None };
    let (x, y) = (pixel.x - 0.5, pixel.y - 0.5);
    if !(x >= 1.0 && y >= 1.0 && x < width as f64 - 2.0 && y < height as f64 - 2.0) {
        return None;
    }
    let (i, j) = (x as usize, y as usize);
    let wall = nearest[y.round() as usize * width + x.round() as usize].0 as f64;
    let behind = place.z - wall;
    let slack = SLACK * wall;
    if !counts[j * width + i] || wall <= 0.0 || behind > slack + SLACK_MM || behind < -3.0 * slack - SLACK_MM {
        return None;
    }
    let moved = |by: DVec3| {
        let by = camera_from_world.transform_vector3(by);
        Some((camera.project(place + WIDTH * by)? - pixel) / WIDTH)
    };
    let ways = [moved(by_first)?, moved(by_second)?];
    let (fx, fy) = ((x - i as f64) as f32, (y - j as f64) as f32);
    let mut row = Row { residual: [0.0; 3], by: [[0.0; 3]; 2], way_px: (pixel - point.pixel).length() };
    for c in 0..3 {
        let at = |dx: usize, dy: usize| contrast.data[((j + dy) * width + i + dx) * 3 + c];
        let [v00, v10, v01, v11] = [at(0, 0), at(1, 0), at(0, 1), at(1, 1)];
        let (top, bottom) = (v00 + (v10 - v00) * fx, v01 + (v11 - v01) * fx);
        let slope = DVec2::new(((v10 - v00) * (1.0 - fy) + (v11 - v01) * fy) as f64, (bottom - top) as f64);
        row.residual[c] = point.contrast[c] - (top + (bottom - top) * fy);
        (row.by[0][c], row.by[1][c]) = (slope.dot(ways[0]), slope.dot(ways[1]));
    }
    Some(row)
}

/// What the points of `key` at phase `first` say about both phases when the later frame is at `second`.
fn pair(key: &Keyframe, first: f64, sight: &Sight<'_>, second: f64, shape: Shape<'_>) -> Pair {
    let rows: Vec<Row> = key.points.iter().filter_map(|p| row(key.eye, p, first, sight, second, shape)).collect();
    if rows.len() < FEWEST_POINTS {
        return Pair::default();
    }
    let mut sizes: Vec<f32> = rows.iter().flat_map(|row| row.residual.map(f32::abs)).collect();
    let middle = sizes.len() / 2;
    let scale = (1.4826 * *sizes.select_nth_unstable_by(middle, f32::total_cmp).1).max(SMALLEST_SCALE);
    let limit = HUBER * scale;
    let per_value = 1.0 / (scale as f64 * scale as f64 * TOGETHER);
    let way_px: f64 = rows.iter().map(|row| row.way_px).sum();
    let mut pair = Pair {
        kept: rows.len() as f64 / key.points.len() as f64,
        flow: way_px / rows.len() as f64 / sight.picture.contrast.width as f64,
        ..Pair::default()
    };
    for Row { residual, by: [first, second], .. } in &rows {
        for ((r, a), b) in residual.iter().zip(first).zip(second) {
            let weight = (limit / r.abs().max(limit)) as f64 * per_value;
            pair.hessian[0] += weight * a * a;
            pair.hessian[1] += weight * a * b;
            pair.hessian[2] += weight * b * b;
            pair.gradient[0] += weight * a * *r as f64;
            pair.gradient[1] += weight * b * *r as f64;
        }
    }
    pair
}

#[cfg(test)]
mod tests {
    use glam::DAffine3;

    use super::*;
    use crate::base::Camera;
    use crate::reconstruct::settings::{Source, Sourced};

    const SIZE: usize = 64;
    const AROUND: u32 = 48;
    const RINGS: u32 = 61;
    const RADIUS_MM: f64 = 6.0;

    /// A tube along z that breathing narrows, shifts and draws towards the camera.
    struct Tube {
        rest: Vec<[f32; 3]>,
        displacement: Vec<[f32; 3]>,
        faces: Vec<[u32; 3]>,
    }

    impl Tube {
        fn new() -> Tube {
            let place = |i: u32| {
                let (turn, z) = ((i % AROUND) as f64 / AROUND as f64 * std::f64::consts::TAU, (i / AROUND) as f64);
                DVec3::new(RADIUS_MM * turn.cos(), RADIUS_MM * turn.sin(), z)
            };
            let all = (0..AROUND * RINGS).map(place);
            let way = |p: DVec3| DVec3::new(3.0 - 0.2 * p.x, 2.0 - 0.2 * p.y, -3.0 - 0.05 * p.z);
            let faces = (0..AROUND * (RINGS - 1)).flat_map(|i| {
                let next = i / AROUND * AROUND + (i + 1) % AROUND;
                [[i, next, i + AROUND], [next, next + AROUND, i + AROUND]]
            });
            Tube {
                rest: all.clone().map(|p| p.as_vec3().to_array()).collect(),
                displacement: all.map(|p| way(p).as_vec3().to_array()).collect(),
                faces: faces.collect(),
            }
        }

        fn shape(&self) -> Shape<'_> {
            Shape { rest: &self.rest, displacement: &self.displacement, faces: &self.faces }
        }

        /// What a camera at `z` mm sees at `phase`: a pattern that is fixed to the rest shape, under a light that is not.
        fn film(&self, z: f64, phase: f64) -> (View, Image<f32>) {
            let camera = Camera::pinhole(SIZE as u32, SIZE as u32, 1.7);
            let view = View::new(camera, DAffine3::from_translation(DVec3::new(0.8, -0.5, z)));
            let all: Vec<u32> = (0..self.faces.len() as u32).collect();
            let shape = self.shape();
            let nearest = nearest_faces(&view, &Rays::new(&camera), &shape.at(phase), &self.faces, &all);
            let mut image = Image::filled(SIZE, SIZE, 3, 0.02f32);
            for (i, &(depth, face)) in nearest.iter().enumerate().filter(|(_, (depth, _))| *depth > 0.0) {
                let pixel = DVec2::new((i % SIZE) as f64 + 0.5, (i / SIZE) as f64 + 0.5);
                let direction = camera.direction(pixel);
                let point =
                    Point { pixel, ray: direction / direction.z, face: self.faces[face as usize], contrast: [0.0; 3] };
                let eye = view.camera_from_world.inverse().translation;
                let [p, ..] = carried(eye, &point, phase, 0.0, shape).unwrap();
                let turn = p.y.atan2(p.x);
                let pattern = (5.0 * turn).sin() * (1.7 * p.z).cos() + (3.0 * turn + 0.8 * p.z).sin();
                let light = 8.0 / (4.0 + depth as f64);
                (0..3).for_each(|c| image.data[3 * i + c] = (light * (0.5 + 0.1 * pattern)) as f32);
            }
            (view, image)
        }
    }

    fn ours<T>(value: T) -> Sourced<T> {
        Sourced { value, source: Source::Ours, why: String::new() }
    }

    /// Errors of the window over a film, whose first frame is believed to be `off` from its phase and later ones `off` from theirs.
    fn errors(off: f64) -> Vec<f64> {
        let tube = Tube::new();
        let all: Vec<u32> = (0..tube.faces.len() as u32).collect();
        let mut window =
            Window::new(&settings::Window { keyframes: ours(8), memory: ours(0.7), prior_deviation: ours(0.05) })
                .expect("there are keyframes");
        (0..40)
            .map(|frame| {
                let truth = 0.5 + 0.3 * (frame as f64 * 0.15).sin();
                let (view, image) = tube.film(2.0 + 0.3 * frame as f64, truth);
                let frame = Level { view, image, weights: Vec::new() };
                window.place(&frame, &all, truth + off, tube.shape()).phase - truth
            })
            .collect()
    }

    #[test]
    fn phases_that_are_expected_in_the_wrong_place_are_mended_by_parallax() {
        for off in [0.06, -0.06] {
            let errors = errors(off);
            assert!((errors[0] - off).abs() < 1e-3, "one frame alone has no parallax: {}", errors[0]);
            let late = errors[30..].iter().map(|e| e.abs()).fold(0.0, f64::max);
            assert!(late < 0.012, "{errors:.4?}");
        }
    }

    #[test]
    fn the_derivatives_of_a_carried_point_are_those_of_its_place() {
        let tube = Tube::new();
        let shape = tube.shape();
        let (view, _) = tube.film(3.0, 0.4);
        let all: Vec<u32> = (0..tube.faces.len() as u32).collect();
        let nearest = nearest_faces(&view, &Rays::new(&view.camera), &shape.at(0.4), &tube.faces, &all);
        let eye = view.camera_from_world.inverse().translation;
        for i in (7..SIZE * SIZE).step_by(131).filter(|&i| nearest[i].0 > 0.0) {
            let pixel = DVec2::new((i % SIZE) as f64 + 0.5, (i / SIZE) as f64 + 0.5);
            let face = tube.faces[nearest[i].1 as usize];
            let point = Point { pixel, ray: view.camera.direction(pixel), face, contrast: [0.0; 3] };
            let at = |first: f64, second: f64| carried(eye, &point, first, second, shape).unwrap();
            let [_, by_first, by_second] = at(0.4, 0.7);
            let h = 1e-5;
            let numeric_first = (at(0.4 + h, 0.7)[0] - at(0.4 - h, 0.7)[0]) / (2.0 * h);
            let numeric_second = (at(0.4, 0.7 + h)[0] - at(0.4, 0.7 - h)[0]) / (2.0 * h);
            assert!(
                (by_first - numeric_first).length() < 1e-5 * (1.0 + by_first.length()),
                "{by_first} {numeric_first}"
            );
            assert!((by_second - numeric_second).length() < 1e-5 * (1.0 + by_second.length()));
        }
    }

    #[test]
    fn contrast_knows_no_gain_and_no_hidden_pixels() {
        let image = Image {
            width: 40,
            height: 30,
            channels: 3,
            data: (0..3600).map(|i| 0.5 + 0.3 * (i as f32 * 0.37).sin()).collect(),
        };
        let weights: Vec<f32> = (0..1200).map(|i| f32::from(u8::from(i % 40 < 30))).collect();
        let mut other = image.clone();
        (0..1200).filter(|i| i % 40 >= 30).for_each(|i| other.data[3 * i] = 9.0);
        let (a, b) = (picture(&image, &weights), picture(&other, &weights));
        assert_eq!(a.contrast.data, b.contrast.data);
        let flat = picture(&Image::filled(40, 30, 3, 0.6), &[]);
        assert!(flat.contrast.data.iter().all(|v| v.abs() < 1e-5));
    }
}
