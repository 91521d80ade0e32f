//! Films in the layouts of other programs.
//!
//! ```text
//! film or participant's folder -> ExportSource -> a layout -> a new folder with EXPORT.md, which says what is in it
//!                                 (what may go out)  colmap, nerfstudio, endonerf, c3vd, tum, glb
//! ```
//!
//! What each layout holds, and what its readers assume, is written at the top of its file and in docs/export.md.

mod c3vd;
mod colmap_layout;
mod endonerf;
mod nerfstudio;
mod source;
mod surface_glb;
mod tum_layout;
mod writer;

use std::path::{Path, PathBuf};

use crate::base::staging::Staging;
use crate::base::{Error, Estimate, Progress, Result, files};
pub use endonerf::PoseAxes;
use source::ExportSource;
pub use source::ExportedTruth;
use writer::ExportWriter;

/// A layout.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExportFormat {
    /// COLMAP's model, with images and masks.
    Colmap,
    /// nerfstudio's `transforms.json` with splits and points, and D-NeRF's files where the camera allows them.
    Nerfstudio,
    /// EndoNeRF's folder: images, depth, masks, `poses_bounds.npy`.
    Endonerf,
    /// C3VD's folder: colour, depth, `pose.txt`, omnidirectional intrinsics.
    C3vd,
    /// A trajectory.
    Tum,
    /// The breathing surface.
    Glb,
}

/// What is asked for.
#[derive(Clone, Copy, Debug)]
pub struct ExportSettings {
    /// The layout.
    pub format: ExportFormat,
    /// Whether the truth goes out.
    pub truth: ExportedTruth,
    /// Units of the written lengths in a millimetre; `None` is the layout's own choice.
    pub scale: Option<f64>,
    /// Camera axes of EndoNeRF's poses.
    pub axes: PoseAxes,
}

/// What came of an export.
#[derive(Clone, Debug)]
pub struct Exported {
    /// The folder.
    pub folder: PathBuf,
    /// Frames that were written or stand in a table.
    pub frames: usize,
    /// What the user should know, a sentence each.
    pub notes: Vec<String>,
}

/// Name of the text that says what is in the folder.
const ABOUT: &str = "EXPORT.md";
/// Seconds and bytes that a pixel takes while it is decoded, encoded and held.
const PIXEL_S: f64 = 4e-7;
const PIXEL_BYTES: f64 = 64.0;

/// Writes the film or participant's folder in `root` into the new folder `out`, all of it or nothing.
///
/// Errors: a folder `out` that holds something; a layout that needs truth which is not shown, or a camera that it
/// cannot describe; an option that the layout does not have; reading and writing; `Interrupted` between frames.
pub fn export(root: &Path, settings: &ExportSettings, out: &Path, progress: &dyn Progress) -> Result<Exported> {
    settings.check()?;
    if out.exists() && out.read_dir().map_err(|e| Error::io("reading", out, e))?.next().is_some() {
        return Err(Error::input("is not empty: nothing is overwritten").at(out));
    }
    let source = ExportSource::open(root, settings.truth)?;
    settings.check_truth(&source)?;
    let pixels = f64::from(source.camera.width) * f64::from(source.camera.height);
    progress.accepts(&Estimate {
        memory_bytes: pixels * PIXEL_BYTES * rayon::current_num_threads() as f64,
        seconds: pixels * PIXEL_S * source.frames.len() as f64,
        resumable: false,
    })?;
    let staging = Staging::new(out)?;
    let writer = ExportWriter { staging: &staging, progress };
    let text = match settings.format {
        ExportFormat::Colmap => colmap_layout::write(&source, settings.scale.unwrap_or(1.0), &writer),
        ExportFormat::Nerfstudio => nerfstudio::write(&source, settings.scale.unwrap_or(1.0), &writer),
        ExportFormat::Endonerf => endonerf::write(&source, settings.scale, settings.axes, &writer),
        ExportFormat::C3vd => c3vd::write(&source, &writer),
        ExportFormat::Tum => tum_layout::write(&source, settings.scale.unwrap_or(1.0), &writer),
        ExportFormat::Glb => surface_glb::write(&source, &writer),
    }
    .map_err(|e| e.at(root))?;
    let about = text.about + source.track_words().unwrap_or_default();
    files::write_bytes(&staging.path(ABOUT), about.as_bytes())?;
    let names = files::names_in(&staging.path(""))?;
    staging.publish(&names)?;
    Ok(Exported { folder: out.to_path_buf(), frames: source.frames.len(), notes: text.notes })
}

impl ExportSettings {
    /// Refuses options that the layout does not have.
    fn check(&self) -> Result<()> {
        let refused = |why: &str| Err(Error::usage(why));
        match self.format {
            ExportFormat::C3vd if self.scale.is_some() => refused("--scale: C3VD is in millimetres"),
            ExportFormat::Glb if self.scale.is_some() => refused("--scale: glTF is in metres"),
            ExportFormat::Endonerf | ExportFormat::C3vd if self.truth == ExportedTruth::Hidden => refused(
                "--format: this layout holds the depth of every frame, which is truth; say --truth to export it",
            ),
            format if format != ExportFormat::Endonerf && self.axes != PoseAxes::default() => {
                refused("--axes: only the poses of EndoNeRF's layout are read in several ways")
            }
            _ => Ok(()),
        }
    }

    /// Refuses to show the truth in a layout that holds none: on the ideal track the poses and the surface are told.
    fn check_truth(&self, source: &ExportSource) -> Result<()> {
        let is_told = matches!(self.format, ExportFormat::Colmap | ExportFormat::Tum) && !source.is_clinical();
        if is_told && source.shows_truth() {
            return Err(Error::usage(
                "--truth: of a film of the ideal track this format holds what a method is told, and nothing else that is true",
            ));
        }
        Ok(())
    }
}
