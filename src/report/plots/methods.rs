//! Methods compared: bars with intervals per metric, and error against run time.

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::canvas::{Area, Drawn, Figure, GRID, INK, Pen, Stroke, legend, tick};
use super::labels::{Taken, free_spot};
use crate::report::palette::Palette;
use crate::report::summary::MethodSummary;
use crate::report::table::{arrow, show};
use crate::score::statistics::MeanInterval;
use crate::score::{Metric, metric, paper_metrics};

struct Bar {
    color: RGBColor,
    place: usize,
    mean: MeanInterval,
}

/// One panel of bars per metric of the paper, a row per method: numbers beside bars need room that lying bars have,
/// however many methods there are.
pub struct MethodBars {
    names: Vec<(String, Stroke)>,
    panels: Vec<(&'static Metric, Vec<Bar>)>,
}

/// Panels beside each other.
const COLUMNS: usize = 5;
/// Sizes in units: the column of names, a panel, a method's row, what a panel has above its rows.
const NAMES_WIDTH: u32 = 214;
const PANEL_WIDTH: u32 = 206;
const ROW_HEIGHT: u32 = 17;
const PANEL_HEAD: u32 = 34;
/// Room for a number beside the longest bar, in shares of the bars.
const NUMBER_ROOM: f64 = 0.42;

impl MethodBars {
    /// `None` when nothing was scored.
    pub fn new(summaries: &[MethodSummary], palette: &Palette) -> Option<Self> {
        let stroke = |s: &MethodSummary| Stroke::from(palette.style(&s.method.id));
        let names = summaries.iter().map(|s| (s.method.title.clone(), stroke(s))).collect();
        let bars = |m: &Metric| -> Vec<Bar> {
            let bar = |(place, s): (usize, &MethodSummary)| {
                s.mean(m.id).map(|mean| Bar { color: stroke(s).color, place, mean })
            };
            summaries.iter().enumerate().filter_map(bar).collect()
        };
        let panels: Vec<_> = paper_metrics().map(|m| (m, bars(m))).filter(|(_, bars)| !bars.is_empty()).collect();
        (!panels.is_empty()).then_some(MethodBars { names, panels })
    }

    /// Height of a row of panels in units.
    fn panel_height(&self) -> u32 {
        PANEL_HEAD + ROW_HEIGHT * self.names.len() as u32
    }
}

impl Figure for MethodBars {
    fn size(&self) -> (u32, u32) {
        let rows = self.panels.len().div_ceil(COLUMNS) as u32;
        (NAMES_WIDTH + PANEL_WIDTH * COLUMNS as u32, 12 + rows * (self.panel_height() + 12))
    }

