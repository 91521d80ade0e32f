//! What a pass leaves out must not be seen: each skip switched off, on every kernel, against the default.

use glam::DVec3;
use respire_bench::splat::{
    Filter, Gaussians, Gradients, ImageGradient, Isa, Rasterizer, Settings, Shape, Skips, SplatKernels, View, Wanted,
};

use super::forward::available;
use super::scenes::{Kind, Lens, random, relative, view, wide, world_from_camera};

fn pass<T: SplatKernels>(
    isa: Isa,
    scene: &Gaussians<T>,
    view: &View,
    settings: &Settings,
    skips: Skips,
) -> (Vec<T>, Gradients<T>) {
    let mut rasterizer = Rasterizer::<T>::with_isa(isa).unwrap();
    rasterizer.skips(skips);
    let image = rasterizer.render(scene, view, settings, None).unwrap().color.clone();
    let weights: Vec<T> = (0..image.len()).map(|k| T::of(((k * 7919) % 101) as f64 / 50.0 - 1.0)).collect();
    let gradient = ImageGradient { color: &weights, ..ImageGradient::default() };
    (image, rasterizer.backward(scene, &gradient, Wanted::ALL).unwrap().clone())
}

/// Positions, axes, opacities, SH and pose, one after the other.
fn all<T: SplatKernels>(g: &Gradients<T>) -> [Vec<f64>; 5] {
    let axes = g.axes.as_flattened().as_flattened();
    [wide(g.positions.as_flattened()), wide(axes), wide(&g.opacities), wide(&g.sh), g.pose.to_vec()]
}

/// Largest change of a value without the stop.
fn nothing_is_lost<T: SplatKernels>(isa: Isa, lens: Lens, filter: Filter) -> f64 {
    // Dense enough that pixels stop, wide enough that many lie beside the image.
    let scene = random(400, Kind::Discs, 1, 31).cast::<f32>().cast::<T>();
    let (view, settings) = (view(lens), Settings { filter, ..Settings::default() });
    let (image, gradients) = pass(isa, &scene, &view, &settings, Skips::ALL);
    let exact = [Skips::EXTENTS, Skips::BLOCKS, Skips::BESIDE];
    for off in exact {
        let (found, by_all) = pass(isa, &scene, &view, &settings, Skips::ALL.without(off));
        assert!(found == image, "{isa}: without {off:?} the image is another");
        for (group, (a, b)) in all(&by_all).iter().zip(&all(&gradients)).enumerate() {
            assert!(relative(a, b) <= 1e-6, "{isa}: without {off:?}, group {group}: {:e}", relative(a, b));
        }
    }
    let (found, _) = pass(isa, &scene, &view, &settings, Skips::ALL.without(Skips::STOP));
    let largest = found.iter().zip(&image).map(|(a, b)| (a.to_f64() - b.to_f64()).abs()).fold(0.0, f64::max);
    assert!(largest < 1e-3, "{isa}: light beyond the stop changes {largest:e}");
    largest
}

#[test]
fn what_is_skipped_cannot_be_seen() {
    for isa in available() {
        // Some pixels of this scene stop; seen otherwise none may.
        assert!(nothing_is_lost::<f32>(isa, Lens::Pinhole, Filter::Dilate) > 0.0);
        nothing_is_lost::<f32>(isa, Lens::Fisheye, Filter::Dilate);
    }
    nothing_is_lost::<f32>(Isa::widest(), Lens::Pinhole, Filter::Compensate);
    nothing_is_lost::<f64>(Isa::Scalar, Lens::Fisheye, Filter::Dilate);
}

