//! Forward mode: derivatives of the image along directions, against central differences in f64, against the backward
//! pass, and every f32 kernel against f64.

use respire_bench::splat::{
    Direction, Footprint, Gaussians, ImageGradient, Isa, Motion, Rasterizer, Settings, Shape, SplatKernels, View,
    Wanted,
};

use super::forward::available;
use super::gradients::moved;
use super::scenes::{Kind, Lens, random, relative, rng, tube, view, wide};

const STEP: f64 = 1e-7;

fn settings() -> Settings {
    Settings { background: [0.2, 0.5, 0.1], gain: [0.8, 1.2, 1.1], ..Settings::default() }
}

/// Velocities of everything that a [`Motion`] can move, one per Gaussian.
#[derive(Clone)]
struct Velocities<T> {
    positions: Vec<[T; 3]>,
    axes: Vec<[[T; 3]; 2]>,
    columns: Vec<[[T; 3]; 3]>,
    colors: Vec<[T; 3]>,
}

impl<T: SplatKernels> Velocities<T> {
    fn motion(&self) -> Motion<'_, T> {
        Motion { positions: &self.positions, axes: &self.axes, columns: &self.columns, colors: &self.colors }
    }
}

impl Velocities<f64> {
    /// Random; ellipsoids turn and stretch by an affine motion, one for all.
    fn new(scene: &Gaussians<f64>, seed: u64) -> Self {
        let r = &mut rng(&[12, seed]);
        let mut three = || [0, 1, 2].map(|_| 0.3 * r.normal());
        let n = scene.len();
        let positions: Vec<[f64; 3]> = (0..n).map(|_| three()).collect();
        let colors = (0..n).map(|_| three()).collect();
        let (axes, columns) = match &scene.shape {
            Shape::Discs { axes } => (axes.iter().map(|_| [three(), three()]).collect(), Vec::new()),
            // Growing as a whole by 30 % per unit, which is a change of the scales alone.
            Shape::Ellipsoids { .. } => {
                let grown = |i: usize| columns_of(scene, i).map(|c| c.map(|v| 0.3 * v));
                (Vec::new(), (0..n).map(grown).collect())
            }
        };
        Velocities { positions, axes, columns, colors }
    }

    fn cast(&self) -> Velocities<f32> {
        let three = |v: &[f64; 3]| v.map(|c| c as f32);
        Velocities {
            positions: self.positions.iter().map(three).collect(),
            axes: self.axes.iter().map(|a| [three(&a[0]), three(&a[1])]).collect(),
            columns: self.columns.iter().map(|c| [three(&c[0]), three(&c[1]), three(&c[2])]).collect(),
            colors: self.colors.iter().map(three).collect(),
        }
    }

    /// The scene after `step`.
    fn moved(&self, scene: &Gaussians<f64>, step: f64) -> Gaussians<f64> {
        let mut out = scene.clone();
        for (p, v) in out.positions.iter_mut().flatten().zip(self.positions.iter().flatten()) {
            *p += step * v;
        }
        match &mut out.shape {
            Shape::Discs { axes } => {
                let velocities = self.axes.iter().flatten().flatten();
                axes.iter_mut().flatten().flatten().zip(velocities).for_each(|(a, v)| *a += step * v);
            }
            Shape::Ellipsoids { scales, .. } => scales.iter_mut().flatten().for_each(|s| *s *= 1.0 + 0.3 * step),
        }
        let stride = out.sh_stride();
        for (i, color) in self.colors.iter().enumerate() {
            // The constant basis function is 0.282...
            (0..3).for_each(|k| out.sh[i * stride + k] += step * color[k] / 0.28209479177387814);
        }
        out
    }
}

/// `R_k s_k` by a formula of its own.
fn columns_of(scene: &Gaussians<f64>, i: usize) -> [[f64; 3]; 3] {
    let Shape::Ellipsoids { rotations, scales } = &scene.shape else { unreachable!("asked of ellipsoids only") };
    let [w, x, y, z] = rotations[i];
    let turned = glam::DMat3::from_quat(glam::DQuat::from_xyzw(x, y, z, w).normalize());
    [0, 1, 2].map(|k| (turned.col(k) * scales[i][k]).to_array())
}

fn image(scene: &Gaussians<f64>, view: &View, settings: &Settings) -> Vec<f64> {
    Rasterizer::<f64>::new().render(scene, view, settings, None).unwrap().color.clone()
}

