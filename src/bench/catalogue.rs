//! What can be run: cases, methods, profiles and thresholds, as the program carries them or in a folder that the user
//! names. Never a mixture of both: the same program gives the same results from whichever folder it is started.
//!
//! ```text
//! bench-cases/<case>.toml                a case each, scored
//! bench-cases/tuning/<case>.toml         a case each, on which numbers of methods are chosen; never scored
//! bench-cases/patients/<case>.toml       a case each whose anatomy and motion are one person's; run when asked for
//! bench-cases/tuning/sweeps/<name>.toml  values of a method's keys, to be tried on the tuning cases
//! bench-cases/gate.toml                  thresholds of the ideal track
//! bench-cases/gate-clinical.toml         thresholds of the clinical track
//! bench-cases/ablations.toml             variants of the methods and cases
//! bench-cases/methods/<id>.toml          a method each
//! bench-cases/profiles/<id>.toml         a profile each
//! ```

use std::path::{Path, PathBuf};

use super::plan::toml_ids;
use crate::base::{Error, Result, shipped};
use crate::simulate::track::Track;

/// Files beside the cases: the thresholds and the ablations.
const GATE: &str = "gate";
const CLINICAL_GATE: &str = "gate-clinical";
const ABLATIONS: &str = "ablations";
/// Folder of the cases whose anatomy and motion are one person's.
const PATIENTS: &str = "patients";
/// Folder of the tuning cases, and in it that of the sweeps.
const TUNING: &str = "tuning";
const SWEEPS: &str = "sweeps";

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

    /// Ids of the scored cases in natural order (`case2` before `case10`).
    pub fn case_ids(&self) -> Result<Vec<String>> {
        Ok(toml_ids(&self.root)?
            .into_iter()
            .filter(|id| ![GATE, CLINICAL_GATE, ABLATIONS].contains(&id.as_str()))
            .collect())
    }

    /// Ids of the tuning cases, which no run takes unless it is told so; none where there is no such folder.
    pub fn tuning_ids(&self) -> Result<Vec<String>> {
        self.optional_ids(&self.root.join(TUNING))
    }

    /// Ids of the patients' cases, which no run takes unless it is told so; none where there is no such folder.
    pub fn patient_ids(&self) -> Result<Vec<String>> {
        self.optional_ids(&self.root.join(PATIENTS))
    }

    /// Ids of the files of a folder that a user's catalogue may lack.
    fn optional_ids(&self, folder: &Path) -> Result<Vec<String>> {
        let is_there = self.root == Path::new(shipped::ROOT) || folder.is_dir();
        if is_there { toml_ids(folder) } else { Ok(Vec::new()) }
    }

    /// The file of a scored, a tuning or a patient's case by id, or `wish` itself when it is the path of a TOML file.
    pub fn case_file(&self, wish: &str) -> Result<PathBuf> {
        if wish.ends_with(".toml") {
            return Ok(PathBuf::from(wish));
        }
        let folders = [
            (self.root.clone(), self.case_ids()?),
            (self.root.join(TUNING), self.tuning_ids()?),
            (self.root.join(PATIENTS), self.patient_ids()?),
        ];
        let of_wish = folders.iter().find(|(_, ids)| ids.iter().any(|known| known == wish));
        let (folder, _) = of_wish.ok_or_else(|| {
            let known: Vec<String> = folders.iter().flat_map(|(_, ids)| ids.clone()).collect();
            let known = known.join(", ");
            Error::usage(format!("there is no case `{wish}`; there are {known}, or the path of a case file"))
        })?;
        Ok(folder.join(format!("{wish}.toml")))
    }

    /// The folder of the methods.
    pub fn methods(&self) -> PathBuf {
        self.root.join("methods")
    }

    /// The folder of the profiles.
    pub fn profiles(&self) -> PathBuf {
        self.root.join("profiles")
    }

    /// The thresholds of the gate for runs of `track`.
    pub fn gate_file(&self, track: Track) -> PathBuf {
        let name = match track {
            Track::Ideal => GATE,
            Track::Clinical => CLINICAL_GATE,
        };
        self.root.join(name).with_extension("toml")
    }

    /// The ablations.
    pub fn ablations_file(&self) -> PathBuf {
        self.root.join(ABLATIONS).with_extension("toml")
    }

    /// A sweep by name, or `wish` itself when it is the path of a TOML file.
    pub fn sweep_file(&self, wish: &str) -> Result<PathBuf> {
        if wish.ends_with(".toml") {
            return Ok(PathBuf::from(wish));
        }
        let folder = self.root.join(TUNING).join(SWEEPS);
        let known = self.optional_ids(&folder)?;
        if !known.iter().any(|name| name == wish) {
            let known = known.join(", ");
            return Err(Error::usage(format!("there is no sweep `{wish}`; there are {known}, or the path of a file")));
        }
        Ok(folder.join(format!("{wish}.toml")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cases_are_found_by_id_or_path_and_the_gate_is_none() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["case1.toml", "case2.toml", "gate.toml", "gate-clinical.toml", "ablations.toml"] {
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
        assert_eq!(catalogue.tuning_ids().unwrap(), [""; 0]);
    }

    #[test]
    fn tuning_cases_patients_and_sweeps_are_found_by_name_and_are_not_among_the_scored() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("bench-cases");
        for catalogue in [Catalogue::open(None).unwrap(), Catalogue::open(Some(&folder)).unwrap()] {
            let tuning = catalogue.tuning_ids().unwrap();
            assert_eq!(tuning, ["tune1", "tune2", "tune3", "tune4"]);
            assert!(catalogue.case_ids().unwrap().iter().all(|id| !tuning.contains(id)));
            assert_eq!(catalogue.case_file("tune2").unwrap(), catalogue.root().join("tuning/tune2.toml"));
            assert_eq!(catalogue.patient_ids().unwrap(), ["patient1"]);
            assert_eq!(catalogue.case_file("patient1").unwrap(), catalogue.root().join("patients/patient1.toml"));
            assert_eq!(catalogue.sweep_file("ours").unwrap(), catalogue.root().join("tuning/sweeps/ours.toml"));
            assert_eq!(catalogue.sweep_file("my/own.toml").unwrap(), Path::new("my/own.toml"));
            assert!(catalogue.sweep_file("theirs").unwrap_err().to_string().contains("bridgesplat, clinical, ours"));
        }
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
