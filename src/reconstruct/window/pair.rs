//! A keyframe and a later frame: how the points of the one show in the other, and what that says about both phases.

use glam::{DMat3, DVec2, DVec3, Vec3};
use nalgebra::{DMatrix, DVector};

use crate::splat::View;

use super::contrast::Picture;
use crate::reconstruct::phase_fit::at_phase;

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
/// One of so many points is looked at where only the misfit is asked for.
const LOOKED_AT: usize = 4;
/// A point is hidden where it lies so much of the wall's depth, and so many mm, behind the nearest wall, and has left its
/// face where it lies three times that much before it.
const SLACK: f64 = 0.05;
const SLACK_MM: f64 = 0.5;
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
    /// Vertices at `phase`.
    pub fn at(&self, phase: f64) -> Vec<[f32; 3]> {
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

/// A frame whose points are looked for in later ones.
pub struct Keyframe {
    /// Where it was taken from, mm.
    pub eye: DVec3,
    /// Its points.
    pub points: Vec<Point>,
}

/// A pixel of a keyframe.
pub struct Point {
    /// Where it is in its picture.
    pub pixel: DVec2,
    /// Its direction in the world, of unit z-depth.
    pub ray: DVec3,
    /// Corners of the face that it shows.
    pub face: [u32; 3],
    /// What it looks like.
    pub contrast: [f32; 3],
}

/// The later frame of a pair.
pub struct Sight<'a> {
    /// Where it was taken from.
    pub view: &'a View,
    /// What it shows.
    pub picture: &'a Picture,
    /// Depth in mm and index of the face at each pixel.
    pub nearest: &'a [(f32, u32)],
}

/// What a pair of frames says about the phases of both, and about the coefficients of a correction, three per centre.
#[derive(Clone, Debug)]
pub struct Pair {
    /// Phase of the first, of the second, coefficients.
    pub hessian: DMatrix<f64>,
    /// Likewise.
    pub gradient: DVector<f64>,
    /// Share of the points that the second frame shows.
    pub kept: f64,
    /// Mean way of the points across the picture, as a share of its width.
    pub flow: f64,
}

/// The points of a frame: of each cell the pixel on a wall whose contrast is steepest.
pub fn keyframe(sight: &Sight<'_>, shape: Shape<'_>) -> Keyframe {
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

/// What a ray of a keyframe meets on its face, seen at another phase.
pub struct Carried {
    /// Where it is, mm, world.
    pub place: DVec3,
    /// The derivatives of that by the first and by the second phase.
    pub by_phase: [DVec3; 2],
    /// And by an offset of the face's way to expiration, per axis.
    pub by_offset: [DVec3; 3],
    /// Share of each corner in it.
    pub shares: [f64; 3],
}

/// Where what a ray from `eye` meets on its face at phase `first` is at phase `second`; `None` where the ray grazes the
/// face.
pub fn carried(eye: DVec3, point: &Point, first: f64, second: f64, shape: Shape<'_>) -> Option<Carried> {
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
    let later = shape.corners(point.face, second);
    // How the place moves when what the ray meets moves on its face.
    let slide = |change: DVec3| change.x * (later[1] - later[0]) + change.y * (later[2] - later[0]);
    Some(Carried {
        place: on_face(later),
        by_phase: [slide(solved * -way), way],
        by_offset: DVec3::AXES.map(|axis| second * axis - first * slide(solved * axis)),
        shares: [1.0 - uvt.x - uvt.y, uvt.x, uvt.y],
    })
}

/// A point as both frames show it: difference of contrasts, and the derivatives of the later one by both phases.
struct Row {
    residual: [f32; 3],
    by: [[f64; 3]; 2],
    way_px: f64,
    offset: Option<Offset>,
}

/// The derivatives of the later contrast by an offset of the whole face, axis by axis, and the face.
struct Offset {
    by: [[f64; 3]; 3],
    face: [u32; 3],
    shares: [f64; 3],
}

/// Whether a row knows what an offset of its face does.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Offsets {
    Wanted,
    Left,
}

fn row(
    eye: DVec3,
    point: &Point,
    first: f64,
    sight: &Sight<'_>,
    second: f64,
    shape: Shape<'_>,
    offsets: Offsets,
) -> Option<Row> {
    let Sight { view: View { camera, camera_from_world, .. }, picture: Picture { contrast, counts }, nearest } = *sight;
    let (width, height) = (contrast.width, contrast.height);
    let carried = carried(eye, point, first, second, shape)?;
    let place = camera_from_world.transform_point3(carried.place);
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
    let [by_first, by_second] = carried.by_phase;
    let ways = [moved(by_first)?, moved(by_second)?];
    let offset_ways = match offsets {
        Offsets::Wanted => {
            let [x, y, z] = carried.by_offset;
            [moved(x)?, moved(y)?, moved(z)?]
        }
        Offsets::Left => [DVec2::ZERO; 3],
    };
    let mut by_offset = [[0.0; 3]; 3];
    let (fx, fy) = ((x - i as f64) as f32, (y - j as f64) as f32);
    let mut row = Row { residual: [0.0; 3], by: [[0.0; 3]; 2], way_px: (pixel - point.pixel).length(), offset: None };
    for c in 0..3 {
        let at = |dx: usize, dy: usize| contrast.data[((j + dy) * width + i + dx) * 3 + c];
        let [v00, v10, v01, v11] = [at(0, 0), at(1, 0), at(0, 1), at(1, 1)];
        let (top, bottom) = (v00 + (v10 - v00) * fx, v01 + (v11 - v01) * fx);
        let slope = DVec2::new(((v10 - v00) * (1.0 - fy) + (v11 - v01) * fy) as f64, (bottom - top) as f64);
        row.residual[c] = point.contrast[c] - (top + (bottom - top) * fy);
        (row.by[0][c], row.by[1][c]) = (slope.dot(ways[0]), slope.dot(ways[1]));
        by_offset.iter_mut().zip(offset_ways).for_each(|(by, way)| by[c] = slope.dot(way));
    }
    if offsets == Offsets::Wanted {
        row.offset = Some(Offset { by: by_offset, face: point.face, shares: carried.shares });
    }
    Some(row)
}

