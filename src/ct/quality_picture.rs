//! Pictures of the quality page: slices with contours, a shaded surface, lines. All in mm of LPS, looked at from the
//! front, the left or the feet.

use std::fmt::Write;

use glam::{DVec2, DVec3};

use crate::base::{Image, Result, TriangleMesh, Volume, base64};
use crate::formats::png;

/// HU that are black and white.
const WINDOW_HU: [f64; 2] = [-1050.0, 150.0];
/// Pixels a mm of the shaded surface.
const PIXELS_PER_MM: f64 = 2.0;
/// Size of the letters at a picture's edges, in pixels of the page.
const LETTER_PX: f64 = 12.0;
/// Lengths of the bar in mm: the first that leaves a third of the picture's width.
const BARS_MM: [f64; 3] = [20.0, 5.0, 1.0];

/// From where a picture is looked at: which axes of LPS run to the right and up, and which one into it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PictureView {
    /// From the front: the patient's left is to the right.
    Front,
    /// From the left: the back is to the right.
    Left,
    /// From the feet, as CT slices are shown: the left is to the right, the front above.
    Feet,
}

impl PictureView {
    /// Its name on the page.
    pub fn name(self) -> &'static str {
        match self {
            PictureView::Front => "coronal",
            PictureView::Left => "sagittal",
            PictureView::Feet => "axial",
        }
    }

    /// Letters of the patient's sides at the left, right, upper and lower edge: in LPS x grows to the patient's left, y to
    /// the back (posterior) and z to the head.
    pub fn sides(self) -> [&'static str; 4] {
        match self {
            PictureView::Front => ["R", "L", "H", "F"],
            PictureView::Left => ["A", "P", "H", "F"],
            PictureView::Feet => ["R", "L", "A", "P"],
        }
    }

    /// (right, up, deep): places on the picture, and depth away from the eye.
    fn seen(self, p: DVec3) -> (DVec2, f64) {
        match self {
            PictureView::Front => (DVec2::new(p.x, p.z), p.y),
            PictureView::Left => (DVec2::new(p.y, p.z), -p.x),
            PictureView::Feet => (DVec2::new(p.x, -p.y), p.z),
        }
    }

    fn place(self, seen: DVec2, deep: f64) -> DVec3 {
        match self {
            PictureView::Front => DVec3::new(seen.x, deep, seen.y),
            PictureView::Left => DVec3::new(-deep, seen.x, seen.y),
            PictureView::Feet => DVec3::new(seen.x, -seen.y, deep),
        }
    }
}

/// The part of the body that a picture shows, mm.
#[derive(Clone, Copy, Debug)]
pub struct PictureFrame {
    pub view: PictureView,
    low: DVec2,
    high: DVec2,
}

impl PictureFrame {
    /// Around some places, with a margin in mm.
    pub fn around(view: PictureView, places: impl Iterator<Item = DVec3>, margin_mm: f64) -> PictureFrame {
        let (low, high) = places
            .map(|p| view.seen(p).0)
            .fold((DVec2::INFINITY, DVec2::NEG_INFINITY), |(low, high), p| (low.min(p), high.max(p)));
        PictureFrame { view, low: low - margin_mm, high: high + margin_mm }
    }

    fn size(&self) -> DVec2 {
        (self.high - self.low).max(DVec2::ONE)
    }

    /// Place on the picture, from its upper left corner, mm.
    fn on_picture(&self, place: DVec3) -> DVec2 {
        let seen = self.view.seen(place).0;
        DVec2::new(seen.x - self.low.x, self.high.y - seen.y)
    }

    /// Its width, mm.
    pub fn width_mm(&self) -> f64 {
        self.size().x
    }

