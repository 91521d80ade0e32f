//! What is taken over from the render before, and what lies out of sight: neither may change a bit.

use respire_bench::splat::{
    DepthOutput, Gaussians, Isa, Rasterizer, Reuse, Settings, Shape, SplatKernels, View, Wanted,
};

use super::scenes::{Kind, Lens, Weights, random, rng, view};

const PIXELS: usize = 43 * 29;

/// Images and gradients as bits; `Debug` writes enough digits to tell any two numbers apart.
fn pass<T: SplatKernels>(r: &mut Rasterizer<T>, scene: &Gaussians<T>, view: &View, settings: &Settings) -> String {
    let weights = Weights::<T>::new(PIXELS, 5);
    let image = format!("{:?}", r.render(scene, view, settings, None).unwrap());
    let gradients = r.backward(scene, &weights.gradient(), Wanted::ALL).unwrap();
    image + &format!("{gradients:?}")
}

fn repaint<T: SplatKernels>(scene: &mut Gaussians<T>, key: u64) {
    let mut r = rng(&[9, key]);
    scene.sh.iter_mut().for_each(|v| *v = T::of(0.3 * r.normal()));
}

fn repainted_equals_fresh<T: SplatKernels>(isa: Isa, lens: Lens, kind: Kind, degree: u8) {
    let mut scene = random(150, kind, degree, 61).cast::<T>();
    let view = view(lens);
    let mut kept = Rasterizer::<T>::with_isa(isa).unwrap();
    kept.reuse(Reuse::Unchanged);
    for step in 0..4 {
        repaint(&mut scene, step);
        let settings =
            Settings { gain: [1.0, 0.9 + 0.1 * step as f64, 1.1], background: [0.1; 3], ..Settings::default() };
        if step == 2 {
            // What is not a colour has changed: nothing may be left of before.
            scene.positions[7][0] += T::of(0.3);
        }
        let fresh = pass(&mut Rasterizer::<T>::with_isa(isa).unwrap(), &scene, &view, &settings);
        assert!(pass(&mut kept, &scene, &view, &settings) == fresh, "{isa}, degree {degree}, step {step}");
    }
}

#[test]
fn a_repainted_scene_equals_a_fresh_one_bit_for_bit() {
    for isa in [Isa::Scalar, Isa::Baseline, Isa::Avx2, Isa::Avx512].into_iter().filter(|isa| isa.available().is_ok()) {
        for degree in 0..=3 {
            repainted_equals_fresh::<f32>(isa, Lens::Pinhole, Kind::Discs, degree);
        }
        repainted_equals_fresh::<f32>(isa, Lens::Pinhole, Kind::Ellipsoids, 1);
        repainted_equals_fresh::<f32>(isa, Lens::Fisheye, Kind::Discs, 1);
    }
    repainted_equals_fresh::<f64>(Isa::Scalar, Lens::Pinhole, Kind::Ellipsoids, 2);
}

/// A depth image that nobody asks for is not written again while it is 0: whatever was rendered before, it is 0.
fn depth_equals_fresh<T: SplatKernels>(isa: Isa) {
    use DepthOutput::{Expected, Median, Skip, Surface};
    let scene = random(60, Kind::Discs, 0, 64).cast::<T>();
    let mut kept = Rasterizer::<T>::with_isa(isa).unwrap();
    let asked = [Skip, Skip, Expected, Skip, Median, Skip, Skip, Surface, Skip, Expected, Expected, Skip, Skip];
    for (step, depth) in asked.into_iter().enumerate() {
        let mut view = view(Lens::Pinhole);
        if step % 5 == 4 {
            view.camera.height -= 6;
        }
        let settings = Settings { depth, ..Settings::default() };
        let fresh =
            Rasterizer::<T>::with_isa(isa).unwrap().render(&scene, &view, &settings, None).unwrap().depth.clone();
        let rendered = kept.render(&scene, &view, &settings, None).unwrap();
        assert!(rendered.depth == fresh, "{isa}, step {step}");
        assert_eq!(fresh.iter().any(|v| v.to_f64() > 0.0), depth != Skip, "{isa}, step {step}");
    }
}

#[test]
fn a_depth_that_nobody_asks_for_is_zero() {
    for isa in [Isa::Scalar, Isa::Baseline].into_iter().filter(|isa| isa.available().is_ok()) {
        depth_equals_fresh::<f32>(isa);
    }
    depth_equals_fresh::<f64>(Isa::Scalar);
}

#[test]
fn reuse_notices_every_change() {
    let scene = random(80, Kind::Discs, 1, 62).cast::<f32>();
    let (plain, settings) = (view(Lens::Pinhole), Settings::default());
    type Change = fn(&mut Gaussians<f32>, &mut View, &mut Settings);
    let changes: [(&str, Change); 6] = [
        ("opacity", |g, _, _| g.opacities[3] *= 0.5),
        ("shape", |g, _, _| {
            let Shape::Discs { axes } = &mut g.shape else { unreachable!() };
            axes[5][1][2] += 0.2;
        }),
        ("camera", |_, v, _| v.camera.cx += 1.0),
        ("pose", |_, v, _| v.camera_from_world.translation.x += 0.1),
        ("dilation", |_, _, s| s.dilation_px2 = 0.6),
        ("a colour that is not finite", |g, _, _| g.sh[25] = f32::NAN),
    ];
    for (name, change) in changes {
        let (mut scene, mut view, mut settings) = (scene.clone(), plain, settings);
        let mut kept = Rasterizer::<f32>::new();
        kept.reuse(Reuse::Unchanged);
        let before = pass(&mut kept, &scene, &view, &settings);
        change(&mut scene, &mut view, &mut settings);
        let fresh = pass(&mut Rasterizer::<f32>::new(), &scene, &view, &settings);
        assert!(before != fresh, "{name}: the change shows");
        assert!(pass(&mut kept, &scene, &view, &settings) == fresh, "{name}");
    }
}

