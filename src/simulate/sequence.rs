//! A sequence on disk: the one place that knows its file names.
//!
//! The manifest holds the hash of every file. Whatever is read here is compared with it first, so that a film whose
//! images were exchanged is refused and never scored.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use glam::{DAffine3, DVec3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

#[cfg(feature = "methods")]
use crate::airway::case::AnatomySource;
use crate::airway::case_centerline;
use crate::airway::centerline::Centerline;
use crate::airway::target::Target;
use crate::base::range::{BREATHING_PERIOD_S, NumberRange, SHARE};
use crate::base::{Camera, Error, Image, Mask, Result, TriangleMesh, case_id, files, hash};
use crate::formats::transforms::{Transforms, TransformsFrame, TransformsLens};
use crate::formats::{exr, mesh, png};

use super::film_tables::{disturbed, film_pose, given_frames, read_points, targets_by_frame};

/// Record of one frame, truth included.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameRecord {
    /// Time since the first frame in seconds.
    pub time_s: f64,
    /// True breathing phase.
    pub phase: f64,
    /// Exposure gain that was applied to the linear radiance.
    pub gain: f64,
    /// White-balance factors applied to red, green and blue.
    pub white_balance: [f64; 3],
    /// True pose in the scanner frame.
    pub world_from_camera: DAffine3,
}

/// A second camera at the instant of a frame, whose picture no method sees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NovelView {
    /// The frame.
    pub frame: usize,
    /// True pose in the scanner frame.
    pub world_from_camera: DAffine3,
}

/// An opened sequence folder.
#[derive(Clone, Debug)]
pub struct Sequence {
    /// The folder.
    pub root: PathBuf,
    /// Which case was filmed.
    pub case_id: String,
    /// Content hash of everything that determines the sequence.
    pub hash: String,
    /// Intrinsics, the same for all frames.
    pub camera: Camera,
    /// One record per frame, in order.
    pub frames: Vec<FrameRecord>,
    /// Views that no method fits, in order of their frames.
    pub novel_views: Vec<NovelView>,
    /// Mean duration of a breath in seconds.
    pub breathing_period_s: f64,
    /// What navigation is after.
    pub targets: Vec<Target>,
    /// Hash of what the film holds, 64 hex digits: of its case, and of the content of every file that methods and
    /// metrics read.
    pub content: String,
    /// What a film of the clinical track has beside; `None` is the ideal track.
    pub clinical: Option<ClinicalTruth>,
    /// Mask of all frames, relative to the folder.
    mask_path: Option<String>,
    /// Hash of each file, by its name relative to the folder.
    files: BTreeMap<String, String>,
}

/// What methods of the clinical track are told in place of the truth, and the part of the truth that no phase says.
#[derive(Clone, Debug)]
pub struct ClinicalTruth {
    /// Intrinsics that methods are told.
    pub told_camera: Camera,
    /// Pose of each frame that they are told.
    pub told_poses: Vec<DAffine3>,
    /// Second cameras as they are told.
    pub told_views: Vec<NovelView>,
    /// Place of each target at each frame, mm.
    pub target_places: Vec<Vec<DVec3>>,
}

/// The part of `manifest.json` that this program reads; the rest is for people and other programs.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct ManifestHead {
    pub case_id: String,
    pub hash: String,
    pub frames: usize,
    pub breathing_period_s: f64,
    /// Hash of each file but this one and the plan, by its name relative to the folder.
    pub files: BTreeMap<String, String>,
}

impl ManifestHead {
    /// Where the file `name` of the film in `root` lies, once its content has been compared with the hash here.
    fn checked(&self, root: &Path, name: &str) -> Result<PathBuf> {
        checked(MANIFEST, &self.files, root, name)
    }

    /// Names of the files of the film in `root` that are missing or not what they were when it was finished, in order.
    pub fn changed(&self, root: &Path) -> Vec<String> {
        let names: Vec<&String> = self.files.keys().collect();
        names.into_par_iter().filter(|name| self.checked(root, name).is_err()).cloned().collect()
    }
}

