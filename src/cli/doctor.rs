//! `doctor`: what is installed, which instruction set, which library versions, what is missing and what mends it.

use serde::Serialize;

use super::Terminal;
use crate::base::{Error, ErrorKind, Result};
use crate::ffi::system;
use crate::ffi::versions::{EMBREE_HEADER, embree_complaint, embree_runtime};
use crate::ffi::vision;

/// The one command that mends a machine.
const REMEDY: &str = "scripts/setup.sh";

/// Below this a `quick` run does not fit.
const MEMORY_NEEDED_MIB: f64 = 1500.0;

/// Arguments of `doctor`.
#[derive(clap::Args)]
#[command(after_help = "Example: respire-bench doctor --json")]
pub struct Arguments {
    /// Write JSON.
    #[arg(long)]
    json: bool,
}

/// What `doctor` found; the keys of `doctor --json`.
#[derive(Serialize)]
struct Findings {
    version: &'static str,
    rustc: &'static str,
    embree_runtime: String,
    embree_header: String,
    opencv: String,
    isa_available: Vec<&'static str>,
    isa_used: &'static str,
    cores: usize,
    memory_mib: f64,
    missing: Vec<String>,
}

fn isa_available() -> Vec<&'static str> {
    let mut found = vec!["sse2"];
    #[cfg(target_arch = "x86_64")]
    for (name, present) in [
        ("sse4.2", is_x86_feature_detected!("sse4.2")),
        ("avx2", is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma")),
        ("avx512", is_x86_feature_detected!("avx512f") && is_x86_feature_detected!("avx512dq")),
    ] {
        if present {
            found.push(name);
        }
    }
    found
}

fn examine() -> Findings {
    let embree = embree_runtime();
    let mut missing: Vec<String> = embree_complaint(embree, EMBREE_HEADER).into_iter().collect();
    let isa_available = isa_available();
    // Results are pinned to one instruction set, so that they are the same on every machine that has it.
    let isa_used = if isa_available.contains(&"avx2") { "avx2" } else { "sse2" };
    if isa_used != "avx2" {
        missing.push("the processor has no AVX2: results will differ in the last bits from the published ones".into());
    }
    let memory_mib = system::memory_mib();
    if memory_mib < MEMORY_NEEDED_MIB {
        missing.push(format!("the machine has {memory_mib:.0} MiB of memory; {MEMORY_NEEDED_MIB:.0} MiB are needed"));
    }
    Findings {
        version: env!("CARGO_PKG_VERSION"),
        rustc: env!("RESPIRE_BENCH_RUSTC"),
        embree_runtime: embree.map_or_else(|| "none".into(), |v| v.to_string()),
        embree_header: EMBREE_HEADER.to_string(),
        opencv: vision::version(),
        isa_available,
        isa_used,
        cores: std::thread::available_parallelism().map_or(1, |n| n.get()),
        memory_mib,
        missing,
    }
}

/// Prints the findings; `ErrorKind::Environment` when something is missing.
pub fn run(arguments: Arguments, terminal: &Terminal) -> Result<()> {
    let found = examine();
    if arguments.json {
        terminal.json(&found)?;
    } else {
        let lines = [
            ("respire-bench", found.version.to_owned()),
            ("compiler", found.rustc.to_owned()),
            ("Embree", format!("{} (headers {})", found.embree_runtime, found.embree_header)),
            ("OpenCV", found.opencv.clone()),
            ("instruction sets", format!("{} (used: {})", found.isa_available.join(", "), found.isa_used)),
            ("cores", found.cores.to_string()),
            ("memory", format!("{:.0} MiB", found.memory_mib)),
        ];
        for (name, value) in lines {
            terminal.line(format_args!("{name:<18}{value}"));
        }
    }
    match found.missing.as_slice() {
        [] => {
            if !arguments.json {
                terminal.line("nothing is missing");
            }
            Ok(())
        }
        missing => Err(Error::new(ErrorKind::Environment, format!("{}; to mend it: {REMEDY}", missing.join("; ")))),
    }
}
