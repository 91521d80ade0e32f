//! A prediction on disk: what `evaluate` reads, from whichever program it comes.
//!
//! ```text
//! color/NNNNNN.png               one per frame, 8-bit sRGB, the sequence's size           needed
//! depth/NNNNNN.{exr,npy,png}     one per frame, z-depth in mm, 0 = none; PNG: 16-bit grey times depth_unit_mm
//! ahead/NNNNNN.png               renderings made before the method read the frame's image; frames 7, 15, .., all of them
//! novel/NNNNNN.png               views of the sequence's second cameras (transforms_novel.json): all of them or none
//! novel_depth/NNNNNN.{exr,npy,png}  their z-depth, as above
//! targets.csv                    frame,target,x_mm,y_mm,z_mm; where the targets of the sequence are, every frame
//! target_covariance.csv          frame,target,xx,xy,xz,yy,yz,zz in mm^2: covariance of each target's place in the camera's
//!                                axes (x right, y down, z forward), every frame; wants targets.csv
//! phase.csv                      frame,phase[,phase_sd]; one row per frame, 0 = full inspiration, 1 = full expiration
//! poses.csv                      frame,m00..m23; world_from_camera where the method has poses of its own; camera axes as
//!                                above (OpenCV's, not those of transforms.json)
//! mesh/final.ply                 surface at the last frame, mm, the sequence's world
//! correspondence.csv             vertex,face,b0,b1,b2 or vertex,predicted_vertex: where each vertex of the sequence's
//!                                meshes is on final.ply, which is needed if it has other faces
//! timing.json                    {"time_total_s": wall seconds of the method alone, "time_cpu_s": its CPU seconds}, or one
//! prediction.json                {"method": id, "case": id, "depth_unit_mm": 1.0}
//! ```

use std::collections::BTreeMap;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use glam::{DAffine3, DMat3, DVec3};
use serde::Deserialize;

use super::correspondence;
use super::truth::Truth;
use crate::base::depth::check_predicted_depth;
use crate::base::range::{
    COORDINATE_MM, COVARIANCE_MM2, NumberRange, PREDICTED_PHASE, PREDICTED_PHASE_SD, WORK_TIME_S,
};
use crate::base::{Camera, Error, Image, Result, TriangleMesh, files, pose};
use crate::formats::number_table::{self, COUNT, Column, NumberRow};
use crate::formats::prediction::{
    ABOUT, AHEAD, COLOR, CORRESPONDENCE, COVARIANCE_COLUMNS, DEPTH, DEPTH_ENDINGS, FINAL_MESH, NOVEL, NOVEL_DEPTH,
    PHASE, PHASE_COLUMNS, PICTURE_ENDING, POSE_COLUMNS, POSES, SINGLE_FILES, TARGET_COLUMNS, TARGET_COVARIANCE,
    TARGETS, TIMING, TIMING_KEYS, frame_name,
};
use crate::formats::{depth_png, exr, mesh, npy, png};
use crate::simulate::participant::{Given, Participant};
use crate::simulate::sequence::held_out;

/// What a prediction has to answer: known to whoever has the film, and to participants, who have no truth.
#[derive(Clone, Debug)]
pub struct Question {
    /// Intrinsics of all frames.
    pub camera: Camera,
    /// Frames.
    pub frames: usize,
    /// Frames with a second camera, ascending.
    pub novel_frames: Vec<usize>,
    /// Where each target was planned, at inspiration, mm.
    pub planned_targets_mm: Vec<DVec3>,
    /// The pose of every frame as it is given.
    pub given_poses: Vec<DAffine3>,
    /// Whether there are coughs or touches of the wall, where it may be known.
    pub is_disturbed: Option<bool>,
    /// Vertices of the true surface, where they are known: `correspondence.csv` has a row for each.
    vertices: Option<usize>,
    /// The case, where it may be known.
    case_id: Option<String>,
    /// Files of the truth, which a prediction must not hand back by a link.
    true_files: Vec<PathBuf>,
}

