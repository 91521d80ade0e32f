//! Whatever goes in: no panic, nothing but finite numbers out, or one sentence.

use respire_bench::base::Camera;
use respire_bench::splat::{
    DepthOutput, Filter, Footprint, Gaussians, Gradients, ImageGradient, Rasterizer, Settings, Shape, View, Wanted,
};

use super::forward::available;
use super::scenes::{Kind, Lens, Weights, flat, random, relative, rng, view, world_from_camera};

const POISON: [f32; 14] = [
    f32::NAN,
    -f32::NAN,
    f32::INFINITY,
    f32::NEG_INFINITY,
    1e38,
    -1e38,
    1e-40,
    1e-30,
    0.0,
    -0.0,
    1.0 / 255.0,
    16.0,
    1e10,
    -1.0,
];

fn poisoned(seed: u64) -> Gaussians<f32> {
    let r = &mut rng(&[9, seed]);
    let kind = if seed.is_multiple_of(2) { Kind::Ellipsoids } else { Kind::Discs };
    let mut scene = random(12, kind, (seed % 4) as u8, seed).cast::<f32>();
    for _ in 0..=r.index(6) {
        let value = POISON[r.index(POISON.len())];
        let (i, k) = (r.index(12), r.index(3));
        match (r.index(5), &mut scene.shape) {
            (0, _) => scene.positions[i][k] = value,
            (1, Shape::Ellipsoids { rotations, .. }) => rotations[i] = [value, 0.0, 0.0, 0.0],
            (2, Shape::Ellipsoids { scales, .. }) => scales[i][k] = value,
            (1 | 2, Shape::Discs { axes }) => axes[i][k % 2][k] = value,
            (3, _) => scene.opacities[i] = value,
            _ => {
                let at = r.index(scene.sh.len());
                scene.sh[at] = value;
            }
        }
    }
    scene
}

fn all_finite(g: &Gradients<f32>) -> bool {
    let vectors = g.positions.iter().chain(&g.scales).chain(g.axes.iter().flatten()).flatten();
    let rest = g.rotations.iter().flatten().chain(&g.opacities).chain(&g.sh).chain(&g.channels);
    let camera = g.pose.iter().chain(&g.gain).chain(&g.lens);
    vectors.chain(rest).all(|v| v.is_finite()) && camera.into_iter().all(|v| v.is_finite())
}

/// Their squares are beyond single precision; a power of two changes no digit of the images.
#[test]
fn quaternions_of_any_length_show_the_same() {
    let scene = random(60, Kind::Ellipsoids, 1, 7).cast::<f32>();
    let weights = Weights::<f32>::new(43 * 29, 1);
    for isa in available() {
        for (footprint, lens) in [(Footprint::Ewa, Lens::Pinhole), (Footprint::Disc, Lens::Fisheye)] {
            let settings = Settings { footprint, ..Settings::default() };
            let mut rasterizer = Rasterizer::<f32>::with_isa(isa).unwrap();
            let mut seen = |length: f32| {
                let mut scene = scene.clone();
                let Shape::Ellipsoids { rotations, .. } = &mut scene.shape else { unreachable!("asked for them") };
                // Others keep theirs, beside these in the same vectors.
                rotations.iter_mut().step_by(2).for_each(|q| *q = q.map(|v| v * length));
                let color = rasterizer.render(&scene, &view(lens), &settings, None).unwrap().color.clone();
                let gradients = rasterizer.backward(&scene, &weights.gradient(), Wanted::SHAPES).unwrap();
                let by: Vec<[f32; 4]> =
                    gradients.rotations.iter().step_by(2).map(|by| by.map(|v| v * length)).collect();
                (color, by, gradients.scales.clone())
            };
            let usual = seen(1.0);
            for exponent in [-110, -80, -73, 66, 83, 110] {
                let (color, by, scales) = seen(2f32.powi(exponent));
                assert!(color == usual.0 && scales == usual.2, "{isa}, {footprint:?}: 2^{exponent}");
                // Small gradients of large quaternions are denormal.
                let error = relative(&flat(&by), &flat(&usual.1));
                assert!(error < 1e-6, "{isa}, {footprint:?}: 2^{exponent}: {error}");
            }
        }
    }
}

