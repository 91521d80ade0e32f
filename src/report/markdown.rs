//! `report.md`: the comparison table with the paper's numbers beside ours, every case, failures, images.

use std::fmt::Write;

use super::differences::NeighbourDifference;
use super::plots::ReportImages;
use super::run::{Outcome, Role, Run};
use super::summary::MethodSummary;
use super::table::{ComparisonTable, TableCell, arrow, counted, heading, show};
use crate::score::{Metric, paper_metrics, registry};

/// The whole file.
pub fn report(
    run: &Run,
    summaries: &[MethodSummary],
    tables: &[ComparisonTable],
    differences: &[NeighbourDifference],
    pictures: &ReportImages,
) -> String {
    let mut out = format!("# respire-bench: {}\n\n", escape(&run.id));
    let failed = run.cells.iter().filter(|c| c.score().is_none()).count();
    let _ = writeln!(
        out,
        "{}, {}, {}, {failed} failed. Profile {}, track `{}`.\n",
        counted(run.cases.len(), "case"),
        counted(run.methods.len(), "method"),
        counted(run.cells.len(), "cell"),
        escape(&run.profile),
        run.track.word()
    );
    for note in run.conditions.iter().chain(&run.notes) {
        let _ = writeln!(out, "{}\n", escape(note));
    }
    tables.iter().for_each(|table| comparison(&mut out, table));
    neighbours(&mut out, differences);
    intervals(&mut out, summaries);
    failures(&mut out, run);
    images(&mut out, pictures);
    cases(&mut out, run);
    definitions(&mut out);
    out
}

/// Text that Markdown does not take for markup.
pub fn escape(text: &str) -> String {
    // A bracket that a parenthesis follows is a link or a picture.
    let plain =
        text.replace('&', "&amp;").replace('\\', "\\\\").replace('|', "\\|").replace('*', "\\*").replace("](", "]\\(");
    plain.replace('<', "&lt;").replace(['\n', '\r'], " ")
}

fn comparison(out: &mut String, table: &ComparisonTable) {
    let ranked = match table.kind.ranks() {
        true => {
            " **Bold**: best ranked method; a method is ranked where it is scored on every case, with all of its seeds."
        }
        false => "",
    };
    let _ = writeln!(
        out,
        "## {}\n\n{} Mean over {}.{ranked} Rows in *italics* are bounds, not ranked.{}\n\n{}",
        table.kind.title(),
        table.kind.explanation(),
        counted(table.cases, "case"),
        table.signs().map(|(sign, means)| format!(" {sign}: {means}.")).collect::<String>(),
        comparison_table(table)
    );
    for sentence in table.additions() {
        let _ = writeln!(out, "{sentence}\n");
    }
}

/// The comparison table alone.
pub fn comparison_table(table: &ComparisonTable) -> String {
    let headings: String = table.columns.iter().map(|m| format!(" {} {} |", escape(heading(m)), arrow(m))).collect();
    let mut out = format!("| Method | CTs | Mesh |{headings}\n|---|:-:|:-:|{}\n", "--:|".repeat(table.columns.len()));
    for row in &table.rows {
        let title = match row.method.role {
            Role::Ranked => escape(&row.method.title),
            Role::Sanity => format!("*{}*", escape(&row.method.title)),
        };
        let mesh = row.method.mesh.map_or("–", |mesh| if mesh { "✓" } else { "✗" });
        let cells: String = row.cells.iter().map(|c| format!(" {} |", dressed(c))).collect();
        let _ = writeln!(out, "| {title} | {} | {mesh} |{cells}", row.ct_scans);
    }
    out
}

fn dressed(cell: &TableCell) -> String {
    let value = if cell.best { format!("**{}**", cell.starred()) } else { cell.starred() };
    cell.paper.as_ref().map_or(value.clone(), |paper| format!("{value} ({paper})"))
}

fn neighbours(out: &mut String, differences: &[NeighbourDifference]) {
    if differences.is_empty() {
        return;
    }
    out.push_str("## Neighbours in the ranking\n\n");
    let _ = writeln!(
        out,
        "{NEIGHBOURS_MEAN}\n\n| Metric | Place | Method | Next | Ahead by (95 %) | Clear |\n|---|--:|---|---|--:|:-:|"
    );
    for d in differences {
        let _ = writeln!(
            out,
            "| {} | {} | {} | {} | {} | {} |",
            escape(&d.metric.heading()),
            d.rank,
            escape(&d.method.title),
            escape(&d.next.title),
            ahead(d),
            d.word()
        );
    }
    out.push('\n');
}

/// What the numbers of [`neighbours`] are.
pub const NEIGHBOURS_MEAN: &str = "By how much a row is ahead of the next one: mean over cases of the difference in each \
    case, with its interval over trees and cases. Where that holds 0 the order is not clear; where the first sees more (CT \
    scans, pictures, poses), the next is not beaten by it.";