impl Question {
    /// What the film of `truth` asks.
    pub fn of(truth: &dyn Truth) -> Self {
        Question {
            camera: *truth.camera(),
            frames: truth.frames().len(),
            novel_frames: truth.novel_views().iter().map(|view| view.frame).collect(),
            planned_targets_mm: truth.targets().iter().map(|target| target.inspiration_mm).collect(),
            given_poses: truth.told_poses(),
            is_disturbed: truth.disturbed().ok().map(|frames| frames.contains(&true)),
            vertices: None,
            case_id: Some(truth.case_id().to_owned()),
            true_files: truth.file_paths(),
        }
    }

    /// The same, with the number of vertices of the true surface, where it may be known.
    pub fn with_vertices(self, vertices: Option<usize>) -> Self {
        Question { vertices, ..self }
    }

    /// That number.
    pub fn vertices(&self) -> Option<usize> {
        self.vertices
    }

    /// The same for somebody without the truth.
    pub fn of_participant(participant: &Participant) -> Self {
        Question {
            camera: participant.given_camera(),
            frames: participant.given_frames().len(),
            novel_frames: participant.given_views().iter().map(|view| view.frame).collect(),
            planned_targets_mm: participant.planned_targets_mm(),
            given_poses: participant.given_frames().iter().map(|frame| frame.world_from_camera).collect(),
            is_disturbed: None,
            vertices: None,
            case_id: None,
            true_files: Vec::new(),
        }
    }
}

/// An opened prediction folder.
#[derive(Clone, Debug)]
pub struct Prediction {
    root: PathBuf,
    width: usize,
    height: usize,
    depth_ending: Option<&'static str>,
    depth_unit_mm: f64,
    ahead: Vec<usize>,
    /// Frames whose second camera's view is predicted: all of the sequence's or none.
    novel: bool,
    novel_depth_ending: Option<&'static str>,
    /// Per frame, per target; mm.
    targets: Option<Vec<Vec<DVec3>>>,
    /// Per frame, per target; mm^2, camera axes.
    target_covariance_mm2: Option<Vec<Vec<DMat3>>>,
    method: Option<String>,
    phase: Option<Vec<f64>>,
    /// Standard deviation of each phase.
    phase_sd: Option<Vec<f64>>,
    poses: Option<Vec<DAffine3>>,
    time_total_s: Option<f64>,
    time_cpu_s: Option<f64>,
}

/// Millimetres of a depth unit: from a nanometre to a kilometre.
const DEPTH_UNIT_MM: NumberRange = NumberRange::new(1e-6, 1e6);
/// Entries of a pose's matrix: of a rotation, or of a place in mm.
const ENTRY: NumberRange = COORDINATE_MM;
#[derive(Default, Deserialize)]
struct About {
    method: Option<String>,
    case: Option<String>,
    depth_unit_mm: Option<f64>,
}

#[derive(Deserialize)]
struct TimingFile {
    time_total_s: Option<f64>,
    time_cpu_s: Option<f64>,
}