    /// An SVG of `content` (in mm from the upper left corner), with the patient's sides at its edges and a bar of length.
    /// `label` says what it shows.
    pub fn svg(&self, content: &str, px_per_mm: f64, label: &str) -> String {
        let (size, px) = (self.size(), self.size() * px_per_mm);
        let marks = self.marks(px_per_mm);
        format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" role=\"img\" aria-label=\"{}\" width=\"{:.0}\" height=\"{:.0}\" \
             viewBox=\"0 0 {:.1} {:.1}\">{content}{marks}</svg>",
            in_attribute(label),
            px.x,
            px.y,
            size.x,
            size.y
        )
    }

    /// Letters and bar, with a light rim: they stand on air and on bone.
    fn marks(&self, px_per_mm: f64) -> String {
        let (size, letter) = (self.size(), LETTER_PX / px_per_mm);
        let [left, right, top, bottom] = self.view.sides();
        let (middle, line) = (size.y / 2.0 + 0.35 * letter, size.y - 0.35 * letter);
        let mut words = vec![
            (left.to_owned(), 0.3 * letter, middle, "start"),
            (right.to_owned(), size.x - 0.3 * letter, middle, "end"),
            (top.to_owned(), size.x / 2.0, letter, "middle"),
            (bottom.to_owned(), size.x / 2.0, line, "middle"),
        ];
        let mut bar = String::new();
        if let Some(mm) = BARS_MM.into_iter().find(|mm| 1.5 * mm <= size.x) {
            let x = 0.5 * letter;
            for (colour, px) in [("#fff", 5.0), ("#111", 2.0)] {
                let width = px / px_per_mm;
                let _ = write!(
                    bar,
                    "<path d=\"M{x:.2} {line:.2}h{mm}\" stroke=\"{colour}\" stroke-width=\"{width:.2}\" fill=\"none\"/>"
                );
            }
            words.push((format!("{mm} mm"), x, line - 0.5 * letter, "start"));
        }
        let rim = 3.0 / px_per_mm;
        let mut text = format!(
            "{bar}<g font-family=\"sans-serif\" font-size=\"{letter:.2}\" font-weight=\"600\" fill=\"#111\" stroke=\"#fff\" \
             stroke-width=\"{rim:.2}\" paint-order=\"stroke\">"
        );
        for (word, x, y, anchor) in words {
            let _ = write!(text, "<text x=\"{x:.2}\" y=\"{y:.2}\" text-anchor=\"{anchor}\">{word}</text>");
        }
        text + "</g>"
    }

    fn image_tag(&self, image: &Image<u8>) -> Result<String> {
        let size = self.size();
        Ok(format!(
            "<image width=\"{:.1}\" height=\"{:.1}\" preserveAspectRatio=\"none\" href=\"data:image/png;base64,{}\"/>",
            size.x,
            size.y,
            base64::encode(&png::encode(image)?)
        ))
    }
}

/// Words as they stand in an attribute.
fn in_attribute(words: &str) -> String {
    words.replace('&', "&amp;").replace('<', "&lt;").replace('"', "&quot;")
}

/// A slice of `scan` at `deep_mm` into the frame, as an element of its SVG.
pub fn slice(frame: &PictureFrame, scan: &Volume<i16>, deep_mm: f64) -> Result<String> {
    frame.image_tag(&slice_pixels(frame, scan, deep_mm))
}

/// A slice with a pixel for each mm.
fn slice_pixels(frame: &PictureFrame, scan: &Volume<i16>, deep_mm: f64) -> Image<u8> {
    let size = frame.size();
    let (width, height) = (size.x.ceil() as usize, size.y.ceil() as usize);
    let to_index = scan.grid.index_from_place();
    let mut image = Image::filled(width, height, 3, 0u8);
    for y in 0..height {
        for x in 0..width {
            let seen = frame.low + DVec2::new(x as f64 + 0.5, size.y - y as f64 - 0.5);
            let hu = scan.sample(to_index(frame.view.place(seen, deep_mm))).unwrap_or(WINDOW_HU[0]);
            let grey = ((hu - WINDOW_HU[0]) / (WINDOW_HU[1] - WINDOW_HU[0])).clamp(0.0, 1.0) * 255.0;
            image.pixel_mut(x, y).fill(grey as u8);
        }
    }
    image
}

/// Where a surface crosses the plane at `deep_mm`: an element of the frame's SVG.
pub fn contour(frame: &PictureFrame, vertices: &[DVec3], faces: &[[u32; 3]], deep_mm: f64, colour: &str) -> String {
    let mut path = String::new();
    for face in faces {
        let corner = face.map(|v| vertices[v as usize]);
        let height = corner.map(|p| frame.view.seen(p).1 - deep_mm);
        let mut ends = Vec::with_capacity(2);
        for (a, b) in [(0, 1), (1, 2), (2, 0)] {
            if (height[a] < 0.0) != (height[b] < 0.0) {
                ends.push(frame.on_picture(corner[a].lerp(corner[b], height[a] / (height[a] - height[b]))));
            }
        }
        if let [from, to] = ends[..] {
            let _ = write!(path, "M{:.1} {:.1}L{:.1} {:.1}", from.x, from.y, to.x, to.y);
        }
    }
    format!("<path d=\"{path}\" stroke=\"{colour}\" stroke-width=\"0.7\" fill=\"none\"/>")
}

