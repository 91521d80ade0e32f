//! Writes cost against error of many settings: the table as CSV, the chart as SVG and PNG.

use std::path::{Path, PathBuf};

use super::pareto_chart::{ParetoChart, SettingRole, on_front};
use super::plots;
use super::tables::write_csv;
use crate::base::{Error, Result};

/// Writes `<stem>.csv`, `<stem>.svg` and `<stem>.png` into `folder`; returns the path of the CSV.
///
/// Errors: no points, points with different extra columns, an unwritable folder.
pub fn write(chart: &ParetoChart, folder: &Path, stem: &str) -> Result<PathBuf> {
    let Some(first) = chart.points.first() else { return Err(Error::input("nothing was measured")) };
    let names: Vec<&str> = first.extra.iter().map(|e| e.0).collect();
    let front = on_front(&chart.points);
    let mut rows = Vec::new();
    for (point, on_front) in chart.points.iter().zip(&front) {
        if point.extra.iter().map(|e| e.0).ne(names.iter().copied()) {
            return Err(Error::input("has other columns than the points before it").element(&point.setting));
        }
        let mut row = vec![point.subject.clone(), point.mode.clone(), point.setting.clone()];
        row.extend([point.cost.to_string(), point.error.to_string(), on_front.to_string()]);
        row.push((point.role == SettingRole::Default).to_string());
        row.extend(point.extra.iter().map(|e| e.1.to_string()));
        rows.push(row);
    }
    let fixed = ["subject", "mode", "setting", "cost", "error", "front", "default"];
    let header: Vec<String> = fixed.iter().chain(&names).map(|s| s.to_string()).collect();
    let table = folder.join(format!("{stem}.csv"));
    write_csv(&table, &header, &rows)?;
    plots::draw_pareto(chart, &front, folder, stem)?;
    Ok(table)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::pareto_chart::ParetoPoint;

    fn point(subject: &str, cost: f64, error: f64) -> ParetoPoint {
        let role = if cost == 2.0 { SettingRole::Default } else { SettingRole::Alternative };
        let setting = format!("{cost}");
        ParetoPoint {
            subject: subject.into(),
            mode: "raw".into(),
            setting,
            cost,
            error,
            role,
            extra: vec![("rays", 7.0)],
        }
    }

    fn chart() -> ParetoChart {
        let points = vec![point("a", 1.0, 1.0), point("a", 2.0, 0.5), point("a", 3.0, 0.6), point("b", 4.0, 9.0)];
        ParetoChart { cost: "CPU seconds", error: "relMSE", points }
    }

    #[test]
    fn front_holds_what_nothing_beats() {
        assert_eq!(on_front(&chart().points), [true, true, false, true]);
        // Of two equal points neither beats the other.
        assert_eq!(on_front(&[point("a", 1.0, 1.0), point("a", 1.0, 1.0)]), [true, true]);
    }

    #[test]
    fn table_and_plots_are_written() {
        let folder = tempfile::tempdir().unwrap();
        let table = write(&chart(), folder.path(), "pareto-test").unwrap();
        let text = std::fs::read_to_string(table).unwrap();
        assert_eq!(text.lines().next().unwrap(), "subject,mode,setting,cost,error,front,default,rays");
        assert_eq!(text.lines().nth(2).unwrap(), "a,raw,2,2,0.5,true,true,7");
        let svg = std::fs::read_to_string(folder.path().join("pareto-test.svg")).unwrap();
        assert!(svg.contains("relMSE") && svg.contains("default"));
        assert!(folder.path().join("pareto-test.png").is_file());
        assert!(write(&ParetoChart { points: vec![], ..chart() }, folder.path(), "none").is_err());
        let mut uneven = chart();
        uneven.points[1].extra.clear();
        assert!(write(&uneven, folder.path(), "uneven").is_err());
    }
}
