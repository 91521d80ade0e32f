//! Page, pens and colours: one style for all plots, as SVG and as PNG.

use std::error::Error as StdError;
use std::sync::Once;

use plotters::chart::{ChartBuilder, ChartContext};
use plotters::coord::Shift;
use plotters::coord::cartesian::Cartesian2d;
use plotters::coord::types::RangedCoordf64;
use plotters::element::DashedPathElement;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use plotters::style::{FontStyle, register_font};

use crate::base::{Error, Image, Result};
use crate::report::palette::RowStyle;

/// Pixels of the PNG for one unit of the SVG.
const PNG_SCALE: f64 = 2.0;

/// Result of a drawing step.
pub type Drawn<T, DB> = std::result::Result<T, DrawingAreaErrorKind<<DB as DrawingBackend>::ErrorType>>;
/// A panel to draw in.
pub type Area<DB> = DrawingArea<DB, Shift>;
/// A panel with two linear axes.
pub type LinearChart<'a, DB> = ChartContext<'a, DB, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

/// Text and axes.
pub const INK: RGBColor = RGBColor(26, 26, 26);
/// Grid lines.
pub const GRID: RGBColor = RGBColor(226, 226, 226);
/// Truth in every plot.
pub const TRUTH: RGBColor = RGBColor(0, 0, 0);

/// A line's look in a plot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stroke {
    /// Colour.
    pub color: RGBColor,
    /// Lengths of dash and gap in units; `None`: unbroken.
    pub dash: Option<[u8; 2]>,
}

impl Stroke {
    /// Truth in every plot.
    pub const TRUTH: Stroke = Stroke { color: TRUTH, dash: None };
}

impl From<RowStyle> for Stroke {
    fn from(style: RowStyle) -> Self {
        let [red, green, blue] = style.color;
        Stroke { color: RGBColor(red, green, blue), dash: style.dash }
    }
}

/// Heights of text in units, of which a letter's body is 1 / 1.24: 11 px for the smallest on a page that is not zoomed.
pub const TICK_TEXT: f64 = 13.6;
/// Axes, names in a legend.
pub const AXIS_TEXT: f64 = 14.5;
/// Titles of panels, in bold.
pub const TITLE_TEXT: f64 = 15.5;
/// What a panel leaves for the words and ticks of its axes, in units: below where the axis has words, below where it has
/// none, at the left with words and without.
pub const X_ROOM: f64 = 46.0;
const X_ROOM_BARE: f64 = 27.0;
pub const Y_ROOM: f64 = 66.0;
const Y_ROOM_BARE: f64 = 46.0;
/// Room around a panel, and at its right, for the last tick.
pub const PANEL_MARGIN: f64 = 6.0;
pub const PANEL_RIGHT: f64 = 14.0;

/// Sizes in units of the SVG.
#[derive(Clone, Copy, Debug)]
pub struct Pen {
    scale: f64,
}

impl Pen {
    /// For bitmaps that are not scaled.
    pub const PLAIN: Pen = Pen { scale: 1.0 };

    /// A length in backend pixels.
    pub fn px(self, units: f64) -> u32 {
        (units * self.scale).round().max(1.0) as u32
    }

    /// A signed length in backend pixels.
    pub fn at(self, units: f64) -> i32 {
        (units * self.scale).round() as i32
    }

    /// Upright text of a height in units.
    pub fn text(self, units: f64) -> TextStyle<'static> {
        ("sans-serif", units * self.scale).into_font().color(&INK)
    }

    /// Bold text.
    pub fn bold(self, units: f64) -> TextStyle<'static> {
        ("sans-serif", units * self.scale, FontStyle::Bold).into_font().color(&INK)
    }

    /// A line of a width in units.
    pub fn line(self, color: RGBColor, units: f64) -> ShapeStyle {
        color.stroke_width(self.px(units))
    }
}

/// A drawing that any backend can show.
pub trait Figure {
    /// Width and height in units.
    fn size(&self) -> (u32, u32);

    /// Draws everything on a white page.
    fn draw<DB: DrawingBackend>(&self, page: &Area<DB>, pen: Pen) -> Drawn<(), DB>;
}

