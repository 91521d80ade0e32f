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
mod counted_run;
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
pub mod read_back;
#[cfg(test)]
mod report_tests;
pub mod run;
pub mod scene;
mod seal;
pub mod summary;
pub mod table;
pub mod tables;

use std::borrow::Cow;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use html::PAGE;
pub use run::{CaseInfo, CellRecord, MethodInfo, Outcome, Role, Run, StageCost};

use crate::base::{Error, Progress, Result, files};
use crate::simulate::track::Track;

/// The long table, which every report has.
const RESULTS: &str = "results.csv";
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
    /// The cases of which all frames are in a file of their own.
    whole_films: BTreeSet<String>,
}

impl RunParts {
    /// `place` is where the run's files lie, seen from the page: empty or a folder with a slash at its end.
    fn track<'a>(&'a self, run: &'a Run, place: &'a str) -> html::TrackReport<'a> {
        let RunParts { tables, differences, pictures, scenes, whole_films } = self;
        html::TrackReport { run, place, tables, differences, pictures, scenes, whole_films }
    }
}

/// Refuses a `folder` that holds something and no report: a film's or a prediction's files have names that a report's have,
/// too, and would be lost.
pub fn refuse_other_folder(folder: &Path) -> Result<()> {
    let is_report = [run::RUN_FACTS, RESULTS, PAGE].iter().any(|name| folder.join(name).is_file());
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
    let (Some((first, others)), false) = (runs.split_first(), names.windows(2).any(|pair| pair[0] == pair[1])) else {
        let sentence = "a report of several tracks has one run of each, and these are of: ".to_owned();
        return Err(Error::input(sentence + &names.join(", ")).at(folder));
    };
    let mut reports = TrackReports::new(folder);
    let written = reports.add_named(Cow::Borrowed(first.0), first.1, progress)?;
    for (run, name) in others {
        reports.add_named(Cow::Borrowed(run), name, progress)?;
    }
    Ok(written)
}

/// Reports of runs of different tracks under one page, which are written one after the other: [`write_tracks`].
pub struct TrackReports<'a> {
    folder: PathBuf,
    /// Each run with its folder's name, seen from the page, and what the page shows of it.
    written: Vec<(Cow<'a, Run>, String, RunParts)>,
}

impl<'a> TrackReports<'a> {
    /// In `folder`, which need not be there.
    pub fn new(folder: &Path) -> Self {
        TrackReports { folder: folder.to_owned(), written: Vec::new() }
    }

    /// Writes the report of `run`, of another track than those before, into its own folder, and the page of all so far.
    /// What comes back names the page, and the run's report and table.
    ///
    /// Errors: those of [`write()`].
    pub fn add(&mut self, run: Run, progress: &dyn Progress) -> Result<Written> {
        let name = run.track.word();
        self.add_named(Cow::Owned(run), name, progress)
    }

    fn add_named(&mut self, run: Cow<'a, Run>, name: &str, progress: &dyn Progress) -> Result<Written> {
        let own = self.folder.join(name);
        let parts = write_parts(&run, &own, progress)?;
        let table = written(&own, &parts);
        self.written.push((run, format!("{name}/"), parts));
        let tracks: Vec<html::TrackReport<'_>> =
            self.written.iter().map(|(run, place, parts)| parts.track(run, place)).collect();
        let html = self.folder.join(PAGE);
        files::write_bytes(&html, html::report(&tracks).as_bytes())?;
        Ok(Written { html, ..table })
    }
}

/// The folders of the tracks' reports in `folder`, if it is one of [`TrackReports`]; else none.
pub fn track_folders(folder: &Path) -> Vec<PathBuf> {
    let of_tracks = [Track::Ideal, Track::Clinical].map(|track| folder.join(track.word()));
    let is_there = |folder: &PathBuf| folder.join(RESULTS).is_file();
    if folder.join(RESULTS).is_file() { Vec::new() } else { of_tracks.into_iter().filter(is_there).collect() }
}

/// Everything that belongs to one run, its own page included.
fn write_parts(run: &Run, folder: &Path, progress: &dyn Progress) -> Result<RunParts> {
    let summaries = summary::summarise(run);
    tables::write_results(run, &folder.join(RESULTS))?;
    tables::write_comparison(run, &folder.join("comparison.csv"))?;
    tables::write_summary(&summaries, &folder.join("summary.csv"))?;
    let differences = differences::neighbours(run, &summaries);
    tables::write_differences(&differences, &folder.join("differences.csv"))?;
    tables::write_frames(run, &folder.join("frames.csv"))?;
    tables::write_timings(run, &folder.join("timings.csv"))?;
    files::write_json(&folder.join(run::RUN_FACTS), &run.facts())?;
    let tables = table::ComparisonTable::all(run.track, &summaries);
    let latex: Vec<String> = tables.iter().map(|table| latex::table(table, &run.id)).collect();
    files::write_bytes(&folder.join("table.tex"), latex.join("\n").as_bytes())?;
    let pictures = plots::draw(run, &summaries, folder, progress)?;
    let markdown = markdown::report(run, &summaries, &tables, &differences, &pictures);
    files::write_bytes(&folder.join(MARKDOWN), markdown.as_bytes())?;
    let scenes = gather::gather(run, progress)?;
    scenes.write(folder)?;
    seal::write(folder, &[])?;
    let mut parts = RunParts { tables, differences, pictures, scenes, whole_films: BTreeSet::new() };
    let mut films = Vec::new();
    for case in &run.cases {
        progress.proceed()?;
        // One at a time: a whole film is large.
        if let Some(whole) = gather::whole_film(run, case)? {
            let page = html::whole_film(&html::TrackReport { scenes: &whole, ..parts.track(run, "../") }, case);
            let name = html::film_page(&case.id);
            files::write_bytes(&folder.join(&name), page.as_bytes())?;
            parts.whole_films.insert(case.id.clone());
            films.push(name);
        }
    }
    seal::write(folder, &films)?;
    files::write_bytes(&folder.join(PAGE), html::report(&[parts.track(run, "")]).as_bytes())?;
    Ok(parts)
}

fn written(folder: &Path, parts: &RunParts) -> Written {
    // A track has a table at least: that of its headline comes first.
    let table = parts.tables.first().map(markdown::comparison_table).unwrap_or_default();
    Written { markdown: folder.join(MARKDOWN), html: folder.join(PAGE), table }
}
