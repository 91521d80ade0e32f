//! The comparison tables, to be formatted as Markdown, LaTeX and HTML: navigation on the clinical track, the columns that
//! rank, and the paper's Table 1.

use super::paper::paper_value;
use super::run::MethodInfo;
use super::summary::{MethodSummary, in_order_of_tables};
use crate::base::own_row;
use crate::score::{Goal, Group, Metric, navigation_bar_metrics, navigation_metrics, paper_metrics, ranking_metrics};
use crate::simulate::track::Track;

/// One value of the table.
#[derive(Clone, Debug, PartialEq)]
pub struct TableCell {
    /// Mean over cases; a dash where there is none.
    pub value: String,
    /// The same as a number, to sort by.
    pub number: Option<f64>,
    /// 95 % interval, empty where there is none.
    pub interval: String,
    /// The paper's value, where its table has one.
    pub paper: Option<String>,
    /// Best of the ranked methods.
    pub best: bool,
    /// Not the best, but ahead of every ranked method that sees no more.
    pub leads_equals: bool,
    /// The truth itself: the value, or the dash where equal images have none, is starred.
    pub perfect: bool,
    /// A surface of some case could not be measured: the case's worst row counts in its place.
    pub marked: bool,
}

/// One row: a method.
#[derive(Clone, Debug)]
pub struct TableRow {
    /// The method; the title says so where it was scored on fewer cases than other rows.
    pub method: MethodInfo,
    /// CT scans it is given.
    pub ct_scans: String,
    /// In the order of the table's columns.
    pub cells: Vec<TableCell>,
}

/// "1 case", "9 cases".
pub fn counted(number: usize, noun: &str) -> String {
    format!("{number} {noun}{}", if number == 1 { "" } else { "s" })
}

/// Which columns a table has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TableKind {
    /// Targets in the camera's axes, and how true the error bars are: the clinical track's headline.
    Navigation,
    /// Those that rank: views that nobody fitted, phase, targets in all frames, time.
    Ranking,
    /// The paper's, of fitted frames and the last one, with its values beside ours; nothing is ranked by them.
    Paper,
}

impl TableKind {
    /// Those of a report of `track`, in its order.
    pub fn of(track: Track) -> &'static [TableKind] {
        match track {
            Track::Ideal => &[TableKind::Ranking, TableKind::Paper],
            Track::Clinical => &[TableKind::Navigation, TableKind::Ranking, TableKind::Paper],
        }
    }

    /// Whether a row can be best in it.
    pub fn ranks(self) -> bool {
        self != TableKind::Paper
    }

    /// Heading above the table.
    pub fn title(self) -> &'static str {
        match self {
            TableKind::Navigation => "Navigation",
            TableKind::Ranking => "Comparison",
            TableKind::Paper => "The paper's columns",
        }
    }

    /// What its numbers are of.
    pub fn explanation(self) -> &'static str {
        match self {
            TableKind::Navigation => {
                "Where the targets are in the camera's axes, in mm, so that errors of pose and tissue count together. Lost: more \
                 than 5 mm off. Found again: within a second after a cough or a touch of the wall. In silence: lost while the \
                 stated error bar is below 2.5 mm. 68 % within one and 95 % within two standard deviations are right; the last \
                 four columns rank nobody."
            }
            TableKind::Ranking => {
                "Pictures and depth are of second cameras, whose pictures no method was given; targets are of all frames."
            }
            TableKind::Paper => {
                "Of frames that the methods had fitted, and of the last frame; with the value of the paper's Table 1 (its \
                 nine COPDGene cases, its machine, its assumptions, which are those of the ideal track)."
            }
        }
    }

    fn columns(self) -> Vec<&'static Metric> {
        match self {
            TableKind::Navigation => navigation_metrics().chain(navigation_bar_metrics()).collect(),
            TableKind::Ranking => ranking_metrics().collect(),
            TableKind::Paper => paper_metrics().collect(),
        }
    }
}

/// A table.
#[derive(Clone, Debug)]
pub struct ComparisonTable {
    /// Which one.
    pub kind: TableKind,
    /// Its columns.
    pub columns: Vec<&'static Metric>,
    /// Ranked methods, then the sanity rows.
    pub rows: Vec<TableRow>,
    /// Most cases behind any row.
    pub cases: usize,
}

impl ComparisonTable {
    /// What rows add to the paper's equations, a sentence each: for below the first table that shows them.
    pub fn additions(&self) -> impl Iterator<Item = String> {
        let rows = self.rows.iter().filter(|_| self.kind == TableKind::Ranking);
        let of = |row: &TableRow| own_row::own(&row.method.id).filter(|own| !own.additions.is_empty());
        rows.filter_map(of).map(|own| format!("{} adds to the paper's equations: {}.", own.title, own.additions))
    }
}

