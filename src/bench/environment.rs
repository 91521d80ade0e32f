//! The machine and the libraries a run is made on: `environment.json`, `doctor`, and the id beside every timing.

use std::sync::LazyLock;

use serde::Serialize;

use crate::base::hash;
use crate::ct::dicom_conversion::converter_version;
use crate::ct::registration::elastix_version;
pub use crate::ffi::system::{hang_up_is_ignored, ignore_hang_up, report_file_size_limit};
use crate::ffi::versions::{EMBREE_HEADER, embree_complaint, embree_runtime};
use crate::ffi::{system, vision};
use crate::render;
use crate::splat::Isa;

/// Memory that a `quick` run needs.
const MEMORY_NEEDED_MIB: f64 = 1500.0;

/// The machine, the libraries and what is missing.
#[derive(Clone, Debug, Serialize)]
pub struct Environment {
    /// Version of this program.
    pub version: &'static str,
    /// The compiler that built it.
    pub rustc: &'static str,
    /// The Embree that is loaded.
    pub embree_runtime: String,
    /// The Embree that it was built against.
    pub embree_header: String,
    /// The OpenCV that is loaded.
    pub opencv: String,
    /// The elastix that `import ct` calls; nothing else needs it.
    pub elastix: Option<String>,
    /// The dcm2niix that `import ct` calls for DICOM that is compressed; nothing else needs it.
    pub dcm2niix: Option<String>,
    /// Instruction sets that there are kernels for and that the processor has.
    pub isa_available: Vec<String>,
    /// Instruction set for tracing rays: pinned, so that images are the same on every machine that has it.
    pub isa_of_rays: &'static str,
    /// Instruction set for rasterising: the widest.
    pub isa_of_splats: String,
    /// Processor model.
    pub processor: String,
    /// Logical cores.
    pub cores: usize,
    /// Threads of this process.
    pub threads: usize,
    /// Physical memory in MiB.
    pub memory_mib: f64,
    /// One sentence for each thing that is missing.
    pub missing: Vec<String>,
}

/// By the test that chooses the kernels, so that what is listed runs.
fn isa_available() -> Vec<String> {
    let kernels = [Isa::Baseline, Isa::Avx2, Isa::Avx512];
    kernels.into_iter().filter(|isa| isa.available().is_ok()).map(|isa| isa.to_string()).collect()
}

fn processor() -> String {
    let text = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = text.lines().find_map(|line| line.strip_prefix("model name")?.split_once(':'));
    model.map_or("unknown", |(_, name)| name.trim()).to_owned()
}

fn cores() -> usize {
    std::thread::available_parallelism().map_or(1, |n| n.get())
}

impl Environment {
    /// Examines this machine.
    pub fn examine() -> Self {
        let embree = embree_runtime();
        let isa_available = isa_available();
        let memory_mib = system::memory_mib();
        let mut missing: Vec<String> = embree_complaint(embree, EMBREE_HEADER).into_iter().collect();
        if !isa_available.iter().any(|isa| isa == render::ISA) {
            missing.push(format!("the processor has no {}, which rays are traced with", render::ISA));
        }
        if memory_mib < MEMORY_NEEDED_MIB {
            missing
                .push(format!("the machine has {memory_mib:.0} MiB of memory; {MEMORY_NEEDED_MIB:.0} MiB are needed"));
        }
        Environment {
            version: env!("CARGO_PKG_VERSION"),
            rustc: env!("RESPIRE_BENCH_RUSTC"),
            embree_runtime: embree.map_or_else(|| "none".into(), |v| v.to_string()),
            embree_header: EMBREE_HEADER.to_string(),
            opencv: vision::version(),
            elastix: elastix_version(),
            dcm2niix: converter_version(),
            isa_available,
            isa_of_rays: render::ISA,
            isa_of_splats: Isa::widest().to_string(),
            processor: processor(),
            cores: cores(),
            threads: rayon::current_num_threads(),
            memory_mib,
            missing,
        }
    }
}

/// Eight digits, the same for machines whose timings may be compared: processor and number of cores.
pub fn machine_id() -> &'static str {
    static ID: LazyLock<String> =
        LazyLock::new(|| hash::of_bytes(format!("{} x {}", processor(), cores()).as_bytes())[..8].to_owned());
    &ID
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_widest_instruction_set_that_is_listed_is_the_widest_that_runs() {
        let found = Environment::examine();
        assert_eq!(found.isa_available.last(), Some(&found.isa_of_splats));
    }
}
