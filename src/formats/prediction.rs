//! The names in a PREDICTION folder: of its folders, files and columns. The writer
//! (`src/reconstruct/prediction_folder.rs`) and the reader (`src/score/prediction.rs`, which says what each holds) both
//! take them from here.

use std::path::Path;

use crate::base::{Error, Result, files};

/// Renderings of the frames.
pub const COLOR: &str = "color";
/// Depths of the frames.
pub const DEPTH: &str = "depth";
/// Renderings of frames, made before the frame's own image was read.
pub const AHEAD: &str = "ahead";
/// Renderings of the second cameras' views.
pub const NOVEL: &str = "novel";
/// Depths of the second cameras' views.
pub const NOVEL_DEPTH: &str = "novel_depth";

/// How pictures end.
pub const PICTURE_ENDING: &str = "png";
/// How depth images that this program writes end.
pub const DEPTH_ENDING: &str = "exr";
/// How depth images may end, in the order of the search.
pub const DEPTH_ENDINGS: [&str; 3] = [DEPTH_ENDING, "npy", "png"];

/// Breathing phases.
pub const PHASE: &str = "phase.csv";
/// Poses of the camera.
pub const POSES: &str = "poses.csv";
/// Places of the targets.
pub const TARGETS: &str = "targets.csv";
/// How surely a prediction knows its targets.
pub const TARGET_COVARIANCE: &str = "target_covariance.csv";
/// The surface at the last frame.
pub const FINAL_MESH: &str = "mesh/final.ply";
/// Where the vertices of the sequence's meshes are on the predicted surface.
pub const CORRESPONDENCE: &str = "correspondence.csv";
/// What the method spent.
pub const TIMING: &str = "timing.json";
/// Which method made the prediction.
pub const ABOUT: &str = "prediction.json";
/// All files beside the folders of pictures.
pub const SINGLE_FILES: [&str; 8] =
    [PHASE, POSES, TARGETS, TARGET_COVARIANCE, FINAL_MESH, CORRESPONDENCE, TIMING, ABOUT];

/// Columns of [`PHASE`]; the last one only where the method estimates it.
pub const PHASE_COLUMNS: [&str; 3] = ["frame", "phase", "phase_sd"];
/// Columns of [`POSES`]: the frame, and the upper rows of world_from_camera, mm.
pub const POSE_COLUMNS: [&str; 13] =
    ["frame", "m00", "m01", "m02", "m03", "m10", "m11", "m12", "m13", "m20", "m21", "m22", "m23"];
/// Columns of [`TARGETS`].
pub const TARGET_COLUMNS: [&str; 5] = ["frame", "target", "x_mm", "y_mm", "z_mm"];
/// Columns of [`TARGET_COVARIANCE`]: the upper half of each matrix, mm squared.
pub const COVARIANCE_COLUMNS: [&str; 8] = ["frame", "target", "xx", "xy", "xz", "yy", "yz", "zz"];
/// Columns of [`CORRESPONDENCE`] with places on faces.
pub const ON_FACE_COLUMNS: [&str; 5] = ["vertex", "face", "b0", "b1", "b2"];
/// Columns of [`CORRESPONDENCE`] with places at vertices.
pub const AT_VERTEX_COLUMNS: [&str; 2] = ["vertex", "predicted_vertex"];

/// Keys of [`TIMING`] that are read: wall and CPU seconds.
pub const TIMING_KEYS: [&str; 2] = ["time_total_s", "time_cpu_s"];
/// What this program writes there besides, for people.
pub const TIMING_NOTES: [&str; 2] = ["time_per_frame_s", "frames"];
/// Keys of [`ABOUT`] that are read.
pub const ABOUT_KEYS: [&str; 3] = ["method", "case", "depth_unit_mm"];

/// `NNNNNN.ending`, the name of a frame's file in its folder.
pub fn frame_name(frame: usize, ending: &str) -> String {
    format!("{frame:06}.{ending}")
}

/// `folder/NNNNNN.ending`, a frame's file.
pub fn frame_file(folder: &str, frame: usize, ending: &str) -> String {
    format!("{folder}/{}", frame_name(frame, ending))
}

/// The first line of a table.
pub fn header(columns: &[&str]) -> String {
    columns.join(",") + "\n"
}

/// For what writes a `timing.json` of another meaning into `folder`.
///
/// Errors: that of a prediction is there.
pub fn refuse_timing_in(folder: &Path) -> Result<()> {
    let path = folder.join(TIMING);
    let told = files::read_json::<serde_json::Value>(&path);
    match told.is_ok_and(|timing| TIMING_KEYS.iter().any(|key| timing.get(key).is_some())) {
        true => {
            Err(Error::input("is a prediction's, and nothing is overwritten: name another folder with --out").at(path))
        }
        false => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_those_of_the_documents() {
        assert_eq!(frame_file(COLOR, 7, PICTURE_ENDING), "color/000007.png");
        assert_eq!(frame_file(NOVEL_DEPTH, 1_234_567, DEPTH_ENDING), "novel_depth/1234567.exr");
        assert_eq!(header(&TARGET_COLUMNS), "frame,target,x_mm,y_mm,z_mm\n");
    }

    #[test]
    fn a_prediction_is_told_from_others_times() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| files::write_bytes(&folder.path().join(name), text.as_bytes()).unwrap();
        refuse_timing_in(&folder.path().join("absent")).unwrap();
        write(TIMING, "{\"render_wall_s\": 1.5}");
        refuse_timing_in(folder.path()).unwrap();
        write(TIMING, "{\"time_cpu_s\": 1.5}");
        assert!(refuse_timing_in(folder.path()).unwrap_err().to_string().contains("timing.json: is a prediction's"));
    }
}