impl Prediction {
    /// The folder.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Opens `root` as an answer to `question`: lists its contents and reads the small files.
    ///
    /// Errors, each naming the file: a frame missing from a folder that is there, a bad row, a bad value, a prediction
    /// that says that it is of another case, a file that is one of the truth's own.
    pub fn open(root: &Path, question: &Question) -> Result<Self> {
        if !root.is_dir() {
            return Err(Error::input("is not a folder").at(root));
        }
        // A pipe would be read for ever, and a link to nothing is no file that was left out.
        let is_there = |path: &PathBuf| path.symlink_metadata().is_ok();
        let mut files = SINGLE_FILES.iter().map(|name| root.join(name)).filter(is_there);
        if let Some(path) = files.find(|path| !path.is_file()) {
            return Err(Error::input("is no file").at(path));
        }
        let mut folders = [COLOR, DEPTH, AHEAD, NOVEL, NOVEL_DEPTH].map(|name| root.join(name)).into_iter();
        if let Some(path) = folders.find(|path| is_there(path) && !path.is_dir()) {
            return Err(Error::input("is no folder").at(path));
        }
        let (camera, frames) = (&question.camera, question.frames);
        let about: About = read_optional(&root.join(ABOUT))?.unwrap_or_default();
        if let (Some(case), Some(asked)) = (&about.case, &question.case_id)
            && case != asked
        {
            let sentence = format!("is `{case}`, but the film is of `{asked}`");
            return Err(Error::input(sentence).element("case").at(root.join(ABOUT)));
        }
        let depth_unit_mm = about.depth_unit_mm.unwrap_or(1.0);
        DEPTH_UNIT_MM.check(depth_unit_mm).map_err(|e| e.element("depth_unit_mm").at(root.join(ABOUT)))?;
        expect_frames(&root.join(COLOR), PICTURE_ENDING, 0..frames)?;
        let own_depth = depth_ending(&root.join(DEPTH), 0)?;
        if let Some(ending) = own_depth {
            expect_frames(&root.join(DEPTH), ending, 0..frames)?;
        }
        let views = &question.novel_frames;
        let first = views.first().copied().unwrap_or(0);
        let novel = !views.is_empty() && root.join(NOVEL).is_dir();
        if novel {
            expect_frames(&root.join(NOVEL), PICTURE_ENDING, views.iter().copied())?;
        }
        let novel_depth_ending = if views.is_empty() { None } else { depth_ending(&root.join(NOVEL_DEPTH), first)? };
        if let Some(ending) = novel_depth_ending {
            expect_frames(&root.join(NOVEL_DEPTH), ending, views.iter().copied())?;
        }
        let targets = question.planned_targets_mm.len();
        let (phase, phase_sd) = read_phase(&root.join(PHASE), frames)?.unzip();
        let [time_total_s, time_cpu_s] = read_time(&root.join(TIMING))?;
        let prediction = Prediction {
            width: camera.width as usize,
            height: camera.height as usize,
            depth_ending: own_depth,
            depth_unit_mm,
            ahead: ahead_frames(&root.join(AHEAD), frames)?,
            novel,
            novel_depth_ending,
            targets: read_targets(&root.join(TARGETS), frames, targets)?,
            target_covariance_mm2: read_covariance(&root.join(TARGET_COVARIANCE), frames, targets)?,
            method: about.method,
            phase,
            phase_sd: phase_sd.flatten(),
            poses: read_poses(&root.join(POSES), frames)?,
            time_total_s,
            time_cpu_s,
            root: root.to_path_buf(),
        };
        if prediction.target_covariance_mm2.is_some() && prediction.targets.is_none() {
            return Err(Error::input(format!("is there without {TARGETS}")).at(root.join(TARGET_COVARIANCE)));
        }
        prediction.refuse_true_files(question)?;
        Ok(prediction)
    }

    /// Refuses a prediction that hands the truth back by a link: a file of it that is, on disk, one of the truth's own.
    fn refuse_true_files(&self, question: &Question) -> Result<()> {
        let identity = |path: &Path| path.metadata().ok().map(|found| (found.dev(), found.ino()));
        let own: BTreeMap<(u64, u64), PathBuf> =
            question.true_files.iter().filter_map(|path| Some((identity(path)?, path.clone()))).collect();
        let link = self.file_paths(question.frames).find_map(|path| Some((own.get(&identity(&path)?)?, path)));
        match link {
            Some((truth, path)) => {
                Err(Error::input(format!("is a link to the truth ({}), not a prediction", truth.display())).at(path))
            }
            None => Ok(()),
        }
    }

    /// Every file that scoring may read, there or not.
    pub(super) fn file_paths(&self, frames: usize) -> impl Iterator<Item = PathBuf> {
        let folders = [
            (COLOR, Some(PICTURE_ENDING)),
            (DEPTH, self.depth_ending),
            (AHEAD, Some(PICTURE_ENDING)),
            (NOVEL, Some(PICTURE_ENDING)),
            (NOVEL_DEPTH, self.novel_depth_ending),
        ];
        let of_folder = move |(folder, ending): (&str, Option<&'static str>)| {
            let folder = self.root.join(folder);
            ending.into_iter().flat_map(move |ending| {
                let folder = folder.clone();
                (0..frames).map(move |frame| frame_path(&folder, frame, ending))
            })
        };
        folders.into_iter().flat_map(of_folder).chain(SINGLE_FILES.map(|name| self.root.join(name)))
    }

    /// The method's own name, if the folder tells it.
    pub fn method(&self) -> Option<&str> {
        self.method.as_deref()
    }

