//! The forward pass against brute force in f64 (no tiles, no masks, other formulas) and against the reference scene.

use glam::{DMat2, DMat3, DQuat, DVec2, DVec3};
use respire_bench::splat::{Gaussians, Isa, Rasterizer, Rendered, Settings, Shape, View};

use super::scenes::{Kind, Lens, random, tube, view};
use crate::skip::shared;

/// Values of one pixel, and how close any of its decisions was (relative distance of alpha from 1/255, of the
/// transmittance from the stop).
struct Pixel {
    color: DVec3,
    depth: f64,
    alpha: f64,
    margin: f64,
}

/// EWA splatting by the book, pixel by pixel over all splats.
fn brute_force(g: &Gaussians<f64>, view: &View, settings: &Settings) -> Vec<Pixel> {
    let camera = view.camera;
    let rotation = view.camera_from_world.matrix3;
    let eye = view.camera_from_world.inverse().translation;
    // As gsplat has it: .15 of the image beyond its edges.
    let focal = DVec2::new(camera.fl_x, camera.fl_y);
    let (size, centre) = (DVec2::new(camera.width as f64, camera.height as f64), DVec2::new(camera.cx, camera.cy));
    let (low, high) = ((-centre - 0.15 * size) / focal, (size - centre + 0.15 * size) / focal);
    let mut splats = Vec::new();
    for i in 0..g.len() {
        let world = DVec3::from(g.positions[i]);
        let t = view.camera_from_world.transform_point3(world);
        if t.z < settings.near_mm {
            continue;
        }
        let covariance = match &g.shape {
            Shape::Ellipsoids { rotations, scales } => {
                let [w, x, y, z] = rotations[i];
                let m = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize());
                let s = DMat3::from_diagonal(DVec3::from(scales[i]).powf(2.0));
                m * s * m.transpose()
            }
            Shape::Discs { axes } => {
                let [a, b] = axes[i].map(DVec3::from);
                let outer = |v: DVec3| DMat3::from_cols(v * v.x, v * v.y, v * v.z);
                outer(a) + outer(b)
            }
        };
        // Jacobian by central differences of the camera itself: knows nothing of the closed form.
        let clamped = if camera.fisheye.is_none() {
            let slope = DVec2::new(t.x / t.z, t.y / t.z).clamp(low, high);
            DVec3::new(slope.x * t.z, slope.y * t.z, t.z)
        } else {
            t
        };
        let step = 1e-5;
        let column = |axis: DVec3| {
            (camera.project(clamped + axis * step).unwrap() - camera.project(clamped - axis * step).unwrap())
                / (2.0 * step)
        };
        let (jx, jy, jz) = (column(DVec3::X), column(DVec3::Y), column(DVec3::Z));
        let c = rotation * covariance * rotation.transpose();
        let project = |v: DVec3| jx * v.x + jy * v.y + jz * v.z;
        let rows = [project(c.x_axis), project(c.y_axis), project(c.z_axis)];
        let entry = |a: usize, b: usize| jx[b] * rows[0][a] + jy[b] * rows[1][a] + jz[b] * rows[2][a];
        let d = settings.dilation_px2;
        let cov2 = DMat2::from_cols_array(&[entry(0, 0) + d, entry(0, 1), entry(1, 0), entry(1, 1) + d]);
        let direction = (world - eye).normalize();
        let color = DVec3::from(color_degree_1(g, i, direction)).max(DVec3::ZERO);
        splats.push((t.z as f32, i, camera.project(t).unwrap(), cov2.inverse(), color, t.z, g.opacities[i]));
    }
    splats.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    (0..camera.width * camera.height)
        .map(|p| {
            let at = DVec2::new((p % camera.width) as f64 + 0.5, (p / camera.width) as f64 + 0.5);
            let (mut left, mut color, mut depth, mut margin) = (1.0, DVec3::ZERO, 0.0, f64::MAX);
            for (_, _, mean, conic, rgb, z, opacity) in &splats {
                let offset = at - *mean;
                let alpha = (opacity * (-0.5 * offset.dot(*conic * offset)).exp()).min(0.99);
                margin = margin.min((alpha * 255.0 - 1.0).abs());
                if alpha < 1.0 / 255.0 {
                    continue;
                }
                let next = left * (1.0 - alpha);
                margin = margin.min((next * 1e4 - 1.0).abs());
                if next <= 1e-4 {
                    break;
                }
                color += left * alpha * *rgb;
                depth += left * alpha * z;
                left = next;
            }
            let alpha = 1.0 - left;
            let color = (color + left * DVec3::from(settings.background)) * DVec3::from(settings.gain);
            Pixel { color, depth: if alpha > 0.0 { depth / alpha } else { 0.0 }, alpha, margin }
        })
        .collect()
}

