//! `report.html`: one file, which asks the network for nothing. Tables and plots (inline SVG) stand in the markup and
//! need no script; the airway, the films and the curves under one cursor are drawn by the scripts in `page/` from the
//! data of each case (`page_data`), read when the case is opened.

use std::collections::BTreeSet;

use maud::{Markup, PreEscaped, html};

use super::differences::NeighbourDifference;
use super::document::document;
use super::markdown::{NEIGHBOURS_MEAN, ahead};
use super::page_data::{DATA_END, DATA_START, case_data};
use super::palette::{Palette, RowStyle};
use super::plots::{ReportImage, ReportImages};
use super::run::{CaseInfo, CellRecord, Outcome, Role, Run};
use super::scene::Scenes;
use super::table::{ComparisonTable, TableCell, arrow, counted, heading, show};
use crate::score::{Metric, Status, paper_metrics, registry};

/// Name of the page.
pub const PAGE: &str = "report.html";
/// Most bytes of the page, whatever it is of: it is mailed and opened on telephones.
pub const PAGE_BYTES: usize = 15_000_000;
/// Where airways take more of the page than this, they are made smaller.
const AIRWAY_BYTES: usize = 5_000_000;
/// Least part of the page that films get: where less is left, cases say less of themselves ([`CaseDetail`]).
const FILM_BYTES: usize = 2_000_000;
/// Bytes of a vertex and its faces, 12 each, in base64; and of a row's error there.
const VERTEX_BYTES: usize = 32;
const ERROR_BYTES: f64 = 4.0 / 3.0;

/// In this order, after the scripts that all pages share.
const SCRIPTS: [&str; 2] = [include_str!("page/player.js"), include_str!("page/table.js")];

/// What a page shows of one track.
#[derive(Clone, Copy)]
pub struct TrackReport<'a> {
    /// The run.
    pub run: &'a Run,
    /// Where its files lie, seen from the page: empty, or a folder with a slash at its end.
    pub place: &'a str,
    /// Its tables.
    pub tables: &'a [ComparisonTable],
    /// Neighbours in its ranking.
    pub differences: &'a [NeighbourDifference],
    /// Its plots.
    pub pictures: &'a ReportImages,
    /// Its airways and films.
    pub scenes: &'a Scenes,
    /// The cases of which all frames are in a file of their own.
    pub whole_films: &'a BTreeSet<String>,
}

/// What stands on the page of each case; the rest is in the case's own file. In order of size.
#[derive(Clone, Copy, PartialEq, Eq)]
enum CaseDetail {
    /// Airway, film, curves, numbers, plots.
    Whole,
    /// All but the plots.
    WithoutPlots,
    /// Where it is to be found.
    Elsewhere,
}

