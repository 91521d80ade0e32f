//! What people and machines read: CSV, Markdown, LaTeX, HTML, plots, JUnit, gate verdicts.
//!
//! ```text
//! Run (cells with their scores) -> write() -> results.csv frames.csv timings.csv comparison.csv summary.csv
//!                                             differences.csv run.json report.md report.html table.tex plots/ panels/
//!                                             films/ scenes.json manifest.json
//! ```

pub mod ablation;
pub mod benchmark_json;
pub mod compare;
pub mod differences;
pub mod gate;
pub mod gate_files;
pub mod gate_limits;
#[cfg(test)]
mod gate_tests;
mod gather;
mod html;
mod latex;
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

use crate::base::{Progress, Result, files};

/// What [`write()`] left behind.
#[derive(Clone, Debug)]
pub struct Written {
    /// The Markdown report.
    pub markdown: PathBuf,
    /// The HTML report.
    pub html: PathBuf,
    /// The table that ranks, as Markdown, for a terminal or a CI summary.
    pub table: String,
}

/// Writes every file of the report into `folder`, tables first, so that an image that cannot be drawn loses no number.
///
/// Errors: an unwritable folder, a sequence or prediction that cannot be read again for the images.
pub fn write(run: &Run, folder: &Path, progress: &dyn Progress) -> Result<Written> {
    let summaries = summary::summarise(run);
    tables::write_results(run, &folder.join("results.csv"))?;
    tables::write_comparison(run, &folder.join("comparison.csv"))?;
    tables::write_summary(&summaries, &folder.join("summary.csv"))?;
    let differences = differences::neighbours(run, &summaries);
    tables::write_differences(&differences, &folder.join("differences.csv"))?;
    tables::write_frames(run, &folder.join("frames.csv"))?;
    tables::write_timings(run, &folder.join("timings.csv"))?;
    files::write_json(&folder.join("run.json"), &run.facts())?;
    let tables = table::ComparisonTable::both(&summaries);
    let latex: Vec<String> = tables.iter().map(|table| latex::table(table, &run.id)).collect();
    files::write_bytes(&folder.join("table.tex"), latex.join("\n").as_bytes())?;
    let pictures = plots::draw(run, &summaries, folder, progress)?;
    let (markdown, html) = (folder.join("report.md"), folder.join("report.html"));
    files::write_bytes(&markdown, markdown::report(run, &summaries, &tables, &differences, &pictures).as_bytes())?;
    let scenes = gather::gather(run, progress)?;
    scenes.write(folder)?;
    seal::write(folder)?;
    let track =
        html::TrackReport { run, tables: &tables, differences: &differences, pictures: &pictures, scenes: &scenes };
    files::write_bytes(&html, html::report(&[track]).as_bytes())?;
    for case in &run.cases {
        // One at a time: a whole film is large.
        if let Some(whole) = gather::whole_film(run, case)? {
            let page = html::whole_film(run, case, &whole);
            files::write_bytes(&folder.join(format!("films/{}.html", case.id)), page.as_bytes())?;
        }
    }
    let [ranking, _] = &tables;
    Ok(Written { markdown, html, table: markdown::comparison_table(ranking) })
}