fn color_degree_1(g: &Gaussians<f64>, i: usize, d: DVec3) -> [f64; 3] {
    assert_eq!(g.sh_degree, 1);
    [0, 1, 2].map(|k| {
        let h = |n: usize| g.sh[(i * 4 + n) * 3 + k];
        0.5 + 0.28209479177387814 * h(0) + 0.4886025119029199 * (-d.y * h(1) + d.z * h(2) - d.x * h(3))
    })
}

/// Worst differences of colour, alpha (absolute) and depth (relative) where no decision hangs by a thread.
fn worst<T: respire_bench::splat::SplatKernels>(image: &Rendered<T>, truth: &[Pixel]) -> f64 {
    let mut worst = 0f64;
    let mut compared = 0;
    for (p, pixel) in truth.iter().enumerate().filter(|(_, pixel)| pixel.margin > 1e-3) {
        compared += 1;
        for k in 0..3 {
            worst = worst.max((image.color[3 * p + k].to_f64() - pixel.color[k]).abs());
        }
        worst = worst.max((image.alpha[p].to_f64() - pixel.alpha).abs());
        worst = worst.max((image.depth[p].to_f64() - pixel.depth).abs() / pixel.depth.max(1.0));
    }
    assert!(compared * 2 > truth.len(), "only {compared} of {} pixels could be compared", truth.len());
    worst
}

const ISAS: [Isa; 4] = [Isa::Scalar, Isa::Baseline, Isa::Avx2, Isa::Avx512];

/// Every kernel that this processor runs.
pub fn available() -> impl Iterator<Item = Isa> {
    ISAS.into_iter().filter(|isa| isa.available().is_ok())
}

#[test]
fn forward_equals_brute_force() {
    let settings = Settings { background: [0.2, 0.1, 0.4], gain: [0.9, 1.1, 1.3], ..Settings::default() };
    for seed in 0..200 {
        let n = [1, 7, 30, 80, 200][seed as usize % 5];
        let kind = if seed % 2 == 0 { Kind::Ellipsoids } else { Kind::Discs };
        let lens = if seed % 3 == 0 { Lens::Fisheye } else { Lens::Pinhole };
        let scene = random(n, kind, 1, seed).cast::<f32>().cast::<f64>();
        let view = view(lens);
        let truth = brute_force(&scene, &view, &settings);
        let mut exact = Rasterizer::<f64>::new();
        let error = worst(exact.render(&scene, &view, &settings, None).unwrap(), &truth);
        assert!(error < 1e-7, "scene {seed}, f64: {error:e}");
        for isa in available() {
            let mut rasterizer = Rasterizer::<f32>::with_isa(isa).unwrap();
            let error = worst(rasterizer.render(&scene.cast(), &view, &settings, None).unwrap(), &truth);
            assert!(error < 2e-5, "scene {seed}, {isa}: {error:e}");
        }
    }
}

#[test]
fn the_reference_scene_gives_the_reference_figures() {
    let Some((tube, view)) = tube("tube_20k.npz", 256) else { return };
    let Some(path) = shared("reference/splat/ref_expected.json") else { return };
    let expected: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
    let expected = &expected["tube_20k_256"];
    for isa in available() {
        let mut rasterizer = Rasterizer::<f32>::with_isa(isa).unwrap();
        let image = rasterizer.render(&tube, &view, &Settings::default(), None).unwrap();
        let near = |value: f64, key: &str, tolerance: f64| {
            let truth = expected[key].as_f64().unwrap();
            assert!((value - truth).abs() <= tolerance, "{isa}: {key} is {value}, not {truth}");
        };
        near(image.visible_count as f64, "visible", 2.0);
        let mean = image.color.iter().map(|&v| v as f64).sum::<f64>() / image.color.len() as f64;
        near(mean, "img_mean", 2e-6);
        let left = image.alpha.iter().map(|&v| 1.0 - v as f64).sum::<f64>() / image.alpha.len() as f64;
        near(left, "mean_T", 2e-6);
        // What the lists hold is less than what boxes meet: a box may reach into a tile, and no pixel centre be in it.
        let entries = image.intersections;
        let boxes = rasterizer.box_intersections();
        near(boxes as f64, "isect_t16", 10.0);
        assert!(entries < boxes && 10 * entries > 9 * boxes, "{isa}: {entries} entries for {boxes}");
    }
}

