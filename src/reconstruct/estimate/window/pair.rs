//! A keyframe and a later frame: where the keyframe's points appear in the later frame, and the normal equations
//! of both phases and the other unknowns that follow.

use glam::{DAffine3, DMat3, DVec2, DVec3};
use nalgebra::{DMatrix, DVector};

use crate::base::statistics::robust_deviation;
use crate::reconstruct::fitting::contrast::ContrastImage;
use crate::reconstruct::geometry::breathing::BreathingMesh;
use crate::reconstruct::geometry::rigid::{POSE, turns};
use crate::splat::View;

/// Side in pixels of the square cells. Each gives one point, the pixel of steepest contrast.
const CELL_PX: usize = 4;
/// Relative jump of depth between neighbouring pixels that counts as an edge of a wall. Points on edges are not
/// used: edges move differently from walls.
const EDGE: f32 = 0.15;
/// Residuals beyond this many robust standard deviations count linearly.
const HUBER: f32 = 2.0;
/// Smallest robust standard deviation, in units of contrast.
const SMALLEST_SCALE: f32 = 0.01;
/// Number of values that count as one independent observation: errors of neighbouring points are correlated.
const TOGETHER: f64 = 20.0;
/// Pairs with fewer visible points are ignored.
const FEWEST_POINTS: usize = 30;
/// The misfit uses every this many-th point.
const MISFIT_STRIDE: usize = 4;
/// A point is hidden if it lies more than `SLACK` (share of the wall's depth) plus `SLACK_MM` behind the nearest
/// wall. It is discarded, too, if it lies more than three times the share plus `SLACK_MM` in front of it.
const SLACK: f64 = 0.05;
const SLACK_MM: f64 = 0.5;
/// Step of the forward difference of a projection, in units of the unknown (phase or mm).
const WIDTH: f64 = 1e-3;

/// A frame whose points are looked up in later ones.
pub struct Keyframe {
    /// The given pose.
    pub camera_from_world: DAffine3,
    /// When it was taken.
    pub time_s: f64,
    /// Its points.
    pub points: Vec<KeyframePoint>,
}

/// A pixel of a keyframe.
pub struct KeyframePoint {
    /// Where it is in its image.
    pub pixel: DVec2,
    /// Its viewing direction in camera axes, scaled to a z-depth of 1.
    pub ray: DVec3,
    /// Corners of the face that it shows.
    pub face: [u32; 3],
    /// Its local contrast per channel.
    pub contrast: [f32; 3],
}

/// The later frame of a pair, in which the points of the keyframe are looked up.
pub struct TargetFrame<'a> {
    /// Its camera and assumed pose.
    pub view: &'a View,
    /// Its local contrast.
    pub contrast_image: &'a ContrastImage,
    /// Depth in mm and index of the face at each pixel.
    pub nearest: &'a [(f32, u32)],
}

/// The normal equations of a pair of frames, in the phases of both and [`OtherUnknowns`].
#[derive(Clone, Debug)]
pub struct Pair {
    /// Order: phase of the first frame, of the second; correction of the poses, its change per second; coefficients
    /// of the displacement field's correction, three per centre.
    pub hessian: DMatrix<f64>,
    /// In the same order.
    pub gradient: DVector<f64>,
    /// Share of the points that are visible in the second frame.
    pub kept: f64,
    /// Mean distance by which the points moved in the image, as a share of its width.
    pub flow: f64,
}

/// The keyframe of a frame: in each cell, the pixel of steepest contrast that lies on a wall and not on its edge.
pub fn keyframe(target: &TargetFrame<'_>, given: &View, time_s: f64, faces: &[[u32; 3]]) -> Keyframe {
    let TargetFrame { view, contrast_image: ContrastImage { contrast, counts }, nearest } = *target;
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
        points.push(KeyframePoint {
            pixel,
            ray: direction / direction.z,
            face: faces[nearest[i].1 as usize],
            contrast: [0, 1, 2].map(|c| contrast.data[3 * i + c]),
        });
    }
    Keyframe { camera_from_world: given.camera_from_world, time_s, points }
}

