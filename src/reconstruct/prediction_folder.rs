//! The PREDICTION folder: `color/NNNNNN.png`, `depth/NNNNNN.exr`, `ahead/NNNNNN.png`,
//! `novel/NNNNNN.png`, `novel_depth/NNNNNN.exr`, `targets.csv`, `target_covariance.csv`, `phase.csv` (with
//! `phase_sd` if the method estimates it), `poses.csv` (if it estimates them), `mesh/final.ply`, `timing.json`,
//! `prediction.json`. Frames are written as they come, the rest at the end.

use std::path::{Path, PathBuf};

use glam::{DAffine3, DMat3, DVec3};
use serde::Serialize;

use crate::base::{Error, Image, Result, TriangleMesh, files};
use crate::formats::{exr, mesh, png, prediction};

/// What a method spent, in `timing.json`.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct PredictionTiming {
    /// Wall seconds of the method alone, above 0.
    pub time_total_s: f64,
    /// Its CPU seconds, above 0, where they are known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub time_cpu_s: Option<f64>,
    /// Wall seconds per frame.
    pub time_per_frame_s: f64,
    /// Number of frames.
    pub frames: usize,
}

/// A folder of predictions that is being written: pictures at once, tables by [`PredictionFolder::finish`]. Nothing is
/// compared with a film here; `respire-bench check` does that.
#[derive(Debug)]
pub struct PredictionFolder {
    folder: PathBuf,
    phases: Vec<(usize, f64, Option<f64>)>,
    poses: Vec<(usize, DAffine3)>,
    targets: String,
    covariances: String,
}

impl PredictionFolder {
    /// Nothing is written yet.
    pub fn new(folder: &Path) -> Self {
        PredictionFolder {
            folder: folder.to_path_buf(),
            phases: Vec::new(),
            poses: Vec::new(),
            targets: prediction::header(&prediction::TARGET_COLUMNS),
            covariances: prediction::header(&prediction::COVARIANCE_COLUMNS),
        }
    }

    fn picture_file(&self, kind: &str, frame: usize) -> PathBuf {
        self.folder.join(prediction::frame_file(kind, frame, prediction::PICTURE_ENDING))
    }

    fn depth_file(&self, kind: &str, frame: usize) -> PathBuf {
        self.folder.join(prediction::frame_file(kind, frame, prediction::DEPTH_ENDING))
    }

    /// Writes the rendering of a frame, 8-bit sRGB.
    pub fn color(&self, frame: usize, image: &Image<u8>) -> Result<()> {
        png::write_rgb_fast(&self.picture_file(prediction::COLOR, frame), image)
    }

    /// Writes the z-depth of a frame in mm, 0 where nothing is.
    pub fn depth_mm(&self, frame: usize, depth: &Image<f32>) -> Result<()> {
        exr::write_depth(&self.depth_file(prediction::DEPTH, frame), depth)
    }

    /// Writes the rendering of a frame that was made before its image was used.
    pub fn ahead(&self, frame: usize, image: &Image<u8>) -> Result<()> {
        png::write_rgb_fast(&self.picture_file(prediction::AHEAD, frame), image)
    }

    /// Writes the view of the second camera of a frame.
    pub fn novel(&self, frame: usize, image: &Image<u8>) -> Result<()> {
        png::write_rgb_fast(&self.picture_file(prediction::NOVEL, frame), image)
    }

    /// Writes the z-depth of the second camera of a frame in mm, 0 where nothing is.
    pub fn novel_depth_mm(&self, frame: usize, depth: &Image<f32>) -> Result<()> {
        exr::write_depth(&self.depth_file(prediction::NOVEL_DEPTH, frame), depth)
    }

    /// Adds the breathing phase of a frame and, where it is known, its standard deviation.
    pub fn add_phase(&mut self, frame: usize, phase: f64, deviation: Option<f64>) {
        self.phases.push((frame, phase, deviation));
    }