    fn draw<DB: DrawingBackend>(&self, page: &Area<DB>, pen: Pen) -> Drawn<(), DB> {
        for (row, panels) in self.panels.chunks(COLUMNS).enumerate() {
            let top = 8.0 + row as f64 * f64::from(self.panel_height() + 12);
            for (place, (name, stroke)) in self.names.iter().enumerate() {
                let y = pen.at(top + f64::from(PANEL_HEAD) + (place as f64 + 0.5) * f64::from(ROW_HEIGHT));
                let style = pen.text(12.0).pos(Pos::new(HPos::Right, VPos::Center));
                page.draw(&Text::new(shortened(name), (pen.at(f64::from(NAMES_WIDTH) - 8.0), y), style))?;
                let mark = [pen.at(f64::from(NAMES_WIDTH) - 4.0), pen.at(f64::from(NAMES_WIDTH))];
                page.draw(&Rectangle::new(
                    [(mark[0], y - pen.at(5.0)), (mark[1], y + pen.at(5.0))],
                    stroke.color.filled(),
                ))?;
            }
            for (column, (m, bars)) in panels.iter().enumerate() {
                let left = f64::from(NAMES_WIDTH) + column as f64 * f64::from(PANEL_WIDTH);
                draw_bars(page, pen, (left, top), m, bars, self.names.len())?;
            }
        }
        Ok(())
    }
}

/// A name that fits into its column.
fn shortened(name: &str) -> String {
    // Letters of a column of names, at the text's size.
    const LETTERS: usize = 31;
    if name.chars().count() <= LETTERS {
        name.to_owned()
    } else {
        name.chars().take(LETTERS - 1).chain(['…']).collect()
    }
}

fn draw_bars<DB: DrawingBackend>(
    page: &Area<DB>,
    pen: Pen,
    (left, top): (f64, f64),
    m: &Metric,
    bars: &[Bar],
    rows: usize,
) -> Drawn<(), DB> {
    let end_of = |b: &Bar| b.mean.interval.map_or(b.mean.mean, |[_, high]| high.max(b.mean.mean));
    let start_of = |b: &Bar| b.mean.interval.map_or(b.mean.mean, |[low, _]| low.min(b.mean.mean));
    let low = bars.iter().map(start_of).fold(0.0, f64::min);
    let high = bars.iter().map(end_of).fold(0.0, f64::max).max(1e-9);
    let width = f64::from(PANEL_WIDTH) - 14.0;
    let x = |v: f64| left + 4.0 + (v - low) / ((1.0 + NUMBER_ROOM) * (high - low)) * width;
    let y = |place: usize| top + f64::from(PANEL_HEAD) + (place as f64 + 0.5) * f64::from(ROW_HEIGHT);
    let at = |x: f64, y: f64| (pen.at(x), pen.at(y));
    let head = format!("{} {}", m.heading(), arrow(m));
    page.draw(&Text::new(head, at(x(0.0), top + 4.0), pen.bold(13.0)))?;
    let axis = vec![at(x(0.0), top + f64::from(PANEL_HEAD) - 4.0), at(x(0.0), y(rows - 1) + 9.0)];
    page.draw(&PathElement::new(axis, pen.line(INK, 1.0)))?;
    for bar in bars {
        let (middle, mean) = (y(bar.place), bar.mean.mean);
        let (from, to) = (x(mean.min(0.0)), x(mean.max(0.0)));
        page.draw(&Rectangle::new([at(from, middle - 5.5), at(to, middle + 5.5)], bar.color.filled()))?;
        if let Some([low, high]) = bar.mean.interval {
            let stem = vec![at(x(low), middle), at(x(high), middle)];
            page.draw(&PathElement::new(stem, pen.line(INK, 1.3)))?;
            for end in [low, high] {
                let cap = vec![at(x(end), middle - 3.0), at(x(end), middle + 3.0)];
                page.draw(&PathElement::new(cap, pen.line(INK, 1.3)))?;
            }
        }
        let style = pen.text(11.0).pos(Pos::new(HPos::Left, VPos::Center));
        page.draw(&Text::new(show(m, mean), at(x(end_of(bar).max(0.0)) + 5.0, middle), style))?;
    }
    Ok(())
}

/// Colour, time and error of a method.
type MethodPoint = (RGBColor, MeanInterval, MeanInterval);

/// Time per frame against an error, both axes logarithmic.
pub struct ErrorAgainstTime {
    names: Vec<(String, Stroke)>,
    panels: Vec<(&'static Metric, Vec<MethodPoint>)>,
}

impl ErrorAgainstTime {
    /// `None` when no method has both a time and an error.
    pub fn new(summaries: &[MethodSummary], palette: &Palette) -> Option<Self> {
        let stroke = |s: &MethodSummary| Stroke::from(palette.style(&s.method.id));
        let mut panels = Vec::new();
        for m in ["depth_rmse_mm", "target_error_mm", "phase_mae"].into_iter().filter_map(metric) {
            let point = |s: &MethodSummary| {
                let (time, error) = (s.mean("time_per_frame_s")?, s.mean(m.id)?);
                (time.mean > 0.0 && error.mean > 0.0).then(|| (stroke(s).color, time, error))
            };
            let points: Vec<_> = summaries.iter().filter_map(point).collect();
            if !points.is_empty() {
                panels.push((m, points));
            }
        }
        let plain = |s: &MethodSummary| Stroke { dash: None, ..stroke(s) };
        let names = summaries.iter().map(|s| (s.method.title.clone(), plain(s))).collect();
        (!panels.is_empty()).then_some(ErrorAgainstTime { names, panels })
    }
}

impl Figure for ErrorAgainstTime {
    fn size(&self) -> (u32, u32) {
        (420 * self.panels.len().max(2) as u32, 400)
    }