/// Relative L2 without the six values that are furthest off: where an alpha crosses 1/255 within the step, a difference
/// quotient is no derivative.
fn relative_but_for_jumps(a: &[f64], b: &[f64]) -> f64 {
    let mut squares: Vec<f64> = a.iter().zip(b).map(|(x, y)| (x - y).powi(2)).collect();
    squares.sort_by(f64::total_cmp);
    let norm = a.iter().map(|x| x * x).sum::<f64>();
    (squares[..squares.len() - 6].iter().sum::<f64>() / norm).sqrt()
}

fn slope(plus: &[f64], minus: &[f64]) -> Vec<f64> {
    plus.iter().zip(minus).map(|(p, m)| (p - m) / (2.0 * STEP)).collect()
}

fn unit(k: usize) -> [f64; 6] {
    let mut xi = [0.0; 6];
    xi[k] = 1.0;
    xi
}

#[test]
fn every_direction_equals_central_differences() {
    let (ewa, disc) = (Footprint::Ewa, Footprint::Disc);
    for (seed, kind, lens, degree, footprint) in [
        (41, Kind::Discs, Lens::Pinhole, 1, ewa),
        (42, Kind::Ellipsoids, Lens::Pinhole, 3, ewa),
        (43, Kind::Discs, Lens::Fisheye, 2, ewa),
        (44, Kind::Ellipsoids, Lens::Fisheye, 0, ewa),
        (45, Kind::Discs, Lens::Pinhole, 1, disc),
        (46, Kind::Ellipsoids, Lens::Pinhole, 3, disc),
        (47, Kind::Discs, Lens::Fisheye, 2, disc),
        (48, Kind::Ellipsoids, Lens::Fisheye, 1, disc),
    ] {
        let scene = random(25, kind, degree, seed);
        let velocities = Velocities::new(&scene, seed);
        let (view, settings) = (view(lens), Settings { footprint, ..settings() });
        let mut directions = vec![Direction::Motion(velocities.motion())];
        directions.extend((0..6).map(|k| Direction::Pose(unit(k))));
        directions.push(Direction::Gain([0.5, -1.0, 2.0]));
        let mut rasterizer = Rasterizer::<f64>::new();
        let tangents = rasterizer.render_tangent(&scene, &view, &settings, None, &directions).unwrap().to_vec();
        assert_eq!(rasterizer.rendered().color, image(&scene, &view, &settings), "the render itself changed");
        for (k, tangent) in tangents.iter().enumerate() {
            let at = |step: f64| match k {
                0 => image(&velocities.moved(&scene, step), &view, &settings),
                1..7 => image(&scene, &moved(&view, k - 1, step), &settings),
                _ => {
                    let mut settings = settings;
                    (0..3).for_each(|c| settings.gain[c] += step * [0.5, -1.0, 2.0][c]);
                    image(&scene, &view, &settings)
                }
            };
            let error = relative_but_for_jumps(tangent, &slope(&at(STEP), &at(-STEP)));
            assert!(error <= 1e-6, "scene {seed}, direction {k}: off by {error:e}");
        }
    }
}

/// `v . (J d) = (J^T v) . d`: forward and backward mode are two programs for one matrix.
#[test]
fn forward_mode_is_the_transpose_of_backward_mode() {
    for footprint in [Footprint::Ewa, Footprint::Disc] {
        transpose(Settings { footprint, ..settings() });
    }
}

fn transpose(settings: Settings) {
    let scene = random(60, Kind::Discs, 1, 51);
    let velocities = Velocities { colors: Vec::new(), ..Velocities::new(&scene, 51) };
    let view = view(Lens::Pinhole);
    let active: Vec<u32> = (0..60).filter(|i| i % 4 != 2).collect();
    let mut rasterizer = Rasterizer::<f64>::new();
    let xi = [0.1, -0.2, 0.3, 0.4, -0.5, 0.6];
    let directions = [Direction::Motion(velocities.motion()), Direction::Pose(xi)];
    let tangents = rasterizer.render_tangent(&scene, &view, &settings, Some(&active), &directions).unwrap().to_vec();
    let weights: Vec<f64> = (0..tangents[0].len()).map(|k| ((k * 7919) % 101) as f64 / 50.0 - 1.0).collect();
    let gradient = ImageGradient { color: &weights, ..ImageGradient::default() };
    let gradients = rasterizer.backward(&scene, &gradient, Wanted::ALL).unwrap();
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
    let by_motion: f64 = active
        .iter()
        .zip(gradients.positions.iter().zip(&gradients.axes))
        .map(|(&i, (position, axes))| {
            dot(position, &velocities.positions[i as usize])
                + dot(axes.as_flattened(), velocities.axes[i as usize].as_flattened())
        })
        .sum();
    for (tangent, backward) in tangents.iter().zip([by_motion, dot(&gradients.pose, &xi)]) {
        let forward = dot(tangent, &weights);
        assert!((forward - backward).abs() <= 1e-10 * forward.abs(), "{forward} forward, {backward} backward");
    }
}