/// Where the file `name` in `root` lies, once its content has been compared with its hash in `files`, which are those of
/// the file `manifest`.
pub(super) fn checked(manifest: &str, files: &BTreeMap<String, String>, root: &Path, name: &str) -> Result<PathBuf> {
    let path = root.join(name);
    let refused = |why: String| Err(Error::input(why).at(&path));
    match files.get(name) {
        None => refused(format!("is not listed in the film's {manifest}; film the case again with `simulate`")),
        Some(wanted) if hash::of_file(&path)? != *wanted => {
            let what = "is not the file that was filmed: its content does not have the hash that";
            refused(format!("{what} {manifest} gives"))
        }
        Some(_) => Ok(path),
    }
}

/// Written last: a folder with it is complete.
pub const MANIFEST: &str = "manifest.json";
/// Written first: what the folder is going to be.
pub const PLAN: &str = "plan.json";

/// Manifest of a participant's folder.
pub const PARTICIPANT: &str = "participant.json";

/// Gains and factors of the white balance.
const FACTOR: NumberRange = NumberRange::new(1e-12, 1e12);

/// One frame in this many is held out.
const HELD_OUT_PERIOD: usize = 8;

/// Whether `frame` is one of 7, 15, ..: methods render it before they may use its image, and a second camera that they
/// never see films it.
pub fn held_out(frame: usize) -> bool {
    frame % HELD_OUT_PERIOD == HELD_OUT_PERIOD - 1
}

/// `images/NNNNNN.png`.
pub fn image_name(frame: usize) -> String {
    format!("images/{frame:06}.png")
}

/// `depth/NNNNNN.exr`.
pub fn depth_name(frame: usize) -> String {
    format!("depth/{frame:06}.exr")
}

/// `novel/NNNNNN.png`, the view of the second camera at a frame.
pub fn novel_image_name(frame: usize) -> String {
    format!("novel/{frame:06}.png")
}

/// `novel_depth/NNNNNN.exr`.
pub fn novel_depth_name(frame: usize) -> String {
    format!("novel_depth/{frame:06}.exr")
}

/// `radiance/NNNNNN.exr`, on request.
pub fn radiance_name(frame: usize) -> String {
    format!("radiance/{frame:06}.exr")
}

/// `normal/NNNNNN.exr`, on request.
pub fn normal_name(frame: usize) -> String {
    format!("normal/{frame:06}.exr")
}

/// `albedo/NNNNNN.exr`, on request.
pub fn albedo_name(frame: usize) -> String {
    format!("albedo/{frame:06}.exr")
}

/// `motion_forward/NNNNNN.exr`, on request; the last frame has none.
pub fn forward_motion_name(frame: usize) -> String {
    format!("motion_forward/{frame:06}.exr")
}

/// `motion_backward/NNNNNN.exr`, on request; the first frame has none.
pub fn backward_motion_name(frame: usize) -> String {
    format!("motion_backward/{frame:06}.exr")
}

/// `phase_sensitivity/NNNNNN.exr`, on request.
pub fn sensitivity_name(frame: usize) -> String {
    format!("phase_sensitivity/{frame:06}.exr")
}

/// `covered/NNNNNN.png`, on the clinical track.
pub fn covered_name(frame: usize) -> String {
    format!("covered/{frame:06}.png")
}

/// `mesh/frame_NNNNNN.ply`, on request.
pub fn frame_mesh_name(frame: usize) -> String {
    format!("mesh/frame_{frame:06}.ply")
}

