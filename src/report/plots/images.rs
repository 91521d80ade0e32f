//! Images side by side, truth first: renderings, and depth error maps on one logarithmic colour scale.

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::canvas::{INK, Pen, on_bitmap};
use crate::base::depth::present;
use crate::base::{Image, Result};
use crate::report::run::Run;
use crate::score::{Prediction, Question, Truth};

/// Frames shown of a case.
const ROWS: usize = 4;
/// Sides of shown images are at least this many pixels; whole multiples, so that pixels stay pixels.
const LEAST_SIDE: usize = 180;
/// Ends of the colour scale of depth errors.
const ERROR_SCALE_MM: [f64; 2] = [0.1, 30.0];
/// Where there is a truth but no prediction.
const ABSENT: [u8; 3] = [255, 0, 170];
/// Where there is no truth.
const NO_TRUTH: [u8; 3] = [255, 255, 255];

/// Layout in pixels: margin, heading row, foot row, label column, colour bar.
const MARGIN: usize = 6;
const HEAD: usize = 42;
const FOOT: usize = 24;
const LEFT: usize = 104;
const SCALE_BAR: usize = 66;

/// One image and the text below it.
struct LabelledImage {
    image: Image<u8>,
    foot: String,
}

/// A table of images with headings.
struct ImageGrid {
    heads: Vec<String>,
    rows: Vec<(String, Vec<LabelledImage>)>,
}

/// Renderings of a few frames: truth and each method. `None` without cells or frames to show.
pub fn renderings(run: &Run, case_id: &str, truth: &dyn Truth) -> Result<Option<Image<u8>>> {
    let shown = run.shown(case_id);
    let predictions = opened(&shown, truth)?;
    let mut rows = Vec::new();
    for frame in chosen(truth.frames().len()) {
        let mut tiles = vec![LabelledImage { image: truth.image(frame)?, foot: String::new() }];
        for ((_, _, score), prediction) in shown.iter().zip(&predictions) {
            let value =
                |id: &str| score.frame_scores[frame].values.iter().find(|v| v.metric == id).and_then(|v| v.value);
            let decibel = value("psnr_db").map_or_else(|| "identical".into(), |v| format!("{v:.1} dB"));
            let foot = value("ssim").map_or(decibel.clone(), |v| format!("{decibel}, SSIM {v:.3}"));
            tiles.push(LabelledImage { image: prediction.color(frame)?, foot });
        }
        rows.push((row_name(truth, frame), tiles));
    }
    let heads = std::iter::once("Truth".to_owned()).chain(shown.iter().map(|(m, _, _)| m.title.clone())).collect();
    compose(ImageGrid { heads, rows }, None)
}

/// True depth, and for each method |predicted - true depth|; a pixel without a prediction is magenta.
pub fn depth_errors(run: &Run, case_id: &str, truth: &dyn Truth) -> Result<Option<Image<u8>>> {
    let shown = run.shown(case_id);
    let predictions = opened(&shown, truth)?;
    let mut heads = vec!["True depth".to_owned()];
    let mut rows: Vec<(String, Vec<LabelledImage>)> = Vec::new();
    for frame in chosen(truth.frames().len()) {
        let depth = truth.depth_mm(frame)?;
        let far = depth.data.iter().filter_map(|&d| present(d)).fold(0.0, f64::max).max(1e-6);
        let map = painted(&depth, |_, d| present(d).map_or(NO_TRUTH, |d| shade(1.0 - d / far)));
        rows.push((row_name(truth, frame), vec![LabelledImage { image: map, foot: format!("0 to {far:.0} mm") }]));
    }
    for ((method, _, score), prediction) in shown.iter().zip(&predictions) {
        let mut any = false;
        for ((_, tiles), frame) in rows.iter_mut().zip(chosen(truth.frames().len())) {
            let Some(predicted) = prediction.depth_mm(frame)? else { continue };
            let depth = truth.depth_mm(frame)?;
            let map = painted(&depth, |index, t| match (present(t), present(predicted.data[index])) {
                (None, _) => NO_TRUTH,
                (Some(_), None) => ABSENT,
                (Some(t), Some(p)) => shade(on_error_scale((p - t).abs())),
            });
            let value =
                score.frame_scores[frame].values.iter().find(|v| v.metric == "depth_rmse_mm").and_then(|v| v.value);
            tiles.push(LabelledImage {
                image: map,
                foot: value.map_or_else(String::new, |v| format!("RMSE {v:.2} mm")),
            });
            any = true;
        }
        if any {
            heads.push(method.title.clone());
        }
    }
    if heads.len() < 2 {
        return Ok(None);
    }
    compose(ImageGrid { heads, rows }, Some("|depth error| [mm]"))
}

