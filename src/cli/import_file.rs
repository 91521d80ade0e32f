//! How an imported file is to be understood: the arguments that `import mesh`, `mesh-pair` and `tree` share.

use clap::Args;

use crate::airway::import_axes::PatientAxes;
use crate::airway::import_mesh::{ExpectedAnatomy, FileMeaning, PartChoice};
use crate::base::range::NumberRange;

/// Units of 1e-6 mm to 1e6 mm.
const UNIT_MM: NumberRange = NumberRange::new(1e-6, 1e6);

#[derive(Args)]
pub(super) struct FileArguments {
    /// Where x, y and z of the file point: one each of l/r (left, right), p/a (posterior, anterior), s/i (superior,
    /// inferior)
    #[arg(long, default_value_t = PatientAxes::LPS, value_name = "LPS|RAS|..")]
    axes: PatientAxes,
    /// The file's unit in mm: 10 for centimetres, 1000 for metres
    #[arg(long, default_value_t = 1.0, value_name = "R", value_parser = UNIT_MM.parser::<f64>())]
    scale: f64,
    /// Of several loose parts, take the one with the most faces
    #[arg(long)]
    keep_largest: bool,
    /// Take an airway that is no human one by its size, its trachea, or how it lies (an animal, a phantom)
    #[arg(long)]
    unusual: bool,
}

impl FileArguments {
    pub(super) fn meaning(&self) -> FileMeaning {
        FileMeaning {
            axes: self.axes,
            scale: self.scale,
            parts: if self.keep_largest { PartChoice::Largest } else { PartChoice::Single },
            anatomy: if self.unusual { ExpectedAnatomy::Any } else { ExpectedAnatomy::Human },
        }
    }
}
