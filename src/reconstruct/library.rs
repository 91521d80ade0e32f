//! The methods that `bench-cases/methods/*.toml` define.

use std::path::Path;

use serde::Deserialize;

use crate::base::{Error, Result, files};

use super::contract::Reconstruct;
use super::methods::bridgesplat::Bridgesplat;
use super::methods::bridgesplat_nomesh::BridgesplatNomesh;
use super::methods::ours::{Ours, OursVariant};
use super::methods::ours_gn::OursGn;
use super::methods::ours_nomesh::OursNomesh;
use super::settings;

/// What every method file says; the rest depends on `kind`.
#[derive(Deserialize)]
struct Header {
    id: String,
    kind: String,
}

/// Reads one method. `iteration_scale` multiplies every iteration count (a profile's `iteration_scale`).
///
/// Errors: a file that is not TOML, an unknown key or kind, an id that is not the file's name.
pub fn method(path: &Path, iteration_scale: f64) -> Result<Box<dyn Reconstruct>> {
    let header: Header = files::read_toml(path)?;
    if path.file_stem().is_none_or(|stem| stem.to_string_lossy() != header.id) {
        return Err(Error::input(format!("must be the file's name, not `{}`", header.id)).element("id").at(path));
    }
    let phase = || files::read_toml::<settings::PhaseMethod>(path);
    let bridge = || files::read_toml::<settings::BridgeMethod>(path);
    Ok(match header.kind.as_str() {
        "ours" => Box::new(Ours::new(phase()?, OursVariant::Ours, iteration_scale)),
        "static-ct" => Box::new(Ours::new(phase()?, OursVariant::StaticCt, iteration_scale)),
        "oracle-phase" => Box::new(Ours::new(phase()?, OursVariant::OraclePhase, iteration_scale)),
        "ours-gn" => Box::new(OursGn::new(files::read_toml(path)?, iteration_scale)),
        "ours-nomesh" => Box::new(OursNomesh::new(phase()?, iteration_scale)),
        "bridgesplat" => Box::new(Bridgesplat::new(bridge()?, iteration_scale)),
        "bridgesplat-nomesh" => Box::new(BridgesplatNomesh::new(bridge()?, iteration_scale)),
        other => {
            let known = "ours, ours-nomesh, ours-gn, bridgesplat, bridgesplat-nomesh, static-ct, oracle-phase";
            return Err(Error::input(format!("there is no kind `{other}`; the kinds are {known}"))
                .element("kind")
                .at(path));
        }
    })
}

/// All methods of a folder, sorted by id.
pub fn methods(folder: &Path, iteration_scale: f64) -> Result<Vec<Box<dyn Reconstruct>>> {
    let entries = std::fs::read_dir(folder).map_err(|e| Error::io("reading", folder, e))?;
    let mut paths: Vec<_> = entries.filter_map(|e| e.ok()).map(|e| e.path()).collect();
    paths.retain(|p| p.extension().is_some_and(|e| e == "toml"));
    paths.sort_by_key(|p| p.file_stem().map(|stem| stem.to_owned()));
    paths.iter().map(|p| method(p, iteration_scale)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shipped() -> std::path::PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("bench-cases/methods")
    }

    #[test]
    fn the_methods_are_there() {
        let all = methods(&shipped(), 1.0).unwrap();
        let ids: Vec<&str> = all.iter().map(|m| m.id()).collect();
        let expected = [
            "bridgesplat",
            "bridgesplat-nomesh",
            "bridgesplat-release",
            "oracle-phase",
            "ours",
            "ours-gn",
            "ours-gn-pose",
            "ours-nomesh",
            "ours-plain",
            "static-ct",
        ];
        assert_eq!(ids, expected);
    }

    #[test]
    fn a_wrong_file_is_named_with_its_key() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("ours.toml");
        let good = std::fs::read_to_string(shipped().join("ours.toml")).unwrap();
        for (from, to, says) in [
            ("kind = \"ours\"", "kind = \"theirs\"", "there is no kind `theirs`"),
            ("id = \"ours\"", "id = \"mine\"", "must be the file's name"),
            ("color_weight", "colour_weight", "colour_weight"),
            ("source = \"paper\"", "source = \"hearsay\"", "hearsay"),
        ] {
            assert!(good.contains(from));
            std::fs::write(&path, good.replacen(from, to, 1)).unwrap();
            let error = method(&path, 1.0).err().unwrap().to_string();
            assert!(error.contains(says) && error.contains("ours.toml"), "{error}");
        }
    }
}
