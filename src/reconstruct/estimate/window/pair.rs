//! A keyframe and a later frame: how the points of the one show in the other, and what that says about both phases.

use glam::{DAffine3, DMat3, DVec2, DVec3, Vec3};
use nalgebra::{DMatrix, DVector};

use crate::splat::View;

use super::contrast::Picture;
use super::drift::{POSE, turns};
use crate::reconstruct::estimate::phase_fit::at_phase;

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
    /// Where it was taken from, as it is given.
    pub camera_from_world: DAffine3,
    /// When.
    pub time_s: f64,
    /// Its points.
    pub points: Vec<Point>,
}

/// A pixel of a keyframe.
pub struct Point {
    /// Where it is in its picture.
    pub pixel: DVec2,
    /// Its direction in camera axes, of unit z-depth.
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

/// What a pair of frames says about the phases of both and about [`Others`].
#[derive(Clone, Debug)]
pub struct Pair {
    /// Phase of the first, of the second; correction of the poses, its change per second; offsets, three per centre.
    pub hessian: DMatrix<f64>,
    /// Likewise.
    pub gradient: DVector<f64>,
    /// Share of the points that the second frame shows.
    pub kept: f64,
    /// Mean way of the points across the picture, as a share of its width.
    pub flow: f64,
}

/// The points of a frame: of each cell the pixel on a wall whose contrast is steepest.
pub fn keyframe(sight: &Sight<'_>, given: &View, time_s: f64, faces: &[[u32; 3]]) -> Keyframe {
    let Sight { view, picture: Picture { contrast, counts }, nearest } = *sight;
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
            ray: direction / direction.z,
            face: faces[nearest[i].1 as usize],
            contrast: [0, 1, 2].map(|c| contrast.data[3 * i + c]),
        });
    }
    Keyframe { camera_from_world: given.camera_from_world, time_s, points }
}

/// What a ray of a keyframe meets on its face, seen at another phase.
pub struct Carried {
    /// Where it is, mm, world.
    pub place: DVec3,
    /// How far it is along the ray, mm of z-depth.
    pub depth: f64,
    /// How the face moves there with the phase.
    pub way: DVec3,
    /// How the place moves when the ray does where it meets the face.
    pub slide: DMat3,
    /// Share of each corner in it.
    pub shares: [f64; 3],
}

impl Carried {
    /// The derivatives of the place by the first and by the second phase.
    pub fn by_phase(&self) -> [DVec3; 2] {
        [self.slide * -self.way, self.way]
    }

    /// By an offset of the face's way to expiration, per axis.
    pub fn by_offset(&self, first: f64, second: f64) -> DMat3 {
        DMat3::from_diagonal(DVec3::splat(second)) - first * self.slide
    }
}

/// Where what a `ray` from `eye` meets on `face` at phase `first` is at phase `second`; `None` where the ray grazes the face.
pub fn carried([eye, ray]: [DVec3; 2], face: [u32; 3], first: f64, second: f64, shape: Shape<'_>) -> Option<Carried> {
    let [a, b, c] = shape.corners(face, first);
    let [way_a, way_b, way_c] = face.map(|v| shape.way(v));
    // eye + t ray = a + u (b - a) + v (c - a).
    let met = DMat3::from_cols(b - a, c - a, -ray);
    if met.determinant().abs() < 1e-9 {
        return None;
    }
    let solved = met.inverse();
    let uvt = solved * (eye - a);
    let on_face = |[a, b, c]: [DVec3; 3]| a + uvt.x * (b - a) + uvt.y * (c - a);
    let later = shape.corners(face, second);
    let [along_u, along_v] = [later[1] - later[0], later[2] - later[0]];
    let slide = |change: DVec3| change.x * along_u + change.y * along_v;
    Some(Carried {
        place: on_face(later),
        depth: uvt.z,
        way: on_face([way_a, way_b, way_c]),
        slide: DMat3::from_cols(slide(solved.x_axis), slide(solved.y_axis), slide(solved.z_axis)),
        shares: [1.0 - uvt.x - uvt.y, uvt.x, uvt.y],
    })
}

