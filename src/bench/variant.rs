//! Variants: a shipped method, or a case, with a few of its keys changed. What an ablation and a sweep are made of.
//!
//! A key is a path of TOML keys with dots (`appearance.gaussians_per_face`). Where it names a sourced number
//! (`{ value = .., source = .. }`), the value is what changes.
//!
//! ```toml
//! cases = ["tune1", "tune2"]           # never a scored case: numbers are chosen on what is run here
//! noise_seeds = [1, 2, 3]              # every line runs with the first, each method as shipped with all
//! metrics = ["novel_psnr_db"]          # columns, at most five
//! [[ablation]]                         # a line
//! group = "ingredients of `ours`"
//! setting = "no SSIM"
//! method = "ours"
//! set = { ssim_weight = 0.0 }
//! [[axis]]                             # a line for each value
//! method = "ours"
//! keys = ["ssim_weight", "phase_ssim_weight"]   # all of them have the same value
//! values = [0.1, 0.2, 0.4]
//! ```
//!
//! With `track = "clinical"` all lines run on films of the clinical track. With `grid = true` there is a line for every combination of the axes' values instead.

use std::path::Path;

use serde::Deserialize;

use super::plan::choose;
use crate::base::range::SEED;
use crate::base::{Error, Result, files};
use crate::reconstruct::MethodFile;
use crate::score::metric;
use crate::simulate::track::Track;

/// Most columns of a table beside its first.
const MOST_METRICS: usize = 5;
/// Most lines that axes make: a sweep of more takes weeks.
const MOST_LINES: usize = 500;

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
    /// How its cases are filmed: the file's `track`.
    #[serde(skip)]
    pub track: Track,
    /// It is a value of an axis: values of one axis are tried to find the best.
    #[serde(skip)]
    pub of_axis: bool,
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
            track: Track::default(),
            of_axis: false,
        }
    }

    /// Whether nothing is changed: a line that shows a method beside others.
    pub fn is_shipped(&self) -> bool {
        self.set.is_empty() && self.case.is_empty()
    }

    /// The method's file with its changes. `methods` is the folder of the shipped files.
    pub fn method_file(&self, methods: &Path) -> Result<MethodFile> {
        let file = MethodFile::load(&methods.join(format!("{}.toml", self.method)))?;
        file.with(self.set.iter().map(|(key, value)| (key.as_str(), value)))
    }
}

/// Values to be tried for some keys of a method. The shipped one may be among them: its cells are those of the method as
/// shipped.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct KeyAxis {
    /// Id of the method.
    method: String,
    /// Keys of the method file, which have the same value.
    keys: Vec<String>,
    /// The values.
    values: Vec<toml::Value>,
}

impl KeyAxis {
    fn name(&self) -> String {
        self.keys.join(" = ")
    }

    fn check(&self) -> Result<()> {
        let refused = |element: &str| Err(Error::input("must not be empty").element(element));
        match self {
            axis if axis.keys.is_empty() => refused("axis.keys"),
            axis if axis.values.is_empty() => refused("axis.values"),
            _ => Ok(()),
        }
    }
}

