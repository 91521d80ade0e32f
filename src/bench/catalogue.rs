//! What can be run: the folder `bench-cases/` with its cases, methods, profiles and thresholds.
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
use crate::base::{Error, Result};

/// Files beside the cases: the thresholds and the ablations.
const GATE: &str = "gate";
const ABLATIONS: &str = "ablations";

/// An opened `bench-cases` folder.
#[derive(Clone, Debug)]
pub struct Catalogue {
    root: PathBuf,
}

impl Catalogue {
    /// `folder`, or when it is not given the nearest `bench-cases` above the working folder, or above the program.
    pub fn find(folder: Option<&Path>) -> Result<Self> {
        if let Some(root) = folder {
            return match root.is_dir() {
                true => Ok(Catalogue { root: root.to_path_buf() }),
                false => Err(Error::input("there is no such folder").at(root)),
            };
        }
        let starts = [std::env::current_dir().ok(), std::env::current_exe().ok()];
        let mut candidates = starts.iter().flatten().flat_map(|start| start.ancestors()).map(|a| a.join("bench-cases"));
        match candidates.find(|folder| folder.join("profiles").is_dir()) {
            Some(root) => Ok(Catalogue { root }),
            None => Err(Error::usage("there is no folder bench-cases here or above; name it with --bench-cases DIR")),
        }
    }

    /// The folder.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Ids of the cases in natural order (`case2` before `case10`).
    pub fn case_ids(&self) -> Result<Vec<String>> {
        Ok(toml_ids(&self.root)?.into_iter().filter(|id| id != GATE && id != ABLATIONS).collect())
    }

    /// The file of a case: `<id>.toml` here, or `wish` itself when it is the path of a TOML file.
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
        let catalogue = Catalogue::find(Some(folder.path())).unwrap();
        assert_eq!(catalogue.case_ids().unwrap(), ["case1", "case2"]);
        assert_eq!(catalogue.case_file("case2").unwrap(), folder.path().join("case2.toml"));
        assert_eq!(catalogue.case_file("mine/own.toml").unwrap(), Path::new("mine/own.toml"));
        let unknown = catalogue.case_file("gate").unwrap_err();
        assert_eq!(unknown.kind().exit_code(), 2);
        assert!(unknown.to_string().contains("case1, case2"), "{unknown}");
        assert_eq!(Catalogue::find(Some(&folder.path().join("no"))).unwrap_err().kind().exit_code(), 4);
    }

    #[test]
    fn the_shipped_folder_is_found_from_the_test_program() {
        assert!(Catalogue::find(None).unwrap().profiles().join("quick.toml").exists());
    }
}
