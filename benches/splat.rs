//! Wall clock of the splat core and its parts: `cargo bench --bench splat` (divan; on a quiet machine). CPU time per
//! stage: `examples/splat_timing.rs`; instructions: `scripts/count-instructions.sh`.

use divan::{Bencher, black_box};
use respire_bench::experiments::timing::TimedScene;
use respire_bench::splat::{Rasterizer, Reuse, Wanted};

/// Discs and image side.
const SCENES: [(usize, usize); 3] = [(5_000, 128), (20_000, 256), (100_000, 400)];

fn main() {
    divan::main();
}

/// Times passes on `scene`; `None`: forward alone.
fn bench(bencher: Bencher<'_, '_>, scene: &TimedScene, mut rasterizer: Rasterizer<f32>, wanted: Option<Wanted>) {
    bencher.bench_local(|| {
        let done = match wanted {
            Some(wanted) => scene.forward_backward(&mut rasterizer, wanted),
            None => scene.forward(&mut rasterizer),
        };
        black_box(done.expect("a good scene"));
    });
}

#[divan::bench(args = SCENES)]
fn forward(bencher: Bencher<'_, '_>, (discs, side): (usize, usize)) {
    bench(bencher, &TimedScene::tube(discs, side), Rasterizer::new(), None);
}

#[divan::bench(args = SCENES)]
fn forward_and_backward(bencher: Bencher<'_, '_>, (discs, side): (usize, usize)) {
    bench(bencher, &TimedScene::tube(discs, side), Rasterizer::new(), Some(Wanted::ALL));
}

#[divan::bench(args = SCENES)]
fn with_five_times_as_many_out_of_sight(bencher: Bencher<'_, '_>, (discs, side): (usize, usize)) {
    bench(bencher, &TimedScene::tube(discs, side).with_hidden(5), Rasterizer::new(), Some(Wanted::ALL));
}

#[divan::bench(args = SCENES)]
fn appearance_alone(bencher: Bencher<'_, '_>, (discs, side): (usize, usize)) {
    let mut rasterizer = Rasterizer::new();
    rasterizer.reuse(Reuse::Unchanged);
    bench(bencher, &TimedScene::tube(discs, side), rasterizer, Some(Wanted::SH));
}
