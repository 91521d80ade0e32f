//! Profiles: the size of a run. One TOML each in `bench-cases/profiles/`.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::plan::toml_ids;
use crate::airway::case::Effect;
use crate::base::range::{FRAME_RATE, FRAMES, KeyRanges, NumberRange, SAMPLES_PER_PIXEL, SEED};
use crate::base::{Error, Result, files};
use crate::report::run::{PROFILES_BETWEEN, is_evaluated_id};
use crate::simulate::FilmLight;
use crate::simulate::track::Track;

/// Ranges of a profile.
const RANGES: KeyRanges = KeyRanges(&[
    ("seeds", SEED),
    ("image_width_px", NumberRange::new(8.0, 4096.0)),
    ("frames_per_second", FRAME_RATE),
    ("minimum_frames", FRAMES),
    ("minimum_breaths", NumberRange::new(0.0, 1000.0)),
    ("samples_per_pixel", SAMPLES_PER_PIXEL),
    ("iteration_scale", NumberRange::new(1e-3, 100.0)),
]);

/// How large the images are, how many frames there are, and how much work goes into each.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Profile {
    /// Name: that of its file.
    #[serde(skip)]
    pub name: String,
    /// Its file.
    #[serde(skip)]
    pub file: PathBuf,
    /// One line for readers of the file.
    pub description: String,
    /// Cases to run; absent means all.
    #[serde(default)]
    pub cases: Option<Vec<String>>,
    /// Methods to run; absent means all.
    #[serde(default)]
    pub methods: Option<Vec<String>>,
    /// Tracks that `all-cases` runs where none is asked for; absent means the ideal one.
    #[serde(default = "ideal_alone")]
    pub tracks: Vec<Track>,
    /// Seeds of the methods' own randomness.
    pub seeds: Vec<u64>,
    /// Width and height of the square images in pixels.
    pub image_width_px: u32,
    /// Frame rate of the video.
    pub frames_per_second: f64,
    /// Fewest frames of a sequence.
    pub minimum_frames: usize,
    /// Whole breaths that a sequence covers at least; 0 lets `minimum_frames` alone decide.
    pub minimum_breaths: f64,
    /// Paths traced per pixel.
    pub samples_per_pixel: u32,
    /// Factor on every iteration count of the methods; 1 is the published setting.
    pub iteration_scale: f64,
    /// Effects of the scope that are switched off in every case.
    #[serde(default)]
    pub without: Vec<Effect>,
    /// `full`, or `draft` for films that only have to be there.
    #[serde(default, skip_serializing_if = "FilmLight::is_full")]
    pub light: FilmLight,
}

fn ideal_alone() -> Vec<Track> {
    vec![Track::Ideal]
}

impl Profile {
    /// Reads `<folder>/<wish>.toml`, or `wish` itself when it is the path of a TOML file. An unknown id is a usage
    /// error that lists the known ones.
    pub fn load(folder: &Path, wish: &str) -> Result<Profile> {
        let path = if wish.ends_with(".toml") { PathBuf::from(wish) } else { folder.join(format!("{wish}.toml")) };
        if !wish.ends_with(".toml") && !files::is_file(&path) {
            let known = toml_ids(folder)?.join(", ");
            let sentence = format!("there is no profile `{wish}`; there are {known}, or the path of a profile file");
            return Err(Error::usage(sentence));
        }
        let mut profile: Profile = files::read_toml(&path)?;
        profile.validate().map_err(|e| e.at(&path))?;
        profile.file.clone_from(&path);
        profile.name = path.file_stem().and_then(|stem| stem.to_str()).unwrap_or("custom").to_owned();
        if is_evaluated_id(&format!("{}-", profile.name)) || profile.name.contains(PROFILES_BETWEEN) {
            let sentence = "has a name that only predictions of others or merged reports have: rename it";
            return Err(Error::input(sentence).at(&path));
        }
        Ok(profile)
    }

    /// What a report says where methods do not run all of their iterations.
    pub fn note_on_iterations(&self) -> Option<String> {
        let percent = (1e6 * 100.0 * self.iteration_scale).round() / 1e6;
        (percent != 100.0).then(|| format!("Every method runs {percent} % of its iterations (docs/methods.md)."))
    }

    /// Rejects numbers that no run can use; the error names the key.
    pub fn validate(&self) -> Result<()> {
        if self.seeds.is_empty() {
            return Err(Error::input("must name at least one seed").element("seeds"));
        }
        if self.tracks.is_empty() || self.tracks.iter().enumerate().any(|(i, track)| self.tracks[..i].contains(track)) {
            return Err(Error::input("must name one track or both, each once").element("tracks"));
        }
        RANGES.check("", self)
    }

    /// Frames of a sequence whose breathing period is `period_s`.
    pub fn frames(&self, period_s: f64) -> usize {
        // The tiny slack keeps 4 s at 10 frames/s from becoming 41 frames by rounding.
        let breaths = (self.minimum_breaths * period_s * self.frames_per_second - 1e-9).ceil();
        self.minimum_frames.max(breaths as usize)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shipped() -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("bench-cases/profiles")
    }

    #[test]
    fn shipped_profiles_keep_their_promises() {
        assert_eq!(toml_ids(&shipped()).unwrap(), ["paper", "quick", "smoke"]);
        let quick = Profile::load(&shipped(), "quick").unwrap();
        assert!(quick.image_width_px >= 128 && quick.minimum_frames >= 40 && quick.minimum_breaths >= 1.0);
        assert_eq!((quick.cases, quick.methods), (None, None));
        assert_eq!(quick.tracks, [Track::Ideal, Track::Clinical]);
        let paper = Profile::load(&shipped(), "paper").unwrap();
        assert!(paper.image_width_px >= 256 && paper.minimum_frames >= 400 && paper.frames_per_second == 25.0);
        assert_eq!((paper.iteration_scale, paper.tracks), (1.0, quick.tracks));
        let smoke = Profile::load(&shipped(), "smoke").unwrap();
        assert_eq!((smoke.image_width_px, smoke.minimum_frames), (64, 12));
        assert_eq!(smoke.tracks, [Track::Ideal]);
        assert_eq!(smoke.cases.map(|c| c.len()), Some(2));
    }

    #[test]
    fn one_breath_is_covered_whatever_the_rate() {
        let quick = Profile::load(&shipped(), "quick").unwrap();
        assert_eq!(quick.frames(4.0), 40);
        assert_eq!(quick.frames(3.0), 40);
        assert_eq!(quick.frames(4.32), 44);
    }

    #[test]
    fn wrong_values_are_named() {
        let mut profile = Profile::load(&shipped(), "smoke").unwrap();
        profile.frames_per_second = f64::NAN;
        assert_eq!(profile.validate().unwrap_err().to_string(), "frames_per_second: NaN must lie in 0.1 to 1000");
        let unknown = Profile::load(&shipped(), "huge").unwrap_err();
        assert!(unknown.to_string().contains("paper, quick, smoke"), "{unknown}");
        let by_path = Profile::load(&shipped(), shipped().join("quick.toml").to_str().unwrap()).unwrap();
        assert_eq!((by_path.name.as_str(), by_path.minimum_frames), ("quick", 40));
        assert_eq!(Profile::load(&shipped(), "no/such.toml").unwrap_err().kind().exit_code(), 4);
    }
}
