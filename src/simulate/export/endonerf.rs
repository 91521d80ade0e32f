//! EndoNeRF's folder: `images/`, `depth/`, `masks/`, `poses_bounds.npy`.
//!
//! What its readers assume, by the sources of EndoNeRF, EndoGaussian and Deform3DGS:
//!
//! - images of 640 x 512 pixels (EndoGaussian and Deform3DGS hold these numbers), a pinhole with one focal length, the
//!   principal point in the middle. A smaller film is laid onto such a canvas, pixel for pixel, with its principal
//!   point in the middle, and the rest is masked; a larger one gets a larger canvas, and `img_wh` of the reader must be
//!   changed.
//! - masks are 255 where an instrument hides the tissue: here also outside of the film, where the scope's mask hides
//!   it, and where there is no depth.
//! - depth is an integer image in the unit of the poses; 0 is none.
//! - `poses_bounds.npy` has a row of 17 numbers per frame: `[R | t | (height, width, focal)]` row by row, then the
//!   nearest and the furthest depth. EndoNeRF and Deform3DGS take R's axes to be OpenGL's, EndoGaussian OpenCV's: [`PoseAxes`].
//! - frames are evenly spaced in time; frame i is for tests where (i - 1) is a multiple of 8.

use crate::base::{Camera, Error, Image, Result};
use crate::formats::{depth_png, npy, png};

use super::source::ExportSource;
use super::writer::{ExportWriter, LayoutText, filled, scaled};

/// Camera axes of the poses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PoseAxes {
    /// x right, y up, z backwards: EndoNeRF, Deform3DGS.
    #[default]
    OpenGl,
    /// x right, y down, z forward: EndoGaussian.
    OpenCv,
}

/// Width and height that the readers hold.
const CANVAS_PX: [usize; 2] = [640, 512];
/// Codes of depth in a millimetre, unless the user says otherwise: rounding costs at most 0.05 mm, and 6.5 m can be
/// said.
const CODES_PER_MM: f64 = 10.0;
/// Where nothing of the film is.
const HIDDEN: u8 = 255;

/// How the film lies on the canvas.
struct EndonerfCanvas {
    size: [usize; 2],
    /// Column and row of the film's first pixel.
    corner: [usize; 2],
}

impl EndonerfCanvas {
    /// Errors: a camera that the layout cannot describe.
    fn of(camera: &Camera) -> Result<EndonerfCanvas> {
        let refused = |why: String| Err(Error::input(format!("EndoNeRF's layout knows {why}")));
        if camera.fisheye.is_some() {
            return refused("pinholes alone, and this camera is a fisheye".into());
        }
        if (camera.fl_x - camera.fl_y).abs() > 1e-6 * camera.fl_x {
            return refused(format!("one focal length, and this camera has {} and {}", camera.fl_x, camera.fl_y));
        }
        let side = |axis: usize, length: u32, centre: f64| -> Result<(usize, usize)> {
            // Even, and wide enough for the longer of the two sides of the principal point.
            let needed = 2 * centre.max(f64::from(length) - centre).ceil() as usize;
            let size = needed.max(CANVAS_PX[axis]);
            let corner = size as f64 / 2.0 - centre;
            if (corner - corner.round()).abs() > 1e-6 || corner < -1e-6 {
                let why =
                    format!("the principal point in the middle, and {centre} cannot be moved there by whole pixels");
                return Err(Error::input(format!("EndoNeRF's layout has {why}")));
            }
            Ok((size, corner.round() as usize))
        };
        let (width, left) = side(0, camera.width, camera.cx)?;
        let (height, top) = side(1, camera.height, camera.cy)?;
        Ok(EndonerfCanvas { size: [width, height], corner: [left, top] })
    }

    /// `image` on the canvas, `fill` around it.
    fn lay<T: Copy>(&self, image: &Image<T>, fill: T) -> Image<T> {
        let mut canvas = Image::filled(self.size[0], self.size[1], image.channels, fill);
        for y in 0..image.height {
            for x in 0..image.width {
                canvas.pixel_mut(x + self.corner[0], y + self.corner[1]).copy_from_slice(image.pixel(x, y));
            }
        }
        canvas
    }
}