/// Surface at full inspiration.
pub const INSPIRATION: &str = "mesh/inspiration.ply";
/// Surface at full expiration, same faces.
pub const EXPIRATION: &str = "mesh/expiration.ply";
/// Surface at full expiration with the registration's error, where the case has one.
pub const REGISTERED_EXPIRATION: &str = "mesh/expiration_registered.ply";
/// Surface at the last frame, on the clinical track: no phase says where it is.
pub const LAST_SURFACE: &str = "mesh/last_frame.ply";
/// What methods of the clinical track are told: cameras, second cameras, the two surfaces.
pub const TOLD_TRANSFORMS: &str = "told/transforms.json";
/// See [`TOLD_TRANSFORMS`].
pub const TOLD_NOVEL_TRANSFORMS: &str = "told/transforms_novel.json";
/// See [`TOLD_TRANSFORMS`].
pub const TOLD_INSPIRATION: &str = "told/inspiration.ply";
/// See [`TOLD_TRANSFORMS`].
pub const TOLD_EXPIRATION: &str = "told/expiration.ply";
/// The centreline of the told surface at inspiration.
pub const TOLD_CENTERLINE: &str = "told/centerline.csv";
/// Where each true vertex is on the surfaces that methods are told, where those have other faces.
pub const TOLD_CORRESPONDENCE: &str = "told/correspondence.csv";
/// Truth of the clinical track's effects per frame.
pub const CONDITIONS: &str = "clinical.csv";
/// Sizes of the clinical track's effects in this film.
pub const SIZES: &str = "clinical.json";
/// Where the targets are at every frame, on the clinical track.
pub const TARGETS_BY_FRAME: &str = "targets_by_frame.csv";
/// Centreline at inspiration.
pub const CENTERLINE: &str = "centerline.csv";
/// Cameras and truth in nerfstudio's layout.
pub const TRANSFORMS: &str = "transforms.json";
/// Targets as planned on the CT at inspiration.
pub const TARGETS: &str = "targets.csv";
/// Where the targets are at full expiration: truth.
pub const TARGETS_EXPIRATION: &str = "targets_expiration.csv";
/// The second cameras in nerfstudio's layout.
pub const NOVEL_TRANSFORMS: &str = "transforms_novel.json";
/// Truth as a table.
pub const FRAMES: &str = "frames.csv";
/// The layout in words.
pub const FORMAT: &str = "FORMAT.md";
/// Where the images hold something, when the scope has a mask.
pub const MASK: &str = "mask.png";
/// A few frames at a glance.
pub const CONTACT_SHEET: &str = "contact_sheet.png";
/// The film, small, as an animated PNG.
pub const PREVIEW: &str = "preview.png";
/// Files for people, which neither methods nor metrics read.
const FOR_PEOPLE: [&str; 3] = [FORMAT, CONTACT_SHEET, PREVIEW];
/// Folders that hold one file per frame or mesh.
pub(super) const FOLDERS: [&str; 13] = [
    "images",
    "depth",
    "novel",
    "novel_depth",
    "radiance",
    "normal",
    "albedo",
    "motion_forward",
    "motion_backward",
    "phase_sensitivity",
    "mesh",
    "covered",
    "told",
];

/// Whether `folder` is the film's or a participant's in `root`, or one that holds its files: nothing else may be written there.
pub fn holds_files_of(root: &Path, folder: &Path) -> bool {
    let (Ok(root), Ok(folder)) = (root.canonicalize(), folder.canonicalize()) else { return false };
    folder == root || FOLDERS.iter().any(|name| folder.starts_with(root.join(name)))
}

impl Sequence {
    /// Opens a finished sequence folder.
    ///
    /// Errors name the file: no manifest (not a sequence, or not finished), truth that is missing, damaged, or not what
    /// the manifest says. Images, depths and meshes are compared with it when they are read.
    pub fn open(root: &Path) -> Result<Sequence> {
        let manifest = root.join(MANIFEST);
        if !manifest.is_file() {
            let why = if !root.is_dir() {
                "there is no such folder"
            } else if root.join(PLAN).is_file() {
                "the sequence is not finished; the command that made it resumes it"
            } else if root.join(PARTICIPANT).is_file() {
                "is a participant's folder, which holds no truth; the whole film is in the folder `truth` made with it"
            } else {
                "is not a sequence folder: it has no manifest.json"
            };
            return Err(Error::input(why).at(root));
        }
        let head: ManifestHead = files::read_json(&manifest)?;
        case_id::check(&head.case_id).map_err(|e| e.element("case_id").at(&manifest))?;
        BREATHING_PERIOD_S.check(head.breathing_period_s).map_err(|e| e.element("breathing_period_s").at(&manifest))?;
        let path = head.checked(root, TRANSFORMS)?;
        let transforms = Transforms::read(&path)?;
        if transforms.frames.len() != head.frames || head.frames == 0 {
            let sentence = format!("has {} frames, the manifest says {}", transforms.frames.len(), head.frames);
            return Err(Error::input(sentence).at(path));
        }
        let given = given_frames(&transforms).map_err(|e| e.at(&path))?;
        let mut frames = Vec::with_capacity(head.frames);
        for (index, (frame, given)) in transforms.frames.iter().zip(given).enumerate() {
            frames.push(record(frame, given).map_err(|e| e.element(format!("frame {index}")).at(&path))?);
        }
        let camera = transforms.camera().map_err(|e| e.at(&path))?;
        let mask_path = transforms.frames[0].mask_path.clone();
        let novel_views = novel_views(&head.checked(root, NOVEL_TRANSFORMS)?, head.frames)?;
        let targets = targets(&head.checked(root, TARGETS)?, &head.checked(root, TARGETS_EXPIRATION)?)?;
        let is_clinical = head.files.contains_key(TOLD_TRANSFORMS) || root.join(TOLD_TRANSFORMS).exists();
        let clinical = match is_clinical {
            true => Some(clinical_truth(&head, root, &camera, &novel_views, targets.len())?),
            false => None,
        };
        let read = head.files.iter().filter(|(name, _)| !FOR_PEOPLE.contains(&name.as_str()));
        let content = hash::of_value(&(&head.case_id, &head.hash, read.collect::<BTreeMap<_, _>>()))?;
        let ManifestHead { case_id, hash, files, breathing_period_s, .. } = head;
        Ok(Sequence {
            root: root.to_path_buf(),
            case_id,
            hash,
            camera,
            frames,
            novel_views,
            breathing_period_s,
            targets,
            content,
            clinical,
            mask_path,
            files,
        })
    }

