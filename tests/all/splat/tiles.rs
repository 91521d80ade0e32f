//! The side of the tiles decides what a pass costs and nothing else: every image of every mode, and every gradient, with
//! tiles of 4, 8 and 16 pixels, on every kernel.

use respire_bench::splat::{
    DepthOutput, Direction, Footprint, Gradients, ImageGradient, Isa, Rasterizer, Real, Settings, TileSide, Wanted,
};

use super::forward::available;
use super::scenes::{Kind, Lens, random, relative, view, wide};

/// Everything that a rasteriser gives.
struct Pass<T> {
    /// Colour, depth, alpha, two channels, velocity along a motion of the camera.
    images: [Vec<T>; 5],
    gradients: Gradients<T>,
}

fn pass<T: Real>(isa: Isa, side: TileSide, lens: Lens, settings: &Settings) -> Pass<T> {
    let scene = random(150, Kind::Discs, 1, 77).cast::<T>();
    let view = view(lens);
    let mut rasterizer = Rasterizer::<T>::with_isa(isa).unwrap();
    rasterizer.tile_side(side);
    let direction = Direction::Pose([0.1, -0.2, 0.3, 0.5, -0.4, 0.2]);
    let moving = rasterizer.render_tangent(&scene, &view, settings, None, &[direction]).unwrap()[0].clone();
    let rendered = rasterizer.render(&scene, &view, settings, None).unwrap().clone();
    let features: Vec<T> = (0..2 * scene.len()).map(|k| T::of((k % 13) as f64 / 13.0)).collect();
    let channels = rasterizer.render_channels(&features, 2).unwrap().to_vec();
    let weights =
        |n: usize, step: usize| -> Vec<T> { (0..n).map(|k| T::of(((k * step) % 101) as f64 / 50.0 - 1.0)).collect() };
    let (color, alpha) = (weights(rendered.color.len(), 7919), weights(rendered.alpha.len(), 104_729));
    let depth = if settings.depth == DepthOutput::Expected { weights(alpha.len(), 31) } else { Vec::new() };
    let by_channels = weights(channels.len(), 1009);
    let gradient = ImageGradient { color: &color, depth: &depth, alpha: &alpha, channels: &by_channels };
    let gradients = rasterizer.backward(&scene, &gradient, Wanted::ALL).unwrap().clone();
    Pass { images: [rendered.color, rendered.depth, rendered.alpha, channels, moving], gradients }
}

/// Positions, axes, opacities, SH, camera and exposure, one after the other.
fn groups<T: Real>(g: &Gradients<T>) -> [Vec<f64>; 6] {
    let axes = g.axes.as_flattened().as_flattened();
    [wide(g.positions.as_flattened()), wide(axes), wide(&g.opacities), wide(&g.sh), g.pose.to_vec(), g.gain.to_vec()]
}

fn nothing_changes<T: Real>(isa: Isa, lens: Lens, settings: &Settings, bound: f64) {
    let usual = pass::<T>(isa, TileSide::Px16, lens, settings);
    for side in [TileSide::Px8, TileSide::Px4] {
        let found = pass::<T>(isa, side, lens, settings);
        for (k, (a, b)) in found.images.iter().zip(&usual.images).enumerate() {
            assert!(a == b, "{isa}, {side:?}: image {k} is another");
        }
        // A splat's sums are added tile by tile: other tiles, other rounding.
        for (k, (a, b)) in groups(&found.gradients).iter().zip(&groups(&usual.gradients)).enumerate() {
            assert!(relative(a, b) <= bound, "{isa}, {side:?}: group {k} by {:e}", relative(a, b));
        }
    }
}

#[test]
fn the_side_of_the_tiles_is_not_seen() {
    let settings = Settings {
        background: [0.2, 0.5, 0.1],
        gain: [0.8, 1.2, 1.1],
        depth: DepthOutput::Expected,
        ..Settings::default()
    };
    for isa in available() {
        for lens in [Lens::Pinhole, Lens::Fisheye] {
            nothing_changes::<f32>(isa, lens, &settings, 2e-5);
        }
    }
    nothing_changes::<f64>(Isa::Scalar, Lens::Pinhole, &settings, 1e-12);
    for depth in [DepthOutput::Median, DepthOutput::Surface] {
        nothing_changes::<f32>(Isa::widest(), Lens::Pinhole, &Settings { depth, ..settings }, 2e-5);
    }
    let discs = Settings { footprint: Footprint::Disc, ..settings };
    nothing_changes::<f64>(Isa::Scalar, Lens::Pinhole, &discs, 1e-11);
    for isa in available() {
        nothing_changes::<f32>(isa, Lens::Fisheye, &discs, 2e-4);
    }
}
