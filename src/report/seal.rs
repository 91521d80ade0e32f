//! `manifest.json` of a report: the hash of each file that `merge` reads, so that one that was changed afterwards is
//! noticed. It is no signature: whoever changes table and manifest alike is found only where frames contradict.

use std::collections::BTreeMap;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::scene::SCENES;
use crate::base::{Error, Result, files, hash};

/// Its name.
const MANIFEST: &str = "manifest.json";
/// Tables that it covers; what the page shows is covered too, where it is there.
const TABLES: [&str; 4] = ["results.csv", "comparison.csv", "frames.csv", "timings.csv"];

/// Tables with a row per frame or stage, without which a report can be read.
const LONG: [&str; 2] = ["frames.csv", "timings.csv"];

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

/// Refuses tables that are not those of the manifest. A report of an older version has none, and a report kept for
/// reference leaves out what is long ([`LONG`]); both are accepted unless a manifest is `needed`.
pub(super) fn check(folder: &Path, needed: bool) -> Result<()> {
    let path = folder.join(MANIFEST);
    if !path.exists() {
        let sentence =
            "is missing: without it nobody can tell whether the tables were changed; score the prediction again";
        return if needed { Err(Error::input(sentence).at(path)) } else { Ok(()) };
    }
    let manifest: ReportManifest = files::read_json(&path)?;
    for name in covered(folder) {
        let table = folder.join(name);
        if !needed && LONG.contains(&name) && !table.exists() {
            continue;
        }
        let wanted = manifest.files.get(name);
        if wanted.is_none() || wanted != Some(&hash::of_file(&table)?) {
            let sentence =
                "was changed since it was written: its content does not have the hash that manifest.json gives";
            return Err(Error::input(sentence).at(table));
        }
    }
    Ok(())
}