/// Writes the folder.
pub(super) fn write(
    source: &ExportSource,
    scale: Option<f64>,
    axes: PoseAxes,
    writer: &ExportWriter<'_>,
) -> Result<LayoutText> {
    let scale = scale.unwrap_or(CODES_PER_MM);
    let canvas = EndonerfCanvas::of(&source.camera)?;
    let frames = source.frames.len();
    let rows = std::sync::Mutex::new(vec![[0f32; 17]; frames]);
    let too_far = std::sync::atomic::AtomicUsize::new(0);
    writer.each_frame(frames, |frame| {
        let name = |folder: &str| writer.path(format!("{folder}/{frame:06}.png"));
        let depth_mm = source.depth_mm(frame)?;
        let codes = depth_mm.map(|d| (f64::from(d) * scale).round().clamp(0.0, 65_535.0) as u16);
        let far = codes.data.iter().filter(|&&code| code == u16::MAX).count();
        too_far.fetch_add(far, std::sync::atomic::Ordering::Relaxed);
        let shows = |pixel: usize| source.mask.as_ref().is_none_or(|mask| mask.shows(pixel));
        let hidden = |(pixel, &code): (usize, &u16)| {
            if shows(pixel) && code > 0 && code < u16::MAX { 0 } else { HIDDEN }
        };
        let mask = Image { data: codes.data.iter().enumerate().map(hidden).collect(), ..empty(&codes) };
        let seen = || codes.data.iter().zip(&mask.data).filter(|(_, hidden)| **hidden == 0).map(|(code, _)| *code);
        let bounds = [seen().min().unwrap_or(0), seen().max().unwrap_or(0)];
        png::write_rgb(&name("images"), &canvas.lay(&source.image(frame)?, 0))?;
        depth_png::write(&name("depth"), &canvas.lay(&codes, 0))?;
        png::write_grey(&name("masks"), &canvas.lay(&mask, HIDDEN))?;
        let row = pose_row(source, frame, scale, axes, &canvas, bounds);
        rows.lock().unwrap_or_else(std::sync::PoisonError::into_inner)[frame] = row;
        Ok(())
    })?;
    let rows = rows.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner);
    npy::write(&writer.path("poses_bounds.npy"), &[frames, 17], rows.as_flattened())?;
    let [width, height] = canvas.size;
    let mut notes = Vec::new();
    if canvas.size != CANVAS_PX {
        notes.push(format!(
            "the canvas is {width}x{height}: set `img_wh` in the reader's scene/endo_loader.py, which holds 640x512"
        ));
    }
    let far = too_far.into_inner();
    if far > 0 {
        notes.push(format!("{far} pixels are too far for 16 bits and masked; a smaller --scale keeps them"));
    }
    Ok(LayoutText { about: about(source, scale, axes, &canvas), notes })
}

/// An image of the size of `codes` with no pixels yet.
fn empty(codes: &Image<u16>) -> Image<u8> {
    Image { width: codes.width, height: codes.height, channels: 1, data: Vec::new() }
}

fn pose_row(
    source: &ExportSource,
    frame: usize,
    scale: f64,
    axes: PoseAxes,
    canvas: &EndonerfCanvas,
    [near, far]: [u16; 2],
) -> [f32; 17] {
    let pose = scaled(&source.frames[frame].world_from_camera, scale);
    let sign = if axes == PoseAxes::OpenGl { -1.0 } else { 1.0 };
    let columns = [
        pose.matrix3.x_axis,
        sign * pose.matrix3.y_axis,
        sign * pose.matrix3.z_axis,
        pose.translation,
        glam::DVec3::new(canvas.size[1] as f64, canvas.size[0] as f64, source.camera.fl_x),
    ];
    let mut row = [0f32; 17];
    for (place, value) in row[..15].iter_mut().enumerate() {
        *value = columns[place % 5][place / 5] as f32;
    }
    row[15..].copy_from_slice(&[f32::from(near), f32::from(far)]);
    row
}

fn about(source: &ExportSource, scale: f64, axes: PoseAxes, canvas: &EndonerfCanvas) -> String {
    let ([width, height], [left, top]) = (canvas.size, canvas.corner);
    let axes = match axes {
        PoseAxes::OpenGl => {
            "OpenGL's (x right, y up, z backwards), as EndoNeRF and Deform3DGS read them\n(EndoGaussian: `--axes opencv`)"
        }
        PoseAxes::OpenCv => {
            "OpenCV's (x right, y down, z forward), as EndoGaussian reads them\n(EndoNeRF, Deform3DGS: `--axes opengl`)"
        }
    };
    let values = [
        ("width", width.to_string()),
        ("height", height.to_string()),
        ("film", format!("{}x{}", source.camera.width, source.camera.height)),
        ("left", left.to_string()),
        ("top", top.to_string()),
        ("scale", scale.to_string()),
        ("axes", axes.to_owned()),
    ];
    filled(include_str!("about/endonerf.md"), &values)
}
