//! Time of each stage of the last passes: wall clock, and CPU time of the whole process.

use std::time::Instant;

use crate::ffi::system::cpu_time_s;

/// The stages of a pass, in order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PassStage {
    /// Gaussians to splats.
    Project,
    /// Splats to the sorted lists of the tiles.
    Bin,
    /// Lists to the sums of pixels.
    Composite,
    /// Sums to images.
    Develop,
    /// Image gradients through the tiles to moments of splats.
    CompositeBackward,
    /// Moments to gradients of Gaussians and camera.
    Chain,
}

impl PassStage {
    /// All of them: four of the forward, two of the backward pass.
    pub const ALL: [PassStage; 6] = [
        PassStage::Project,
        PassStage::Bin,
        PassStage::Composite,
        PassStage::Develop,
        PassStage::CompositeBackward,
        PassStage::Chain,
    ];

    /// Name in tables.
    pub fn name(self) -> &'static str {
        match self {
            PassStage::Project => "project",
            PassStage::Bin => "bin",
            PassStage::Composite => "composite",
            PassStage::Develop => "develop",
            PassStage::CompositeBackward => "composite_backward",
            PassStage::Chain => "chain",
        }
    }
}

/// Seconds of each stage, in the order of [`PassStage::ALL`].
#[derive(Clone, Copy, Debug, Default)]
pub struct StageTimes {
    /// Wall clock.
    pub wall_s: [f64; 6],
    /// CPU time of the process (all threads, including unrelated work); 0 unless requested.
    pub cpu_s: [f64; 6],
}

/// Measures one stage after the other.
#[derive(Debug)]
pub struct PassClock {
    times: StageTimes,
    with_cpu: bool,
    since: Instant,
    cpu_since: f64,
}

impl Default for PassClock {
    fn default() -> Self {
        PassClock { times: StageTimes::default(), with_cpu: false, since: Instant::now(), cpu_since: 0.0 }
    }
}

impl PassClock {
    pub fn times(&self) -> StageTimes {
        self.times
    }

    pub fn measure_cpu(&mut self) {
        self.with_cpu = true;
    }

    /// Starts the first stage of a pass.
    pub fn start(&mut self) {
        self.since = Instant::now();
        self.cpu_since = if self.with_cpu { cpu_time_s() } else { 0.0 };
    }

    /// Ends `stage` and starts the next one.
    pub fn end(&mut self, stage: PassStage) {
        let (since, cpu_since) = (self.since, self.cpu_since);
        self.start();
        self.times.wall_s[stage as usize] = (self.since - since).as_secs_f64();
        self.times.cpu_s[stage as usize] = self.cpu_since - cpu_since;
    }
}
