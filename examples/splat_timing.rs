//! Times the rasteriser on the tube of `splat::tube` (all of it in milliseconds):
//!
//! ```text
//! cargo run --release --example splat_timing -- [DISCS] [SIDE] [THREADS] [ISA] [REPETITIONS]
//! cargo run --release --example splat_timing -- table [REPETITIONS]
//! cargo run --release --example splat_timing -- pass [DISCS] [SIDE] [PASSES]
//! ```
//! The first times each stage of a pass, and then turn by turn: forward mode (JVP), steps of the appearance alone,
//! five times as many discs out of sight, a fisheye, AVX2 against the widest kernels, the loss of the methods; with 0
//! for THREADS, two threads against one. `table` does all of it at 20,000 discs and 256x256 and at 100,000 and
//! 400x400, and a million discs, with two threads. `pass` does some passes in one thread and says nothing, for
//! `scripts/count-instructions.sh`.
//!
//! On a busy machine believe the CPU times (of the whole process, median), not the wall clock.

use rayon::ThreadPool;
use respire_bench::base::Result;
use respire_bench::experiments::timing::{
    BACKWARD_STAGES, FORWARD_STAGES, Samples, TimedScene, in_turns, pool, repeat,
};
use respire_bench::ffi::system::peak_memory_mib;
use respire_bench::reconstruct::loss::photometric::Photometric;
use respire_bench::splat::{Isa, PassStage, Rasterizer, Reuse, Wanted};

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let number = |k: usize, default: usize| arguments.get(k).and_then(|v| v.parse().ok()).unwrap_or(default);
    match arguments.first().map(String::as_str) {
        Some("table") => table(number(1, 100)),
        Some("pass") => {
            let (scene, passes) = (TimedScene::tube(number(1, 20_000), number(2, 256)), number(3, 1));
            let mut rasterizer = Rasterizer::new();
            pool(1)?.install(|| (0..passes).try_for_each(|_| scene.forward_backward(&mut rasterizer, Wanted::ALL)))
        }
        _ => {
            let isa = match arguments.get(3).map(String::as_str) {
                Some("scalar") => Isa::Scalar,
                Some("sse2") => Isa::Baseline,
                Some("avx2") => Isa::Avx2,
                _ => Isa::widest(),
            };
            let (discs, side, threads) = (number(0, 20_000), number(1, 256), number(2, 2));
            let program = Program { scene: TimedScene::tube(discs, side), isa, repetitions: number(4, 100) };
            program.head(discs, side);
            match threads {
                0 => program.threads(),
                _ => program.all(&pool(threads)?),
            }
        }
    }
}

fn table(repetitions: usize) -> Result<()> {
    let two = pool(2)?;
    for (discs, side, repetitions) in [(20_000, 256, repetitions), (100_000, 400, repetitions.div_ceil(2))] {
        let program = Program { scene: TimedScene::tube(discs, side), isa: Isa::widest(), repetitions };
        program.head(discs, side);
        program.threads()?;
        program.all(&two)?;
    }
    let scene = TimedScene::tube(1_000_000, 1024);
    let mut rasterizer = Rasterizer::new();
    println!("1000000 discs, 1024x1024; peak memory {:.0} MiB with the scene", peak_memory_mib());
    let passes = || repeat(repetitions.div_ceil(10), || scene.forward_backward(&mut rasterizer, Wanted::ALL));
    print("forward + backward", &two.install(passes)?);
    println!("peak memory {:.0} MiB", peak_memory_mib());
    Ok(())
}

fn print(name: &str, samples: &Samples) {
    let ([wall, cpu], ms) = ([samples.wall(), samples.cpu()], 1e3);
    println!(
        "{name:<38} {:>9.3} {:>9.3} {:>9.3} {:>9.3}",
        ms * wall.median_s,
        ms * cpu.median_s,
        ms * wall.least_s,
        ms * cpu.least_s
    );
}

/// Two rows, and the second over the first.
fn print_pair(names: [&str; 2], samples: &[Samples; 2]) {
    names.iter().zip(samples).for_each(|(name, samples)| print(name, samples));
    let [a, b] = samples.each_ref().map(|s| [s.wall().median_s, s.cpu().median_s, s.wall().least_s, s.cpu().least_s]);
    let ratios: String = a.iter().zip(b).map(|(a, b)| format!(" {:>9.3}", b / a)).collect();
    println!("  {:<36}{ratios}", "the second over the first");
}

/// One scene and the kernels in question.
struct Program {
    scene: TimedScene,
    isa: Isa,
    repetitions: usize,
}

impl Program {
    fn head(&self, discs: usize, side: usize) {
        println!("{discs} discs, {side}x{side}, {}", self.isa);
        println!("{:<38} {:>9} {:>9} {:>9} {:>9}", "ms", "wall", "CPU", "least", "least CPU");
    }

    fn rasterizer(&self) -> Result<Rasterizer<f32>> {
        let mut rasterizer = Rasterizer::with_isa(self.isa)?;
        rasterizer.measure_cpu();
        Ok(rasterizer)
    }

