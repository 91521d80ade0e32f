//! What of a film is given to whoever answers it, and a folder that holds just that.
//!
//! ```text
//! participant/participant.json          frames, breathing period, hash of each file below
//! participant/FORMAT.md                 this layout in words, the same in every folder
//! participant/images/NNNNNN.png         all frames
//! participant/transforms.json           intrinsics; per frame the given pose and the time
//! participant/transforms_novel.json     poses of the second cameras; their pictures are nowhere
//! participant/depth/000000.exr          depth of the first frame, and of no other
//! participant/mesh/inspiration.ply, expiration.ply   the two CTs, with the registration's error where there is one
//! participant/centerline.csv            points of the centreline at inspiration
//! participant/targets.csv               targets as planned at inspiration
//! participant/mask.png                  only with a mask
//! ```
//!
//! Nothing else is in it: no phase, no exposure, no other depth, no place of a target but the planned one, no case, no
//! seed, and no hash of anything that is not in it. Its files have one fixed time of change, so that the order and the
//! time in which they were made tell nothing either. Whoever knows the case file can film it again, of course: a blind
//! comparison needs a case that is not published.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use glam::{DAffine3, DVec3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::film_tables::{given_frames, points_csv, read_points};
use super::sequence::{self, NovelView, PARTICIPANT, Sequence};
use crate::base::range::BREATHING_PERIOD_S;
use crate::base::{Camera, Error, Image, Mask, Result, TriangleMesh, files, hash};
use crate::formats::transforms::{Transforms, TransformsFrame, TransformsLens};
use crate::formats::{exr, mesh, png};

/// Time of change of every file and folder: the first second of 2000, in seconds of Unix.
const CHANGED_S: u64 = 946_684_800;
/// Keys of a frame that are told, in a participant's folder and in exports; every other one is left out, so that none of
/// the truth goes out.
pub(super) const FRAME_KEYS: [&str; 5] = ["file_path", "depth_file_path", "mask_path", "transform_matrix", "time"];
/// First line of the participant's centreline.
const CENTERLINE_HEADER: &str = "point,x_mm,y_mm,z_mm";

/// Time and given pose of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GivenFrame {
    /// Seconds since the first frame.
    pub time_s: f64,
    /// Given pose in the scanner frame.
    pub world_from_camera: DAffine3,
}

/// What is told of the mean duration of a breath: two digits, as a monitor shows it. A film's waveform is tuned to end at a
/// phase that is drawn for the case, so that all digits of its period, put into the waveform's formula, would be the phase of
/// every frame.
fn told_period_s(period_s: f64) -> f64 {
    format!("{period_s:.1e}").parse().unwrap_or(period_s)
}

/// A film as methods may see it: the whole film behind this trait, or a participant's folder.
pub trait Given: Send + Sync {
    /// Intrinsics of all frames.
    fn given_camera(&self) -> Camera;

    /// Time and pose of each frame.
    fn given_frames(&self) -> Vec<GivenFrame>;

    /// Whether the poses are a sensor's (the clinical track), and not the true ones.
    fn given_poses_are_measured(&self) -> bool;

    /// Second cameras, in order of their frames.
    fn given_views(&self) -> &[NovelView];

    /// Mean duration of a breath in seconds, to two digits.
    fn given_period_s(&self) -> f64;

    /// Targets as planned at inspiration, mm.
    fn planned_targets_mm(&self) -> Vec<DVec3>;

    /// 8-bit sRGB image of a frame.
    fn given_image(&self, frame: usize) -> Result<Image<u8>>;

    /// Which pixels of all frames show something; `None`: all.
    fn given_mask(&self) -> Result<Option<Mask>>;

    /// CT surface at inspiration.
    fn given_inspiration(&self) -> Result<TriangleMesh>;

    /// CT surface at expiration, same faces, with the registration's error.
    fn given_expiration(&self) -> Result<TriangleMesh>;

    /// Points of the centreline at inspiration, mm.
    fn given_centerline_mm(&self) -> Result<Vec<DVec3>>;

    /// z-depth of the first frame in mm, 0 where nothing was hit.
    fn first_depth_mm(&self) -> Result<Image<f32>>;

    /// True phase of each frame, for the bound that is told it; `None` where the truth is elsewhere.
    fn true_phase(&self) -> Option<Vec<f64>>;
}

impl Given for Sequence {
    fn given_camera(&self) -> Camera {
        self.clinical.as_ref().map_or(self.camera, |clinical| clinical.told_camera)
    }