#[test]
fn poisoned_scenes_stay_finite() {
    let weights = Weights::<f32>::new(43 * 29, 1);
    for isa in available() {
        let mut rasterizer = Rasterizer::<f32>::with_isa(isa).unwrap();
        for seed in 0..2500 {
            let scene = poisoned(seed);
            let lens = if seed % 5 == 0 { Lens::Fisheye } else { Lens::Pinhole };
            let footprint = if seed % 7 == 3 { Footprint::Disc } else { Footprint::Ewa };
            let filter = if seed % 7 == 5 { Filter::Compensate } else { Filter::Dilate };
            let depth = [DepthOutput::Expected, DepthOutput::Surface, DepthOutput::Median][seed as usize % 3];
            let settings = Settings { footprint, filter, depth, ..Settings::default() };
            let image = rasterizer.render(&scene, &view(lens), &settings, None).unwrap();
            let finite = image.color.iter().chain(&image.depth).chain(&image.alpha).all(|v| v.is_finite());
            assert!(finite, "{isa}, scene {seed}: image");
            let normals = scene.normals(&view(lens));
            let channels = rasterizer.render_channels(&normals, 3).unwrap();
            assert!(channels.iter().all(|v| v.is_finite()), "{isa}, scene {seed}: channels");
            let depth: &[f32] = if depth == DepthOutput::Expected { &weights.depth } else { &[] };
            let gradient = ImageGradient { depth, channels: &weights.color, ..weights.gradient() };
            let lens = if footprint == Footprint::Disc && lens == Lens::Fisheye { Wanted::NONE } else { Wanted::LENS };
            let wanted = Wanted::ALL | Wanted::CHANNELS | if seed % 2 == 0 { lens } else { Wanted::NONE };
            let gradients = rasterizer.backward(&scene, &gradient, wanted).unwrap();
            assert!(all_finite(gradients), "{isa}, scene {seed}: gradients");
        }
    }
}

#[test]
fn empty_and_tiny_scenes_render() {
    let mut rasterizer = Rasterizer::<f32>::new();
    let one_pixel = View::new(Camera::pinhole(1, 1, 1.0), world_from_camera());
    for n in [0, 1] {
        let scene = random(n, Kind::Discs, 0, 5).cast::<f32>();
        for view in [one_pixel, view(Lens::Pinhole)] {
            let pixels = (view.camera.width * view.camera.height) as usize;
            rasterizer.render(&scene, &view, &Settings::default(), None).unwrap();
            let weights = Weights::new(pixels, 1);
            let gradients = rasterizer.backward(&scene, &weights.gradient(), Wanted::ALL).unwrap();
            assert_eq!(gradients.positions.len(), n);
        }
        let image = rasterizer.render(&scene, &one_pixel, &Settings::default(), Some(&[])).unwrap();
        assert!(image.color == [0.0; 3] && image.visible.is_empty());
    }
}

/// No disc at all, none that takes part, none that is visible: a picture of the background on every kernel.
#[test]
fn exact_discs_without_a_visible_disc_render() {
    let settings = Settings { footprint: Footprint::Disc, background: [0.5; 3], ..Settings::default() };
    let view = view(Lens::Pinhole);
    let weights = Weights::<f32>::new(43 * 29, 1);
    let gradient = ImageGradient { depth: &[], ..weights.gradient() };
    let none = random(0, Kind::Discs, 0, 5).cast::<f32>();
    let mut broken = random(2, Kind::Ellipsoids, 0, 5).cast::<f32>();
    let Shape::Ellipsoids { rotations, .. } = &mut broken.shape else { unreachable!() };
    *rotations = vec![[0.0; 4], [f32::NAN; 4]];
    for isa in available() {
        for (scene, active) in [(&none, None), (&broken, Some(&[][..])), (&broken, None)] {
            let mut rasterizer = Rasterizer::<f32>::with_isa(isa).unwrap();
            let image = rasterizer.render(scene, &view, &settings, active).unwrap();
            assert!(image.visible_count == 0 && image.color.iter().all(|v| *v == 0.5), "{isa}");
            assert!(all_finite(rasterizer.backward(scene, &gradient, Wanted::ALL).unwrap()), "{isa}");
        }
    }
}

#[test]
fn what_lies_behind_or_outside_is_invisible() {
    let mut scene = random(3, Kind::Discs, 1, 6);
    let at = |x: f64, z: f64| world_from_camera().transform_point3(glam::DVec3::new(x, 0.0, z)).to_array();
    scene.positions = vec![at(0.0, -3.0), at(100.0, 3.0), at(0.0, 3.0)];
    scene.opacities = vec![0.9, 0.9, 1.0 / 256.0];
    let mut rasterizer = Rasterizer::<f64>::new();
    let image = rasterizer.render(&scene, &view(Lens::Pinhole), &Settings::default(), None).unwrap();
    assert!(image.visible == [false; 3] && image.color.iter().all(|&v| v == 0.0));
}

