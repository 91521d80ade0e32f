//! Variants: a shipped method, or a case, with a few of its keys changed. What an ablation and a sweep are made of.
//!
//! A key is a path of TOML keys with dots (`appearance.gaussians_per_face`). Where it names a sourced number
//! (`{ value = .., source = .. }`), the value is what changes.

use std::path::{Path, PathBuf};

use serde::Deserialize;

use super::plan::choose;
use crate::base::{Error, Result, files};

/// One line of `bench-cases/ablations.toml`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Variant {
    /// What is varied; lines of one group stand together. Empty for a method as shipped.
    pub group: String,
    /// To what.
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

    /// Writes the method's file with its changes into `folder`; gives back its path.
    pub fn write_method(&self, methods: &Path, folder: &Path) -> Result<PathBuf> {
        let name = format!("{}.toml", self.method);
        let shipped = methods.join(&name);
        let mut table: toml::Table = files::read_toml(&shipped)?;
        for (key, value) in &self.set {
            let path: Vec<&str> = key.split('.').collect();
            replace(&mut table, &path, value.clone()).map_err(|e| e.at(&shipped))?;
        }
        let path = folder.join(name);
        files::write_bytes(&path, table.to_string().as_bytes())?;
        Ok(path)
    }
}

/// The file: on which cases, and what.
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

/// Replaces what stands at `path`; an error when there is no such key.
pub fn replace(table: &mut toml::Table, path: &[&str], value: toml::Value) -> Result<()> {
    let missing = || Error::input(format!("has no key `{}`", path.join(".")));
    let (last, groups) = path.split_last().ok_or_else(missing)?;
    let mut at = table;
    for group in groups {
        at = at.get_mut(*group).and_then(toml::Value::as_table_mut).ok_or_else(missing)?;
    }
    match at.get_mut(*last).ok_or_else(missing)? {
        toml::Value::Table(sourced) if sourced.contains_key("value") => sourced.insert("value".into(), value),
        plain => Some(std::mem::replace(plain, value)),
    };
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shipped() -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("bench-cases")
    }

    #[test]
    fn sourced_numbers_keep_their_source_and_unknown_keys_are_named() {
        let mut table: toml::Table =
            toml::from_str("variant = 'full'\n[appearance]\nrate = { value = 1, source = 'ours' }").unwrap();
        replace(&mut table, &["appearance", "rate"], toml::Value::from(3)).unwrap();
        replace(&mut table, &["variant"], toml::Value::from("release")).unwrap();
        assert_eq!(table["appearance"]["rate"]["value"].as_integer(), Some(3));
        assert_eq!(table["appearance"]["rate"]["source"].as_str(), Some("ours"));
        assert_eq!(table["variant"].as_str(), Some("release"));
        let error = replace(&mut table, &["appearance", "speed"], toml::Value::from(3)).unwrap_err();
        assert!(error.to_string().contains("appearance.speed"), "{error}");
    }

    #[test]
    fn every_shipped_ablation_makes_a_method_and_cases_that_can_be_read() {
        let ablations = Ablations::load(&shipped().join("ablations.toml"), None).unwrap();
        let folder = tempfile::tempdir().unwrap();
        for variant in &ablations.ablation {
            let path = variant.write_method(&shipped().join("methods"), folder.path()).unwrap();
            crate::reconstruct::method(&path, 1.0).unwrap();
            for case in &ablations.cases {
                crate::airway::case::Case::load_changed(&shipped().join(format!("{case}.toml")), &variant.case)
                    .unwrap();
            }
        }
        let wish = ["no such".to_owned()];
        assert!(Ablations::load(&shipped().join("ablations.toml"), Some(&wish)).is_err());
    }
}
