//! Cost against error of many settings: the Pareto front, as CSV and as a plot.

use std::path::{Path, PathBuf};

use serde::Serialize;

use super::plots;
use crate::base::{Error, Result, files};

/// Whether a point is the setting that the program uses when nobody asks for another.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Standing {
    /// One of the others.
    #[default]
    Alternative,
    /// The default.
    Default,
}

/// One measured setting.
#[derive(Clone, Debug, PartialEq)]
pub struct Point {
    /// What was measured on (a scene, a case): one panel each.
    pub subject: String,
    /// Family of settings: one colour each.
    pub mode: String,
    /// The setting within the family, shown beside the point.
    pub setting: String,
    /// What it costs, in the chart's unit; above 0.
    pub cost: f64,
    /// How wrong it is, in the chart's unit; at most zero where it cannot be told from noise.
    pub error: f64,
    /// The default or not.
    pub standing: Standing,
    /// Further columns of the CSV; the same names in every point.
    pub extra: Vec<(&'static str, f64)>,
}

/// A set of measured settings and what their numbers mean.
#[derive(Clone, Debug, PartialEq)]
pub struct Chart {
    /// Axis of the costs with its unit, for example "CPU seconds per frame".
    pub cost: &'static str,
    /// Axis of the errors with its unit.
    pub error: &'static str,
    /// All settings; panels and colours in the order of their first appearance.
    pub points: Vec<Point>,
}

/// For every point: whether no other point of its subject costs less, or the same, and errs less.
pub fn on_front(points: &[Point]) -> Vec<bool> {
    let beats = |a: &Point, b: &Point| {
        a.subject == b.subject && a.cost <= b.cost && a.error <= b.error && (a.cost < b.cost || a.error < b.error)
    };
    points.iter().map(|p| !points.iter().any(|other| beats(other, p))).collect()
}

/// Writes `<stem>.csv`, `<stem>.svg` and `<stem>.png` into `folder`; gives back the path of the CSV.
///
/// Errors: no points, points with different extra columns, an unwritable folder.
pub fn write(chart: &Chart, folder: &Path, stem: &str) -> Result<PathBuf> {
    let table = folder.join(format!("{stem}.csv"));
    files::write_bytes(&table, csv_text(chart)?.as_bytes())?;
    plots::draw_pareto(chart, &on_front(&chart.points), folder, stem)?;
    Ok(table)
}

fn csv_text(chart: &Chart) -> Result<String> {
    let Some(first) = chart.points.first() else { return Err(Error::input("nothing was measured")) };
    let names: Vec<&str> = first.extra.iter().map(|e| e.0).collect();
    let failed = |e: String| Error::input(format!("encoding as CSV failed: {e}"));
    let mut writer = csv::WriterBuilder::new().terminator(csv::Terminator::Any(b'\n')).from_writer(Vec::new());
    let mut record = |fields: Vec<String>| writer.write_record(&fields).map_err(|e| failed(e.to_string()));
    let fixed = ["subject", "mode", "setting", "cost", "error", "front", "default"];
    record(fixed.iter().chain(&names).map(|s| s.to_string()).collect())?;
    for (point, front) in chart.points.iter().zip(on_front(&chart.points)) {
        if point.extra.iter().map(|e| e.0).ne(names.iter().copied()) {
            return Err(Error::input("has other columns than the points before it").element(&point.setting));
        }
        let mut fields = vec![point.subject.clone(), point.mode.clone(), point.setting.clone()];
        fields.extend([point.cost.to_string(), point.error.to_string(), front.to_string()]);
        fields.push((point.standing == Standing::Default).to_string());
        fields.extend(point.extra.iter().map(|e| e.1.to_string()));
        record(fields)?;
    }
    let bytes = writer.into_inner().map_err(|e| failed(e.to_string()))?;
    String::from_utf8(bytes).map_err(|e| failed(e.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(subject: &str, cost: f64, error: f64) -> Point {
        let standing = if cost == 2.0 { Standing::Default } else { Standing::Alternative };
        let setting = format!("{cost}");
        Point {
            subject: subject.into(),
            mode: "raw".into(),
            setting,
            cost,
            error,
            standing,
            extra: vec![("rays", 7.0)],
        }
    }

    fn chart() -> Chart {
        let points = vec![point("a", 1.0, 1.0), point("a", 2.0, 0.5), point("a", 3.0, 0.6), point("b", 4.0, 9.0)];
        Chart { cost: "CPU seconds", error: "relMSE", points }
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
        assert!(write(&Chart { points: vec![], ..chart() }, folder.path(), "none").is_err());
        let mut uneven = chart();
        uneven.points[1].extra.clear();
        assert!(write(&uneven, folder.path(), "uneven").is_err());
    }
}