type ShownCell<'a> =
    (&'a crate::report::run::MethodInfo, &'a crate::report::run::CellRecord, &'a crate::score::CellScore);

fn opened(shown: &[ShownCell], truth: &dyn Truth) -> Result<Vec<Prediction>> {
    let question = Question::of(truth);
    shown.iter().map(|(_, cell, _)| Prediction::open(&cell.prediction, &question)).collect()
}

/// Frames spread over the sequence, the last one included.
fn chosen(frames: usize) -> Vec<usize> {
    let rows = ROWS.min(frames);
    (1..=rows).map(|row| (row * frames).div_ceil(rows) - 1).collect()
}

fn row_name(truth: &dyn Truth, frame: usize) -> String {
    let record = &truth.frames()[frame];
    format!("{:.1} s\nphase {:.2}", record.time_s, record.phase)
}

fn on_error_scale(error_mm: f64) -> f64 {
    let [low, high] = ERROR_SCALE_MM.map(f64::ln);
    ((error_mm.max(1e-9).ln() - low) / (high - low)).clamp(0.0, 1.0)
}

fn shade(share: f64) -> [u8; 3] {
    let color = ViridisRGB.get_color(share.clamp(0.0, 1.0));
    [color.0, color.1, color.2]
}

fn painted(depth: &Image<f32>, color: impl Fn(usize, f32) -> [u8; 3]) -> Image<u8> {
    Image {
        width: depth.width,
        height: depth.height,
        channels: 3,
        data: depth.data.iter().enumerate().flat_map(|(index, &d)| color(index, d)).collect(),
    }
}

/// Copies `tile` to (`left`, `top`), every pixel `factor` times as wide and high.
fn paste(page: &mut Image<u8>, tile: &Image<u8>, left: usize, top: usize, factor: usize) {
    for y in 0..tile.height * factor {
        for x in 0..tile.width * factor {
            page.pixel_mut(left + x, top + y).copy_from_slice(tile.pixel(x / factor, y / factor));
        }
    }
}

fn compose(panel: ImageGrid, scale_title: Option<&str>) -> Result<Option<Image<u8>>> {
    let Some(first) = panel.rows.first().and_then(|(_, tiles)| tiles.first()) else { return Ok(None) };
    let factor = LEAST_SIDE.div_ceil(first.image.width.max(1)).max(1);
    let (width, height) = (first.image.width * factor, first.image.height * factor);
    let page_width = LEFT + panel.heads.len() * (width + MARGIN) + MARGIN;
    let row_height = height + FOOT;
    let page_height = HEAD + panel.rows.len() * row_height + MARGIN + if scale_title.is_some() { SCALE_BAR } else { 0 };
    let mut page = Image::filled(page_width, page_height, 3, 255u8);
    let left_of = |column: usize| LEFT + column * (width + MARGIN);
    let top_of = |row: usize| HEAD + row * row_height;
    for (row, (_, tiles)) in panel.rows.iter().enumerate() {
        for (column, tile) in tiles.iter().enumerate() {
            paste(&mut page, &tile.image, left_of(column), top_of(row), factor);
        }
    }
    let bar_top = top_of(panel.rows.len()) + MARGIN;
    let bar_width = (page_width - LEFT - MARGIN).min(520);
    if scale_title.is_some() {
        let bar: Vec<u8> =
            (0..12 * bar_width).flat_map(|i| shade((i % bar_width) as f64 / (bar_width - 1) as f64)).collect();
        paste(&mut page, &Image { width: bar_width, height: 12, channels: 3, data: bar }, LEFT, bar_top, 1);
    }
    let pen = Pen::PLAIN;
    let centred = |style: TextStyle<'static>| style.pos(Pos::new(HPos::Center, VPos::Center));
    on_bitmap(&mut page, |canvas| {
        for (column, head) in panel.heads.iter().enumerate() {
            let lines = in_lines(head, width);
            let size = lines.iter().map(|line| fitting(line, width)).fold(f64::INFINITY, f64::min);
            for (line, part) in lines.iter().enumerate() {
                let y = (HEAD / 2) as i32 + 18 * line as i32 - 9 * (lines.len() as i32 - 1);
                let at = ((left_of(column) + width / 2) as i32, y);
                canvas.draw(&Text::new((*part).to_owned(), at, centred(pen.bold(size))))?;
            }
        }
        for (row, (name, tiles)) in panel.rows.iter().enumerate() {
            for (line, part) in name.lines().enumerate() {
                let at = ((LEFT / 2) as i32, (top_of(row) + height / 2 + 18 * line) as i32 - 9);
                canvas.draw(&Text::new(part.to_owned(), at, centred(pen.text(15.0))))?;
            }
            for (column, tile) in tiles.iter().enumerate() {
                let at = ((left_of(column) + width / 2) as i32, (top_of(row) + height + FOOT / 2) as i32 - 1);
                canvas.draw(&Text::new(tile.foot.clone(), at, centred(pen.text(14.0))))?;
            }
        }
        if let Some(title) = scale_title {
            let below = (bar_top + 22) as i32;
            for tick in [0.1, 0.3, 1.0, 3.0, 10.0, 30.0] {
                let x = LEFT as f64 + on_error_scale(tick) * (bar_width - 1) as f64;
                canvas.draw(&PathElement::new(
                    vec![(x as i32, bar_top as i32 + 12), (x as i32, bar_top as i32 + 15)],
                    pen.line(INK, 1.0),
                ))?;
                canvas.draw(&Text::new(format!("{tick}"), (x as i32, below), centred(pen.text(14.0))))?;
            }
            let note = format!("{title}; magenta: nothing predicted");
            let side = pen.text(14.0).pos(Pos::new(HPos::Left, VPos::Center));
            canvas.draw(&Text::new(note, (LEFT as i32, bar_top as i32 + 44), side))?;
        }
        Ok(())
    })?;
    Ok(Some(page))
}

/// `text` in one line, or cut at the space nearest to its middle where a tile is too narrow for it.
fn in_lines(text: &str, width: usize) -> Vec<&str> {
    let from_middle = |at: usize| at.abs_diff(text.len() / 2);
    let space = text.match_indices(' ').map(|(at, _)| at).min_by_key(|&at| from_middle(at));
    match space {
        Some(at) if fitting(text, width) < LARGEST_HEAD => vec![&text[..at], &text[at + 1..]],
        _ => vec![text],
    }
}

/// Height of a heading that has room, in pixels.
const LARGEST_HEAD: f64 = 16.0;

/// Text height at which `text` is no wider than a tile.
fn fitting(text: &str, width: usize) -> f64 {
    // A bold DejaVu letter is about 0.7 of its height wide.
    (width as f64 / (0.7 * text.chars().count().max(1) as f64)).clamp(8.0, LARGEST_HEAD)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_heading_that_is_too_wide_is_cut_near_its_middle() {
        assert_eq!(in_lines("Truth", 180), ["Truth"]);
        assert_eq!(in_lines("BridgeSplat (released objective)", 180), ["BridgeSplat", "(released objective)"]);
        assert_eq!(in_lines("a-name-of-one-word-that-is-long", 180), ["a-name-of-one-word-that-is-long"]);
    }
}