/// 3,000 Gaussians that each cover an image of 16384x16384 pixels: three billion entries of lists, which used to end in
/// an abort. Counted first, and refused on every kernel; the rasteriser goes on with what fits.
#[test]
fn lists_that_cannot_be_are_refused_before_they_are_made() {
    let vast = View::new(Camera::pinhole(16384, 16384, 1.5), glam::DAffine3::IDENTITY);
    let mut scene = Gaussians::<f32>::discs(3000, 0, 0.9);
    scene.positions = vec![[0.0, 0.0, 5.0]; 3000];
    scene.shape = Shape::Discs { axes: vec![[[50.0, 0.0, 0.0], [0.0, 50.0, 0.0]]; 3000] };
    let small = random(12, Kind::Discs, 0, 5).cast::<f32>();
    for isa in available() {
        let mut rasterizer = Rasterizer::<f32>::with_isa(isa).unwrap();
        let start = std::time::Instant::now();
        let refused = rasterizer.render(&scene, &vast, &Settings::default(), None).map(drop).unwrap_err();
        assert_eq!(refused.kind().exit_code(), 4);
        let said = refused.to_string();
        assert!(said.contains("the most") || said.contains("this machine has"), "{isa}: {said}");
        assert!(start.elapsed().as_secs() < 20, "{isa}: {:?}", start.elapsed());
        assert!(rasterizer.backward(&scene, &ImageGradient::default(), Wanted::ALL).is_err());
        let estimate = rasterizer.estimate(&scene, &vast, &Settings::default(), true).unwrap();
        assert!(estimate.memory_bytes > 1e11 && estimate.question().is_some(), "{isa}: {estimate}");
        let image = rasterizer.render(&small, &view(Lens::Pinhole), &Settings::default(), None).unwrap();
        assert!(image.visible_count > 0, "{isa}");
    }
}

/// An estimate counts what a render then has in its lists.
#[test]
fn an_estimate_counts_the_tiles_without_making_their_lists() {
    let scene = random(300, Kind::Discs, 1, 8).cast::<f32>();
    for isa in available() {
        let mut rasterizer = Rasterizer::<f32>::with_isa(isa).unwrap();
        let estimate = |r: &mut Rasterizer<f32>, scene: &Gaussians<f32>| {
            r.estimate(scene, &view(Lens::Pinhole), &Settings::default(), false).unwrap().memory_bytes
        };
        let none = random(0, Kind::Discs, 1, 8).cast::<f32>();
        let lists = estimate(&mut rasterizer, &scene) - estimate(&mut rasterizer, &none);
        let image = rasterizer.render(&scene, &view(Lens::Pinhole), &Settings::default(), None).unwrap();
        assert_eq!(lists, 10.0 * image.intersections as f64, "{isa}");
    }
}

#[test]
fn misuse_is_answered_in_a_sentence() {
    let scene = random(5, Kind::Discs, 1, 8).cast::<f32>();
    let mut rasterizer = Rasterizer::<f32>::new();
    let (view, settings) = (view(Lens::Pinhole), Settings::default());
    let none = ImageGradient::default();
    let sentence = |e: respire_bench::base::Error| e.to_string();
    assert!(rasterizer.backward(&scene, &none, Wanted::ALL).is_err(), "backward before any render");
    assert!(rasterizer.render(&scene, &view, &settings, Some(&[3, 1])).is_err());
    assert!(rasterizer.render(&scene, &view, &settings, Some(&[5])).is_err());
    let bad = Settings { near_mm: f64::NAN, ..settings };
    assert!(rasterizer.render(&scene, &view, &bad, None).is_err());
    let mut short = scene.clone();
    short.sh.pop();
    assert!(rasterizer.render(&short, &view, &settings, None).is_err());
    rasterizer.render(&scene, &view, &settings, None).unwrap();
    let mut color = vec![0.0; 43 * 29 * 3];
    color[3 * (2 * 43 + 7)] = f32::NAN;
    let image = ImageGradient { color: &color, ..none };
    let message = rasterizer.backward(&scene, &image, Wanted::ALL).map_err(sentence).unwrap_err();
    assert!(message.contains("pixel (7, 2)"), "{message}");
    let image = ImageGradient { color: &color[..9], ..none };
    assert!(rasterizer.backward(&scene, &image, Wanted::ALL).is_err());
}
