//! `export`: a film in the layout of another program.

use std::path::PathBuf;

use clap::ValueEnum;

use super::Terminal;
use crate::base::range::NumberRange;
use crate::base::{Progress, Result};
use crate::simulate::export::{ExportFormat, ExportSettings, ExportedTruth, PoseAxes, export};

/// Arguments of `export`.
#[derive(clap::Args)]
#[command(after_help = "\
    SEQUENCE is a film or a participant's folder of `simulate --blind`. By default only what a participant \
    may see goes out. EXPORT.md in the new folder says what is in it, and the command lines of those who read it; \
    docs/export.md, what their loaders assume.\n\
    Example: respire-bench export films/case1 --format colmap --out /tmp/case1-colmap")]
pub struct ExportArguments {
    /// Film, or participant's folder
    #[arg(value_name = "SEQUENCE")]
    sequence: PathBuf,
    /// Layout to write
    #[arg(long, value_enum)]
    format: LayoutChoice,
    /// New folder
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Export the truth too: the depth of every frame, the true surfaces; of the clinical track, the true camera and
    /// poses
    #[arg(long)]
    truth: bool,
    /// Units of lengths in a millimetre: 0.001 writes metres [default: 1.0; for endonerf 10.0]
    #[arg(long, value_name = "N", value_parser = SCALE.parser::<f64>())]
    scale: Option<f64>,
    /// Of endonerf: camera axes of the poses
    #[arg(long, value_enum, default_value_t = AxesChoice::Opengl)]
    axes: AxesChoice,
}

/// Units of lengths in a millimetre.
const SCALE: NumberRange = NumberRange::new(1e-6, 1e6);

#[derive(Clone, Copy, ValueEnum)]
enum LayoutChoice {
    /// COLMAP's model, text and binary: gsplat, nerfstudio, OpenSplat, Brush
    Colmap,
    /// transforms.json with splits and points; D-NeRF's files
    Nerfstudio,
    /// Images, depth, masks, poses_bounds.npy: EndoGaussian, Deform3DGS; needs --truth
    Endonerf,
    /// Colour, depth, pose.txt, omnidirectional intrinsics; needs --truth
    C3vd,
    /// A trajectory for evo
    Tum,
    /// The breathing surface with one morph target
    Glb,
}

#[derive(Clone, Copy, ValueEnum)]
enum AxesChoice {
    /// EndoNeRF, Deform3DGS
    Opengl,
    /// EndoGaussian
    Opencv,
}

/// Writes the folder, says where it is.
pub fn run(arguments: ExportArguments, terminal: &Terminal) -> Result<()> {
    let settings = ExportSettings {
        format: match arguments.format {
            LayoutChoice::Colmap => ExportFormat::Colmap,
            LayoutChoice::Nerfstudio => ExportFormat::Nerfstudio,
            LayoutChoice::Endonerf => ExportFormat::Endonerf,
            LayoutChoice::C3vd => ExportFormat::C3vd,
            LayoutChoice::Tum => ExportFormat::Tum,
            LayoutChoice::Glb => ExportFormat::Glb,
        },
        truth: if arguments.truth { ExportedTruth::Shown } else { ExportedTruth::Hidden },
        scale: arguments.scale,
        axes: match arguments.axes {
            AxesChoice::Opengl => PoseAxes::OpenGl,
            AxesChoice::Opencv => PoseAxes::OpenCv,
        },
    };
    terminal.stage("exporting");
    let exported = export(&arguments.sequence, &settings, &arguments.out, terminal)?;
    terminal.finish();
    exported.notes.iter().for_each(|note| terminal.note(note));
    terminal.line(format_args!(
        "{}: {} frames; EXPORT.md says what is there",
        exported.folder.display(),
        exported.frames
    ));
    Ok(())
}
