//! `respire-bench ct-loop`: cases become scans, scans become cases, and the difference is measured.

use std::path::PathBuf;

use clap::Args;

use super::Terminal;
use super::selection::CatalogueFolder;
use super::simulate_ct::ProtocolChoice;
use super::stopped::resumable;
use crate::airway::case::Case;
use crate::base::{Result, files};
use crate::experiments::ct_loop::masks::differences;
use crate::experiments::ct_loop::tables::{COLUMNS, markdown, mask_table, records};
use crate::experiments::ct_loop::{LoopSettings, measure};
use crate::report::tables::write_csv;

/// Arguments of `ct-loop`.
#[derive(Args)]
#[command(
    after_help = "Needs elastix (scripts/setup.sh --ct); minutes a case. A case whose result is there, from the same files \
    and program, is not measured again. DIR/PROTOCOL/CASE holds the imported airway in both states (inspiration.ply, expiration.ply).\n\
    Examples:\n  respire-bench ct-loop case1 --protocol thin --out /tmp/ct-loop\n  respire-bench ct-loop --masks \
    one.nii.gz another.nii.gz --out /tmp/masks"
)]
pub struct CtLoopArguments {
    /// Cases by id, or paths of case files; all of them when not given
    #[arg(value_name = "CASE")]
    cases: Vec<String>,
    /// How the scanner is set, one or both
    #[arg(long, value_enum, value_delimiter = ',', default_value = "thin", value_name = "PROTOCOL,..")]
    protocol: Vec<ProtocolChoice>,
    /// Instead: two or more label maps of one airway, and how far they differ from each other (masks.md)
    #[arg(long, value_name = "MASK", num_args = 1.., conflicts_with_all = ["cases", "protocol"])]
    masks: Vec<PathBuf>,
    /// Folder for results, ct-loop.csv and ct-loop.md
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Leaves the scans on disk
    #[arg(long)]
    keep_scans: bool,
    #[command(flatten)]
    catalogue: CatalogueFolder,
}

/// Runs the command.
pub fn run(arguments: CtLoopArguments, terminal: &Terminal) -> Result<()> {
    if !arguments.masks.is_empty() {
        terminal.stage("surfaces of the masks");
        let table = mask_table(&differences(&arguments.masks, terminal)?);
        terminal.finish();
        files::write_bytes(&arguments.out.join("masks.md"), table.as_bytes())?;
        terminal.line(table.trim_end());
        return Ok(());
    }
    let catalogue = arguments.catalogue.open()?;
    let names = if arguments.cases.is_empty() { catalogue.case_ids()? } else { arguments.cases };
    let load = |name: &String| Case::load(&catalogue.case_file(name)?);
    let cases: Vec<Case> = names.iter().map(load).collect::<Result<_>>()?;
    let mut results = Vec::new();
    for protocol in arguments.protocol.iter().map(|choice| choice.protocol()) {
        let settings = LoopSettings { protocol, out: arguments.out.clone(), keep_scans: arguments.keep_scans };
        for case in &cases {
            terminal.stage(format!("{}, {}", case.id, protocol.name()));
            results.push(resumable(measure(case, &settings, terminal))?);
            write_csv(&arguments.out.join("ct-loop.csv"), &COLUMNS.map(String::from), &records(&results))?;
            files::write_bytes(&arguments.out.join("ct-loop.md"), markdown(&results).as_bytes())?;
        }
    }
    terminal.finish();
    terminal.line(markdown(&results).trim_end());
    Ok(())
}