    fn all(&self, pool: &ThreadPool) -> Result<()> {
        pool.install(|| {
            self.stages()?;
            println!("peak memory {:.0} MiB", peak_memory_mib());
            self.tangent()?;
            self.appearance()?;
            let mut fisheye = self.scene.clone();
            fisheye.view.camera.fisheye = Some([-0.03, 0.002, 0.0, 0.0]);
            self.against("with 5x more out of sight", &self.scene.with_hidden(5), self.rasterizer()?)?;
            self.against("through a fisheye", &fisheye, self.rasterizer()?)?;
            if self.isa > Isa::Avx2 {
                self.against("with AVX2", &self.scene, Rasterizer::with_isa(Isa::Avx2)?)?;
            }
            self.loss()
        })
    }

    fn stages(&self) -> Result<()> {
        let (mut rasterizer, mut passes) = (self.rasterizer()?, Vec::new());
        for _ in 0..self.repetitions {
            self.scene.forward_backward(&mut rasterizer, Wanted::ALL)?;
            passes.push(rasterizer.stage_times());
        }
        let image = rasterizer.rendered();
        println!("{} visible, {} intersections", image.visible_count, image.intersections);
        for (k, stage) in PassStage::ALL.iter().enumerate() {
            print(stage.name(), &Samples::of_stages(&passes, k..k + 1));
        }
        print("forward", &Samples::of_stages(&passes, FORWARD_STAGES));
        print("forward + backward", &Samples::of_stages(&passes, 0..BACKWARD_STAGES.end));
        Ok(())
    }

    fn tangent(&self) -> Result<()> {
        let velocities = self.scene.velocities();
        let mut rasterizers = [self.rasterizer()?, self.rasterizer()?];
        let samples = in_turns(self.repetitions, |k, samples| {
            samples.time(|| match k {
                0 => self.scene.forward(&mut rasterizers[0]),
                _ => self.scene.forward_tangent(&mut rasterizers[1], &velocities).map(drop),
            })
        })?;
        print_pair(["forward", "forward with one motion (JVP)"], &samples);
        Ok(())
    }

    /// New SH on the same geometry, with and without reuse.
    fn appearance(&self) -> Result<()> {
        for (what, wanted) in [("forward", None), ("forward + backward of SH", Some(Wanted::SH))] {
            let mut rasterizers = [self.rasterizer()?, self.rasterizer()?];
            rasterizers[1].reuse(Reuse::Unchanged);
            let mut scenes = [self.scene.clone(), self.scene.clone()];
            let samples = in_turns(self.repetitions, |k, samples| {
                scenes[k].gaussians.sh.iter_mut().for_each(|v| *v *= 0.999);
                samples.time(|| scenes[k].pass(&mut rasterizers[k], wanted))
            })?;
            print_pair([what, "the same on unchanged geometry"], &samples);
        }
        Ok(())
    }

    /// Forward and backward of the scene against those of another.
    fn against(&self, name: &str, other: &TimedScene, rasterizer: Rasterizer<f32>) -> Result<()> {
        let mut rasterizers = [self.rasterizer()?, rasterizer];
        let samples = in_turns(self.repetitions, |k, samples| {
            samples.time(|| [&self.scene, other][k].forward_backward(&mut rasterizers[k], Wanted::ALL))
        })?;
        print_pair(["forward + backward", name], &samples);
        Ok(())
    }

    /// The loss among passes, as a method calls it: what it needs has left the caches in between.
    fn loss(&self) -> Result<()> {
        let side = self.scene.view.camera.width as usize;
        let mut photometric = Photometric::new(&vec![0.4; 3 * side * side], side, side, 0.2, None);
        let mut gradient = vec![0.0f32; 3 * side * side];
        let mut rasterizer = self.rasterizer()?;
        let mut samples = [Samples::default(), Samples::default()];
        for _ in 0..self.repetitions {
            samples[0].time(|| self.scene.forward(&mut rasterizer))?;
            samples[1].time(|| photometric.evaluate(&rasterizer.rendered().color, &mut gradient));
            self.scene.backward(&mut rasterizer, &gradient, Wanted::ALL)?;
        }
        print_pair(["forward", "L1 + SSIM with gradient"], &samples);
        Ok(())
    }

    /// Two threads against one.
    fn threads(&self) -> Result<()> {
        let pools = [pool(2)?, pool(1)?];
        for (what, wanted) in [("forward", None), ("forward + backward", Some(Wanted::ALL))] {
            let mut rasterizers = [self.rasterizer()?, self.rasterizer()?];
            let samples = in_turns(self.repetitions, |k, samples| {
                pools[k].install(|| samples.time(|| self.scene.pass(&mut rasterizers[k], wanted)))
            })?;
            print_pair([&format!("{what}, 2 threads"), &format!("{what}, 1 thread")], &samples);
        }
        Ok(())
    }
}
