//! What all layouts share: where they write, how they tell their progress, and the words of EXPORT.md.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

use glam::DAffine3;
use rayon::prelude::*;

use crate::base::staging::Staging;
use crate::base::{Progress, Result, files};

/// What a layout says of itself.
pub(super) struct LayoutText {
    /// The body of EXPORT.md.
    pub about: String,
    /// What the user should know, a sentence each.
    pub notes: Vec<String>,
}

/// Where a layout is written to, and how it tells its progress.
pub(super) struct ExportWriter<'a> {
    pub staging: &'a Staging,
    pub progress: &'a dyn Progress,
}

impl ExportWriter<'_> {
    /// Where a file of that name, relative to the folder, is put together.
    pub fn path(&self, name: impl AsRef<Path>) -> PathBuf {
        self.staging.path(name)
    }

    /// Writes a text.
    pub fn text(&self, name: &str, text: &str) -> Result<()> {
        files::write_bytes(&self.path(name), text.as_bytes())
    }

    /// Does the work of every frame, side by side.
    pub fn each_frame(&self, frames: usize, work: impl Fn(usize) -> Result<()> + Sync) -> Result<()> {
        let done = AtomicUsize::new(0);
        (0..frames).into_par_iter().try_for_each(|frame| {
            self.progress.proceed()?;
            work(frame)?;
            let count = done.fetch_add(1, Ordering::Relaxed) + 1;
            self.progress.advance(count, frames);
            Ok(())
        })
    }
}

/// `pose` with its place in units of which `scale` are a millimetre.
pub(super) fn scaled(pose: &DAffine3, scale: f64) -> DAffine3 {
    DAffine3 { matrix3: pose.matrix3, translation: pose.translation * scale }
}

/// The unit of lengths, in words.
pub(super) fn unit_words(scale: f64) -> String {
    match scale {
        1.0 => "millimetres".into(),
        1e-3 => "metres".into(),
        _ => format!("{scale} to the millimetre"),
    }
}

/// `template` with `{name}` replaced by its value.
pub(super) fn filled(template: &str, values: &[(&str, String)]) -> String {
    values.iter().fold(template.to_owned(), |text, (name, value)| text.replace(&format!("{{{name}}}"), value))
}
