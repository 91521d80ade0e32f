//! Wall clock of the splat core and its parts: `cargo bench --bench splat` (divan; on a quiet machine). CPU time per stage:
//! `examples/splat_timing.rs`; instructions: `scripts/count-instructions.sh`.

use divan::{Bencher, black_box};
use respire_bench::splat::{Gaussians, ImageGradient, Rasterizer, Reuse, View, Wanted, tube};

/// Discs and image side.
const SCENES: [(usize, usize); 3] = [(5_000, 128), (20_000, 256), (100_000, 400)];

fn main() {
    divan::main();
}

struct Ready {
    scene: Gaussians<f32>,
    view: View,
    color: Vec<f32>,
    rasterizer: Rasterizer<f32>,
}

fn ready((n, side): (usize, usize), hidden: usize) -> Ready {
    Ready {
        scene: tube::with_hidden(&tube::tube(n), hidden),
        view: tube::view(side),
        color: tube::image_gradient(3 * side * side),
        rasterizer: Rasterizer::new(),
    }
}

impl Ready {
    fn forward(&mut self) {
        black_box(self.rasterizer.render(&self.scene, &self.view, &tube::settings(), None).expect("a good scene"));
    }

    fn backward(&mut self, wanted: Wanted) {
        let gradient = ImageGradient { color: &self.color, ..ImageGradient::default() };
        black_box(self.rasterizer.backward(&self.scene, &gradient, wanted).expect("a good gradient"));
    }
}

#[divan::bench(args = SCENES)]
fn forward(bencher: Bencher<'_, '_>, scene: (usize, usize)) {
    let mut ready = ready(scene, 0);
    bencher.bench_local(|| ready.forward());
}

#[divan::bench(args = SCENES)]
fn forward_and_backward(bencher: Bencher<'_, '_>, scene: (usize, usize)) {
    let mut ready = ready(scene, 0);
    bencher.bench_local(|| {
        ready.forward();
        ready.backward(Wanted::ALL);
    });
}

#[divan::bench(args = SCENES)]
fn with_five_times_as_many_out_of_sight(bencher: Bencher<'_, '_>, scene: (usize, usize)) {
    let mut ready = ready(scene, 5);
    bencher.bench_local(|| {
        ready.forward();
        ready.backward(Wanted::ALL);
    });
}

#[divan::bench(args = SCENES)]
fn appearance_alone(bencher: Bencher<'_, '_>, scene: (usize, usize)) {
    let mut ready = ready(scene, 0);
    ready.rasterizer.reuse(Reuse::Unchanged);
    bencher.bench_local(|| {
        ready.forward();
        ready.backward(Wanted::SH);
    });
}