    fn draw<DB: DrawingBackend>(&self, page: &Area<DB>, pen: Pen) -> Drawn<(), DB> {
        let rest = legend(page, pen, &self.names)?;
        for (area, (m, points)) in rest.split_evenly((1, self.panels.len())).iter().zip(&self.panels) {
            draw_points(area, pen, m, points)?;
        }
        Ok(())
    }
}

/// A logarithmic range around positive values, at least a factor of four wide.
pub(super) fn log_range(values: impl Iterator<Item = f64>) -> [f64; 2] {
    let (low, high) = values
        .filter(|v| v.is_finite() && *v > 0.0)
        .fold((f64::INFINITY, 0.0f64), |(low, high), v| (low.min(v), high.max(v)));
    if high <= 0.0 { [0.1, 10.0] } else { [low.min(high / 4.0) / 1.6, high.max(low * 4.0) * 1.6] }
}

/// 1, 2 and 5 times the powers of ten in the range; the powers alone in a range of more than three.
pub(super) fn log_ticks([low, high]: [f64; 2]) -> Vec<f64> {
    let decades = low.log10().floor() as i32..=high.log10().ceil() as i32;
    // More than nine labels would touch.
    let steps: &[f64] = if (high / low).log10() > 3.0 { &[1.0] } else { &[1.0, 2.0, 5.0] };
    let ticks = decades.flat_map(|d| steps.iter().map(move |step| step * 10f64.powi(d)));
    ticks.filter(|t| (low..=high).contains(t)).collect()
}

fn bounds_of(mean: &MeanInterval) -> impl Iterator<Item = f64> {
    let [low, high] = mean.interval.unwrap_or([mean.mean; 2]);
    // A bound at or below zero has no place on a logarithmic axis.
    [mean.mean, high, if low > 0.0 { low } else { mean.mean }].into_iter()
}

fn draw_points<DB: DrawingBackend>(area: &Area<DB>, pen: Pen, m: &Metric, points: &[MethodPoint]) -> Drawn<(), DB> {
    let x = log_range(points.iter().flat_map(|p| bounds_of(&p.1)));
    let y = log_range(points.iter().flat_map(|p| bounds_of(&p.2)));
    let mut chart = ChartBuilder::on(area)
        .margin(pen.px(8.0))
        .margin_right(pen.px(16.0))
        .x_label_area_size(pen.px(40.0))
        .y_label_area_size(pen.px(62.0))
        .build_cartesian_2d(
            (x[0]..x[1]).log_scale().with_key_points(log_ticks(x)),
            (y[0]..y[1]).log_scale().with_key_points(log_ticks(y)),
        )?;
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .bold_line_style(pen.line(GRID, 1.0))
        .axis_style(pen.line(INK, 1.0))
        .label_style(pen.text(11.0))
        .axis_desc_style(pen.text(12.0))
        .x_labels(6)
        .y_labels(6)
        .x_label_formatter(&|v| tick(*v))
        .y_label_formatter(&|v| tick(*v))
        .x_desc("method time per frame [s]")
        .y_desc(m.heading())
        .draw()?;
    for (color, time, error) in points {
        let at = (time.mean, error.mean);
        let across: Vec<f64> = bounds_of(time).collect();
        let up: Vec<f64> = bounds_of(error).collect();
        let lines = [
            PathElement::new(vec![(across[2], at.1), (across[1], at.1)], pen.line(*color, 1.3)),
            PathElement::new(vec![(at.0, up[2]), (at.0, up[1])], pen.line(*color, 1.3)),
        ];
        chart.draw_series(lines)?;
        chart.draw_series(std::iter::once(Circle::new(at, pen.px(5.5), color.filled())))?;
    }
    let corner = chart.backend_coord(&(x[0], y[0]));
    let (across, down) = area.get_pixel_range();
    let room = Taken { low: (corner.0, down.start), high: (across.end, corner.1) };
    let places: Vec<(i32, i32)> = points.iter().map(|p| chart.backend_coord(&(p.1.mean, p.2.mean))).collect();
    let mut taken: Vec<Taken> = places.iter().map(|&place| Taken::around(place, pen.at(5.5))).collect();
    for (point, &place) in points.iter().zip(&places) {
        let (text, style) = (show(m, point.2.mean), pen.text(10.0));
        let (width, height) = area.estimate_text_size(&text, &style)?;
        let (shift, spot) = free_spot(place, [width as i32, height as i32], pen, (room, &taken));
        taken.push(spot);
        let label = Text::new(text, shift, style.pos(Pos::new(HPos::Left, VPos::Top)));
        chart.draw_series(std::iter::once(EmptyElement::at((point.1.mean, point.2.mean)) + label))?;
    }
    Ok(())
}
