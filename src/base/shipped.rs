//! The files that the program carries: cases with their trees and surfaces, methods, profiles, thresholds and ablations,
//! as they were in `bench-cases/` when it was built; none without the feature `methods`. Their paths begin with [`ROOT`], and [`super::files`] reads them like files on
//! disk, so that nothing above needs to know where a case comes from.

use std::path::{Component, Path, PathBuf};

/// What the paths of carried files begin with: `built-in:/case1.toml` is `bench-cases/case1.toml`.
pub const ROOT: &str = "built-in:";

/// Path below `bench-cases/` and bytes, sorted by path.
const FILES: &[(&str, &[u8])] = &include!(concat!(env!("OUT_DIR"), "/shipped.rs"));

/// The path below [`ROOT`]; `None` for a path on disk.
pub(super) fn below_root(path: &Path) -> Option<&Path> {
    path.strip_prefix(ROOT).ok()
}

/// The bytes of a carried file, by its path below [`ROOT`]; `a/../b` is `b`, as on disk.
pub(super) fn bytes(inside: &Path) -> Option<&'static [u8]> {
    let mut plain = PathBuf::new();
    for part in inside.components() {
        match part {
            Component::ParentDir => _ = plain.pop(),
            part => plain.push(part),
        }
    }
    FILES.iter().find(|(name, _)| Path::new(name) == plain).map(|(_, bytes)| *bytes)
}

/// Names of the files in a carried folder, by its path below [`ROOT`]; `None` where there is none.
pub(super) fn names(inside: &Path) -> Option<Vec<&'static str>> {
    let in_folder = |(name, _): &&(&'static str, &[u8])| Path::new(name).parent() == Some(inside);
    let last_part = |(name, _): &(&'static str, &[u8])| name.rsplit('/').next();
    let names: Vec<&str> = FILES.iter().filter(in_folder).filter_map(last_part).collect();
    (!names.is_empty()).then_some(names)
}

#[cfg(test)]
#[cfg(feature = "methods")]
mod tests {
    use super::*;
    use crate::base::files;

    /// Every file of the checkout, and nothing else, byte for byte.
    #[test]
    fn the_table_is_the_folder() {
        fn walk(folder: &Path, root: &Path, found: &mut Vec<(String, Vec<u8>)>) {
            for entry in std::fs::read_dir(folder).unwrap() {
                let path = entry.unwrap().path();
                if path.is_dir() {
                    walk(&path, root, found);
                } else if path.extension().is_some_and(|e| e == "toml" || e == "ply" || e == "csv") {
                    let name = path.strip_prefix(root).unwrap().to_str().unwrap().to_owned();
                    found.push((name, std::fs::read(&path).unwrap()));
                }
            }
        }
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("bench-cases");
        let mut found = Vec::new();
        walk(&root, &root, &mut found);
        found.sort();
        let carried: Vec<_> = FILES.iter().map(|(name, bytes)| (name.to_string(), bytes.to_vec())).collect();
        assert!(carried == found, "{:?}", found.iter().map(|f| &f.0).collect::<Vec<_>>());
        assert!(found.len() > 20);
    }

    #[test]
    fn carried_files_are_read_listed_and_missed_like_files_on_disk() {
        let root = Path::new(ROOT);
        let text = files::read_text(&root.join("gate.toml")).unwrap();
        assert_eq!(files::read_bytes(&root.join("gate.toml")).unwrap(), text.as_bytes());
        assert!(files::is_file(&root.join("trees/atm_224.toml")) && !files::is_file(&root.join("trees")));
        assert_eq!(files::read_text(&root.join("tuning/../gate.toml")).unwrap(), text);
        assert_eq!(files::toml_stems(&root.join("profiles")).unwrap(), ["paper", "quick", "smoke"]);
        assert!(files::toml_stems(root).unwrap().contains(&"case1".to_owned()));
        let missing = files::read_text(&root.join("case99.toml")).unwrap_err();
        assert_eq!(missing.to_string(), "built-in:/case99.toml: reading failed: the program carries no such file");
        assert_eq!(missing.kind().exit_code(), 4);
        let missing = files::toml_stems(&root.join("nowhere")).unwrap_err().to_string();
        assert!(missing.ends_with("the program carries no such folder"), "{missing}");
        let refused = files::write_bytes(&root.join("gate.toml"), b"").unwrap_err();
        assert_eq!(refused.to_string(), "built-in:/gate.toml: what the program carries cannot be written");
    }
}
