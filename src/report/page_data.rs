//! What the page's scripts are given: one JSON per case, read when the case is opened; and, when reports are merged, read
//! back from the pages of whole films.

use serde::{Deserialize, Serialize};

use super::palette::Palette;
use super::run::{CaseInfo, CellRecord, MethodInfo, Role, Run};
use super::scene::{AirwayScene, FilmKey, FilmScene, Packed, Pictures, RowScene, Scenes, SurfaceScene};
use crate::base::{Error, Result};
use crate::score::{CellScore, Goal, metric};

/// What the error plot can show, the first at the beginning.
const SERIES: [&str; 5] = ["target_mean_mm", "phase_mae", "depth_rmse_mm", "psnr_db", "ssim"];
/// Most frames of a curve: the plot is no wider in pixels.
const SAMPLES: usize = 240;

/// What stands around a case's data in a page.
pub const DATA_START: &str = "<script type=\"application/json\">";
/// What ends them.
pub const DATA_END: &str = "</script>";

/// A case.
#[derive(Serialize)]
struct PageCase<'a> {
    id: &'a str,
    /// What the error plot can show.
    metrics: Vec<PageMetric>,
    /// Frames of the curves, their times and true phases.
    samples: Vec<usize>,
    times_s: Vec<f64>,
    phases: Vec<f64>,
    film: Option<PageFilm<'a>>,
    rows: Vec<PageRow<'a>>,
}

#[derive(Serialize)]
struct PageMetric {
    id: &'static str,
    heading: String,
    higher: bool,
    digits: usize,
}

#[derive(Serialize)]
struct PageFilm<'a> {
    key: &'a FilmKey,
    title: &'a str,
    times_s: &'a Packed<f32>,
    phases: &'a Packed<f32>,
    poses: &'a Packed<f32>,
    tan_half_height: f64,
    targets_mm: &'a Packed<f32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    targets_by_frame_mm: Option<&'a Packed<f32>>,
    airway: Option<&'a AirwayScene>,
    pictures: &'a Pictures,
}

impl<'a> PageFilm<'a> {
    fn of(film: &'a FilmScene) -> Self {
        PageFilm {
            key: &film.film,
            title: &film.title,
            times_s: &film.times_s,
            phases: &film.phases,
            poses: &film.poses,
            tan_half_height: film.tan_half_height,
            targets_mm: &film.targets_mm,
            targets_by_frame_mm: film.targets_by_frame_mm.as_ref(),
            airway: film.airway.as_ref(),
            pictures: &film.pictures,
        }
    }
}

#[derive(Serialize)]
struct PageRow<'a> {
    method: &'a str,
    seed: u64,
    run_id: &'a str,
    title: &'a str,
    color: String,
    dash: Option<[u8; 2]>,
    is_bound: bool,
    pictures: Option<&'a Pictures>,
    targets_mm: Option<&'a Packed<f32>>,
    surface: Option<&'a SurfaceScene>,
    phase: Vec<Option<f64>>,
    /// In the order of the metrics.
    series: Vec<Vec<Option<f64>>>,
}

/// Four digits that count: more than a plot shows.
fn short(value: f64) -> f64 {
    format!("{value:.3e}").parse().unwrap_or(value)
}

fn sampled(scores: &[&CellScore]) -> Vec<usize> {
    let mut frames: Vec<usize> = scores.iter().flat_map(|s| s.frame_scores.iter().map(|f| f.frame)).collect();
    frames.sort_unstable();
    frames.dedup();
    super::scene::spread(frames.len(), SAMPLES).into_iter().map(|k| frames[k]).collect()
}