#[test]
fn images_do_not_depend_on_threads_or_on_idle_neighbours() {
    let scene = random(300, Kind::Discs, 1, 77).cast::<f32>();
    let active: Vec<u32> = (0..300).filter(|i| i % 3 != 1).collect();
    let view = view(Lens::Pinhole);
    let weights = super::scenes::Weights::<f32>::new(43 * 29, 5);
    let run = |threads: usize| {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| {
            let mut rasterizer = Rasterizer::<f32>::new();
            let image = rasterizer.render(&scene, &view, &Settings::default(), Some(&active)).unwrap().clone();
            let gradients =
                rasterizer.backward(&scene, &weights.gradient(), respire_bench::splat::Wanted::ALL).unwrap();
            (format!("{:?}", image), format!("{gradients:?}"))
        })
    };
    let one = run(1);
    assert!(one == run(2) && one == run(8), "the number of threads changes the result");
}

#[test]
fn depth_ties_go_by_index() {
    // Two discs in one place: the first in the list covers the second.
    let mut scene = random(2, Kind::Discs, 1, 3);
    scene.positions[1] = scene.positions[0];
    let place = super::scenes::world_from_camera().transform_point3(DVec3::new(0.0, 0.0, 4.0)).to_array();
    scene.positions = vec![place; 2];
    scene.shape = Shape::Discs { axes: vec![[[2.0, 0.0, 0.0], [0.0, 2.0, 0.0]]; 2] };
    scene.opacities = vec![0.9; 2];
    scene.sh = vec![0.0; 24];
    scene.sh[0] = 1.5;
    scene.sh[12 + 2] = 1.5;
    let mut rasterizer = Rasterizer::<f32>::new();
    let image = rasterizer.render(&scene.cast(), &view(Lens::Pinhole), &Settings::default(), None).unwrap();
    let center = 3 * (14 * 43 + 21);
    assert!(image.color[center] > image.color[center + 2] + 0.2, "{:?}", &image.color[center..center + 3]);
}

#[test]
fn the_order_of_the_list_does_not_matter() {
    for seed in 0..20 {
        let scene = random(150, Kind::Discs, 1, 300 + seed).cast::<f32>();
        let mut order: Vec<usize> = (0..150).collect();
        let r = &mut super::scenes::rng(&[17, seed]);
        (1..150).rev().for_each(|i| order.swap(i, r.index(i + 1)));
        let Shape::Discs { axes } = &scene.shape else { unreachable!("discs are asked for") };
        let shuffled = Gaussians {
            positions: order.iter().map(|&i| scene.positions[i]).collect(),
            shape: Shape::Discs { axes: order.iter().map(|&i| axes[i]).collect() },
            opacities: order.iter().map(|&i| scene.opacities[i]).collect(),
            sh: order.iter().flat_map(|&i| scene.sh[12 * i..12 * i + 12].to_vec()).collect(),
            sh_degree: 1,
        };
        for isa in available() {
            let run = |scene: &Gaussians<f32>| {
                let mut rasterizer = Rasterizer::<f32>::with_isa(isa).unwrap();
                let image = rasterizer.render(scene, &view(Lens::Pinhole), &Settings::default(), None).unwrap().clone();
                (image, rasterizer.contributors().unwrap())
            };
            let ((a, blended), (b, shuffled)) = (run(&scene), run(&shuffled));
            let worst = a.color.iter().zip(&b.color).map(|(x, y)| (x - y).abs()).fold(0.0, f32::max);
            assert!(worst <= 1e-6, "scene {seed}, {isa}: {worst:e}");
            assert_eq!(blended, shuffled, "scene {seed}, {isa}: other Gaussians are blended");
        }
    }
}
