//! From anatomy to a filmed sequence on disk, and back: trajectory, exposure, writer, reader. Knows nothing of methods.

pub mod exposure;
pub mod film;
mod misregister;
pub mod preview;
pub mod sensor;
pub mod sequence;
mod shared_frames;
mod shoot;
pub mod trajectory;
pub mod truth;

use std::path::{Path, PathBuf};

use rayon::prelude::*;
use serde::Serialize;

use crate::airway::case::Case;
use crate::airway::{self, Anatomy, case_centerline};
use crate::base::revision::of_rooms;
use crate::base::{Error, Progress, Result, files, hash};
use crate::formats::transforms::Transforms;
use crate::formats::{mesh as mesh_file, png};
use crate::render::Material;
use film::Film;
use misregister::misregister;
use sensor::Sensor;
use sequence::{ManifestHead, Sequence};
use truth::{TruthMap, TruthSet};

/// Changes whenever the same case and settings give other pixels or other truth.
const SIMULATOR_VERSION: u32 = 7;

/// Which meshes a sequence folder holds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum MeshOutput {
    /// Inspiration and expiration: any other follows from the phase.
    #[default]
    EndStates,
    /// The deformed mesh of every frame as well.
    EveryFrame,
}

/// Whether linear images are kept beside the 8-bit ones.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum RadianceOutput {
    /// 8-bit sRGB only.
    #[default]
    None,
    /// Linear radiance before gain and white balance, as OpenEXR.
    Exr,
}

/// How a case is filmed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SimulationSettings {
    /// Image width in pixels.
    pub width_px: u32,
    /// Image height in pixels.
    pub height_px: u32,
    /// Frame rate of the video.
    pub frames_per_second: f64,
    /// Number of frames.
    pub frames: usize,
    /// Paths traced per pixel.
    pub samples_per_pixel: u32,
    /// Meshes to write.
    pub meshes: MeshOutput,
    /// Linear images to write.
    pub radiance: RadianceOutput,
    /// Ground-truth images to write.
    pub truth: TruthSet,
}

/// Films `case` into the folder `out` and opens the result.
///
/// A finished folder with the same content hash is only opened; a half-made one is resumed frame by frame; one of
/// another content is made anew. The bytes depend on case and settings alone. Frames of the same film that a finished folder
/// beside `out` holds (films of one case with different errors of the registration) are copied, not rendered.
/// Errors: the case's (anatomy, way, material), a folder that is no sequence, writing; `Interrupted` between frames.
pub fn simulate(case: &Case, settings: &SimulationSettings, out: &Path, progress: &dyn Progress) -> Result<Sequence> {
    check(settings)?;
    let hash = sequence_hash(case, settings)?;
    if let Ok(done) = Sequence::open(out)
        && done.hash == hash
    {
        return Ok(done);
    }
    let material = material(case)?;
    prepare_folder(out, &hash)?;
    let anatomy = airway::build(case)?;
    let film = Film::plan(case, &anatomy, settings, &material)?;
    film.notes.iter().for_each(|note| progress.note(&format!("{}: {note}", case.id)));
    shared_frames::copy_frames(case, settings, out, progress)?;
    shoot::shoot(case, &anatomy, &film, &material, settings, out, progress)?;
    write_truth(case, &anatomy, &film, settings, &hash, out)?;
    Sequence::open(out)
}

/// Revision of the code that films a sequence.
pub fn revision() -> String {
    of_rooms(&["outside", "tracer", "base", "formats", "airway", "render", "simulate"])
}

/// Content hash of the sequence that `case` and `settings` make, 64 hex digits.
pub fn sequence_hash(case: &Case, settings: &SimulationSettings) -> Result<String> {
    hash::of_value(&(SIMULATOR_VERSION, case.hash()?, settings))
}

/// The look that the case file asks for.
pub fn material(case: &Case) -> Result<Material> {
    let material: Material = case
        .material
        .clone()
        .try_into()
        .map_err(|e| Error::input(e.to_string().trim_end().replace('\n', " ")).element("material"))?;
    material.validate()?;
    Ok(material)
}

fn check(settings: &SimulationSettings) -> Result<()> {
    let size = |v: u32| (1..=8192).contains(&v);
    if !size(settings.width_px) || !size(settings.height_px) || settings.samples_per_pixel == 0 {
        return Err(Error::usage("a film needs images of 1 to 8192 pixels a side and at least one sample per pixel"));
    }
    if settings.frames < 2 || !(settings.frames_per_second.is_finite() && settings.frames_per_second > 0.0) {
        return Err(Error::usage("a film needs at least two frames and a positive frame rate"));
    }
    Ok(())
}

/// Makes the folder ready for the content `hash`: keeps the frames of the same content, removes those of another.
fn prepare_folder(out: &Path, hash: &str) -> Result<()> {
    #[derive(serde::Deserialize)]
    struct Plan {
        hash: String,
    }
    let plan = out.join(sequence::PLAN);
    let same = plan.is_file() && files::read_json::<Plan>(&plan).is_ok_and(|p| p.hash == hash);
    if !same {
        let empty = !out.exists() || out.read_dir().map_err(|e| Error::io("reading", out, e))?.next().is_none();
        if !empty && !plan.is_file() {
            return Err(Error::input("is neither empty nor a sequence folder: nothing is overwritten").at(out));
        }
        let _ = std::fs::remove_file(out.join(sequence::MANIFEST));
        for part in sequence::FOLDERS {
            let folder = out.join(part);
            if folder.exists() {
                std::fs::remove_dir_all(&folder).map_err(|e| Error::io("removing", &folder, e))?;
            }
        }
        files::write_json(&plan, &serde_json::json!({ "hash": hash }))?;
    }
    // Nothing of the film, so away with it.
    files::remove_unfinished(out)
}

