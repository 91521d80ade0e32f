//! The airway as a mask: one label of somebody's segmentation, or grown from the scan ([`super::region`]).

use std::path::Path;

use super::parts::{VoxelContact, fill_holes, mask_of, parts};
use super::scan::turned;
use crate::airway::import_check::ExpectedAnatomy;
use crate::base::{Error, Result, Volume};
use crate::formats::volume::read_labels;

/// Volume in ml of the airway that a CT shows: a child's trachea to a wide tree.
const AIRWAY_ML: [f64; 2] = [5.0, 300.0];

/// An airway mask, and what was taken away from it.
pub struct AirwayMask {
    /// 1 in the lumen; i, j and k to the left, back and head.
    pub mask: Volume<u8>,
    /// Volume in ml.
    pub volume_ml: f64,
    /// Loose parts that were left out.
    pub loose_parts: usize,
    /// Their share of all voxels.
    pub loose_share: f64,
}

/// Reads a label map and takes label `wanted` of it, or its only one. The largest connected part is kept, its holes
/// filled.
///
/// Errors name the file: several labels and none wanted, a label that is not there, a part that is no airway by its
/// size.
pub fn read_mask(path: &Path, wanted: Option<u16>, anatomy: ExpectedAnatomy) -> Result<AirwayMask> {
    let labels = read_labels(path)?;
    chosen(&labels, wanted).and_then(|mask| cleaned(mask, anatomy)).map_err(|e| e.at(path))
}

/// Voxels of label `wanted`, or of the only one there is.
pub fn chosen(labels: &Volume<u16>, wanted: Option<u16>) -> Result<Volume<u8>> {
    let mut counts = std::collections::BTreeMap::<u16, usize>::new();
    labels.data.iter().filter(|v| **v > 0).for_each(|&v| *counts.entry(v).or_default() += 1);
    let present: Vec<String> = counts.keys().take(20).map(u16::to_string).collect();
    let label = match (wanted, counts.len()) {
        (_, 0) => return Err(Error::input("holds no label above 0: it is empty")),
        (Some(label), _) if counts.contains_key(&label) => label,
        (Some(label), _) => {
            return Err(Error::input(format!("holds no label {label}; it holds {}", present.join(", "))));
        }
        (None, 1) => *counts.keys().next().unwrap_or(&1),
        (None, count) => {
            return Err(Error::input(format!(
                "holds {count} labels ({}): --label says which one is the airway",
                present.join(", ")
            )));
        }
    };
    Ok(labels.map(|v| u8::from(v == label)))
}

/// The largest part, without holes. A human one has the size of an airway.
pub fn cleaned(mask: Volume<u8>, anatomy: ExpectedAnatomy) -> Result<AirwayMask> {
    let mask = turned(mask);
    let all = mask.data.iter().filter(|v| **v > 0).count();
    let found = parts(&mask, VoxelContact::Corners);
    let largest = found.first().ok_or_else(|| Error::input("the airway mask is empty"))?;
    let volume_ml = largest.len() as f64 * mask.grid.voxel_mm3() * 1e-3;
    if anatomy == ExpectedAnatomy::Human && !(AIRWAY_ML[0]..=AIRWAY_ML[1]).contains(&volume_ml) {
        return Err(Error::input(format!(
            "its largest part has {volume_ml:.1} ml, and an airway has {} to {} ml: it is another organ, or the airway \
             with lung in it; --unusual takes it",
            AIRWAY_ML[0], AIRWAY_ML[1]
        )));
    }
    let loose_share = 1.0 - largest.len() as f64 / all as f64;
    let mut kept = mask_of(mask.grid, largest);
    fill_holes(&mut kept);
    Ok(AirwayMask { mask: kept, volume_ml, loose_parts: found.len() - 1, loose_share })
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::base::VoxelGrid;

    #[test]
    fn a_label_is_chosen_cleaned_and_held_against_an_airways_size() {
        let grid = VoxelGrid::upright([40, 40, 40], DVec3::ZERO, DVec3::ONE);
        let label = |at: usize| {
            let p = grid.centre(at);
            if (p.truncate() - 20.0).length() < 9.0 {
                u16::from((p.truncate() - 20.0).length() > 1.5) * 3
            } else {
                u16::from(at == 5) * 7
            }
        };
        let labels = Volume { grid, data: (0..grid.count()).map(label).collect() };
        let human = |mask| cleaned(mask, ExpectedAnatomy::Human);
        let said = |wanted| chosen(&labels, wanted).and_then(human).err().unwrap().to_string();
        assert!(said(None).contains("2 labels (3, 7): --label"));
        assert!(said(Some(4)).contains("no label 4; it holds 3, 7"));
        assert!(said(Some(7)).contains("0.0 ml"));
        let small = chosen(&labels, Some(7)).and_then(|mask| cleaned(mask, ExpectedAnatomy::Any)).unwrap();
        assert!(small.volume_ml < 0.1);
        let airway = chosen(&labels, Some(3)).and_then(human).unwrap();
        assert_eq!(airway.loose_parts, 0);
        assert!((airway.volume_ml - 9.8).abs() < 0.5, "{}", airway.volume_ml);
    }
}