    fn given_frames(&self) -> Vec<GivenFrame> {
        let given = |(index, f): (usize, &sequence::FrameRecord)| GivenFrame {
            time_s: f.time_s,
            world_from_camera: self.clinical.as_ref().map_or(f.world_from_camera, |c| c.told_poses[index]),
        };
        self.frames.iter().enumerate().map(given).collect()
    }

    fn given_poses_are_measured(&self) -> bool {
        self.clinical.is_some()
    }

    fn given_views(&self) -> &[NovelView] {
        self.clinical.as_ref().map_or(&self.novel_views, |clinical| &clinical.told_views)
    }

    fn given_period_s(&self) -> f64 {
        told_period_s(self.breathing_period_s)
    }

    fn planned_targets_mm(&self) -> Vec<DVec3> {
        self.targets.iter().map(|target| target.inspiration_mm).collect()
    }

    fn given_image(&self, frame: usize) -> Result<Image<u8>> {
        self.image(frame)
    }

    fn given_mask(&self) -> Result<Option<Mask>> {
        self.mask()
    }

    fn given_inspiration(&self) -> Result<TriangleMesh> {
        self.told_inspiration()
    }

    fn given_expiration(&self) -> Result<TriangleMesh> {
        self.registered_expiration()
    }

    fn given_centerline_mm(&self) -> Result<Vec<DVec3>> {
        Ok(self.told_centerline()?.points.iter().map(|point| point.position_mm).collect())
    }

    fn first_depth_mm(&self) -> Result<Image<f32>> {
        self.depth_mm(0)
    }

    fn true_phase(&self) -> Option<Vec<f64>> {
        Some(self.frames.iter().map(|f| f.phase).collect())
    }
}

#[derive(Clone, Debug, Serialize, Deserialize)]
struct ParticipantHead {
    frames: usize,
    breathing_period_s: f64,
    /// Whether the poses are a sensor's; what was written before that was said does not say it.
    #[serde(default)]
    poses_are_measured: bool,
    /// Hash of each other file, by its name relative to the folder.
    files: BTreeMap<String, String>,
}

/// An opened participant's folder.
#[derive(Clone, Debug)]
pub struct Participant {
    root: PathBuf,
    camera: Camera,
    frames: Vec<GivenFrame>,
    novel_views: Vec<NovelView>,
    breathing_period_s: f64,
    poses_are_measured: bool,
    targets_mm: Vec<DVec3>,
    mask_path: Option<String>,
    files: BTreeMap<String, String>,
}

impl Participant {
    /// Whether `root` is a participant's folder.
    pub fn is_at(root: &Path) -> bool {
        root.join(PARTICIPANT).is_file()
    }

    /// Opens a participant's folder. Errors name the file that is missing, damaged or not what `participant.json` says.
    pub fn open(root: &Path) -> Result<Participant> {
        if !root.is_dir() {
            return Err(Error::input("there is no such folder").at(root));
        }
        let manifest = root.join(PARTICIPANT);
        let head: ParticipantHead = files::read_json(&manifest)?;
        BREATHING_PERIOD_S.check(head.breathing_period_s).map_err(|e| e.element("breathing_period_s").at(&manifest))?;
        let path = sequence::checked(PARTICIPANT, &head.files, root, sequence::TRANSFORMS)?;
        let transforms = Transforms::read(&path)?;
        if transforms.frames.len() != head.frames || head.frames == 0 {
            let sentence = format!("has {} frames, {PARTICIPANT} says {}", transforms.frames.len(), head.frames);
            return Err(Error::input(sentence).at(path));
        }
        let given = given_frames(&transforms).map_err(|e| e.at(&path))?;
        let frames =
            given.into_iter().map(|(time_s, world_from_camera)| GivenFrame { time_s, world_from_camera }).collect();
        let at = |name: &str| sequence::checked(PARTICIPANT, &head.files, root, name);
        Ok(Participant {
            root: root.to_path_buf(),
            camera: transforms.camera().map_err(|e| e.at(&path))?,
            frames,
            novel_views: sequence::novel_views(&at(sequence::NOVEL_TRANSFORMS)?, head.frames)?,
            breathing_period_s: head.breathing_period_s,
            poses_are_measured: head.poses_are_measured,
            targets_mm: read_points(&at(sequence::TARGETS)?, "target")?,
            mask_path: transforms.frames[0].mask_path.clone(),
            files: head.files,
        })
    }

