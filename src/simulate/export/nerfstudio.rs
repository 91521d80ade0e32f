//! nerfstudio's folder: `transforms.json` with splits, masks and points; and beside it D-NeRF's
//! `transforms_train.json`, `transforms_val.json`, `transforms_test.json`, where the camera is what those can say.
//!
//! What its readers assume, by the source of nerfstudio 1.1.5. The parser of `transforms.json` wants masks and depths
//! of all frames or of none; `train_filenames`, `val_filenames` and `test_filenames` together or not at all; grey
//! masks. It multiplies `points.ply` by `applied_scale`, poses not: so there is none. A depth is multiplied by a
//! thousandth: so it is written in thousandths of the unit of the poses. The parser of D-NeRF knows `camera_angle_x`,
//! square pixels, a principal point in the middle, names without `.png`, and a `time` in 0 to 1; it scales nothing.

use serde_json::{Value, json};

use super::source::ExportSource;
use super::writer::{ExportWriter, LayoutText, filled, scaled, unit_words};
use crate::base::{Error, Result, files};
use crate::formats::colmap::ColoredPoint;
use crate::formats::transforms::{Transforms, TransformsFrame, TransformsLens};
use crate::formats::{npy, png, points_ply};
use crate::simulate::participant::FRAME_KEYS;

/// nerfstudio's `depth_unit_scale_factor`.
const DEPTH_UNIT: f64 = 1e-3;

/// What EXPORT.md says of D-NeRF's files, and of their absence.
const DNERF: &str = "\
`transforms_train.json`, `_val`, `_test`: the same in D-NeRF's form (`time` from 0 to 1, names without
`.png`), for `dnerf-data`, Deformable-3D-Gaussians, 4DGaussians and K-Planes. Their scene box reaches
from -1.5 to 1.5: export with `--scale 0.02` or so.";
const NO_DNERF: &str = "\
D-NeRF's `transforms_train.json` is left out: its readers know neither distortion nor a principal
point.";

fn image_name(frame: usize) -> String {
    format!("images/{frame:06}.png")
}

/// Writes the folder.
pub(super) fn write(source: &ExportSource, scale: f64, writer: &ExportWriter<'_>) -> Result<LayoutText> {
    let mask = source.mask_image();
    writer.each_frame(source.frames.len(), |frame| {
        png::write_rgb(&writer.path(image_name(frame)), &source.image(frame)?)?;
        if let Some(mask) = &mask {
            png::write_grey(&writer.path(format!("masks/{frame:06}.png")), mask)?;
        }
        if source.shows_truth() {
            let depth = source.depth_mm(frame)?.map(|d| (f64::from(d) * scale / DEPTH_UNIT) as f32);
            npy::write(&writer.path(depth_name(frame)), &[depth.height, depth.width], &depth.data)?;
        }
        Ok(())
    })?;
    let surface = source.inspiration()?;
    let color = source.wall_color()?;
    let points: Vec<ColoredPoint> =
        surface.vertices.iter().map(|&v| ColoredPoint { position: v * scale, color }).collect();
    points_ply::write(&writer.path("points.ply"), &points, &surface.vertex_normals())?;
    files::write_json(&writer.path("transforms.json"), &transforms(source, scale, mask.is_some())?)?;
    let dynamic = dnerf_angle(source).is_some();
    if let Some(camera_angle_x) = dnerf_angle(source) {
        for (split, frames) in
            [("train", source.train_frames()), ("val", source.test_frames()), ("test", source.test_frames())]
        {
            let value = json!({ "camera_angle_x": camera_angle_x, "frames": dnerf_frames(source, scale, &frames) });
            files::write_json(&writer.path(format!("transforms_{split}.json")), &value)?;
        }
    }
    let dnerf = if dynamic { DNERF } else { NO_DNERF };
    let values = [("unit", unit_words(scale)), ("dnerf", dnerf.to_owned())];
    let about = filled(include_str!("about/nerfstudio.md"), &values);
    let notes = if dynamic {
        Vec::new()
    } else {
        vec![
            "transforms_train.json is left out: D-NeRF's form knows only a pinhole with square pixels about the middle"
                .into(),
        ]
    };
    Ok(LayoutText { about, notes })
}

fn depth_name(frame: usize) -> String {
    format!("depth/{frame:06}.npy")
}

/// `transforms.json`.
fn transforms(source: &ExportSource, scale: f64, masked: bool) -> Result<Value> {
    let entry = |(frame, given): (usize, &crate::simulate::participant::GivenFrame)| TransformsFrame {
        file_path: image_name(frame),
        depth_file_path: source.shows_truth().then(|| depth_name(frame)),
        mask_path: masked.then(|| format!("masks/{frame:06}.png")),
        transform_matrix: TransformsFrame::matrix(&scaled(&given.world_from_camera, scale)),
        time: given.time_s,
        breathing_phase: None,
        exposure: 1.0,
        white_balance: [1.0; 3],
        lens: TransformsLens::default(),
    };
    let entries = source.frames.iter().enumerate().map(entry).collect();
    let failed = |e: serde_json::Error| Error::input(e.to_string());
    let mut value = serde_json::to_value(Transforms::new(&source.camera, entries)).map_err(failed)?;
    let Some(top) = value.as_object_mut() else { return Ok(value) };
    // Readers multiply points by the one, and take the other from their own options.
    top.remove("applied_scale");
    top.remove("depth_unit_scale_factor");
    top.insert("ply_file_path".into(), "points.ply".into());
    let names = |frames: Vec<usize>| frames.into_iter().map(image_name).collect::<Vec<_>>();
    top.insert("train_filenames".into(), names(source.train_frames()).into());
    for split in ["val_filenames", "test_filenames"] {
        top.insert(split.into(), names(source.test_frames()).into());
    }
    let frames = top.get_mut("frames").and_then(Value::as_array_mut);
    for frame in frames.into_iter().flatten().filter_map(Value::as_object_mut) {
        frame.retain(|key, _| FRAME_KEYS.contains(&key.as_str()));
    }
    Ok(value)
}

/// The horizontal field of view in radians, where that says all of the camera.
fn dnerf_angle(source: &ExportSource) -> Option<f64> {
    let c = &source.camera;
    let (width, height) = (f64::from(c.width), f64::from(c.height));
    let is_plain = c.fisheye.is_none() && (c.fl_x - c.fl_y).abs() < 1e-6 * c.fl_x;
    let is_centred = (c.cx - width / 2.0).abs() < 1e-6 && (c.cy - height / 2.0).abs() < 1e-6;
    (is_plain && is_centred).then(|| 2.0 * (width / 2.0 / c.fl_x).atan())
}

fn dnerf_frames(source: &ExportSource, scale: f64, frames: &[usize]) -> Vec<Value> {
    let last_s = source.frames.last().map_or(1.0, |f| f.time_s).max(f64::MIN_POSITIVE);
    let entry = |&frame: &usize| {
        let given = &source.frames[frame];
        json!({
            "file_path": format!("images/{frame:06}"),
            "time": given.time_s / last_s,
            "transform_matrix": TransformsFrame::matrix(&scaled(&given.world_from_camera, scale)),
        })
    };
    frames.iter().map(entry).collect()
}
