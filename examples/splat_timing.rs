//! Times the rasteriser on the tube of `splat::tube`:
//! `cargo run --release --example splat_timing -- [DISCS] [SIDE] [THREADS] [ISA] [REPETITIONS]`: stage by stage; what an
//! appearance-only step costs; what five times as many discs out of sight add; the loss; peak memory. With 0 for THREADS:
//! two threads against one instead, turn by turn.
//!
//! On a busy machine believe the CPU times (of the whole process, median), not the wall clock.

use std::time::Instant;

use respire_bench::ffi::splat::loss::{self, LossImage};
use respire_bench::ffi::system::{cpu_time_s, peak_memory_mib};
use respire_bench::splat::{
    Direction, Gaussians, ImageGradient, Isa, Motion, PassStage, Rasterizer, Reuse, Settings, View, Wanted, tube,
};

/// Wall and CPU milliseconds of repeated work.
#[derive(Default)]
struct Samples {
    wall: Vec<f64>,
    cpu: Vec<f64>,
}

impl Samples {
    fn add(&mut self, wall_s: f64, cpu_s: f64) {
        self.wall.push(wall_s * 1e3);
        self.cpu.push(cpu_s * 1e3);
    }

    fn time(&mut self, work: impl FnOnce()) {
        let (wall, cpu) = (Instant::now(), cpu_time_s());
        work();
        self.add(wall.elapsed().as_secs_f64(), cpu_time_s() - cpu);
    }

    fn line(&self, name: &str) {
        let median = |v: &[f64]| {
            let mut v = v.to_vec();
            v.sort_by(f64::total_cmp);
            v[v.len() / 2]
        };
        let least = |v: &[f64]| v.iter().copied().fold(f64::MAX, f64::min);
        println!(
            "{name:<34} {:>9.3} {:>9.3} {:>9.3} {:>9.3}",
            median(&self.wall),
            median(&self.cpu),
            least(&self.wall),
            least(&self.cpu)
        );
    }
}

/// One scene, one view.
struct Bench {
    scene: Gaussians<f32>,
    view: View,
    settings: Settings,
    color: Vec<f32>,
    isa: Isa,
}

impl Bench {
    fn rasterizer(&self) -> Rasterizer<f32> {
        let mut rasterizer = Rasterizer::with_isa(self.isa).expect("the processor has it");
        rasterizer.measure_cpu();
        rasterizer
    }

    fn render(&self, rasterizer: &mut Rasterizer<f32>, scene: &Gaussians<f32>) {
        rasterizer.render(scene, &self.view, &self.settings, None).expect("a good scene");
    }

    fn both(&self, rasterizer: &mut Rasterizer<f32>, scene: &Gaussians<f32>, wanted: Wanted) {
        self.render(rasterizer, scene);
        let gradient = ImageGradient { color: &self.color, ..ImageGradient::default() };
        rasterizer.backward(scene, &gradient, wanted).expect("a good gradient");
    }

    fn stages(&self, repetitions: usize) {
        let mut rasterizer = self.rasterizer();
        let velocities: Vec<[f32; 3]> = self.scene.positions.iter().map(|p| [0.1 * p[0], 0.1 * p[1], 1.0]).collect();
        let motion = Direction::Motion(Motion { positions: &velocities, ..Motion::default() });
        let mut stages: [Samples; 6] = Default::default();
        let (mut forward, mut both, mut tangent) = Default::default();
        let total = |samples: &mut Samples, times: &[[f64; 6]; 2], count: usize| {
            samples.add(times[0][..count].iter().sum(), times[1][..count].iter().sum());
        };
        for _ in 0..repetitions {
            self.both(&mut rasterizer, &self.scene, Wanted::ALL);
            let times = [rasterizer.stage_times().wall_s, rasterizer.stage_times().cpu_s];
            stages.iter_mut().enumerate().for_each(|(k, samples)| samples.add(times[0][k], times[1][k]));
            total(&mut forward, &times, 4);
            total(&mut both, &times, 6);
            let Bench { scene, view, settings, .. } = self;
            Samples::time(&mut tangent, || {
                rasterizer.render_tangent(scene, view, settings, None, &[motion]).expect("a good motion");
            });
        }
        let image = rasterizer.rendered();
        println!("{} visible, {} intersections", image.visible_count, image.intersections);
        for (stage, samples) in PassStage::ALL.iter().zip(&stages) {
            samples.line(stage.name());
        }
        forward.line("forward");
        both.line("forward + backward");
        tangent.line("forward + one motion (JVP)");
    }