/// The point where a keyframe's ray meets its face, carried to another phase.
pub struct CarriedPoint {
    /// Where it is, mm, world.
    pub place: DVec3,
    /// Z-depth of the intersection in the keyframe, mm.
    pub depth: f64,
    /// Velocity of the face there, mm per unit of phase.
    pub velocity: DVec3,
    /// Derivative of the place by a translation of the ray: the intersection slides on the face.
    pub slide: DMat3,
    /// Its barycentric coordinates.
    pub shares: [f64; 3],
}

impl CarriedPoint {
    /// The derivatives of the place by the first and by the second phase. Moving the face by `velocity` is, for the
    /// intersection, the same as moving the ray by `-velocity`.
    pub fn by_phase(&self) -> [DVec3; 2] {
        [self.slide * -self.velocity, self.velocity]
    }

    /// The derivative of the place by an offset of the face's displacement to expiration.
    pub fn by_offset(&self, first: f64, second: f64) -> DMat3 {
        DMat3::from_diagonal(DVec3::splat(second)) - first * self.slide
    }
}

/// Intersects a ray with `face` at phase `first` and carries the point to phase `second`; `None` if the ray is
/// nearly parallel to the face.
///
/// The ray from `eye` along `ray` meets the corners `v_i(first)` at `eye + t ray = a + u (b - a) + v (c - a)`;
/// the answer is `sum b_i v_i(second)` with the barycentric coordinates `b = (1 - u - v, u, v)`.
pub fn carried(
    [eye, ray]: [DVec3; 2],
    face: [u32; 3],
    first: f64,
    second: f64,
    mesh: BreathingMesh<'_>,
) -> Option<CarriedPoint> {
    let [a, b, c] = mesh.corners(face, first);
    let displacements = face.map(|v| mesh.displacement_of(v));
    let meeting = DMat3::from_cols(b - a, c - a, -ray);
    if meeting.determinant().abs() < 1e-9 {
        return None;
    }
    let inverse = meeting.inverse();
    let uvt = inverse * (eye - a);
    let on_face = |[a, b, c]: [DVec3; 3]| a + uvt.x * (b - a) + uvt.y * (c - a);
    let later = mesh.corners(face, second);
    let [along_u, along_v] = [later[1] - later[0], later[2] - later[0]];
    let slide = |change: DVec3| change.x * along_u + change.y * along_v;
    Some(CarriedPoint {
        place: on_face(later),
        depth: uvt.z,
        velocity: on_face(displacements),
        slide: DMat3::from_cols(slide(inverse.x_axis), slide(inverse.y_axis), slide(inverse.z_axis)),
        shares: [1.0 - uvt.x - uvt.y, uvt.x, uvt.y],
    })
}

/// The corrections of the poses of a pair; both follow from one correction and its change per second.
#[derive(Clone, Copy, Debug)]
pub struct PairPoses {
    /// Correction of the first and of the later frame.
    pub corrections: [[f64; POSE]; 2],
    /// Seconds between the two.
    pub elapsed_s: f64,
}

/// The unknowns besides the phases.
#[derive(Clone, Copy, Default)]
pub struct OtherUnknowns<'a> {
    /// The correction of the poses, if any.
    pub poses: Option<PairPoses>,
    /// Weights of all vertices at the centres of a correction of the displacement field.
    pub weights: &'a [&'a [f32]],
}

impl OtherUnknowns<'_> {
    /// How many there are.
    pub fn count(&self) -> usize {
        (if self.poses.is_some() { 2 * POSE } else { 0 }) + 3 * self.weights.len()
    }
}

/// A point of the keyframe compared in both frames.
pub struct PointResidual {
    /// Difference of contrasts `r`, per channel.
    residual: [f32; 3],
    /// Gradient of the later frame's contrast, per channel, in 1 / pixel.
    slope: [DVec2; 3],
    /// The point's displacement from one image to the other, pixels.
    pub path: DVec2,
    /// Derivatives of that displacement by both phases.
    pub by_phase: [DVec2; 2],
    /// Derivatives by the other unknowns.
    pub by_others: Vec<DVec2>,
}

/// Assumed state of a pair of frames.
#[derive(Clone, Copy)]
pub struct Assumed<'a> {
    /// Phase of the keyframe.
    pub first: f64,
    /// Pose of the keyframe.
    pub key_from_world: DAffine3,
    /// Phase of the later frame.
    pub second: f64,
    /// The airway.
    pub mesh: BreathingMesh<'a>,
}

