//! Which way the axes of an imported file point, as a word of the command line.

use clap::ValueEnum;

use crate::airway::import_tree::PatientAxes;

#[derive(Clone, Copy, ValueEnum)]
pub(super) enum AxesChoice {
    /// x left, y posterior, z superior
    Lps,
    /// x right, y anterior, z superior
    Ras,
}

impl AxesChoice {
    pub fn axes(self) -> PatientAxes {
        match self {
            AxesChoice::Lps => PatientAxes::Lps,
            AxesChoice::Ras => PatientAxes::Ras,
        }
    }
}
