//! The figures of the splat core in one go, for a quiet machine:
//! `cargo run --release --example splat_table -- [REPETITIONS]`.
//!
//! What is compared is measured turn by turn in one run, wall clock, median and in brackets the least, in milliseconds: one
//! thread and two, AVX-512 and AVX2, forward mode, discs out of sight, a fisheye, the loss of the methods, a million discs.

use std::time::Instant;

use rayon::ThreadPool;
use respire_bench::ffi::system::peak_memory_mib;
use respire_bench::reconstruct::loss::photometric::Photometric;
use respire_bench::splat::{
    Direction, Gaussians, ImageGradient, Isa, Motion, Rasterizer, Settings, View, Wanted, tube,
};

/// Wall milliseconds of something, again and again.
struct Row {
    name: String,
    times: Vec<f64>,
}

impl Row {
    fn new(name: impl Into<String>) -> Self {
        Row { name: name.into(), times: Vec::new() }
    }

    /// From inside the pool: how long a thread outside waits for it to wake up is no part of the core.
    fn time(&mut self, pool: &ThreadPool, work: impl FnOnce() + Send) {
        self.times.push(pool.install(|| {
            let start = Instant::now();
            work();
            start.elapsed().as_secs_f64() * 1e3
        }));
    }

    fn median(&self) -> f64 {
        let mut times = self.times.clone();
        times.sort_by(f64::total_cmp);
        times[times.len() / 2]
    }

    fn least(&self) -> f64 {
        self.times.iter().copied().fold(f64::MAX, f64::min)
    }

    fn print(&self) {
        println!("{:<54} {:>9.3} ({:.3})", self.name, self.median(), self.least());
    }

    /// The ratio to another row of the same turns, by medians and by the least.
    fn print_ratio(&self, name: &str, to: &Row) {
        println!("{name:<54} {:>9.2} ({:.2})", self.median() / to.median(), self.least() / to.least());
    }
}

/// One scene, one view.
struct Scene {
    discs: Gaussians<f32>,
    view: View,
    settings: Settings,
    color: Vec<f32>,
}

impl Scene {
    fn new(n: usize, side: usize) -> Self {
        let color = tube::image_gradient(3 * side * side);
        Scene { discs: tube::tube(n), view: tube::view(side), settings: tube::settings(), color }
    }

    fn forward(&self, rasterizer: &mut Rasterizer<f32>) {
        rasterizer.render(&self.discs, &self.view, &self.settings, None).expect("a good scene");
    }

    fn both(&self, rasterizer: &mut Rasterizer<f32>) {
        self.forward(rasterizer);
        let gradient = ImageGradient { color: &self.color, ..ImageGradient::default() };
        rasterizer.backward(&self.discs, &gradient, Wanted::ALL).expect("a good gradient");
    }
}

type Pass = fn(&Scene, &mut Rasterizer<f32>);

/// Two things turn by turn, each first every other time, so that neither finds the caches in a better state.
fn turn_by_turn(
    pool: &ThreadPool,
    repetitions: usize,
    rows: [Row; 2],
    mut first: impl FnMut() + Send,
    mut second: impl FnMut() + Send,
) -> [Row; 2] {
    let [mut a, mut b] = rows;
    for turn in 0..2 * repetitions.div_ceil(2) + 2 {
        if turn % 2 == 0 {
            a.time(pool, &mut first);
            b.time(pool, &mut second);
        } else {
            b.time(pool, &mut second);
            a.time(pool, &mut first);
        }
        if turn == 1 {
            // The first turns fill tables.
            a.times.clear();
            b.times.clear();
        }
    }
    a.print();
    b.print();
    [a, b]
}