/// The whole page, of at most [`PAGE_BYTES`] as long as the tables of all cases leave room: films get what is left. Of many
/// cases each says less.
pub fn report(tracks: &[TrackReport<'_>]) -> String {
    let airways = || tracks.iter().flat_map(|track| &track.scenes.films).filter_map(|film| film.airway.as_ref());
    let vertices = AIRWAY_BYTES / VERTEX_BYTES / airways().count().max(1);
    let rows = tracks.iter().map(|track| track.run.methods.len()).max().unwrap_or(0);
    let each = VERTEX_BYTES as f64 + ERROR_BYTES * rows as f64;
    let drawn = airways().map(|airway| airway.vertices().min(vertices) as f64 * each).sum::<f64>() as usize;
    let bare: Vec<Scenes> = tracks.iter().map(|track| track.scenes.without_pictures()).collect();
    for detail in [CaseDetail::Whole, CaseDetail::WithoutPlots] {
        if assembled(tracks, &bare, detail).len() + drawn + FILM_BYTES > PAGE_BYTES {
            continue;
        }
        let small: Vec<Scenes> = tracks.iter().map(|track| track.scenes.with_small_airways(vertices)).collect();
        let without: Vec<Scenes> = small.iter().map(|scenes| scenes.thinned(0)).collect();
        let rest = assembled(tracks, &without, detail).len();
        let room = PAGE_BYTES.saturating_sub(rest) / tracks.len().max(1);
        let scenes: Vec<Scenes> = small.iter().map(|scenes| scenes.thinned(room)).collect();
        let page = assembled(tracks, &scenes, detail);
        if page.len() <= PAGE_BYTES {
            return page;
        }
    }
    assembled(tracks, &bare, CaseDetail::Elsewhere)
}

/// Where the page of a case's whole film is, in the report's folder.
pub fn film_page(case_id: &str) -> String {
    format!("films/{case_id}.html")
}

/// One case with every frame at full size, its numbers and plots, beside the report: too large for it. `track.place` is
/// where the run's files lie, seen from this file.
pub fn whole_film(track: &TrackReport<'_>, case: &CaseInfo) -> String {
    let TrackReport { run, scenes, .. } = *track;
    let palette = Palette::of(&run.methods);
    let title = format!("{}: the whole film", case.heading());
    document(
        &title,
        "",
        &SCRIPTS,
        html! {
            h1 { (case.heading()) " " small { "whole film, " (run.id) } }
            p.muted { a href={ (track.place) (PAGE) } { "The whole report" } }
            div #tools {}
            (case_section(run, case, Some(scenes), &palette, CaseHeading::OnPageOfItsOwn, html! {
                (numbers(run, case))
                @for picture in of_case(track, case) { (figure(picture)) }
            }))
        },
    )
}

fn assembled(tracks: &[TrackReport<'_>], scenes: &[Scenes], detail: CaseDetail) -> String {
    let title = tracks.first().map_or_else(String::new, |track| format!("respire-bench: {}", track.run.id));
    document(
        &title,
        "",
        &SCRIPTS,
        html! {
            h1 { "respire-bench " small { @for track in tracks { (track.run.id) " " } } }
            div #tools {}
            @for (track, scenes) in tracks.iter().zip(scenes) {
                // Scripts show one track at a time, and say which.
                @if tracks.len() > 1 { h2.track-name { "Track: " (track.run.track.word()) } }
                (track_section(track, scenes, detail))
            }
            h2 { "Definitions" }
            details { summary { "What every metric is" } dl { @for m in registry() {
                dt { code { (m.id) } " (" (m.direction.word()) " is better)" }
                dd { (m.definition) }
            } } }
        },
    )
}

fn track_section(track: &TrackReport<'_>, scenes: &Scenes, detail: CaseDetail) -> Markup {
    let TrackReport { run, tables, differences, pictures, .. } = *track;
    let palette = Palette::of(&run.methods);
    let failed: Vec<_> = run.cells.iter().filter(|c| c.score().is_none()).collect();
    html! {
        section.track data-track=(run.track.word()) {
            p.muted {
                (counted(run.cases.len(), "case")) ", " (counted(run.methods.len(), "method")) ", "
                (counted(run.cells.len(), "cell")) ", "
                (failed.len()) " failed. Profile " code { (run.profile) } ", track " code { (run.track.word()) } "."
            }
            @for note in run.conditions.iter().chain(&run.notes) { p.muted { (note) } }
            @for table in tables {
                h2 { (table.kind.title()) }
                (comparison(table, run, &palette))
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
            h2 { "Every case" }
            @if detail != CaseDetail::Whole { p.muted {
                "Too many cases for the whole of each to stand here: plots"
                @if detail == CaseDetail::Elsewhere { ", films and numbers of each case" }
                " are in files beside this page, and all numbers in " a href={ (track.place) "results.csv" } { "results.csv" } "."
            } }
            @for case in &run.cases {
                @let scenes = (detail != CaseDetail::Elsewhere).then_some(scenes);
                (case_section(run, case, scenes, &palette, CaseHeading::AmongOthers, static_part(track, case, detail)))
            }
            h2 { "Plots of all cases" }
            @for picture in &pictures.overview { (figure(picture)) }
        }
    }
}

/// Where a case stands.
#[derive(Clone, Copy, PartialEq, Eq)]
enum CaseHeading {
    /// Closed, under its name.
    AmongOthers,
    /// Open: the page is about it alone, and has its name.
    OnPageOfItsOwn,
}

/// A case: the scripts' part, for which a script holds the data (none without `scenes`), and what stands there without
/// them.
fn case_section(
    run: &Run,
    case: &CaseInfo,
    scenes: Option<&Scenes>,
    palette: &Palette,
    heading: CaseHeading,
    fixed: Markup,
) -> Markup {
    let kept = scenes.and_then(|scenes| scenes.film(&case.id)).filter(|_| case.title.is_empty());
    let title = kept.map(|film| film.title.as_str()).filter(|title| !title.is_empty());
    let data = scenes.and_then(|scenes| case_data(run, case, scenes, palette));
    html! {
        details.case open[heading == CaseHeading::OnPageOfItsOwn] {
            summary {
                @if heading == CaseHeading::OnPageOfItsOwn { "Film, numbers and plots" } @else {
                    (case.heading()) @if let Some(title) = title { ": " (title) }
                }
            }
            div.inside {
                @if scenes.is_some() { div.player id={ (run.track.word()) "-" (case.id) } {} }
                @if let Some(data) = data { (PreEscaped([DATA_START, &data, DATA_END].concat())) }
                (fixed)
            }
        }
    }
}

fn numbers(run: &Run, case: &CaseInfo) -> Markup {
    html! {
        h3 { "Numbers" }
        (case_table(run, &case.id, &Palette::of(&run.methods)))
    }
}

fn of_case<'a>(track: &TrackReport<'a>, case: &CaseInfo) -> impl Iterator<Item = &'a ReportImage> {
    track.pictures.by_case.iter().filter(|(id, _)| *id == case.id).flat_map(|(_, of_case)| of_case)
}

fn static_part(track: &TrackReport<'_>, case: &CaseInfo, detail: CaseDetail) -> Markup {
    let TrackReport { run, place, whole_films, .. } = *track;
    html! {
        @if detail != CaseDetail::Elsewhere { (numbers(run, case)) }
        @if detail == CaseDetail::Whole { @for picture in of_case(track, case) { (figure(picture)) } }
        @if whole_films.contains(&case.id) {
            p.muted.whole {
                "In files beside this page: "
                a href={ (place) (film_page(&case.id)) } { "the whole film" }
                @for picture in of_case(track, case).filter(|picture| picture.svg.is_none()) {
                    ", " a href={ (place) (picture.png) } { (picture.title) }
                }
                "."
            }
        }
    }
}

/// Whether a method's name is broken into lines: the column of names stays in sight, and must leave room for another.
fn is_long(title: &str) -> bool {
    const LETTERS: usize = 36;
    title.chars().count() > LETTERS
}

/// A piece of the row's line, as plots draw it.
fn swatch(style: RowStyle) -> Markup {
    let dash = style.dash.map(|[on, off]| format!("{on} {off}"));
    html! {
        svg.swatch viewBox="0 0 24 10" aria-hidden="true" {
            line x1="1" x2="23" y1="5" y2="5" stroke=(style.hex()) stroke-width="3.4" stroke-dasharray=[dash] {}
        }
    }
}

fn comparison(table: &ComparisonTable, run: &Run, palette: &Palette) -> Markup {
    let is_foreign = |id: &str| run.cells.iter().any(|cell| cell.method == id && cell.is_foreign());
    let has_intervals = table.rows.iter().flat_map(|row| &row.cells).any(|cell| !cell.interval.is_empty());
    html! {
        div.wide { table.sortable.comparison {
            thead {
                tr {
                    th {} th.group colspan="2" { "Setting" }
                    @for (group, count) in table.groups() { th.group colspan=(count) { (group.title()) } }
                }
                tr {
                    th { "Method" } th { "CTs" } th { "Mesh" }
                    @for m in &table.columns { (column(m, heading(m))) }
                }
            }
            tbody { @for (index, row) in table.rows.iter().enumerate() {
                tr.section[starts_section(table, index)].own[row.method.id == "ours"].foreign[is_foreign(&row.method.id)]
                    .sanity[row.method.role == Role::Sanity] data-method=(row.method.id) {
                    td.long[is_long(&row.method.title)] { (swatch(palette.style(&row.method.id))) (row.method.title) }
                    td { (row.ct_scans) }
                    td { (row.method.mesh.map_or("–", |mesh| if mesh { "✓" } else { "✗" })) }
                    @for cell in &row.cells {
                        td data-value=(cell.number.map_or_else(String::new, |v| v.to_string())) { (value(cell)) }
                    }
                }
            } }
        } }
        p.muted {
            (table.kind.explanation()) " Mean over " (counted(table.cases, "case"))
            @if has_intervals { "; below it the 95 % bootstrap interval over trees and cases" }
            ". "
            @if table.kind.ranks() {
                "Bold: best ranked method; a method is ranked where it is scored on every case, with all of its seeds. "
            }
            "Rows in italics are bounds and not ranked."
            @for (sign, means) in table.signs() { " " (sign) ": " (means) "." }
            @for sentence in table.additions() { " " (sentence) }
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

/// Heading of a metric's column, with its unit below it where neither the heading nor the values say it.
fn column(m: &Metric, name: &str) -> Markup {
    let is_said = m.id == "time_total_s" || m.unit == "%" || name.contains(m.unit);
    html! {
        th title=(m.definition) data-better=(m.direction.word()) {
            (name) "\u{a0}" (arrow(m))
            @if !is_said { span.unit { (m.unit) } }
        }
    }
}

fn value(cell: &TableCell) -> Markup {
    let starred = cell.starred();
    let signs = starred.strip_prefix(&cell.value).unwrap_or_default().trim();
    // The signs take no room, so that numbers stand below each other.
    let number = html! { (cell.value) @if !signs.is_empty() { span.sign { " " (signs) } } };
    html! {
        @if cell.best { strong { (number) } } @else { (number) }
        @if !cell.interval.is_empty() { span.interval { (cell.interval) } }
        @if let Some(paper) = &cell.paper { span.paper { "paper " (paper) } }
    }
}

fn case_table(run: &Run, case: &str, palette: &Palette) -> Markup {
    let shown = |m: &Metric, cell: &CellRecord| match cell.score().and_then(|s| s.metric(m.id)) {
        None => html! { td.failed data-value="" { "failed" } },
        Some(score) => match score.value {
            Some(value) => html! { td data-value=(value) { (show(m, value)) } },
            None if score.status == Status::NotApplicable => html! { td data-value="" title="not applicable" { "–" } },
            None => html! { td.muted data-value="" { (score.status.word().replace('_', " ")) } },
        },
    };
    let method = |cell: &CellRecord| run.methods.iter().find(|m| m.id == cell.method);
    let is_bound = |cell: &CellRecord| method(cell).is_some_and(|m| m.role == Role::Sanity);
    html! {
        div.wide { table.sortable.of-case {
            thead { tr {
                th { "Method" } th { "Seed" }
                @for m in paper_metrics() { (column(m, m.label)) }
            } }
            tbody { @for cell in run.cells.iter().filter(|c| c.case_id == case) {
                @let title = method(cell).map_or(&cell.method, |m| &m.title);
                tr.sanity[is_bound(cell)] data-method=(cell.method) {
                    td.long[is_long(title)] { (swatch(palette.style(&cell.method))) (title) }
                    td data-value=(cell.seed) { (cell.seed) }
                    @for m in paper_metrics() { (shown(m, cell)) }
                }
            } }
        } }
    }
}

fn figure(picture: &ReportImage) -> Markup {
    html! {
        @if let Some(svg) = &picture.svg {
            h3 { (picture.title) }
            p.muted.caption { (picture.caption) }
            figure.plot tabindex="0" role="img" aria-label=(picture.title) { (PreEscaped(without_prolog(svg))) }
        }
    }
}

/// An SVG document without its XML declaration, to stand inside HTML.
fn without_prolog(svg: &str) -> &str {
    svg.find("<svg").map_or(svg, |start| &svg[start..])
}