/// Residual and derivatives of `point`; `None` if the later frame does not show it.
///
/// With `x = project(camera_from_world X)` the pixel of the carried point `X`:
/// `r = C_key(point) - C_target(x)`, and by an unknown `q`, `dx/dq = (d project / dX) camera_from_world dX/dq`.
pub fn point_residual(
    point: &KeyframePoint,
    target: &TargetFrame<'_>,
    assumed: &Assumed<'_>,
    others: &OtherUnknowns<'_>,
) -> Option<PointResidual> {
    let TargetFrame { view, contrast_image: ContrastImage { contrast, counts }, nearest } = *target;
    let View { camera, camera_from_world, .. } = view;
    let Assumed { first, key_from_world, second, mesh } = *assumed;
    let (width, height) = (contrast.width, contrast.height);

    // The point at the later phase, and its pixel in the later frame.
    let world_from_key = key_from_world.inverse();
    let ray = world_from_key.transform_vector3(point.ray);
    let carried = carried([world_from_key.translation, ray], point.face, first, second, mesh)?;
    let place = camera_from_world.transform_point3(carried.place);
    let pixel = if place.z > 0.0 { camera.project(place)? } else { return None };
    let (x, y) = (pixel.x - 0.5, pixel.y - 0.5);
    if !(x >= 1.0 && y >= 1.0 && x < width as f64 - 2.0 && y < height as f64 - 2.0) {
        return None;
    }

    // Occlusion: the wall that the later frame has there must be the point's own.
    let (i, j) = (x as usize, y as usize);
    let wall = nearest[y.round() as usize * width + x.round() as usize].0 as f64;
    let behind = place.z - wall;
    let slack = SLACK * wall;
    if !counts[j * width + i] || wall <= 0.0 || behind > slack + SLACK_MM || behind < -3.0 * slack - SLACK_MM {
        return None;
    }

    // Derivatives of the pixel by both phases, the projection by a forward difference.
    let pixel_change = |by: DVec3| Some((camera.project(place + WIDTH * by)? - pixel) / WIDTH);
    let in_camera = |by: DVec3| camera_from_world.transform_vector3(by);
    let [by_first, by_second] = carried.by_phase();
    let by_phase = [pixel_change(in_camera(by_first))?, pixel_change(in_camera(by_second))?];

    // By the other unknowns, all through the same three columns of the projection.
    let mut by_others = Vec::new();
    if others.count() > 0 {
        let [right, down, ahead] = [pixel_change(DVec3::X)?, pixel_change(DVec3::Y)?, pixel_change(DVec3::Z)?];
        let projected = |by: DVec3| by.x * right + by.y * down + by.z * ahead;
        if let Some(PairPoses { corrections: [of_key, own], elapsed_s }) = others.poses {
            // One correction moves both cameras: it moves the keyframe's ray the opposite way, and the point in the
            // later camera. The keyframe's correction is `xi - elapsed xi'`.
            let shift = |xi: [f64; POSE]| DVec3::from_slice(&xi[3..]);
            let (hit, place) = (carried.depth * point.ray - shift(of_key), place - shift(own));
            let by_key = |by: DVec3| projected(in_camera(carried.slide * -world_from_key.transform_vector3(by)));
            let key = (turns(of_key).map(|turn| by_key(turn.cross(hit))), DVec3::AXES.map(by_key));
            let own = (turns(own).map(|turn| projected(turn.cross(place))), [right, down, ahead]);
            let both = key.0.into_iter().chain(key.1).zip(own.0.into_iter().chain(own.1));
            by_others.extend(both.map(|(key, own)| key + own));
            by_others.extend(key.0.into_iter().chain(key.1).map(|key| -elapsed_s * key));
        }
        let by_offset = carried.by_offset(first, second);
        let by_offset = [by_offset.x_axis, by_offset.y_axis, by_offset.z_axis].map(|by| projected(in_camera(by)));
        for weights in others.weights {
            let share = |(&v, share): (&u32, f64)| share * weights[v as usize] as f64;
            let share: f64 = point.face.iter().zip(carried.shares).map(share).sum();
            by_others.extend(by_offset.map(|by| share * by));
        }
    }

    // Residual and slope of the later contrast, bilinear.
    let (fx, fy) = ((x - i as f64) as f32, (y - j as f64) as f32);
    let path = pixel - point.pixel;
    let mut found = PointResidual { residual: [0.0; 3], slope: [DVec2::ZERO; 3], path, by_phase, by_others };
    for c in 0..3 {
        let at = |dx: usize, dy: usize| contrast.data[((j + dy) * width + i + dx) * 3 + c];
        let [v00, v10, v01, v11] = [at(0, 0), at(1, 0), at(0, 1), at(1, 1)];
        let (top, bottom) = (v00 + (v10 - v00) * fx, v01 + (v11 - v01) * fx);
        found.slope[c] = DVec2::new(((v10 - v00) * (1.0 - fy) + (v11 - v01) * fy) as f64, (bottom - top) as f64);
        found.residual[c] = point.contrast[c] - (top + (bottom - top) * fy);
    }
    Some(found)
}