    /// Rendered image of `frame`; of the sequence's size.
    pub fn color(&self, frame: usize) -> Result<Image<u8>> {
        self.image(COLOR, frame)
    }

    /// Rendering of `frame` made before the method read its image.
    pub fn ahead(&self, frame: usize) -> Result<Image<u8>> {
        self.image(AHEAD, frame)
    }

    /// Frames with an [`Prediction::ahead`] image, ascending.
    pub fn ahead_frames(&self) -> &[usize] {
        &self.ahead
    }

    /// Whether the views of the second cameras are predicted.
    pub fn has_novel_views(&self) -> bool {
        self.novel
    }

    /// Rendering from the second camera of `frame`.
    pub fn novel(&self, frame: usize) -> Result<Image<u8>> {
        self.image(NOVEL, frame)
    }

    /// Predicted places of the targets in mm, per frame and target, if there are any.
    pub fn targets(&self) -> Option<&[Vec<DVec3>]> {
        self.targets.as_deref()
    }

    /// Stated covariances of the targets' places in the camera's axes in mm^2, per frame and target, if there are any.
    pub fn target_covariance_mm2(&self) -> Option<&[Vec<DMat3>]> {
        self.target_covariance_mm2.as_deref()
    }

    /// Predicted z-depth of `frame` in mm, if the prediction has depth.
    pub fn depth_mm(&self, frame: usize) -> Result<Option<Image<f32>>> {
        self.depth(DEPTH, self.depth_ending, frame)
    }

    /// Predicted z-depth of the second camera of `frame` in mm, if the prediction has it.
    pub fn novel_depth_mm(&self, frame: usize) -> Result<Option<Image<f32>>> {
        self.depth(NOVEL_DEPTH, self.novel_depth_ending, frame)
    }

    fn depth(&self, folder: &str, ending: Option<&str>, frame: usize) -> Result<Option<Image<f32>>> {
        let Some(ending) = ending else { return Ok(None) };
        let path = frame_path(&self.root.join(folder), frame, ending);
        let image = match ending {
            "exr" => exr::read(&path)?,
            "npy" => npy::read_plane(&path)?,
            _ => depth_png::read(&path, self.depth_unit_mm)?,
        };
        self.expect_size(&path, image.width, image.height)?;
        if image.channels != 1 {
            return Err(Error::input(format!("has {} channels; depth has one", image.channels)).at(path));
        }
        check_predicted_depth(&image).map_err(|e| e.at(path))?;
        Ok(Some(image))
    }

    /// Predicted phase of every frame, if there is one.
    pub fn phase(&self) -> Option<&[f64]> {
        self.phase.as_deref()
    }

    /// Standard deviation of the predicted phase of every frame, if it is stated.
    pub fn phase_sd(&self) -> Option<&[f64]> {
        self.phase_sd.as_deref()
    }

    /// Predicted pose (world from camera, mm) of every frame, if there is one.
    pub fn poses(&self) -> Option<&[DAffine3]> {
        self.poses.as_deref()
    }

    /// Wall seconds of the method alone, if known.
    pub fn time_total_s(&self) -> Option<f64> {
        self.time_total_s
    }

    /// CPU seconds of the method alone, if known.
    pub fn time_cpu_s(&self) -> Option<f64> {
        self.time_cpu_s
    }

    /// Predicted surface at the last frame, if there is one; valid (indices and coordinates in range).
    pub fn final_mesh(&self) -> Result<Option<TriangleMesh>> {
        let path = self.root.join(FINAL_MESH);
        if !path.exists() {
            return Ok(None);
        }
        let surface = mesh::read(&path)?;
        surface.validate().map_err(|e| e.at(&path))?;
        let is_near = |place: &DVec3| place.to_array().into_iter().all(|v| COORDINATE_MM.contains(v));
        if let Some(far) = surface.vertices.iter().position(|place| !is_near(place)) {
            let sentence = format!("lies at {} mm; coordinates lie in {COORDINATE_MM}", surface.vertices[far]);
            return Err(Error::input(sentence).element(format!("vertex {far}")).at(path));
        }
        Ok(Some(surface))
    }

