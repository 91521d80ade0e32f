//! Figures that the README quotes are those of the report that it names.

use std::collections::BTreeMap;
use std::path::Path;

/// The rows of the README's table, by the names that it gives them.
const ROWS: [(&str, &str); 12] = [
    ("BridgeSplat", "bridgesplat"),
    ("BridgeSplat, released objective", "bridgesplat-release"),
    ("BridgeSplat, no mesh", "bridgesplat-nomesh"),
    ("Ours, no mesh", "ours-nomesh"),
    ("Ours", "ours"),
    ("Ours + keyframes", "ours-window"),
    ("Gauss-Newton", "ours-gn"),
    ("Virtual bronchoscopy", "virtual-bronchoscopy"),
    ("No picture: pose", "pose-only"),
    ("No picture: clock", "mean-breath"),
    ("Static CT", "static-ct"),
    ("Oracle phase", "oracle-phase"),
];
/// Its columns.
const COLUMNS: [&str; 4] = ["novel_psnr_db", "psnr_db", "phase_mae", "target_mean_mm"];

#[test]
fn the_table_of_the_readme_is_that_of_its_report() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut summary = csv::Reader::from_path(folder.join("reports/reference/quick/summary.csv")).unwrap();
    let records: Vec<BTreeMap<String, String>> = summary.deserialize().map(Result::unwrap).collect();
    let value = |method: &str, column: &str| -> f64 {
        records.iter().find(|record| record["method"] == method).unwrap()[column].parse().unwrap()
    };
    let readme = std::fs::read_to_string(folder.join("README.md")).unwrap();
    let table = readme.split("| method | PSNR dB, novel |").nth(1).unwrap();
    let lines: Vec<&str> = table.lines().skip(2).take_while(|line| line.starts_with('|')).collect();
    assert_eq!(lines.len(), ROWS.len());
    let mut quoted = 0;
    for (line, (name, method)) in lines.iter().zip(ROWS) {
        let cells: Vec<&str> = line.trim_matches('|').split('|').map(|cell| cell.trim().trim_matches('*')).collect();
        assert_eq!((cells[0], cells.len()), (name, 1 + COLUMNS.len()), "{line}");
        for (cell, column) in cells[1..].iter().zip(COLUMNS) {
            // What stands in brackets is the paper's.
            let Some(figure) = cell.split('(').next().map(str::trim).filter(|figure| !figure.is_empty()) else {
                continue;
            };
            let decimals = figure.split('.').nth(1).unwrap().len();
            let found = format!("{:.decimals$}", value(method, column));
            assert_eq!(figure.trim_start_matches('0'), found.trim_start_matches('0'), "{name}, {column}");
            quoted += 1;
        }
    }
    assert_eq!(quoted, 42);
}
