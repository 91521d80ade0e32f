//! From anatomy to a filmed sequence on disk, and back: trajectory, exposure, writer, reader. Knows nothing of methods.

pub mod clinical;
pub mod export;
pub mod exposure;
pub mod film;
mod film_tables;
mod identity;
mod look;
mod misregister;
mod novel_view;
pub mod participant;
pub mod preview;
pub mod sensor;
pub mod sequence;
mod settings;
mod shared_frames;
mod shoot;
mod steering;
mod told;
pub mod track;
pub mod trajectory;
pub mod truth;

use std::path::Path;

use rayon::prelude::*;

use crate::airway::case::Case;
use crate::airway::targets::targets;
use crate::airway::{self, Anatomy, case_centerline};
use crate::base::{Error, Progress, Result, files, hash};
use crate::formats::transforms::Transforms;
use crate::formats::{mesh as mesh_file, png};
use film::Film;
pub use film::scope_light;
use identity::{film_hash, simulator_version};
pub use identity::{revision, sequence_folder, sequence_hash};
pub use look::material;
use misregister::misregister;
use sensor::Sensor;
use sequence::{ManifestHead, NovelView, Sequence};
pub use settings::{FilmLight, MeshOutput, RadianceOutput, SimulationSettings};

/// Films `case` into the folder `out` and opens the result.
///
/// A finished folder with the same content hash is only opened, once all its files have been compared with the
/// manifest; frames that were changed since are filmed again. A half-made folder is resumed frame by frame; one of
/// another content is made anew. The bytes depend on case and settings alone. Frames of the same film that a finished
/// folder beside `out` holds (films of one case with different errors of the registration) are copied, not rendered.
/// Errors: the case's (anatomy, route, material), a folder that is no sequence, writing; `Interrupted` between frames.
pub fn simulate(case: &Case, settings: &SimulationSettings, out: &Path, progress: &dyn Progress) -> Result<Sequence> {
    settings.check()?;
    let hash = sequence_hash(case, settings)?;
    if let Some(done) = finished(case, settings, &hash, out, progress)? {
        return Ok(done);
    }
    let material = material(case)?;
    progress.accepts(&settings.estimate(case))?;
    let folder = FolderBefore::of(out, &hash)?;
    progress.advance(0, settings.frames);
    let of_case = |e: Error| case.blamed(e);
    let anatomy = airway::build(case).map_err(of_case)?;
    let film = Film::plan_watched(case, &anatomy, settings, &material, progress).map_err(of_case)?;
    film.notes.iter().for_each(|note| progress.note(&format!("{}: {note}", case.id)));
    // Not before: a case that cannot be filmed leaves nothing behind.
    folder.prepare(out, &hash)?;
    shared_frames::copy_frames(case, settings, out, progress)?;
    shoot::shoot(case, &anatomy, &film, &material, settings, out, progress).map_err(of_case)?;
    write_truth(case, &anatomy, &film, settings, &hash, out)?;
    Sequence::open(out)
}

/// The film in `out`, if it is the wanted one and nothing of it is missing or changed. Of a film that was changed
/// since, the images of the changed frames are removed, so that those frames are filmed again.
fn finished(
    case: &Case,
    settings: &SimulationSettings,
    hash: &str,
    out: &Path,
    progress: &dyn Progress,
) -> Result<Option<Sequence>> {
    let manifest = out.join(sequence::MANIFEST);
    let Ok(head) = files::read_json::<ManifestHead>(&manifest) else { return Ok(None) };
    if head.hash != hash {
        return Ok(None);
    }
    let changed = head.changed(out);
    let is_sound = |name: &String| head.files.contains_key(name) && changed.binary_search(name).is_err();
    if settings.content_names(case).iter().all(is_sound)
        && let Ok(done) = Sequence::open(out)
    {
        return Ok(Some(done));
    }
    let mut again = 0;
    for frame in (0..settings.frames).filter(|&frame| !settings.frame_names(case, frame).iter().all(is_sound)) {
        let image = out.join(sequence::image_name(frame));
        if image.exists() {
            std::fs::remove_file(&image).map_err(|e| Error::io("removing", &image, e))?;
        }
        again += 1;
    }
    if again > 0 {
        progress
            .note(&format!("{}: {again} frames were changed since they were filmed; they are filmed again", case.id));
    }
    Ok(None)
}

/// What a folder holds before a film is made in it.
#[derive(PartialEq)]
enum FolderBefore {
    /// Frames of the same content, which are kept.
    Same,
    /// Nothing, or another film, which is removed.
    Other,
}