/// Discs of all sizes around the edge of what a camera sees, ordered by their angle so that whole groups lie beside: no
/// splat that reaches the image may be left early, whatever the lens.
#[test]
fn what_is_beside_reaches_no_pixel() {
    let lenses = [[0.0; 4], [0.05, -0.02, 0.01, -0.003], [-0.12, 0.01, 0.0, 0.0], [0.3, 0.0, 0.0, 0.0]];
    let views = lenses.iter().map(|&lens| {
        let mut view = view(Lens::Fisheye);
        view.camera.fisheye = Some(lens);
        view
    });
    for (number, view) in views.chain([view(Lens::Pinhole)]).enumerate() {
        let mut scene = random(0, Kind::Discs, 0, 1);
        let mut axes = Vec::new();
        for k in 0..6000usize {
            let (angle, turn) = (1.55 * k as f64 / 6000.0, 2.4 * k as f64);
            let (distance, size) = (1.0 + (k % 7) as f64, 0.02 * 3f64.powi((k / 16 % 5) as i32));
            let ray = DVec3::new(angle.sin() * turn.cos(), angle.sin() * turn.sin(), angle.cos());
            let across = DVec3::new(-turn.sin(), turn.cos(), 0.0);
            let world = world_from_camera();
            let axis = |v: DVec3| (size * world.transform_vector3(v)).to_array();
            scene.positions.push(world.transform_point3(distance * ray).to_array());
            axes.push([axis(across), axis(ray.cross(across))]);
            scene.opacities.push(1.0);
            scene.sh.extend([0.3; 3]);
        }
        scene.shape = Shape::Discs { axes };
        let scene = scene.cast::<f32>();
        for isa in available() {
            let visible = |skips: Skips| {
                let mut rasterizer = Rasterizer::<f32>::with_isa(isa).unwrap();
                rasterizer.skips(skips);
                rasterizer.render(&scene, &view, &Settings::default(), None).unwrap().visible.clone()
            };
            let (with, without) = (visible(Skips::ALL), visible(Skips::ALL.without(Skips::BESIDE)));
            let lost = (0..6000).find(|&k| with[k] != without[k]);
            assert_eq!(lost, None, "camera {number}, {isa}: a splat that the image shows is left");
            let shown = without.iter().filter(|v| **v).count();
            assert!(shown > 500 && shown < 5500, "camera {number}: {shown} of 6000 are shown: nothing to tell");
        }
    }
}

#[test]
fn a_pass_needs_a_render_after_the_skips_have_changed() {
    let scene = random(5, Kind::Discs, 0, 3);
    let mut rasterizer = Rasterizer::<f64>::new();
    rasterizer.render(&scene, &view(Lens::Pinhole), &Settings::default(), None).unwrap();
    rasterizer.skips(Skips::ALL);
    assert!(rasterizer.backward(&scene, &ImageGradient::default(), Wanted::ALL).is_err());
}

/// Moments are written only where a pixel blends; what another pass has left in the other slots must not count, nor with
/// further channels, whose moments are added.
#[test]
fn a_pass_knows_nothing_of_the_one_before() {
    let dense = |seed: u64| {
        let mut scene = random(900, Kind::Discs, 1, seed).cast::<f32>();
        scene.opacities.fill(0.95);
        scene
    };
    let (before, scene, view) = (dense(31), dense(77), view(Lens::Pinhole));
    for isa in available() {
        let gradients = |rasterizer: &mut Rasterizer<f32>, scene: &Gaussians<f32>| {
            let features: Vec<f32> = (0..2 * scene.len()).map(|k| (k % 13) as f32 / 6.0 - 1.0).collect();
            let image = rasterizer.render(scene, &view, &Settings::default(), None).unwrap().color.clone();
            rasterizer.render_channels(&features, 2).unwrap();
            let weights: Vec<f32> = (0..image.len()).map(|k| ((k * 7919) % 101) as f32 / 50.0 - 1.0).collect();
            let by_image = ImageGradient {
                color: &weights,
                channels: &weights[..image.len() / 3 * 2],
                ..ImageGradient::default()
            };
            rasterizer.backward(scene, &by_image, Wanted::ALL | Wanted::CHANNELS).unwrap().clone()
        };
        let mut used = Rasterizer::<f32>::with_isa(isa).unwrap();
        gradients(&mut used, &before);
        let (found, fresh) =
            (gradients(&mut used, &scene), gradients(&mut Rasterizer::<f32>::with_isa(isa).unwrap(), &scene));
        let hidden = (0..scene.len()).filter(|&i| fresh.opacities[i] == 0.0).count();
        assert!(hidden > 200 && hidden < 800, "{isa}: {hidden} of 900 have no gradient: nothing to tell");
        assert!(all(&found) == all(&fresh) && found.channels == fresh.channels, "{isa}: another gradient");
    }
}
