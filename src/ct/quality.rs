//! `import.html`: whether an import may be trusted, on one page without scripts: slices with contours, the surface
//! coloured by its distance from the mask, how volumes change, the tree with its generations, the motion.

use glam::DVec3;
use maud::{DOCTYPE, Markup, PreEscaped, html};

use super::motion_field::VolumeChange;
use super::quality_picture::{DrawnLine, PictureFrame, PictureView, contour, histogram, lines, slice, surface};
use crate::airway::Anatomy;
use crate::base::{Result, Volume};

const STYLE: &str = "
body{font:15px/1.45 system-ui,'DejaVu Sans',sans-serif;color:#1a1a1a;margin:2rem auto;max-width:1240px;padding:0 1.2rem}
h1{font-size:1.6rem;margin-bottom:.2rem}h2{margin-top:2.4rem;border-bottom:1px solid #ddd;padding-bottom:.2rem}
table{border-collapse:collapse;font-size:.9rem}td{padding:.25rem .7rem;vertical-align:top}td:first-child{color:#555;white-space:nowrap}
figure{margin:.8rem .8rem .8rem 0;display:inline-block;vertical-align:top}figcaption{color:#555;font-size:.88rem;max-width:420px}
.muted{color:#666}
";
/// Colours of generations 0, 1, 2, ...; the last holds for all beyond.
const GENERATIONS: [&str; 7] = ["#222222", "#1f4e8c", "#1d8a8a", "#3c9a3c", "#c9a227", "#c9621f", "#a8324a"];
/// Width of a picture.
const PICTURE_PX: f64 = 380.0;
/// Every so many points of the centreline has a motion arrow.
const ARROWS_EACH: usize = 3;

/// A scan in one breath hold, for the slices.
pub struct BreathHold<'a> {
    /// What it is called on the page.
    pub name: &'a str,
    /// The scan.
    pub scan: &'a Volume<i16>,
    /// The airway's vertices in it.
    pub vertices: &'a [DVec3],
}

/// All that the page shows.
pub struct QualityPage<'a> {
    /// Name of the case.
    pub case_id: &'a str,
    /// Sentences for people: what was measured, in order.
    pub facts: &'a [(&'static str, String)],
    /// The scans; none where a case was made without.
    pub scans: &'a [BreathHold<'a>],
    /// The airway.
    pub anatomy: &'a Anatomy,
    /// Distance in mm of each vertex from what the surface was made of.
    pub residual_mm: &'a [f64],
    /// The distance in mm that is red.
    pub red_mm: f64,
    /// What the distance is.
    pub residual_words: &'a str,
    /// How volumes change in the lungs; none without a field.
    pub change: Option<&'a VolumeChange>,
}

