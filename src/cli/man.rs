//! `man`: the help of every command as a manual page.

use std::path::{Path, PathBuf};

use clap::Command;
use clap_mangen::Man;

use super::Terminal;
use crate::base::{Error, Result, files};

/// Arguments of `man`.
#[derive(clap::Args)]
#[command(after_help = "Writes respire-bench.1 and a page for each command, respire-bench-COMMAND.1.\n\
    Example: respire-bench man --out ~/.local/share/man/man1 && man respire-bench-simulate")]
pub struct ManArguments {
    /// Folder for the pages
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

/// Writes the pages of the whole command `line`.
pub fn run(arguments: ManArguments, line: Command, terminal: &Terminal) -> Result<()> {
    // `help` repeats what every page says.
    let mut line = line.disable_help_subcommand(true);
    // Gives commands their whole names (`respire-bench-import-ct`), and the global options.
    line.build();
    let count = write_pages(&line, &arguments.out)?;
    terminal.line(format_args!("{}: {count} pages", arguments.out.display()));
    Ok(())
}

/// The page of `command` and those of its subcommands; how many they are.
fn write_pages(command: &Command, folder: &Path) -> Result<usize> {
    let page = Man::new(command.clone()).source(concat!("respire-bench ", env!("CARGO_PKG_VERSION")));
    let path = folder.join(page.get_filename());
    let mut bytes = Vec::new();
    page.render(&mut bytes).map_err(|e| Error::input(format!("cannot be written as a page: {e}")).at(&path))?;
    files::write_bytes(&path, &bytes)?;
    let below = command.get_subcommands().filter(|below| !below.is_hide_set());
    below.map(|below| write_pages(below, folder)).sum::<Result<usize>>().map(|count| count + 1)
}
