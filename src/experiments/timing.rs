//! How the rasteriser is timed: scene, warm-up, repetitions, least and median. Used by `pareto splat`,
//! by `examples/splat_timing.rs` and by `benches/splat.rs`.
//!
//! CPU times are those of the whole process, all threads together; other work on the machine disturbs them least. Two
//! pieces of work are compared turn by turn, either first every other time, so that neither finds the caches in a
//! better state.

use std::ops::Range;
use std::time::Instant;

use rayon::{ThreadPool, ThreadPoolBuilder};

use crate::base::statistics::upper_median;
use crate::base::{Error, Result};
use crate::ffi::system::cpu_time_s;
use crate::splat::{
    Direction, Gaussians, ImageGradient, Motion, PassStage, Rasterizer, Settings, SplatKernels, StageTimes, View,
    Wanted, tube,
};

/// Stages of the forward pass among [`PassStage::ALL`].
pub const FORWARD_STAGES: Range<usize> = 0..4;
/// Stages of the backward pass.
pub const BACKWARD_STAGES: Range<usize> = FORWARD_STAGES.end..PassStage::ALL.len();

/// Wall and CPU seconds of one piece of work.
#[derive(Clone, Copy, Debug, Default)]
pub struct Cost {
    /// Wall clock.
    pub wall_s: f64,
    /// CPU time of the process.
    pub cpu_s: f64,
}

/// Does `work` once and says what it cost.
pub fn measure<R>(work: impl FnOnce() -> R) -> (R, Cost) {
    let (wall, cpu_s) = (Instant::now(), cpu_time_s());
    let answer = work();
    (answer, Cost { wall_s: wall.elapsed().as_secs_f64(), cpu_s: cpu_time_s() - cpu_s })
}

/// Seconds of repeated work, in the order in which they were measured.
#[derive(Clone, Debug, Default)]
pub struct Samples {
    /// Wall clock.
    pub wall_s: Vec<f64>,
    /// CPU time of the process.
    pub cpu_s: Vec<f64>,
}

/// Least and median of some seconds; NaN without any.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spread {
    /// The least.
    pub least_s: f64,
    /// The upper median.
    pub median_s: f64,
}

impl Spread {
    /// The spread of these seconds, in any order.
    pub fn of(seconds: &[f64]) -> Spread {
        let least_s = seconds.iter().copied().min_by(f64::total_cmp);
        let median_s = upper_median(seconds.iter().copied());
        Spread { least_s: least_s.unwrap_or(f64::NAN), median_s: median_s.unwrap_or(f64::NAN) }
    }
}

impl Samples {
    /// Adds one measurement.
    pub fn add(&mut self, cost: Cost) {
        self.wall_s.push(cost.wall_s);
        self.cpu_s.push(cost.cpu_s);
    }

    /// Does `work` and adds what it cost.
    pub fn time<R>(&mut self, work: impl FnOnce() -> R) -> R {
        let (answer, cost) = measure(work);
        self.add(cost);
        answer
    }

    /// Spread of the wall-clock times.
    pub fn wall(&self) -> Spread {
        Spread::of(&self.wall_s)
    }

    /// Spread of the CPU times.
    pub fn cpu(&self) -> Spread {
        Spread::of(&self.cpu_s)
    }
}

impl Samples {
    /// The summed cost of the stages `range` (of [`PassStage::ALL`]), pass by pass.
    pub fn of_stages(passes: &[StageTimes], range: Range<usize>) -> Samples {
        let mut samples = Samples::default();
        for times in passes {
            let sum = |seconds: &[f64; 6]| seconds[range.clone()].iter().sum();
            samples.add(Cost { wall_s: sum(&times.wall_s), cpu_s: sum(&times.cpu_s) });
        }
        samples
    }
}

/// Times `N` pieces of work turn by turn, `repetitions` turns (at least one) after one to fill tables and caches.
///
/// `work(k, samples)` does the piece `k` and times what it wants with [`Samples::time`].
pub fn in_turns<const N: usize>(
    repetitions: usize,
    mut work: impl FnMut(usize, &mut Samples) -> Result<()>,
) -> Result<[Samples; N]> {
    let mut samples = [(); N].map(|()| Samples::default());
    for turn in 0..=repetitions.max(1) {
        for place in 0..N {
            let k = if turn % 2 == 0 { place } else { N - 1 - place };
            work(k, &mut samples[k])?;
        }
        if turn == 0 {
            samples = [(); N].map(|()| Samples::default());
        }
    }
    Ok(samples)
}

/// Times `work` `repetitions` times (at least once) after one to warm up.
pub fn repeat(repetitions: usize, mut work: impl FnMut() -> Result<()>) -> Result<Samples> {
    let [samples] = in_turns(repetitions, |_, samples| samples.time(&mut work))?;
    Ok(samples)
}