/// The corrections of the poses of a pair, which are one correction and its change per second.
#[derive(Clone, Copy, Debug)]
pub struct Poses {
    /// Of the first and of the later frame.
    pub corrections: [[f64; POSE]; 2],
    /// Seconds between the two.
    pub elapsed_s: f64,
}

/// What besides the phases is unknown.
#[derive(Clone, Copy, Default)]
pub struct Others<'a> {
    /// The correction of the poses, if any.
    pub poses: Option<Poses>,
    /// Weights of all vertices at the centres of a correction of the displacement field.
    pub weights: &'a [&'a [f32]],
}

impl Others<'_> {
    /// How many there are.
    pub fn count(&self) -> usize {
        (if self.poses.is_some() { 2 * POSE } else { 0 }) + 3 * self.weights.len()
    }
}

/// A point as both frames show it.
pub struct Row {
    /// Difference of contrasts.
    residual: [f32; 3],
    /// Slopes of the later one, per pixel.
    slope: [DVec2; 3],
    /// Its way from one to the other, pixels, and the derivatives of that.
    pub way: DVec2,
    /// By both phases.
    pub by_phase: [DVec2; 2],
    /// By all else.
    pub by_others: Vec<DVec2>,
}

/// A pair of frames, as it is assumed to be.
#[derive(Clone, Copy)]
pub struct Assumed<'a> {
    /// Phase of the first.
    pub first: f64,
    /// Its pose.
    pub key_from_world: DAffine3,
    /// Phase of the later one.
    pub second: f64,
    /// The airway.
    pub shape: Shape<'a>,
}

/// `point` as both frames show it; `None` where the later one does not.
pub fn row(point: &Point, sight: &Sight<'_>, assumed: &Assumed<'_>, others: &Others<'_>) -> Option<Row> {
    let Sight { view: View { camera, camera_from_world, .. }, picture: Picture { contrast, counts }, nearest } = *sight;
    let Assumed { first, key_from_world, second, shape } = *assumed;
    let (width, height) = (contrast.width, contrast.height);
    let world_from_key = key_from_world.inverse();
    let ray = world_from_key.transform_vector3(point.ray);
    let carried = carried([world_from_key.translation, ray], point.face, first, second, shape)?;
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
    let moved = |by: DVec3| Some((camera.project(place + WIDTH * by)? - pixel) / WIDTH);
    let turned = |by: DVec3| camera_from_world.transform_vector3(by);
    let [by_first, by_second] = carried.by_phase();
    let by_phase = [moved(turned(by_first))?, moved(turned(by_second))?];
    let mut by_others = Vec::new();
    if others.count() > 0 {
        let [right, down, ahead] = [moved(DVec3::X)?, moved(DVec3::Y)?, moved(DVec3::Z)?];
        let seen = |by: DVec3| by.x * right + by.y * down + by.z * ahead;
        if let Some(Poses { corrections: [of_key, own], elapsed_s }) = others.poses {
            let shift = |xi: [f64; POSE]| DVec3::from_slice(&xi[3..]);
            let (hit, place) = (carried.depth * point.ray - shift(of_key), place - shift(own));
            // The ray moves against the camera.
            let by_key = |by: DVec3| seen(turned(carried.slide * -world_from_key.transform_vector3(by)));
            let key = (turns(of_key).map(|turn| by_key(turn.cross(hit))), DVec3::AXES.map(by_key));
            let own = (turns(own).map(|turn| seen(turn.cross(place))), [right, down, ahead]);
            let both = key.0.into_iter().chain(key.1).zip(own.0.into_iter().chain(own.1));
            by_others.extend(both.map(|(key, own)| key + own));
            by_others.extend(key.0.into_iter().chain(key.1).map(|key| -elapsed_s * key));
        }
        let by_offset = carried.by_offset(first, second);
        let by_offset = [by_offset.x_axis, by_offset.y_axis, by_offset.z_axis].map(|by| seen(turned(by)));
        for weights in others.weights {
            let share = |(&v, share): (&u32, f64)| share * weights[v as usize] as f64;
            let share: f64 = point.face.iter().zip(carried.shares).map(share).sum();
            by_others.extend(by_offset.map(|by| share * by));
        }
    }
    let (fx, fy) = ((x - i as f64) as f32, (y - j as f64) as f32);
    let way = pixel - point.pixel;
    let mut row = Row { residual: [0.0; 3], slope: [DVec2::ZERO; 3], way, by_phase, by_others };
    for c in 0..3 {
        let at = |dx: usize, dy: usize| contrast.data[((j + dy) * width + i + dx) * 3 + c];
        let [v00, v10, v01, v11] = [at(0, 0), at(1, 0), at(0, 1), at(1, 1)];
        let (top, bottom) = (v00 + (v10 - v00) * fx, v01 + (v11 - v01) * fx);
        row.slope[c] = DVec2::new(((v10 - v00) * (1.0 - fy) + (v11 - v01) * fy) as f64, (bottom - top) as f64);
        row.residual[c] = point.contrast[c] - (top + (bottom - top) * fy);
    }
    Some(row)
}

