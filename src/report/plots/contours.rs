//! Contours of the lumen at the final frame, truth and every method with a surface, one panel per case.

use plotters::prelude::*;

use super::canvas::{
    Area, Drawn, Figure, LinearChart, PANEL_MARGIN, PANEL_RIGHT, PanelAxes, Pen, Stroke, TRUTH, X_ROOM, Y_ROOM, chart,
    clip, draw_line, legend,
};
use crate::report::palette::Palette;
use crate::report::run::Run;
use crate::score::contour::ContourOverlay;

/// Half side of a panel at most, in half extents of the true contour: a predicted contour far away would otherwise
/// shrink the truth to a dot.
const MAX_EXTENT: f64 = 2.2;

/// Height of a panel's title and the room around it, in units.
const TITLE_ROOM: f64 = 26.0;

struct ContourPanel {
    title: String,
    overlays: Vec<(Stroke, ContourOverlay)>,
}

/// The grid of panels.
pub struct ContourGrid {
    panels: Vec<ContourPanel>,
    names: Vec<(String, Stroke)>,
}

impl ContourGrid {
    /// `None` when there is no contour to show.
    pub fn new(run: &Run, palette: &Palette) -> Option<Self> {
        let mut names = vec![("Truth".to_owned(), Stroke::TRUTH)];
        let mut panels = Vec::new();
        for case in &run.cases {
            let mut overlays = Vec::new();
            for (method, _, score) in run.shown(&case.id) {
                if let Some(overlay) = &score.overlay {
                    let stroke = Stroke::from(palette.style(&method.id));
                    let name = (method.title.clone(), stroke);
                    if !names.contains(&name) {
                        names.push(name);
                    }
                    overlays.push((stroke, overlay.clone()));
                }
            }
            if !overlays.is_empty() {
                panels.push(ContourPanel { title: case.id.clone(), overlays });
            }
        }
        (!panels.is_empty()).then_some(ContourGrid { panels, names })
    }

    fn columns(&self) -> usize {
        self.panels.len().clamp(1, 3)
    }

    fn rows(&self) -> usize {
        self.panels.len().div_ceil(self.columns())
    }
}

impl Figure for ContourGrid {
    fn size(&self) -> (u32, u32) {
        (if self.columns() == 1 { 520 } else { 400 * self.columns() as u32 }, 60 + 400 * self.rows() as u32)
    }

    fn draw<DB: DrawingBackend>(&self, page: &Area<DB>, pen: Pen) -> Drawn<(), DB> {
        let rest = legend(page, pen, &self.names)?;
        let areas = rest.split_evenly((self.rows(), self.columns()));
        for (area, panel) in areas.iter().zip(&self.panels) {
            draw_panel(area, pen, panel)?;
        }
        Ok(())
    }
}

/// Flips y: image rows grow downwards, the plot's axis upwards.
fn upright(point: [f64; 2]) -> [f64; 2] {
    [point[0], -point[1]]
}

/// Centre and half side of the square that a panel shows.
fn window(panel: &ContourPanel) -> ([f64; 2], f64) {
    let bounds = |points: &mut dyn Iterator<Item = [f64; 2]>| {
        points.fold(([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]), |(low, high), p| {
            ([low[0].min(p[0]), low[1].min(p[1])], [high[0].max(p[0]), high[1].max(p[1])])
        })
    };
    let truth = &panel.overlays[0].1.truth;
    let (low, high) = bounds(&mut truth.iter().map(|&p| upright(p)));
    let centre = [(low[0] + high[0]) / 2.0, (low[1] + high[1]) / 2.0];
    let half = ((high[0] - low[0]).max(high[1] - low[1]) / 2.0).max(0.5);
    let reach = panel
        .overlays
        .iter()
        .flat_map(|(_, o)| o.predicted.iter().map(|&p| upright(p)))
        .map(|p| (p[0] - centre[0]).abs().max((p[1] - centre[1]).abs()))
        .fold(half, f64::max);
    (centre, 1.12 * reach.min(MAX_EXTENT * half))
}

fn draw_panel<DB: DrawingBackend>(area: &Area<DB>, pen: Pen, panel: &ContourPanel) -> Drawn<(), DB> {
    let (centre, half) = window(panel);
    // The label areas are wider than high: equal scales need unequal ranges.
    let (width, height) = area.dim_in_pixel();
    let plot_width = (width as i32 - pen.at(Y_ROOM + PANEL_MARGIN + PANEL_RIGHT)).max(1) as f64;
    let plot_height = (height as i32 - pen.at(X_ROOM + 2.0 * PANEL_MARGIN + TITLE_ROOM)).max(1) as f64;
    let unit = 2.0 * half / plot_width.min(plot_height);
    let (half_x, half_y) = (unit * plot_width / 2.0, unit * plot_height / 2.0);
    let (low, high) = ([centre[0] - half_x, centre[1] - half_y], [centre[0] + half_x, centre[1] + half_y]);
    let axes = PanelAxes {
        title: &panel.title,
        x: "x in the camera's plane [mm]",
        y: "y [mm]",
        x_range: [low[0], high[0]],
        y_range: [low[1], high[1]],
    };
    let mut panel_chart = chart(area, pen, &axes)?;
    outline(&mut panel_chart, &panel.overlays[0].1.truth, true, (pen, Stroke::TRUTH, 4.0), low, high)?;
    for (stroke, overlay) in &panel.overlays {
        let pen = (pen, *stroke, 1.8);
        outline(&mut panel_chart, &overlay.predicted, overlay.predicted_closed, pen, low, high)?;
    }
    let inside = |p: [f64; 2]| (0..2).all(|axis| (low[axis]..=high[axis]).contains(&p[axis]));
    for (stroke, overlay) in &panel.overlays {
        let target = upright(overlay.target_predicted);
        if inside(target) {
            let dot = Circle::new((target[0], target[1]), pen.px(4.0), stroke.color.filled());
            panel_chart.draw_series(std::iter::once(dot))?;
        }
    }
    let target = upright(panel.overlays[0].1.target_truth);
    panel_chart.draw_series(std::iter::once(Cross::new((target[0], target[1]), pen.px(6.0), pen.line(TRUTH, 2.0))))?;
    if inside([0.0, 0.0]) {
        panel_chart.draw_series(std::iter::once(TriangleMarker::new((0.0, 0.0), pen.px(5.0), TRUTH.filled())))?;
    }
    Ok(())
}

fn outline<DB: DrawingBackend>(
    chart: &mut LinearChart<'_, DB>,
    points: &[[f64; 2]],
    closed: bool,
    (pen, stroke, width): (Pen, Stroke, f64),
    low: [f64; 2],
    high: [f64; 2],
) -> Drawn<(), DB> {
    let closing = points.last().zip(points.first()).filter(|_| closed).map(|(a, b)| (*a, *b));
    let segments = points.windows(2).map(|w| (w[0], w[1])).chain(closing);
    let visible = segments.filter_map(|(a, b)| clip(upright(a), upright(b), low, high));
    // Neighbouring visible pieces are one stroke, so that joints are round and files small.
    let mut strokes: Vec<Vec<(f64, f64)>> = Vec::new();
    for (a, b) in visible {
        match strokes.last_mut().filter(|s| s.last() == Some(&(a[0], a[1]))) {
            Some(stroke) => stroke.push((b[0], b[1])),
            None => strokes.push(vec![(a[0], a[1]), (b[0], b[1])]),
        }
    }
    strokes.iter().try_for_each(|points| draw_line(chart, pen, stroke, width, points))
}
