//! Curves over time: phase trajectories of all cases, and the errors of every frame of one case.

use plotters::prelude::*;

use super::canvas::{
    Area, Drawn, Figure, LinearChart, PanelAxes, Pen, Stroke, chart, chart_with_ticks, draw_line, legend, range_of,
    tick,
};
use super::methods::{log_range, log_ticks};
use crate::report::palette::Palette;
use crate::report::run::{MethodInfo, Run};
use crate::score::{CellScore, metric};

/// A curve without NaN.
type Curve = (Stroke, Vec<(f64, f64)>);

fn draw_curves<DB: DrawingBackend>(
    chart: &mut LinearChart<'_, DB>,
    pen: Pen,
    curves: &[Curve],
    width: f64,
) -> Drawn<(), DB> {
    curves.iter().try_for_each(|(stroke, points)| draw_line(chart, pen, *stroke, width, points))
}

/// What is shown of a case, of the cells whose frames are known: those of a kept report are not.
fn with_frames<'a>(run: &'a Run, case_id: &str) -> Vec<(&'a MethodInfo, &'a CellScore)> {
    let shown = run.shown(case_id).into_iter().map(|(method, _, score)| (method, score));
    shown.filter(|(_, score)| !score.frame_scores.is_empty()).collect()
}

fn true_phase(score: &CellScore) -> Curve {
    (Stroke::TRUTH, score.frame_scores.iter().map(|f| (f.time_s, f.phase)).collect())
}

fn predicted_phase(stroke: Stroke, score: &CellScore) -> Curve {
    let points = score.frame_scores.iter().filter_map(|f| f.phase_predicted.map(|p| (f.time_s, p)));
    (stroke, points.collect())
}

/// Phase against time for every case, truth in black.
pub struct PhaseGrid {
    panels: Vec<(String, Vec<Curve>)>,
    names: Vec<(String, Stroke)>,
}

impl PhaseGrid {
    /// `None` when no method has a phase.
    pub fn new(run: &Run, palette: &Palette) -> Option<Self> {
        let mut names = vec![("Truth".to_owned(), Stroke::TRUTH)];
        let mut panels = Vec::new();
        for case in &run.cases {
            let shown = with_frames(run, &case.id);
            let mut curves: Vec<Curve> = shown.iter().take(1).map(|(_, score)| true_phase(score)).collect();
            for (method, score) in shown {
                let curve = predicted_phase(palette.style(&method.id).into(), score);
                if !curve.1.is_empty() {
                    let name = (method.title.clone(), curve.0);
                    if !names.contains(&name) {
                        names.push(name);
                    }
                    curves.push(curve);
                }
            }
            if !curves.is_empty() {
                panels.push((case.id.clone(), curves));
            }
        }
        (names.len() > 1).then_some(PhaseGrid { panels, names })
    }

    fn columns(&self) -> usize {
        self.panels.len().clamp(1, 3)
    }

    fn rows(&self) -> usize {
        self.panels.len().div_ceil(self.columns())
    }
}

impl Figure for PhaseGrid {
    fn size(&self) -> (u32, u32) {
        (if self.columns() == 1 { 640 } else { 1240 }, 50 + 225 * self.rows() as u32)
    }

    fn draw<DB: DrawingBackend>(&self, page: &Area<DB>, pen: Pen) -> Drawn<(), DB> {
        let rest = legend(page, pen, &self.names)?;
        let low = self.panels.iter().flat_map(|p| &p.1).flat_map(|c| &c.1).map(|p| p.1).fold(0.0, f64::min);
        let high = self.panels.iter().flat_map(|p| &p.1).flat_map(|c| &c.1).map(|p| p.1).fold(1.0, f64::max);
        for (index, (area, (case, curves))) in
            rest.split_evenly((self.rows(), self.columns())).iter().zip(&self.panels).enumerate()
        {
            let end = curves.iter().flat_map(|c| &c.1).map(|p| p.0).fold(0.0, f64::max);
            let bottom = index + self.columns() >= self.panels.len();
            let axes = PanelAxes {
                title: case,
                x: if bottom { "time [s]" } else { "" },
                y: if index % self.columns() == 0 { "breathing phase" } else { "" },
                x_range: [0.0, end.max(1e-3)],
                y_range: [low - 0.03, high + 0.03],
            };
            let mut panel = chart(area, pen, &axes)?;
            draw_curves(&mut panel, pen, &curves[..1], 3.0)?;
            draw_curves(&mut panel, pen, &curves[1..], 1.6)?;
        }
        Ok(())
    }
}

/// Phase, and picture, depth, target and phase error of every frame of one case, one above the other.
pub struct FrameErrors {
    names: Vec<(String, Stroke)>,
    panels: Vec<FramePanel>,
}

/// Curves of one number.
struct FramePanel {
    name: String,
    curves: Vec<Curve>,
    /// Whether its axis is logarithmic: errors in mm span decades, and one bad row would flatten the others.
    is_log: bool,
}

/// Frame-wise metrics with a panel of their own.
const FRAME_METRICS: [&str; 5] = ["psnr_db", "ssim", "depth_rmse_mm", "target_mean_mm", "phase_mae"];
/// What an error in mm is drawn at least at, as on the page: below it is rounding.
const LEAST_MM: f64 = 0.01;
/// Most ticks of a logarithmic axis: there is no room for more labels.
const LOG_TICKS: usize = 6;

