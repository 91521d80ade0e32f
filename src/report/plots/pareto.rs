//! Cost against error, one panel per subject, both axes logarithmic; the front as a line, the default as a ring. A
//! point without any error (a reference) stands on the lower edge.

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::canvas::{AXIS_TEXT, Area, Drawn, Figure, GRID, INK, Pen, Stroke, TICK_TEXT, TITLE_TEXT, X_ROOM, legend};
use super::labels::{LabelRoom, Taken, along, free_spot};
use super::methods::{log_range, log_ticks};
use crate::report::pareto_chart::{ParetoChart, SettingRole};

/// Okabe and Ito's palette and one more, in the order of the modes.
const COLORS: [RGBColor; 8] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
    RGBColor(140, 140, 140),
    RGBColor(120, 94, 240),
];
/// The line of the front.
const FRONT: RGBColor = RGBColor(180, 180, 180);
/// Room for the ticks of the errors, which have many digits, in units.
const Y_ROOM: f64 = 84.0;
/// Most panels beside each other.
const COLUMNS: usize = 3;

struct Dot {
    at: (f64, f64),
    color: RGBColor,
    label: String,
    role: SettingRole,
    on_front: bool,
}

/// The figure.
pub struct ParetoPlot<'a> {
    chart: &'a ParetoChart,
    names: Vec<(String, Stroke)>,
    panels: Vec<(&'a str, Vec<Dot>)>,
}

impl<'a> ParetoPlot<'a> {
    /// `None` where no point can stand on logarithmic axes. `front`: one per point.
    pub fn new(chart: &'a ParetoChart, front: &[bool]) -> Option<Self> {
        let plain = |color: RGBColor| Stroke { color, dash: None };
        let mut names: Vec<(String, Stroke)> = Vec::new();
        let mut panels: Vec<(&str, Vec<Dot>)> = Vec::new();
        for (point, &on_front) in chart.points.iter().zip(front) {
            if !(point.cost > 0.0 && point.error >= 0.0) {
                continue;
            }
            let color = match names.iter().find(|(name, _)| *name == point.mode) {
                Some((_, stroke)) => stroke.color,
                None => {
                    let color = COLORS[names.len() % COLORS.len()];
                    names.push((point.mode.clone(), plain(color)));
                    color
                }
            };
            let at = (point.cost, point.error);
            let dot = Dot { at, color, label: point.setting.clone(), role: point.role, on_front };
            match panels.iter_mut().find(|(subject, _)| *subject == point.subject) {
                Some((_, dots)) => dots.push(dot),
                None => panels.push((&point.subject, vec![dot])),
            }
        }
        names.push(("front".into(), plain(FRONT)));
        names.push(("ring: default".into(), plain(INK)));
        panels.retain(|(_, dots)| dots.iter().any(|dot| dot.at.1 > 0.0));
        if panels.iter().flat_map(|(_, dots)| dots).any(|dot| dot.at.1 == 0.0) {
            names.push(("lower edge: the reference itself".into(), plain(WHITE)));
        }
        (!panels.is_empty()).then_some(ParetoPlot { chart, names, panels })
    }
}

impl Figure for ParetoPlot<'_> {
    fn size(&self) -> (u32, u32) {
        let columns = self.panels.len().clamp(2, COLUMNS) as u32;
        (440 * columns, 60 + 380 * self.panels.len().div_ceil(COLUMNS) as u32)
    }

    fn draw<DB: DrawingBackend>(&self, page: &Area<DB>, pen: Pen) -> Drawn<(), DB> {
        let rest = legend(page, pen, &self.names)?;
        let columns = self.panels.len().min(COLUMNS);
        let areas = rest.split_evenly((self.panels.len().div_ceil(COLUMNS), columns));
        for (area, (subject, dots)) in areas.iter().zip(&self.panels) {
            draw_panel(area, pen, self.chart, subject, dots)?;
        }
        Ok(())
    }
}

/// A tick of a logarithmic axis: all its digits, or a power of ten.
fn short(value: &f64) -> String {
    if *value >= 1e-3 && *value < 1e5 { format!("{value}") } else { format!("{value:.0e}") }
}

fn draw_panel<DB: DrawingBackend>(
    area: &Area<DB>,
    pen: Pen,
    words: &ParetoChart,
    subject: &str,
    dots: &[Dot],
) -> Drawn<(), DB> {
    let x = log_range(dots.iter().map(|d| d.at.0));
    let y = log_range(dots.iter().map(|d| d.at.1));
    let mut chart = ChartBuilder::on(area)
        .caption(subject, pen.bold(TITLE_TEXT))
        .margin(pen.px(8.0))
        .margin_right(pen.px(24.0))
        .x_label_area_size(pen.px(X_ROOM))
        .y_label_area_size(pen.px(Y_ROOM))
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
        .x_label_formatter(&short)
        .y_label_formatter(&short)
        .x_desc(words.cost)
        .y_desc(words.error)
        .draw()?;
    let place = |d: &Dot| (d.at.0, if d.at.1 > 0.0 { d.at.1 } else { y[0] });
    let mut front: Vec<(f64, f64)> = dots.iter().filter(|d| d.on_front).map(place).collect();
    front.sort_by(|a, b| a.0.total_cmp(&b.0));
    let corners: Vec<(i32, i32)> = front.iter().map(|at| chart.backend_coord(at)).collect();
    let lines = corners.windows(2).flat_map(|ends| along([ends[0], ends[1]])).collect();
    chart.draw_series(std::iter::once(PathElement::new(front, pen.line(FRONT, 2.5))))?;
    let mut taken: Vec<Taken> = Vec::new();
    let floor = chart.backend_coord(&(x[0], y[0])).1;
    let (across, down) = area.get_pixel_range();
    let inside = Taken { low: (across.start, down.start), high: (across.end, floor) };
    for dot in dots {
        let at = place(dot);
        chart.draw_series(std::iter::once(Circle::new(at, pen.px(4.5), dot.color.filled())))?;
        if dot.role == SettingRole::Default {
            chart.draw_series(std::iter::once(Circle::new(at, pen.px(9.0), pen.line(INK, 2.0))))?;
        }
        let (x, y) = chart.backend_coord(&at);
        taken.push(Taken::around((x, y), pen.at(if dot.role == SettingRole::Default { 9.0 } else { 4.5 })));
    }
    let mut room = LabelRoom { inside, taken, lines };
    for dot in dots {
        let (at, style) = (place(dot), pen.text(TICK_TEXT));
        let (width, height) = area.estimate_text_size(&dot.label, &style)?;
        let (x, y) = chart.backend_coord(&at);
        let (shift, spot) = free_spot((x, y), [width as i32, height as i32], pen, &room);
        room.taken.push(spot);
        let label = Text::new(dot.label.clone(), shift, style.pos(Pos::new(HPos::Left, VPos::Top)));
        chart.draw_series(std::iter::once(EmptyElement::at(at) + label))?;
    }
    Ok(())
}
