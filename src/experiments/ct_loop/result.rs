//! What the way from a case to its scans and back has cost.

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::base::{Result, files};
use crate::ct::lumen::DistanceSpread;

/// Generations that are told apart; the last stands for all beyond.
pub const GENERATIONS: u32 = 6;

/// How the imported airway was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum AirwayWay {
    /// From the true label map, as a perfect network would give it.
    Mask,
    /// By region growing.
    Grown,
}

impl AirwayWay {
    /// In tables.
    pub fn name(self) -> &'static str {
        match self {
            AirwayWay::Mask => "true mask",
            AirwayWay::Grown => "region growing",
        }
    }
}

/// One generation of the true airway.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct GenerationLoss {
    /// 0 trachea; the last stands for all beyond.
    pub generation: u32,
    /// Branches there are, and those found.
    pub branches: usize,
    /// Branches found.
    pub found: usize,
    /// Distance of the wall of the found ones from the imported wall, mm.
    pub wall: DistanceSpread,
}

/// What one way of finding the airway gave.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct WayResult {
    /// Which.
    pub way: AirwayWay,
    /// Why there is nothing, where there is nothing.
    pub failure: Option<String>,
    /// By generation.
    pub generations: Vec<GenerationLoss>,
    /// Distance of the wall of all found branches from the imported wall, mm.
    pub wall: DistanceSpread,
    /// The same for generations 0 to 3.
    pub wall_to_3: DistanceSpread,
    /// Distance of the imported wall from the true one, mm.
    pub imported_wall: DistanceSpread,
    /// Imported branches that are none.
    pub extra_branches: usize,
    /// Distance of the true centreline from the imported one along found branches, mm.
    pub centerline: DistanceSpread,
    /// Distance of the wall of found branches at expiration from the imported one, mm.
    pub wall_expiration: DistanceSpread,
}

impl WayResult {
    /// Branches of the true airway, and those that were found.
    pub fn totals(&self) -> (usize, usize) {
        let count = |of: fn(&GenerationLoss) -> usize| self.generations.iter().map(of).fold(0, usize::saturating_add);
        (count(|row| row.branches), count(|row| row.found))
    }
}

/// One case under one protocol.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LoopResult {
    /// Hash of the case, the protocol and the code; empty in files of earlier versions.
    #[serde(default)]
    pub key: String,
    /// Case.
    pub case_id: String,
    /// Protocol, by name.
    pub protocol: String,
    /// With the true mask, and grown.
    pub ways: Vec<WayResult>,
    /// Motion of the true airway, mm.
    pub motion: DistanceSpread,
    /// Error of the registered field at the true vertices of the airway, mm.
    pub airway_error: DistanceSpread,
    /// Error at forks of vessels, mm, and its mean.
    pub tissue_error: DistanceSpread,
    /// Mean error at forks of vessels, mm.
    pub tissue_error_mean_mm: f64,
    /// Voxels in the lungs that fold, of how many.
    pub folded: usize,
    /// Voxels in the lungs.
    pub voxels: usize,
}

impl LoopResult {
    /// Reads a result's file.
    ///
    /// Errors: it cannot be read or is no such file.
    pub fn read(path: &Path) -> Result<LoopResult> {
        files::read_json(path)
    }
}