    /// Whose airway was filmed, as its case file says; empty where the film does not tell.
    #[cfg(feature = "methods")]
    pub fn tree(&self) -> String {
        #[derive(Deserialize)]
        struct Filmed {
            case: FilmedCase,
        }
        #[derive(Deserialize)]
        struct FilmedCase {
            anatomy: AnatomySource,
        }
        files::read_json::<Filmed>(&self.root.join(MANIFEST)).map_or_else(|_| String::new(), |f| f.case.anatomy.tree())
    }

    /// Where target `index` is at `frame`, mm.
    pub fn target_mm(&self, index: usize, frame: usize) -> DVec3 {
        match &self.clinical {
            None => self.targets[index].at(self.frames[frame].phase),
            Some(clinical) => clinical.target_places[frame][index],
        }
    }

    /// Which frames a cough or a touch of the wall disturbs; none on the ideal track. Errors as [`Sequence::image`].
    pub fn disturbed(&self) -> Result<Vec<bool>> {
        if self.clinical.is_none() {
            return Ok(vec![false; self.frames.len()]);
        }
        let path = self.checked(CONDITIONS)?;
        disturbed(&files::read_bytes(&path)?, self.frames.len()).map_err(|e| e.at(&path))
    }

    /// The surface at the last frame where no phase says it; `None` on the ideal track. Errors as [`Sequence::image`].
    pub fn last_surface(&self) -> Result<Option<TriangleMesh>> {
        self.clinical.as_ref().map(|_| mesh::read(&self.checked(LAST_SURFACE)?)).transpose()
    }

    /// The surface at inspiration that methods are told, and the table that says where each true vertex is on it; `None`
    /// where it has the true faces. Errors as [`Sequence::image`].
    pub fn told_correspondence(&self) -> Result<Option<(TriangleMesh, Vec<u8>)>> {
        if !self.files.contains_key(TOLD_CORRESPONDENCE) {
            return Ok(None);
        }
        let table = files::read_bytes(&self.checked(TOLD_CORRESPONDENCE)?)?;
        Ok(Some((self.told_inspiration()?, table)))
    }