    /// Compares every file with `participant.json`, and refuses a file that it does not list.
    pub fn verify(&self) -> Result<()> {
        let names: Vec<&String> = self.files.keys().collect();
        names.into_par_iter().map(|name| self.checked(name).err()).find_map_first(|e| e).map_or(Ok(()), Err)?;
        for path in files::all_in(&self.root)? {
            let name = path.strip_prefix(&self.root).unwrap_or(&path).to_string_lossy().into_owned();
            if name != PARTICIPANT && !self.files.contains_key(&name) {
                return Err(Error::input("is no file of a participant's folder").at(path));
            }
        }
        Ok(())
    }

    /// Reads every file. The error names the first that cannot be read.
    pub fn check(&self) -> Result<usize> {
        self.verify()?;
        (0..self.frames.len()).into_par_iter().try_for_each(|frame| self.given_image(frame).map(drop))?;
        self.given_mask()?;
        self.first_depth_mm()?;
        self.given_centerline_mm()?;
        if self.given_inspiration()?.faces != self.given_expiration()?.faces {
            return Err(Error::input("the two surfaces have different faces").at(&self.root));
        }
        Ok(self.frames.len())
    }

    fn checked(&self, name: &str) -> Result<PathBuf> {
        sequence::checked(PARTICIPANT, &self.files, &self.root, name)
    }
}

impl Given for Participant {
    fn given_camera(&self) -> Camera {
        self.camera
    }

    fn given_frames(&self) -> Vec<GivenFrame> {
        self.frames.clone()
    }

    fn given_poses_are_measured(&self) -> bool {
        self.poses_are_measured
    }

    fn given_views(&self) -> &[NovelView] {
        &self.novel_views
    }

    fn given_period_s(&self) -> f64 {
        self.breathing_period_s
    }

    fn planned_targets_mm(&self) -> Vec<DVec3> {
        self.targets_mm.clone()
    }

    fn given_image(&self, frame: usize) -> Result<Image<u8>> {
        let path = self.checked(&sequence::image_name(frame))?;
        let image = png::read_rgb(&path)?;
        sequence::check_size(&self.camera, image.width, image.height, &path)?;
        Ok(image)
    }

    fn given_mask(&self) -> Result<Option<Mask>> {
        self.mask_path.as_ref().map(|name| sequence::read_mask(&self.camera, &self.checked(name)?)).transpose()
    }

    fn given_inspiration(&self) -> Result<TriangleMesh> {
        mesh::read(&self.checked(sequence::INSPIRATION)?)
    }

    fn given_expiration(&self) -> Result<TriangleMesh> {
        mesh::read(&self.checked(sequence::EXPIRATION)?)
    }

    fn given_centerline_mm(&self) -> Result<Vec<DVec3>> {
        read_points(&self.checked(sequence::CENTERLINE)?, "point")
    }

    fn first_depth_mm(&self) -> Result<Image<f32>> {
        let path = self.checked(&sequence::depth_name(0))?;
        let depth = exr::read(&path)?;
        sequence::check_size(&self.camera, depth.width, depth.height, &path)?;
        Ok(depth)
    }

    fn true_phase(&self) -> Option<Vec<f64>> {
        None
    }
}

/// Names of the film's files that a participant gets as they are, beside the names they get there.
fn copied_names(film: &Sequence) -> Vec<(String, String)> {
    let same = |name: String| (name.clone(), name);
    let mut names: Vec<(String, String)> =
        (0..film.frames.len()).map(|frame| same(sequence::image_name(frame))).collect();
    names.push(same(sequence::depth_name(0)));
    names.push((film.given_inspiration_name().into(), sequence::INSPIRATION.into()));
    names.push((film.registered_expiration_name().into(), sequence::EXPIRATION.into()));
    names.push(same(sequence::TARGETS.into()));
    names.extend(film.mask_name().map(|name| same(name.to_owned())));
    names
}

/// Refuses a folder that [`write()`] would not replace: one that is neither empty nor a participant's, or holds anything
/// else beside a participant's files, an answer for example.
pub fn check_replaceable(out: &Path) -> Result<()> {
    let is_empty = !out.exists() || out.read_dir().map_err(|e| Error::io("reading", out, e))?.next().is_none();
    if is_empty {
        return Ok(());
    }
    if !Participant::is_at(out) {
        return Err(Error::input("is neither empty nor a participant's folder: nothing is overwritten").at(out));
    }
    let head: ParticipantHead = files::read_json(&out.join(PARTICIPANT))?;
    let is_own = |path: &Path| {
        let name = path.strip_prefix(out).ok().and_then(Path::to_str);
        name.is_some_and(|name| name == PARTICIPANT || head.files.contains_key(name))
    };
    match files::all_in(out)?.iter().find(|path| !is_own(path)) {
        Some(other) => {
            let sentence =
                "is no file of the participant's folder around it, which would be replaced: move it elsewhere";
            Err(Error::input(sentence).at(other))
        }
        None => Ok(()),
    }
}