impl QualityPage<'_> {
    /// The page.
    pub fn html(&self) -> Result<String> {
        let anatomy = self.anatomy;
        let slices = self.slices()?;
        let shown: Vec<f64> = self.residual_mm.iter().map(|r| r / self.red_mm).collect();
        let mut shaded = Vec::new();
        for view in [PictureView::Front, PictureView::Left] {
            let frame = PictureFrame::around(view, anatomy.inspiration.vertices.iter().copied(), 4.0);
            shaded.push(frame.svg(&surface(&frame, &anatomy.inspiration, &shown)?, PICTURE_PX));
        }
        let page = html! {
            (DOCTYPE)
            html lang="en" {
                head {
                    meta charset="utf-8";
                    meta name="viewport" content="width=device-width, initial-scale=1";
                    link rel="icon" href="data:,";
                    title { "import of " (self.case_id) }
                    style { (PreEscaped(STYLE)) }
                }
                body {
                    h1 { "Import of " (self.case_id) }
                    p.muted { "Look before you film: contours lie on the dark lumen, the surface is blue, nothing folds." }
                    table { @for (what, words) in self.facts { tr { td { (what) } td { (words) } } } }
                    @if !slices.is_empty() {
                        h2 { "Slices" }
                        p.muted { "Through the carina and the middle of the tree; the surface where it crosses them in red." }
                        @for (caption, picture) in &slices { (figure(picture, caption)) }
                    }
                    h2 { "Surface" }
                    p.muted { (self.residual_words) ": blue 0, grey " (format!("{:.2}", 0.5 * self.red_mm)) ", red "
                        (format!("{:.2}", self.red_mm)) " mm and more." }
                    @for picture in &shaded { (figure(picture, "")) }
                    @if let Some(change) = self.change {
                        h2 { "Volume change in the lungs" }
                        (figure(&histogram(&change.histogram, 0.0, 2.0), &format!(
                            "Volume at expiration over volume at inspiration, {} voxels: least {:.2}, median {:.2}, greatest {:.2}; \
                             {} fold.", change.voxels, change.least, change.median, change.greatest, change.folded)))
                    }
                    h2 { "Tree and motion" }
                    (figure(&self.tree(), "Centreline by generation: black 0, blue 1, then teal, green, yellow, orange, red."))
                    (figure(&self.motion(PictureView::Front), "Motion from inspiration (grey) to expiration, from the front."))
                    (figure(&self.motion(PictureView::Left), "The same from the left."))
                }
            }
        };
        Ok(page.into_string())
    }

    fn slices(&self) -> Result<Vec<(String, String)>> {
        let points = &self.anatomy.centerline.points;
        let carina = self.anatomy.centerline.carina_mm().unwrap_or_default();
        let middle = points.iter().map(|p| p.position_mm).sum::<DVec3>() / points.len().max(1) as f64;
        let mut found = Vec::new();
        for hold in self.scans {
            for (view, deep) in
                [(PictureView::Front, carina.y), (PictureView::Left, -carina.x), (PictureView::Feet, middle.z)]
            {
                let frame = PictureFrame::around(view, hold.vertices.iter().copied(), 25.0);
                let content = slice(&frame, hold.scan, deep)?
                    + &contour(&frame, hold.vertices, &self.anatomy.inspiration.faces, deep, "#e8352b");
                found.push((format!("{}, {}", hold.name, view.name()), frame.svg(&content, PICTURE_PX)));
            }
        }
        Ok(found)
    }

    fn tree(&self) -> String {
        let points = &self.anatomy.centerline.points;
        let frame = PictureFrame::around(PictureView::Front, points.iter().map(|p| p.position_mm), 12.0);
        let all: Vec<DrawnLine> = points
            .iter()
            .filter_map(|p| {
                Some(DrawnLine {
                    from: points[p.parent? as usize].position_mm,
                    to: p.position_mm,
                    colour: GENERATIONS[(p.generation as usize).min(GENERATIONS.len() - 1)].to_owned(),
                    width_mm: (0.8 * p.radius_mm).max(0.6),
                })
            })
            .collect();
        frame.svg(&lines(&frame, &all), PICTURE_PX)
    }

    fn motion(&self, view: PictureView) -> String {
        let points = &self.anatomy.centerline.points;
        let there = &self.anatomy.centerline_expiration;
        let frame = PictureFrame::around(view, points.iter().map(|p| p.position_mm).chain(there.iter().copied()), 8.0);
        let rest = points.iter().filter_map(|p| {
            let from = points[p.parent? as usize].position_mm;
            Some(DrawnLine { from, to: p.position_mm, colour: "#bbbbbb".to_owned(), width_mm: 1.0 })
        });
        let arrows = points.iter().zip(there).step_by(ARROWS_EACH).map(|(p, to)| DrawnLine {
            from: p.position_mm,
            to: *to,
            colour: "#c2382e".to_owned(),
            width_mm: 0.5,
        });
        frame.svg(&lines(&frame, &rest.chain(arrows).collect::<Vec<_>>()), PICTURE_PX)
    }
}

fn figure(picture: &str, caption: &str) -> Markup {
    html! { figure { (PreEscaped(picture)) @if !caption.is_empty() { figcaption { (caption) } } } }
}