    /// Name of the file of the surface at inspiration that methods are given.
    pub(super) fn given_inspiration_name(&self) -> &'static str {
        if self.clinical.is_some() { TOLD_INSPIRATION } else { INSPIRATION }
    }

    /// Compares every file of the film with the manifest. The error names the first one that is missing or another.
    pub fn verify(&self) -> Result<()> {
        let names: Vec<&String> = self.files.keys().collect();
        names.into_par_iter().map(|name| self.checked(name).err()).find_map_first(|e| e).map_or(Ok(()), Err)
    }

    /// All files of the film but manifest and plan.
    pub fn file_paths(&self) -> impl Iterator<Item = PathBuf> {
        self.files.keys().map(|name| self.root.join(name))
    }

    /// Where the file `name` lies, once its content has been compared with the manifest.
    pub(super) fn checked(&self, name: &str) -> Result<PathBuf> {
        checked(MANIFEST, &self.files, &self.root, name)
    }

    /// The 8-bit sRGB image of a frame. Errors name a file that is missing, damaged or of another size.
    pub fn image(&self, frame: usize) -> Result<Image<u8>> {
        self.picture(&image_name(frame))
    }

    /// True z-depth of a frame in mm, 0 where nothing was hit. Errors as [`Sequence::image`].
    pub fn depth_mm(&self, frame: usize) -> Result<Image<f32>> {
        self.depth(&depth_name(frame))
    }

    /// What the second camera of `frame` saw. Errors as [`Sequence::image`].
    pub fn novel_image(&self, frame: usize) -> Result<Image<u8>> {
        self.picture(&novel_image_name(frame))
    }

    /// True z-depth in mm of the second camera of `frame`. Errors as [`Sequence::image`].
    pub fn novel_depth_mm(&self, frame: usize) -> Result<Image<f32>> {
        self.depth(&novel_depth_name(frame))
    }

    fn picture(&self, name: &str) -> Result<Image<u8>> {
        let path = self.checked(name)?;
        let image = png::read_rgb(&path)?;
        self.check_size(image.width, image.height, &path)?;
        Ok(image)
    }

    fn depth(&self, name: &str) -> Result<Image<f32>> {
        let path = self.checked(name)?;
        let depth = exr::read(&path)?;
        self.check_size(depth.width, depth.height, &path)?;
        if depth.channels != 1 {
            return Err(Error::input(format!("has {} channels instead of 1", depth.channels)).at(path));
        }
        Ok(depth)
    }

    /// Which pixels of the images count, `None` where all do: those of the scope's mask, less one pixel at its rim,
    /// which the mask may hide in part. Errors name a file that is missing, damaged, of another size, or hides
    /// everything.
    pub fn mask(&self) -> Result<Option<Mask>> {
        let Some(name) = &self.mask_path else { return Ok(None) };
        read_mask(&self.camera, &self.checked(name)?).map(Some)
    }

    /// Name of the mask of all frames, if there is one.
    pub(super) fn mask_name(&self) -> Option<&str> {
        self.mask_path.as_deref()
    }

    /// Surface at full inspiration; normals point into the lumen.
    pub fn inspiration(&self) -> Result<TriangleMesh> {
        mesh::read(&self.checked(INSPIRATION)?)
    }

    /// Surface at full expiration, same faces as [`Sequence::inspiration`].
    pub fn expiration(&self) -> Result<TriangleMesh> {
        mesh::read(&self.checked(EXPIRATION)?)
    }

    /// The surface at inspiration that methods are given.
    pub(super) fn told_inspiration(&self) -> Result<TriangleMesh> {
        mesh::read(&self.checked(self.given_inspiration_name())?)
    }

    /// The surface at full expiration that methods are given: with the registration's error, where the case has one.
    pub fn registered_expiration(&self) -> Result<TriangleMesh> {
        mesh::read(&self.checked(self.registered_expiration_name())?)
    }

    /// Name of that surface's file.
    pub(super) fn registered_expiration_name(&self) -> &'static str {
        if self.clinical.is_some() {
            return TOLD_EXPIRATION;
        }
        // A file that the manifest does not know is refused, not passed over.
        let is_there = self.files.contains_key(REGISTERED_EXPIRATION) || self.root.join(REGISTERED_EXPIRATION).exists();
        if is_there { REGISTERED_EXPIRATION } else { EXPIRATION }
    }

    /// Centreline at inspiration.
    pub fn centerline(&self) -> Result<Centerline> {
        case_centerline::read(&self.checked(CENTERLINE)?)
    }

    /// The centreline at inspiration that methods are given: that of the surface that they are given. Films of the clinical
    /// track from before it was told have the true one.
    pub(super) fn told_centerline(&self) -> Result<Centerline> {
        if self.clinical.is_some() && self.files.contains_key(TOLD_CENTERLINE) {
            return case_centerline::read(&self.checked(TOLD_CENTERLINE)?);
        }
        self.centerline()
    }

    fn check_size(&self, width: usize, height: usize, path: &Path) -> Result<()> {
        check_size(&self.camera, width, height, path)
    }
}

/// Refuses an image in `path` that is not of the camera's size.
pub(super) fn check_size(camera: &Camera, width: usize, height: usize, path: &Path) -> Result<()> {
    let (w, h) = (camera.width as usize, camera.height as usize);
    if (width, height) != (w, h) {
        return Err(Error::input(format!("is {width}x{height}, the camera is {w}x{h}")).at(path));
    }
    Ok(())
}

