//! Which cells, and where they are kept: arguments that several commands share.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};

use crate::base::range::SEED;
use crate::base::{Error, Result};
use crate::bench::{Catalogue, Pipeline, Profile, Wishes};
use crate::simulate::track::Track;

/// The method that can refine poses, with poses that are true and with rough ones.
const WITH_POSES: &str = "ours-gn";
const WITHOUT_POSES: &str = "ours-gn-pose";

/// Profile, cases, methods, seeds.
#[derive(Args)]
pub struct Selection {
    #[command(flatten)]
    profile: ProfileChoice,
    /// Cases by id, or paths of case files; the profile's when not given
    #[arg(long, value_delimiter = ',', value_name = "CASE,..")]
    cases: Vec<String>,
    /// Methods by id; the profile's when not given
    #[arg(long, value_delimiter = ',', value_name = "METHOD,..")]
    methods: Vec<String>,
    #[command(flatten)]
    poses: PoseChoice,
    /// Seeds of the methods' randomness; the profile's when not given
    #[arg(long, value_delimiter = ',', value_name = "N,..", value_parser = SEED.parser::<u64>())]
    seeds: Vec<u64>,
    #[command(flatten)]
    catalogue: CatalogueFolder,
}

/// Size of a run.
#[derive(Args)]
pub struct ProfileChoice {
    /// Size of the run: smoke, quick, paper, or the path of a profile file
    #[arg(long, default_value = "quick", value_name = "P")]
    profile: String,
}

impl ProfileChoice {
    /// Name or path, as it was given.
    pub fn name(&self) -> &str {
        &self.profile
    }
}

/// Where a run keeps what it makes.
#[derive(Args)]
pub struct CacheFolder {
    /// Folder of sequences and finished cells
    #[arg(long, default_value = ".cache", value_name = "DIR")]
    cache: PathBuf,
}

impl CacheFolder {
    /// The folder, which may not be there yet.
    pub fn path(&self) -> &Path {
        &self.cache
    }
}

/// The one track that a command is about.
#[derive(Args)]
pub struct TrackChoice {
    /// What the methods are told
    #[arg(long, value_enum, default_value = "ideal", value_name = "T")]
    track: TrackWord,
}

#[derive(Clone, Copy, ValueEnum)]
enum TrackWord {
    /// The paper's assumptions
    Ideal,
    /// What a hospital has (docs/clinical.md)
    Clinical,
}

impl TrackChoice {
    /// The track.
    pub fn track(&self) -> Track {
        match self.track {
            TrackWord::Ideal => Track::Ideal,
            TrackWord::Clinical => Track::Clinical,
        }
    }
}

/// The tracks that a run is about.
#[derive(Args)]
pub struct TracksChoice {
    /// What the methods are told [default: the profile's: both tracks in `quick` and `paper`, the ideal one in `smoke`]
    #[arg(long, value_enum, value_name = "T")]
    track: Option<TracksWord>,
}

#[derive(Clone, Copy, ValueEnum)]
enum TracksWord {
    /// The paper's assumptions
    Ideal,
    /// What a hospital has (docs/clinical.md)
    Clinical,
    /// One after the other, each with a report of its own, and one page
    Both,
}

impl TracksChoice {
    /// The tracks: those of the profile in `selection` where none was chosen.
    pub fn tracks(&self, selection: &Selection) -> Result<Vec<Track>> {
        match self.track {
            Some(TracksWord::Ideal) => Ok(vec![Track::Ideal]),
            Some(TracksWord::Clinical) => Ok(vec![Track::Clinical]),
            Some(TracksWord::Both) => Ok(vec![Track::Ideal, Track::Clinical]),
            None => selection.tracks(),
        }
    }
}

/// How well the poses are known.
#[derive(Args)]
pub struct PoseChoice {
    /// Poses that are off by 2 mm and 3 degrees, refined with the phase: `ours-gn` becomes `ours-gn-pose`
    #[arg(long)]
    unknown_pose: bool,
}

impl PoseChoice {
    /// The methods to run. Errors where one of them needs true poses.
    pub fn rows(&self, methods: Option<Vec<String>>) -> Result<Option<Vec<String>>> {
        if !self.unknown_pose {
            return Ok(methods);
        }
        let named = methods.unwrap_or_else(|| vec![WITH_POSES.to_owned()]);
        if let Some(other) = named.iter().find(|m| ![WITH_POSES, WITHOUT_POSES].contains(&m.as_str())) {
            let sentence = format!("--unknown-pose is for `{WITH_POSES}`; `{other}` takes its poses for granted");
            return Err(Error::usage(sentence));
        }
        Ok(Some(vec![WITHOUT_POSES.to_owned()]))
    }
}

