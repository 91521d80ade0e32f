//! Gradients against central differences in double precision, and the faults that the same check must catch.

use super::row::StressRow;
use crate::base::Result;
use crate::splat::Fault;
use crate::splat::gradient_check::{CentralDifferences, GradientCase, LANE_LIMIT};

/// Prefix of the rows of the faults.
pub(super) const FAULT: &str = "seeded fault";
/// Scenes of the check.
const SCENES: u64 = 75;
/// Scenes that the faults are tried on.
const FAULT_SCENES: usize = 12;

/// A row per group of gradients (worst value of all scenes), and one per fault: its error is that of the worst value on
/// the scene that shows it best, and it passes when it is caught.
pub(super) fn rows() -> Result<Vec<StressRow>> {
    let truths =
        (0..SCENES).map(|seed| CentralDifferences::new(GradientCase::new(seed))).collect::<Result<Vec<_>>>()?;
    let mut groups: Vec<StressRow> = Vec::new();
    for truth in &truths {
        for finding in truth.compare(None)? {
            let name = format!("f64 gradient of {} by central differences", finding.group);
            let found = groups.iter_mut().find(|row| row.item == name);
            let error = found.as_ref().map_or(0.0, |row| row.gradient_error).max(finding.worst_lane);
            let row = StressRow {
                gradient_error: error,
                worst_group: finding.group,
                passed: error <= LANE_LIMIT,
                ..StressRow::of_claim(name, true)
            };
            match found {
                Some(place) => *place = row,
                None => groups.push(row),
            }
        }
    }
    for fault in Fault::ALL {
        let (mut worst, mut group) = (0.0, "-");
        for truth in &truths[..FAULT_SCENES] {
            for finding in truth.compare(Some(fault))? {
                if finding.worst_lane > worst {
                    (worst, group) = (finding.worst_lane, finding.group);
                }
            }
        }
        let caught = worst > LANE_LIMIT;
        let row = StressRow::of_claim(format!("{FAULT} {fault:?} is caught"), caught);
        groups.push(StressRow { gradient_error: worst, worst_group: group, ..row });
    }
    Ok(groups)
}