impl FrameErrors {
    /// `None` when nothing is known of the case's frames.
    pub fn new(run: &Run, case_id: &str, palette: &Palette) -> Option<Self> {
        let stroke = |method: &str| Stroke::from(palette.style(method));
        let shown = with_frames(run, case_id);
        let (_, first) = shown.first()?;
        let mut names = vec![("Truth".to_owned(), Stroke::TRUTH)];
        names.extend(shown.iter().map(|(m, _)| (m.title.clone(), stroke(&m.id))));
        let mut phases = vec![true_phase(first)];
        phases.extend(shown.iter().map(|(m, s)| predicted_phase(stroke(&m.id), s)).filter(|c| !c.1.is_empty()));
        let mut panels = vec![FramePanel { name: "breathing phase".to_owned(), curves: phases, is_log: false }];
        for id in FRAME_METRICS {
            let curves: Vec<Curve> =
                shown.iter().map(|(m, s)| (stroke(&m.id), s.series(id))).filter(|c| !c.1.is_empty()).collect();
            if let (Some(m), false) = (metric(id), curves.is_empty()) {
                let name = if id == "phase_mae" { "phase error".into() } else { m.heading() };
                panels.push(FramePanel { name, curves, is_log: m.unit == "mm" });
            }
        }
        Some(FrameErrors { names, panels })
    }
}

/// Draws curves of errors in mm by their logarithm.
fn draw_log_panel<DB: DrawingBackend>(area: &Area<DB>, pen: Pen, axes: &PanelAxes, curves: &[Curve]) -> Drawn<(), DB> {
    let values = || curves.iter().flat_map(|(_, points)| points).map(|(_, mm)| *mm);
    let is_cut = values().any(|mm| mm < LEAST_MM);
    let range = log_range(values().map(|mm| mm.max(LEAST_MM)));
    let mut ticks = log_ticks(range);
    if ticks.len() > LOG_TICKS {
        ticks.retain(|mm| (mm.log10() - mm.log10().round()).abs() < 1e-9);
    }
    let is_least = |mm: f64| is_cut && (mm / LEAST_MM - 1.0).abs() < 1e-9;
    let named = |mm: f64| if is_least(mm) { format!("≤ {}", tick(mm)) } else { tick(mm) };
    let ticks: Vec<(f64, String)> = ticks.into_iter().map(|mm| (mm.log10(), named(mm))).collect();
    let drawn: Vec<Curve> = curves
        .iter()
        .map(|(stroke, points)| (*stroke, points.iter().map(|(t, mm)| (*t, mm.max(LEAST_MM).log10())).collect()))
        .collect();
    let axes = PanelAxes { y_range: range.map(f64::log10), ..*axes };
    let mut panel = chart_with_ticks(area, pen, &axes, &ticks)?;
    draw_curves(&mut panel, pen, &drawn, 1.6)
}

impl Figure for FrameErrors {
    fn size(&self) -> (u32, u32) {
        (1240, 60 + 175 * self.panels.len() as u32)
    }

    fn draw<DB: DrawingBackend>(&self, page: &Area<DB>, pen: Pen) -> Drawn<(), DB> {
        let rest = legend(page, pen, &self.names)?;
        let end = self.panels.iter().flat_map(|p| &p.curves).flat_map(|c| &c.1).map(|p| p.0).fold(0.0, f64::max);
        for (index, (area, FramePanel { name, curves, is_log })) in
            rest.split_evenly((self.panels.len(), 1)).iter().zip(&self.panels).enumerate()
        {
            let axes = PanelAxes {
                title: "",
                x: if index + 1 == self.panels.len() { "time [s]" } else { "" },
                y: name,
                x_range: [0.0, end.max(1e-3)],
                y_range: range_of(curves.iter().flat_map(|c| &c.1).map(|p| p.1)),
            };
            if *is_log {
                draw_log_panel(area, pen, &axes, curves)?;
                continue;
            }
            let mut panel = chart(area, pen, &axes)?;
            let thick = usize::from(index == 0);
            draw_curves(&mut panel, pen, &curves[..thick], 3.0)?;
            draw_curves(&mut panel, pen, &curves[thick..], 1.6)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::Outcome;
    use crate::report::report_tests::sample_run;

    /// A merge with a kept report has the truth of the rows whose frames it has, and names no others.
    #[test]
    fn rows_without_frames_have_no_part_in_curves() {
        let folder = tempfile::tempdir().unwrap();
        let mut run = sample_run(folder.path(), 48, 6);
        let first = run.shown("case1")[0].0.title.clone();
        let kept = run.methods[0].id.clone();
        for cell in run.cells.iter_mut().filter(|cell| cell.method == kept) {
            let Outcome::Scored(score) = &mut cell.outcome else { continue };
            score.frame_scores.clear();
        }
        let palette = Palette::of(&run.methods);
        let phases = PhaseGrid::new(&run, &palette).unwrap();
        let errors = FrameErrors::new(&run, "case1", &palette).unwrap();
        assert_eq!(run.methods[0].title, first);
        for (names, truth) in [(&phases.names, &phases.panels[0].1[0]), (&errors.names, &errors.panels[0].curves[0])] {
            assert!(
                names[0].0 == "Truth" && names.iter().all(|(name, _)| *name != first) && names.len() > 2,
                "{first}"
            );
            assert_eq!(truth.1.len(), 6);
        }
        run.cells.iter_mut().for_each(|cell| {
            if let Outcome::Scored(score) = &mut cell.outcome {
                score.frame_scores.clear();
            }
        });
        assert!(PhaseGrid::new(&run, &palette).is_none() && FrameErrors::new(&run, "case1", &palette).is_none());
    }
}
