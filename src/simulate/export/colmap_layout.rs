//! A folder that trainers of Gaussians take for COLMAP's output: `images/`, `masks/`, `sparse/0/`.
//!
//! What its readers assume, by their sources: gsplat's examples open `sparse/0` with pycolmap and test every eighth
//! image from the first on; nerfstudio (1.1.5) takes text first, and the lists `train_list.txt`, `val_list.txt`,
//! `test_list.txt` where they are; OpenSplat reads binary files alone, and no fisheye; Brush takes any `.ply` of the
//! folder in place of the points, so there is none, and finds `masks/NAME.png` itself.

use super::source::ExportSource;
use super::writer::{ExportWriter, LayoutText, filled, scaled, unit_words};
use crate::base::{Result, files};
use crate::formats::colmap::{ColmapModel, ColoredPoint};
use crate::formats::png;

/// Name of an image, relative to `images/`.
fn name_of(frame: usize) -> String {
    format!("{frame:06}.png")
}

/// Writes the folder.
pub(super) fn write(source: &ExportSource, scale: f64, writer: &ExportWriter<'_>) -> Result<LayoutText> {
    let color = source.wall_color()?;
    let surface = source.inspiration()?;
    let model = ColmapModel {
        camera: source.camera,
        images: (source.frames.iter().enumerate())
            .map(|(frame, f)| (name_of(frame), scaled(&f.world_from_camera, scale)))
            .collect(),
        points: surface.vertices.iter().map(|&v| ColoredPoint { position: v * scale, color }).collect(),
    };
    let mask = source.mask_image();
    writer.each_frame(source.frames.len(), |frame| {
        png::write_rgb(&writer.path(format!("images/{}", name_of(frame))), &source.image(frame)?)?;
        match &mask {
            Some(mask) => png::write_grey(&writer.path(format!("masks/{}", name_of(frame))), mask),
            None => Ok(()),
        }
    })?;
    writer.text("sparse/0/cameras.txt", &model.cameras_text())?;
    writer.text("sparse/0/images.txt", &model.images_text())?;
    writer.text("sparse/0/points3D.txt", &model.points_text())?;
    files::write_bytes(&writer.path("sparse/0/cameras.bin"), &model.cameras_binary())?;
    files::write_bytes(&writer.path("sparse/0/images.bin"), &model.images_binary())?;
    files::write_bytes(&writer.path("sparse/0/points3D.bin"), &model.points_binary())?;
    let list = |frames: Vec<usize>| frames.into_iter().map(|frame| name_of(frame) + "\n").collect::<String>();
    writer.text("train_list.txt", &list(source.train_frames()))?;
    for split in ["val", "test"] {
        writer.text(&format!("{split}_list.txt"), &list(source.test_frames()))?;
    }
    let masks = if mask.is_some() { " --masks-path masks" } else { "" };
    let lens = if source.camera.fisheye.is_some() { "OPENCV_FISHEYE" } else { "PINHOLE" };
    let values = [
        ("lens", lens.to_owned()),
        ("unit", unit_words(scale)),
        ("points", model.points.len().to_string()),
        ("masks", masks.to_owned()),
    ];
    let about = filled(include_str!("about/colmap.md"), &values);
    let notes = if source.camera.fisheye.is_some() {
        vec!["the camera is a fisheye: OpenSplat refuses it; gsplat's examples undistort it".to_owned()]
    } else {
        Vec::new()
    };
    Ok(LayoutText { about, notes })
}