/// How badly the later frame at phase `second` agrees with `key` at phase `first`, by every fourth point: mean difference of
/// contrast, larger where fewer points are seen; infinite where too few are.
pub fn misfit(key: &Keyframe, first: f64, sight: &Sight<'_>, second: f64, shape: Shape<'_>) -> f64 {
    let points = key.points.iter().step_by(LOOKED_AT);
    let tried = points.len();
    let sizes: Vec<f64> = (points.filter_map(|p| row(key.eye, p, first, sight, second, shape, Offsets::Left)))
        .map(|row| row.residual.iter().map(|r| r.abs() as f64).sum())
        .collect();
    if sizes.len() * LOOKED_AT < FEWEST_POINTS {
        return f64::INFINITY;
    }
    let kept = sizes.len() as f64 / tried as f64;
    sizes.iter().sum::<f64>() / sizes.len() as f64 / kept.sqrt()
}

/// What the points of `key` at phase `first` say about both phases when the later frame is at `second`, and about the
/// coefficients of a correction of the displacement field whose centres have these `weights` of all vertices.
pub fn pair(
    key: &Keyframe,
    first: f64,
    sight: &Sight<'_>,
    second: f64,
    shape: Shape<'_>,
    weights: &[&[f32]],
) -> Pair {
    let size = 2 + 3 * weights.len();
    let (hessian, gradient) = (DMatrix::zeros(size, size), DVector::zeros(size));
    let mut pair = Pair { hessian, gradient, kept: 0.0, flow: 0.0 };
    let offsets = if weights.is_empty() { Offsets::Left } else { Offsets::Wanted };
    let rows = key.points.iter().filter_map(|p| row(key.eye, p, first, sight, second, shape, offsets));
    let rows: Vec<Row> = rows.collect();
    if rows.len() < FEWEST_POINTS {
        return pair;
    }
    let mut sizes: Vec<f32> = rows.iter().flat_map(|row| row.residual.map(f32::abs)).collect();
    let middle = sizes.len() / 2;
    let scale = (1.4826 * *sizes.select_nth_unstable_by(middle, f32::total_cmp).1).max(SMALLEST_SCALE);
    let limit = HUBER * scale;
    let per_value = 1.0 / (scale as f64 * scale as f64 * TOGETHER);
    let weight = |r: f32| (limit / r.abs().max(limit)) as f64 * per_value;
    let way_px: f64 = rows.iter().map(|row| row.way_px).sum();
    pair.kept = rows.len() as f64 / key.points.len() as f64;
    pair.flow = way_px / rows.len() as f64 / sight.picture.contrast.width as f64;
    // Of the first phase, of both, of the second.
    let (mut second_order, mut first_order) = ([0.0f64; 3], [0.0f64; 2]);
    for Row { residual, by: [first, second], .. } in &rows {
        for ((r, a), b) in residual.iter().zip(first).zip(second) {
            let weight = weight(*r);
            second_order[0] += weight * a * a;
            second_order[1] += weight * a * b;
            second_order[2] += weight * b * b;
            first_order[0] += weight * a * *r as f64;
            first_order[1] += weight * b * *r as f64;
        }
    }
    for row in &rows {
        let Some(Offset { by, face, shares }) = &row.offset else { continue };
        let share = |weights: &&[f32]| {
            face.iter().zip(shares).map(|(&v, share)| share * weights[v as usize] as f64).sum::<f64>()
        };
        let share: Vec<f64> = weights.iter().map(share).collect();
        let mut column = vec![0.0; size];
        for (c, r) in row.residual.iter().enumerate() {
            (column[0], column[1]) = (row.by[0][c], row.by[1][c]);
            for (k, value) in column[2..].iter_mut().enumerate() {
                *value = share[k / 3] * by[k % 3][c];
            }
            let weight = weight(*r);
            for i in 2..size {
                let along = weight * column[i];
                pair.gradient[i] += along * *r as f64;
                (0..=i).for_each(|j| pair.hessian[(i, j)] += along * column[j]);
            }
        }
    }
    pair.hessian.fill_upper_triangle_with_lower_triangle();
    let [a, both, b] = second_order;
    (pair.hessian[(0, 0)], pair.hessian[(0, 1)], pair.hessian[(1, 0)], pair.hessian[(1, 1)]) = (a, both, both, b);
    (pair.gradient[0], pair.gradient[1]) = (first_order[0], first_order[1]);
    pair
}