/// Registers the fonts once: plotters has none of its own.
pub fn prepare_fonts() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        let regular = register_font("sans-serif", FontStyle::Normal, include_bytes!("../font/DejaVuSans.ttf"));
        let bold = register_font("sans-serif", FontStyle::Bold, include_bytes!("../font/DejaVuSans-Bold.ttf"));
        debug_assert!(regular.is_ok() && bold.is_ok());
    });
}

fn failed(error: impl StdError) -> Error {
    Error::input(format!("a plot cannot be drawn: {error}"))
}

/// The figure as SVG text.
pub fn svg(figure: &impl Figure) -> Result<String> {
    prepare_fonts();
    let mut text = String::new();
    {
        let page = SVGBackend::with_string(&mut text, figure.size()).into_drawing_area();
        page.fill(&WHITE).map_err(failed)?;
        figure.draw(&page, Pen { scale: 1.0 }).map_err(failed)?;
        page.present().map_err(failed)?;
    }
    Ok(text)
}

/// The figure as pixels, two for one unit.
pub fn bitmap(figure: &impl Figure) -> Result<Image<u8>> {
    let (width, height) = figure.size();
    let pen = Pen { scale: PNG_SCALE };
    let mut image = Image::filled(pen.px(f64::from(width)) as usize, pen.px(f64::from(height)) as usize, 3, 255u8);
    on_bitmap(&mut image, |page| figure.draw(page, pen))?;
    Ok(image)
}

/// Draws on an RGB image.
pub fn on_bitmap<'a>(
    image: &'a mut Image<u8>,
    draw: impl FnOnce(&Area<BitMapBackend<'a>>) -> Drawn<(), BitMapBackend<'a>>,
) -> Result<()> {
    prepare_fonts();
    let size = (image.width as u32, image.height as u32);
    let page = BitMapBackend::with_buffer(&mut image.data, size).into_drawing_area();
    draw(&page).map_err(failed)?;
    page.present().map_err(failed)
}

/// Draws a line of `width` units through `points`, broken as its dash says.
pub fn draw_line<DB: DrawingBackend>(
    chart: &mut LinearChart<'_, DB>,
    pen: Pen,
    stroke: Stroke,
    width: f64,
    points: &[(f64, f64)],
) -> Drawn<(), DB> {
    let style = pen.line(stroke.color, width);
    match stroke.dash {
        None => {
            let on_page: Vec<(i32, i32)> = points.iter().map(|point| chart.backend_coord(point)).collect();
            let pieces =
                blunt_pieces(&on_page).into_iter().map(|range| PathElement::new(points[range].to_vec(), style));
            chart.draw_series(pieces)?
        }
        Some([dash, gap]) => {
            let [dash, gap] = [dash, gap].map(|units| pen.px(units.into()));
            chart.draw_series(DashedLineSeries::new(points.to_vec(), dash, gap, style))?
        }
    };
    Ok(())
}

/// The pieces of a line between its sharp turns, as ranges of its points; neighbours share a point. Where a wide line
/// turns back, its two edges meet far beyond the turn, and plotters draws all of the way there.
fn blunt_pieces(line: &[(i32, i32)]) -> Vec<std::ops::Range<usize>> {
    let (mut turns, mut last) = (Vec::new(), [0.0f64; 2]);
    for (k, two) in line.windows(2).enumerate() {
        let way = [f64::from(two[1].0 - two[0].0), f64::from(two[1].1 - two[0].1)];
        if way == [0.0; 2] {
            continue;
        }
        // By more than 120 degrees: up to there the edges meet within the width of the line.
        if last[0] * way[0] + last[1] * way[1] < -0.5 * last[0].hypot(last[1]) * way[0].hypot(way[1]) {
            turns.push(k);
        }
        last = way;
    }
    turns.push(line.len().saturating_sub(1));
    let mut start = 0;
    turns.into_iter().map(|end| std::mem::replace(&mut start, end)..(end + 1).min(line.len())).collect()
}