/// Everything but the frames; the manifest last.
fn write_truth(
    case: &Case,
    anatomy: &Anatomy,
    film: &Film,
    settings: &SimulationSettings,
    hash: &str,
    out: &Path,
) -> Result<()> {
    let comments = ["units mm", "space LPS", "normals point into the lumen"];
    mesh_file::write_ply(&out.join(sequence::INSPIRATION), &anatomy.inspiration, &comments)?;
    mesh_file::write_ply(&out.join(sequence::EXPIRATION), &anatomy.expiration, &comments)?;
    if case.registration_error_mm > 0.0 {
        let registered = misregister(&anatomy.expiration, case.registration_error_mm, case.seed);
        mesh_file::write_ply(&out.join(sequence::REGISTERED_EXPIRATION), &registered, &comments)?;
    }
    files::write_bytes(&out.join(sequence::CENTERLINE), case_centerline::to_csv(&anatomy.centerline).as_bytes())?;
    let mask = Sensor::new(&film.camera, &case.scope, case.seed).mask(&film.camera);
    if let Some(mask) = &mask {
        png::write_grey(&out.join(sequence::MASK), mask)?;
    }
    let entry = |(i, frame)| sequence::transforms_frame(i, frame, mask.is_some());
    let entries = film.frames.iter().enumerate().map(entry).collect();
    Transforms::new(&film.camera, entries).write(&out.join(sequence::TRANSFORMS))?;
    files::write_bytes(&out.join(sequence::FRAMES), film.frames_csv().as_bytes())?;
    files::write_bytes(&out.join(sequence::FORMAT), include_bytes!("FORMAT.md"))?;
    preview::write(out, film.frames.len(), settings.frames_per_second)?;
    let hashes: Vec<(String, String)> = content_names(case, settings)
        .into_par_iter()
        .map(|name| hash::of_file(&out.join(&name)).map(|h| (name, h)))
        .collect::<Result<_>>()?;
    let head = ManifestHead { case_id: case.id.clone(), hash: hash.to_string(), frames: film.frames.len() };
    let mut manifest = serde_json::to_value(head).map_err(|e| Error::input(e.to_string()))?;
    manifest["simulator_version"] = SIMULATOR_VERSION.into();
    manifest["case_hash"] = case.hash()?.into();
    manifest["film_hash"] = shared_frames::film_hash(case, settings)?.into();
    manifest["settings"] = serde_json::to_value(settings).map_err(|e| Error::input(e.to_string()))?;
    manifest["case"] = serde_json::to_value(case).map_err(|e| Error::input(e.to_string()))?;
    manifest["material"] = serde_json::to_value(material(case)?).map_err(|e| Error::input(e.to_string()))?;
    manifest["film"] = film.summary();
    manifest["files"] =
        hashes.into_iter().map(|(name, hash)| (name, hash.into())).collect::<serde_json::Map<_, _>>().into();
    files::write_json(&out.join(sequence::MANIFEST), &manifest)
}

/// All files of the folder but plan and manifest, in order.
fn content_names(case: &Case, settings: &SimulationSettings) -> Vec<String> {
    let fixed = [
        sequence::INSPIRATION,
        sequence::EXPIRATION,
        sequence::CENTERLINE,
        sequence::TRANSFORMS,
        sequence::FRAMES,
        sequence::FORMAT,
        sequence::CONTACT_SHEET,
        sequence::PREVIEW,
    ];
    let mut names: Vec<String> = fixed.iter().map(|n| n.to_string()).collect();
    if case.scope.mask_radius > 0.0 {
        names.push(sequence::MASK.to_string());
    }
    names.extend((0..settings.frames).flat_map(|frame| frame_names(frame, settings)));
    names
}

/// The files of one frame, the image last.
fn frame_names(frame: usize, settings: &SimulationSettings) -> Vec<String> {
    let truth = [
        (TruthMap::Normals, true, sequence::normal_name(frame)),
        (TruthMap::Albedo, true, sequence::albedo_name(frame)),
        (TruthMap::Motion, frame + 1 < settings.frames, sequence::forward_motion_name(frame)),
        (TruthMap::Motion, frame > 0, sequence::backward_motion_name(frame)),
        (TruthMap::PhaseSensitivity, true, sequence::sensitivity_name(frame)),
    ];
    let mut names = vec![sequence::depth_name(frame)];
    names.extend(truth.into_iter().filter(|(map, exists, _)| *exists && settings.truth.has(*map)).map(|t| t.2));
    if settings.meshes == MeshOutput::EveryFrame {
        names.push(sequence::frame_mesh_name(frame));
    }
    if settings.radiance == RadianceOutput::Exr {
        names.push(sequence::radiance_name(frame));
    }
    names.push(sequence::image_name(frame));
    names
}

/// Where the sequence of `case` lives below `root`: `<case>-<hash12>`.
pub fn sequence_folder(root: &Path, case: &Case, settings: &SimulationSettings) -> Result<PathBuf> {
    Ok(root.join(format!("{}-{}", case.id, &sequence_hash(case, settings)?[..12])))
}
