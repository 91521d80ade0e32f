//! Methods compared: bars with intervals per metric, and error against run time.

use plotters::element::DashedPathElement;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::canvas::{
    AXIS_TEXT, Area, Drawn, Figure, GRID, INK, Pen, Stroke, TICK_TEXT, TITLE_TEXT, X_ROOM, Y_ROOM, tick,
};
use super::labels::{LabelRoom, Taken, along, free_spot};
use crate::report::palette::Palette;
use crate::report::run::Role;
use crate::report::summary::{MethodSummary, in_order_of_tables};
use crate::report::table::{arrow, show};
use crate::score::statistics::MeanInterval;
use crate::score::{Metric, metric, paper_metrics};

struct Bar {
    color: RGBColor,
    role: Role,
    place: usize,
    mean: MeanInterval,
}

/// How much of a bound's colour its bar has: it is no method.
const BOUND_STRENGTH: f64 = 0.45;

/// One panel of bars per metric of the paper, a row per method: numbers beside bars need room that lying bars have,
/// however many methods there are.
pub struct MethodBars {
    names: Vec<(String, Stroke)>,
    panels: Vec<(&'static Metric, Vec<Bar>)>,
}

/// Panels beside each other.
const COLUMNS: usize = 5;
/// Sizes in units: the column of names, a panel, a method's row, what a panel has above its rows.
const NAMES_WIDTH: u32 = 250;
const PANEL_WIDTH: u32 = 212;
const ROW_HEIGHT: u32 = 19;
const PANEL_HEAD: u32 = 34;
/// Room for a number beside the longest bar, in shares of the bars.
const NUMBER_ROOM: f64 = 0.5;

impl MethodBars {
    /// `None` when nothing was scored.
    pub fn new(summaries: &[MethodSummary], palette: &Palette) -> Option<Self> {
        let stroke = |s: &MethodSummary| Stroke::from(palette.style(&s.method.id));
        let rows = || in_order_of_tables(summaries);
        let names = rows().map(|s| (s.method.title.clone(), stroke(s))).collect();
        let bars = |m: &Metric| -> Vec<Bar> {
            let bar = |(place, s): (usize, &MethodSummary)| {
                s.mean(m.id).map(|mean| Bar { color: stroke(s).color, role: s.method.role, place, mean })
            };
            rows().enumerate().filter_map(bar).collect()
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
                let style = pen.text(TICK_TEXT).pos(Pos::new(HPos::Right, VPos::Center));
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

/// A line from a name to its dot: dots in grey, so that it is no interval.
const TIE: RGBColor = RGBColor(140, 140, 140);
const TIE_DASH: [f64; 2] = [1.5, 2.5];
/// Half the width of the bar at the end of an interval, in units.
const CAP: f64 = 3.0;

/// A name that fits into its column.
fn shortened(name: &str) -> String {
    // Letters of a column of names, at the text's size.
    const LETTERS: usize = 35;
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
    // Times have their unit beside the number.
    let head = if m.id == "time_total_s" { m.label.to_owned() } else { m.heading() };
    page.draw(&Text::new(format!("{head} {}", arrow(m)), at(x(0.0), top + 4.0), pen.bold(TITLE_TEXT)))?;
    let axis = vec![at(x(0.0), top + f64::from(PANEL_HEAD) - 4.0), at(x(0.0), y(rows - 1) + 9.0)];
    page.draw(&PathElement::new(axis, pen.line(INK, 1.0)))?;
    for bar in bars {
        let (middle, mean) = (y(bar.place), bar.mean.mean);
        let (from, to) = (x(mean.min(0.0)), x(mean.max(0.0)));
        let strength = if bar.role == Role::Sanity { BOUND_STRENGTH } else { 1.0 };
        let fill = bar.color.mix(strength).filled();
        page.draw(&Rectangle::new([at(from, middle - 6.0), at(to, middle + 6.0)], fill))?;
        if let Some([low, high]) = bar.mean.interval {
            // A light rim, so that it stands out from every bar.
            for (color, width) in [(WHITE, 3.3), (INK, 1.3)] {
                let stem = vec![at(x(low), middle), at(x(high), middle)];
                page.draw(&PathElement::new(stem, pen.line(color, width)))?;
                for end in [low, high] {
                    let cap = vec![at(x(end), middle - 3.5), at(x(end), middle + 3.5)];
                    page.draw(&PathElement::new(cap, pen.line(color, width)))?;
                }
            }
        }
        let style = pen.text(TICK_TEXT).pos(Pos::new(HPos::Left, VPos::Center));
        page.draw(&Text::new(show(m, mean), at(x(end_of(bar).max(0.0)) + 5.0, middle), style))?;
    }
    Ok(())
}

/// A method in a plot of time against error.
struct MethodPoint {
    title: String,
    role: Role,
    color: RGBColor,
    time: MeanInterval,
    error: MeanInterval,
}

/// Time per frame against an error, both axes logarithmic. The name stands beside the dot: so many colours are not told
/// apart by a list of them.
pub struct ErrorAgainstTime {
    panels: Vec<(&'static Metric, Vec<MethodPoint>)>,
}

impl ErrorAgainstTime {
    /// `None` when no method has both a time and an error.
    pub fn new(summaries: &[MethodSummary], palette: &Palette) -> Option<Self> {
        let mut panels = Vec::new();
        for m in ["depth_rmse_mm", "target_error_mm", "phase_mae"].into_iter().filter_map(metric) {
            let point = |s: &MethodSummary| {
                let (time, error) = (s.mean("time_per_frame_s")?, s.mean(m.id)?);
                let (title, color) = (s.method.title.clone(), Stroke::from(palette.style(&s.method.id)).color);
                (time.mean > 0.0 && error.mean > 0.0).then_some(MethodPoint {
                    title,
                    role: s.method.role,
                    color,
                    time,
                    error,
                })
            };
            let points: Vec<_> = summaries.iter().filter_map(point).collect();
            if !points.is_empty() {
                panels.push((m, points));
            }
        }
        (!panels.is_empty()).then_some(ErrorAgainstTime { panels })
    }
}

impl Figure for ErrorAgainstTime {
    fn size(&self) -> (u32, u32) {
        (440 * self.panels.len().max(2) as u32, 460)
    }

    fn draw<DB: DrawingBackend>(&self, page: &Area<DB>, pen: Pen) -> Drawn<(), DB> {
        for (area, (m, points)) in page.split_evenly((1, self.panels.len())).iter().zip(&self.panels) {
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
    let x = log_range(points.iter().flat_map(|p| bounds_of(&p.time)));
    let y = log_range(points.iter().flat_map(|p| bounds_of(&p.error)));
    let mut chart = ChartBuilder::on(area)
        .margin(pen.px(8.0))
        .margin_right(pen.px(16.0))
        .x_label_area_size(pen.px(X_ROOM))
        .y_label_area_size(pen.px(Y_ROOM + 10.0))
        .build_cartesian_2d(
            (x[0]..x[1]).log_scale().with_key_points(log_ticks(x)),
            (y[0]..y[1]).log_scale().with_key_points(log_ticks(y)),
        )?;
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .bold_line_style(pen.line(GRID, 1.0))
        .axis_style(pen.line(INK, 1.0))
        .label_style(pen.text(TICK_TEXT))
        .axis_desc_style(pen.text(AXIS_TEXT))
        .x_labels(6)
        .y_labels(6)
        .x_label_formatter(&|v| tick(*v))
        .y_label_formatter(&|v| tick(*v))
        .x_desc("method time per frame [s]")
        .y_desc(m.heading())
        .draw()?;
    let radius = 5.5;
    let (mut taken, mut lines) = (Vec::new(), Vec::new());
    for point in points {
        let at = (point.time.mean, point.error.mean);
        let across: Vec<f64> = bounds_of(&point.time).collect();
        let up: Vec<f64> = bounds_of(&point.error).collect();
        let whiskers = [[(across[2], at.1), (across[1], at.1)], [(at.0, up[2]), (at.0, up[1])]];
        let line = |ends: &[(f64, f64); 2]| PathElement::new(ends.to_vec(), pen.line(point.color, 1.3));
        chart.draw_series(whiskers.iter().map(line))?;
        for (ends, cap) in whiskers.iter().zip([[0, pen.at(CAP)], [pen.at(CAP), 0]]) {
            // An interval of no length has no ends.
            if ends[0] == ends[1] {
                continue;
            }
            let [right, down] = cap;
            let bar = |&end: &(f64, f64)| {
                EmptyElement::at(end)
                    + PathElement::new(vec![(-right, -down), (right, down)], pen.line(point.color, 1.3))
            };
            chart.draw_series(ends.iter().map(bar))?;
        }
        lines.extend(whiskers.map(|ends| Taken::between(ends.map(|end| chart.backend_coord(&end)))));
        taken.push(Taken::around(chart.backend_coord(&at), pen.at(radius)));
    }
    for point in points {
        let at = (point.time.mean, point.error.mean);
        chart.draw_series(std::iter::once(Circle::new(at, pen.px(radius), point.color.filled())))?;
        if point.role == Role::Sanity {
            chart.draw_series(std::iter::once(Circle::new(at, pen.px(0.5 * radius), WHITE.filled())))?;
        }
    }
    let corner = chart.backend_coord(&(x[0], y[0]));
    let (across, down) = area.get_pixel_range();
    let inside = Taken { low: (corner.0, down.start), high: (across.end, corner.1) };
    let mut room = LabelRoom { inside, taken, lines };
    for point in points {
        let (at, style) = ((point.time.mean, point.error.mean), pen.text(TICK_TEXT));
        let title = shortened(&point.title);
        let (width, height) = area.estimate_text_size(&title, &style)?;
        let place = chart.backend_coord(&at);
        // Viewers of an SVG give a line more height than its letters have.
        let (lead, height) = (pen.at(2.0), height as i32 + pen.at(5.0));
        let ((right, down), spot) = free_spot(place, [width as i32, height], pen, &room);
        let shift = (right, down + lead);
        room.taken.push(spot);
        // A name that found no room beside its dot is tied to it.
        if let Some(end) = spot.far_from(place, pen.at(2.5 * radius)) {
            let [dot, gap] = TIE_DASH.map(|units| pen.px(units));
            let ends = vec![(0, 0), (end.0 - place.0, end.1 - place.1)];
            let tie = DashedPathElement::new(ends, dot, gap, pen.line(TIE, 1.0));
            chart.draw_series(std::iter::once(EmptyElement::at(at) + tie))?;
            room.lines.extend(along([place, end]));
        }
        let label = Text::new(title, shift, style.pos(Pos::new(HPos::Left, VPos::Top)));
        chart.draw_series(std::iter::once(EmptyElement::at(at) + label))?;
    }
    Ok(())
}