/// How badly the later frame agrees with `key`, by every fourth point: mean difference of contrast, larger where fewer points
/// are seen; infinite where too few are.
pub fn misfit(key: &Keyframe, sight: &Sight<'_>, assumed: &Assumed<'_>) -> f64 {
    let points = key.points.iter().step_by(LOOKED_AT);
    let tried = points.len();
    let phases_alone = Others::default();
    let sizes: Vec<f64> = (points.filter_map(|p| row(p, sight, assumed, &phases_alone)))
        .map(|row| row.residual.iter().map(|r| r.abs() as f64).sum())
        .collect();
    if sizes.len() * LOOKED_AT < FEWEST_POINTS {
        return f64::INFINITY;
    }
    let kept = sizes.len() as f64 / tried as f64;
    sizes.iter().sum::<f64>() / sizes.len() as f64 / kept.sqrt()
}

/// What the points of `key` say about both phases and about what else is unknown.
pub fn pair(key: &Keyframe, sight: &Sight<'_>, assumed: &Assumed<'_>, others: &Others<'_>) -> Pair {
    let size = 2 + others.count();
    let (hessian, gradient) = (DMatrix::zeros(size, size), DVector::zeros(size));
    let mut pair = Pair { hessian, gradient, kept: 0.0, flow: 0.0 };
    let rows: Vec<Row> = key.points.iter().filter_map(|p| row(p, sight, assumed, others)).collect();
    if rows.len() < FEWEST_POINTS {
        return pair;
    }
    let mut sizes: Vec<f32> = rows.iter().flat_map(|row| row.residual.map(f32::abs)).collect();
    let middle = sizes.len() / 2;
    let scale = (1.4826 * *sizes.select_nth_unstable_by(middle, f32::total_cmp).1).max(SMALLEST_SCALE);
    let limit = HUBER * scale;
    let per_value = 1.0 / (scale as f64 * scale as f64 * TOGETHER);
    let way_px: f64 = rows.iter().map(|row| row.way.length()).sum();
    pair.kept = rows.len() as f64 / key.points.len() as f64;
    pair.flow = way_px / rows.len() as f64 / sight.picture.contrast.width as f64;
    // Of the first phase, of both, of the second.
    let (mut second_order, mut first_order) = ([0.0f64; 3], [0.0f64; 2]);
    let mut column = vec![0.0; size];
    for Row { residual, slope, by_phase, by_others, .. } in &rows {
        for (r, slope) in residual.iter().zip(slope) {
            let weight = (limit / r.abs().max(limit)) as f64 * per_value;
            let [a, b] = by_phase.map(|way| slope.dot(way));
            second_order[0] += weight * a * a;
            second_order[1] += weight * a * b;
            second_order[2] += weight * b * b;
            first_order[0] += weight * a * *r as f64;
            first_order[1] += weight * b * *r as f64;
            if by_others.is_empty() {
                continue;
            }
            (column[0], column[1]) = (a, b);
            column[2..].iter_mut().zip(by_others).for_each(|(value, way)| *value = slope.dot(*way));
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
