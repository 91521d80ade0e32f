//! What can be run: cases, methods, profiles and thresholds, as the program carries them or in a folder that the user
//! names. Never a mixture of both: the same program gives the same results from whichever folder it is started.
//!
//! ```text
//! bench-cases/<case>.toml         a case each
//! bench-cases/gate.toml           thresholds
//! bench-cases/ablations.toml      variants of the methods and cases
//! bench-cases/methods/<id>.toml   a method each
//! bench-cases/profiles/<id>.toml  a profile each
//! ```

use std::path::{Path, PathBuf};

use super::plan::toml_ids;
use crate::base::{Error, Result, shipped};

/// Files beside the cases: the thresholds and the ablations.
const GATE: &str = "gate";
const ABLATIONS: &str = "ablations";

/// The carried files (`src/base/shipped.rs`), or those of a folder like `bench-cases/`.
#[derive(Clone, Debug)]
pub struct Catalogue {
    root: PathBuf,
}

impl Catalogue {
    /// That of `folder`; what the program carries when it is not given.
    pub fn open(folder: Option<&Path>) -> Result<Self> {
        match folder {
            None => Ok(Catalogue { root: PathBuf::from(shipped::ROOT) }),
            Some(root) if root.is_dir() => Ok(Catalogue { root: root.to_path_buf() }),
            Some(root) => Err(Error::input("there is no such folder").at(root)),
        }
    }

    /// The folder, or [`shipped::ROOT`].
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Ids of the cases in natural order (`case2` before `case10`).
    pub fn case_ids(&self) -> Result<Vec<String>> {
        Ok(toml_ids(&self.root)?.into_iter().filter(|id| id != GATE && id != ABLATIONS).collect())
    }

    /// The file of a case: `<id>.toml` of the catalogue, or `wish` itself when it is the path of a TOML file.
    pub fn case_file(&self, wish: &str) -> Result<PathBuf> {
        if wish.ends_with(".toml") {
            return Ok(PathBuf::from(wish));
        }
        let known = self.case_ids()?;
        if !known.iter().any(|id| id == wish) {
            let known = known.join(", ");
            return Err(Error::usage(format!(
                "there is no case `{wish}`; there are {known}, or the path of a case file"
            )));
        }
        Ok(self.root.join(format!("{wish}.toml")))
    }

    /// The folder of the methods.
    pub fn methods(&self) -> PathBuf {
        self.root.join("methods")
    }

    /// The folder of the profiles.
    pub fn profiles(&self) -> PathBuf {
        self.root.join("profiles")
    }

    /// The thresholds of the gate.
    pub fn gate_file(&self) -> PathBuf {
        self.root.join(GATE).with_extension("toml")
    }

    /// The ablations.
    pub fn ablations_file(&self) -> PathBuf {
        self.root.join(ABLATIONS).with_extension("toml")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cases_are_found_by_id_or_path_and_the_gate_is_none() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["case1.toml", "case2.toml", "gate.toml", "ablations.toml"] {
            std::fs::write(folder.path().join(name), "").unwrap();
        }
        let catalogue = Catalogue::open(Some(folder.path())).unwrap();
        assert_eq!(catalogue.case_ids().unwrap(), ["case1", "case2"]);
        assert_eq!(catalogue.case_file("case2").unwrap(), folder.path().join("case2.toml"));
        assert_eq!(catalogue.case_file("mine/own.toml").unwrap(), Path::new("mine/own.toml"));
        let unknown = catalogue.case_file("gate").unwrap_err();
        assert_eq!(unknown.kind().exit_code(), 2);
        assert!(unknown.to_string().contains("case1, case2"), "{unknown}");
        assert_eq!(Catalogue::open(Some(&folder.path().join("no"))).unwrap_err().kind().exit_code(), 4);
    }

    #[test]
    fn what_is_carried_is_what_the_folder_holds() {
        use crate::airway::case::Case;
        use crate::bench::{Ablations, Pipeline, Wishes};

        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("bench-cases");
        let (carried, on_disk) = (Catalogue::open(None).unwrap(), Catalogue::open(Some(&folder)).unwrap());
        assert_eq!(carried.case_ids().unwrap(), on_disk.case_ids().unwrap());
        // The keys of all cells, and with them cached films and results, are the same.
        for profile in ["smoke", "quick", "paper"] {
            let keys = |catalogue: &Catalogue| {
                let plan = Pipeline::new(catalogue, profile, Wishes::default()).unwrap().plan().unwrap();
                let cells = plan.cells();
                let keys: Vec<String> = cells.iter().map(|cell| plan.score_key(cell).unwrap()).collect();
                (plan.run_id().unwrap(), keys)
            };
            assert_eq!(keys(&carried), keys(&on_disk), "{profile}");
            assert!(!keys(&carried).1.is_empty());
        }
        let lines =
            |catalogue: &Catalogue| format!("{:?}", Ablations::load(&catalogue.ablations_file(), None).unwrap());
        assert_eq!(lines(&carried), lines(&on_disk));
        // A tree's path is relative to its case file, wherever that is.
        let anatomy = |catalogue: &Catalogue| {
            crate::airway::build(&Case::load(&catalogue.case_file("case1").unwrap()).unwrap()).unwrap()
        };
        assert_eq!(anatomy(&carried).inspiration.vertices, anatomy(&on_disk).inspiration.vertices);
    }
}