/// How badly the later frame agrees with `key`, over every [`MISFIT_STRIDE`]-th point: the mean absolute difference
/// of contrast, divided by the square root of the visible share; infinite if too few points are visible.
pub fn misfit(key: &Keyframe, target: &TargetFrame<'_>, assumed: &Assumed<'_>) -> f64 {
    let points = key.points.iter().step_by(MISFIT_STRIDE);
    let tried = points.len();
    let phases_alone = OtherUnknowns::default();
    let sizes: Vec<f64> = (points.filter_map(|p| point_residual(p, target, assumed, &phases_alone)))
        .map(|found| found.residual.iter().map(|r| r.abs() as f64).sum())
        .collect();
    if sizes.len() * MISFIT_STRIDE < FEWEST_POINTS {
        return f64::INFINITY;
    }
    let kept = sizes.len() as f64 / tried as f64;
    sizes.iter().sum::<f64>() / sizes.len() as f64 / kept.sqrt()
}

/// The normal equations of all points of `key`: with `J = slope . dx/dq` and Huber weights `w`, the Hessian
/// `sum w J^T J` and the gradient `sum w J^T r`.
pub fn pair(key: &Keyframe, target: &TargetFrame<'_>, assumed: &Assumed<'_>, others: &OtherUnknowns<'_>) -> Pair {
    let size = 2 + others.count();
    let (hessian, gradient) = (DMatrix::zeros(size, size), DVector::zeros(size));
    let mut pair = Pair { hessian, gradient, kept: 0.0, flow: 0.0 };
    let residuals: Vec<PointResidual> =
        key.points.iter().filter_map(|p| point_residual(p, target, assumed, others)).collect();
    if residuals.len() < FEWEST_POINTS {
        return pair;
    }

    let sizes = residuals.iter().flat_map(|found| found.residual.map(f32::abs));
    let scale = robust_deviation(sizes).map_or(SMALLEST_SCALE, |scale| scale.max(SMALLEST_SCALE));
    let limit = HUBER * scale;
    let per_value = 1.0 / (scale as f64 * scale as f64 * TOGETHER);

    // Share of points still visible, and how far they have moved.
    let path_px: f64 = residuals.iter().map(|found| found.path.length()).sum();
    pair.kept = residuals.len() as f64 / key.points.len() as f64;
    pair.flow = path_px / residuals.len() as f64 / target.contrast_image.contrast.width as f64;

    // Normal equations. The phases are accumulated separately, since most windows have no other unknowns; the
    // entries of `second_order` are first-first, first-second, second-second.
    let (mut second_order, mut first_order) = ([0.0f64; 3], [0.0f64; 2]);
    let mut column = vec![0.0; size];
    for PointResidual { residual, slope, by_phase, by_others, .. } in &residuals {
        for (r, slope) in residual.iter().zip(slope) {
            let weight = (limit / r.abs().max(limit)) as f64 * per_value;
            let [a, b] = by_phase.map(|by| slope.dot(by));
            second_order[0] += weight * a * a;
            second_order[1] += weight * a * b;
            second_order[2] += weight * b * b;
            first_order[0] += weight * a * *r as f64;
            first_order[1] += weight * b * *r as f64;
            if by_others.is_empty() {
                continue;
            }
            (column[0], column[1]) = (a, b);
            column[2..].iter_mut().zip(by_others).for_each(|(value, by)| *value = slope.dot(*by));
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