/// The data of a case, to stand in a script element: no `<` in it. `None` where nothing was scored.
pub fn case_data<'a>(run: &'a Run, case: &'a CaseInfo, scenes: &'a Scenes, palette: &Palette) -> Option<String> {
    let shown = run.shown(&case.id);
    let scores: Vec<&CellScore> = shown.iter().map(|(_, _, score)| *score).collect();
    let samples = sampled(&scores);
    // A row may lack frames that another has.
    let any = |at: &usize| scores.iter().find_map(|score| score.frame_scores.iter().find(|f| f.frame == *at));
    if samples.is_empty() {
        return None;
    }
    let has = |id: &str| {
        scores.iter().any(|score| score.frame_scores.iter().any(|f| f.values.iter().any(|v| v.metric == id)))
    };
    let metrics: Vec<_> = SERIES.into_iter().filter(|id| has(id)).filter_map(metric).collect();
    let row = |&(method, cell, score): &(&'a MethodInfo, &'a CellRecord, &'a CellScore)| {
        let frame = |at: &usize| score.frame_scores.iter().find(|f| f.frame == *at);
        let value = |id: &str, at: &usize| frame(at)?.values.iter().find(|v| v.metric == id)?.value.map(short);
        let (style, kept) = (palette.style(&method.id), scenes.row(score));
        PageRow {
            method: &method.id,
            seed: cell.seed,
            run_id: &cell.run_id,
            title: &method.title,
            color: style.hex(),
            dash: style.dash,
            is_bound: method.role == Role::Sanity,
            pictures: kept.map(|row| &row.pictures).filter(|pictures| !pictures.frames.is_empty()),
            targets_mm: kept.map(|row| &row.targets_mm).filter(|targets| !targets.0.is_empty()),
            surface: kept.map(|row| &row.surface),
            phase: samples.iter().map(|at| frame(at)?.phase_predicted.map(short)).collect(),
            series: metrics.iter().map(|m| samples.iter().map(|at| value(m.id, at)).collect()).collect(),
        }
    };
    let rows = shown.iter().map(row).collect();
    let data = PageCase {
        id: &case.id,
        metrics: metrics
            .iter()
            .map(|m| PageMetric {
                id: m.id,
                heading: if m.id == "phase_mae" { "Phase error".into() } else { m.heading() },
                higher: m.direction == Goal::Higher,
                digits: m.digits,
            })
            .collect(),
        times_s: samples.iter().map(|at| any(at).map_or(0.0, |f| short(f.time_s))).collect(),
        phases: samples.iter().map(|at| any(at).map_or(0.0, |f| short(f.phase))).collect(),
        film: scenes.film(&case.id).map(PageFilm::of),
        rows,
        samples,
    };
    // Inside a script element nothing but `</script` and `<!--` has a meaning: without `<` there is neither.
    serde_json::to_string(&data).ok().map(|text| text.replace('<', "\\u003c"))
}

/// What [`case_data`] gave to a page, as far as [`Scenes`] hold it.
#[derive(Deserialize)]
struct KeptCase {
    film: Option<KeptFilm>,
    rows: Vec<KeptRow>,
}

#[derive(Deserialize)]
struct KeptFilm {
    key: FilmKey,
    title: String,
    times_s: Packed<f32>,
    phases: Packed<f32>,
    poses: Packed<f32>,
    tan_half_height: f64,
    targets_mm: Packed<f32>,
    targets_by_frame_mm: Option<Packed<f32>>,
    pictures: Pictures,
}

#[derive(Deserialize)]
struct KeptRow {
    method: String,
    seed: u64,
    run_id: String,
    pictures: Option<Pictures>,
    targets_mm: Option<Packed<f32>>,
}

/// The film that the page of a whole film shows, and those of its rows that `is_wanted` (method, seed, run id), without
/// surfaces and contours. `None` where the page has no film.
///
/// Errors: data that are no JSON of [`case_data`], or whose arrays do not fit each other.
pub fn kept_scenes(page: &str, is_wanted: impl Fn(&str, u64, &str) -> bool) -> Result<Option<Scenes>> {
    let Some((_, rest)) = page.split_once(DATA_START) else { return Ok(None) };
    let data = rest.split_once(DATA_END).map_or(rest, |(data, _)| data);
    let case: KeptCase = serde_json::from_str(data).map_err(|e| Error::input(format!("the film's data: {e}")))?;
    let Some(film) = case.film else { return Ok(None) };
    let row = |row: KeptRow| {
        Some(RowScene {
            film: film.key.clone(),
            method: row.method,
            seed: row.seed,
            pictures: row.pictures?,
            targets_mm: row.targets_mm.unwrap_or_default(),
            ..RowScene::default()
        })
    };
    let wanted = case.rows.into_iter().filter(|row| is_wanted(&row.method, row.seed, &row.run_id));
    let rows = wanted.filter_map(row).collect();
    let film = FilmScene {
        film: film.key,
        title: film.title,
        times_s: film.times_s,
        phases: film.phases,
        poses: film.poses,
        tan_half_height: film.tan_half_height,
        targets_mm: film.targets_mm,
        targets_by_frame_mm: film.targets_by_frame_mm,
        airway: None,
        pictures: film.pictures,
    };
    let scenes = Scenes { films: vec![film], rows };
    scenes.check()?;
    Ok(Some(scenes))
}