    /// Adds the pose of a frame, world from camera in mm.
    pub fn add_pose(&mut self, frame: usize, world_from_camera: DAffine3) {
        self.poses.push((frame, world_from_camera));
    }

    /// Adds the places of all targets at a frame, mm.
    pub fn add_targets(&mut self, frame: usize, places_mm: &[DVec3]) {
        for (target, place) in places_mm.iter().enumerate() {
            self.targets += &format!("{frame},{target},{:.9},{:.9},{:.9}\n", place.x, place.y, place.z);
        }
    }

    /// Adds the covariances of all targets' places at a frame, camera axes, mm squared.
    pub fn add_target_covariances(&mut self, frame: usize, covariances_mm2: &[DMat3]) {
        for (target, c) in covariances_mm2.iter().enumerate() {
            let (x, y) = (c.x_axis, c.y_axis);
            let entries = [x.x, x.y, x.z, y.y, y.z, c.z_axis.z].map(|entry| format!(",{entry:.9}")).concat();
            self.covariances += &format!("{frame},{target}{entries}\n");
        }
    }

    /// Writes the tables, the surface at the last frame and the times, as far as they are there.
    pub fn finish(self, final_mesh: Option<&TriangleMesh>, timing: Option<&PredictionTiming>) -> Result<()> {
        let at = |name: &str| self.folder.join(name);
        if !self.phases.is_empty() {
            let path = at(prediction::PHASE);
            files::write_bytes(&path, &phase_table(&self.phases).map_err(|e| e.at(&path))?)?;
        }
        if !self.poses.is_empty() {
            files::write_bytes(&at(prediction::POSES), pose_table(&self.poses).as_bytes())?;
        }
        if self.targets.lines().count() > 1 {
            files::write_bytes(&at(prediction::TARGETS), self.targets.as_bytes())?;
        }
        if self.covariances.lines().count() > 1 {
            files::write_bytes(&at(prediction::TARGET_COVARIANCE), self.covariances.as_bytes())?;
        }
        if let Some(surface) = final_mesh {
            mesh::write_ply(&at(prediction::FINAL_MESH), surface, &["airway surface at the last frame, mm"])?;
        }
        timing.map_or(Ok(()), |timing| files::write_json(&at(prediction::TIMING), timing))
    }

    /// Names the method in `prediction.json`.
    pub fn write_about(&self, method: &str) -> Result<()> {
        files::write_json(&self.folder.join(prediction::ABOUT), &PredictionAbout { method })
    }
}

/// What `prediction.json` says.
#[derive(Serialize)]
struct PredictionAbout<'a> {
    method: &'a str,
}

/// Columns `frame`, `phase` and, where all are known, `phase_sd`.
fn phase_table(phases: &[(usize, f64, Option<f64>)]) -> Result<Vec<u8>> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    let failed = |e: csv::Error| Error::input(format!("cannot be written: {e}"));
    let with_deviation = phases.iter().all(|(_, _, deviation)| deviation.is_some());
    let columns = if with_deviation { 3 } else { 2 };
    writer.write_record(&prediction::PHASE_COLUMNS[..columns]).map_err(failed)?;
    for (frame, phase, deviation) in phases {
        let deviation = deviation.map_or(String::new(), |sd| format!("{sd:.9}"));
        let row = [frame.to_string(), format!("{phase:.9}"), deviation];
        writer.write_record(&row[..columns]).map_err(failed)?;
    }
    writer.into_inner().map_err(|e| Error::input(e.to_string()))
}

/// Columns `frame` and `m00` to `m23`: the upper rows of world_from_camera, mm.
fn pose_table(poses: &[(usize, DAffine3)]) -> String {
    let mut table = prediction::header(&prediction::POSE_COLUMNS);
    for (frame, pose) in poses {
        table += &frame.to_string();
        for row in 0..3 {
            for column in [pose.matrix3.x_axis, pose.matrix3.y_axis, pose.matrix3.z_axis, pose.translation] {
                table += &format!(",{:.9}", column[row]);
            }
        }
        table.push('\n');
    }
    table
}
