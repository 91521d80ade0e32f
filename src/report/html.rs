//! `report.html`: one self-contained file without scripts. Plots are inline SVG, images are
//! embedded PNG.

use maud::{DOCTYPE, Markup, PreEscaped, html};

use super::differences::NeighbourDifference;
use super::markdown::{NEIGHBOURS_MEAN, ahead};
use super::plots::{ReportImage, ReportImages};
use super::run::{Outcome, Role, Run};
use super::table::{ComparisonTable, TableCell, TableKind, arrow, heading, show};
use crate::formats::png;
use crate::score::{Metric, paper_metrics, registry};

const STYLE: &str = "
body{font:15px/1.45 system-ui,'DejaVu Sans',sans-serif;color:#1a1a1a;margin:2rem auto;max-width:1240px;padding:0 1.2rem}
h1{font-size:1.6rem;margin-bottom:.2rem}h2{margin-top:2.4rem;border-bottom:1px solid #ddd;padding-bottom:.2rem}
table{border-collapse:collapse;font-variant-numeric:tabular-nums;font-size:.9rem}th,td{padding:.32rem .6rem;text-align:right}
th:first-child,td:first-child{text-align:left}thead tr:last-child th{border-bottom:1.5px solid #333}thead tr:first-child th{border-top:2px solid #333}
th.group{text-align:center;border-bottom:1px solid #999}tbody tr:last-child td{border-bottom:2px solid #333}
tr.section td{border-top:1px solid #999}tr.own td{background:#efefef}tr.sanity td{color:#666;font-style:italic}
.paper{color:#8a8a8a;font-size:.82em;display:block}.interval{color:#8a8a8a;font-size:.78em;display:block;white-space:nowrap}
figure{margin:1.2rem 0}figure svg,figure img{max-width:100%;height:auto}figcaption{color:#555;font-size:.88rem}
details{margin:.6rem 0}summary{cursor:pointer;font-weight:600}.wide{overflow-x:auto}code{background:#f3f3f3;padding:0 .2em}
.muted{color:#666}.failed{color:#a40000}
";

/// The whole page.
pub fn report(
    run: &Run,
    tables: &[ComparisonTable],
    differences: &[NeighbourDifference],
    pictures: &ReportImages,
) -> String {
    let failed: Vec<_> = run.cells.iter().filter(|c| c.score().is_none()).collect();
    html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                link rel="icon" href="data:,";
                title { "respire-bench: " (run.id) }
                style { (PreEscaped(STYLE)) }
            }
            body {
                h1 { "respire-bench: " (run.id) }
                p.muted {
                    (run.cases.len()) " cases, " (run.methods.len()) " methods, " (run.cells.len()) " cells, "
                    (failed.len()) " failed. Profile " code { (run.profile) } ", track " code { (run.track.word()) } "."
                }
                @for note in &run.notes { p.muted { (note) } }
                @for table in tables {
                    h2 { (table.kind.title()) }
                    (comparison(table))
                }
                @if !differences.is_empty() {
                    h2 { "Neighbours in the ranking" }
                    details { summary { "By how much a row is ahead of the next one" } (neighbours(differences)) }
                }
                @if !failed.is_empty() {
                    h2 { "Failed cells" }
                    ul { @for cell in &failed { @if let Outcome::Failed(why) = &cell.outcome {
                        li.failed { (cell.case_id) " / " (cell.method) " / seed " (cell.seed) ": " (why) }
                    } } }
                }
                h2 { "Overview" }
                @for picture in &pictures.overview { (figure(picture)) }
                h2 { "Every case" }
                @for case in &run.cases {
                    details {
                        summary { (case.heading()) }
                        (case_table(run, &case.id))
                        @for (_, of_case) in pictures.by_case.iter().filter(|(id, _)| *id == case.id) {
                            @for picture in of_case { (figure(picture)) }
                        }
                    }
                }
                h2 { "Definitions" }
                dl { @for m in registry() {
                    dt { code { (m.id) } " (" (m.direction.word()) " is better)" }
                    dd { (m.definition) }
                } }
            }
        }
    }
    .into_string()
}

fn comparison(table: &ComparisonTable) -> Markup {
    html! {
        div.wide { table {
            thead {
                tr {
                    th {} th.group colspan="2" { "Setting" }
                    @for (group, count) in table.groups() { th.group colspan=(count) { (group.title()) } }
                }
                tr {
                    th { "Method" } th { "CTs" } th { "Mesh" }
                    @for m in &table.columns { th title=(m.definition) { (heading(m)) (arrow(m)) } }
                }
            }
            tbody { @for (index, row) in table.rows.iter().enumerate() {
                tr.section[starts_section(table, index)].own[row.method.id == "ours"].sanity[row.method.role == Role::Sanity] {
                    td { (row.method.title) }
                    td { (row.ct_scans) }
                    td { (row.method.mesh.map_or("–", |mesh| if mesh { "✓" } else { "✗" })) }
                    @for cell in &row.cells { td { (value(cell)) } }
                }
            } }
        } }
        p.muted {
            (table.kind.explanation()) " Mean over " (table.cases) " cases; below it the 95 % bootstrap interval over trees and cases. "
            @if table.kind == TableKind::Ranking {
                "Bold: best ranked method; a method is ranked where it is scored on every case. "
            }
            "Rows in italics are bounds and not ranked."
            @for (sign, means) in table.signs() { " " (sign) ": " (means) "." }
        }
    }
}

fn neighbours(differences: &[NeighbourDifference]) -> Markup {
    html! {
        div.wide { table {
            thead { tr {
                th { "Metric" } th { "Place" } th { "Method" } th { "Next" } th { "Ahead by (95 %)" } th { "Clear" }
            } }
            tbody { @for d in differences { tr {
                td { (d.metric.heading()) } td { (d.rank) } td { (d.method.title) } td { (d.next.title) }
                td { (ahead(d)) } td { (d.word()) }
            } } }
        } }
        p.muted { (NEIGHBOURS_MEAN) }
    }
}

fn starts_section(table: &ComparisonTable, index: usize) -> bool {
    let section = |i: usize| {
        let method = &table.rows[i].method;
        (method.role, method.ct_scans.filter(|_| method.role == Role::Ranked))
    };
    index > 0 && section(index) != section(index - 1)
}

fn value(cell: &TableCell) -> Markup {
    html! {
        @if cell.best { strong { (cell.starred()) } } @else { (cell.starred()) }
        @if !cell.interval.is_empty() { span.interval { (cell.interval) } }
        @if let Some(paper) = &cell.paper { span.paper { "paper " (paper) } }
    }
}

fn case_table(run: &Run, case: &str) -> Markup {
    let shown = |m: &Metric, cell: &super::run::CellRecord| match cell.score().and_then(|s| s.metric(m.id)) {
        None => "failed".to_owned(),
        Some(score) => score.value.map_or_else(|| score.status.word().replace('_', " "), |v| show(m, v)),
    };
    html! {
        div.wide { table {
            thead { tr { th { "Method" } th { "Seed" } @for m in paper_metrics() { th { (m.heading()) " " (arrow(m)) } } } }
            tbody { @for cell in run.cells.iter().filter(|c| c.case_id == case) {
                tr { td { (cell.method) } td { (cell.seed) } @for m in paper_metrics() { td { (shown(m, cell)) } } }
            } }
        } }
    }
}

fn figure(picture: &ReportImage) -> Markup {
    html! {
        figure {
            @match &picture.svg {
                Some(svg) => (PreEscaped(without_prolog(svg))),
                None => img alt=(picture.title) src={ "data:image/png;base64," (png::base64(&picture.png_bytes)) };
            }
            figcaption { (picture.caption) }
        }
    }
}

/// An SVG document without its XML declaration, to stand inside HTML.
fn without_prolog(svg: &str) -> &str {
    svg.find("<svg").map_or(svg, |start| &svg[start..])
}
