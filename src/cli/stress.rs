//! `respire-bench stress`: the numerical-stability table.

use std::path::PathBuf;

use clap::Args;

use super::Terminal;
use crate::base::{Error, ErrorKind, Result, files};
use crate::experiments::stress::{self, StressRow, StressSize};

/// Arguments of `stress`.
#[derive(Args)]
#[command(
    after_help = "Writes stress.csv into DIR when given. Fails when a number is not finite or an error is larger than\n\
    1e-3 (image) or 2e-2 (worst group of gradients) relative to double precision; of values of 3e38, which single\n\
    precision cannot square, only finite results are asked. Metrics are held against closed forms, gradients against\n\
    central differences (1e-6 for every value), and every fault seeded into the backward pass must be caught by them.\n\
    Example: respire-bench stress --out /tmp/stress"
)]
pub struct StressArguments {
    /// Folder for the table
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Leave out the items with a million Gaussians and 4096x4096 pixels
    #[arg(long)]
    small: bool,
    /// The table as JSON
    #[arg(long)]
    json: bool,
}

/// Prints the table; `ErrorKind::CellFailed` when an item failed.
pub fn run(arguments: StressArguments, terminal: &Terminal) -> Result<()> {
    let rows = stress::rows(if arguments.small { StressSize::Small } else { StressSize::Full }, terminal)?;
    if let Some(folder) = &arguments.out {
        files::write_bytes(&folder.join("stress.csv"), stress::csv(&rows).as_bytes())?;
    }
    if arguments.json {
        terminal.json(&rows)?;
    } else {
        print(&rows, terminal);
    }
    let failed = rows.iter().filter(|r| !r.passed).count();
    if failed > 0 {
        return Err(Error::new(ErrorKind::CellFailed, format!("{failed} of {} items failed", rows.len())));
    }
    Ok(())
}

fn print(rows: &[StressRow], terminal: &Terminal) {
    terminal.line(format!("{:<34} {:>9} {:>9} {:<10} not finite", "item", "image", "gradient", "worst"));
    for r in rows {
        let mark = if r.passed { "" } else { "  FAILED" };
        let (image, gradient) = (r.image_error, r.gradient_error);
        terminal.line(format!(
            "{:<34} {image:>9.1e} {gradient:>9.1e} {:<10} {}{mark}",
            r.item, r.worst_group, r.not_finite
        ));
    }
    terminal.line(stress::summary(rows));
}
