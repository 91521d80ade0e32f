//! The comparison table in the layout of the paper's Table 1, to be formatted as Markdown, LaTeX and HTML.

use super::paper::paper_value;
use super::run::{MethodInfo, Role};
use super::summary::MethodSummary;
use crate::score::{Goal, Group, Metric, paper_metrics};

/// One value of the table.
#[derive(Clone, Debug, PartialEq)]
pub struct TableCell {
    /// Mean over cases; a dash where there is none.
    pub value: String,
    /// 95 % interval, empty where there is none.
    pub interval: String,
    /// The paper's value, where its table has one.
    pub paper: Option<String>,
    /// Best of the ranked methods.
    pub best: bool,
    /// The truth itself: the value, or the dash where equal images have none, is starred.
    pub perfect: bool,
}

/// One row: a method.
#[derive(Clone, Debug)]
pub struct TableRow {
    /// The method; the title says so where it was scored on fewer cases than other rows.
    pub method: MethodInfo,
    /// CT scans it is given.
    pub ct_scans: String,
    /// In the order of [`paper_metrics`].
    pub cells: Vec<TableCell>,
    /// Cells of this method that failed.
    pub failed: usize,
}

/// The table.
#[derive(Clone, Debug)]
pub struct ComparisonTable {
    /// Ranked methods, then the sanity rows.
    pub rows: Vec<TableRow>,
    /// Most cases behind any row.
    pub cases: usize,
}

/// Short column heading as in the paper.
pub fn heading(metric: &Metric) -> &'static str {
    match metric.id {
        "depth_rmse_mm" => "RMSE",
        "phase_mae" => "MAE",
        "contour_rmse_mm" => "Contour",
        "target_error_mm" => "Target",
        "time_per_frame_s" => "s/frame",
        _ => metric.label,
    }
}

/// The arrow of the better direction.
pub fn arrow(metric: &Metric) -> &'static str {
    match metric.direction {
        Goal::Higher => "↑",
        Goal::Lower => "↓",
    }
}

/// The paper's column groups with the number of columns in each.
pub fn groups() -> Vec<(Group, usize)> {
    let mut found: Vec<(Group, usize)> = Vec::new();
    for m in paper_metrics() {
        match found.last_mut().filter(|(g, _)| *g == m.group) {
            Some((_, count)) => *count += 1,
            None => found.push((m.group, 1)),
        }
    }
    found
}

/// A value as tables show it; long times in minutes, as in the paper.
pub fn show(metric: &Metric, value: f64) -> String {
    match metric.id {
        "time_total_s" if value >= 120.0 => format!("{:.1} min", value / 60.0),
        "time_total_s" => format!("{value:.1} s"),
        _ => metric.format(value),
    }
}

impl TableCell {
    /// The value, with a star where it is perfect.
    pub fn starred(&self) -> String {
        if self.perfect { format!("{} {STAR}", self.value) } else { self.value.clone() }
    }
}

/// Marks a perfect score, which no estimate reaches.
pub const STAR: char = '★';
/// What the star means.
pub const STAR_MEANS: &str = "equal to the truth, which no estimate is";

impl ComparisonTable {
    /// Whether any score is starred.
    pub fn has_star(&self) -> bool {
        self.rows.iter().flat_map(|row| &row.cells).any(|cell| cell.perfect)
    }

    /// Formats the summaries.
    pub fn new(summaries: &[MethodSummary]) -> Self {
        let cases = summaries.iter().map(|s| s.cases).max().unwrap_or(0);
        let named = |s: &MethodSummary| {
            let mut method = s.method.clone();
            if s.cases < cases {
                method.title += &format!(" ({} of {cases} cases)", s.cases);
            }
            method
        };
        let row = |s: &MethodSummary| TableRow {
            method: named(s),
            ct_scans: s.method.ct_scans.map_or_else(|| "–".into(), |n| n.to_string()),
            failed: s.failed,
            cells: paper_metrics().map(|m| cell(s, m)).collect(),
        };
        let of = |role: Role| summaries.iter().filter(move |s| s.method.role == role);
        ComparisonTable { rows: of(Role::Ranked).chain(of(Role::Sanity)).map(row).collect(), cases }
    }
}

fn cell(summary: &MethodSummary, metric: &Metric) -> TableCell {
    let found = summary.metric(metric.id);
    let mean = found.and_then(|m| m.mean);
    TableCell {
        value: mean.map_or_else(|| "–".into(), |m| show(metric, m.mean)),
        interval: mean
            .and_then(|m| m.interval)
            .map_or_else(String::new, |[low, high]| format!("{} to {}", show(metric, low), show(metric, high))),
        paper: paper_value(&summary.method.id, metric.id).map(|v| show(metric, v)),
        best: found.is_some_and(|m| m.rank == Some(1)),
        perfect: found.is_some_and(|m| m.is_perfect),
    }
}
