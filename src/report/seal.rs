//! `manifest.json` of a report: the hash of each file that `merge`, `gate` and `compare` read, so that one that was changed
//! afterwards is noticed. It is no signature: whoever changes table and manifest alike is found only where frames contradict.

use std::collections::BTreeMap;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::run::RUN_FACTS;
use super::scene::SCENES;
use crate::base::{Error, Result, files, hash};

/// Its name.
const MANIFEST: &str = "manifest.json";
/// Tables that it covers; what `run.json` says, what the page shows, and whole films are covered too, where they are there.
const TABLES: [&str; 4] = ["results.csv", "comparison.csv", "frames.csv", "timings.csv"];

#[derive(Serialize, Deserialize)]
struct ReportManifest {
    /// BLAKE3 of each file, by its name.
    files: BTreeMap<String, String>,
}

/// The files of a report that are there and always checked; older reports kept no scenes.
fn covered(folder: &Path) -> impl Iterator<Item = &'static str> {
    TABLES.into_iter().chain(folder.join(SCENES).exists().then_some(SCENES))
}

/// Writes the manifest of the report in `folder`, which covers the files `films`, too.
pub(super) fn write(folder: &Path, films: &[String]) -> Result<()> {
    let hashed = |name: String| hash::of_file(&folder.join(&name)).map(|hash| (name, hash));
    let facts = folder.join(RUN_FACTS).exists().then(|| RUN_FACTS.to_owned());
    let names = covered(folder).map(str::to_owned).chain(facts).chain(films.iter().cloned());
    let files = names.map(hashed).collect::<Result<_>>()?;
    files::write_json(&folder.join(MANIFEST), &ReportManifest { files })
}

/// Whether the file `name` of the report in `folder` is there and in its manifest, which older reports and those without
/// whole films have not.
///
/// Errors: a file that is not the manifest's.
pub(super) fn is_sealed(folder: &Path, name: &str) -> Result<bool> {
    let (path, manifest) = (folder.join(name), folder.join(MANIFEST));
    if !path.is_file() || !manifest.is_file() {
        return Ok(false);
    }
    let manifest: ReportManifest = files::read_json(&manifest)?;
    manifest.files.get(name).map_or(Ok(false), |sealed| refuse_changed(&path, Some(sealed)).map(|()| true))
}

fn refuse_changed(path: &Path, sealed: Option<&String>) -> Result<()> {
    if sealed.is_some() && !path.exists() {
        return Err(Error::input("is missing, and manifest.json has its hash: copy the report as a whole").at(path));
    }
    if sealed == Some(&hash::of_file(path)?) {
        return Ok(());
    }
    let sentence = "was changed since it was written: its content does not have the hash that manifest.json gives";
    Err(Error::input(sentence).at(path))
}

/// What shows that the tables in `folder` are as they were written, and is not there.
pub fn lacking_evidence(folder: &Path) -> impl Iterator<Item = &'static str> {
    [MANIFEST, RUN_FACTS].into_iter().filter(|name| !folder.join(name).is_file())
}

/// Refuses tables that are not those of the manifest, and names the files that are not there: a report of an older
/// version has no manifest, and one kept for reference leaves out what is long.
pub(super) fn check(folder: &Path) -> Result<Vec<&'static str>> {
    let (there, mut missing): (Vec<&str>, Vec<&str>) = covered(folder).partition(|name| folder.join(name).exists());
    let path = folder.join(MANIFEST);
    if !path.exists() {
        missing.insert(0, MANIFEST);
        return Ok(missing);
    }
    let manifest: ReportManifest = files::read_json(&path)?;
    // Older manifests do not cover it.
    let facts = manifest.files.contains_key(RUN_FACTS).then_some(RUN_FACTS);
    for name in there.into_iter().chain(facts) {
        refuse_changed(&folder.join(name), manifest.files.get(name))?;
    }
    Ok(missing)
}