fn passes(pools: &[ThreadPool; 2], n: usize, side: usize, repetitions: usize) {
    let scene = Scene::new(n, side);
    println!("{n} discs, {side}x{side}");
    let new = Rasterizer::<f32>::new;
    let what = [("forward", Scene::forward as Pass), ("forward + backward", Scene::both)];
    for (name, work) in what {
        let mut rasterizer = new();
        let mut rows = ["1 thread", "2 threads"].map(|threads| Row::new(format!("{name}, {threads}")));
        for turn in 0..=repetitions {
            for (row, pool) in rows.iter_mut().zip(pools) {
                row.time(pool, || work(&scene, &mut rasterizer));
            }
            if turn == 0 {
                rows.iter_mut().for_each(|row| row.times.clear());
            }
        }
        rows.iter().for_each(Row::print);
        rows[0].print_ratio(&format!("{name}: 1 thread over 2"), &rows[1]);
    }

    let velocities: Vec<[f32; 3]> = scene.discs.positions.iter().map(|p| [0.1 * p[0], 0.1 * p[1], 1.0]).collect();
    let motion = Direction::Motion(Motion { positions: &velocities, ..Motion::default() });
    let (mut still, mut moving) = (new(), new());
    let rows = ["forward, 2 threads", "forward with one direction (JVP), 2 threads"].map(Row::new);
    let [plain, tangent] = turn_by_turn(
        &pools[1],
        repetitions,
        rows,
        || scene.forward(&mut still),
        || {
            let Scene { discs, view, settings, .. } = &scene;
            moving.render_tangent(discs, view, settings, None, &[motion]).expect("a good motion");
        },
    );
    tangent.print_ratio("JVP over forward", &plain);

    let mut tree = Scene::new(n, side);
    tree.discs = tube::with_hidden(&scene.discs, 5);
    let (mut alone, mut among) = (new(), new());
    let rows = ["forward + backward, 2 threads", "the same with 5x more out of sight"].map(Row::new);
    let both = turn_by_turn(&pools[1], repetitions, rows, || scene.both(&mut alone), || tree.both(&mut among));
    both[1].print_ratio("5x more out of sight over none", &both[0]);

    let mut bent = Scene::new(n, side);
    bent.view.camera.fisheye = Some([-0.03, 0.002, 0.0, 0.0]);
    let (mut straight, mut curved) = (new(), new());
    let rows = ["forward + backward, 2 threads", "the same through a fisheye"].map(Row::new);
    let both = turn_by_turn(&pools[1], repetitions, rows, || scene.both(&mut straight), || bent.both(&mut curved));
    both[1].print_ratio("fisheye over pinhole", &both[0]);

    let narrow = Isa::Avx2.available().unwrap_or(Isa::Baseline);
    let of = |isa| Rasterizer::<f32>::with_isa(isa).expect("the processor has it");
    for (name, work) in what {
        let (mut wide, mut small) = (new(), of(narrow));
        let rows = [Isa::widest(), narrow].map(|isa| Row::new(format!("{name}, {isa}, 2 threads")));
        let both = turn_by_turn(&pools[1], repetitions, rows, || work(&scene, &mut wide), || work(&scene, &mut small));
        both[1].print_ratio(&format!("{name}: {narrow} over {}", Isa::widest()), &both[0]);
    }

    // The loss among passes, as a method calls it: what it needs has left the caches in between.
    let mut photometric = Photometric::new(&vec![0.4; scene.color.len()], side, side, 0.2, None);
    let mut gradient = vec![0.0f32; scene.color.len()];
    let mut rasterizer = new();
    let mut rows = ["forward, 2 threads", "L1 + SSIM with gradient, 2 threads"].map(Row::new);
    for turn in 0..=repetitions {
        rows[0].time(&pools[1], || scene.forward(&mut rasterizer));
        rows[1].time(&pools[1], || {
            photometric.evaluate(&rasterizer.rendered().color, &mut gradient);
        });
        // What a backward pass leaves in the caches.
        pools[1].install(|| {
            let gradient = ImageGradient { color: &gradient, ..ImageGradient::default() };
            rasterizer.backward(&scene.discs, &gradient, Wanted::ALL).expect("a good gradient");
        });
        if turn == 0 {
            rows.iter_mut().for_each(|row| row.times.clear());
        }
    }
    rows.iter().for_each(Row::print);
    rows[1].print_ratio("loss over forward, 2 threads", &rows[0]);
}

fn main() {
    let repetitions = std::env::args().nth(1).and_then(|v| v.parse().ok()).unwrap_or(100);
    let pool = |threads| rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads can be made");
    let pools = [pool(1), pool(2)];
    println!("{:<54} {:>9} (least), ms", Isa::widest().to_string(), "median");
    passes(&pools, 20_000, 256, repetitions);
    passes(&pools, 100_000, 400, repetitions.div_ceil(2));
    let before = peak_memory_mib();
    let scene = Scene::new(1_000_000, 1024);
    let with_scene = peak_memory_mib();
    let mut rasterizer = Rasterizer::<f32>::new();
    let mut row = Row::new("1000000 discs, 1024x1024, forward + backward, 2 threads");
    for _ in 0..=repetitions.div_ceil(10) {
        row.time(&pools[1], || scene.both(&mut rasterizer));
    }
    row.times.remove(0);
    row.print();
    println!("peak memory: {:.0} MiB before, {with_scene:.0} with the scene, {:.0} after", before, peak_memory_mib());
}