/// Writes what participants get of `film` into the folder `out`, in place of what they got of an earlier film there.
///
/// Errors: a file of the film that is not what was filmed; a folder that is neither empty nor a participant's.
pub fn write(film: &Sequence, out: &Path) -> Result<Participant> {
    let failed = |e| Error::io("writing", out, e);
    check_replaceable(out)?;
    let parent = out.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    fs::create_dir_all(parent).map_err(failed)?;
    let staged = tempfile::Builder::new().prefix(".unfinished-").tempdir_in(parent).map_err(failed)?;
    let folder = staged.path().join("participant");
    for (from, to) in copied_names(film) {
        files::write_bytes(&folder.join(to), &files::read_bytes(&film.checked(&from)?)?)?;
    }
    write_tables(film, &folder)?;
    let mut listed = BTreeMap::new();
    for path in files::all_in(&folder)? {
        let name = path.strip_prefix(&folder).unwrap_or(&path).to_string_lossy().into_owned();
        listed.insert(name, hash::of_file(&path)?);
    }
    let head = ParticipantHead {
        frames: film.frames.len(),
        breathing_period_s: film.given_period_s(),
        poses_are_measured: film.given_poses_are_measured(),
        files: listed,
    };
    files::write_json(&folder.join(PARTICIPANT), &head)?;
    files::set_modified_below(&folder, SystemTime::UNIX_EPOCH + Duration::from_secs(CHANGED_S))?;
    if out.exists() {
        fs::remove_dir_all(out).map_err(|e| Error::io("removing", out, e))?;
    }
    fs::rename(&folder, out).and_then(|()| File::open(parent)?.sync_all()).map_err(failed)?;
    Participant::open(out)
}

/// The files that the film has in another form.
fn write_tables(film: &Sequence, folder: &Path) -> Result<()> {
    let entry = |file_path: String, time: f64, pose: &DAffine3| TransformsFrame {
        file_path,
        depth_file_path: None,
        mask_path: film.mask_name().map(str::to_owned),
        transform_matrix: TransformsFrame::matrix(pose),
        time,
        breathing_phase: None,
        exposure: 1.0,
        white_balance: [1.0; 3],
        lens: TransformsLens::default(),
    };
    let given = film.given_frames();
    let frames = given.iter().enumerate();
    let mut entries: Vec<TransformsFrame> =
        frames.map(|(i, f)| entry(sequence::image_name(i), f.time_s, &f.world_from_camera)).collect();
    entries[0].depth_file_path = Some(sequence::depth_name(0));
    write_transforms(&film.given_camera(), entries, &folder.join(sequence::TRANSFORMS))?;
    let view = |view: &NovelView| {
        let time_s = film.frames[view.frame].time_s;
        entry(sequence::novel_image_name(view.frame), time_s, &view.world_from_camera)
    };
    let entries = film.given_views().iter().map(view).collect();
    write_transforms(&film.given_camera(), entries, &folder.join(sequence::NOVEL_TRANSFORMS))?;
    let points = film.given_centerline_mm()?;
    let table = points_csv(CENTERLINE_HEADER, points.into_iter());
    files::write_bytes(&folder.join(sequence::CENTERLINE), table.as_bytes())?;
    files::write_bytes(&folder.join(sequence::FORMAT), include_bytes!("PARTICIPANT.md"))
}

/// Writes the transforms with [`FRAME_KEYS`] alone: what is not told stands nowhere, not even as a default.
fn write_transforms(camera: &Camera, entries: Vec<TransformsFrame>, path: &Path) -> Result<()> {
    let failed = |e: serde_json::Error| Error::input(e.to_string()).at(path);
    let mut value = serde_json::to_value(Transforms::new(camera, entries)).map_err(failed)?;
    let frames = value.get_mut("frames").and_then(serde_json::Value::as_array_mut);
    for frame in frames.into_iter().flatten().filter_map(serde_json::Value::as_object_mut) {
        frame.retain(|key, _| FRAME_KEYS.contains(&key.as_str()));
    }
    files::write_json(path, &value)
}