/// A pool of `threads` threads. Time from inside ([`ThreadPool::install`]): how long a thread outside waits is no part
/// of the work.
pub fn pool(threads: usize) -> Result<ThreadPool> {
    let pool = ThreadPoolBuilder::new().num_threads(threads).build();
    pool.map_err(|e| Error::input(format!("cannot start {threads} threads: {e}")))
}

/// What is timed: Gaussians, a camera, and a gradient of the image.
#[derive(Clone, Debug)]
pub struct TimedScene<T = f32> {
    /// The scene.
    pub gaussians: Gaussians<T>,
    /// The camera.
    pub view: View,
    /// Colour alone, as the peers are timed.
    pub settings: Settings,
    /// Gradient of the loss by each colour of the image.
    pub color_gradient: Vec<T>,
}

impl TimedScene {
    /// The tube of [`tube::tube`] with `discs` discs, in an image of `side_px` x `side_px`.
    pub fn tube(discs: usize, side_px: usize) -> Self {
        TimedScene {
            gaussians: tube::tube(discs),
            view: tube::view(side_px),
            settings: tube::settings(),
            color_gradient: tube::image_gradient(3 * side_px * side_px),
        }
    }

    /// The same with `copies` more copies of its Gaussians where the camera cannot see them.
    pub fn with_hidden(&self, copies: usize) -> Self {
        TimedScene { gaussians: tube::with_hidden(&self.gaussians, copies), ..self.clone() }
    }

    /// The same in another precision.
    pub fn cast<U: SplatKernels>(&self) -> TimedScene<U> {
        TimedScene {
            gaussians: self.gaussians.cast(),
            view: self.view,
            settings: self.settings,
            color_gradient: self.color_gradient.iter().map(|&v| U::of(f64::from(v))).collect(),
        }
    }

    /// A velocity of each centre in mm per unit: away from the axis and along it.
    pub fn velocities(&self) -> Vec<[f32; 3]> {
        self.gaussians.positions.iter().map(|p| [0.1 * p[0], 0.1 * p[1], 1.0]).collect()
    }

    /// One forward pass with its derivative along `velocities`, image by image.
    pub fn forward_tangent<'a>(
        &self,
        rasterizer: &'a mut Rasterizer<f32>,
        velocities: &[[f32; 3]],
    ) -> Result<&'a [Vec<f32>]> {
        let motion = Direction::Motion(Motion { positions: velocities, ..Motion::default() });
        rasterizer.render_tangent(&self.gaussians, &self.view, &self.settings, None, &[motion])
    }
}

impl<T: SplatKernels> TimedScene<T> {
    /// One forward pass.
    pub fn forward(&self, rasterizer: &mut Rasterizer<T>) -> Result<()> {
        rasterizer.render(&self.gaussians, &self.view, &self.settings, None).map(drop)
    }

    /// One forward pass, and a backward pass where gradients are wanted.
    pub fn pass(&self, rasterizer: &mut Rasterizer<T>, wanted: Option<Wanted>) -> Result<()> {
        match wanted {
            Some(wanted) => self.forward_backward(rasterizer, wanted),
            None => self.forward(rasterizer),
        }
    }

    /// One forward and backward pass.
    pub fn forward_backward(&self, rasterizer: &mut Rasterizer<T>, wanted: Wanted) -> Result<()> {
        self.forward(rasterizer)?;
        self.backward(rasterizer, &self.color_gradient, wanted)
    }

    /// The backward pass alone, from another gradient of the image.
    pub fn backward(&self, rasterizer: &mut Rasterizer<T>, color_gradient: &[T], wanted: Wanted) -> Result<()> {
        let gradient = ImageGradient { color: color_gradient, ..ImageGradient::default() };
        rasterizer.backward(&self.gaussians, &gradient, wanted).map(drop)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spread_is_the_least_and_the_upper_median() {
        let spread = Spread::of(&[3.0, 1.0, 2.0, 7.0]);
        assert_eq!(spread, Spread { least_s: 1.0, median_s: 3.0 });
        assert!(Spread::of(&[]).median_s.is_nan());
    }

    #[test]
    fn turns_alternate_and_the_warm_up_does_not_count() {
        let mut order = Vec::new();
        let samples: [Samples; 2] = in_turns(3, |k, samples| {
            order.push(k);
            samples.time(|| Ok(()))
        })
        .unwrap();
        assert_eq!(order, [0, 1, 1, 0, 0, 1, 1, 0]);
        assert_eq!(samples.map(|s| (s.wall_s.len(), s.cpu_s.len())), [(3, 3); 2]);
    }
}
