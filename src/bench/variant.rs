//! Variants: a shipped method, or a case, with a few of its keys changed. What an ablation and a sweep are made of.
//!
//! A key is a path of TOML keys with dots (`appearance.gaussians_per_face`). Where it names a sourced number
//! (`{ value = .., source = .. }`), the value is what changes.

use std::path::Path;

use serde::Deserialize;

use super::plan::choose;
use crate::base::range::SEED;
use crate::base::{Error, Result, files};
use crate::reconstruct::MethodFile;

/// One line of `bench-cases/ablations.toml`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Variant {
    /// What is varied; lines of one group stand together. Empty for a method as shipped.
    pub group: String,
    /// What it is set to.
    pub setting: String,
    /// Id of the method.
    pub method: String,
    /// Keys of the method file and their new values.
    #[serde(default)]
    pub set: toml::Table,
    /// Keys of the case files and their new values.
    #[serde(default)]
    pub case: toml::Table,
}

impl Variant {
    /// The method as shipped, on the cases as shipped.
    pub fn shipped(method: &str) -> Self {
        Variant {
            group: String::new(),
            setting: String::new(),
            method: method.into(),
            set: toml::Table::new(),
            case: toml::Table::new(),
        }
    }

    /// The method's file with its changes. `methods` is the folder of the shipped files.
    pub fn method_file(&self, methods: &Path) -> Result<MethodFile> {
        let file = MethodFile::load(&methods.join(format!("{}.toml", self.method)))?;
        file.with(self.set.iter().map(|(key, value)| (key.as_str(), value)))
    }
}

/// The ablations file: its cases and its variants.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ablations {
    /// Ids of the cases.
    pub cases: Vec<String>,
    /// Seeds whose spread is the noise floor of each shipped method.
    pub noise_seeds: Vec<u64>,
    /// One line each.
    pub ablation: Vec<Variant>,
}

impl Ablations {
    /// Reads the file; `groups` keeps only those.
    pub fn load(path: &Path, groups: Option<&[String]>) -> Result<Self> {
        let mut read: Ablations = files::read_toml(path)?;
        for (place, &seed) in read.noise_seeds.iter().enumerate() {
            SEED.check(seed as f64).map_err(|e| e.element(format!("noise_seeds[{place}]")).at(path))?;
        }
        if read.noise_seeds.is_empty() {
            return Err(Error::input("must name at least one seed").element("noise_seeds").at(path));
        }
        let mut known: Vec<String> = read.ablation.iter().map(|v| v.group.clone()).collect();
        known.dedup();
        let chosen = choose(&known, groups, "ablation")?;
        read.ablation.retain(|v| chosen.contains(&v.group));
        Ok(read)
    }

    /// Methods that the lines name, each once, in their order.
    pub fn methods(&self) -> Vec<String> {
        let mut ids: Vec<String> = Vec::new();
        for variant in &self.ablation {
            if !ids.contains(&variant.method) {
                ids.push(variant.method.clone());
            }
        }
        ids
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shipped() -> std::path::PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("bench-cases")
    }

    #[test]
    fn every_shipped_ablation_makes_a_method_and_cases_that_can_be_read() {
        let ablations = Ablations::load(&shipped().join("ablations.toml"), None).unwrap();
        for variant in &ablations.ablation {
            let shipped_method = MethodFile::load(&shipped().join("methods").join(format!("{}.toml", variant.method)));
            let changed = variant.method_file(&shipped().join("methods")).unwrap();
            assert_eq!(changed.keys() == shipped_method.unwrap().keys(), variant.set.is_empty(), "{variant:?}");
            for case in &ablations.cases {
                crate::airway::case::Case::load_changed(&shipped().join(format!("{case}.toml")), &variant.case)
                    .unwrap();
            }
        }
        let wish = ["no such".to_owned()];
        assert!(Ablations::load(&shipped().join("ablations.toml"), Some(&wish)).is_err());
    }
}
