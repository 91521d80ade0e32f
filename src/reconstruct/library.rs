//! From the method files (`bench-cases/methods/`, on disk or carried by the program) to the methods.
//!
//! A file may name another one as its `base` and then states only what differs from it; a base may have a base of its
//! own. Values are inherited together with their source. The header is not inherited: every file has its own. Nor are
//! keys that the file's kind does not read, so that `static-ct`, which is given the phase, can build on `ours-window`,
//! which estimates it. What a file itself states must be read by its kind: every other key is refused by name.

use std::path::{Path, PathBuf};

use toml::{Table, Value};

use crate::base::{Error, Result, files};

use super::contract::Reconstruct;
use super::methods::bridgesplat::Bridgesplat;
use super::methods::bridgesplat_nomesh::BridgesplatNomesh;
use super::methods::ours::{GivenPhase, Ours};
use super::methods::ours_gn::OursGn;
use super::methods::ours_nav::OursNav;
use super::methods::ours_nomesh::OursNomesh;
use super::methods::virtual_rows::VirtualMethod;
use super::settings::{
    KeyPath, Keys, METHOD_RANGES, MethodHeader, MethodKind, MethodSettings, contains, overlay, remove, replace,
};

/// A method file with everything that it inherits.
#[derive(Clone, Debug)]
pub struct MethodFile {
    path: PathBuf,
    header: MethodHeader,
    keys: Table,
}

impl MethodFile {
    /// Reads a method file and its bases, which stand in the same folder.
    ///
    /// Errors: a file that is not TOML, an id that is not the file's name, an unknown kind, a base that is missing or
    /// leads back to the file, a key that is missing, that the file's kind does not read, or whose value has another
    /// type or is out of range.
    pub fn load(path: &Path) -> Result<Self> {
        Self::inherit(path, &mut Vec::new())
    }

    /// `heirs` are the files that lead here.
    fn inherit(path: &Path, heirs: &mut Vec<String>) -> Result<Self> {
        let own: Table = files::read_toml(path)?;
        let header: MethodHeader = files::read_toml(path)?;
        if path.file_stem().is_none_or(|stem| stem.to_string_lossy() != header.id) {
            let sentence = format!("must be the file's name, not `{}`", header.id);
            return Err(Error::input(sentence).element("id").at(path));
        }
        let mut keys = Table::new();
        if let Some(base) = &header.base {
            let refused = |sentence: String| Err(Error::input(sentence).element("base").at(path));
            heirs.push(header.id.clone());
            if heirs.contains(base) {
                return refused(format!("the bases form a circle: {} -> {base}", heirs.join(" -> ")));
            }
            let base_path = path.with_file_name(format!("{base}.toml"));
            if !files::is_file(&base_path) {
                return refused(format!("there is no method `{base}` in this folder"));
            }
            keys = Self::inherit(&base_path, heirs)?.keys;
            MethodHeader::KEYS.iter().for_each(|key| drop(keys.remove(*key)));
        }
        overlay(&mut keys, own.clone());
        let mut file = MethodFile { path: path.to_owned(), header, keys };
        for key in file.build(1.0)?.1 {
            if contains(&own, &key) {
                let sentence = format!("methods of kind {} read no such key", own["kind"]);
                return Err(Error::input(sentence).element(key.join(".")).at(path));
            }
            remove(&mut file.keys, &key);
        }
        file.check_numbers()?;
        Ok(file)
    }

    fn check_numbers(&self) -> Result<()> {
        METHOD_RANGES.check_value("", &Value::Table(self.keys.clone())).map_err(|e| e.at(&self.path))
    }

