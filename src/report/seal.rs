//! `manifest.json` of a report: the hash of each file that `merge`, `gate` and `compare` read, so that one that was changed
//! afterwards is noticed. It is no signature: whoever changes table and manifest alike is found only where frames contradict.

use std::collections::BTreeMap;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::scene::SCENES;
use crate::base::{Error, Result, files, hash};

/// Its name.
const MANIFEST: &str = "manifest.json";
/// Tables that it covers; what the page shows is covered too, where it is there.
const TABLES: [&str; 4] = ["results.csv", "comparison.csv", "frames.csv", "timings.csv"];

#[derive(Serialize, Deserialize)]
struct ReportManifest {
    /// BLAKE3 of each file, by its name.
    files: BTreeMap<String, String>,
}

/// The files of a report that are there and covered; older reports kept no scenes.
fn covered(folder: &Path) -> impl Iterator<Item = &'static str> {
    TABLES.into_iter().chain(folder.join(SCENES).exists().then_some(SCENES))
}

/// Writes the manifest of the report in `folder`.
pub(super) fn write(folder: &Path) -> Result<()> {
    let hashed = |name: &str| Ok((name.to_owned(), hash::of_file(&folder.join(name))?));
    let files = covered(folder).map(hashed).collect::<Result<_>>()?;
    files::write_json(&folder.join(MANIFEST), &ReportManifest { files })
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
    for name in there {
        let table = folder.join(name);
        if manifest.files.get(name) != Some(&hash::of_file(&table)?) {
            let sentence =
                "was changed since it was written: its content does not have the hash that manifest.json gives";
            return Err(Error::input(sentence).at(table));
        }
    }
    Ok(missing)
}