    /// Where the vertices of the sequence's meshes are on the predicted surface, if the prediction says so, mm.
    ///
    /// Errors: a bad row; a table without a surface.
    pub fn correspondence(&self) -> Result<Option<Vec<DVec3>>> {
        let path = self.root.join(CORRESPONDENCE);
        if !path.exists() {
            return Ok(None);
        }
        let Some(surface) = self.final_mesh()? else {
            return Err(Error::input(format!("is there without {FINAL_MESH}")).at(path));
        };
        correspondence::parse(&files::read_bytes(&path)?, &surface).map(Some).map_err(|e| e.at(path))
    }

    fn image(&self, folder: &str, frame: usize) -> Result<Image<u8>> {
        let path = frame_path(&self.root.join(folder), frame, PICTURE_ENDING);
        let image = png::read_rgb(&path)?;
        self.expect_size(&path, image.width, image.height)?;
        Ok(image)
    }

    fn expect_size(&self, path: &Path, width: usize, height: usize) -> Result<()> {
        if (width, height) == (self.width, self.height) {
            return Ok(());
        }
        Err(Error::input(format!(
            "is {width}x{height} pixels; the sequence is {}x{} (nothing is rescaled)",
            self.width, self.height
        ))
        .at(path))
    }
}

fn frame_path(folder: &Path, frame: usize, ending: &str) -> PathBuf {
    folder.join(frame_name(frame, ending))
}

fn expect_frames(folder: &Path, ending: &str, mut frames: impl Iterator<Item = usize> + Clone) -> Result<()> {
    if !folder.is_dir() {
        return Err(Error::input("the folder is missing").at(folder));
    }
    let last = frames.clone().last().unwrap_or(0);
    match frames.clone().map(|frame| frame_path(folder, frame, ending)).find(|path| !path.is_file()) {
        Some(path) => {
            let first = frames.next().unwrap_or(0);
            Err(Error::input(format!("is missing; there must be one for each of {first:06} to {last:06}")).at(path))
        }
        None => Ok(()),
    }
}

/// The known ending that frame `first` has; `None` without the folder.
fn depth_ending(folder: &Path, first: usize) -> Result<Option<&'static str>> {
    if !folder.is_dir() {
        return Ok(None);
    }
    match DEPTH_ENDINGS.into_iter().find(|ending| frame_path(folder, first, ending).is_file()) {
        Some(ending) => Ok(Some(ending)),
        None => {
            let names = DEPTH_ENDINGS.map(|ending| frame_name(first, ending)).join(", ");
            Err(Error::input(format!("has none of {names}")).at(folder))
        }
    }
}

/// Every eighth frame, where the folder is there: all or none, so that nobody shows the best ones alone.
fn ahead_frames(folder: &Path, frames: usize) -> Result<Vec<usize>> {
    let eighths = (0..frames).filter(|&frame| held_out(frame));
    if !folder.is_dir() {
        return Ok(Vec::new());
    }
    expect_frames(folder, PICTURE_ENDING, eighths.clone())?;
    Ok(eighths.collect())
}

/// The keys of a JSON file, if it is there. (An array of values, of which serde would make a struct too, has none.)
fn read_optional<T: serde::de::DeserializeOwned>(path: &Path) -> Result<Option<T>> {
    if !path.exists() {
        return Ok(None);
    }
    let keys: serde_json::Map<String, serde_json::Value> = files::read_json(path)?;
    serde_json::from_value(keys.into()).map(Some).map_err(|e| Error::input(e.to_string()).at(path))
}

/// Wall and CPU seconds.
fn read_time(path: &Path) -> Result<[Option<f64>; 2]> {
    let Some(told) = read_optional::<TimingFile>(path)? else { return Ok([None; 2]) };
    for (key, seconds) in TIMING_KEYS.into_iter().zip([told.time_total_s, told.time_cpu_s]) {
        let Some(seconds) = seconds else { continue };
        if seconds == 0.0 {
            let sentence = "is 0: no method takes no time; leave it out if it is not known";
            return Err(Error::input(sentence).element(key).at(path));
        }
        WORK_TIME_S.check(seconds).map_err(|e| e.element(key).at(path))?;
    }
    Ok([told.time_total_s, told.time_cpu_s])
}

/// Phases, and their standard deviations where they are stated.
type Phases = (Vec<f64>, Option<Vec<f64>>);

