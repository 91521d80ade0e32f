//! Exact discs: the forward pass against rays met by the book, against EWA where both must agree, and where EWA fails.

use glam::{DMat3, DVec2, DVec3};
use respire_bench::base::Camera;
use respire_bench::splat::{DepthOutput, Footprint, Gaussians, Isa, Rasterizer, Settings, Shape, SplatKernels, View};

use super::forward::available;
use super::scenes::{Kind, Lens, random, tube, view};

const DISC: Settings = Settings {
    footprint: Footprint::Disc,
    near_mm: 0.2,
    dilation_px2: 0.3,
    filter: respire_bench::splat::Filter::Dilate,
    gain: [0.9, 1.1, 1.3],
    background: [0.2, 0.1, 0.4],
    depth: DepthOutput::Expected,
};

struct Pixel {
    color: DVec3,
    depth: f64,
    alpha: f64,
    /// How near any decision was, relative to its threshold.
    margin: f64,
}

/// Every ray against every disc: a linear system per pair, no tiles, no boxes.
fn brute_force(g: &Gaussians<f64>, view: &View, settings: &Settings) -> Vec<Pixel> {
    let camera = view.camera;
    let eye = view.camera_from_world.inverse().translation;
    let mut discs = Vec::new();
    for i in 0..g.len() {
        let world = DVec3::from(g.positions[i]);
        let t = view.camera_from_world.transform_point3(world);
        let Shape::Discs { axes } = &g.shape else { unreachable!("discs are asked for") };
        let [a, b] = axes[i].map(|axis| view.camera_from_world.transform_vector3(DVec3::from(axis)));
        if t.z >= settings.near_mm {
            let d = (world - eye).normalize();
            let rgb = [0, 1, 2].map(|k| {
                let h = |n: usize| g.sh[(i * 4 + n) * 3 + k];
                0.5 + 0.28209479177387814 * h(0) + 0.4886025119029199 * (-d.y * h(1) + d.z * h(2) - d.x * h(3))
            });
            discs.push((t.z as f32, i, t, a, b, DVec3::from(rgb).max(DVec3::ZERO), g.opacities[i]));
        }
    }
    discs.sort_by(|x, y| x.0.total_cmp(&y.0).then(x.1.cmp(&y.1)));
    let pixels = (0..camera.width * camera.height).map(|p| {
        let at = DVec2::new((p % camera.width) as f64 + 0.5, (p / camera.width) as f64 + 0.5);
        let ray = camera.direction(at);
        let (mut left, mut color, mut depth, mut margin) = (1.0, DVec3::ZERO, 0.0, f64::MAX);
        for (_, _, t, a, b, rgb, opacity) in &discs {
            let solved = DMat3::from_cols(*a, *b, -ray).inverse() * -*t;
            let z = solved.z * ray.z;
            let on_plane = solved.x * solved.x + solved.y * solved.y;
            let on_screen = (at - camera.project(*t).unwrap()).length_squared() / settings.dilation_px2;
            let met = z >= settings.near_mm && on_plane <= on_screen;
            margin = margin.min((z / settings.near_mm - 1.0).abs());
            let alpha = (opacity * (-0.5 * if met { on_plane } else { on_screen }).exp()).min(0.99);
            margin = margin.min((alpha * 255.0 - 1.0).abs());
            if alpha < 1.0 / 255.0 {
                continue;
            }
            // The depth jumps between the point met and the centre.
            margin = margin.min((on_plane / on_screen - 1.0).abs());
            let next = left * (1.0 - alpha);
            margin = margin.min((next * 1e4 - 1.0).abs());
            if next <= 1e-4 {
                break;
            }
            color += left * alpha * *rgb;
            depth += left * alpha * if met { z } else { t.z };
            left = next;
        }
        let alpha = 1.0 - left;
        let color = (color + left * DVec3::from(settings.background)) * DVec3::from(settings.gain);
        Pixel { color, depth: if alpha > 0.0 { depth / alpha } else { 0.0 }, alpha, margin }
    });
    pixels.collect()
}

fn worst<T: SplatKernels>(isa: Isa, scene: &Gaussians<f64>, view: &View, truth: &[Pixel]) -> f64 {
    let mut rasterizer = Rasterizer::<T>::with_isa(isa).unwrap();
    let image = rasterizer.render(&scene.cast(), view, &DISC, None).unwrap();
    let (mut worst, mut compared) = (0f64, 0);
    for (p, pixel) in truth.iter().enumerate().filter(|(_, pixel)| pixel.margin > 1e-3) {
        compared += 1;
        (0..3).for_each(|k| worst = worst.max((image.color[3 * p + k].to_f64() - pixel.color[k]).abs()));
        worst = worst.max((image.alpha[p].to_f64() - pixel.alpha).abs());
        worst = worst.max((image.depth[p].to_f64() - pixel.depth).abs() / pixel.depth.max(1.0));
    }
    assert!(compared * 3 > truth.len(), "only {compared} of {} pixels could be compared", truth.len());
    worst
}

