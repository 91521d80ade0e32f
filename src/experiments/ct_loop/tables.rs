//! Tables of the loop: CSV, and Markdown for people.

use super::result::{AirwayWay, GENERATIONS, GenerationLoss, LoopResult};
use crate::base::statistics::upper_median;
use crate::ct::lumen::DistanceSpread;
use crate::ct::simulated::protocol::ScanProtocol;

/// Columns of the CSV: a row per case, protocol, way and generation; `all` holds what is of the whole case.
pub const COLUMNS: [&str; 16] = [
    "case",
    "protocol",
    "way",
    "generation",
    "branches",
    "found",
    "extra",
    "wall_median_mm",
    "wall_p95_mm",
    "wall_expiration_median_mm",
    "centerline_median_mm",
    "centerline_p95_mm",
    "airway_registration_median_mm",
    "airway_registration_p95_mm",
    "tissue_registration_mean_mm",
    "folded_voxels",
];

/// The rows of [`COLUMNS`].
pub fn records(results: &[LoopResult]) -> Vec<Vec<String>> {
    let number = |value: f64| format!("{value:.4}");
    let mut rows = Vec::new();
    for result in results {
        for way in &result.ways {
            let head = |generation: String| {
                vec![result.case_id.clone(), result.protocol.clone(), way.way.name().to_owned(), generation]
            };
            for row in &way.generations {
                let mut cells = head(row.generation.to_string());
                cells.extend([row.branches.to_string(), row.found.to_string(), String::new()]);
                cells.extend([number(row.wall.median_mm), number(row.wall.p95_mm)]);
                cells.resize(COLUMNS.len(), String::new());
                rows.push(cells);
            }
            let (all, found) = way.totals();
            let mut cells = head("all".to_owned());
            cells.extend([all.to_string(), found.to_string(), way.extra_branches.to_string()]);
            cells.extend(
                [
                    way.wall.median_mm,
                    way.wall.p95_mm,
                    way.wall_expiration.median_mm,
                    way.centerline.median_mm,
                    way.centerline.p95_mm,
                    result.airway_error.median_mm,
                    result.airway_error.p95_mm,
                    result.tissue_error_mean_mm,
                ]
                .map(number),
            );
            cells.push(result.folded.to_string());
            rows.push(cells);
        }
    }
    rows
}

/// Tables for people.
pub fn markdown(results: &[LoopResult]) -> String {
    let mut text = "# From a case to two CTs and back\n\nmm; median / 95th percentile. `wall` is the distance of the \
                    true wall from the imported one, along branches that were found.\n\n## Surface and tree\n\n\
                    | case, protocol, way | branches found / extra | wall, generations 0 to 3 | wall, all found | wall \
                    at expiration | centreline |\n|---|---|---|---|---|---|\n"
        .to_owned();
    let two = |spread: &DistanceSpread| format!("{:.2} / {:.2}", spread.median_mm, spread.p95_mm);
    for result in results {
        for way in &result.ways {
            let name = format!("{}, {}, {}", result.case_id, result.protocol, way.way.name());
            if let Some(failure) = &way.failure {
                text += &format!("| {name} | {failure} | | | | |\n");
                continue;
            }
            let (all, found) = way.totals();
            text += &format!(
                "| {name} | {found} of {all} / {} | {} | {} | {} | {} |\n",
                way.extra_branches,
                two(&way.wall_to_3),
                two(&way.wall),
                two(&way.wall_expiration),
                two(&way.centerline)
            );
        }
    }
    text += "\n## Registration\n\n| case, protocol | motion of the airway | error on the airway | error on forks of vessels \
             | its mean | voxels that fold |\n|---|---|---|---|---|---|\n";
    for result in results {
        text += &format!(
            "| {}, {} | {} | {} | {} | {:.2} | {} of {} |\n",
            result.case_id,
            result.protocol,
            two(&result.motion),
            two(&result.airway_error),
            two(&result.tissue_error),
            result.tissue_error_mean_mm,
            result.folded,
            result.voxels
        );
    }
    text += "\n## By generation\n\n| protocol, way | generation | found | wall, median of cases | worst case |\n\
             |---|---|---|---|---|\n";
    for protocol in ScanProtocol::ALL {
        for way in [AirwayWay::Mask, AirwayWay::Grown] {
            for generation in 0..GENERATIONS {
                text += &generation_line(results, protocol, way, generation).unwrap_or_default();
            }
        }
    }
    text
}

fn generation_line(results: &[LoopResult], protocol: ScanProtocol, way: AirwayWay, generation: u32) -> Option<String> {
    let rows: Vec<&GenerationLoss> = results
        .iter()
        .filter(|result| result.protocol == protocol.name())
        .flat_map(|result| result.ways.iter().filter(|w| w.way == way))
        .flat_map(|w| w.generations.iter().filter(|row| row.generation == generation))
        .collect();
    let medians: Vec<f64> = rows.iter().filter(|row| row.found > 0).map(|row| row.wall.median_mm).collect();
    let count = |of: fn(&GenerationLoss) -> usize| rows.iter().map(|row| of(row)).fold(0, usize::saturating_add);
    let branches = count(|row| row.branches);
    if branches == 0 {
        return None;
    }
    let found = count(|row| row.found);
    let last = if generation + 1 == GENERATIONS { " and beyond" } else { "" };
    let walls = match (upper_median(medians.iter().copied()), medians.iter().copied().max_by(f64::total_cmp)) {
        (Some(middle), Some(worst)) => format!("{middle:.2} | {worst:.2}"),
        _ => " | ".to_owned(),
    };
    Some(format!("| {}, {} | {generation}{last} | {found} of {branches} | {walls} |\n", protocol.name(), way.name()))
}

/// The table of [`super::masks::differences`].
pub fn mask_table(rows: &[GenerationLoss]) -> String {
    let mut text =
        "# How far masks of one airway differ\n\nEvery mask against every other one; mm, along branches that both \
                    have.\n\n| generation | branches of one that another has | wall, median / 95 % |\n|---|---|---|\n"
            .to_owned();
    for row in rows {
        let last = if row.generation + 1 == GENERATIONS { " and beyond" } else { "" };
        let share = 100.0 * row.found as f64 / row.branches.max(1) as f64;
        let wall = &row.wall;
        text += &format!(
            "| {}{last} | {} of {} ({share:.0} %) | {:.2} / {:.2} |\n",
            row.generation, row.found, row.branches, wall.median_mm, wall.p95_mm
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use super::super::result::WayResult;
    use super::*;

    /// Found by the fuzzer: their sum wrapped, and fewer branches than there are were told.
    #[test]
    fn counts_beyond_what_a_number_holds_stay_at_its_end() {
        let row = GenerationLoss { generation: 0, branches: usize::MAX, found: 1, wall: DistanceSpread::default() };
        let way = WayResult {
            way: AirwayWay::Mask,
            failure: None,
            generations: vec![row],
            wall: DistanceSpread::default(),
            wall_to_3: DistanceSpread::default(),
            imported_wall: DistanceSpread::default(),
            extra_branches: 0,
            centerline: DistanceSpread::default(),
            wall_expiration: DistanceSpread::default(),
        };
        let protocol = ScanProtocol::Thin.name().to_owned();
        let result = LoopResult { protocol, ways: vec![way], ..LoopResult::default() };
        let line = generation_line(&[result.clone(), result], ScanProtocol::Thin, AirwayWay::Mask, 0).unwrap();
        assert!(line.contains(&format!("2 of {}", usize::MAX)), "{line}");
    }
}