/// A line of names with their colours along the top of `area`, broken where it does not fit; never over data. Returns
/// the rest of the area.
pub fn legend<DB: DrawingBackend>(area: &Area<DB>, pen: Pen, entries: &[(String, Stroke)]) -> Drawn<Area<DB>, DB> {
    let (width, _) = area.dim_in_pixel();
    let style = pen.text(AXIS_TEXT);
    let (margin, swatch, gap, row) = (pen.at(14.0), pen.at(22.0), pen.at(18.0), pen.at(21.0));
    let (mut x, mut y) = (margin, pen.at(12.0));
    let mut places = Vec::new();
    for (name, stroke) in entries {
        let text = area.estimate_text_size(name, &style)?.0 as i32;
        let wanted = swatch + pen.at(6.0) + text;
        if x + wanted > width as i32 - margin && x > margin {
            x = margin;
            y += row;
        }
        places.push((x, y, name, *stroke));
        x += wanted + gap;
    }
    for (x, y, name, stroke) in places {
        let (line, style_of_line) = (vec![(x, y), (x + swatch, y)], pen.line(stroke.color, 3.5));
        match stroke.dash {
            None => area.draw(&PathElement::new(line, style_of_line))?,
            Some([dash, gap]) => {
                let [dash, gap] = [dash, gap].map(|units| pen.px(units.into()));
                area.draw(&DashedPathElement::new(line, dash, gap, style_of_line))?;
            }
        }
        let anchored = style.pos(Pos::new(HPos::Left, VPos::Center));
        area.draw(&Text::new(name.clone(), (x + swatch + pen.at(6.0), y), anchored))?;
    }
    Ok(area.split_vertically(y + row / 2 + pen.at(4.0)).1)
}

/// Words and ranges of one panel.
pub struct PanelAxes<'a> {
    /// Above the panel.
    pub title: &'a str,
    /// Below, with unit.
    pub x: &'a str,
    /// At the left, with unit.
    pub y: &'a str,
    /// Values at the left and right end.
    pub x_range: [f64; 2],
    /// Values at the bottom and the top.
    pub y_range: [f64; 2],
}

/// A panel with title, axes and a light grid.
pub fn chart<'a, DB: DrawingBackend + 'a>(
    area: &Area<DB>,
    pen: Pen,
    axes: &PanelAxes,
) -> Drawn<LinearChart<'a, DB>, DB> {
    bare_chart(area, pen, axes, 6)
}

/// A panel whose upright axis has these ticks: values and what is written beside them.
pub fn chart_with_ticks<'a, DB: DrawingBackend + 'a>(
    area: &Area<DB>,
    pen: Pen,
    axes: &PanelAxes,
    ticks: &[(f64, String)],
) -> Drawn<LinearChart<'a, DB>, DB> {
    let mut chart = bare_chart(area, pen, axes, 0)?;
    let [left, right] = axes.x_range;
    for (value, name) in ticks {
        let line = PathElement::new(vec![(left, *value), (right, *value)], pen.line(GRID, 1.0));
        chart.draw_series(std::iter::once(line))?;
        let style = pen.text(TICK_TEXT).pos(Pos::new(HPos::Right, VPos::Center));
        let words = Text::new(name.clone(), (-pen.at(8.0), 0), style);
        chart.draw_series(std::iter::once(EmptyElement::at((left, *value)) + words))?;
    }
    Ok(chart)
}

/// [`chart`] with about `y_ticks` ticks on its upright axis.
fn bare_chart<'a, DB: DrawingBackend + 'a>(
    area: &Area<DB>,
    pen: Pen,
    axes: &PanelAxes,
    y_ticks: usize,
) -> Drawn<LinearChart<'a, DB>, DB> {
    let mut chart = ChartBuilder::on(area)
        .caption(axes.title, pen.bold(TITLE_TEXT))
        .margin(pen.px(PANEL_MARGIN))
        .margin_right(pen.px(PANEL_RIGHT))
        .x_label_area_size(pen.px(if axes.x.is_empty() { X_ROOM_BARE } else { X_ROOM }))
        .y_label_area_size(pen.px(if axes.y.is_empty() { Y_ROOM_BARE } else { Y_ROOM }))
        .build_cartesian_2d(axes.x_range[0]..axes.x_range[1], axes.y_range[0]..axes.y_range[1])?;
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .bold_line_style(pen.line(GRID, 1.0))
        .axis_style(pen.line(INK, 1.0))
        .label_style(pen.text(TICK_TEXT))
        .axis_desc_style(pen.text(AXIS_TEXT))
        .x_labels(6)
        .y_labels(y_ticks)
        .x_label_formatter(&|v| tick(*v))
        .y_label_formatter(&|v| tick(*v))
        .x_desc(axes.x)
        .y_desc(axes.y)
        .draw()?;
    Ok(chart)
}