impl FolderBefore {
    /// Of `out`, for the content `hash`. Errors: files that are no film's.
    fn of(out: &Path, hash: &str) -> Result<FolderBefore> {
        #[derive(serde::Deserialize)]
        struct FilmPlan {
            hash: String,
        }
        let plan = out.join(sequence::PLAN);
        if plan.is_file() {
            let is_same = files::read_json::<FilmPlan>(&plan).is_ok_and(|p| p.hash == hash);
            return Ok(if is_same { FolderBefore::Same } else { FolderBefore::Other });
        }
        let is_empty = !out.exists() || out.read_dir().map_err(|e| Error::io("reading", out, e))?.next().is_none();
        if !is_empty {
            return Err(Error::input("is neither empty nor a sequence folder: nothing is overwritten").at(out));
        }
        Ok(FolderBefore::Other)
    }

    /// Makes the folder ready for the content `hash`.
    fn prepare(self, out: &Path, hash: &str) -> Result<()> {
        if self == FolderBefore::Other {
            // One that stayed would describe frames of another film.
            let manifest = out.join(sequence::MANIFEST);
            match std::fs::remove_file(&manifest) {
                Err(e) if e.kind() != std::io::ErrorKind::NotFound => return Err(Error::io("removing", &manifest, e)),
                _ => {}
            }
            for part in sequence::FOLDERS {
                let folder = out.join(part);
                if folder.exists() {
                    std::fs::remove_dir_all(&folder).map_err(|e| Error::io("removing", &folder, e))?;
                }
            }
            files::write_json(&out.join(sequence::PLAN), &serde_json::json!({ "hash": hash }))?;
        }
        // What a killed run was writing is no part of the film.
        files::remove_unfinished(out)
    }
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
    if case.registration_error_mm > 0.0 && case.clinical.is_none() {
        let registered = misregister(&anatomy.expiration, case.registration_error_mm, case.seed);
        mesh_file::write_ply(&out.join(sequence::REGISTERED_EXPIRATION), &registered, &comments)?;
    }
    files::write_bytes(&out.join(sequence::CENTERLINE), case_centerline::to_csv(&anatomy.centerline).as_bytes())?;
    let planned = targets(anatomy, case.breathing.as_ref());
    let table = film_tables::points_csv(film_tables::POINTS_HEADER, planned.iter().map(|target| target.inspiration_mm));
    files::write_bytes(&out.join(sequence::TARGETS), table.as_bytes())?;
    let table = film_tables::points_csv(film_tables::POINTS_HEADER, planned.iter().map(|target| target.expiration_mm));
    files::write_bytes(&out.join(sequence::TARGETS_EXPIRATION), table.as_bytes())?;
    let mask = Sensor::new(&film.camera, &film.scope, case.seed).mask(&film.camera);
    if let Some(mask) = &mask {
        png::write_grey(&out.join(sequence::MASK), mask)?;
    }
    let entry = |(i, frame)| sequence::transforms_frame(i, frame, mask.is_some());
    let entries = film.frames.iter().enumerate().map(entry).collect();
    Transforms::new(&film.camera, entries).write(&out.join(sequence::TRANSFORMS))?;
    let entry = |view: &NovelView| sequence::novel_entry(view, &film.frames[view.frame], mask.is_some());
    let entries = film.novel_views.iter().map(entry).collect();
    Transforms::new(&film.camera, entries).write(&out.join(sequence::NOVEL_TRANSFORMS))?;
    files::write_bytes(&out.join(sequence::FRAMES), film.frames_csv().as_bytes())?;
    if let Some(clinical) = film.clinical() {
        told::write(case, anatomy, &planned, film, clinical, out)?;
    }
    let words = match film.clinical() {
        None => include_str!("FORMAT.md").to_owned(),
        Some(_) => include_str!("FORMAT.md").to_owned() + include_str!("FORMAT_CLINICAL.md"),
    };
    files::write_bytes(&out.join(sequence::FORMAT), words.as_bytes())?;
    preview::write(out, film.frames.len(), settings.frames_per_second)?;
    let files = settings
        .content_names(case)
        .into_par_iter()
        .map(|name| hash::of_file(&out.join(&name)).map(|h| (name, h)))
        .collect::<Result<_>>()?;
    let head = ManifestHead {
        case_id: case.id.clone(),
        hash: hash.to_string(),
        frames: film.frames.len(),
        breathing_period_s: film.breathing_period_s(),
        files,
    };
    let mut manifest = serde_json::to_value(head).map_err(|e| Error::input(e.to_string()))?;
    manifest["simulator_version"] = simulator_version(case).into();
    manifest["case_hash"] = case.hash()?.into();
    manifest["film_hash"] = film_hash(case, settings)?.into();
    manifest["settings"] = serde_json::to_value(settings).map_err(|e| Error::input(e.to_string()))?;
    manifest["case"] = serde_json::to_value(case).map_err(|e| Error::input(e.to_string()))?;
    manifest["material"] = serde_json::to_value(material(case)?).map_err(|e| Error::input(e.to_string()))?;
    manifest["film"] = film.summary();
    files::write_json(&out.join(sequence::MANIFEST), &manifest)
}
