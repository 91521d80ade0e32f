//! Plots and image panels of a run, as SVG (text stays text) and PNG.

mod canvas;
mod contours;
mod curves;
mod images;
mod labels;
mod methods;
mod pareto;

use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

use canvas::Figure;
use rayon::prelude::*;

use super::palette::Palette;
use super::pareto_chart::ParetoChart;
use super::run::{CaseInfo, Run};
use super::summary::MethodSummary;
use crate::base::{Image, Progress, Result, files};
use crate::formats::png;

/// An image that was written.
#[derive(Clone, Debug)]
pub struct ReportImage {
    /// Alternative text.
    pub title: String,
    /// What it shows.
    pub caption: String,
    /// Path of the PNG, relative to the report's folder.
    pub png: String,
    /// The SVG itself, where there is one.
    pub svg: Option<String>,
}

/// All images of a report.
#[derive(Clone, Debug, Default)]
pub struct ReportImages {
    /// Over all cases.
    pub overview: Vec<ReportImage>,
    /// Case id and its images.
    pub by_case: Vec<(String, Vec<ReportImage>)>,
}

/// Draws everything that the run has data for into `folder`/plots and `folder`/panels.
pub fn draw(run: &Run, summaries: &[MethodSummary], folder: &Path, progress: &dyn Progress) -> Result<ReportImages> {
    let palette = Palette::of(&run.methods);
    let mut pictures = ReportImages::default();
    let mut overview = |picture: Option<ReportImage>| pictures.overview.extend(picture);
    overview(plot(
        folder,
        "methods",
        methods::MethodBars::new(summaries, &palette),
        "Methods by metric",
        "Means over cases, 95 % bootstrap intervals; the arrow shows the better direction. Pale: bounds, which are not ranked.",
    )?);
    overview(plot(
        folder,
        "error-against-time",
        methods::ErrorAgainstTime::new(summaries, &palette),
        "Error against run time",
        "Method time per frame against error, means over cases with 95 % intervals, both axes logarithmic; lower left is better. Rings: bounds, which are not ranked. Dotted: whose a name is.",
    )?);
    overview(plot(
        folder,
        "phase",
        curves::PhaseGrid::new(run, &palette),
        "Breathing phase",
        "Recovered breathing phase; the thick line is the truth. 0 is full inspiration, 1 full expiration.",
    )?);
    overview(plot(
        folder,
        "contours",
        contours::ContourGrid::new(run, &palette),
        "Final contours",
        "Lumen contour in the plane of the last camera (triangle); the thick line is the truth. Cross: the true target; dots: where a method puts it.",
    )?);
    let done = AtomicUsize::new(0);
    let drawn = |case: &CaseInfo| {
        progress.proceed()?;
        let pictures = of_case(run, case, &palette, folder)?;
        progress.advance(done.fetch_add(1, Ordering::Relaxed) + 1, run.cases.len());
        Ok((case.id.clone(), pictures))
    };
    pictures.by_case = run.cases.par_iter().map(drawn).collect::<Result<_>>()?;
    pictures.by_case.retain(|(_, pictures)| !pictures.is_empty());
    Ok(pictures)
}

/// The images of one case.
fn of_case(run: &Run, case: &CaseInfo, palette: &Palette, folder: &Path) -> Result<Vec<ReportImage>> {
    let mut pictures = Vec::new();
    pictures.extend(plot(
        folder,
        &format!("frames-{}", case.id),
        curves::FrameErrors::new(run, &case.id, palette),
        &format!("Errors per frame, {}", case.id),
        "Phase and errors of every frame; errors in mm on logarithmic axes.",
    )?);
    if let Some(truth) = &case.truth {
        pictures.extend(panel(
            folder,
            &format!("images-{}", case.id),
            images::renderings(run, &case.id, truth.as_ref())?,
            &format!("Renderings, {}", case.id),
            "Renderings beside the truth, with PSNR and SSIM of the frame.",
        )?);
        pictures.extend(panel(
            folder,
            &format!("depth-{}", case.id),
            images::depth_errors(run, &case.id, truth.as_ref())?,
            &format!("Depth errors, {}", case.id),
            "True depth, and the absolute depth error of each method on a logarithmic scale from 0.1 to 30 mm; magenta: nothing predicted.",
        )?);
    }
    Ok(pictures)
}

/// Draws cost against error as `<stem>.svg` and `<stem>.png`; `front` says which points lie on the front.
pub fn draw_pareto(chart: &ParetoChart, front: &[bool], folder: &Path, stem: &str) -> Result<()> {
    let Some(figure) = pareto::ParetoPlot::new(chart, front) else { return Ok(()) };
    files::write_bytes(&folder.join(format!("{stem}.svg")), canvas::svg(&figure)?.as_bytes())?;
    png::write_rgb(&folder.join(format!("{stem}.png")), &canvas::bitmap(&figure)?)
}

fn plot(
    folder: &Path,
    stem: &str,
    figure: Option<impl Figure>,
    title: &str,
    caption: &str,
) -> Result<Option<ReportImage>> {
    let Some(figure) = figure else { return Ok(None) };
    let svg = canvas::svg(&figure)?;
    let png = format!("plots/{stem}.png");
    files::write_bytes(&folder.join(format!("plots/{stem}.svg")), svg.as_bytes())?;
    png::write_rgb(&folder.join(&png), &canvas::bitmap(&figure)?)?;
    Ok(Some(ReportImage { title: title.into(), caption: caption.into(), png, svg: Some(svg) }))
}

fn panel(
    folder: &Path,
    stem: &str,
    image: Option<Image<u8>>,
    title: &str,
    caption: &str,
) -> Result<Option<ReportImage>> {
    let Some(image) = image else { return Ok(None) };
    let png = format!("panels/{stem}.png");
    let path = folder.join(&png);
    png::write_rgb(&path, &image)?;
    Ok(Some(ReportImage { title: title.into(), caption: caption.into(), png, svg: None }))
}
