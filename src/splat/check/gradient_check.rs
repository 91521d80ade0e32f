//! The gradients of the backward pass against central differences of the forward pass, value by value, on random scenes
//! in double precision; and the same check of a backward pass with a [`Fault`], which must not pass.
//!
//! The loss is a fixed random weighting of the images. A central difference is wrong if a decision (alpha over
//! 1/255, a pixel full, a colour clamped at 0) changes between its two ends. A value that disagrees is therefore
//! differenced again with smaller steps, and the closest result counts. No step hides a wrong gradient, as the
//! faults show.

use glam::{DAffine3, DQuat, DVec3};

use crate::base::camera::world_from_camera_looking;
use crate::base::random::{CounterRng, Stage};
use crate::base::{Camera, Result};

use crate::splat::pass::Rasterizer;
use crate::splat::plain::fault::Fault;
use crate::splat::types::{Filter, Footprint, Gaussians, Gradients, ImageGradient, Settings, Shape, View, Wanted};

/// Step and order of the first difference, then of the repetitions for values that disagree.
const STEPS: [(f64, DifferenceOrder); 7] = [
    (1e-6, DifferenceOrder::Two),
    (1e-5, DifferenceOrder::Four),
    (3e-6, DifferenceOrder::Four),
    (3e-7, DifferenceOrder::Two),
    (3e-5, DifferenceOrder::Four),
    (5e-8, DifferenceOrder::Two),
    (1e-8, DifferenceOrder::Two),
];
/// Errors are relative to the value or to this share of the root mean square of its group, whichever is larger.
const FLOOR: f64 = 0.1;
/// Largest relative error of a value that passes.
pub const LANE_LIMIT: f64 = 1e-6;

/// Further channels besides the three of the normal.
const FREE: usize = 2;
/// All further channels.
const CHANNELS: usize = 3 + FREE;

/// Index of a Gaussian that is opaque, near and large.
const LARGE: usize = 3;

/// A scene and the weights of its loss.
#[derive(Clone, Debug)]
pub struct GradientCase {
    /// A description of the scene.
    pub name: String,
    /// The Gaussians.
    pub scene: Gaussians<f64>,
    /// The camera.
    pub view: View,
    /// How it is rendered.
    pub settings: Settings,
    color: Vec<f64>,
    depth: Vec<f64>,
    alpha: Vec<f64>,
    /// Weights of the channels: three of the normal and `FREE` more.
    channels: Vec<f64>,
    /// Channels of each Gaussian.
    features: Vec<f64>,
}

/// One group of gradients against the differences.
#[derive(Clone, Copy, Debug)]
pub struct GradientFinding {
    /// Name of the group.
    pub group: &'static str,
    /// Number of values.
    pub lanes: usize,
    /// Worst `|gradient - difference| / max(|difference|, 0.1 rms of the group)`.
    pub worst_lane: f64,
    /// `|gradient - difference| / |difference|`, L2 over the group.
    pub relative: f64,
}

/// Order of the error of a difference.
#[derive(Clone, Copy)]
enum DifferenceOrder {
    Two,
    Four,
}