    /// The same method with the values of some keys changed. A key is a path with dots (`window.keyframes`).
    ///
    /// Errors: a key that the method does not have, or a value of another type or out of range.
    pub fn with<'a>(mut self, changes: impl IntoIterator<Item = (&'a str, &'a Value)>) -> Result<Self> {
        for (key, value) in changes {
            let path: Vec<&str> = key.split('.').collect();
            replace(&mut self.keys, &path, value.clone()).map_err(|e| e.at(&self.path))?;
        }
        self.build(1.0)?;
        self.check_numbers()?;
        Ok(self)
    }

    /// What every method file says.
    pub fn header(&self) -> &MethodHeader {
        &self.header
    }

    /// All keys that the method runs with, inherited ones included.
    pub fn keys(&self) -> &Table {
        &self.keys
    }

    /// The method. `iteration_scale` multiplies every iteration count (a profile's `iteration_scale`).
    pub fn method(&self, iteration_scale: f64) -> Result<Box<dyn Reconstruct>> {
        self.build(iteration_scale).map(|(method, _)| method)
    }

    /// The method as the navigation that it is.
    ///
    /// Errors: a method of another kind.
    pub fn navigation(&self) -> Result<OursNav> {
        MethodSettings::read(&mut Keys::new(self.keys.clone())).map(OursNav::new).map_err(|e| e.at(&self.path))
    }

    /// The settings, of the type that belongs to the method's kind.
    #[cfg(test)]
    pub fn settings<S: MethodSettings>(&self) -> Result<S> {
        S::read(&mut Keys::new(self.keys.clone()))
    }

    /// The method, and the paths of the keys that its kind does not read.
    fn build(&self, scale: f64) -> Result<(Box<dyn Reconstruct>, Vec<KeyPath>)> {
        let mut keys = Keys::new(self.keys.clone());
        let method = self.of_kind(&mut keys, scale).map_err(|e| e.at(&self.path))?;
        Ok((method, keys.unread()))
    }

    /// The program that the kind names, with its settings taken from `keys`.
    fn of_kind(&self, keys: &mut Keys, scale: f64) -> Result<Box<dyn Reconstruct>> {
        Ok(match self.header.kind {
            MethodKind::Ours => Box::new(Ours::new(MethodSettings::read(keys)?, scale)),
            MethodKind::StaticCt => {
                Box::new(Ours::with_given_phase(MethodSettings::read(keys)?, GivenPhase::Inspiration, scale))
            }
            MethodKind::OraclePhase => {
                Box::new(Ours::with_given_phase(MethodSettings::read(keys)?, GivenPhase::True, scale))
            }
            MethodKind::StaticExpiration => {
                Box::new(Ours::with_given_phase(MethodSettings::read(keys)?, GivenPhase::Expiration, scale))
            }
            MethodKind::PoseOnly => Box::new(VirtualMethod::pose_only(MethodSettings::read(keys)?)),
            MethodKind::MeanBreath => Box::new(VirtualMethod::mean_breath(MethodSettings::read(keys)?)),
            MethodKind::VirtualBronchoscopy => {
                Box::new(VirtualMethod::virtual_bronchoscopy(MethodSettings::read(keys)?))
            }
            MethodKind::OursNomesh => Box::new(OursNomesh::new(MethodSettings::read(keys)?, scale)),
            MethodKind::OursGn => Box::new(OursGn::new(MethodSettings::read(keys)?, scale)),
            MethodKind::OursNav => Box::new(OursNav::new(MethodSettings::read(keys)?)),
            MethodKind::Bridgesplat => Box::new(Bridgesplat::new(MethodSettings::read(keys)?, scale)),
            MethodKind::BridgesplatNomesh => Box::new(BridgesplatNomesh::new(MethodSettings::read(keys)?, scale)),
        })
    }
}

/// All method files of a folder, sorted by id.
pub fn method_files(folder: &Path) -> Result<Vec<MethodFile>> {
    let ids = files::toml_stems(folder)?;
    ids.iter().map(|id| MethodFile::load(&folder.join(format!("{id}.toml")))).collect()
}

#[cfg(test)]
mod tests {
    use super::super::settings::Listing;
    use super::*;