/// Thousands of neighbours behind and beside the camera: the same image and gradients, and zeros for them, also after they
/// were in view once.
#[test]
fn what_is_out_of_sight_changes_nothing() {
    let scene = random(200, Kind::Ellipsoids, 1, 63).cast::<f32>();
    let view = view(Lens::Pinhole);
    let mut tree = scene.clone();
    let copy = |from: &Gaussians<f32>, to: &mut Gaussians<f32>, shift: glam::DVec3| {
        let (Shape::Ellipsoids { rotations, scales }, Shape::Ellipsoids { rotations: r, scales: s }) =
            (&from.shape, &mut to.shape)
        else {
            unreachable!()
        };
        r.extend_from_slice(rotations);
        s.extend_from_slice(scales);
        to.positions.extend(from.positions.iter().map(|p| [0, 1, 2].map(|k| p[k] + shift[k] as f32)));
        to.opacities.extend_from_slice(&from.opacities);
        to.sh.extend_from_slice(&from.sh);
    };
    let back = view.camera_from_world.inverse().matrix3;
    for k in 0..30 {
        let shift =
            if k % 2 == 0 { glam::DVec3::new(0.0, 0.0, -40.0 - k as f64) } else { glam::DVec3::new(90.0, 0.0, 0.0) };
        copy(&scene, &mut tree, back * shift);
    }
    let settings = Settings::default();
    let weights = Weights::<f32>::new(PIXELS, 5);
    let (mut alone, mut among) = (Rasterizer::<f32>::new(), Rasterizer::<f32>::new());
    let mut turned = view;
    turned.camera_from_world = glam::DAffine3::from_rotation_y(std::f64::consts::PI) * view.camera_from_world;
    for round in 0..2 {
        let image = alone.render(&scene, &view, &settings, None).unwrap().clone();
        let found = among.render(&tree, &view, &settings, None).unwrap();
        assert!(image.color == found.color && image.alpha == found.alpha && found.visible_count == image.visible_count);
        let expected = alone.backward(&scene, &weights.gradient(), Wanted::ALL).unwrap();
        let found = among.backward(&tree, &weights.gradient(), Wanted::ALL).unwrap();
        assert!(found.positions[..200] == expected.positions && found.sh[..200 * 12] == expected.sh, "round {round}");
        assert!(found.positions[200..].iter().flatten().chain(&found.sh[200 * 12..]).all(|&v| v == 0.0));
        assert!(found.rotations[200..].iter().flatten().chain(&found.opacities[200..]).all(|&v| v == 0.0));
        let behind = among.render(&tree, &turned, &settings, None).unwrap().visible_count;
        assert!(behind > 0, "the neighbours are in view once");
        among.backward(&tree, &weights.gradient(), Wanted::ALL).unwrap();
    }
}

/// A wall in front of everything that comes and goes: what it hides has no gradients, is said to have none, and is not
/// written again; what it shows again has them all.
#[test]
fn what_is_hidden_is_said_to_have_no_gradients_and_has_none() {
    for isa in [Isa::Scalar, Isa::Baseline, Isa::Avx2, Isa::Avx512].into_iter().filter(|isa| isa.available().is_ok()) {
        let view = view(Lens::Pinhole);
        let mut scene = random(400, Kind::Discs, 1, 65).cast::<f32>();
        let pose = view.camera_from_world.inverse();
        let eye = pose.translation.as_vec3();
        let forward = pose.matrix3.z_axis.as_vec3();
        let mut kept = Rasterizer::<f32>::with_isa(isa).unwrap();
        for (step, is_there) in [false, true, true, false, true].into_iter().enumerate() {
            // Four opaque discs of a metre, a millimetre before the eye; or behind it.
            for k in 0..4 {
                let away = if is_there { 1.0 + 0.01 * k as f32 } else { -1.0 };
                scene.positions[k] = (eye + forward * away).to_array();
                scene.opacities[k] = 0.99;
                let Shape::Discs { axes } = &mut scene.shape else { unreachable!("made of discs") };
                axes[k] = [pose.matrix3.x_axis, pose.matrix3.y_axis].map(|axis| (axis.as_vec3() * 1000.0).to_array());
            }
            let mut fresh = Rasterizer::<f32>::with_isa(isa).unwrap();
            let settings = Settings::default();
            let said = pass(&mut kept, &scene, &view, &settings);
            assert!(said == pass(&mut fresh, &scene, &view, &settings), "{isa}, step {step}");
            let gradients = kept.gradients();
            let unheard: Vec<usize> = (0..scene.len()).filter(|&k| gradients.is_unheard(k)).collect();
            let Shape::Discs { .. } = scene.shape else { unreachable!("made of discs") };
            assert!(unheard.iter().all(|&k| {
                let geometry = gradients.positions[k].iter().chain(gradients.axes[k].as_flattened());
                geometry.chain(&gradients.sh[k * 12..][..12]).chain([&gradients.opacities[k]]).all(|g| *g == 0.0)
            }));
            // The plain twin does not look.
            assert_eq!(unheard.len() > 300, is_there && isa != Isa::Scalar, "{isa}, step {step}: {}", unheard.len());
        }
    }
}