/// One value of each of some axes, as a line.
fn line_of(group: String, chosen: &[(&KeyAxis, &toml::Value)]) -> Variant {
    let words = |(axis, value): &(&KeyAxis, &toml::Value)| match chosen.len() {
        1 => value.to_string(),
        _ => format!("{} {value}", axis.name()),
    };
    let keys = |(axis, value): &(&KeyAxis, &toml::Value)| -> Vec<(String, toml::Value)> {
        axis.keys.iter().map(|key| (key.clone(), (*value).clone())).collect()
    };
    Variant {
        group,
        setting: chosen.iter().map(words).collect::<Vec<_>>().join(", "),
        set: chosen.iter().flat_map(keys).collect(),
        of_axis: true,
        ..Variant::shipped(&chosen[0].0.method)
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
    /// Ids of the metrics that the tables show, at most five.
    #[serde(default = "default_metrics")]
    pub metrics: Vec<String>,
    /// The track on which all lines run: `ideal` or `clinical`.
    #[serde(default)]
    track: String,
    /// One line each; those of the axes follow those of the file.
    #[serde(default)]
    pub ablation: Vec<Variant>,
    #[serde(default)]
    axis: Vec<KeyAxis>,
    /// Whether the axes are combined, instead of one at a time.
    #[serde(default)]
    grid: bool,
}

fn default_metrics() -> Vec<String> {
    ["novel_psnr_db", "novel_depth_rmse_mm", "phase_mae", "target_mean_mm", "time_per_frame_s"].map(String::from).into()
}

impl Ablations {
    /// Reads the file; `groups` keeps only those.
    pub fn load(path: &Path, groups: Option<&[String]>) -> Result<Self> {
        let mut read: Ablations = files::read_toml(path)?;
        read.check().map_err(|e| e.at(path))?;
        let lines = read.lines_of_axes().map_err(|e| e.at(path))?;
        read.ablation.extend(lines);
        let track = read.track();
        read.ablation.iter_mut().for_each(|variant| variant.track = track);
        let mut known: Vec<String> = Vec::new();
        for variant in &read.ablation {
            if !known.contains(&variant.group) {
                known.push(variant.group.clone());
            }
        }
        let chosen = choose(&known, groups, "group of lines")?;
        read.ablation.retain(|v| chosen.contains(&v.group));
        Ok(read)
    }

    fn check(&self) -> Result<()> {
        for (place, &seed) in self.noise_seeds.iter().enumerate() {
            SEED.check(seed as f64).map_err(|e| e.element(format!("noise_seeds[{place}]")))?;
        }
        if self.noise_seeds.is_empty() {
            return Err(Error::input("must name at least one seed").element("noise_seeds"));
        }
        if let Some(unknown) = self.metrics.iter().find(|id| metric(id).is_none()) {
            return Err(Error::input(format!("there is no metric `{unknown}`")).element("metrics"));
        }
        if !(1..=MOST_METRICS).contains(&self.metrics.len()) {
            return Err(Error::input(format!("must name 1 to {MOST_METRICS} metrics")).element("metrics"));
        }
        Track::of_word(&self.track).map_err(|e| e.element("track"))?;
        self.axis.iter().try_for_each(KeyAxis::check)
    }

    /// The track on which all lines run.
    pub fn track(&self) -> Track {
        Track::of_word(&self.track).unwrap_or_default()
    }

    fn lines_of_axes(&self) -> Result<Vec<Variant>> {
        let counts = self.axis.iter().map(|axis| axis.values.len());
        let count = if self.grid { counts.fold(1, usize::saturating_mul) } else { counts.sum() };
        if count > MOST_LINES {
            let sentence = format!("asks for {count} lines, and {MOST_LINES} is the most");
            return Err(Error::input(sentence).element("axis"));
        }
        if !self.grid {
            let one = |axis| move |value| line_of(KeyAxis::name(axis), &[(axis, value)]);
            return Ok(self.axis.iter().flat_map(|axis| axis.values.iter().map(one(axis))).collect());
        }
        let Some(first) = self.axis.first() else { return Ok(Vec::new()) };
        if self.axis.iter().any(|axis| axis.method != first.method) {
            return Err(Error::input("a grid has one method").element("axis"));
        }
        let mut chosen: Vec<Vec<(&KeyAxis, &toml::Value)>> = vec![Vec::new()];
        for axis in &self.axis {
            let with = |value| move |before: &Vec<_>| [before.as_slice(), &[(axis, value)]].concat();
            chosen = axis.values.iter().flat_map(|value| chosen.iter().map(with(value))).collect();
        }
        Ok(chosen.iter().map(|chosen| line_of("grid".into(), chosen)).collect())
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

    fn read(text: &str, groups: Option<&[String]>) -> Result<Ablations> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.toml");
        std::fs::write(&path, text).unwrap();
        Ablations::load(&path, groups)
    }

    #[test]
    fn every_shipped_line_makes_a_method_and_cases_that_can_be_read_and_none_of_them_is_scored() {
        use crate::bench::Catalogue;

        let catalogue = Catalogue::open(Some(&shipped())).unwrap();
        let sweeps = files::toml_stems(&shipped().join("tuning/sweeps")).unwrap();
        assert!(sweeps.len() >= 5, "{sweeps:?}");
        let sweeps = sweeps.iter().map(|name| catalogue.sweep_file(name).unwrap());
        for file in std::iter::once(catalogue.ablations_file()).chain(sweeps) {
            let ablations = Ablations::load(&file, None).unwrap();
            assert_eq!(ablations.cases, catalogue.tuning_ids().unwrap(), "{}", file.display());
            for variant in &ablations.ablation {
                let shipped_method =
                    MethodFile::load(&shipped().join("methods").join(format!("{}.toml", variant.method)));
                let changed = variant.method_file(&shipped().join("methods")).unwrap();
                let is_same = changed.keys() == shipped_method.unwrap().keys();
                assert!(variant.of_axis || is_same == variant.set.is_empty(), "{variant:?}");
                for case in &ablations.cases {
                    let file = catalogue.case_file(case).unwrap();
                    crate::airway::case::Case::load_changed(&file, &variant.case).unwrap();
                }
            }
        }
    }

    #[test]
    fn axes_become_lines_one_at_a_time_or_as_a_grid() {
        let axes = "[[axis]]\nmethod = 'ours'\nkeys = ['ssim_weight', 'phase_ssim_weight']\nvalues = [0.1, 0.4]\n\
            [[axis]]\nmethod = 'ours'\nkeys = ['iterations']\nvalues = [[1, 2, 3], [4, 5, 6], [7, 8, 9]]\n";
        let head = "cases = ['tune1']\nnoise_seeds = [1]\n";
        let lines = read(&format!("{head}{axes}"), None).unwrap().ablation;
        let words: Vec<_> = lines.iter().map(|v| (v.group.as_str(), v.setting.as_str())).collect();
        assert_eq!(words[1], ("ssim_weight = phase_ssim_weight", "0.4"));
        assert_eq!((words.len(), words[2]), (5, ("iterations", "[1, 2, 3]")));
        assert!(lines[0].set["ssim_weight"] == lines[0].set["phase_ssim_weight"] && lines[0].set.len() == 2);
        let grid = read(&format!("{head}grid = true\n{axes}"), None).unwrap().ablation;
        assert!(grid.len() == 6 && grid.iter().all(|v| v.set.len() == 3 && v.group == "grid"));
        assert_eq!(grid[5].setting, "ssim_weight = phase_ssim_weight 0.4, iterations [7, 8, 9]");
        let one = read(&format!("{head}{axes}"), Some(&["iterations".to_owned()])).unwrap();
        assert_eq!(one.ablation.len(), 3);
        let many = format!("{head}grid = true\n{}", axes.repeat(5));
        for (text, says) in [
            (many.as_str(), "axis: asks for 7776 lines, and 500 is the most"),
            (&format!("{head}{}", axes.replace("[0.1, 0.4]", "[]")), "axis.values: must not be empty"),
            (&format!("{head}metrics = ['psnr']\n"), "metrics: there is no metric `psnr`"),
            (&format!("{head}metrics = []\n"), "metrics: must name 1 to 5 metrics"),
            (&format!("{head}grid = true\n{}", axes.replacen("'ours'", "'ours-gn'", 1)), "a grid has one method"),
        ] {
            let said = read(text, None).unwrap_err().to_string();
            assert!(said.contains(says) && said.contains("a.toml"), "{said}");
        }
        let wish = ["no such".to_owned()];
        assert!(read(head, Some(&wish)).is_err());
    }
}
