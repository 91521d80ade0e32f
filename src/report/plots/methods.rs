//! Methods compared: bars with intervals per metric, and error against run time.

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::canvas::{Area, Drawn, Figure, GRID, INK, Pen, color_of, legend, tick};
use crate::report::summary::MethodSummary;
use crate::report::table::{arrow, show};
use crate::score::statistics::MeanInterval;
use crate::score::{Metric, metric, paper_metrics};

struct Bar {
    color: RGBColor,
    place: usize,
    mean: MeanInterval,
}

/// One panel of bars per metric of the paper.
pub struct MethodBars {
    names: Vec<(String, RGBColor)>,
    panels: Vec<(&'static Metric, Vec<Bar>)>,
}

impl MethodBars {
    /// `None` when nothing was scored.
    pub fn new(summaries: &[MethodSummary]) -> Option<Self> {
        let names = summaries.iter().map(|s| (s.method.title.clone(), color_of(&s.method.id))).collect();
        let bars = |m: &Metric| -> Vec<Bar> {
            let bar = |(place, s): (usize, &MethodSummary)| {
                s.mean(m.id).map(|mean| Bar { color: color_of(&s.method.id), place, mean })
            };
            summaries.iter().enumerate().filter_map(bar).collect()
        };
        let panels: Vec<_> = paper_metrics().map(|m| (m, bars(m))).filter(|(_, bars)| !bars.is_empty()).collect();
        (!panels.is_empty()).then_some(MethodBars { names, panels })
    }
}

impl Figure for MethodBars {
    fn size(&self) -> (u32, u32) {
        (1240, 40 + 250 * self.panels.len().div_ceil(5) as u32)
    }

    fn draw<DB: DrawingBackend>(&self, page: &Area<DB>, pen: Pen) -> Drawn<(), DB> {
        let rest = legend(page, pen, &self.names)?;
        let areas = rest.split_evenly((self.panels.len().div_ceil(5), 5));
        for (area, (m, bars)) in areas.iter().zip(&self.panels) {
            draw_bars(area, pen, m, bars, self.names.len())?;
        }
        Ok(())
    }
}

fn draw_bars<DB: DrawingBackend>(area: &Area<DB>, pen: Pen, m: &Metric, bars: &[Bar], places: usize) -> Drawn<(), DB> {
    let top_of = |b: &Bar| b.mean.interval.map_or(b.mean.mean, |[_, high]| high.max(b.mean.mean));
    let low_of = |b: &Bar| b.mean.interval.map_or(b.mean.mean, |[low, _]| low.min(b.mean.mean));
    let low = bars.iter().map(low_of).fold(0.0, f64::min);
    let high = bars.iter().map(top_of).fold(0.0, f64::max).max(1e-9);
    let head = 0.16 * (high - low);
    let mut chart = ChartBuilder::on(area)
        .caption(format!("{} {}", m.heading(), arrow(m)), pen.bold(13.0))
        .margin(pen.px(6.0))
        .x_label_area_size(pen.px(8.0))
        .y_label_area_size(pen.px(44.0))
        .build_cartesian_2d(-0.6..places as f64 - 0.4, (if low < 0.0 { low - head / 2.0 } else { 0.0 })..high + head)?;
    chart
        .configure_mesh()
        .disable_x_mesh()
        .light_line_style(TRANSPARENT)
        .bold_line_style(pen.line(GRID, 1.0))
        .axis_style(pen.line(INK, 1.0))
        .label_style(pen.text(11.0))
        .y_labels(6)
        .x_labels(0)
        .y_label_formatter(&|v| tick(*v))
        .draw()?;
    for bar in bars {
        let (x, mean) = (bar.place as f64, bar.mean.mean);
        chart.draw_series(std::iter::once(Rectangle::new([(x - 0.38, 0.0), (x + 0.38, mean)], bar.color.filled())))?;
        if let Some([low, high]) = bar.mean.interval {
            let cap = |y: f64| PathElement::new(vec![(x - 0.12, y), (x + 0.12, y)], pen.line(INK, 1.3));
            let stem = PathElement::new(vec![(x, low), (x, high)], pen.line(INK, 1.3));
            chart.draw_series([stem, cap(low), cap(high)])?;
        }
        let style = pen.text(10.0).pos(Pos::new(HPos::Center, VPos::Bottom));
        let value = m.format(mean);
        chart.draw_series(std::iter::once(Text::new(value, (x, top_of(bar).max(0.0) + 0.03 * (high - low)), style)))?;
    }
    Ok(())
}

/// Colour, time and error of a method.
type MethodPoint = (RGBColor, MeanInterval, MeanInterval);

/// Time per frame against an error, both axes logarithmic.
pub struct ErrorAgainstTime {
    names: Vec<(String, RGBColor)>,
    panels: Vec<(&'static Metric, Vec<MethodPoint>)>,
}

impl ErrorAgainstTime {
    /// `None` when no method has both a time and an error.
    pub fn new(summaries: &[MethodSummary]) -> Option<Self> {
        let mut panels = Vec::new();
        for m in ["depth_rmse_mm", "target_error_mm", "phase_mae"].into_iter().filter_map(metric) {
            let point = |s: &MethodSummary| {
                let (time, error) = (s.mean("time_per_frame_s")?, s.mean(m.id)?);
                (time.mean > 0.0 && error.mean > 0.0).then(|| (color_of(&s.method.id), time, error))
            };
            let points: Vec<_> = summaries.iter().filter_map(point).collect();
            if !points.is_empty() {
                panels.push((m, points));
            }
        }
        let names = summaries.iter().map(|s| (s.method.title.clone(), color_of(&s.method.id))).collect();
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

/// 1, 2 and 5 times the powers of ten in the range.
pub(super) fn log_ticks([low, high]: [f64; 2]) -> Vec<f64> {
    let decades = low.log10().floor() as i32..=high.log10().ceil() as i32;
    let ticks = decades.flat_map(|d| [1.0, 2.0, 5.0].map(|step| step * 10f64.powi(d)));
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
        let style = pen.text(10.0).pos(Pos::new(HPos::Left, VPos::Bottom));
        let label = Text::new(show(m, at.1), (pen.at(8.0), pen.at(-5.0)), style);
        chart.draw_series(std::iter::once(EmptyElement::at(at) + label))?;
    }
    Ok(())
}