#[test]
fn forward_equals_rays_met_one_by_one() {
    let mut worst_single: Vec<(Isa, f64)> = available().map(|isa| (isa, 0.0)).collect();
    for seed in 0..200 {
        let n = [1, 5, 20, 50][seed as usize % 4];
        let lens = if seed % 3 == 0 { Lens::Fisheye } else { Lens::Pinhole };
        let scene = random(n, Kind::Discs, 1, 700 + seed).cast::<f32>().cast::<f64>();
        let truth = brute_force(&scene, &view(lens), &DISC);
        let error = worst::<f64>(Isa::Scalar, &scene, &view(lens), &truth);
        assert!(error < 1e-8, "scene {seed}, f64: {error:e}");
        for (isa, most) in &mut worst_single {
            *most = most.max(worst::<f32>(*isa, &scene, &view(lens), &truth));
        }
    }
    for (isa, worst) in worst_single {
        println!("f32, {isa}: worst {worst:.1e}");
        assert!(worst < 1e-4, "f32, {isa}: {worst:e}");
    }
}

/// On the tube 20,000 discs are small enough that the affine projection is a fair one: 44 dB apart in
/// `../shared/reference/splat/PEERS.md` without filters.
#[test]
fn discs_and_ewa_agree_on_the_tube() {
    let Some((tube, view)) = tube("tube_20k.npz", 256) else { return };
    let image = |footprint, dilation_px2| {
        let settings = Settings { footprint, dilation_px2, ..Settings::default() };
        Rasterizer::<f32>::new().render(&tube, &view, &settings, None).unwrap().color.clone()
    };
    let decibels = |dilation| {
        let (a, b) = (image(Footprint::Ewa, dilation), image(Footprint::Disc, dilation));
        let square = a.iter().zip(&b).map(|(x, y)| f64::from(x - y).powi(2)).sum::<f64>() / a.len() as f64;
        -10.0 * square.log10()
    };
    let (bare, filtered) = (decibels(0.0), decibels(0.3));
    println!("EWA against exact discs: {bare:.1} dB without filters, {filtered:.1} dB with");
    assert!((40.0..48.0).contains(&bare), "{bare}");
    assert!((32.0..46.0).contains(&filtered), "{filtered}");
}

/// One wide disc as a floor, 85 degrees off the view: its outline and depth are those of the plane, to the last pixel.
#[test]
fn a_grazing_disc_keeps_its_plane() {
    let view = View::new(Camera::pinhole(64, 64, 1.5), glam::DAffine3::IDENTITY);
    let mut floor = Gaussians::<f64>::discs(1, 0, 0.9);
    floor.positions = vec![[0.0, 1.0, 12.0]];
    floor.shape = Shape::Discs { axes: vec![[[3.0, 0.0, 0.0], [0.0, 0.0, 3.0]]] };
    let at = |footprint, x: usize, y: usize| {
        let settings = Settings { footprint, ..Settings::default() };
        let mut rasterizer = Rasterizer::<f64>::new();
        let image = rasterizer.render(&floor, &view, &settings, None).unwrap();
        (image.alpha[64 * y + x], image.depth[64 * y + x])
    };
    let mut worst_ewa = 0f64;
    for (x, y) in [(32, 35), (32, 36), (32, 37), (25, 36), (40, 37)] {
        let ray = view.camera.direction(DVec2::new(x as f64 + 0.5, y as f64 + 0.5));
        let point = ray / ray.y;
        let truth = 0.9 * (-0.5 * ((point.x / 3.0).powi(2) + ((point.z - 12.0) / 3.0).powi(2))).exp();
        let (alpha, depth) = at(Footprint::Disc, x, y);
        if truth > 0.1 {
            assert!((alpha - truth).abs() < 1e-9 && (depth - point.z).abs() < 1e-9, "({x}, {y}): {alpha} {truth}");
        }
        worst_ewa = worst_ewa.max((at(Footprint::Ewa, x, y).0 - truth).abs());
    }
    assert!(worst_ewa > 0.05, "EWA would do here: the test is blind");
}