/// A tick value without trailing zeros: to a thousandth, or to two digits where it is smaller.
pub fn tick(value: f64) -> String {
    // Ticks of an even axis are sums, so that its 0 may be off by rounding.
    let decimals = if value.abs() < 1e-9 { 3 } else { (1.0 - value.abs().log10().floor()).max(3.0) as usize };
    let text = format!("{value:.decimals$}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".into() } else { text.into() }
}

/// Lowest and highest of finite values, widened by 5 %; [0, 1] when there are none.
pub fn range_of(values: impl Iterator<Item = f64>) -> [f64; 2] {
    let (low, high) = values
        .filter(|v| v.is_finite())
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
    if low > high {
        return [0.0, 1.0];
    }
    let margin = (0.05 * (high - low)).max(1e-3 * high.abs()).max(1e-6);
    [low - margin, high + margin]
}

/// The part of the segment `a`-`b` inside the box `low`-`high` (Liang and Barsky 1984).
pub fn clip(a: [f64; 2], b: [f64; 2], low: [f64; 2], high: [f64; 2]) -> Option<([f64; 2], [f64; 2])> {
    let (mut enter, mut leave) = (0.0f64, 1.0f64);
    for axis in 0..2 {
        let along = b[axis] - a[axis];
        for (toward, room) in [(-along, a[axis] - low[axis]), (along, high[axis] - a[axis])] {
            if toward == 0.0 && room < 0.0 {
                return None;
            } else if toward < 0.0 {
                enter = enter.max(room / toward);
            } else if toward > 0.0 {
                leave = leave.min(room / toward);
            }
        }
    }
    let at = |t: f64| [a[0] + (b[0] - a[0]) * t, a[1] + (b[1] - a[1]) * t];
    (enter <= leave).then(|| (at(enter), at(leave)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn segments_are_cut_at_the_box() {
        let (low, high) = ([0.0, 0.0], [10.0, 10.0]);
        assert_eq!(clip([-5.0, 5.0], [15.0, 5.0], low, high), Some(([0.0, 5.0], [10.0, 5.0])));
        assert_eq!(clip([1.0, 1.0], [2.0, 3.0], low, high), Some(([1.0, 1.0], [2.0, 3.0])));
        assert_eq!(clip([-5.0, 12.0], [15.0, 12.0], low, high), None);
        assert_eq!(clip([-5.0, 4.0], [4.0, -5.0], low, high), None);
    }

    #[test]
    fn a_line_that_turns_back_has_no_spike() {
        let turning = [(0.0, 0.5), (0.5, 0.5), (0.5, 0.5), (0.02, 0.53)];
        let color = RGBColor(255, 0, 0);
        let mut image = Image { width: 400, height: 200, channels: 3, data: vec![255u8; 400 * 200 * 3] };
        let mut turn = 0;
        on_bitmap(&mut image, |page| {
            let axes = PanelAxes { title: "", x: "", y: "", x_range: [0.0, 1.0], y_range: [0.0, 1.0] };
            let mut chart = chart(page, Pen::PLAIN, &axes)?;
            turn = chart.backend_coord(&turning[1]).0 as usize;
            draw_line(&mut chart, Pen::PLAIN, Stroke { color, dash: None }, 6.0, &turning)
        })
        .unwrap();
        let is_red = |pixel: &[u8]| pixel[0] > 200 && pixel[1] < 100;
        let red = image.data.chunks_exact(3).enumerate().filter(|(_, pixel)| is_red(pixel)).map(|(at, _)| at % 400);
        let farthest = red.max().unwrap();
        assert!((turn - 3..turn + 8).contains(&farthest), "{farthest} px, and the turn is at {turn}");
    }

    #[test]
    fn ranges_survive_empty_constant_and_broken_input() {
        assert_eq!(range_of(std::iter::empty()), [0.0, 1.0]);
        assert_eq!(range_of([f64::NAN, f64::INFINITY].into_iter()), [0.0, 1.0]);
        let [low, high] = range_of([3.0, 3.0].into_iter());
        assert!(low < 3.0 && 3.0 < high);
        assert_eq!((tick(0.5), tick(-0.0), tick(20.0)), ("0.5".into(), "0".into(), "20".into()));
        assert_eq!((tick(1e-4), tick(0.001), tick(0.3 - 0.2 - 0.1)), ("0.0001".into(), "0.001".into(), "0".into()));
    }
}
