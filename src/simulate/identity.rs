//! What makes two sequences the same: content hashes, and the folder's name that follows from them.

use std::path::{Path, PathBuf};

use super::exposure::is_spot;
use super::look::material;
use super::settings::SimulationSettings;
use crate::airway::case::Case;
use crate::base::revision::of_rooms;
use crate::base::{Result, hash};

/// Changes whenever the same case and settings give other pixels or other truth, on the ideal track.
const IDEAL_VERSION: u32 = 11;
/// The same for the clinical track.
const CLINICAL_VERSION: u32 = 12;
/// The same where a wall is not dark (`Material::is_dark`), on both tracks: what changed last is their light alone.
const BRIGHT_VERSION: u32 = 13;
/// The same where the lamp lights a spot ([`is_spot`]) or a mask hides part of the picture, on both tracks: what changed
/// last is their exposure alone.
const METERED_VERSION: u32 = 14;

/// Revision of the code that films a sequence.
pub fn revision() -> String {
    of_rooms(&["outside", "tracer", "base", "formats", "airway", "render", "simulate"])
}

/// Version of what films `case`.
pub(super) fn simulator_version(case: &Case) -> u32 {
    match material(case) {
        _ if is_spot(case.scope.emission_half_angle_deg) || case.scope.mask_radius > 0.0 => METERED_VERSION,
        Ok(material) if !material.is_dark() => BRIGHT_VERSION,
        _ if case.clinical.is_some() => CLINICAL_VERSION,
        _ => IDEAL_VERSION,
    }
}

/// Content hash of the sequence that `case` and `settings` make, 64 hex digits.
pub fn sequence_hash(case: &Case, settings: &SimulationSettings) -> Result<String> {
    hash::of_value(&(simulator_version(case), case.hash()?, settings))
}

/// Content hash of the frames of `case`: of everything but what methods are told of the motion, this program's code
/// included (a changed renderer must not reuse older frames). 64 hex digits.
pub(super) fn film_hash(case: &Case, settings: &SimulationSettings) -> Result<String> {
    let film = Case { registration_error_mm: 0.0, ..case.clone() };
    hash::of_value(&("film", revision(), film.hash()?, settings))
}

/// Where the sequence of `case` lives below `root`: `<case>-<hash12>`.
pub fn sequence_folder(root: &Path, case: &Case, settings: &SimulationSettings) -> Result<PathBuf> {
    Ok(root.join(format!("{}-{}", case.id, &sequence_hash(case, settings)?[..12])))
}