/// Where cases, methods and profiles are described.
#[derive(Args)]
pub struct CatalogueFolder {
    /// Folder of cases, methods, profiles and thresholds, instead of those that the program carries
    #[arg(long, value_name = "DIR")]
    bench_cases: Option<PathBuf>,
}

impl CatalogueFolder {
    /// Opens the folder, or what the program carries.
    pub fn open(&self) -> Result<Catalogue> {
        Catalogue::open(self.bench_cases.as_deref())
    }
}

/// What is the path of a TOML file, as an absolute one; names as they are.
fn absolute_file(wish: &str) -> Result<String> {
    if wish.ends_with(".toml") { absolute_path(Path::new(wish)) } else { Ok(wish.to_owned()) }
}

/// A path that holds in every folder, as a word of a command line.
pub fn absolute_path(path: &Path) -> Result<String> {
    let absolute = std::path::absolute(path).map_err(|e| Error::io("reading", path, e))?;
    absolute.into_os_string().into_string().map_err(|_| Error::usage("is no text in UTF-8").at(path))
}

fn wish<T>(given: Vec<T>) -> Option<Vec<T>> {
    (!given.is_empty()).then_some(given)
}

impl Selection {
    /// Name or path of the profile, as it was given.
    pub fn profile_name(&self) -> &str {
        self.profile.name()
    }

    /// The words of a command line that has the same profile and folders, which are absolute.
    pub fn place_words(&self) -> Result<Vec<String>> {
        let mut words = vec!["--profile".to_owned(), absolute_file(self.profile.name())?];
        if let Some(folder) = &self.catalogue.bench_cases {
            words.extend(["--bench-cases".to_owned(), absolute_path(folder)?]);
        }
        if self.poses.unknown_pose {
            words.push("--unknown-pose".to_owned());
        }
        Ok(words)
    }

    /// Whether cases were chosen, and not left to the profile.
    pub fn has_cases(&self) -> bool {
        !self.cases.is_empty()
    }

    /// The words of a command line that chooses the same methods and seeds.
    pub fn row_words(&self) -> Vec<String> {
        let mut words = Vec::new();
        if !self.methods.is_empty() {
            words.extend(["--methods".to_owned(), self.methods.join(",")]);
        }
        if !self.seeds.is_empty() {
            let seeds: Vec<String> = self.seeds.iter().map(u64::to_string).collect();
            words.extend(["--seeds".to_owned(), seeds.join(",")]);
        }
        words
    }

    /// The cases as they were asked for, files by their absolute paths; in the order of [`Pipeline::cases`].
    pub fn case_wishes(&self) -> Result<Vec<String>> {
        if !self.cases.is_empty() {
            return self.cases.iter().map(|wish| absolute_file(wish)).collect();
        }
        let catalogue = self.catalogue.open()?;
        match Profile::load(&catalogue.profiles(), self.profile.name())?.cases {
            Some(cases) => cases.iter().map(|wish| absolute_file(wish)).collect(),
            None => catalogue.case_ids(),
        }
    }

    /// The tracks that the profile runs.
    fn tracks(&self) -> Result<Vec<Track>> {
        Ok(Profile::load(&self.catalogue.open()?.profiles(), self.profile.name())?.tracks)
    }

    /// Reads everything that was chosen; every mistake in it is reported here, before any work.
    pub fn pipeline(&self, track: Track) -> Result<Pipeline> {
        let methods = self.poses.rows(wish(self.methods.clone()))?;
        let wishes = Wishes { cases: wish(self.cases.clone()), methods, seeds: wish(self.seeds.clone()), track };
        Pipeline::new(&self.catalogue.open()?, self.profile.name(), wishes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unknown_poses_choose_the_row_that_refines_them_and_refuse_others() {
        let names = |list: &[&str]| Some(list.iter().map(|s| s.to_string()).collect::<Vec<_>>());
        let rough = PoseChoice { unknown_pose: true };
        for asked in [None, names(&["ours-gn"]), names(&["ours-gn-pose"])] {
            assert_eq!(rough.rows(asked).unwrap(), names(&["ours-gn-pose"]));
        }
        let error = rough.rows(names(&["ours-gn", "ours"])).unwrap_err();
        assert_eq!(error.kind().exit_code(), 2);
        assert_eq!(PoseChoice { unknown_pose: false }.rows(names(&["ours"])).unwrap(), names(&["ours"]));
    }
}