/// The pixels that count by the mask in `path`: its own, less one pixel at the rim.
pub(super) fn read_mask(camera: &Camera, path: &Path) -> Result<Mask> {
    let image = png::read_rgb(path)?;
    check_size(camera, image.width, image.height, path)?;
    Mask::from_image(&image).and_then(|mask| mask.eroded(1)).map_err(|e| e.at(path))
}

/// Frame that `name` is the second camera's picture of; `None` where it is none.
fn novel_frame(name: &str) -> Option<usize> {
    let frame = name.strip_prefix("novel/")?.strip_suffix(".png")?.parse().ok()?;
    (novel_image_name(frame) == name).then_some(frame)
}

/// The second cameras of a film of `frames` frames. Errors name file and entry: a pose that is none, a name that is
/// none of a view, views that do not follow each other in the order of their frames.
pub(super) fn novel_views(path: &Path, frames: usize) -> Result<Vec<NovelView>> {
    let transforms = Transforms::read(path)?;
    let mut views: Vec<NovelView> = Vec::with_capacity(transforms.frames.len());
    for (index, entry) in transforms.frames.iter().enumerate() {
        let refused = |why: String| Error::input(why).element(format!("frame {index}")).at(path);
        let Some(frame) = novel_frame(&entry.file_path).filter(|&frame| frame < frames) else {
            return Err(refused(format!("{} is no view of this film", entry.file_path)));
        };
        if views.last().is_some_and(|before| before.frame >= frame) {
            return Err(refused(format!("{} does not follow the view before it", entry.file_path)));
        }
        let world_from_camera = film_pose(entry).map_err(|e| e.element(format!("frame {index}")).at(path))?;
        views.push(NovelView { frame, world_from_camera });
    }
    Ok(views)
}

/// Reads what is told of the film of the clinical track in `root`, and where its `targets` targets are at every frame.
/// It must have the frames, the picture's size and the second cameras of the truth.
fn clinical_truth(
    head: &ManifestHead,
    root: &Path,
    camera: &Camera,
    views: &[NovelView],
    targets: usize,
) -> Result<ClinicalTruth> {
    let path = head.checked(root, TOLD_TRANSFORMS)?;
    let told = Transforms::read(&path)?;
    if told.frames.len() != head.frames {
        let sentence = format!("has {} frames, the manifest says {}", told.frames.len(), head.frames);
        return Err(Error::input(sentence).at(path));
    }
    let told_camera = told.camera().map_err(|e| e.at(&path))?;
    check_size(camera, told_camera.width as usize, told_camera.height as usize, &path)?;
    let told_poses = given_frames(&told).map_err(|e| e.at(&path))?.into_iter().map(|(_, pose)| pose).collect();
    let path = head.checked(root, TOLD_NOVEL_TRANSFORMS)?;
    let told_views = novel_views(&path, head.frames)?;
    let of_frames = |views: &[NovelView]| views.iter().map(|view| view.frame).collect::<Vec<_>>();
    if of_frames(&told_views) != of_frames(views) {
        return Err(Error::input(format!("has other views than {NOVEL_TRANSFORMS}")).at(path));
    }
    let path = head.checked(root, TARGETS_BY_FRAME)?;
    let target_places = targets_by_frame(&files::read_bytes(&path)?, head.frames, targets).map_err(|e| e.at(&path))?;
    Ok(ClinicalTruth { told_camera, told_poses, told_views, target_places })
}

fn targets(planned: &Path, truth: &Path) -> Result<Vec<Target>> {
    let (inspiration, expiration) = (read_points(planned, "target")?, read_points(truth, "target")?);
    if inspiration.len() != expiration.len() {
        let sentence = format!("has {} targets, {TARGETS} has {}", expiration.len(), inspiration.len());
        return Err(Error::input(sentence).at(truth));
    }
    let pair = |(inspiration_mm, expiration_mm)| Target { inspiration_mm, expiration_mm };
    Ok(inspiration.into_iter().zip(expiration).map(pair).collect())
}

/// The record of a frame whose time and pose are `given`.
fn record(frame: &TransformsFrame, (time_s, world_from_camera): (f64, DAffine3)) -> Result<FrameRecord> {
    let check = |key: &'static str, range: NumberRange, value: f64| {
        range.check(value).map_err(|e| Error::input(format!("{key}: {e}")))
    };
    check("breathing_phase", SHARE, frame.breathing_phase.unwrap_or_default())?;
    check("exposure", FACTOR, frame.exposure)?;
    frame.white_balance.iter().try_for_each(|&factor| check("white_balance", FACTOR, factor))?;
    Ok(FrameRecord {
        time_s,
        phase: frame.breathing_phase.ok_or_else(|| Error::input("has no breathing_phase"))?,
        gain: frame.exposure,
        white_balance: frame.white_balance,
        world_from_camera,
    })
}

