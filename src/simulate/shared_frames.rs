//! Frames that two sequences share: films of one case with different errors of the registration have the same pixels
//! and truth, and only the mesh that methods are given differs. Such frames are copied from the folder that has them.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Deserialize;

use crate::airway::case::Case;
use crate::base::{Progress, Result, files, hash};

use super::identity::film_hash;
use super::sequence;
use super::settings::SimulationSettings;

/// The part of a manifest that identifies its film.
#[derive(Deserialize)]
struct FilmManifest {
    film_hash: Option<String>,
    files: BTreeMap<String, String>,
}

/// Copies into `out` the frames that it lacks and that a finished film beside it has, where they are byte by byte what
/// that film's manifest says. All others are left to be rendered.
///
/// Errors: writing into `out`. Damage to the other folder is no error: its frames are not taken.
pub(super) fn copy_frames(
    case: &Case,
    settings: &SimulationSettings,
    out: &Path,
    progress: &dyn Progress,
) -> Result<()> {
    let missing: Vec<usize> =
        (0..settings.frames).filter(|&frame| !out.join(sequence::image_name(frame)).is_file()).collect();
    if missing.is_empty() {
        return Ok(());
    }
    let Some((folder, manifest)) = find(case, &film_hash(case, settings)?, out) else { return Ok(()) };
    let mut copied = 0;
    for frame in missing {
        progress.proceed()?;
        // In the order of writing: the image is the last, so that an image means a whole frame.
        let names = settings.frame_names(case, frame);
        let Some(contents) = names.iter().map(|name| intact(&folder, name, &manifest)).collect::<Option<Vec<_>>>()
        else {
            continue;
        };
        for (name, content) in names.iter().zip(contents) {
            files::write_bytes(&out.join(name), &content)?;
        }
        copied += 1;
    }
    if copied > 0 {
        let name = folder.file_name().unwrap_or_default().to_string_lossy();
        progress
            .note(&format!("{}: {copied} frames are those of {name}, another registration of the same film", case.id));
    }
    Ok(())
}

/// The first finished folder beside `out`, by name, that belongs to the case and has the film.
fn find(case: &Case, wanted: &str, out: &Path) -> Option<(PathBuf, FilmManifest)> {
    let mut beside: Vec<PathBuf> =
        out.parent()?.read_dir().ok()?.filter_map(|entry| Some(entry.ok()?.path())).collect();
    beside.sort();
    let start = format!("{}-", case.id);
    let of_case = |path: &PathBuf| path.file_name().is_some_and(|n| n.to_string_lossy().starts_with(&start));
    beside.into_iter().filter(|path| path != out && of_case(path)).find_map(|path| {
        let manifest: FilmManifest = files::read_json(&path.join(sequence::MANIFEST)).ok()?;
        (manifest.film_hash.as_deref() == Some(wanted)).then_some((path, manifest))
    })
}

/// A file of that film, if it is unchanged since the film was finished.
fn intact(folder: &Path, name: &str, manifest: &FilmManifest) -> Option<Vec<u8>> {
    let content = files::read_bytes(&folder.join(name)).ok()?;
    (manifest.files.get(name)? == &hash::of_bytes(&content)).then_some(content)
}