/// Worst direction of every f32 kernel against f64.
fn f32_errors(scene: &Gaussians<f32>, view: &View, seed: u64) -> Vec<(Isa, usize, f64)> {
    let exact = scene.cast::<f64>();
    let velocities = Velocities::new(&exact, seed);
    let narrow = velocities.cast();
    let poses = (0..6).map(unit);
    let (mut wide_directions, mut directions) =
        (vec![Direction::Motion(velocities.motion())], vec![Direction::Motion(narrow.motion())]);
    wide_directions.extend(poses.clone().map(Direction::Pose));
    directions.extend(poses.map(Direction::Pose));
    let mut rasterizer = Rasterizer::<f64>::new();
    let truth = rasterizer.render_tangent(&exact, view, &settings(), None, &wide_directions).unwrap();
    let mut errors = Vec::new();
    for isa in available() {
        let mut rasterizer = Rasterizer::<f32>::with_isa(isa).unwrap();
        let found = rasterizer.render_tangent(scene, view, &settings(), None, &directions).unwrap();
        errors.extend(found.iter().zip(truth).enumerate().map(|(k, (f, t))| (isa, k, relative(&wide(f), t))));
        // One direction alone and among others: the same bytes.
        let all = found.to_vec();
        let alone = rasterizer.render_tangent(scene, view, &settings(), None, &directions[3..4]).unwrap();
        assert!(alone[0] == all[3], "{isa}: one direction alone gives other bytes than among others");
        // And the image is that of a plain render.
        let image = rasterizer.rendered().color.clone();
        let plain = rasterizer.render(scene, view, &settings(), None).unwrap();
        assert!(image == plain.color, "{isa}: a render with a direction gives another image than one without");
    }
    errors
}

#[test]
fn single_precision_tangents_equal_double() {
    for (seed, kind, lens) in
        [(61, Kind::Ellipsoids, Lens::Pinhole), (62, Kind::Discs, Lens::Fisheye), (63, Kind::Discs, Lens::Pinhole)]
    {
        let scene = random(60, kind, 1, seed).cast::<f32>();
        for (isa, k, error) in f32_errors(&scene, &view(lens), seed) {
            assert!(error <= 1e-4, "scene {seed}, {isa}, direction {k}: off by {error:e}");
        }
    }
}

#[test]
fn single_precision_tangents_equal_double_on_the_reference_scene() {
    let Some((tube, mut view)) = tube("tube_20k.npz", 256) else { return };
    for fisheye in [None, Some([-0.03, 0.002, 0.0, 0.0])] {
        view.camera.fisheye = fisheye;
        for (isa, k, error) in f32_errors(&tube, &view, 9) {
            println!("{fisheye:?}, {isa}, direction {k}: {error:.1e}");
            assert!(error <= 5e-4, "{fisheye:?}, {isa}, direction {k}: off by {error:e}");
        }
    }
}

#[test]
fn tangents_do_not_depend_on_threads() {
    let scene = random(300, Kind::Discs, 1, 77);
    let velocities = Velocities::new(&scene, 77).cast();
    let scene = scene.cast::<f32>();
    let run = |threads: usize| {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| {
            let directions = [Direction::Motion(velocities.motion()), Direction::Pose([1.0; 6])];
            let mut rasterizer = Rasterizer::<f32>::new();
            let view = view(Lens::Pinhole);
            rasterizer.render_tangent(&scene, &view, &settings(), None, &directions).unwrap().to_vec()
        })
    };
    let one = run(1);
    assert!(one == run(2) && one == run(8), "the number of threads changes the tangents");
}

#[test]
fn misuse_of_tangents_is_answered_in_a_sentence() {
    let scene = random(5, Kind::Discs, 1, 8);
    let view = view(Lens::Pinhole);
    let mut rasterizer = Rasterizer::<f64>::new();
    let mut refused = |direction: Direction<'_, f64>| {
        rasterizer.render_tangent(&scene, &view, &settings(), None, &[direction]).unwrap_err().to_string()
    };
    let three = [[0.0; 3]; 3];
    let short = Motion { positions: &three, ..Motion::default() };
    assert!(refused(Direction::Motion(short)).contains("one entry for each of the 5 Gaussians"));
    let columns = [[[0.0; 3]; 3]; 5];
    let wrong = Motion { columns: &columns, ..Motion::default() };
    assert!(refused(Direction::Motion(wrong)).contains("axes for discs"));
    assert!(refused(Direction::Pose([f64::NAN; 6])).contains("not finite"));
    assert!(refused(Direction::Gain([f64::INFINITY; 3])).contains("not finite"));
}