    fn shipped() -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("bench-cases/methods")
    }

    /// A copy of the shipped folder.
    fn copy() -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        for entry in std::fs::read_dir(shipped()).unwrap() {
            let path = entry.unwrap().path();
            std::fs::copy(&path, folder.path().join(path.file_name().unwrap())).unwrap();
        }
        folder
    }

    /// The error for the method `id` after `from` has been replaced by `to` in its file.
    fn refusal(folder: &Path, id: &str, from: &str, to: &str) -> String {
        let path = folder.join(format!("{id}.toml"));
        let good = std::fs::read_to_string(&path).unwrap();
        assert!(good.contains(from), "{id}: {from}");
        std::fs::write(&path, good.replacen(from, to, 1)).unwrap();
        let error = MethodFile::load(&path).err().unwrap_or_else(|| panic!("{id} is read with {to}"));
        std::fs::write(&path, good).unwrap();
        assert_eq!(error.kind().exit_code(), 4, "{error}");
        let text = error.to_string();
        assert!(text.contains(".toml: ") && !text.contains('\n'), "{text}");
        text
    }

    #[test]
    fn every_shipped_file_is_read_with_what_it_inherits() {
        let files = method_files(&shipped()).unwrap();
        let read: Vec<_> = files.iter().map(|f| (f.header().id.as_str(), f.header().base.as_deref())).collect();
        let expected = [
            ("bridgesplat", None),
            ("bridgesplat-nomesh", None),
            ("bridgesplat-release", Some("bridgesplat")),
            ("bridgesplat-tuned", Some("bridgesplat")),
            ("mean-breath", Some("virtual-bronchoscopy")),
            ("oracle-phase", Some("ours-window")),
            ("ours", None),
            ("ours-gn", None),
            ("ours-gn-pose", Some("ours-gn")),
            ("ours-nav", None),
            ("ours-nomesh", Some("ours")),
            ("ours-window", Some("ours")),
            ("pose-only", None),
            ("static-ct", Some("ours-window")),
            ("static-expiration", Some("static-ct")),
            ("virtual-bronchoscopy", Some("pose-only")),
        ];
        assert_eq!(read, expected);
        for file in &files {
            let id = &file.header().id;
            let draws = crate::base::own_row::own(id).unwrap().draws;
            assert_eq!(file.method(1.0).unwrap().draws(), draws, "{id}");
        }
        let number = |id: &str, key: &str| {
            let file = files.iter().find(|f| f.header().id == id).unwrap();
            key.split('.').try_fold(&Value::Table(file.keys().clone()), |at, key| at.get(key)).cloned()
        };
        // Inherited, replaced, and not read.
        assert_eq!(number("ours-window", "color_weight"), number("ours", "color_weight"));
        assert_eq!(number("ours-window", "window.memory"), number("ours", "window.memory"));
        assert_eq!(number("ours", "velocity.value"), Some(Value::from(0.0)));
        assert_eq!(number("ours", "velocity.source"), Some(Value::from("paper")));
        assert_eq!(number("ours-window", "velocity.value"), Some(Value::from(0.7)));
        assert_eq!(number("static-ct", "appearance.opacity"), number("ours", "appearance.opacity"));
        assert_eq!(number("static-ct", "velocity"), None);
        assert_eq!(number("ours-nomesh", "inherits"), None);
    }

    #[test]
    fn the_listing_is_read_for_every_kind() {
        let folder = copy();
        for file in method_files(&shipped()).unwrap() {
            let path = folder.path().join(format!("{}.toml", file.header().id));
            let text = std::fs::read_to_string(&path).unwrap();
            let lines: Vec<&str> = text.lines().filter(|line| !line.starts_with("listing")).collect();
            for (line, listing) in [
                ("", Listing::Always),
                ("listing = \"on-request\"\n", Listing::OnRequest),
                ("listing = \"clinical\"\n", Listing::Clinical),
            ] {
                std::fs::write(&path, format!("{line}{}", lines.join("\n"))).unwrap();
                let method = MethodFile::load(&path).unwrap().method(1.0).unwrap();
                assert_eq!((method.id(), method.listing()), (file.header().id.as_str(), listing));
            }
            std::fs::write(&path, text).unwrap();
        }
    }

    #[test]
    fn a_wrong_file_is_named_with_its_key() {
        let folder = copy();
        for (from, to, says) in [
            ("kind = \"ours\"", "kind = \"theirs\"", "unknown variant `theirs`"),
            ("id = \"ours\"", "id = \"mine\"", "must be the file's name"),
            ("color_weight", "colour_weight", "missing field `color_weight`"),
            ("color_weight", "colour_weight = 1\ncolor_weight", "colour_weight: "),
            ("quiet_share", "quite_share", "appearance: missing field `quiet_share`"),
            ("source = \"paper\"", "source = \"hearsay\"", "hearsay"),
            ("velocity = { value = 0.0", "velocity = { value = \"fast\"", "velocity"),
            ("velocity = { value", "velocity = { note = 1, value", "note"),
            ("velocity = { value = 0.0", "velocity = { value = nan", "velocity: NaN must lie in 0 to 2"),
            ("[60, 40, 30]", "[60, 4000000, 30]", "iterations[1]: 4000000 must lie in 0 to 100000"),
        ] {
            let text = refusal(folder.path(), "ours", from, to);
            assert!(text.contains(says) && text.contains("ours.toml"), "{text}");
        }
    }

    /// One line per kind and key that another kind reads.
    #[test]
    fn a_key_that_the_kind_does_not_read_is_refused() {
        let folder = copy();
        let appearance = ["scale_cap", "rotation_rate", "quiet_share", "scale_rate"].map(|k| format!("appearance.{k}"));
        let [scale_cap, rotation_rate, quiet_share, scale_rate] = appearance.each_ref().map(String::as_str);
        let estimation = [
            "color_weight",
            "phase_ssim_weight",
            "temporal_weight",
            "activation",
            "phase_leak",
            "theta_rate",
            "theta_rate_joint",
            "candidates",
            "velocity",
            "grid_steps",
            "memory_frames",
            "window.keyframes",
        ];
        let unread: [(&str, &[&str]); 10] = [
            ("ours", &[rotation_rate, "steps", "arap_weight"]),
            ("static-ct", &[&estimation[..], &[rotation_rate]].concat()),
            ("oracle-phase", &[&estimation[..], &[rotation_rate]].concat()),
            ("ours-nomesh", &["pixels_per_disc", "most_per_face", "inherits", "window.keyframes", scale_cap]),
            ("ours-gn", &["activation", "appearance.opacity", "pixels_per_disc"]),
            ("static-expiration", &[&estimation[..], &[rotation_rate]].concat()),
            ("pose-only", &["largest_width", "offsets", "appearance.opacity"]),
            ("virtual-bronchoscopy", &["offsets", "calibration_s", "velocity"]),
            ("bridgesplat", &["rotation_weight", rotation_rate, quiet_share, "window.keyframes"]),
            ("bridgesplat-nomesh", &["arap_weight", "variant", scale_cap, scale_rate, quiet_share]),
        ];
        for (id, keys) in unread {
            let path = folder.path().join(format!("{id}.toml"));
            let good: Table = files::read_toml(&path).unwrap();
            for key in keys {
                let mut table = good.clone();
                let stray: Table = toml::from_str(&format!("{key} = {{ value = 1, source = 'ours' }}")).unwrap();
                overlay(&mut table, stray);
                std::fs::write(&path, table.to_string()).unwrap();
                let error = MethodFile::load(&path).err().unwrap_or_else(|| panic!("{id} reads {key}"));
                assert_eq!(error.kind().exit_code(), 4);
                let says = format!("{id}.toml: {key}: methods of kind \"{id}\" read no such key");
                assert!(error.to_string().contains(&says), "{error}");
            }
            std::fs::write(&path, good.to_string()).unwrap();
        }
    }

    #[test]
    fn bases_may_form_a_chain_and_no_circle() {
        let folder = copy();
        let heir = "id = 'heir'\nkind = 'ours'\nbase = 'ours-window'\ndescription = ''\n";
        let path = folder.path().join("heir.toml");
        std::fs::write(&path, heir).unwrap();
        let settings: super::super::settings::OursSettings = MethodFile::load(&path).unwrap().settings().unwrap();
        assert_eq!((*settings.estimation.velocity, *settings.estimation.phase_leak), (0.7, 0.05));
        assert_eq!(settings.header.listing, Listing::Always, "a header is not inherited");

        let missing = refusal(folder.path(), "heir", "'ours-window'", "'yours'");
        assert!(missing.contains("base: there is no method `yours`"), "{missing}");
        let circle = refusal(folder.path(), "ours", "kind", "base = 'heir'\nkind");
        let says = "ours-window.toml: base: the bases form a circle: ours -> heir -> ours-window -> ours";
        assert!(circle.contains(says), "{circle}");
        let own = refusal(folder.path(), "ours", "kind", "base = 'ours'\nkind");
        assert!(own.contains("ours.toml: base: the bases form a circle: ours -> ours"), "{own}");
        let wrong_base = refusal(folder.path(), "ours", "color_weight", "colour_weight = 1\ncolor_weight");
        assert!(wrong_base.contains("colour_weight"), "{wrong_base}");
    }

    #[test]
    fn a_changed_key_is_one_that_the_kind_reads() {
        let load = |id: &str| MethodFile::load(&shipped().join(format!("{id}.toml"))).unwrap();
        let change = |id: &str, key: &str, value: Value| load(id).with([(key, &value)]).map(|f| f.keys().clone());
        let changed = change("ours-window", "window.keyframes", Value::from(4)).unwrap();
        assert_eq!(changed["window"]["keyframes"]["value"].as_integer(), Some(4));
        assert_eq!(changed["window"]["keyframes"]["source"].as_str(), Some("ours"));
        for (id, key, value) in [
            ("static-ct", "velocity", Value::from(0.5)),
            ("ours", "velocities", Value::from(0.5)),
            ("ours", "velocity", Value::from("fast")),
            ("ours", "velocity", Value::from(-1.0)),
            ("ours-gn", "window.keyframes", Value::from(i64::MAX)),
        ] {
            let error = change(id, key, value).unwrap_err().to_string();
            assert!(error.contains(key) && error.contains(&format!("{id}.toml")), "{error}");
        }
    }
}