fn read_phase(path: &Path, frames: usize) -> Result<Option<Phases>> {
    if !path.exists() {
        return Ok(None);
    }
    parse_phase(&files::read_bytes(path)?, frames).map(Some).map_err(|e| e.at(path))
}

fn read_targets(path: &Path, frames: usize, count: usize) -> Result<Option<Vec<Vec<DVec3>>>> {
    if !path.exists() {
        return Ok(None);
    }
    parse_targets(&files::read_bytes(path)?, frames, count).map(Some).map_err(|e| e.at(path))
}

/// Columns of which the first `counts` say what a row is of, and the others have values in `range`.
fn columns<const N: usize>(names: [&'static str; N], counts: usize, range: NumberRange) -> [Column<'static>; N] {
    std::array::from_fn(|k| (names[k], if k < counts { COUNT } else { range }))
}

/// Columns of frame, target and place, found by name; frames in order, within each frame the targets in order.
fn parse_targets(bytes: &[u8], frames: usize, count: usize) -> Result<Vec<Vec<DVec3>>> {
    let columns = columns(TARGET_COLUMNS, 2, COORDINATE_MM);
    let value = |&[_, _, x, y, z]: &[f64; 5]| Some(DVec3::new(x, y, z));
    by_target(&number_table::rows(bytes, columns)?, frames, count, "its place", value)
}

fn read_covariance(path: &Path, frames: usize, count: usize) -> Result<Option<Vec<Vec<DMat3>>>> {
    if !path.exists() {
        return Ok(None);
    }
    parse_covariance(&files::read_bytes(path)?, frames, count).map(Some).map_err(|e| e.at(path))
}

/// Columns of frame, target and the six entries of a covariance in mm squared, found by name; rows as those of
/// [`parse_targets`].
fn parse_covariance(bytes: &[u8], frames: usize, count: usize) -> Result<Vec<Vec<DMat3>>> {
    let columns = columns(COVARIANCE_COLUMNS, 2, COVARIANCE_MM2);
    let covariance = |&[_, _, xx, xy, xz, yy, yz, zz]: &[f64; 8]| {
        let is_sound = xx > 0.0 && xx * yy - xy * xy > 0.0;
        let matrix = DMat3::from_cols_array(&[xx, xy, xz, xy, yy, yz, xz, yz, zz]);
        (is_sound && matrix.determinant() > 0.0).then_some(matrix)
    };
    by_target(&number_table::rows(bytes, columns)?, frames, count, "a positive definite covariance", covariance)
}

/// What `value` makes of each row, by frame and target, which are the first two numbers of the rows: frames in order,
/// within each frame the targets in order. `what` names the value, where a row has none.
fn by_target<const N: usize, T>(
    rows: &[NumberRow<N>],
    frames: usize,
    count: usize,
    what: &str,
    value: impl Fn(&[f64; N]) -> Option<T>,
) -> Result<Vec<Vec<T>>> {
    let mut values: Vec<Vec<T>> = (0..frames).map(|_| Vec::with_capacity(count)).collect();
    for (at, row) in rows.iter().enumerate() {
        let (frame, target, numbers) = (at / count.max(1), at % count.max(1), &row.numbers);
        let is_next = numbers[..2] == [frame as f64, target as f64] && frame < frames && count > 0;
        let Some(value) = is_next.then(|| value(numbers)).flatten() else {
            let sentence = format!("wanted frame {frame} of {frames}, target {target} of {count} and {what}");
            return Err(row.refuse(Error::input(sentence)));
        };
        values[frame].push(value);
    }
    match values.iter().position(|of_frame| of_frame.len() < count) {
        Some(frame) => Err(Error::input(format!("frame {frame} lacks targets: {count} are wanted"))),
        None => Ok(values),
    }
}

fn read_poses(path: &Path, frames: usize) -> Result<Option<Vec<DAffine3>>> {
    if !path.exists() {
        return Ok(None);
    }
    parse_poses(&files::read_bytes(path)?, frames).map(Some).map_err(|e| e.at(path))
}

/// Columns of the frame and of the three upper rows of world_from_camera, found by name; frames in order.
fn parse_poses(bytes: &[u8], frames: usize) -> Result<Vec<DAffine3>> {
    let columns = columns(POSE_COLUMNS, 1, ENTRY);
    let mut poses = Vec::with_capacity(frames);
    for (frame, row) in number_table::rows(bytes, columns)?.iter().enumerate() {
        let numbers = &row.numbers;
        if numbers[0] != frame as f64 || frame >= frames {
            return Err(row.refuse(Error::input(format!("wanted frame {frame} of {frames}"))));
        }
        let column = |k: usize| DVec3::new(numbers[1 + k], numbers[5 + k], numbers[9 + k]);
        let pose = DAffine3::from_mat3_translation(DMat3::from_cols(column(0), column(1), column(2)), column(3));
        pose::check(&pose, COORDINATE_MM).map_err(|e| row.refuse(Error::input(format!("world_from_camera {e}"))))?;
        poses.push(pose);
    }
    if poses.len() < frames {
        return Err(Error::input(format!("frame {} is missing", poses.len())));
    }
    Ok(poses)
}

/// Columns `frame`, `phase` and perhaps `phase_sd` by name, rows in any order, every frame exactly once.
fn parse_phase(bytes: &[u8], frames: usize) -> Result<Phases> {
    let [frame, phase, sd] = PHASE_COLUMNS;
    let [frame, phase, sd] = [(frame, COUNT), (phase, PREDICTED_PHASE), (sd, PREDICTED_PHASE_SD)];
    let has_sd = number_table::has_column(bytes, sd.0)?;
    let without_sd = |NumberRow { line, numbers: [f, p] }| NumberRow { line, numbers: [f, p, 0.0] };
    let rows: Vec<NumberRow<3>> = match has_sd {
        true => number_table::rows(bytes, [frame, phase, sd])?,
        false => number_table::rows(bytes, [frame, phase])?.into_iter().map(without_sd).collect(),
    };
    let mut phases: Vec<Option<(f64, f64)>> = vec![None; frames];
    for row in &rows {
        let [frame, phase, sd] = row.numbers;
        let Some(place) = phases.get_mut(frame as usize).filter(|_| frame.fract() == 0.0) else {
            return Err(row.refuse(Error::input(format!("{frame} is no frame below {frames}"))));
        };
        if place.replace((phase, sd)).is_some() {
            return Err(row.refuse(Error::input(format!("frame {frame} is there twice"))));
        }
    }
    if let Some(frame) = phases.iter().position(Option::is_none) {
        return Err(Error::input(format!("frame {frame} is missing")));
    }
    let (phase, sd): (Vec<f64>, Vec<f64>) = phases.into_iter().flatten().unzip();
    Ok((phase, has_sd.then_some(sd)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn phases_are_read_by_name_in_any_order() {
        let (phases, none) = parse_phase(b"phase,frame,extra\n0.5,1,x\n0.25,0,y\n", 2).unwrap();
        assert_eq!((phases.as_slice(), none), (&[0.25, 0.5][..], None));
        let (_, sd) = parse_phase(b"frame,phase,phase_sd\n0,0.5,0.1\n1,0.5,0.2\n", 2).unwrap();
        assert_eq!(sd.unwrap(), [0.1, 0.2]);
    }

    #[test]
    fn targets_are_read_frame_by_frame_and_their_damage_is_named() {
        let text = b"frame,target,x_mm,y_mm,z_mm\n0,0,1,2,3\n0,1,4,5,6\n1,0,1,2,4\n1,1,4,5,7\n";
        let places = parse_targets(text, 2, 2).unwrap();
        assert_eq!(places[1], [DVec3::new(1.0, 2.0, 4.0), DVec3::new(4.0, 5.0, 7.0)]);
        let say = |text: &[u8], frames| parse_targets(text, frames, 2).unwrap_err().to_string();
        assert!(say(text, 3).contains("frame 2 lacks targets") && say(text, 1).contains("line 4"));
        assert!(say(b"frame,target,x_mm,y_mm,z_mm\n0,0,1,2,nan\n", 1).contains("line 2"));
        assert!(say(b"frame,target,x_mm,y_mm,z_mm\n0,1,1,2,3\n", 1).contains("line 2"));
        // Columns are what their names say, whatever their order.
        assert_eq!(
            parse_targets(b"z_mm,frame,y_mm,target,x_mm\n3,0,2,0,1\n", 1, 1).unwrap(),
            [[DVec3::new(1.0, 2.0, 3.0)]]
        );
        assert!(say(b"frame,target,x,y,z\n0,0,1,2,3\n0,1,4,5,6\n", 1).contains("column x_mm: is missing"));
        assert!(say(b"frame,target,x_mm,y_mm,z_mm\n0,0,n/a,1,2,3\n", 1).contains("line 2"));
        assert!(say(b"frame,target,x_mm,y_mm,z_mm\n0,0,1,2,1e200\n", 1).contains("line 2: z_mm: 1e200 must lie"));
    }

    #[test]
    fn covariances_are_read_target_by_target_and_must_be_positive_definite() {
        let text = |zz: f64| format!("frame,target,xx,xy,xz,yy,yz,zz\n0,0,4,1,-1,2,0.5,{zz}\n");
        let read = parse_covariance(text(9.0).as_bytes(), 1, 1).unwrap();
        assert_eq!(read[0][0], DMat3::from_cols_array(&[4.0, 1.0, -1.0, 1.0, 2.0, 0.5, -1.0, 0.5, 9.0]));
        for (wrong, says) in [(text(-1.0), "line 2"), (text(f64::NAN), "line 2"), (text(1.0).repeat(2), "line 3")] {
            assert!(parse_covariance(wrong.as_bytes(), 1, 1).unwrap_err().to_string().contains(says), "{wrong}");
        }
    }

    #[test]
    fn poses_are_read_row_by_row_and_their_damage_is_named() {
        let text = "frame,m00,m01,m02,m03,m10,m11,m12,m13,m20,m21,m22,m23\n0,1,0,0,7,0,0,-1,8,0,1,0,9\n";
        let pose = parse_poses(text.as_bytes(), 1).unwrap()[0];
        assert_eq!(pose.transform_point3(DVec3::new(1.0, 2.0, 3.0)), DVec3::new(8.0, 5.0, 11.0));
        assert!(parse_poses(text.as_bytes(), 2).unwrap_err().to_string().contains("frame 1 is missing"));
        let say = |text: &str| parse_poses(text.as_bytes(), 1).unwrap_err().to_string();
        assert!(say("frame,m00,m01\n0,1,2\n").contains("column m02: is missing"));
        assert!(say(&text.replace("0,1,0,0,7", "0,n/a,1,0,0,7")).contains("line 2"));
        assert!(say(&text.replace("0,1,0,0,7", "0,1,0,0,1e200")).contains("line 2: m03: 1e200 must lie"));
        for (from, to) in [("0,1,0,0,7", "0,0,0,0,7"), ("0,1,0,0,7", "0,-1,0,0,7"), ("0,1,0,0,7", "0,2,0,0,7")] {
            let said = say(&text.replace(from, to));
            assert!(said.contains("line 2: world_from_camera is no rotation"), "{said}");
        }
    }

    #[test]
    fn damage_in_phases_is_named() {
        let say = |text: &str| parse_phase(text.as_bytes(), 2).unwrap_err().to_string();
        assert!(say("frame,phase\n0,0.1\n").contains("frame 1 is missing"));
        assert!(say("frame,phase\n0,0.1\n0,0.2\n").contains("line 3"));
        assert!(say("frame,phase\n0,nan\n").contains("line 2"));
        assert!(say("frame,phase\n0,1e200\n").contains("line 2"));
        assert!(say("frame,phase\n7,0.1\n").contains("line 2"));
        assert!(say("frame\n0\n").contains("column phase"));
        assert!(say("frame,phase\n0\n").contains("line 2"));
        assert!(say("").contains("column frame"));
        assert!(say("frame,phase,phase\n0,0.1,0.5\n1,0.2,0.5\n").contains("column phase: is there twice"));
        assert!(say("frame,phase\n0.5,0.1\n1,0.2\n").contains("line 2"));
        for sd in ["", "0", "-1", "inf", "1e200"] {
            assert!(say(&format!("frame,phase,phase_sd\n0,0.1,0.1\n1,0.2,{sd}\n")).contains("line 3"), "{sd}");
        }
    }
}