    /// New SH on the same geometry, with and without reuse.
    fn repaint(&self, repetitions: usize) {
        let mut scene = self.scene.clone();
        let (mut anew, mut kept) = (self.rasterizer(), self.rasterizer());
        kept.reuse(Reuse::Unchanged);
        let mut samples: [Samples; 4] = Default::default();
        for _ in 0..=repetitions {
            scene.sh.iter_mut().for_each(|v| *v *= 0.999);
            samples[0].time(|| self.render(&mut anew, &scene));
            samples[1].time(|| self.both(&mut anew, &scene, Wanted::SH));
            samples[2].time(|| self.render(&mut kept, &scene));
            scene.sh.iter_mut().for_each(|v| *v *= 0.999);
            samples[3].time(|| self.both(&mut kept, &scene, Wanted::SH));
        }
        let names = ["forward", "forward + backward of SH", "same geometry: forward", "same geometry: with SH"];
        names.iter().zip(&samples).for_each(|(name, samples)| samples.line(name));
    }

    /// Five times as many discs out of sight, turn by turn with the plain scene.
    fn hidden(&self, repetitions: usize) {
        let tree = tube::with_hidden(&self.scene, 5);
        let (mut alone, mut among) = (self.rasterizer(), self.rasterizer());
        let mut samples: [Samples; 2] = Default::default();
        for _ in 0..=repetitions {
            samples[0].time(|| self.both(&mut alone, &self.scene, Wanted::ALL));
            samples[1].time(|| self.both(&mut among, &tree, Wanted::ALL));
        }
        assert_eq!(alone.rendered().visible_count, among.rendered().visible_count);
        samples[0].line("forward + backward");
        samples[1].line("with 5x more out of sight");
    }

    fn loss(&self, side: usize, repetitions: usize) {
        let plane = vec![0.4f32; 3 * side * side];
        let window = [0.001, 0.0076, 0.036, 0.1094, 0.213, 0.266];
        let image = LossImage {
            width: side,
            height: side,
            target: &self.color,
            mean: &plane,
            square: &plane,
            mask: &[],
            window: &window,
            ssim_weight: 0.2,
            norm: 0,
            softness: 1.0,
        };
        let mut gradient = vec![0.0f32; 3 * side * side];
        let mut samples = Samples::default();
        for _ in 0..repetitions {
            samples.time(|| {
                std::hint::black_box(loss::band(self.isa, &image, &plane, 0, &mut gradient));
            });
        }
        samples.line("L1 + SSIM with gradient, 1 thread");
    }

    /// Two threads against one, turn by turn.
    fn threads(&self, repetitions: usize) {
        let pool = |n: usize| rayon::ThreadPoolBuilder::new().num_threads(n).build().expect("threads can be made");
        let pools = [pool(1), pool(2)];
        let mut rasterizers = [self.rasterizer(), self.rasterizer()];
        let mut samples: [Samples; 2] = Default::default();
        for _ in 0..repetitions {
            for k in 0..2 {
                let rasterizer = &mut rasterizers[k];
                pools[k].install(|| samples[k].time(|| self.both(rasterizer, &self.scene, Wanted::ALL)));
            }
        }
        samples[0].line("forward + backward, 1 thread");
        samples[1].line("forward + backward, 2 threads");
        let least = |s: &Samples| s.wall.iter().copied().fold(f64::MAX, f64::min);
        println!("fastest against fastest: {:.2} times", least(&samples[0]) / least(&samples[1]));
    }
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let number = |k: usize, default: usize| arguments.get(k).and_then(|v| v.parse().ok()).unwrap_or(default);
    let (n, side, threads, repetitions) = (number(0, 20_000), number(1, 256), number(2, 2), number(4, 100));
    let isa = match arguments.get(3).map(String::as_str) {
        Some("scalar") => Isa::Scalar,
        Some("sse2") => Isa::Baseline,
        Some("avx2") => Isa::Avx2,
        _ => Isa::widest(),
    };
    let color = tube::image_gradient(3 * side * side);
    let bench = Bench { scene: tube::tube(n), view: tube::view(side), settings: tube::settings(), color, isa };
    println!("{n} discs, {side}x{side}, {isa}");
    println!("{:<34} {:>9} {:>9} {:>9} {:>9}", "ms", "wall", "CPU", "least", "least CPU");
    if threads == 0 {
        return bench.threads(repetitions);
    }
    rayon::ThreadPoolBuilder::new().num_threads(threads).build_global().expect("the pool is made once");
    bench.stages(repetitions);
    println!("peak memory {:.0} MiB", peak_memory_mib());
    bench.repaint(repetitions);
    bench.hidden(repetitions);
    bench.loss(side, repetitions);
}
