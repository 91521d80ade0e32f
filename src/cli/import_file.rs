//! How an imported file is to be understood: the arguments that `import mesh`, `mesh-pair`, `tree`
//! and `ct` share.

use clap::Args;

use crate::airway::import_axes::PatientAxes;
use crate::airway::import_check::ExpectedAnatomy;
use crate::airway::import_mesh::{FileMeaning, PartChoice};
use crate::base::range::NumberRange;

/// Units of 1e-6 mm to 1e6 mm.
const UNIT_MM: NumberRange = NumberRange::new(1e-6, 1e6);

#[derive(Args)]
pub(super) struct FileArguments {
    /// Where x, y and z of the file point: one each of l/r (left, right), p/a (posterior, anterior), s/i (superior,
    /// inferior); lps without
    #[arg(long, value_name = "LPS|RAS|..")]
    axes: Option<PatientAxes>,
    /// The file's unit in mm: 10 for centimetres, 1000 for metres
    #[arg(long, value_name = "R", value_parser = UNIT_MM.parser::<f64>())]
    scale: Option<f64>,
    /// Of several loose parts, take the one with the most faces
    #[arg(long)]
    keep_largest: bool,
    /// Take an airway that is no human one by its size, its trachea, or how it lies (an animal, a phantom)
    #[arg(long)]
    unusual: bool,
}

impl FileArguments {
    /// The first option given that says something of a surface's file and nothing of a volume's.
    pub(super) fn only_for_surfaces(&self) -> Option<&'static str> {
        let given =
            [("--axes", self.axes.is_some()), ("--scale", self.scale.is_some()), ("--keep-largest", self.keep_largest)];
        given.into_iter().find(|(_, is_given)| *is_given).map(|(name, _)| name)
    }

    pub(super) fn meaning(&self) -> FileMeaning {
        FileMeaning {
            axes: self.axes.unwrap_or(PatientAxes::LPS),
            scale: self.scale.unwrap_or(1.0),
            parts: if self.keep_largest { PartChoice::Largest } else { PartChoice::Single },
            anatomy: expected_anatomy(self.unusual),
        }
    }
}

/// What `--unusual` says.
pub(super) fn expected_anatomy(is_unusual: bool) -> ExpectedAnatomy {
    if is_unusual { ExpectedAnatomy::Any } else { ExpectedAnatomy::Human }
}
