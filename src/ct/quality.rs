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
td{overflow-wrap:anywhere}svg{max-width:100%;height:auto}
figure{margin:.8rem .8rem .8rem 0;max-width:100%;display:inline-block;vertical-align:top}figcaption{color:#555;font-size:.88rem;max-width:420px}
.muted{color:#666}
";
/// Colours of generations 0, 1, 2, ...; the last holds for all beyond.
const GENERATIONS: [&str; 7] = ["#222222", "#1f4e8c", "#1d8a8a", "#3c9a3c", "#c9a227", "#c9621f", "#a8324a"];
/// Width of a section's widest picture; the others have its scale.
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
        let both = [PictureView::Front, PictureView::Left];
        let frames = both.map(|view| PictureFrame::around(view, anatomy.inspiration.vertices.iter().copied(), 4.0));
        for (frame, from) in frames.iter().zip(["front", "left"]) {
            let caption = format!("The surface from the {from}.");
            let content = surface(frame, &anatomy.inspiration, &shown)?;
            shaded.push((frame.svg(&content, scale_of(&frames), &caption), caption));
        }
        let (tree, motion) = (self.tree_frame(), both.map(|view| self.motion_frame(view)));
        let px_per_mm = scale_of(&[tree, motion[0], motion[1]]);
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
                    p.muted { "Look before you film: contours lie on the dark lumen, the surface is blue, nothing folds. \
                        Letters: the patient's right and left, front (A) and back (P), head and feet. Pictures beside each \
                        other have one scale." }
                    table { @for (what, words) in self.facts { tr { td { (what) } td { (unsigned_zeros(words)) } } } }
                    @if !slices.is_empty() {
                        h2 { "Slices" }
                        p.muted { "Through the carina and the middle of the tree; the surface where it crosses them in red." }
                        @for (caption, picture) in &slices { (figure(picture, caption)) }
                    }
                    h2 { "Surface" }
                    p.muted { (self.residual_words) ": blue 0, grey " (format!("{:.2}", 0.5 * self.red_mm)) ", red "
                        (format!("{:.2}", self.red_mm)) " mm and more." }
                    @for (picture, caption) in &shaded { (figure(picture, caption)) }
                    @if let Some(change) = self.change {
                        h2 { "Volume change in the lungs" }
                        (figure(&histogram(&change.histogram, 0.0, 2.0, "Histogram of the volume change"), &format!(
                            "Volume at expiration over volume at inspiration, {} voxels: least {:.2}, median {:.2}, greatest {:.2}; \
                             {} fold.", change.voxels, change.least, change.median, change.greatest, change.folded)))
                    }
                    h2 { "Tree and motion" }
                    (figure(&self.tree(&tree, px_per_mm), "Centreline from the front, by generation: black 0, blue 1, then teal, green, yellow, orange, red."))
                    (figure(&self.motion(&motion[0], px_per_mm, "front"), "Motion from inspiration (grey) to expiration, from the front."))
                    (figure(&self.motion(&motion[1], px_per_mm, "left"), "The same from the left."))
                }
            }
        };
        Ok(page.into_string())
    }

    fn slices(&self) -> Result<Vec<(String, String)>> {
        let points = &self.anatomy.centerline.points;
        let carina = self.anatomy.centerline.carina_mm().unwrap_or_default();
        let middle = points.iter().map(|p| p.position_mm).sum::<DVec3>() / points.len().max(1) as f64;
        let mut cuts = Vec::new();
        for hold in self.scans {
            for (view, deep) in
                [(PictureView::Front, carina.y), (PictureView::Left, -carina.x), (PictureView::Feet, middle.z)]
            {
                cuts.push((hold, deep, PictureFrame::around(view, hold.vertices.iter().copied(), 25.0)));
            }
        }
        let frames: Vec<PictureFrame> = cuts.iter().map(|(_, _, frame)| *frame).collect();
        let mut found = Vec::new();
        for (hold, deep, frame) in cuts {
            let content = slice(&frame, hold.scan, deep)?
                + &contour(&frame, hold.vertices, &self.anatomy.inspiration.faces, deep, "#e8352b");
            let caption = format!("{}, {}", hold.name, frame.view.name());
            let picture = frame.svg(&content, scale_of(&frames), &format!("{caption}: the scan, the surface in red"));
            found.push((caption, picture));
        }
        Ok(found)
    }

    fn tree_frame(&self) -> PictureFrame {
        let points = &self.anatomy.centerline.points;
        PictureFrame::around(PictureView::Front, points.iter().map(|p| p.position_mm), 12.0)
    }

    fn tree(&self, frame: &PictureFrame, px_per_mm: f64) -> String {
        let points = &self.anatomy.centerline.points;
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
        frame.svg(&lines(frame, &all), px_per_mm, "The centreline from the front, by generation")
    }

    fn motion_frame(&self, view: PictureView) -> PictureFrame {
        let points = self.anatomy.centerline.points.iter().map(|p| p.position_mm);
        PictureFrame::around(view, points.chain(self.anatomy.centerline_expiration.iter().copied()), 8.0)
    }

    fn motion(&self, frame: &PictureFrame, px_per_mm: f64, from: &str) -> String {
        let points = &self.anatomy.centerline.points;
        let there = &self.anatomy.centerline_expiration;
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
        let content = lines(frame, &rest.chain(arrows).collect::<Vec<_>>());
        frame.svg(&content, px_per_mm, &format!("Motion from inspiration to expiration, from the {from}"))
    }
}

/// Pixels a mm of the pictures of one section.
fn scale_of(frames: &[PictureFrame]) -> f64 {
    PICTURE_PX / frames.iter().map(PictureFrame::width_mm).fold(1.0, f64::max)
}

/// `words` with 0.0 for -0.0: what is rounded to nothing has no side.
fn unsigned_zeros(words: &str) -> String {
    let is_digit = |c: char| c.is_ascii_digit() || c == '.';
    let mut text = String::with_capacity(words.len());
    for (at, c) in words.char_indices() {
        let rest = &words[at + c.len_utf8()..];
        let number = &rest[..rest.find(|c: char| !is_digit(c)).unwrap_or(rest.len())];
        let is_zero = number.contains('0') && number.chars().all(|c| c == '0' || c == '.');
        if !(c == '-' && is_zero && !text.ends_with(char::is_alphanumeric)) {
            text.push(c);
        }
    }
    text
}

fn figure(picture: &str, caption: &str) -> Markup {
    html! { figure { (PreEscaped(picture)) @if !caption.is_empty() { figcaption { (caption) } } } }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn zeros_have_no_sign() {
        assert_eq!(
            unsigned_zeros("turned by -0.0, -0.5 and (-0.00) degrees"),
            "turned by 0.0, -0.5 and (0.00) degrees"
        );
        assert_eq!(unsigned_zeros("case-0 of 2020-0-1, -, é -0"), "case-0 of 2020-0-1, -, é 0");
    }

    #[test]
    fn pictures_of_a_section_have_one_scale() {
        let around =
            |mm: f64| PictureFrame::around(PictureView::Front, [DVec3::ZERO, DVec3::splat(mm)].into_iter(), 0.0);
        assert_eq!(scale_of(&[around(95.0), around(190.0)]), PICTURE_PX / 190.0);
    }
}