/// A line with ends, colour and width in mm.
pub struct DrawnLine {
    pub from: DVec3,
    pub to: DVec3,
    pub colour: String,
    pub width_mm: f64,
}

/// Lines as elements of the frame's SVG.
pub fn lines(frame: &PictureFrame, lines: &[DrawnLine]) -> String {
    let mut text = String::new();
    for line in lines {
        let (a, b) = (frame.on_picture(line.from), frame.on_picture(line.to));
        let _ = write!(
            text,
            "<path d=\"M{:.1} {:.1}L{:.1} {:.1}\" stroke=\"{}\" stroke-width=\"{:.1}\" stroke-linecap=\"round\"/>",
            a.x, a.y, b.x, b.y, line.colour, line.width_mm
        );
    }
    text
}

/// Colour of a value in [0, 1]: blue over grey to red.
pub fn ramp(value: f64) -> [f64; 3] {
    let t = value.clamp(0.0, 1.0);
    let stops = [[0.23, 0.45, 0.80], [0.80, 0.82, 0.82], [0.80, 0.20, 0.15]];
    let (k, part) = if t < 0.5 { (0, 2.0 * t) } else { (1, 2.0 * t - 1.0) };
    std::array::from_fn(|c| stops[k][c] * (1.0 - part) + stops[k + 1][c] * part)
}

/// A surface whose vertices have values in [0, 1], lit from the eye: an element of the frame's SVG.
pub fn surface(frame: &PictureFrame, mesh: &TriangleMesh, values: &[f64]) -> Result<String> {
    let size = frame.size() * PIXELS_PER_MM;
    let (width, height) = (size.x.ceil() as usize, size.y.ceil() as usize);
    let mut image = Image::filled(width, height, 3, 255u8);
    let mut nearest = vec![f64::INFINITY; width * height];
    for face in &mesh.faces {
        let corner = face.map(|v| mesh.vertices[v as usize]);
        let normal = (corner[1] - corner[0]).cross(corner[2] - corner[0]).normalize_or_zero();
        let eye = frame.view.place(DVec2::ZERO, 1.0);
        let light = 0.25 + 0.75 * normal.dot(eye).abs();
        let value = face.iter().map(|&v| values[v as usize]).sum::<f64>() / 3.0;
        let colour = ramp(value).map(|c| (c * light * 255.0) as u8);
        let at = corner.map(|p| frame.on_picture(p) * PIXELS_PER_MM);
        let deep = corner.map(|p| frame.view.seen(p).1);
        let low = at[0].min(at[1]).min(at[2]).floor().max(DVec2::ZERO);
        let high = at[0].max(at[1]).max(at[2]).ceil().min(DVec2::new(width as f64, height as f64));
        let area = (at[1] - at[0]).perp_dot(at[2] - at[0]);
        if area == 0.0 {
            continue;
        }
        for y in low.y as usize..high.y as usize {
            for x in low.x as usize..high.x as usize {
                let p = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
                let b = (p - at[0]).perp_dot(at[2] - at[0]) / area;
                let c = (at[1] - at[0]).perp_dot(p - at[0]) / area;
                if b < 0.0 || c < 0.0 || b + c > 1.0 {
                    continue;
                }
                let depth = deep[0] * (1.0 - b - c) + deep[1] * b + deep[2] * c;
                let slot = &mut nearest[y * width + x];
                if depth < *slot {
                    *slot = depth;
                    image.pixel_mut(x, y).copy_from_slice(&colour);
                }
            }
        }
    }
    frame.image_tag(&image)
}

