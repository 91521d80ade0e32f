//! The breathing airway as `airway.glb`: inspiration with one morph target, expiration.

use super::source::ExportSource;
use super::writer::{ExportWriter, LayoutText, filled};
use crate::base::{Result, files};
use crate::formats::glb;

/// Writes the surface.
pub(super) fn write(source: &ExportSource, writer: &ExportWriter<'_>) -> Result<LayoutText> {
    let bytes = glb::breathing(&source.inspiration()?, &source.expiration()?, source.period_s())?;
    files::write_bytes(&writer.path("airway.glb"), &bytes)?;
    let which = if source.shows_truth() { "the true one" } else { "the given one, with the registration's error" };
    let period = format!("{:.2}", source.period_s());
    let about = filled(include_str!("about/glb.md"), &[("which", which.to_owned()), ("period", period)]);
    Ok(LayoutText { about, notes: Vec::new() })
}