/// A difference with its interval.
pub fn ahead(d: &NeighbourDifference) -> String {
    let number = |value: f64| unsigned_zero(d.metric.format(value));
    let interval =
        d.ahead.interval.map_or_else(String::new, |[low, high]| format!(" ({} to {})", number(low), number(high)));
    format!("{}{interval}", number(d.ahead.mean))
}

/// A number without the sign of what was rounded away.
fn unsigned_zero(text: String) -> String {
    match text.strip_prefix('-') {
        Some(rest) if !rest.contains(|c: char| c.is_ascii_digit() && c != '0') => rest.to_owned(),
        _ => text,
    }
}

fn intervals(out: &mut String, summaries: &[MethodSummary]) {
    out.push_str("## Means with 95 % intervals over trees and cases\n\n| Metric |");
    for s in summaries {
        let _ = write!(out, " {} |", escape(&s.method.title));
    }
    let _ = writeln!(out, "\n|---|{}", "--:|".repeat(summaries.len()));
    for m in registry() {
        let _ = write!(out, "| {} {} |", escape(&m.heading()), arrow(m));
        for s in summaries {
            let _ = match s.mean(m.id) {
                None => write!(out, " – |"),
                Some(mean) => match mean.interval {
                    None => write!(out, " {} |", show(m, mean.mean)),
                    Some([low, high]) => {
                        write!(out, " {} ({} to {}) |", show(m, mean.mean), show(m, low), show(m, high))
                    }
                },
            };
        }
        out.push('\n');
    }
    out.push('\n');
}

fn failures(out: &mut String, run: &Run) {
    let failed = run.cells.iter().filter_map(|c| match &c.outcome {
        Outcome::Failed(why) => Some((c, why)),
        Outcome::Scored(_) => None,
    });
    let mut lines = failed
        .map(|(c, why)| format!("- {} / {} / seed {}: {}\n", c.case_id, escape(&c.method), c.seed, escape(why)))
        .peekable();
    if lines.peek().is_some() {
        out.push_str("## Failed cells\n\n");
        out.extend(lines);
        out.push('\n');
    }
}

fn images(out: &mut String, pictures: &ReportImages) {
    out.push_str("## Pictures\n\n");
    for picture in &pictures.overview {
        let _ = writeln!(out, "![{}]({})\n\n{}\n", escape(&picture.title), picture.png, escape(&picture.caption));
    }
    for (case, of_case) in &pictures.by_case {
        let _ = writeln!(out, "<details><summary>{}</summary>\n", escape(case));
        for picture in of_case {
            let _ = writeln!(out, "![{}]({})\n\n{}\n", escape(&picture.title), picture.png, escape(&picture.caption));
        }
        out.push_str("</details>\n\n");
    }
}

fn cases(out: &mut String, run: &Run) {
    out.push_str("## Every case\n\n");
    let metrics: Vec<&Metric> = paper_metrics().collect();
    for case in &run.cases {
        let _ = writeln!(out, "<details><summary>{}</summary>\n", escape(&case.heading()));
        let headings: String = metrics.iter().map(|m| format!(" {} {} |", escape(&m.heading()), arrow(m))).collect();
        let _ = writeln!(out, "| Method | Seed |{headings}\n|---|--:|{}", "--:|".repeat(metrics.len()));
        for cell in run.cells.iter().filter(|c| c.case_id == case.id) {
            let _ = write!(out, "| {} | {} |", escape(&cell.method), cell.seed);
            for m in &metrics {
                let score = cell.score().and_then(|s| s.metric(m.id));
                let _ = match (score.and_then(|s| s.value), score) {
                    (Some(value), _) => write!(out, " {} |", show(m, value)),
                    (None, Some(score)) => write!(out, " {} |", escape(score.status.word())),
                    (None, None) => write!(out, " failed |"),
                };
            }
            out.push('\n');
        }
        out.push_str("\n</details>\n\n");
    }
}

fn definitions(out: &mut String) {
    out.push_str("## Definitions\n\n");
    for m in registry() {
        let _ = writeln!(out, "- `{}` ({} is better): {}", m.id, m.direction.word(), escape(m.definition));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_no_markup() {
        assert_eq!(escape("Gauss-Newt&#111;n"), "Gauss-Newt&amp;#111;n");
        assert_eq!(escape("![x](http://a) *b* | PSNR [dB] <i>"), "![x]\\(http://a) \\*b\\* \\| PSNR [dB] &lt;i>");
    }

    #[test]
    fn nothing_has_no_sign() {
        for (text, shown) in [("-0.000", "0.000"), ("-0", "0"), ("0.00", "0.00"), ("-0.010", "-0.010"), ("-10", "-10")]
        {
            assert_eq!(unsigned_zero(text.to_owned()), shown);
        }
    }
}
