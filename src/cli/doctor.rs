//! `doctor`: what is installed, which instruction set, which library versions, what is missing and how to fix it.

use super::Terminal;
use crate::base::{Error, ErrorKind, Result};
use crate::bench::Environment;
use crate::ct::program::REMEDY as SCANS;

/// Installs what is missing.
const REMEDY: &str = "scripts/setup.sh";

/// Arguments of `doctor`.
#[derive(clap::Args)]
#[command(after_help = "Exit code 5 when something is missing.\nExample: respire-bench doctor --json")]
pub struct DoctorArguments {
    /// Write JSON.
    #[arg(long)]
    json: bool,
}

/// Prints the findings; `ErrorKind::Environment` when something is missing.
pub fn run(arguments: DoctorArguments, terminal: &Terminal) -> Result<()> {
    let found = Environment::examine();
    if arguments.json {
        terminal.json(&found)?;
    } else {
        let lines = [
            ("respire-bench", found.version.to_owned()),
            ("compiler", found.rustc.to_owned()),
            ("Embree", format!("{} (headers {})", found.embree_runtime, found.embree_header)),
            ("OpenCV", found.opencv.clone()),
            ("elastix", found.elastix.clone().unwrap_or_else(|| format!("none; for import ct: {SCANS}"))),
            ("dcm2niix", found.dcm2niix.clone().unwrap_or_else(|| format!("none; for compressed DICOM: {SCANS}"))),
            ("instruction sets", found.isa_available.join(", ")),
            ("used", format!("{} for rays, {} for splats", found.isa_of_rays, found.isa_of_splats)),
            ("processor", found.processor.clone()),
            ("cores", format!("{} ({} threads)", found.cores, found.threads)),
            ("memory", format!("{:.0} MiB", found.memory_mib)),
        ];
        for (name, value) in lines {
            terminal.line(format_args!("{name:<18}{value}"));
        }
    }
    if found.missing.is_empty() {
        if !arguments.json {
            terminal.line("nothing is missing");
        }
        return Ok(());
    }
    Err(Error::new(ErrorKind::Environment, format!("{}; to fix it, run {REMEDY}", found.missing.join("; "))))
}
