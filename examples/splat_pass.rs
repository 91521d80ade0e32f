//! Some forward and backward passes on the tube of `splat::tube` in one thread, for `scripts/count-instructions.sh`:
//! `cargo run --release --example splat_pass -- [DISCS] [SIDE] [PASSES]`.

use respire_bench::splat::{ImageGradient, Rasterizer, Wanted, tube};

fn main() {
    let arguments: Vec<usize> = std::env::args().skip(1).filter_map(|v| v.parse().ok()).collect();
    let number = |k: usize, default: usize| arguments.get(k).copied().unwrap_or(default);
    let (n, side, passes) = (number(0, 20_000), number(1, 256), number(2, 1));
    rayon::ThreadPoolBuilder::new().num_threads(1).build_global().expect("the pool is made once");
    let (scene, view, settings) = (tube::with_hidden(&tube::tube(n), 0), tube::view(side), tube::settings());
    let color = tube::image_gradient(3 * side * side);
    let gradient = ImageGradient { color: &color, ..ImageGradient::default() };
    let mut rasterizer = Rasterizer::<f32>::new();
    for _ in 0..passes {
        rasterizer.render(&scene, &view, &settings, None).expect("a good scene");
        rasterizer.backward(&scene, &gradient, Wanted::ALL).expect("a good gradient");
    }
}