/// Bars of a histogram whose bins run from `low` to `high`, with ticks below. `label` says what it shows.
pub fn histogram(shares: &[f64], low: f64, high: f64, label: &str) -> String {
    let most = shares.iter().copied().fold(1e-9, f64::max);
    let (width, height) = (420.0, 150.0);
    let step = width / shares.len().max(1) as f64;
    let (label, all) = (in_attribute(label), height + 22.0);
    let mut text = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" role=\"img\" aria-label=\"{label}\" width=\"{width}\" height=\"{all:.0}\" \
         viewBox=\"0 0 {width} {all:.0}\">"
    );
    for (bin, share) in shares.iter().enumerate() {
        let tall = height * share / most;
        let _ = write!(
            text,
            "<rect x=\"{:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{tall:.1}\" fill=\"#4a78b5\"/>",
            bin as f64 * step,
            height - tall,
            step - 0.6
        );
    }
    for tick in 0..=4 {
        let value = low + (high - low) * f64::from(tick) / 4.0;
        let x = (width * f64::from(tick) / 4.0).clamp(8.0, width - 10.0);
        let _ = write!(
            text,
            "<text x=\"{x:.0}\" y=\"{:.0}\" font-size=\"12\" text-anchor=\"middle\">{value}</text>",
            height + 16.0
        );
    }
    text + "</svg>"
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::VoxelGrid;

    #[test]
    fn a_contour_is_where_the_surface_crosses_the_slice() {
        let vertices = vec![
            DVec3::new(-1.0, -1.0, -1.0),
            DVec3::new(3.0, -1.0, -1.0),
            DVec3::new(-1.0, 3.0, -1.0),
            DVec3::new(-1.0, -1.0, 3.0),
        ];
        let faces = vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]];
        let frame = PictureFrame::around(PictureView::Front, vertices.iter().copied(), 0.0);
        let path = contour(&frame, &vertices, &faces, 1.0, "red");
        assert_eq!(path.matches('M').count(), 3, "{path}");
        assert!(contour(&frame, &vertices, &faces, 9.0, "red").contains("d=\"\""));
        let mesh = TriangleMesh { vertices, faces };
        let picture = frame.svg(&surface(&frame, &mesh, &[0.0, 0.5, 1.0, 0.2]).unwrap(), 25.0, "a \"tree\"");
        assert!(picture.starts_with("<svg") && picture.contains("data:image/png;base64,"));
        assert!(picture.contains("role=\"img\" aria-label=\"a &quot;tree&quot;\"") && picture.contains(">1 mm</text>"));
        let scan = Volume::filled(VoxelGrid::upright([4; 3], DVec3::ZERO, DVec3::ONE), -500i16);
        assert!(slice(&frame, &scan, 1.0).unwrap().contains("base64"));
        assert_eq!(histogram(&[0.1, 0.5, 0.4], 0.0, 2.0, "").matches("<rect").count(), 3);
    }

    /// The letters at the edges are those of the places there: a volume is bright on one side of the patient.
    #[test]
    fn the_letters_are_those_of_the_patients_sides() {
        use PictureView::{Feet, Front, Left};
        let corners = [DVec3::splat(2.0), DVec3::splat(29.0)];
        // A side, the axis on which it lies, whether at its far end, and the views that show it.
        let sides: [(&str, usize, bool, [PictureView; 2]); 6] = [
            ("L", 0, true, [Front, Feet]),
            ("R", 0, false, [Front, Feet]),
            ("P", 1, true, [Left, Feet]),
            ("A", 1, false, [Left, Feet]),
            ("H", 2, true, [Front, Left]),
            ("F", 2, false, [Front, Left]),
        ];
        for (letter, axis, is_far, views) in sides {
            let mut scan = Volume::filled(VoxelGrid::upright([32; 3], DVec3::ZERO, DVec3::ONE), -1000i16);
            for (index, voxel) in scan.data.iter_mut().enumerate() {
                // x runs first, z last.
                let along = [index % 32, index / 32 % 32, index / 1024][axis];
                if (along >= 16) == is_far {
                    *voxel = 100;
                }
            }
            for view in views {
                let frame = PictureFrame::around(view, corners.into_iter(), 0.0);
                let deep = if view == Left { -15.0 } else { 15.0 };
                let image = slice_pixels(&frame, &scan, deep);
                let (width, height) = (image.width, image.height);
                let at = |x: usize, y: usize| image.data[3 * (y * width + x)];
                let edges = [at(2, height / 2), at(width - 3, height / 2), at(width / 2, 2), at(width / 2, height - 3)];
                let place = view.sides().iter().position(|side| *side == letter).unwrap();
                let opposite = place ^ 1;
                assert!(edges[place] > 200 && edges[opposite] < 50, "{letter} {view:?} {edges:?}");
            }
        }
    }
}
