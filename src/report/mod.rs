//! What people and machines read: CSV, Markdown, LaTeX, HTML, plots, JUnit, gate verdicts.
//!
//! ```text
//! Run (cells with their scores) -> write() -> results.csv frames.csv timings.csv comparison.csv summary.csv
//!                                             differences.csv run.json report.md report.html table.tex plots/ panels/
//!                                             films/ scenes.json manifest.json
//! live: the page of `track`, which shows lines as they come
//! ```

pub mod ablation;
pub mod benchmark_json;
pub mod compare;
pub mod differences;
mod document;
pub mod gate;
pub mod gate_files;
pub mod gate_limits;
#[cfg(test)]
mod gate_tests;
mod gather;
mod html;
mod latex;
pub mod live;
mod markdown;
pub mod merge;
#[cfg(test)]
mod merge_tests;
mod page_data;
mod palette;
mod paper;
pub mod pareto;
pub mod pareto_chart;
pub mod plots;
pub mod read;
#[cfg(test)]
mod report_tests;
pub mod run;
pub mod scene;
mod seal;
pub mod summary;
pub mod table;
pub mod tables;

use std::path::{Path, PathBuf};

pub use run::{CaseInfo, CellRecord, MethodInfo, Outcome, Role, Run, StageCost};

use crate::base::{Error, Progress, Result, files};

/// The page.
const PAGE: &str = "report.html";
/// The report for reading.
const MARKDOWN: &str = "report.md";

/// What [`write()`] left behind.
#[derive(Clone, Debug)]
pub struct Written {
    /// The Markdown report.
    pub markdown: PathBuf,
    /// The HTML report.
    pub html: PathBuf,
    /// The first table, as Markdown, for a terminal or a CI summary.
    pub table: String,
}

/// What a page shows of a run, besides the run.
struct RunParts {
    tables: Vec<table::ComparisonTable>,
    differences: Vec<differences::NeighbourDifference>,
    pictures: plots::ReportImages,
    scenes: scene::Scenes,
}

impl RunParts {
    /// `place` is where the run's files lie, seen from the page: empty or a folder with a slash at its end.
    fn track<'a>(&'a self, run: &'a Run, place: &'a str) -> html::TrackReport<'a> {
        let RunParts { tables, differences, pictures, scenes } = self;
        html::TrackReport { run, place, tables, differences, pictures, scenes }
    }
}

/// Refuses a `folder` that holds something and no report: a film's or a prediction's files have names that a report's have,
/// too, and would be lost.
pub fn refuse_other_folder(folder: &Path) -> Result<()> {
    let is_report = ["run.json", "results.csv", PAGE].iter().any(|name| folder.join(name).is_file());
    if !folder.is_dir()
        || is_report
        || files::all_directly_in(folder)?.is_empty() && files::folders_in(folder)?.is_empty()
    {
        return Ok(());
    }
    Err(Error::input("holds other files than a report's: name a new folder, nothing is overwritten").at(folder))
}

/// Writes every file of the report into `folder`, tables first, so that an image that cannot be drawn loses no number.
///
/// Errors: an unwritable folder, a sequence or prediction that cannot be read again for the images.
pub fn write(run: &Run, folder: &Path, progress: &dyn Progress) -> Result<Written> {
    let parts = write_parts(run, folder, progress)?;
    Ok(written(folder, &parts))
}

/// The reports of runs of different tracks. Numbers of two tracks are never put into one table: each run has a folder of
/// its own, named as its track, with all that [`write()`] makes, and `folder/report.html` is a page that switches between
/// them, the first one first. One run alone lies in `folder`. What comes back names the page, and the first run's table.
///
/// Errors: no run, two runs of one track, and those of [`write()`].
pub fn write_tracks(runs: &[Run], folder: &Path, progress: &dyn Progress) -> Result<Written> {
    match runs {
        [run] => write(run, folder, progress),
        _ => {
            let named: Vec<(&Run, &str)> = runs.iter().map(|run| (run, run.track.word())).collect();
            write_named(&named, folder, progress)
        }
    }
}

fn write_named(runs: &[(&Run, &str)], folder: &Path, progress: &dyn Progress) -> Result<Written> {
    let mut names: Vec<&str> = runs.iter().map(|(_, name)| *name).collect();
    names.sort_unstable();
    if runs.is_empty() || names.windows(2).any(|pair| pair[0] == pair[1]) {
        let sentence = "a report of several tracks has one run of each, and these are of: ".to_owned();
        return Err(Error::input(sentence + &names.join(", ")).at(folder));
    }
    let places: Vec<String> = runs.iter().map(|(_, name)| format!("{name}/")).collect();
    let mut parts = Vec::new();
    for (run, name) in runs {
        parts.push(write_parts(run, &folder.join(name), progress)?);
    }
    let tracks: Vec<html::TrackReport<'_>> =
        parts.iter().zip(runs).zip(&places).map(|((parts, (run, _)), place)| parts.track(run, place)).collect();
    let html = folder.join(PAGE);
    files::write_bytes(&html, html::report(&tracks).as_bytes())?;
    Ok(Written { html, ..written(&folder.join(runs[0].1), &parts[0]) })
}

/// Everything that belongs to one run, its own page included.
fn write_parts(run: &Run, folder: &Path, progress: &dyn Progress) -> Result<RunParts> {
    let summaries = summary::summarise(run);
    tables::write_results(run, &folder.join("results.csv"))?;
    tables::write_comparison(run, &folder.join("comparison.csv"))?;
    tables::write_summary(&summaries, &folder.join("summary.csv"))?;
    let differences = differences::neighbours(run, &summaries);
    tables::write_differences(&differences, &folder.join("differences.csv"))?;
    tables::write_frames(run, &folder.join("frames.csv"))?;
    tables::write_timings(run, &folder.join("timings.csv"))?;
    files::write_json(&folder.join("run.json"), &run.facts())?;
    let tables = table::ComparisonTable::all(run.track, &summaries);
    let latex: Vec<String> = tables.iter().map(|table| latex::table(table, &run.id)).collect();
    files::write_bytes(&folder.join("table.tex"), latex.join("\n").as_bytes())?;
    let pictures = plots::draw(run, &summaries, folder, progress)?;
    let markdown = markdown::report(run, &summaries, &tables, &differences, &pictures);
    files::write_bytes(&folder.join(MARKDOWN), markdown.as_bytes())?;
    let scenes = gather::gather(run, progress)?;
    scenes.write(folder)?;
    seal::write(folder)?;
    let parts = RunParts { tables, differences, pictures, scenes };
    files::write_bytes(&folder.join(PAGE), html::report(&[parts.track(run, "")]).as_bytes())?;
    for case in &run.cases {
        // One at a time: a whole film is large.
        if let Some(whole) = gather::whole_film(run, case)? {
            let page = html::whole_film(&html::TrackReport { scenes: &whole, ..parts.track(run, "../") }, case);
            files::write_bytes(&folder.join(format!("films/{}.html", case.id)), page.as_bytes())?;
        }
    }
    Ok(parts)
}

fn written(folder: &Path, parts: &RunParts) -> Written {
    // A track has a table at least: that of its headline comes first.
    let table = parts.tables.first().map(markdown::comparison_table).unwrap_or_default();
    Written { markdown: folder.join(MARKDOWN), html: folder.join(PAGE), table }
}
