//! `respire-bench simulate-ct`: two CT scans of a case, with the truth beside them.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

use super::Terminal;
use super::selection::CatalogueFolder;
use super::stopped::all_or_nothing;
use crate::airway::case::Case;
use crate::base::{Progress, Result};
use crate::ct::simulated::chest::SimulatedChest;
use crate::ct::simulated::protocol::ScanProtocol;
use crate::ct::simulated::scan_truth::write_pair;

/// A protocol on the command line.
#[derive(Clone, Copy, ValueEnum)]
pub(super) enum ProtocolChoice {
    /// Voxels of 0.7 mm, a sharp kernel
    Thin,
    /// Slices of 2.5 mm, a medium kernel
    Thick,
}

impl ProtocolChoice {
    /// The protocol.
    pub(super) fn protocol(self) -> ScanProtocol {
        match self {
            ProtocolChoice::Thin => ScanProtocol::Thin,
            ProtocolChoice::Thick => ScanProtocol::Thick,
        }
    }
}

/// Arguments of `simulate-ct`.
#[derive(Args)]
#[command(
    after_help = "Writes inspiration.nii.gz and expiration.nii.gz (HU), label maps of airway and lobes, both surfaces, \
    the centreline, the displacement field and landmarks.\n\
    Example: respire-bench simulate-ct case1 --protocol thin --out /tmp/ct/case1"
)]
pub struct SimulateCtArguments {
    /// Case by id, or the path of a case file
    #[arg(value_name = "CASE")]
    case: String,
    /// Folder for scans and truth
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// How the scanner is set
    #[arg(long, value_enum, default_value = "thin")]
    protocol: ProtocolChoice,
    #[command(flatten)]
    catalogue: CatalogueFolder,
}

/// Runs the command.
pub fn run(arguments: SimulateCtArguments, terminal: &Terminal) -> Result<()> {
    let case = Case::load(&arguments.catalogue.open()?.case_file(&arguments.case)?)?;
    terminal.stage(format!("{}: chest", case.id));
    let chest = SimulatedChest::new(&case)?;
    all_or_nothing(terminal.proceed())?;
    terminal.stage(format!("{}: scanning", case.id));
    all_or_nothing(write_pair(&chest, arguments.protocol.protocol(), arguments.out.clone(), terminal))?;
    terminal.finish();
    terminal.line(arguments.out.display());
    Ok(())
}