/// Names of the groups with their central differences.
type Groups = Vec<(&'static str, Vec<f64>)>;

const EYE: DVec3 = DVec3::new(3.0, -2.0, 5.0);

fn world_from_camera() -> DAffine3 {
    world_from_camera_looking(EYE, DVec3::new(0.4, 0.3, 1.0), DVec3::new(0.1, -1.0, 0.0))
}

fn gaussians(n: usize, ellipsoids: bool, sh_degree: u8, r: &mut CounterRng) -> Gaussians<f64> {
    let world = world_from_camera();
    let mut scene = Gaussians::discs(n, sh_degree, 0.5);
    for position in &mut scene.positions {
        let z = r.range(2.0, 9.0);
        *position = world.transform_point3(DVec3::new(z * r.range(-1.3, 1.3), z * r.range(-1.0, 1.0), z)).to_array();
    }
    let mut normal = |scale: f64| scale * r.normal();
    scene.shape = if ellipsoids {
        let scales =
            |normal: &mut dyn FnMut(f64) -> f64| [0.4, 0.4, 0.15].map(|size: f64| size * (1.0 + normal(0.4)).abs());
        Shape::Ellipsoids {
            rotations: (0..n).map(|_| [0; 4].map(|_| normal(1.0))).collect(),
            scales: (0..n).map(|_| scales(&mut normal)).collect(),
        }
    } else {
        Shape::Discs { axes: (0..n).map(|_| [0; 2].map(|_| [0; 3].map(|_| normal(0.4)))).collect() }
    };
    scene.positions[LARGE] = world.transform_point3(DVec3::new(r.range(-0.5, 0.5), r.range(-0.3, 0.3), 3.0)).to_array();
    match &mut scene.shape {
        Shape::Ellipsoids { scales, .. } => scales[LARGE] = scales[LARGE].map(|v| 3.0 * v),
        Shape::Discs { axes } => axes[LARGE] = axes[LARGE].map(|axis| axis.map(|v| 3.0 * v)),
    }
    scene.sh.iter_mut().for_each(|v| *v = 0.3 * r.normal());
    let stride = scene.sh_stride();
    for i in 0..n {
        // One beyond the clamp of alpha at 0.99, some with a colour near or below the clamp at 0.
        scene.opacities[i] = if i == LARGE { r.range(0.998, 1.0) } else { r.range(0.05, 1.0) };
        if i % 3 == 1 {
            scene.sh[i * stride + i % 3] -= r.range(1.0, 3.0);
        }
    }
    scene
}

impl GradientCase {
    /// Scene number `seed`: ellipsoids or discs, pinhole or fisheye, SH of degree 0 to 3, either filter, EWA or
    /// exact discs, with normals and two more channels or without, 4 to 12
    /// Gaussians in 35x22 pixels, some of them outside the image or the clamp of the Jacobian.
    pub fn new(seed: u64) -> GradientCase {
        let r = &mut CounterRng::new(seed, Stage::Test, &[4]);
        let (ellipsoids, fisheye) = (seed.is_multiple_of(2), seed / 2 % 2 == 1);
        let filter = if seed / 4 % 2 == 1 { Filter::Compensate } else { Filter::Dilate };
        let footprint = if seed % 3 == 2 { Footprint::Disc } else { Footprint::Ewa };
        let sh_degree = [1, 0, 2, 3, 1][(seed % 5) as usize];
        let mut camera = Camera::pinhole(35, 22, 80f64.to_radians());
        (camera.cx, camera.cy, camera.fl_y) = (camera.cx + 0.7, camera.cy - 0.4, 1.1 * camera.fl_y);
        camera.fisheye = fisheye.then_some([0.05, -0.02, 0.01, -0.003]);
        let scene = gaussians(4 + (seed % 9) as usize, ellipsoids, sh_degree, r);
        let (n, pixels) = (scene.len(), (camera.width * camera.height) as usize);
        let mut plane = |n: usize| (0..n).map(|_| r.normal()).collect();
        let with_channels = usize::from(seed % 3 == 1 || seed % 6 == 5);
        GradientCase {
            name: format!(
                "{} {} of SH degree {sh_degree}, {}, {footprint:?} {filter:?}",
                scene.len(),
                if ellipsoids { "ellipsoids" } else { "discs" },
                if fisheye { "fisheye" } else { "pinhole" },
            ),
            scene,
            view: View::new(camera, world_from_camera()),
            settings: Settings {
                background: [0.2, 0.5, 0.1],
                gain: [0.8, 1.2, 1.1],
                filter,
                footprint,
                ..Settings::default()
            },
            color: plane(3 * pixels),
            depth: plane(pixels),
            alpha: plane(pixels),
            channels: plane(with_channels * CHANNELS * pixels),
            features: plane(FREE * n),
        }
    }

    /// Normal and free channels of each Gaussian.
    fn all_features(&self) -> Vec<f64> {
        let normals = self.scene.normals(&self.view);
        normals.chunks(3).zip(self.features.chunks(FREE)).flat_map(|(a, b)| a.iter().chain(b)).copied().collect()
    }

    fn loss(&self, rasterizer: &mut Rasterizer<f64>) -> Result<f64> {
        let sum = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
        let image = rasterizer.render(&self.scene, &self.view, &self.settings, None)?;
        let plain = sum(&self.color, &image.color) + sum(&self.depth, &image.depth) + sum(&self.alpha, &image.alpha);
        if self.channels.is_empty() {
            return Ok(plain);
        }
        Ok(plain + sum(&self.channels, rasterizer.render_channels(&self.all_features(), CHANNELS)?))
    }

    fn gradients(&self, fault: Option<Fault>) -> Result<Groups> {
        let mut rasterizer = Rasterizer::<f64>::new();
        rasterizer.render(&self.scene, &self.view, &self.settings, None)?;
        if !self.channels.is_empty() {
            rasterizer.render_channels(&self.all_features(), CHANNELS)?;
        }
        let channels = &self.channels;
        let image = ImageGradient { color: &self.color, depth: &self.depth, alpha: &self.alpha, channels };
        let discs = self.settings.footprint == Footprint::Disc;
        let lens = if discs && self.view.camera.fisheye.is_some() { Wanted::NONE } else { Wanted::LENS };
        let wanted = Wanted::ALL | lens | if channels.is_empty() { Wanted::NONE } else { Wanted::CHANNELS };
        let mut gradients = match fault {
            Some(fault) => rasterizer.backward_with_fault(&self.scene, &image, wanted, fault)?,
            None => rasterizer.backward(&self.scene, &image, wanted)?,
        }
        .clone();
        let rows: Vec<[f64; CHANNELS]> = gradients.channels.as_chunks::<CHANNELS>().0.to_vec();
        if !rows.is_empty() {
            let by_normals: Vec<f64> = rows.iter().flat_map(|row| row[..3].to_vec()).collect();
            self.scene.normals_pullback(&self.view, &by_normals, None, &mut gradients)?;
            gradients.channels = rows.iter().flat_map(|row| row[3..].to_vec()).collect();
        }
        let mut found = groups(&gradients);
        found.retain(|(name, _)| *name != "lens" || wanted.any(Wanted::LENS));
        Ok(found)
    }

    /// The case with value `k` of a group changed by `step`.
    fn moved(&self, group: &str, k: usize, step: f64) -> GradientCase {
        let mut case = self.clone();
        let camera = &mut case.view.camera;
        match (group, &mut case.scene.shape) {
            ("positions", _) => case.scene.positions[k / 3][k % 3] += step,
            ("channels", _) => case.features[k] += step,
            ("opacities", _) => case.scene.opacities[k] += step,
            ("sh", _) => case.scene.sh[k] += step,
            ("gain", _) => case.settings.gain[k] += step,
            ("lens", _) => *[&mut camera.fl_x, &mut camera.fl_y, &mut camera.cx, &mut camera.cy][k] += step,
            ("rotations", Shape::Ellipsoids { rotations, .. }) => rotations[k / 4][k % 4] += step,
            ("scales", Shape::Ellipsoids { scales, .. }) => scales[k / 3][k % 3] += step,
            ("axes", Shape::Discs { axes }) => axes[k / 6][k / 3 % 2][k % 3] += step,
            _ => {
                let axis = [DVec3::X, DVec3::Y, DVec3::Z][k % 3] * step;
                let turn = DAffine3::from_quat(DQuat::from_scaled_axis(axis));
                let motion = if k < 3 { turn } else { DAffine3::from_translation(axis) };
                case.view.camera_from_world = motion * case.view.camera_from_world;
            }
        }
        case
    }

    fn difference(
        &self,
        group: &str,
        k: usize,
        (step, order): (f64, DifferenceOrder),
        rasterizer: &mut Rasterizer<f64>,
    ) -> Result<f64> {
        let mut loss_at = |step: f64| self.moved(group, k, step).loss(rasterizer);
        let mut slope = |step: f64| Ok((loss_at(step)? - loss_at(-step)?) / (2.0 * step));
        match order {
            DifferenceOrder::Two => slope(step),
            DifferenceOrder::Four => Ok((4.0 * slope(step)? - slope(2.0 * step)?) / 3.0),
        }
    }
}

fn groups(g: &Gradients<f64>) -> Groups {
    let all: [(&'static str, Vec<f64>); 10] = [
        ("positions", g.positions.as_flattened().to_vec()),
        ("rotations", g.rotations.as_flattened().to_vec()),
        ("scales", g.scales.as_flattened().to_vec()),
        ("axes", g.axes.as_flattened().as_flattened().to_vec()),
        ("opacities", g.opacities.clone()),
        ("channels", g.channels.clone()),
        ("sh", g.sh.clone()),
        ("pose", g.pose.to_vec()),
        ("gain", g.gain.to_vec()),
        ("lens", g.lens.to_vec()),
    ];
    all.into_iter().filter(|(_, values)| !values.is_empty()).collect()
}

fn floor(values: &[f64]) -> f64 {
    FLOOR * (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt()
}

/// The central differences of a case, to hold any backward pass against.
#[derive(Clone, Debug)]
pub struct CentralDifferences {
    case: GradientCase,
    differences: Groups,
}

impl CentralDifferences {
    /// Differences of every value of every group.
    pub fn new(case: GradientCase) -> Result<CentralDifferences> {
        let mut rasterizer = Rasterizer::<f64>::new();
        let mut differences = Groups::new();
        for (group, analytic) in case.gradients(None)? {
            let least = floor(&analytic);
            let mut values = Vec::with_capacity(analytic.len());
            for (k, sound) in analytic.into_iter().enumerate() {
                let mut nearest = f64::INFINITY;
                for step in STEPS {
                    let value = case.difference(group, k, step, &mut rasterizer)?;
                    if (value - sound).abs() < (nearest - sound).abs() {
                        nearest = value;
                    }
                    if (nearest - sound).abs() <= LANE_LIMIT * nearest.abs().max(least) {
                        break;
                    }
                }
                values.push(nearest);
            }
            differences.push((group, values));
        }
        Ok(CentralDifferences { case, differences })
    }

    /// The scene.
    pub fn case(&self) -> &GradientCase {
        &self.case
    }

    /// Every group of the backward pass, sound or with a fault.
    pub fn compare(&self, fault: Option<Fault>) -> Result<Vec<GradientFinding>> {
        let pairs = self.case.gradients(fault)?.into_iter().zip(&self.differences);
        Ok(pairs.map(|((group, found), (_, truth))| finding(group, &found, truth)).collect())
    }

    /// True if the check finds that fault.
    pub fn catches(&self, fault: Fault) -> Result<bool> {
        Ok(self.compare(Some(fault))?.iter().any(|finding| !finding.passes()))
    }
}

fn finding(group: &'static str, found: &[f64], truth: &[f64]) -> GradientFinding {
    let least = floor(truth);
    let lane = |(a, b): (&f64, &f64)| if a == b { 0.0 } else { (a - b).abs() / b.abs().max(least) };
    let worst = |worst: f64, error: f64| if error.is_nan() { f64::INFINITY } else { worst.max(error) };
    let difference = found.iter().zip(truth).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
    let norm = truth.iter().map(|b| b * b).sum::<f64>().sqrt();
    GradientFinding {
        group,
        lanes: found.len(),
        worst_lane: found.iter().zip(truth).map(lane).fold(0.0, worst),
        relative: if difference == 0.0 { 0.0 } else { difference / norm },
    }
}

impl GradientFinding {
    /// Every value is within its limit.
    pub fn passes(&self) -> bool {
        self.worst_lane <= LANE_LIMIT
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Fifty scenes with EWA and 25 with exact discs, every value of every group; both filters, intrinsics, channels.
    #[test]
    fn every_value_equals_its_central_difference() {
        let mut lanes = 0;
        let mut failures = Vec::new();
        let mut worst = 0f64;
        for seed in 0..75 {
            let truth = CentralDifferences::new(GradientCase::new(seed)).unwrap();
            for finding in truth.compare(None).unwrap() {
                if !finding.passes() {
                    failures.push(format!("scene {seed}, {}: {finding:?}", truth.case().name));
                }
                lanes += finding.lanes;
                worst = worst.max(finding.worst_lane);
            }
        }
        println!("{lanes} values, worst {worst:.1e}");
        assert!(failures.is_empty(), "{failures:#?}");
        assert!(lanes > 5000, "{lanes}");
    }

    /// The check must be able to fail: it finds each fault seeded into the backward pass.
    #[test]
    fn every_seeded_fault_is_caught() {
        let truths: Vec<CentralDifferences> =
            (0..6).map(|seed| CentralDifferences::new(GradientCase::new(seed)).unwrap()).collect();
        for fault in Fault::ALL {
            let by = truths.iter().filter(|truth| truth.catches(fault).unwrap()).count();
            println!("{fault:?}: caught on {by} of {} scenes", truths.len());
            assert!(by > 0, "{fault:?} was not caught");
        }
    }
}