/// Short column heading as in the paper.
pub fn heading(metric: &Metric) -> &'static str {
    match metric.id {
        "novel_psnr_db" => "PSNR",
        "novel_ssim" => "SSIM",
        "novel_depth_delta_1_25" => "δ<1.25",
        "target_mean_mm" | "navigation_error_mm" => "Mean",
        "target_p95_mm" | "navigation_error_p95_mm" => "95 %",
        "lost_pct" => "Lost %",
        "recovered_pct" => "Found again %",
        "silent_pct" => "In silence %",
        "navigation_coverage_1sd_pct" => "Within 1 sd %",
        "navigation_coverage_2sd_pct" => "2 sd %",
        "navigation_sd_mm" => "sd",
        "depth_rmse_mm" | "novel_depth_rmse_mm" => "RMSE",
        "phase_mae" => "MAE",
        "contour_rmse_mm" => "Contour",
        "target_error_mm" => "Target",
        "time_per_frame_s" => "s/frame",
        "time_cpu_s" => "CPU s",
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

/// A value as tables show it; long times in minutes, as in the paper.
pub fn show(metric: &Metric, value: f64) -> String {
    match metric.id {
        "time_total_s" if value >= 120.0 => format!("{:.1} min", value / 60.0),
        "time_total_s" => format!("{value:.1} s"),
        _ => metric.format(value),
    }
}

impl TableCell {
    /// The value, with its signs.
    pub fn starred(&self) -> String {
        let star = if self.perfect { format!(" {STAR}") } else { String::new() };
        let mark = if self.marked { format!(" {MARK}") } else { String::new() };
        let leads = if self.leads_equals { format!(" {LEADS_EQUALS}") } else { String::new() };
        format!("{}{star}{mark}{leads}", self.value)
    }
}

/// Marks a perfect score, which no estimate reaches.
pub const STAR: char = '★';
/// What the star means.
pub const STAR_MEANS: &str = "equal to the truth, which no estimate is";
/// Marks a number that is in part another row's.
pub const MARK: char = '†';
/// What the mark means.
pub const MARK_MEANS: &str =
    "a surface that misses the plane, or has other faces and no correspondence.csv, counts with its case's worst row";

/// Marks a number that no row with as little to see beats.
pub const LEADS_EQUALS: char = '‡';
/// What that mark means.
pub const LEADS_EQUALS_MEANS: &str =
    "best of the ranked rows that see no more than it does (CT scans, pictures, poses), which alone can beat it";

impl ComparisonTable {
    /// The signs that the table has, each with its meaning.
    pub fn signs(&self) -> impl Iterator<Item = (char, &'static str)> {
        let has = |sign: fn(&TableCell) -> bool| self.rows.iter().flat_map(|row| &row.cells).any(sign);
        let star = has(|cell| cell.perfect).then_some((STAR, STAR_MEANS));
        let mark = has(|cell| cell.marked).then_some((MARK, MARK_MEANS));
        let leads = has(|cell| cell.leads_equals).then_some((LEADS_EQUALS, LEADS_EQUALS_MEANS));
        star.into_iter().chain(mark).chain(leads)
    }

    /// The column groups with the number of columns in each.
    pub fn groups(&self) -> Vec<(Group, usize)> {
        let mut found: Vec<(Group, usize)> = Vec::new();
        for m in &self.columns {
            match found.last_mut().filter(|(g, _)| *g == m.group) {
                Some((_, count)) => *count += 1,
                None => found.push((m.group, 1)),
            }
        }
        found
    }

    /// The tables of a report of `track`.
    pub fn all(track: Track, summaries: &[MethodSummary]) -> Vec<Self> {
        TableKind::of(track).iter().map(|&kind| ComparisonTable::new(kind, summaries)).collect()
    }

    /// Formats the summaries.
    pub fn new(kind: TableKind, summaries: &[MethodSummary]) -> Self {
        let columns = kind.columns();
        let cases = summaries.iter().map(|s| s.cases).max().unwrap_or(0);
        // The best of several seeds is another number than their mean.
        let draws = |s: &&MethodSummary| own_row::own(&s.method.id).is_some_and(|row| row.draws);
        let seeds = summaries.iter().filter(draws).map(|s| s.seeds).max().unwrap_or(0);
        let named = |s: &MethodSummary| {
            let mut method = s.method.clone();
            let fewer = (s.cases < cases).then(|| format!("{} of {cases} cases", s.cases));
            let failed = (s.failed > 0).then(|| format!("{} of {} runs failed", s.failed, s.cells));
            let unlike = (draws(&s) && s.seeds < seeds).then(|| format!("{} of {seeds} seeds", s.seeds));
            let notes: Vec<String> = fewer.into_iter().chain(unlike).chain(failed).collect();
            if !notes.is_empty() {
                method.title += &format!(" ({})", notes.join("; "));
            }
            method
        };
        let row = |s: &MethodSummary| TableRow {
            method: named(s),
            ct_scans: s.method.ct_scans.map_or_else(|| "–".into(), |n| n.to_string()),
            cells: columns.iter().map(|m| cell(kind, s, m)).collect(),
        };
        let rows = in_order_of_tables(summaries).map(row).collect();
        ComparisonTable { rows, cases, kind, columns }
    }
}

fn cell(kind: TableKind, summary: &MethodSummary, metric: &Metric) -> TableCell {
    let is_paper = kind == TableKind::Paper;
    let ranks = kind.ranks() && !navigation_bar_metrics().any(|bar| bar.id == metric.id);
    let found = summary.metric(metric.id);
    let mean = found.and_then(|m| m.mean);
    // A mean over fewer cases than the row has is another number than those beside it.
    let fewer = mean.filter(|m| m.count < summary.cases).map(|m| format!(" ({} of {})", m.count, summary.cases));
    TableCell {
        number: mean.map(|m| m.mean),
        value: mean.map_or_else(|| "–".into(), |m| show(metric, m.mean) + &fewer.unwrap_or_default()),
        interval: mean
            .and_then(|m| m.interval)
            .map_or_else(String::new, |[low, high]| format!("{} to {}", show(metric, low), show(metric, high))),
        paper: paper_value(&summary.method.id, metric.id).filter(|_| is_paper).map(|v| show(metric, v)),
        best: ranks && found.is_some_and(|m| m.rank == Some(1)),
        leads_equals: ranks && found.is_some_and(|m| m.leads_equals),
        perfect: mean.is_some() && found.is_some_and(|m| m.is_perfect),
        marked: found.is_some_and(|m| m.is_marked),
    }
}
