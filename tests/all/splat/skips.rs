//! What a pass leaves out must not be seen: each skip switched off, on every kernel, against the default.

use respire_bench::splat::{
    Filter, Gaussians, Gradients, ImageGradient, Isa, Rasterizer, Real, Settings, Skips, View, Wanted,
};

use super::forward::available;
use super::scenes::{Kind, Lens, random, relative, view, wide};

fn pass<T: Real>(
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
fn all<T: Real>(g: &Gradients<T>) -> [Vec<f64>; 5] {
    let axes = g.axes.as_flattened().as_flattened();
    [wide(g.positions.as_flattened()), wide(axes), wide(&g.opacities), wide(&g.sh), g.pose.to_vec()]
}

/// Largest change of a value without the stop.
fn nothing_is_lost<T: Real>(isa: Isa, lens: Lens, filter: Filter) -> f64 {
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
    }
    nothing_is_lost::<f32>(Isa::widest(), Lens::Pinhole, Filter::Compensate);
    nothing_is_lost::<f64>(Isa::Scalar, Lens::Fisheye, Filter::Dilate);
}

#[test]
fn a_pass_needs_a_render_after_the_skips_have_changed() {
    let scene = random(5, Kind::Discs, 0, 3);
    let mut rasterizer = Rasterizer::<f64>::new();
    rasterizer.render(&scene, &view(Lens::Pinhole), &Settings::default(), None).unwrap();
    rasterizer.skips(Skips::ALL);
    assert!(rasterizer.backward(&scene, &ImageGradient::default(), Wanted::ALL).is_err());
}
