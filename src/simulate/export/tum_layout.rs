//! The given poses as a trajectory (`trajectory.txt`), for evo and SLAM programs.

use super::source::ExportSource;
use super::writer::{ExportWriter, LayoutText, filled, scaled, unit_words};
use crate::base::Result;
use crate::formats::tum;

/// Writes the table.
pub(super) fn write(source: &ExportSource, scale: f64, writer: &ExportWriter<'_>) -> Result<LayoutText> {
    let rows = source.frames.iter().map(|f| (f.time_s, scaled(&f.world_from_camera, scale)));
    writer.text("trajectory.txt", &tum::trajectory(rows))?;
    let about = filled(include_str!("about/tum.md"), &[("unit", unit_words(scale))]);
    Ok(LayoutText { about, notes: Vec::new() })
}
