//! `respire-bench picture-statistics`: how far pictures look from real bronchoscopy.

use std::path::PathBuf;

use clap::Args;

use super::Terminal;
use crate::base::{Progress, Result, files};
use crate::experiments::picture_statistics::{PictureSet, columns, markdown, records};
use crate::report::tables::write_csv;

/// Arguments of `picture-statistics`.
#[derive(Args)]
#[command(
    after_help = "Prints one line per statistic: the range over sets of real pictures, that of the given ones, and \
    whether\ntheir median lies inside. Each folder (its PNG files) or picture is one set.\n\
    Example: respire-bench picture-statistics /tmp/films/case1/images /tmp/films/case2/images"
)]
pub struct PictureStatisticsArguments {
    /// Folders of pictures, or single pictures
    #[arg(required = true, value_name = "FOLDER")]
    folders: Vec<PathBuf>,
    /// Pictures have a round mask: take the square inside it
    #[arg(long)]
    masked: bool,
    /// Also writes picture-statistics.csv and picture-statistics.md into this folder
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

/// Reads, prints, and writes where asked.
pub fn run(arguments: PictureStatisticsArguments, terminal: &Terminal) -> Result<()> {
    let mut sets = Vec::new();
    terminal.stage("reading pictures");
    for (number, folder) in arguments.folders.iter().enumerate() {
        terminal.advance(number, arguments.folders.len());
        sets.push(PictureSet::read(folder, arguments.masked)?);
    }
    // Films keep their pictures in a folder of one name: the folder above says whose they are.
    for (set, folder) in sets.iter_mut().zip(&arguments.folders) {
        if set.name == "images"
            && let Some(film) = folder.parent().and_then(|parent| parent.file_name())
        {
            set.name = film.to_string_lossy().into_owned();
        }
    }
    let table = markdown(&sets);
    terminal.line(table.trim_end());
    if let Some(out) = &arguments.out {
        write_csv(&out.join("picture-statistics.csv"), &columns(), &records(&sets))?;
        files::write_bytes(&out.join("picture-statistics.md"), table.as_bytes())?;
    }
    Ok(())
}