/// The nerfstudio entry of a second camera at the instant of `frame`.
pub(super) fn novel_entry(view: &NovelView, frame: &FrameRecord, masked: bool) -> TransformsFrame {
    TransformsFrame {
        file_path: novel_image_name(view.frame),
        depth_file_path: Some(novel_depth_name(view.frame)),
        ..transforms_frame(view.frame, &FrameRecord { world_from_camera: view.world_from_camera, ..*frame }, masked)
    }
}

/// The nerfstudio entry of a frame.
pub(super) fn transforms_frame(index: usize, frame: &FrameRecord, masked: bool) -> TransformsFrame {
    TransformsFrame {
        file_path: image_name(index),
        depth_file_path: Some(depth_name(index)),
        mask_path: masked.then(|| MASK.to_string()),
        transform_matrix: TransformsFrame::matrix(&frame.world_from_camera),
        time: frame.time_s,
        breathing_phase: Some(frame.phase),
        exposure: frame.gain,
        white_balance: frame.white_balance,
        lens: TransformsLens::default(),
    }
}

#[cfg(test)]
mod tests {
    use glam::{DMat3, DVec3};

    use super::*;

    fn view(name: &str, x_mm: f64) -> TransformsFrame {
        TransformsFrame {
            file_path: name.into(),
            depth_file_path: None,
            mask_path: None,
            transform_matrix: TransformsFrame::matrix(&DAffine3::from_mat3_translation(
                DMat3::IDENTITY,
                DVec3::X * x_mm,
            )),
            time: 0.0,
            breathing_phase: None,
            exposure: 1.0,
            white_balance: [1.0; 3],
            lens: TransformsLens::default(),
        }
    }

    #[test]
    fn folders_of_a_film_are_known() {
        let film = tempfile::tempdir().unwrap();
        let place = |name: &str| film.path().join(name);
        ["images", "masks"].iter().for_each(|name| std::fs::create_dir(place(name)).unwrap());
        let found = ["", "images", "masks", "nowhere"].map(|name| holds_files_of(film.path(), &place(name)));
        assert_eq!(found, [true, true, false, false]);
        assert!(!holds_files_of(film.path(), film.path().parent().unwrap()));
    }

    #[test]
    fn views_are_found_by_their_names_once_and_in_order() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("transforms_novel.json");
        let read = |frames: usize, entries: Vec<TransformsFrame>| {
            Transforms::new(&Camera::pinhole(4, 4, 1.0), entries).write(&path).unwrap();
            novel_views(&path, frames).map_err(|e| e.to_string())
        };
        let named = |names: &[&str]| names.iter().map(|name| view(name, 1.0)).collect::<Vec<_>>();
        let found = read(16, named(&["novel/000007.png", "novel/000015.png"])).unwrap();
        assert_eq!(found.iter().map(|view| view.frame).collect::<Vec<_>>(), [7, 15]);
        for (names, says) in [
            (&["novel/000007.png", "novel/000007.png"][..], "frame 1: novel/000007.png does not follow"),
            (&["novel/000015.png", "novel/000007.png"], "frame 1: novel/000007.png does not follow"),
            (&["novel/000016.png"], "frame 0: novel/000016.png is no view of this film"),
            (&["novel/7.png"], "is no view"),
            (&["novel/+00007.png"], "is no view"),
            (&["images/000007.png"], "is no view"),
        ] {
            let said = read(16, named(names)).unwrap_err();
            assert!(said.contains("transforms_novel.json") && said.contains(says), "{said}");
        }
        assert!(read(16, vec![view("novel/000007.png", 1e200)]).unwrap_err().contains("transform_matrix lies too far"));
        // Names of all frames were made for every view: minutes for a film of this length.
        let (frames, start) = (100_000, std::time::Instant::now());
        let all = (7..frames).step_by(8).map(|frame| view(&novel_image_name(frame), 1.0)).collect();
        assert_eq!(read(frames, all).unwrap().len(), frames / 8);
        assert!(start.elapsed().as_secs() < 20, "{:?}", start.elapsed());
    }
}
